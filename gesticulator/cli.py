"""The command line: `gesticulator VERB ...`, and `python -m gesticulator VERB ...`.

A verb is an entry point of the group `gesticulator.commands`, so that higher packages and third-party packages can add
verbs. It names a `Command`, which must be cheap to import: heavy modules (torch, librosa) are imported by its `run`.
"""

import argparse
import difflib
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NoReturn

from data_module.errors import InputError, complain, one_line_errors
from data_module.registry import Registry, RegistryEntry

__all__ = ["Command", "main"]

PROGRAM = "gesticulator"
__version__ = "0.1.0"
"""As it stands in pyproject.toml."""
DEFAULT = "infer"
"""The verb used if the first word is not a verb: `gesticulator speech.wav -o gesture.bvh`."""


class Parser(argparse.ArgumentParser):
    """A parser that reports errors in one line, like all other user errors."""

    def error(self, message: str) -> NoReturn:
        """Raise the message as an `InputError` instead of printing the usage."""
        subject, colon, wrong = message.partition(": ")
        # argparse says what is wrong with an option, but does not guess what was meant.
        near = self._nearest(wrong) if subject == "unrecognized arguments" else ""
        raise InputError(subject if colon else "arguments", wrong or message,
                         (f"did you mean {near}? " if near else "") + f"see {self.prog} --help")

    def _nearest(self, arguments: str) -> str:
        """The known option most similar to the first unknown one, or ""."""
        unknown = next((word.partition("=")[0] for word in arguments.split() if word.startswith("--")), "")
        return next(iter(difflib.get_close_matches(unknown, list(self._option_string_actions), 1)), "")


@dataclass(frozen=True)
class Command:
    """A verb of the command line.

    summary: one line for the list of verbs. arguments: adds its arguments to a parser. run: executes it and returns the
    exit code. examples: command lines for its help, without the program's name; each one works as written.
    """

    summary: str
    arguments: Callable[[argparse.ArgumentParser], object]
    run: Callable[[argparse.Namespace], int]
    examples: Sequence[str] = ()

    def parser(self, program: str) -> argparse.ArgumentParser:
        """The parser of this command; program: how it was called, such as "gesticulator infer"."""
        epilog = "examples:\n" + "\n".join(f"  {PROGRAM} {line}" for line in self.examples) if self.examples else None
        # No abbreviations: a new option with the same prefix would break scripts that use one.
        parser = Parser(program, description=self.summary, epilog=epilog, allow_abbrev=False,
                        formatter_class=argparse.RawDescriptionHelpFormatter)
        self.arguments(parser)
        return parser

    def main(self, program: str, argv: Sequence[str] | None = None) -> int:
        """Parse and run; exit code 2 with one line for bad input."""
        with one_line_errors(PROGRAM):
            # Parsed within: errors of arguments are one line, too.
            code = self.run(self.parser(program).parse_args(argv))
            sys.stdout.flush()  # raise errors of a full disk or a closed pipe here
            return code


@contextmanager
def our_warnings() -> Iterator[None]:
    """Show only warnings of this package, one line each; suppress those of libraries."""
    with warnings.catch_warnings():
        # Libraries warn of deprecations that a user of the command can do nothing about.
        warnings.simplefilter("ignore")
        for name in ("data_module", "gesticulator"):
            warnings.filterwarnings("default", module=name)
        warnings.showwarning = _say_warning
        yield


def status(line: str, logged: bool = False) -> None:
    """Show what is being done: on a terminal in one line of standard error, "" to blank it; elsewhere, if it is
    `logged`, in lines of standard output. The import of tqdm would take a fortieth of a short recording."""
    if sys.stderr is not None and sys.stderr.isatty():
        # Back to its start, where a warning is written over it.
        print(f"\r{line[:79]:<79}\r", end="", file=sys.stderr, flush=True)
    elif logged:
        print(line, flush=True)


def _say_warning(message: Warning | str, *_: object, **__: object) -> None:
    complain(f"{PROGRAM}: warning: {' '.join(str(message).split())}")


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Fix the number of threads of NumPy's matrix products regardless of the environment: it determines the order of
    summation and with it the last bits of a result."""
    import numpy  # noqa: F401 - its BLAS must be loaded before it can be limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(count):
        yield


VERBS: Registry[RegistryEntry] = Registry("commands", "a gesticulator.cli.Command", {}, RegistryEntry,
                                 fits=lambda found: isinstance(found, Command))
"""By name; the verbs of this project are entry points too (pyproject.toml), so that `eval` can add verbs."""


def verbs() -> list[str]:
    """Names of the verbs: `DEFAULT` first, then alphabetically."""
    return sorted(VERBS, key=lambda name: (name != DEFAULT, name))


def usage(known: Mapping[str, Command]) -> str:
    """The usage of the program with its verbs, one per line."""
    width, program = max(map(len, known), default=0), PROGRAM
    lines = "\n".join(f"  {name:<{width}}  {command.summary}" for name, command in known.items())
    return (f"usage: {program} VERB ...      ({program} VERB --help describes each)\n"
            f"       {program} SPEECH -o FILE  is short for  {program} {DEFAULT} SPEECH -o FILE\n\n{lines}\n\n"
            f"For a recording named like a verb, include its folder: ./{DEFAULT}\n\n"
            f"{program} --version prints the version\n")


def _check_is_no_verb(word: str, known: Sequence[str]) -> None:
    """`InputError` if the first word is neither an option nor could name a recording."""
    # A word with a dot, a slash or a wildcard is a path, even if nothing is there.
    plain = word and not word.startswith("-") and not set(word) & set("./\\*?[")
    if plain and not os.path.lexists(word):
        near = difflib.get_close_matches(word, known, 1)
        raise InputError(word, "is neither a verb nor a file", (f"did you mean {near[0]}? " if near else "")
                         + f"verbs are {', '.join(known)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the verb named by the first argument."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        print(f"{PROGRAM} {__version__}")
        return 0
    with one_line_errors(PROGRAM):
        if not arguments or arguments[0] in ("-h", "--help"):
            # A broken third-party package must not make the help of the others unusable.
            usable = VERBS.usable()
            print(usage({name: VERBS.load(name) for name in verbs() if name in usable}), end="", flush=True)
            return 0 if arguments else 2
        # What is no verb is the first argument of the default one.
        verb, program = DEFAULT, f"{PROGRAM} {DEFAULT}"
        if arguments[0] in VERBS:
            verb = arguments.pop(0)
            program = f"{PROGRAM} {verb}"
        else:
            _check_is_no_verb(arguments[0], verbs())
        command: Command = VERBS.load(verb)
    return command.main(program, arguments)
