"""The scripts of all named gestures: hands with key poses, repeated movements, and turns of head and trunk.

Directions and places of a hand are (outwards from the body's middle, up, forward); places are metres from its shoulder.
A script is written for its main hand and, where both move, for the other one; a mirrored cue exchanges them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from gesticulator.plan.gestures import ALIASES

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
    """What one hand does. keys: where the stroke begins, at the apex, and after it; point: metres from
    the wrist along the fingers of the point that the places tell; touches: it meets the body or the other hand, so that
    its places are kept; lift: degrees by which the elbow is raised."""

    keys: tuple[HandKey, ...]
    point: float = 0.0
    repeat: Repeat | None = None
    touches: bool = False
    lift: float = 0.0


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
    """A gesture in which both hands repeat the same movement, one half a cycle later; arguments as of `one`."""
    part, script = _parted(pose, more)
    assert part.repeat is not None
    return gesture(part, replace(part, repeat=replace(part.repeat, phase=part.repeat.phase + 0.5)), **script)


def _parted(pose: tuple[Any, ...], more: Mapping[str, Any]) -> tuple[HandPart, dict[str, Any]]:
    """The hand of these arguments, and those of the script."""
    names = ("then", "before", "point", "repeat", "touches", "lift")
    return hand(*pose, **{name: more[name] for name in names if name in more}), {
        name: value for name, value in more.items() if name not in names}


# ------------------------------------------------------------------------------------------------- the repertoire

def _stair(at: float, count: int, step: float) -> tuple[HandKey, ...]:
    """The edge of a hand set down further and further along."""
    keys = []
    for number in range(1, count):
        place, begin = at + step * number, 0.42 * (number - 1)
        for time, up, share in ((begin + 0.2, 0.10, 0.6), (begin + 0.38, 0.0, 1.0)):
            keys.append(HandKey((place - step * (1.0 - share), -0.24 + up, 0.36), (-0.1, 0.05, 1.0), IN, "flat", time))
    return tuple(keys)


# A hand, its apex first: place, directions of the fingers and of the palm, shape, where the stroke begins from there.
_TABLE: Mapping[str, GestureScript | tuple[GestureScript, ...]] = {
    # ------------------------------------------------------------------------------------------- pointing
    "point self": (
        one((-0.13, -0.13, 0.135), (-0.9, 0.3, 0.05), (-0.1, 0, -1), "flat", (0.05, -0.02, 0.1), point=PALM,
            touches=True, hold=0.6),
        both((-0.08, -0.13, 0.145), (-0.85, 0.4, 0), (-0.1, 0, -1), "open", (0.06, -0.03, 0.1), point=PALM,
             touches=True, hold=0.6)),
    "point you": (
        one((0, -0.1, 0.45), (-0.1, 0.2, 1), (-0.9, 0.5, 0), "open", (0.02, -0.12, -0.14), hold=0.55),
        both((0.06, -0.12, 0.42), (0.05, 0.2, 1), (-0.9, 0.5, 0), "open", (0, -0.12, -0.14), hold=0.55)),
    "we all": both((-0.08, -0.2, 0.26), (-0.5, 0.1, 0.85), (-0.4, 1, -0.5), "open", (0.3, 0, 0.12),
                   before={"fingers": (0.25, 0.1, 1), "palm": (-1, 0.5, 0)}, stroke=0.55),
    "they over there": one((0.34, -0.1, 0.26), (0.9, 0.15, 0.4), (-0.1, 1, 0.25), "open", (-0.24, 0, 0.05),
                           neck=(0, -8, 0), head=(0, -9, 0), stroke=0.32),
    "point here": one((0, -0.26, 0.36), (-0.1, -1, 0.2), (-0.4, 0, -1), "point", (0, 0.1, 0),
                      repeat=Repeat(circle=(0, 0.06, 0), rate=2.2, count=1), neck=(4, 0, 0), head=(6, 0, 0)),
    "point there": one((0.18, 0.02, 0.45), (0.35, 0.08, 0.95), (-0.2, -1, 0), "point", (-0.06, -0.1, -0.16),
                       neck=(0, -5, 0), head=(0, -6, 0), hold=0.6),
    "point left": one((0.36, 0, 0.28), (0.86, 0.05, 0.5), (-0.1, -1, 0.1), "point", (-0.1, -0.08, 0), neck=(0, -8, 0),
                      head=(0, -10, 0), side="Left"),
    "point right": one((0.36, 0, 0.28), (0.86, 0.05, 0.5), (-0.1, -1, 0.1), "point", (-0.1, -0.08, 0), neck=(0, -8, 0),
                       head=(0, -10, 0)),
    "point up": one((0.08, 0.16, 0.24), (0, 1, 0.12), (-0.5, 0, 1), "point", (0, -0.14, 0.02), neck=(-3, 0, 0),
                    head=(-6, 0, 0), preparation=0.65, hold=0.6, retraction=0.9),
    "point down": one((0.16, -0.42, 0.2), (0.1, -1, 0.2), (-0.3, 0, -1), "point", (0, 0.12, 0.03), neck=(6, -3, 0),
                      head=(8, -3, 0), hold=0.6),
    "point back": one((0.12, 0, 0.14), (0, 1, -0.15), IN, "thumb", (0.02, -0.05, 0.1),
                      repeat=Repeat(circle=(0, 0, 0.05), rate=2.2, count=1)),
    "point ahead": one((-0.02, -0.1, 0.46), (-0.05, 0.05, 1), IN, "flat", (0.04, -0.06, -0.26),
                       before={"fingers": (-0.2, 0.5, 0.8)}, stroke=0.38),
    "look at this": one((0.27, -0.13, 0.34), (0.55, 0.1, 0.85), (-0.25, 1, 0.1), "open", (-0.16, -0.04, -0.04),
                        neck=(2, -6, 0), head=(3, -8, 0), hold=0.8),
    # ------------------------------------------------------------------------------------------- offers, questions
    "open offer": (
        one((0.08, -0.22, 0.38), (0.1, 0.08, 1), (-0.2, 1, -0.1), "open", (-0.02, -0.04, -0.14), hold=0.6),
        both((0.04, -0.22, 0.36), (0.1, 0.08, 1), (-0.2, 1, -0.1), "open", (0, -0.04, -0.14), hold=0.6)),
    "receive": both((-0.02, -0.18, 0.22), (-0.4, 0.1, 0.9), (-0.2, 1, -0.5), "cup", (0.06, -0.02, 0.2), stroke=0.45),
    "palms question": both((0.12, -0.24, 0.33), (0.45, 0.1, 0.9), (0.1, 1, -0.1), "open", (-0.08, -0.05, -0.06),
                           head=(-3, 0, 4), hold=0.7),
    "shrug": (
        both((0.24, -0.24, 0.22), (0.8, 0.15, 0.6), (0.05, 1, 0.15), "open", (-0.08, -0.05, 0), neck=(0, 0, 4),
             head=(0, 0, 7), adds={"LeftShoulder": (0, 0, 15), "RightShoulder": (0, 0, -15)}, hold=0.55),
        both((0.2, -0.16, 0.2), (0.85, 0.45, 0.4), (0.1, 1, 0.35), "open", (-0.06, -0.08, 0.03), neck=(0, 0, -4),
             head=(0, 0, -6), adds={"LeftShoulder": (0, 0, 17), "RightShoulder": (0, 0, -17)})),
    "plea": both((-0.02, -0.16, 0.43), (0, 0.12, 1), (-0.3, 1, 0), "cup", (0.02, -0.04, -0.16), head=(-3, 0, 8),
                 adds={"Spine1": (4, 0, 0), "Spine2": (4, 0, 0)}, hold=0.9),
    "empty hands": both((0.14, -0.34, 0.33), (0.25, -0.25, 0.95), (0, 1, 0.35), "spread", (-0.06, 0.06, -0.03),
                        neck=(3, 0, 0), head=(4, 0, 0), hold=0.8),
    # ------------------------------------------------------------------------------------------- no and stop
    "sweep no": one_or_both((0.24, -0.25, 0.3), (0.15, 0, 1), DOWN, "flat", (-0.36, 0.02, 0.02),
                            before={"fingers": (-0.75, 0, 0.65)}, nods={"Neck": (0, 5, 0), "Head": (0, 8, 0)},
                            stroke=0.4, hold=0.45)[::-1],
    "finger wag no": one((0.1, 0.02, 0.3), (0, 1, 0.1), AHEAD, "point", (0, -0.1, 0), repeat=Repeat((0.05, 0, 0),
                         tilt=(0, 0, -20), rate=2.4, count=3), nods={"Head": (0, 6, 0)}, rate=2.4),
    "cut off": both((0.22, -0.33, 0.27), (0.25, -0.1, 1), DOWN, "flat", (-0.38, 0.02, 0.05),
                    before={"fingers": (-0.75, -0.1, 0.65)}, nods={"Head": (0, 6, 0)}, stroke=0.34, hold=0.45),
    "stop palm": (
        one((0.03, -0.02, 0.38), (0, 1, 0.1), AHEAD, "flat", (0, -0.05, -0.14), hold=0.7),
        both((0.03, -0.04, 0.36), (0, 1, 0.1), AHEAD, "flat", (0, -0.05, -0.14), hold=0.7)),
    "push away": both((0, -0.06, 0.42), (0, 1, 0.2), AHEAD, "open", (0, -0.03, -0.2), neck=(0, 10, 0), head=(2, 14, 0),
                      adds={"Spine2": (-3, 0, 0)}, stroke=0.35),
    "calm down": both((0.06, -0.24, 0.37), (-0.1, 0.2, 1), (0, -1, 0.25), "open", (0, 0.13, 0),
                      repeat=Repeat(circle=(0, 0.1, 0), rate=1.1), stroke=0.4),
    "throw away": one((0.3, -0.12, 0.28), (0.8, -0.25, 0.55), (0.2, -0.8, 0.6), "open", (-0.26, 0.04, -0.06),
                      before={"shape": "fist", "fingers": (-0.5, 0.4, 0.6), "palm": (-0.3, -0.5, -0.8)}, head=(0, 5, 0),
                      stroke=0.28, hold=0.35),
    "shoo": one((0.1, -0.12, 0.38), (0.1, 0.1, 1), (0, -1, 0.1), "open", (0, 0, -0.05),
                before={"fingers": (0.1, -0.9, 0.5)}, repeat=Repeat(tilt=(35, 0, 0), rate=2.6, count=2.5), stroke=0.22),
    "brush off": one((-0.33, 0.035, 0.155), (-0.95, 0, -0.2), (0, -0.9, -0.5), "flat", (0.12, 0.02, 0.06), point=TIPS,
                     touches=True, repeat=Repeat((-0.04, 0, 0), circle=(0, 0.02, 0), rate=1.9), neck=(3, 10, 0),
                     head=(5, 14, 0), preparation=0.7, retraction=1),
    # ------------------------------------------------------------------------------------------- signs
    "wait finger": one((0.1, 0.03, 0.29), (0, 1, 0.1), (-0.2, 0, 1), "point", (0, -0.1, 0), head=(2, 0, 3), hold=0.8),
    "idea finger": one((0.08, 0.14, 0.22), (0, 1, 0.05), (-0.8, 0, 0.6), "point", (0, -0.16, 0), neck=(-3, 0, 0),
                       head=(-5, 0, 0), preparation=0.6, hold=0.6, retraction=0.7),
    "thumbs up": (
        one((0.03, -0.1, 0.36), (-0.45, 0, 0.9), (-1, 0, -0.3), "thumb", (0, -0.05, -0.09), nods={"Head": (4, 0, 0)},
            rate=1.4, hold=0.7),
        both((0.06, -0.1, 0.34), (-0.45, 0, 0.9), (-1, 0, -0.3), "thumb", (0, -0.05, -0.09), hold=0.7)),
    "thumbs down": one((0.08, -0.06, 0.36), (-0.9, -0.1, 0.5), (0.45, 0, 1), "thumb", (0, 0.1, -0.02), lift=60,
                       nods={"Head": (0, 5, 0)}, preparation=0.65, hold=0.7),
    "ok ring": one((0.08, -0.01, 0.31), (-0.15, 1, 0.15), (-0.8, 0, 0.7), "ring", (0, -0.08, -0.03), hold=0.7),
    "zero ring": one((0.08, -0.05, 0.31), (-0.25, 1, 0.15), (-1, -0.2, 0.2), "zero", (0, -0.08, -0.03), hold=0.7),
    "fingers crossed": one((0.1, 0.05, 0.24), (0, 1, 0.1), AHEAD, "crossed", head=(0, 0, 5), hold=0.8),
    "victory v": one((0.12, 0.06, 0.26), (0, 1, 0.1), AHEAD, "victory", hold=0.7),
    "nod": gesture(nods={"Neck": (6, 0, 0), "Head": (9, 0, 0)}, rate=1.9, preparation=0.1, stroke=0.2, hold=0.8,
                   retraction=0.3),
    "head shake": gesture(nods={"Neck": (0, 8, 0), "Head": (0, 12, 0)}, rate=1.5, preparation=0.1, stroke=0.2, hold=1.1,
                          retraction=0.35),
    "so so": one((0.05, -0.16, 0.36), (-0.15, 0, 1), DOWN, "spread", (0, -0.06, -0.08), repeat=Repeat((0.015, 0, 0),
                 roll=28, rate=2.2, count=3), head=(0, 0, 6)),
    "wave hello": one((0.22, 0.22, 0.22), (0.1, 1, 0.05), AHEAD, "spread", (-0.02, -0.1, 0),
                      repeat=Repeat((0.11, -0.02, 0), tilt=(0, 0, -20), count=3), preparation=0.6, retraction=0.7),
    "wave goodbye": one((0.22, 0.2, 0.22), (0.05, 1, 0.1), AHEAD, "open", (-0.02, -0.1, 0),
                        repeat=Repeat(tilt=(28, 0, 0), shape="round", rate=2.4, count=3), head=(0, 0, 4),
                        preparation=0.7, retraction=0.9),
    "beckon": one((0.08, -0.12, 0.36), (-0.1, 0.55, 0.85), (-0.1, 0.8, -0.6), "open", (0, -0.06, 0),
                  repeat=Repeat(circle=(0, 0.05, -0.13), tilt=(-12, 0, 0), shape="round", rate=1.8), head=(-3, 0, 0)),
    "usher": one((0.38, -0.2, 0.22), (0.9, -0.05, 0.45), (-0.2, 1, 0.15), "open", (-0.38, 0.06, 0.1),
                 before={"fingers": (-0.3, 0.1, 0.95), "palm": (-0.4, 0.9, -0.3)}, neck=(2, -6, 0), head=(4, -8, 0),
                 adds={"Spine2": (2, -5, 0)}, stroke=0.55, hold=0.7),
    "hands over heart": both((-0.17, -0.12, 0.145), (-0.8, 0.55, 0.05), (-0.1, 0, -1), "flat", (0.06, -0.04, 0.1),
                             point=PALM, touches=True, neck=(3, 0, 0), head=(5, 0, 4), stroke=0.35, hold=0.9),
    "prayer hands": both((-0.162, -0.17, 0.2), (0, 0.95, 0.3), IN, "flat", (0.1, -0.02, 0), touches=True,
                         neck=(5, 0, 0), head=(6, 0, 0), stroke=0.35, hold=0.9),
    "bow": gesture(neck=(8, 0, 0), head=(10, 0, 0), adds={"Spine": (7, 0, 0), "Spine1": (8, 0, 0), "Spine2": (7, 0, 0)},
                   preparation=0.35, stroke=0.35, hold=0.35, retraction=0.7),
    "clap": both((-0.155, -0.12, 0.29), (-0.15, 0.5, 0.85), IN, "flat", (0.14, 0, 0), touches=True,
                 repeat=Repeat(circle=(0.11, 0, 0), rate=2.7, count=4)),
    "oath hand": one((0.17, 0.04, 0.16), (0, 1, 0.05), AHEAD, "flat", (0, -0.1, 0.02), hold=0.9),
    "salute": one((-0.085, 0.215, 0.115), (-0.85, 0.5, 0.1), (-0.2, -0.75, 0.6), "flat", (0.05, -0.1, 0.1), point=TIPS,
                  touches=True, lift=55, **HEAD, stroke=0.3, hold=0.6),
    "hush finger": one((-0.18, 0.14, 0.15), (-0.05, 1, 0.05), (-0.9, 0, -0.4), "point", (0.03, -0.08, 0.08), point=0.15,
                       touches=True, lift=20, **HEAD, hold=0.8),
    # ------------------------------------------------------------------------------------------- numbers
    "number one": one((0.08, 0, 0.27), (0, 1, 0.12), (-0.1, 0, 1), "point", (0, -0.09, 0), hold=0.7),
    "number two": one((0.08, 0, 0.27), (0, 1, 0.12), (-0.1, 0, 1), "two", (0, -0.09, 0), hold=0.7),
    "number three": one((0.08, 0, 0.27), (0, 1, 0.12), (-0.1, 0, 1), "three", (0, -0.09, 0), hold=0.7),
    "number four": one((0.08, 0, 0.27), (0, 1, 0.12), (-0.1, 0, 1), "four", (0, -0.09, 0), hold=0.7),
    "number five": one((0.08, 0, 0.27), (0, 1, 0.12), (-0.1, 0, 1), "spread", (0, -0.09, 0), hold=0.7),
    "count off": gesture(hand((-0.13, -0.08, 0.36), (-0.7, 0.3, 0.55), (-0.3, -0.7, -0.6), "point", (0.05, 0.05, 0),
                              point=TIPS, touches=True,
                              then=(HandKey((-0.11, -0.03, 0.36), (-0.7, 0.3, 0.55), (-0.3, -0.7, -0.6), "point", 0.22),
                                    HandKey((-0.14, -0.1, 0.38), (-0.7, 0.2, 0.55), (-0.3, -0.7, -0.6), "point", 0.45),
                                    HandKey((-0.11, -0.05, 0.37), (-0.7, 0.2, 0.55), (-0.3, -0.7, -0.6), "point", 0.67),
                                    HandKey((-0.14, -0.12, 0.4), (-0.7, 0.1, 0.55), (-0.3, -0.7, -0.6), "point", 0.9))),
                         hand((-0.13, -0.2, 0.34), (-0.25, 0.75, 0.45), (-0.5, 0.3, -0.7), "spread", touches=True)),
    # ------------------------------------------------------------------------------------------- ideas, things
    "now press": both((0.02, -0.31, 0.35), (-0.1, 0, 1), DOWN, "flat", (0, 0.13, 0), repeat=Repeat(circle=(0, 0.05, 0),
                      rate=2.2, count=1), head=(5, 0, 0), hold=0.55),
    # ------------------------------------------------------------------------------------------- size and shape
    "big spread": both((0.32, -0.1, 0.32), (0.3, 0.35, 0.9), (-1, 0.1, 0.25), "open", (-0.26, -0.04, 0),
                       head=(-3, 0, 0), adds={"Spine2": (-3, 0, 0)}, stroke=0.4, hold=0.7),
    "small pinch": one((0.06, -0.02, 0.33), (-0.45, 0.75, 0.45), (-0.9, -0.5, 0.1), "gap", (0, -0.07, -0.05),
                       neck=(3, 0, 0), head=(3, 0, 5), hold=0.8),
    "tall hand": one((0.26, 0.23, 0.26), (0.1, 0, 1), DOWN, "flat", (0, -0.24, 0.04), neck=(-4, -5, 0),
                     head=(-8, -6, 0), preparation=0.6, stroke=0.5, hold=0.7, retraction=0.9),
    "low hand": one((0.2, -0.4, 0.2), (0.2, -0.1, 1), DOWN, "flat", (0, 0.18, 0.04), neck=(6, -6, 0), head=(9, -7, 0),
                    stroke=0.4, hold=0.7),
    "long stretch": both((0.3, -0.17, 0.3), (-0.1, 0.25, 0.9), (-1, -0.2, 0), "pinch", (-0.42, 0, 0.04), stroke=0.7),
    "narrow": both((-0.13, -0.16, 0.36), (-0.05, 0.1, 1), IN, "flat", (0.22, 0, 0), stroke=0.5, hold=0.6),
    "round shape": both((-0.03, -0.16, 0.33), (-0.45, 0.2, 0.85), (-1, 0, -0.5), "round", (0, 0, -0.04),
                        repeat=Repeat((0, 0.05, 0), circle=(0.05, 0, 0), rate=1, count=1), hold=0.6),
    "box frame": both((-0.03, -0.2, 0.37), (-0.05, 0.1, 1), IN, "flat", (0, 0.12, 0), repeat=Repeat(circle=(0, 0.06, 0),
                      count=1), hold=0.7),
    "flat surface": one_or_both((0.28, -0.22, 0.32), (0.35, 0, 0.95), DOWN, "flat", (-0.4, 0, 0.02),
                                before={"fingers": (-0.6, 0, 0.8)}, stroke=0.6, hold=0.4),
    "surround": both((0.36, -0.06, 0.26), (0.55, 0.3, 0.8), (-1, 0.2, 0.5), "open", (-0.44, 0.16, 0.08),
                     before={"fingers": (-0.3, 0.6, 0.8), "palm": (-0.4, -0.9, 0.2)},
                     then=(HandKey((-0.06, -0.28, 0.36), (-0.3, 0.1, 1), (-0.5, 1, 0), "open", 0.6),), preparation=0.5,
                     stroke=0.45, hold=0.8),
    # ------------------------------------------------------------------------------------------- change
    "increase": one((0.22, 0.06, 0.36), (0.2, 0.35, 0.9), (0.1, -1, 0.3), "flat", (-0.22, -0.36, 0.02),
                    head=(-4, -3, 0), stroke=0.6),
    "decrease": one((0.18, -0.32, 0.32), (0.2, -0.3, 0.95), (0.1, -1, -0.3), "flat", (-0.22, 0.36, 0.04),
                    head=(5, -3, 0), stroke=0.6),
    "up and down": one((-0.02, -0.12, 0.38), (-0.1, 0.1, 1), DOWN, "flat", (-0.1, -0.1, 0),
                       then=(HandKey((0.05, -0.28, 0.38), (0, -0.1, 1), DOWN, "flat", 0.3),
                             HandKey((0.12, -0.12, 0.37), (0.05, 0.1, 1), DOWN, "flat", 0.6),
                             HandKey((0.2, -0.28, 0.36), (0.1, -0.1, 1), DOWN, "flat", 0.9),
                             HandKey((0.27, -0.14, 0.34), (0.15, 0.1, 1), DOWN, "flat", 1.2))),
    "explode": both((0.2, 0.02, 0.33), (0.4, 0.9, 0.4), (-0.3, 0, 1), "spread", (-0.3, -0.16, 0),
                    before={"shape": "fist", "fingers": (-0.3, 0.4, 0.9), "palm": (-0.8, -0.5, 0)}, head=(-4, 0, 0),
                    stroke=0.32),
    "roll hands": in_turn((-0.12, -0.16, 0.34), (-0.9, 0.05, 0.4), (0, -0.3, -1), "relaxed", touches=True,
                          repeat=Repeat((0, 0.075, 0), circle=(0, 0, 0.14), rate=1.7, count=2.5)),
    "turn back": one((0.1, -0.02, 0.32), (-0.2, 0.9, 0.5), (-0.9, 0, 0.3), "point", repeat=Repeat((0, 0.06, 0),
                     circle=(0, 0, -0.13), tilt=(-12, 0, 0), rate=1.5)),
    "quick snap": one((0.14, 0.04, 0.28), (-0.3, 1, 0.35), (-0.8, 0, -0.3), "point", (0, -0.04, -0.02),
                      before={"shape": "snap"}, nods={"Head": (4, 0, 0)}, stroke=0.16),
    # ------------------------------------------------------------------------------------------- together, apart
    "join hands": both((-0.155, -0.2, 0.3), (-0.55, 0.1, 0.8), (-1, 0, -0.3), "cup", (0.3, 0.03, 0), touches=True,
                       stroke=0.5, hold=0.6),
    "interlock": gesture(hand((-0.16, -0.18, 0.34), (-1, 0.3, 0.35), (0.2, 0.2, -1), "claw", (0.2, 0.02, 0), point=PALM,
                              touches=True),
                         hand((-0.16, -0.18, 0.3), (-1, 0.3, 0.35), (0.2, 0.2, -1), "claw", (0.2, 0.02, 0), point=PALM,
                              touches=True),
                         stroke=0.4, hold=0.8),
    "split apart": both((0.2, -0.2, 0.33), (0.1, 0.1, 1), (1, 0.1, 0), "flat", (-0.34, 0, -0.01),
                        before={"fingers": (-0.1, 0.1, 1)}, stroke=0.35),
    "weigh options": in_turn((0.1, -0.24, 0.35), (0.1, 0.05, 1), UP, "cup", repeat=Repeat((0, 0.085, 0), rate=1),
                             head=(3, 0, 5)),
    "contrast flip": one((0.26, -0.22, 0.32), (0.5, 0.05, 0.9), UP, "open", (-0.2, 0.03, 0.02),
                         before={"fingers": (-0.3, 0, 1), "palm": DOWN}, neck=(0, 0, -4), head=(0, -3, -7),
                         stroke=0.36),
    "add beside": one((0.22, -0.24, 0.34), (0.1, 0.05, 1), IN, "flat", (-0.14, 0.1, 0), head=(3, -5, 0), stroke=0.34,
                      hold=0.6),
    "exchange": gesture(hand((-0.05, -0.18, 0.32), (-0.5, 0, 0.9), UP, "flat", touches=True, repeat=Repeat((0, 0, 0.09),
                             circle=(0, 0.06, 0), rate=1.2)),
                        hand((-0.05, -0.18, 0.32), (-0.5, 0, 0.9), DOWN, "flat", touches=True,
                             repeat=Repeat((0, 0, 0.09), circle=(0, -0.06, 0), rate=1.2, phase=0.5))),
    "equal level": both((0.08, -0.14, 0.36), (-0.1, 0, 1), DOWN, "flat", (0, 0.05, -0.06),
                        repeat=Repeat(circle=(0, -0.04, 0), count=1), hold=0.8),
    "step by step": one((-0.1, -0.24, 0.36), (-0.1, 0.05, 1.0), IN, "flat", (0.0, 0.12, 0.0),
                        then=_stair(-0.10, 4, 0.12)),
    # ------------------------------------------------------------------------------------------- stress
    "chop point": (
        one((0.04, -0.26, 0.37), (-0.1, 0.05, 1), IN, "flat", (0, 0.19, -0.05), before={"fingers": (-0.1, 0.7, 0.7)},
            nods={"Head": (5, 0, 0)}, stroke=0.255),
        both((0.02, -0.26, 0.37), (-0.1, 0.05, 1), IN, "flat", (0, 0.19, -0.05), before={"fingers": (-0.1, 0.7, 0.7)},
             nods={"Head": (5, 0, 0)}, stroke=0.255)),
    "precision pinch": one((0.03, -0.1, 0.36), (-0.3, 0.6, 0.8), (-0.5, -0.4, 0.7), "pinch", (0, 0.08, -0.02),
                           repeat=Repeat(circle=(0, 0.05, 0), rate=2.2), head=(4, 0, 0), hold=0.6),
    "purse hand": one((0.05, -0.12, 0.33), (-0.1, 1, 0.1), (-0.2, 0, -1), "bunch", (0, -0.08, 0),
                      repeat=Repeat(circle=(0, 0.05, -0.03), tilt=(-10, 0, 0), rate=2.4, count=3)),
    "air quotes": both((0.13, 0.04, 0.28), (-0.05, 1, 0.12), AHEAD, "quotes", (0, -0.1, 0),
                       repeat=Repeat(circle=(0, -0.015, 0), shape="hooked", rate=2.5), head=(3, 0, 4), hold=0.9),
    # ------------------------------------------------------------------------------------------- feelings
    "cheer arms": both((0.16, 0.34, 0.14), (0.2, 1, 0), (-0.3, 0, 1), "fist", (0, -0.2, 0.06),
                       repeat=Repeat(circle=(0.02, -0.12, 0.04), rate=2.2, count=1.5), head=(-8, 0, 0),
                       preparation=0.85, stroke=0.35, hold=0.7, retraction=1),
    "fist pump": one((0.1, -0.17, 0.24), (-0.15, 0.8, 0.5), (-0.5, 0.2, -0.9), "fist", (-0.02, 0.14, 0.16),
                     nods={"Head": (5, 0, 0)}, hold=0.6),
    "fist resolve": one((0.04, -0.05, 0.3), (-0.05, 1, 0.15), (-0.8, 0, -0.6), "fist", (0, -0.1, 0.04),
                        repeat=Repeat(circle=(0, -0.05, 0.03), rate=2.2), head=(4, 0, 0), hold=0.7),
    "flex arm": one((0.26, 0.24, 0.03), (-0.35, 1, 0), (-1, -0.2, 0), "fist", (0.08, -0.12, 0.06), lift=80,
                    neck=(0, -8, 0), head=(0, -12, 0), preparation=0.75, hold=0.9, retraction=1),
    "hug self": gesture(hand((-0.27, -0.1, 0.15), (-1, 0.25, -0.05), (0, 0, -1), "open", (0.16, 0, 0.12), point=PALM,
                             touches=True),
                        hand((-0.27, -0.18, 0.17), (-1, 0.25, -0.05), (0, 0, -1), "open", (0.16, 0, 0.12), point=PALM,
                             touches=True),
                        neck=(3, 0, 4), head=(6, 0, 8), adds={"LeftShoulder": (0, 0, 6), "RightShoulder": (0, 0, -6)},
                        preparation=0.6, stroke=0.4, hold=0.9),
    "heart hands": both((-0.1, -0.06, 0.28), (-0.62, 0.8, 0.1), (-0.8, -0.6, 0.2), "heart", (0.1, -0.02, 0),
                        touches=True, head=(0, 0, 6), stroke=0.4, hold=1),
    "arms crossed": gesture(hand((-0.24, -0.24, 0.2), (-1, 0.15, -0.05), (0, -0.4, -1), "relaxed", (0.14, 0, 0.1),
                                 point=PALM, touches=True),
                            hand((-0.22, -0.26, 0.24), (-1, 0.1, -0.05), (0, -0.4, -1), "fist", (0.14, 0, 0.1),
                                 point=PALM, touches=True),
                            preparation=0.6, stroke=0.45, hold=1.2, retraction=0.7),
    "hands on hips": both((0.02, -0.44, 0.05), (-0.45, -0.55, 0.65), (-0.8, -0.1, -0.6), "open", (0.1, 0.05, 0.04),
                          point=0.04, touches=True, lift=70, preparation=0.6, stroke=0.35, hold=1.1),
    "rub hands": in_turn((-0.155, -0.2, 0.27), (-0.25, 0.2, 0.95), IN, "flat", (0.1, 0, 0), touches=True,
                         repeat=Repeat((0, 0, 0.045), rate=2.6, count=3.5)),
    "facepalm": one((-0.17, 0.2, 0.185), (-0.35, 0.9, -0.15), (-0.15, -0.2, -1), "open", (0.02, -0.1, 0.1), point=PALM,
                    touches=True, neck=(8, 0, 0), head=(12, 0, 0), **HEAD, hold=0.9),
    # ------------------------------------------------------------------------------------------- the head
    "chin think": one((-0.155, 0.065, 0.135), (-0.5, 0.85, -0.1), (-0.6, 0.2, -0.8), "pen", (0.03, -0.08, 0.08),
                      point=0.1, touches=True, head=(2, 5, 5), **HEAD, hold=1.2),
    "head scratch": one((-0.09, 0.27, 0.03), (-0.75, 0.6, -0.15), (-0.75, -0.6, 0), "claw", (0.06, -0.1, 0.1),
                        point=0.14, touches=True, lift=45, repeat=Repeat((0, 0.015, 0.012), rate=3.2, count=3),
                        head=(5, 0, 6), **HEAD),
    "tap temple": one((-0.09, 0.235, 0.075), (-0.72, 0.7, -0.05), (-0.5, -0.4, -0.7), "point", (0.05, -0.04, 0.05),
                      point=TIPS, touches=True, lift=25, repeat=Repeat(circle=(0.035, 0, 0.01), rate=2.8), **HEAD,
                      hold=0.8),
    "crazy circle": one((-0.05, 0.215, 0.08), (-0.7, 0.72, -0.05), (-0.5, -0.4, -0.7), "point", (0.04, -0.05, 0.04),
                        point=TIPS, touches=True, lift=25, repeat=Repeat((0, 0.03, 0), circle=(0, 0, 0.06), rate=1.7,
                        count=2.5), **HEAD),
    "hand to ear": one((-0.05, 0.2, 0.08), (-0.25, 1, -0.1), (-0.5, 0, 0.85), "cup", (0.06, -0.08, 0.06), point=PALM,
                       touches=True, neck=(0, 8, 0), head=(2, 10, -5), adds={"Spine2": (4, 0, 0)}, **HEAD, hold=1),
    "zip lips": one((-0.15, 0.12, 0.155), (-0.7, 0.5, -0.4), (-0.4, -0.3, -0.9), "pinch", (-0.065, 0, 0), point=0.12,
                    touches=True, lift=25, **HEAD, stroke=0.5),
    "phone hand": one((-0.075, 0.14, 0.11), (-0.3, 0.9, 0.25), (-0.95, -0.2, 0.1), "phone", (0.06, -0.08, 0.06),
                      point=0.06, touches=True, head=(0, 0, 6), **HEAD, hold=1),
    "eat drink": one((-0.09, 0.055, 0.22), (-0.75, 0.3, -0.1), (-0.6, 0.1, -0.8), "round", (0.03, -0.12, 0.08),
                     point=0.06, touches=True, lift=30, head=(-9, 0, 0), **HEAD, stroke=0.4, hold=0.7),
    "sleep cheek": gesture(hand((-0.105, 0.13, 0.12), (-0.3, 1, -0.1), (-0.95, -0.3, -0.1), "flat", (0.05, -0.06, 0.06),
                                point=PALM, touches=True),
                           hand((-0.235, 0.1, 0.14), (-0.55, 1, -0.15), (-0.9, 0.2, -0.4), "flat", (0.03, -0.1, 0.06),
                                point=PALM, touches=True),
                           neck=(0, 0, -9), head=(3, 0, -14), **HEAD, stroke=0.35, hold=1.1),
    # ------------------------------------------------------------------------------------------- objects, actions
    "check watch": gesture(hand((-0.15, -0.12, 0.3), (-0.8, -0.2, 0.3), (0.1, -0.9, -0.4), "point", (0.02, 0.07, 0),
                                point=TIPS, touches=True, repeat=Repeat(circle=(0, 0.05, 0), rate=2.4)),
                           hand((-0.16, -0.16, 0.29), (-1, 0.05, 0.15), (0, -0.8, -0.6), "fist", (0, -0.04, 0.04),
                                touches=True, lift=20),
                           neck=(7, 4, 0), head=(10, 5, 0), hold=0.9),
    "typing": in_turn((-0.04, -0.29, 0.33), (-0.25, -0.1, 1), DOWN, "keys", (0, 0.05, 0), repeat=Repeat((0, 0.012, 0),
                      shape="round", rate=4, count=5), neck=(4, 0, 0), head=(6, 0, 0)),
    "write air": one((-0.02, -0.08, 0.37), (-0.35, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", (-0.08, 0, 0),
                     then=(HandKey((0.03, -0.06, 0.37), (-0.35, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", 0.3),
                           HandKey((0.09, -0.09, 0.36), (-0.3, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", 0.6),
                           HandKey((0.16, -0.07, 0.35), (-0.2, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", 0.9)),
                     repeat=Repeat((0, 0.028, 0), rate=3.2, count=3)),
    "money rub": one((0.06, -0.04, 0.32), (-0.2, 0.8, 0.6), (-0.3, 0.5, -0.75), "pinch", (0, -0.06, -0.03),
                     repeat=Repeat(shape="snap", rate=3, count=4)),
    "drive wheel": in_turn((-0.01, -0.12, 0.38), (-0.2, 0.75, 0.6), (-0.7, -0.2, 0.7), "fist", (0, -0.05, -0.08),
                           repeat=Repeat((0, 0.09, 0), rate=1.1)),
    "open door": both((0.24, -0.12, 0.35), (0.3, 0.5, 0.8), (0.4, 0, 1), "flat", (-0.36, 0, 0.03),
                      before={"fingers": (-0.15, 0.9, 0.4), "palm": (0.1, 0, 1)}, stroke=0.5),
    "close lid": gesture(hand((-0.14, -0.2, 0.32), (-0.85, 0, 0.5), DOWN, "flat", (0, 0.2, 0), point=PALM,
                              touches=True),
                         hand((-0.16, -0.235, 0.32), (-0.85, 0, 0.5), UP, "flat", (0, -0.02, 0), point=PALM,
                              touches=True),
                         stroke=0.35, hold=0.6),
}
SCRIPTS = {name: takes if isinstance(takes, tuple) else (takes,) for name, takes in _TABLE.items()}
SCRIPTS |= {alias: SCRIPTS[name] for alias, name in ALIASES.items()}
"""Name of a gesture -> its takes, of which a draw chooses one."""
