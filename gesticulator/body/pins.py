"""Pose pins: at one moment a hand, the head or the rotation of a joint is where the plan puts it.

Around the moment the motion keeps its manner: a difference is added to it, which rises and fades within `REACH`. With
p(t) the path of a hand and g its place at the time b of the pin,

    p'(t) = p(t) + w(t) (g - p(b)),   w = 6 s^5 - 15 s^4 + 10 s^3,   s = 1 - |t - b| / REACH

and with p(t) in place of p(b) for a pin that holds, so that the hand comes to a stop and is still while it does.
Between two pins of a joint that are nearer than 2 REACH the difference goes from the one to the other. Hands are moved
by turning the whole arm and then bending the elbow in its plane, the head by leaning while the gaze stays.
Frames outside of the ranges are the same bit for bit.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.errors import InputError, shown
from data_module.motion import rotation
from data_module.motion.skeletons import standing
from data_module.types import Array, Motion
from gesticulator.contacts.default_body import cleared
from gesticulator.contacts.lap import is_seated
from gesticulator.contacts.limbs import POLE_OF_ELBOW, BelowShoulder, bend, pose_of, soft, swing, write_turns
from gesticulator.plan.plan import GesturePlan, Place, PosePin

REACH = 0.6
"""Seconds before and after a pin in which the motion differs: a hand half a metre off goes at 1.6 m/s more at most."""
STRETCHED, MOST_STRETCHED = 0.97, 0.995
"""Shares of an arm's length: up to the first a hand can be pinned; the second limits the way to a pin. An elbow that
locks would jump."""
NEAREST, NEAR_SOFT = 0.15, 0.05
"""Smallest distance of a wrist from its shoulder, metres, and metres over which it is approached."""
MOST_LEAN = math.radians(40.0)
"""Largest lean that moves the head: people lean so far while they sit or stand and talk."""
_HEAD_OFF, _CLEARS = 0.03, 0.025
"""Metres by which the head may miss its place, which lies on a curve about the hips; and by which a hand may be moved
out of the body: one on the surface is moved by 0.0125."""
Problem = Callable[[Place, str, str], InputError]
"""Makes the error of a place in the plan."""


@dataclass(frozen=True)
class _Pin:
    """A pin on the frames of a motion: reached in frame `at`, left after frame `until`; number: in the plan."""

    pin: PosePin
    number: int
    at: int
    until: int


def pinned(motion: Motion, plan: GesturePlan) -> Motion:
    """A motion on the default skeleton with the pins of a plan. `InputError` for a place that cannot be reached, with
    the line of the pin if the plan was read from a file."""
    fade, count = max(round(REACH * motion.fps), 1), len(motion)
    pins = [_Pin(pin, number, *(min(round(time * motion.fps), count - 1) for time in (pin.time, pin.time + pin.hold)))
            for number, pin in enumerate(plan.pins)]
    # Pins whose ranges overlap are applied together: the difference of one goes over into that of the next.
    groups: list[list[_Pin]] = []
    for pin in sorted(pins, key=lambda pin: (pin.at, pin.number)):
        if groups and pin.at - max(before.until for before in groups[-1]) < 2 * fade:
            groups[-1].append(pin)
        else:
            groups.append([pin])
    rotations = motion.rotations.copy()
    for group in groups:
        first = max(group[0].at - fade + 1, 0)
        rows = slice(first, min(max(pin.until for pin in group) + fade, count))
        part = replace(motion, rotations=motion.rotations[rows], root_positions=motion.root_positions[rows])
        near = [replace(pin, at=pin.at - first, until=pin.until - first) for pin in group]
        rotations[rows] = _with_pins(part, near, plan.error)
    return replace(motion, rotations=rotations)


def _with_pins(motion: Motion, pins: Sequence[_Pin], error: Problem) -> Array:
    """[T, J, 4] rotations of a motion with its pins."""
    moved = replace(motion, rotations=motion.rotations.copy(), root_positions=standing(motion).root_positions)
    by_joint: dict[int, list[_Pin]] = {}
    for pin in pins:
        if pin.pin.joint not in motion.skeleton.names:
            raise error(("pins", pin.number, "joint"), f"is {shown(pin.pin.joint)}, which the skeleton does not have",
                        f"give one of {', '.join(motion.skeleton.names[:16])}, ...")
        by_joint.setdefault(motion.skeleton.index(pin.pin.joint), []).append(pin)
    share = np.zeros(len(motion))
    for joint, of_joint in sorted(by_joint.items()):  # parents first
        for before, pin in zip(of_joint, of_joint[1:], strict=False):
            if pin.at <= before.until:
                raise error(("pins", pin.number, "time"), f"is {pin.pin.time:g}, when another pin of {pin.pin.joint} "
                            "holds", "give another time, or remove one of the two")
        places = [pin for pin in of_joint if pin.pin.position is not None]
        turns = [pin for pin in of_joint if pin.pin.rotation is not None]
        if places:
            move = _move_head if motion.skeleton.names[joint] == "Head" else _move_hand
            course = _Course(places, motion)
            move(moved, joint, course, error)
            share = np.maximum(share, course.share)
        if turns:
            _turn(moved, joint, _Course(turns, motion))
    if share.any():
        _clear(moved, share, [pin for pin in pins if pin.pin.position is not None and pin.pin.joint != "Head"], error)
    return moved.rotations


class _Course:
    """How strongly the pins of a joint act in the frames of a motion: shares [T] of each pin, and share [T] of all."""

    def __init__(self, pins: Sequence[_Pin], motion: Motion) -> None:
        self.pins, frames = pins, np.arange(len(motion), dtype=np.float64)
        self.shares: list[Array] = []
        fade = max(round(REACH * motion.fps), 1)
        untils = [-math.inf, *(pin.until for pin in pins[:-1])]
        ats = [*(pin.at for pin in pins[1:]), math.inf]
        for pin, before, after in zip(pins, untils, ats, strict=True):
            # Neighbours that are near share the gap: one fades while the other rises.
            rise, fall = (gap if gap < 2 * fade else fade for gap in (pin.at - before, after - pin.until))
            away = np.where(frames < pin.at, (pin.at - frames) / rise, np.maximum(frames - pin.until, 0.0) / fall)
            s = 1.0 - np.minimum(away, 1.0)
            self.shares.append(s * s * s * (s * (6.0 * s - 15.0) + 10.0))
        self.share = np.asarray(np.minimum(np.sum(self.shares, axis=0), 1.0))

    def added(self, path: Array, difference: Callable[[_Pin, Array], Array]) -> Array:
        """[T, 3] the sum of the differences of the pins from a path [T, D]; difference: of a pin from a part of it."""
        # One that is passed differs from the path by as much as it does there: the motion keeps its manner.
        return np.asarray(np.sum([share[:, None] * difference(pin, path if pin.until > pin.at else path[[pin.at]])
                                  for pin, share in zip(self.pins, self.shares, strict=True)], axis=0))


def _limits_hold(share: Array) -> Array:
    """[T] nearly 1 where pins act by `share` [T], falling to 0 at the ends of their range."""
    return np.asarray(1.0 - (1.0 - share) ** 4)


# ----------------------------------------------------------------------------------------------------------- hands

def _moved(path: Array, course: _Course) -> Array:
    """[T, 3] the path of a joint through its pins."""
    return path + course.added(path, lambda pin, there: np.array(pin.pin.position, dtype=np.float64) - there)


def _move_hand(motion: Motion, hand: int, course: _Course, error: Problem) -> None:
    """Move a hand in the rotations of a motion."""
    skeleton, pose = motion.skeleton, pose_of(motion)
    side = skeleton.names[hand].removesuffix("Hand")
    chain = skeleton.index(side + "Arm"), skeleton.index(side + "ForeArm"), hand
    wrist, shoulder = pose.places[side + "Hand"], pose.places[side + "Arm"]
    length = float(sum(np.linalg.norm(skeleton.offsets[joint]) for joint in chain[1:]))
    way = _moved(wrist, course) - shoulder
    far = np.linalg.norm(way, axis=-1)
    for pin in course.pins:
        held = far[pin.at:pin.until + 1]
        if held.max() > STRETCHED * length + 1e-9 or held.min() < NEAREST + NEAR_SOFT - 1e-9:
            raise error(("pins", pin.number, "position"), f"is {held.min():.2f} to {held.max():.2f} m from the "
                        f"{side.lower()} shoulder at {pin.pin.time:.2f} s, and a wrist gets {NEAREST + NEAR_SOFT:.2f} "
                        f"to {STRETCHED * length:.2f} m from it", "give another place")
    near = np.flatnonzero(course.share)
    limited = far[near] + _limits_hold(course.share[near]) * (_limited(far[near], length) - far[near])
    goal = shoulder[near] + way[near] * (limited / np.maximum(far[near], 1e-9))[:, None]
    turns = {skeleton.index(joint): turn[near] for joint, turn in pose.turns.items()}
    # The whole arm turns first, which keeps its manner; only the rest is left to the elbow.
    turned = swing(wrist[near] - shoulder[near], goal - shoulder[near])
    for joint in chain[:2]:
        turns[joint] = turned @ turns[joint]
    bend(turns, BelowShoulder(skeleton, chain[0], shoulder[near]), chain, goal, POLE_OF_ELBOW)
    write_turns(motion.rotations, skeleton, turns, chain[:2], near)


def _limited(far: Array, length: float) -> Array:
    """Distances [T] of a wrist from its shoulder within what an arm can do, without a kink."""
    free, room = STRETCHED * length, (MOST_STRETCHED - STRETCHED) * length
    over = np.maximum(far - free, 0.0)
    return np.minimum(far, free) + room * np.tanh(over / room) + soft(NEAREST - far, NEAR_SOFT)


def _clear(moved: Motion, share: Array, hands: Sequence[_Pin], error: Problem) -> None:
    """Move hands out of the body where a pin has brought them there. share: [T] of all pins."""
    near, free = np.flatnonzero(share), cleared(moved, is_seated(moved))
    changed = np.flatnonzero((free.rotations != moved.rotations).any(axis=(0, 2)))
    if not len(changed):
        return
    wrists, freed = (pose_of(motion).places for motion in (moved, free))
    for pin in hands:
        joint, rows = pin.pin.joint, slice(pin.at, pin.until + 1)
        if np.linalg.norm(wrists[joint][rows] - freed[joint][rows], axis=-1).max() > _CLEARS:
            raise error(("pins", pin.number, "position"), f"is inside the body at {pin.pin.time:.2f} s",
                        "give a place farther ahead")
    keep = _limits_hold(share)[near, None]
    for node in changed:
        old, new = moved.rotations[near, node], free.rotations[near, node]
        new = np.where(np.sum(new * old, axis=-1, keepdims=True) < 0.0, -new, new)
        mixed = rotation.normalise(old + keep * (new - old))
        moved.rotations[near, node] = np.where((new == old).all(axis=-1, keepdims=True), old, mixed)


# ------------------------------------------------------------------------------------------------- head and rotations

def _move_head(motion: Motion, head: int, course: _Course, error: Problem) -> None:
    """Move the head in the rotations of a motion by leaning from the lowest joint of the spine."""
    skeleton, pose = motion.skeleton, pose_of(motion)
    spine, neck = skeleton.index("Spine"), skeleton.parents[head]
    low, path = pose.places["Spine"], pose.places["Head"]
    goal = _moved(path, course)
    lean = swing(path - low, goal - low)
    off = np.linalg.norm(low + np.einsum("tij,tj->ti", lean, path - low) - goal, axis=-1)
    angle = np.linalg.norm(rotation.to_exponential_map(rotation.from_matrix(lean)), axis=-1)
    for pin in course.pins:
        rows = slice(pin.at, pin.until + 1)
        if off[rows].max() > _HEAD_OFF or angle[rows].max() > MOST_LEAN:
            raise error(("pins", pin.number, "position"), f"is out of the head's reach at {pin.pin.time:.2f} s: by "
                        f"leaning it comes within {max(off[rows].max(), 0.01):.2f} m", "give a nearer place")
    near = np.flatnonzero(course.share)
    turns = {skeleton.index(joint): turn[near] for joint, turn in pose.turns.items()}
    # The neck follows the spine, and the head keeps its turn in the world.
    turns[spine], turns[neck] = lean[near] @ turns[spine], lean[near] @ turns[neck]
    write_turns(motion.rotations, skeleton, turns, (spine, head), near)


def _turn(motion: Motion, joint: int, course: _Course) -> None:
    """Turn a joint in the rotations of a motion."""
    path = motion.rotations[:, joint].copy()

    def difference(pin: _Pin, there: Array) -> Array:
        goal = rotation.normalise(np.array(pin.pin.rotation, dtype=np.float64))
        return rotation.to_exponential_map(rotation.multiply(rotation.conjugate(there), goal))

    near = np.flatnonzero(course.share)
    turned = rotation.multiply(path, rotation.from_exponential_map(course.added(path, difference)))[near]
    old = path[near]
    motion.rotations[near, joint] = np.where(np.sum(turned * old, axis=-1, keepdims=True) < 0.0, -turned, turned)
