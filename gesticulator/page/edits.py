"""The plan of a recording that is edited on pages: its revisions, and its file beside the sound.

The server owns the plan. A page that changes it names the revision it started from: one that does not know of another
page's edits is refused (`StaleError`). Whatever the file would lose is copied first, to a name that is free.
"""

import json
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from data_module.errors import InputError, complain
from data_module.files import lock, write_bytes, write_text
from gesticulator.plan.plan import GesturePlan
from gesticulator.plan.plan_file import read_plan

ENDING = ".edits.plan.json"
"""Ending of the plan file beside `talk.wav` to which the edits are saved, `talk.wav.edits.plan.json`."""


class StaleError(Exception):
    """The plan was changed from another page since the revision that an edit started from."""


class Edits:
    """The present plan of a recording, which all its pages edit."""

    def __init__(self, place: Path | None = None, *, opened: bool = False, notice: str = "") -> None:
        """place: the plan's file; None to keep it in memory. opened: whether the first plan is that of the file.
        notice: what pages tell when they open."""
        self.place, self.problem, self.notice = place, "", notice
        self.plan: GesturePlan | None = None
        self._authors: list[str] = []  # the page that made each revision
        self._saved, self._lock = 0, threading.Lock()
        self._known = _stamp(place) if opened else None

    @property
    def revision(self) -> int:
        return len(self._authors)

    def check(self, base: int, page: str) -> None:
        """`StaleError` unless all revisions after `base` are of the same page, which may not await its answers."""
        if not 0 <= base <= self.revision or any(author != page for author in self._authors[base:]):
            raise StaleError

    def take(self, plan: GesturePlan, page: str) -> None:
        """Make a plan the present one, and save it."""
        if plan != self.plan:
            self.plan = plan
            self._authors.append(page)
        self.save()

    def head(self) -> dict[str, Any]:
        """What pages are told: the revision and who made it, why it is not saved (or ""), and what was copied."""
        return {"revision": self.revision, "author": self._authors[-1] if self._authors else "",
                "problem": self.problem, "notice": self.notice}

    def state(self, since: int) -> bytes:
        """`head` as JSON, with the plan if it is newer than a revision."""
        head, plan = self.head(), self.plan
        return json.dumps({**head, **({"plan": plan.to_dict()} if plan and head["revision"] > since else {})}).encode()

    def save(self) -> None:
        """Write the present plan unless it is saved. A failure is told in `problem` and once on the terminal, and the
        server tries again."""
        with self._lock:
            revision, plan = self.revision, self.plan
            if self.place is None or plan is None or revision == self._saved:
                return
            try:
                # Another program's file, or a plan that this one does not go on with: nothing is lost.
                if (there := _stamp(self.place)) not in (None, self._known):
                    self.copy(self.place.read_bytes())
                    self._known = there
                write_text(self.place, plan.to_json())
                self._known, self._saved, self.problem = _stamp(self.place), revision, ""
            except OSError as error:
                problem = f"{self.place.name}: the edits are not saved ({error.strerror or error})"
                if problem != self.problem:
                    complain(f"{problem}; the page keeps them, and saving is tried again")
                self.problem = problem

    def copy(self, data: bytes = b"") -> None:
        """Keep data, by default the present plan, beside the file; OSError if it cannot be written."""
        if self.place is not None and self.plan is not None:
            write_bytes(aside := free_name(self.place), data or self.plan.to_json().encode())
            self.notice = f"The plan that was in {self.place.name} before is in {aside.name}."


def _stamp(place: Path | None) -> int | None:
    """The time at which a file was written, which tells whether another program has; None without a file."""
    return place.stat().st_mtime_ns if place is not None and place.exists() else None


@contextmanager
def held(place: Path) -> Iterator[None]:
    """Keep other programs from editing a plan file; `InputError` if one does."""
    with ExitStack() as stack:
        # A folder that cannot be written takes no lock. Nothing is saved there, which the page tells.
        with suppress(OSError):
            stack.enter_context(lock(place, "gesticulator view", beside=True))
        yield


def place_of(source: Path) -> Path:
    """The file for the edits of a sound."""
    return source.with_name(source.name + ENDING)


def saved_beside(source: Path) -> Path | None:
    """The plan file with the edits of a sound, if there is one."""
    former = source.with_name(source.stem + ENDING)
    if (place := place_of(source)).is_file() or not former.is_file():
        return place if place.is_file() else None
    # Sounds of one stem shared a file: one of another sound stays where it is.
    with suppress(InputError):
        return former if read_plan(former).sound.name in ("", source.name) else None
    return former


def put_aside(place: Path, why: str) -> str:
    """Rename a plan file to a name that is free, and say so. Returns what is said."""
    place.rename(aside := free_name(place))
    said = f"{place}: is not opened, and is now {aside.name}: {why}"
    complain(said)
    return said


def free_name(place: Path) -> Path:
    """`NAME.old`, or the first of `NAME.old.2`, ... that is free: what was put aside is never overwritten."""
    names = (place.with_name(f"{place.name}.old{end}") for end in ("", *map(".{}".format, range(2, 10_000))))
    return next(name for name in names if not name.exists())
