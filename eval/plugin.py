"""Entries of a dict that a command finds by name: a module each, imported when it is called."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from data_module.errors import InputError
from gesticulator.cli import PROGRAM, Command


@dataclass(frozen=True)
class Plugin:
    """module: has `arguments(parser)`, which adds what it takes, and `run(arguments)`. about: one line for --list."""

    module: str
    about: str

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add what it takes."""
        importlib.import_module(self.module).arguments(parser)

    def run(self, arguments: argparse.Namespace) -> Any:
        """What the module's `run` gives; InputError for input that cannot be used."""
        return importlib.import_module(self.module).run(arguments)


def verb(about: str, module: str, *examples: str) -> Command:
    """A command that is a module, whose `run` gives the exit code."""
    plugin = Plugin(module, about)
    return Command(about, plugin.arguments, plugin.run, examples)


def choice(word: str, about: str, known: Mapping[str, Plugin], show: Callable[[Any, Any], None],
           extra: Callable[[argparse.ArgumentParser], None], examples: Sequence[str]) -> Command:
    """The command `word NAME ...` over a dict, with --list.

    show: takes what the plugin's `run` gave, and the arguments. extra: adds arguments that all of the dict have.
    """
    def arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--list", action="store_true", help="list the names and exit")
        parser.add_argument("name", nargs="?", metavar="NAME", help="see --list")
        parser.add_argument("rest", nargs=argparse.REMAINDER, metavar="...", help="NAME --help lists its options")

    def run(given: argparse.Namespace) -> int:
        if given.list:
            width = max(map(len, known))
            print("\n".join(f"{name:<{width}}  {plugin.about}" for name, plugin in known.items()))
            return 0
        if given.name not in known:
            wrong = f"{given.name!r} is unknown" if given.name else "is missing"
            raise InputError(f"the name after {word}", wrong, f"choose among {', '.join(known)}")
        parser = argparse.ArgumentParser(f"{PROGRAM} {word} {given.name}", description=known[given.name].about)
        known[given.name].arguments(parser)
        extra(parser)
        chosen = parser.parse_args(given.rest)
        show(known[given.name].run(chosen), chosen)
        return 0

    return Command(about, arguments, run, examples)
