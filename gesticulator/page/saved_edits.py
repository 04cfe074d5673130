"""The plan file beside the sound that a page's edits are saved to, so that they are there when the page opens again."""

from __future__ import annotations

import threading
from pathlib import Path

from data_module.errors import InputError, complain
from data_module.files import write_text
from gesticulator.plan.plan import GesturePlan

ENDING = ".edits.plan.json"
"""Ending of the file beside `talk.wav`, `talk.edits.plan.json`."""
AFTER = 2.0
"""Seconds after the last edit that it is saved."""


def place_of(source: Path) -> Path:
    """The file for the edits of a sound."""
    return source.with_name(source.stem + ENDING)


def read_saved(source: Path) -> GesturePlan | None:
    """The plan saved beside a sound; None without one. A file that cannot be used is put aside, with a warning."""
    from gesticulator.plan.plan_file import read_plan

    place = place_of(source)
    if not place.is_file():
        return None
    try:
        return read_plan(place)
    except (InputError, OSError) as error:
        put_aside(source, str(error))
        return None


def put_aside(source: Path, why: str) -> None:
    """Rename the saved plan of a sound, and say so."""
    place = place_of(source)
    # Never overwritten: it may be hours of work under another bundle.
    aside = place.with_name(place.name + ".old")
    place.replace(aside)
    complain(f"{place}: is not opened, and is now {aside.name}: {why}")


class SavedEdits:
    """Saves the latest plan some time after it came, and when it is closed."""

    def __init__(self, place: Path, after: float = AFTER) -> None:
        self._place, self._after = place, after
        self._plan: GesturePlan | None = None
        self._timer: threading.Timer | None = None
        self._lock, self._writing = threading.Lock(), threading.Lock()

    def keep(self, plan: GesturePlan) -> None:
        """Save a plan soon, unless another one comes before."""
        with self._lock:
            self._plan = plan
            if self._timer is None:
                self._timer = threading.Timer(self._after, self.save)
                self._timer.daemon = True
                self._timer.start()

    def save(self) -> None:
        """Save the latest plan now, if it was not saved yet. A file that cannot be written is reported."""
        with self._lock:
            # Taken out under the lock, and written without it: a slow disk must not hold up an edit.
            plan, self._plan, self._timer = self._plan, None, None
        if plan is None:
            return
        with self._writing:
            try:
                write_text(self._place, plan.to_json())
            except OSError as error:
                complain(f"{self._place}: the edits are not saved ({error.strerror or error})")
