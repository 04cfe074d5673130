"""Tables of plug-ins: one class for interpreters, writers, corpora, characters, metrics, probes and verbs.

A plug-in of this project is an entry of its table: a name, where its object is ("module:object"), what it needs, one
line of help. Another package adds one by an entry point of the group `gesticulator.<kind>`. Nothing is imported until
it is used, so that the command line can list the names.

    [project.entry-points."gesticulator.writers"]
    ".txt" = "my_package.text:write_text"
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any, Generic, TypeVar

from data_module.errors import InputError, complain

PROJECT = "gesticulator"
"""The distribution whose entries win, and the first part of every group's name."""


@dataclass(frozen=True)
class Requirement:
    """A library that is not always installed. module: what is imported. package: its name on the package index.
    extra: the extra of this distribution that installs it."""

    module: str
    package: str
    extra: str

    def check(self, subject: object) -> None:
        """Raise `InputError` about `subject`, with the command that installs the library, if it is missing."""
        # Looked for, not imported: a large library would take seconds to load for a check.
        if find_spec(self.module) is None:
            raise InputError(subject, f"needs {self.package}, which is not installed",
                             f'pip install "{PROJECT}[{self.extra}]"')


@dataclass(frozen=True)
class RegistryEntry:
    """A plug-in. about: one line of help. where: "module:object", or a module. needs: a library of an extra, None for
    none."""

    about: str
    where: str
    needs: Requirement | None = field(default=None, kw_only=True)

    def load(self) -> Any:
        """The object. Our modules only; `Registry.load` is for those of other packages."""
        module, _, name = self.where.partition(":")
        return getattr(import_module(module), name) if name else import_module(module)


def is_tool(plugin: object) -> bool:
    """Whether an object is a module (or the like) with `arguments`, which adds its options to a parser, and `run`."""
    return callable(getattr(plugin, "arguments", None)) and callable(getattr(plugin, "run", None))


E = TypeVar("E", bound=RegistryEntry)


class Registry(Mapping[str, E], Generic[E]):
    """The plug-ins of one kind by name: those of the table in its order, then those of other packages by name.

    kind: plural; the group of entry points is `gesticulator.<kind>`. what: one of them in a message, "a data set that
    can be read". entries: the table. fits: whether an object can be such a plug-in.

    An entry point names either the object itself or a `RegistryEntry` (of the class `entry`), which names the object
    and says more. If two packages add one name, the table wins, else the package that comes first in the alphabet.
    Iterating, `in`, and `registry[name]` import no plug-in.
    """

    def __init__(self, kind: str, what: str, entries: Mapping[str, E], entry: type[E],
                 fits: Callable[[object], bool] = callable) -> None:
        self.kind, self.what, self.group = kind, what, f"{PROJECT}.{kind}"
        self._table, self._entry, self._fits = dict(entries), entry, fits
        self._points: dict[str, EntryPoint] | None = None

    def __iter__(self) -> Iterator[str]:
        yield from self._table
        yield from self.points()

    def __len__(self) -> int:
        return len(self._table) + len(self.points())

    def __contains__(self, name: object) -> bool:
        return name in self._table or name in self.points()

    def __getitem__(self, name: str) -> E:
        """The entry; for a plug-in of another package one that names the package and the object, without importing it
        (`entry` gives the rest)."""
        # An entry point's own description would need an import, so only its package is named.
        if name in self._table:
            return self._table[name]
        point = self.points()[name]
        return self._entry(f"of the package {_owner(point)}", point.value)

    def points(self) -> Mapping[str, EntryPoint]:
        """The entry points of this kind, without those whose name is taken already. Read once."""
        # Reading the files of all installed packages takes tens of milliseconds.
        if self._points is None:
            self._points = self._read()
        return self._points

    def _read(self) -> dict[str, EntryPoint]:
        # By package in reverse, so that the result does not depend on the order of installation and the first one wins.
        every = sorted(entry_points(group=self.group), key=lambda point: (_owner(point) != PROJECT, _owner(point)))
        points = {point.name: point for point in reversed(every) if point.name not in self._table}
        return dict(sorted(points.items()))

    def unknown(self, name: object) -> InputError:
        """The error for a name that is in no table: it lists the known ones, and the nearest first."""
        # A misspelt name is the usual mistake; the list alone would have to be searched by eye.
        near = difflib.get_close_matches(str(name), list(self), 1)
        return InputError(name, f"is not {self.what}",
                          (f"did you mean {near[0]}? " if near else "") + f"take one of {', '.join(self)}")

    def entry(self, name: str) -> E:
        """The entry in full; `InputError` for an unknown name, or where another package's cannot be imported."""
        plugin = self._object(name)
        return plugin if isinstance(plugin, self._entry) else self[name]

    def load(self, name: str) -> Any:
        """The object of a name.

        `InputError` in one line for an unknown name, for a missing library, for any exception while another package's
        module is imported, and for an object that is no such plug-in.
        """
        plugin = self._object(name)
        if not isinstance(plugin, RegistryEntry):
            return plugin
        if plugin.needs is not None:
            plugin.needs.check(name)
        # Errors in modules of this project are bugs, and keep their traceback.
        return plugin.load() if name in self._table else self._guarded(name, plugin.load)

    def _object(self, name: str) -> Any:
        """The entry of the table, or the object of the entry point: an entry or a plug-in."""
        if name in self._table:
            return self._table[name]
        if name not in self.points():
            raise self.unknown(name)
        return self._guarded(name, self.points()[name].load)

    def _guarded(self, name: str, load: Callable[[], Any]) -> Any:
        point = self.points()[name]
        subject = f"{name} ({point.value} of {_owner(point)})"
        try:
            plugin = load()
        except Exception as error:  # noqa: BLE001 - a module of another package may fail with anything
            raise InputError(subject, f"cannot be loaded ({type(error).__name__}: {error})",
                             "repair or remove the package that adds it") from None
        if not isinstance(plugin, self._entry) and not self._fits(plugin):
            raise InputError(subject, f"is not {self.what}", "repair or remove the package that adds it")
        return plugin

    def usable(self) -> dict[str, E]:
        """The entries in full. Of one that cannot be imported only a line is printed, on standard error."""
        entries: dict[str, E] = {}
        for name in self:
            try:
                entries[name] = self.entry(name)
            except InputError as error:
                complain(f"{PROJECT}: {error}")
        return entries


def _owner(point: EntryPoint) -> str:
    return str(point.dist.name) if point.dist is not None else "an unknown package"
