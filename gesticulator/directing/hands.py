"""The hand of a named gesture: inverse kinematics of the arm that carries it, and the shapes of its fingers.

Everything is computed for the left side; the right one is its mirror image. The upper arm can swing about the line from
shoulder to wrist, which leaves the hand where it is: that angle is chosen so that neither the forearm nor the wrist has
to turn further than a person's. A shape, such as "fist" or "victory", is a curl of each finger, from 0 (straight) to 1
(in a fist), a spread between the fingers, and three angles of the thumb.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER, FINGERED, FINGERS
from data_module.types import Array

_STRETCHED = 0.97
"""Greatest distance of a hand from the shoulder, as a share of the arm's length: an elbow that locks would jump."""
_NEAREST = 0.15
"""Smallest distance of a hand from the shoulder, metres: there the elbow is closed by 147 degrees."""
_PRONATES = 0.6
"""Share of the hand's twist that the forearm takes over, as pronation does in a human forearm."""
MOST_BEND, MOST_TWIST = math.radians(62.0), math.radians(88.0)
"""Greatest bend of the wrist, and greatest twist of forearm and wrist to both sides of a thumb that points up."""
_ELBOW = np.array([0.45, -1.0, -0.25])
"""Direction in which the elbow of a left arm points: down, a little outwards and back."""
_SWINGS = np.radians(np.arange(-40.0, 126.0, 5.0))
"""Angles of the elbow that are tried: from a little inwards to well above the horizontal."""
BONE = np.array([1.0, 0.0, 0.0])
_PALM = np.array([0.0, -1.0, 0.0])
_HINGE = np.array([0.0, -math.cos(math.radians(12.0)), -math.sin(math.radians(12.0))])
"""Axis of the elbow of a level arm: bending moves the forearm forward and a little up."""
_UPPER, _FORE = (float(CHARACTER.offsets[CHARACTER.index("Left" + part)][0]) for part in ("ForeArm", "Hand"))


def hand_rotation(fingers: Array, palm: Array) -> Array:
    """[..., 4] the rotations of a left hand whose fingers point and whose palm faces in two directions [..., 3]; the
    palm gives way where they are not at right angles."""
    along = fingers / np.linalg.norm(fingers, axis=-1, keepdims=True)
    across = palm - np.sum(palm * along, axis=-1, keepdims=True) * along
    return rotation.from_axes((BONE, _PALM), along, across / np.linalg.norm(across, axis=-1, keepdims=True))


def arm_turns(places: Array, hand: Array, swings: Array) -> tuple[Array, Array, Array]:
    """Exponential maps [M, 3] of upper arm, forearm and hand of a left arm. places: [M, 3] of the wrist from the
    shoulder, metres; hand: [M, 4] in the frame of the chest; swings: [M] radians of the elbow, outwards and
    up from where it hangs."""
    arm, forearm = _bones(places, swings)
    twist, bend = _wrist(forearm, hand)
    # A person twists the hand mostly by turning the forearm; the mesh would wring at the wrist otherwise.
    turned = rotation.from_exponential_map(_PRONATES * twist[:, None] * BONE)
    length = np.linalg.norm(bend, axis=-1, keepdims=True)
    bend = rotation.from_exponential_map(bend * (_eased(length, MOST_BEND) / np.maximum(length, 1e-9)))
    left = rotation.multiply(rotation.from_exponential_map((1.0 - _PRONATES) * twist[:, None] * BONE), bend)
    fore = rotation.multiply(rotation.multiply(rotation.conjugate(arm), forearm), turned)
    return rotation.to_exponential_map(arm), rotation.to_exponential_map(fore), rotation.to_exponential_map(left)


def best_swing(place: Array, hand: Array, lift: float = 0.0) -> float:
    """The swing of the elbow, radians, at which forearm and wrist turn within a person's range and the elbow hangs.
    place: [3] of the wrist from the shoulder; hand: [4] its rotation; lift: the swing that is preferred, radians."""
    _, forearm = _bones(np.repeat(place[None], len(_SWINGS), axis=0), _SWINGS)
    twist, bend = _wrist(forearm, hand)
    over = np.maximum(np.abs(twist) - math.radians(75.0), 0.0)
    angle = np.linalg.norm(bend, axis=-1)
    # Radians squared. Twist beyond 75 degrees is forbidden almost, a bent wrist is unpleasant from .9 rad on, and
    # among what is left the elbow hangs.
    cost = 12.0 * over ** 2 + 1.2 * angle ** 2 + 9.0 * np.maximum(angle - 0.9, 0.0) ** 2 + 0.5 * (_SWINGS - lift) ** 2
    return float(_SWINGS[int(np.argmin(cost))])


