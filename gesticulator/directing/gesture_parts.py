"""What a script of a named gesture is made of: hands with key poses, repeated movements, and turns of head and trunk.

Directions and places of a hand are (outwards from the body's middle, up, forward); places are metres from its shoulder.
A script is written for its main hand and, where both move, for the other one; a mirrored cue exchanges them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

Vector = tuple[float, float, float]
UP, DOWN, AHEAD, IN = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)
PALM, TIPS = 0.085, 0.165
"""Metres from the wrist to the middle of the palm, and to the tips of straight fingers."""
HEAD: dict[str, Any] = {"faces": True, "preparation": 0.72, "retraction": 1.0}
"""Fields of a `GestureScript` whose hand goes up to the head: a longer way takes more time."""


@dataclass(frozen=True)
class HandKey:
    """A pose of a hand. place: of the part's `point`; fingers, palm: directions in which they point and it faces; time:
    seconds after the apex, or a negative share of the stroke before it (-1: where the stroke begins)."""

    place: Vector
    fingers: Vector
    palm: Vector
    shape: str = "open"
    time: float = 0.0


@dataclass(frozen=True)
class Repeat:
    """A movement that is repeated after the apex. way, circle: metres of its sine and of its cosine part; tilt: degrees
    about the axes of the body, roll: about the fingers; shape: the hand's shape at its far end; rate: hertz; count:
    times; phase: share of a cycle by which it is ahead."""

    way: Vector = (0.0, 0.0, 0.0)
    circle: Vector = (0.0, 0.0, 0.0)
    tilt: Vector = (0.0, 0.0, 0.0)
    roll: float = 0.0
    shape: str = ""
    rate: float = 2.0
    count: float = 2.0
    phase: float = 0.0


@dataclass(frozen=True)
class HandPart:
    """What one hand does. keys: the first where the stroke begins, one at time 0, the rest after it; point: metres from
    the wrist along the fingers of the point that the places tell; touches: it meets the body or the other hand, so that
    its places are kept; lift: degrees by which the elbow is raised."""

    keys: tuple[HandKey, ...]
    point: float = 0.0
    repeat: Repeat | None = None
    touches: bool = False
    lift: float = 0.0

    @property
    def apex(self) -> HandKey:
        """The pose at the apex."""
        return next(key for key in self.keys if key.time == 0.0)


@dataclass(frozen=True)
class GestureScript:
    """A gesture. side: of the main hand; adds: joint -> turn added during the hold, an exponential map in degrees, for
    a main hand on the right; nods: joint -> turn that is repeated, at its far end at the apex, `rate` times a second.
    faces: the head is brought to the pose of `adds`, as a hand touches it. preparation, stroke, hold, retraction:
    seconds; the apex is at the end of the stroke."""

    main: HandPart | None = None
    other: HandPart | None = None
    adds: Mapping[str, Vector] = field(default_factory=dict)
    nods: Mapping[str, Vector] = field(default_factory=dict)
    side: str = "Right"
    rate: float = 1.6
    faces: bool = False
    preparation: float = 0.55
    stroke: float = 0.25
    hold: float = 0.5
    retraction: float = 0.75

    @property
    def hands(self) -> list[HandPart]:
        """What the hands that take part do, the main one first."""
        return [part for part in (self.main, self.other) if part is not None]


# Most strokes keep the hand's direction and shape and only move it, so the start is the apex but for its place.
def hand(place: Vector, fingers: Vector, palm: Vector, shape: str = "open", start: Vector = (0.0, -0.06, -0.05),
         then: tuple[HandKey, ...] = (), before: Mapping[str, Any] = MappingProxyType({}), **more: Any) -> HandPart:
    """A hand that comes to one pose. start: where its stroke begins, metres from `place`; then: poses after it; before:
    fields of the pose at the start that differ; more: fields of `HandPart`."""
    apex = HandKey(place, fingers, palm, shape)
    (x, y, z), (aside, up, ahead) = place, start
    begin = replace(apex, place=(x + aside, y + up, z + ahead), time=-1.0)
    return HandPart((replace(begin, **before), apex, *then), **more)


def gesture(main: HandPart | None = None, other: HandPart | None = None, neck: Vector | None = None,
            head: Vector | None = None, adds: Mapping[str, Vector] = MappingProxyType({}), **more: Any
            ) -> GestureScript:
    """A gesture. neck, head: of `GestureScript.adds`, with the rest of it; more: its other fields."""
    turns = {"Neck": neck, "Head": head, **adds}
    return GestureScript(main, other, {joint: turn for joint, turn in turns.items() if turn is not None}, **more)


def one(*pose: Any, **more: Any) -> GestureScript:
    """A gesture of one hand; the arguments are those of `hand` and of `gesture`."""
    part, script = _parted(pose, more)
    return gesture(part, **script)


def both(*pose: Any, **more: Any) -> GestureScript:
    """A gesture of both hands, one the mirror image of the other; arguments as of `one`."""
    part, script = _parted(pose, more)
    return gesture(part, part, **script)


def one_or_both(*pose: Any, **more: Any) -> tuple[GestureScript, GestureScript]:
    """Two takes of a gesture: of one hand, and of both; arguments as of `one`."""
    return one(*pose, **more), both(*pose, **more)


def in_turn(*pose: Any, **more: Any) -> GestureScript:
    """A gesture in which both hands repeat the same movement, one half a cycle later: one hand is up where the other is
    down. Arguments as of `one`."""
    part, script = _parted(pose, more)
    assert part.repeat is not None
    return gesture(part, replace(part, repeat=replace(part.repeat, phase=part.repeat.phase + 0.5)), **script)


def _parted(pose: tuple[Any, ...], more: Mapping[str, Any]) -> tuple[HandPart, dict[str, Any]]:
    """The hand of these arguments, and those of the script."""
    names = ("then", "before", "point", "repeat", "touches", "lift")
    return hand(*pose, **{name: more[name] for name in names if name in more}), {
        name: value for name, value in more.items() if name not in names}
