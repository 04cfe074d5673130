"""The one door: `gesticulator VERB ...`, and `python -m gesticulator VERB ...`.

A verb is an entry point of the group `gesticulator.commands`, so that packages above this one, and other people's, can
add verbs. It names a `Command`, which must be cheap to import: what is heavy (torch, librosa) is imported by its `run`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points

from data_module.errors import InputError, one_line_errors

PROGRAM = "gesticulator"
GROUP = "gesticulator.commands"
DEFAULT = "infer"
"""What is meant when the first word is no verb: `gesticulator speech.wav -o gesture.bvh`."""


@dataclass(frozen=True)
class Command:
    """A verb of the command line.

    summary: one line for the list of verbs. arguments: adds what it takes to a parser. run: does it, with the exit
    code. examples: command lines for its help, without the program's name; each is a line that works.
    """

    summary: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    examples: Sequence[str] = ()

    def parser(self, program: str) -> argparse.ArgumentParser:
        """The command's own parser; program: how it was called, such as "gesticulator infer"."""
        epilog = "examples:\n" + "\n".join(f"  {PROGRAM} {line}" for line in self.examples) if self.examples else None
        parser = argparse.ArgumentParser(program, description=self.summary, epilog=epilog,
                                         formatter_class=argparse.RawDescriptionHelpFormatter)
        self.arguments(parser)
        return parser

    def main(self, program: str, argv: Sequence[str] | None = None) -> int:
        """Parse and run; exit code 2 with one line for bad input."""
        arguments = self.parser(program).parse_args(argv)
        with one_line_errors(program):
            return self.run(arguments)


def commands() -> dict[str, Command]:
    """Every verb that is installed, in alphabetical order."""
    return {point.name: point.load() for point in sorted(entry_points(group=GROUP), key=lambda point: point.name)}


def usage(known: dict[str, Command]) -> str:
    """The verbs, one a line."""
    width = max(map(len, known), default=0)
    lines = "\n".join(f"  {name:<{width}}  {command.summary}" for name, command in known.items())
    return (f"usage: {PROGRAM} VERB ...      ({PROGRAM} VERB --help tells of each)\n"
            f"       {PROGRAM} SPEECH -o FILE  is short for  {PROGRAM} {DEFAULT} SPEECH -o FILE\n\n{lines}\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Hand the arguments to the verb that is named first."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        from gesticulator import __version__

        print(f"{PROGRAM} {__version__}")
        return 0
    points = {point.name: point for point in entry_points(group=GROUP)}
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage(commands()), end="")
        return 0 if arguments else 2
    if arguments[0] in points:
        command: Command = points[arguments[0]].load()
        return command.main(f"{PROGRAM} {arguments[0]}", arguments[1:])
    with one_line_errors(PROGRAM):
        if DEFAULT not in points:
            raise InputError(PROGRAM, "is not installed with its commands", "install it with pip install .")
    fallback: Command = points[DEFAULT].load()
    return fallback.main(PROGRAM, arguments)