def _bones(places: Array, swings: Array) -> tuple[Array, Array]:
    """[M, 4] world rotations of upper arm and untwisted forearm."""
    # The triangle of upper arm, forearm and the line to the wrist; beyond its reach the hand stops short.
    length = np.linalg.norm(places, axis=-1, keepdims=True)
    far = np.clip(length, _NEAREST, _STRETCHED * (_UPPER + _FORE))
    along = places / np.maximum(length, 1e-9)
    share = (_UPPER ** 2 + far ** 2 - _FORE ** 2) / (2.0 * far)
    down = _ELBOW - np.sum(_ELBOW * along, axis=-1, keepdims=True) * along
    down = down / np.linalg.norm(down, axis=-1, keepdims=True)
    out = np.cross(along, down)
    aside = np.cos(swings)[:, None] * down + np.sin(swings)[:, None] * out
    elbow = share * along + np.sqrt(np.maximum(_UPPER ** 2 - share ** 2, 1e-6)) * aside
    first, second = elbow / _UPPER, (along * far - elbow) / _FORE
    axis = np.cross(first, second)
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
    return rotation.from_axes((BONE, _HINGE), first, axis), rotation.from_axes((BONE, _HINGE), second, axis)


def _wrist(forearm: Array, hand: Array) -> tuple[Array, Array]:
    """[M] twist of a hand about its forearm, radians from -pi to pi, and [M, 3] the bend that is left after it."""
    wrist = rotation.multiply(rotation.conjugate(forearm), hand)
    twist = rotation.to_exponential_map(rotation.yaw_of(wrist, axis=0))[:, 0]
    # The exponential map of a yaw may be the long way round.
    twist = (twist + np.pi) % (2.0 * np.pi) - np.pi
    back = rotation.from_exponential_map(-twist[:, None] * BONE)
    return _eased(twist, MOST_TWIST), rotation.to_exponential_map(rotation.multiply(back, wrist))


def _eased(angles: Array, most: float) -> Array:
    """Angles that approach a limit smoothly from four fifths of it on: a hard limit would jerk."""
    # The slope is 1 where the limit begins to be felt, so the angle's speed has no step.
    free = 0.8 * most
    over = np.maximum(np.abs(angles) - free, 0.0)
    eased: Array = np.sign(angles) * (np.minimum(np.abs(angles), free) + (most - free) * np.tanh(over / (most - free)))
    return eased


# ---------------------------------------------------------------------------------------------------------- fingers

_FULL = {"Thumb": (8.0, 34.0, 40.0), "Index": (72.0, 92.0, 55.0), "Middle": (74.0, 94.0, 56.0),
         "Ring": (76.0, 94.0, 56.0), "Pinky": (76.0, 92.0, 54.0)}
"""Bends of the joints of a closed finger, from the knuckle on, degrees."""
_SIDE = {"Index": -1.0, "Middle": -0.25, "Ring": 0.4, "Pinky": 1.15}
"""Share of the spread by which a finger turns away from the middle of the hand."""
_UNDER_PALM = np.array([0.75, -0.55, -0.35])
"""Direction towards which a thumb bends."""


@dataclass(frozen=True)
class HandShape:
    """A shape. curls: of index, middle, ring and little finger, 0 to 1; spread: degrees between neighbours; thumb: its
    curl (0 to 1), degrees away from the fingers, and degrees under the palm; knuckles: share of a curl that the
    knuckles take part in (0: only the outer joints bend, as in quotes)."""

    curls: tuple[float, float, float, float] = (0.1, 0.12, 0.15, 0.17)
    spread: float = 3.0
    thumb: tuple[float, float, float] = (0.1, 5.0, 0.0)
    knuckles: float = 1.0


