"""The plan file beside the sound that a page's edits are saved to, so that they are there when the page opens again."""

from __future__ import annotations

from pathlib import Path

from data_module.errors import InputError, complain
from data_module.files import write_text
from gesticulator.plan.plan import GesturePlan

ENDING = ".edits.plan.json"
"""Ending of the file beside `talk.wav`, `talk.edits.plan.json`."""


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


def save(source: Path, plan: GesturePlan) -> None:
    """Save the edited plan of a sound beside it. A file that cannot be written is reported, and the page goes on."""
    place = place_of(source)
    try:
        write_text(place, plan.to_json())
    except OSError as error:
        complain(f"{place}: the edits are not saved ({error.strerror or error})")
