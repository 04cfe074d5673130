"""Sections of a plan that may be left out: gesture units, meanings, pinned poses, curves of knobs, another sound.

They are read, checked, written and carried through every rendering. Absent, they cost nothing and do not stand in the
file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

from data_module.errors import InputError
from data_module.settings import SettingChoice, SettingRange
from gesticulator.plan.json_lines import Path as Place

PHASES = ("preparation", "pre-stroke hold", "stroke", "post-stroke hold", "retraction")
"""Phases of a gesture unit (Kendon; Kita et al.), in the order in which they come."""
UNIT_HANDS = ("left", "right", "both")
CURVES = ("intensity", "activity", "height", "speed", "radius")
"""What a curve may vary: two knobs, and the three hand controls in their units (metres, metres per second, metres)."""

Seconds = Annotated[float, SettingRange(0.0)]


@dataclass(frozen=True)
class GesturePhase:
    """A phase of a gesture unit."""

    kind: Annotated[str, SettingChoice(PHASES)]
    """Which phase it is."""
    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""


@dataclass(frozen=True)
class GestureUnit:
    """From where the hands leave rest to where they are at rest again; it spans several blocks."""

    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""
    phases: tuple[GesturePhase, ...] = ()
    """Its phases, in order and without overlap; there may be gaps, and several strokes."""
    hand: Annotated[str, SettingChoice(UNIT_HANDS)] | None = None
    """Which hand makes it; null where that is open."""
    size: Annotated[float, SettingRange(0.0, 2.0)] = 1.0
    """How large it is, as the intensity of a block."""


@dataclass(frozen=True)
class PlanMeaning:
    """What a stretch of the speech means, as far as a gesture can show it."""

    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""
    kind: str
    """What kind of meaning it is, such as "negation", "pointing" or "size"."""
    about: str = ""
    """What is meant, in words."""
    certainty: Annotated[float, SettingRange(0.0, 1.0)] | None = None
    """How certain the finding is."""


@dataclass(frozen=True)
class PosePin:
    """A joint that is to be in one place, or turned in one way, at one time. Give a rotation, a position or both."""

    time: Seconds
    """Seconds."""
    joint: str
    """The joint's name in the skeleton."""
    rotation: tuple[float, float, float, float] | None = None
    """Its local rotation, a unit quaternion, w first."""
    position: tuple[float, float, float] | None = None
    """Its place in metres: Y up, facing +Z, the floor at 0."""
    hold: Seconds = 0.0
    """Seconds that it stays so."""


@dataclass(frozen=True)
class KnobCurve:
    """A knob that changes over time, on straight lines between its points, and constant before and after them."""

    knob: Annotated[str, SettingChoice(CURVES)]
    """Which knob."""
    times: tuple[Seconds, ...]
    """[M] seconds, rising."""
    values: tuple[float, ...]
    """[M] the knob's value at these times, in its unit."""


@dataclass(frozen=True)
class SoundAlignment:
    """How the plan maps onto another export of its sound, in which pauses or tempo were changed."""

    sha256: str
    """Of the samples of the other sound, taken as that of `sound`."""
    duration: Annotated[float, SettingRange(0.0, above=True)]
    """Seconds of the other sound."""
    times: tuple[Seconds, ...]
    """[M] seconds of this plan, rising."""
    there: tuple[Seconds, ...]
    """[M] the same moments in seconds of the other sound, rising; straight lines between them."""


def check_units(units: tuple[GestureUnit, ...], error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` where units overlap, or their phases do not lie in them one after the other. error: makes one."""
    before = 0.0
    for at, unit in enumerate(units):
        place: Place = ("units", at)
        if not before <= unit.start < unit.end:
            raise error((*place, "start"), f"is {unit.start:g}", f"give {before:g} or more, and less than its end")
        inner = unit.start
        for number, phase in enumerate(unit.phases):
            if not inner <= phase.start < phase.end <= unit.end:
                raise error((*place, "phases", number), f"is {phase.start:g} to {phase.end:g} s",
                            f"give a range within {inner:g} to {unit.end:g} s")
            inner = phase.end
        before = unit.end


def check_meanings(meanings: tuple[PlanMeaning, ...], error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` where a meaning ends before it begins."""
    for at, one in enumerate(meanings):
        if not one.start <= one.end:
            raise error(("meanings", at), f"is {one.start:g} to {one.end:g} s", "give from and to, the lesser first")


def check_pins(pins: tuple[PosePin, ...], error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` for a pin of nothing, or with a rotation that is no unit quaternion."""
    for at, pin in enumerate(pins):
        if pin.rotation is None and pin.position is None:
            raise error(("pins", at), "has neither a rotation nor a position", "give one of them, or both")
        if pin.rotation is not None and abs(sum(part * part for part in pin.rotation) - 1.0) > _UNIT:
            raise error(("pins", at, "rotation"), "is no unit quaternion", "give w, x, y and z of length 1")


_UNIT = 1e-3
"""How far the squared length of a quaternion may be from 1: files round."""


def check_points(place: Place, names: tuple[str, str], columns: tuple[tuple[float, ...], tuple[float, ...]],
                 error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` where two columns of a table [M] are empty or differ in length, or the first does not rise."""
    first, second = columns
    if not first or len(first) != len(second):
        raise error((*place, names[1]), f"has {len(second)} entries for {len(first)} {names[0]}",
                    "give as many of both, one at least")
    if any(not a < b for a, b in pairwise(first)):
        raise error((*place, names[0]), "do not rise", "put them in order, each once")