_FOLDED = (0.75, -8.0, 55.0)
"""A thumb across the palm."""
SHAPES: dict[str, HandShape] = {
    "relaxed": HandShape((0.2, 0.24, 0.28, 0.3)),
    "open": HandShape((0.04, 0.05, 0.07, 0.08), 5.0, (0.0, 14.0, 0.0)),
    "flat": HandShape((0.02, 0.02, 0.02, 0.03), 0.5, (0.15, -12.0, 5.0)),
    "spread": HandShape((0.0, 0.0, 0.0, 0.0), 13.0, (0.0, 30.0, 0.0)),
    "fist": HandShape((1.0, 1.0, 1.0, 1.0), 0.0, (0.8, -10.0, 60.0)),
    "point": HandShape((0.0, 1.0, 1.0, 1.0), 0.0, (0.8, -10.0, 60.0)),
    "two": HandShape((0.0, 0.0, 1.0, 1.0), 4.0, _FOLDED),
    "victory": HandShape((0.0, 0.0, 1.0, 1.0), 16.0, _FOLDED),
    "three": HandShape((0.0, 0.0, 0.0, 1.0), 9.0, _FOLDED),
    "four": HandShape((0.0, 0.0, 0.0, 0.0), 9.0, (0.9, -25.0, 75.0)),
    "thumb": HandShape((1.0, 1.0, 1.0, 1.0), 0.0, (0.0, 42.0, 0.0)),
    "phone": HandShape((1.0, 1.0, 1.0, 0.0), 6.0, (0.0, 42.0, 0.0)),
    "crossed": HandShape((0.08, 0.12, 1.0, 1.0), -11.0, _FOLDED),
    "pinch": HandShape((0.52, 0.85, 0.95, 1.0), 0.0, (0.25, -4.0, 42.0)),
    "gap": HandShape((0.42, 0.85, 0.95, 1.0), 0.0, (0.16, 8.0, 38.0)),
    "ring": HandShape((0.56, 0.2, 0.1, 0.03), 9.0, (0.28, -4.0, 44.0)),
    "zero": HandShape((0.55, 0.52, 0.52, 0.54), 0.0, (0.35, 0.0, 42.0)),
    "bunch": HandShape((0.5, 0.5, 0.52, 0.55), -3.0, (0.25, -10.0, 48.0)),
    "round": HandShape((0.34, 0.34, 0.34, 0.34), 7.0, (0.2, 24.0, 35.0)),
    "claw": HandShape((0.45, 0.45, 0.45, 0.45), 11.0, (0.3, 25.0, 25.0), 0.3),
    "cup": HandShape((0.25, 0.25, 0.27, 0.3), 0.0, (0.2, -5.0, 10.0)),
    "quotes": HandShape((0.12, 0.12, 1.0, 1.0), 8.0, _FOLDED),
    "hooked": HandShape((0.75, 0.75, 1.0, 1.0), 6.0, _FOLDED, 0.5),
    "heart": HandShape((0.5, 0.5, 0.52, 0.55), 0.0, (0.0, 10.0, 20.0)),
    "pen": HandShape((0.48, 0.6, 0.85, 0.95), 0.0, (0.3, -4.0, 40.0)),
    "snap": HandShape((0.35, 0.62, 0.9, 0.95), 0.0, (0.3, -12.0, 44.0)),
    "keys": HandShape((0.22, 0.24, 0.26, 0.28), 6.0, (0.1, 8.0, 20.0)),
}


@functools.cache
def finger_turns(shape: str) -> Array:
    """[15, 3] exponential maps, radians, of the joints of a left hand in a shape, in the order of `FINGERS`."""
    hand = SHAPES[shape]
    rows = []
    for finger in FINGERS:
        thumb = finger == "Thumb"
        curl = hand.thumb[0] if thumb else hand.curls[FINGERS.index(finger) - 1]
        # At rest the palm faces down and the fingers of a left hand point left.
        axis = np.cross(FINGERED.offsets[FINGERED.index(f"LeftHand{finger}2")], _UNDER_PALM if thumb else _PALM)
        for place, degrees in enumerate(_FULL[finger]):
            # Joints bend about the finger's axis; the knuckle also spreads, and the thumb's root turns twice.
            share = curl * (hand.knuckles if place == 0 else 1.0)
            turn = share * degrees * (axis / np.linalg.norm(axis))
            if place == 0:
                turn = turn + (np.array([hand.thumb[2], -hand.thumb[1], 0.0]) if thumb
                               else np.array([0.0, hand.spread * _SIDE[finger], 0.0]))
            rows.append(np.radians(turn))
    return np.array(rows)
