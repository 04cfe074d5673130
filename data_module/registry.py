"""Tables of plug-ins: one class for interpreters, writers, corpora, characters, metrics, probes and verbs.

A plug-in of this project is an entry of its table: a name, where its object is ("module:object"), what it needs, one
line of help. Another package adds one by an entry point of the group `gesticulator.<kind>`. Nothing is imported until
it is used, so that the command line can list the names.

    [project.entry-points."gesticulator.writers"]
    ".txt" = "my_package.text:write_text"
"""

import difflib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any, Generic, TypeVar

from data_module.errors import PROJECT, InputError, complain, install_line


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
            raise InputError(subject, f"needs {self.package}, which is not installed", install_line(self.extra))


@dataclass(frozen=True)
class RegistryEntry:
    """A plug-in. about: one line of help. where: "module:object", or a module. needs: a library of an extra, None for
    none."""

    about: str
    where: str
    needs: Requirement | None = field(default=None, kw_only=True)

    def load(self, subject: object = "") -> Any:
        """The object; `InputError` about `subject` for a missing library."""
        if self.needs is not None:
            self.needs.check(subject)
        module, _, name = self.where.partition(":")
        return getattr(import_module(module), name) if name else import_module(module)


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
        self.kind, self.what = kind, what
        self._table, self._entry, self._fits = dict(entries), entry, fits

    @cached_property
    def points(self) -> dict[str, EntryPoint]:
        """The entry points of other packages, without those whose name is taken already."""
        # By package in reverse, so that the result does not depend on the order of installation and the first one wins.
        every = sorted(entry_points(group=f"{PROJECT}.{self.kind}"), reverse=True,
                       key=lambda point: (_owner(point) != PROJECT, _owner(point)))
        return dict(sorted({point.name: point for point in every if point.name not in self._table}.items()))

    def __iter__(self) -> Iterator[str]:
        return iter([*self._table, *self.points])

    def __len__(self) -> int:
        return len(self._table) + len(self.points)

    def __getitem__(self, name: str) -> E:
        """The entry; for a plug-in of another package one that names the package and the object (`entry` gives the
        rest)."""
        if name in self._table:
            return self._table[name]
        point = self.points[name]
        return self._entry(f"of the package {_owner(point)}", point.value)

    def entry(self, name: str) -> E:
        """The entry in full; `InputError` for an unknown name, or where another package's cannot be imported."""
        plugin = self._table.get(name) or self._outside(name)
        return plugin if isinstance(plugin, self._entry) else self[name]

    def load(self, name: str) -> Any:
        """The object of a name. `InputError` in one line for an unknown name, for a missing library, for any exception
        while another package's module is imported, and for an object that is no such plug-in."""
        if name not in self._table:
            return self._outside(name, whole=True)
        # Errors in modules of this project are bugs, and have their traceback.
        return self._table[name].load(name)

    def usable(self) -> dict[str, E]:
        """The entries in full. Of one that cannot be imported only a line is printed, on standard error."""
        entries: dict[str, E] = {}
        for name in self:
            try:
                entries[name] = self.entry(name)
            except InputError as error:
                complain(f"{PROJECT}: {error}")
        return entries

    def _outside(self, name: str, whole: bool = False) -> Any:
        """The object of another package's entry point: the plug-in, or unless `whole` its entry."""
        if name not in self.points:
            # A misspelt name is the usual mistake; the list alone would have to be searched by eye.
            near = difflib.get_close_matches(name, list(self), 1)
            raise InputError(name, f"is not {self.what}",
                             (f"did you mean {near[0]}? " if near else "") + f"take one of {', '.join(self)}")
        point = self.points[name]
        subject = f"{name} ({point.value} of {_owner(point)})"
        try:
            plugin = point.load()
            if whole and isinstance(plugin, RegistryEntry):
                plugin = plugin.load(name)
        except Exception as error:  # noqa: BLE001 - a module of another package may fail with anything
            raise InputError(subject, f"cannot be loaded ({type(error).__name__}: {error})",
                             "repair or remove the package that adds it") from None
        if not isinstance(plugin, self._entry) and not self._fits(plugin):
            raise InputError(subject, f"is not {self.what}", "repair or remove the package that adds it")
        return plugin


def _owner(point: EntryPoint) -> str:
    return str(point.dist.name) if point.dist is not None else "an unknown package"
