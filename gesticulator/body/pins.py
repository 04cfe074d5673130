"""Pose pins: at one moment a hand, the head or the rotation of a joint is where the plan puts it.

Around the moment the motion keeps its manner: a difference is added to it, which rises and fades within `REACH`. With
p(t) the path of a hand and g its place at the time b of the pin,

    p'(t) = p(t) + w(t) (g - p(c(t))),   w = 6 s^5 - 15 s^4 + 10 s^3,   s = 1 - |t - b| / REACH

where c(t) = b for a pin that is passed; a pin that holds has c(t) = t while it does, so that the hand is still, and c
slows down to a stop within `STOPS` on both sides. Between two pins of a joint that are nearer than 2 REACH the
difference goes from the one to the other. Hands are moved by turning the whole arm and then bending the elbow in its
plane, the head by bending the spine while the gaze stays. Frames outside of the ranges are the same bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from data_module.errors import InputError, shown
from data_module.motion import rotation
from data_module.motion.skeletons import standing
from data_module.types import Array, Motion, Skeleton
from gesticulator.contacts.default_body import cleared
from gesticulator.contacts.limbs import BelowShoulder, bend, pose_of, soft, swing
from gesticulator.plan.plan import GesturePlan, Place, PosePin

REACH = 0.6
"""Seconds before and after a pin in which the motion differs: a hand half a metre off goes at 1.6 m/s more at most."""
STOPS = 0.2
"""Seconds in which a hand stops for a pin that holds: a gesture's hand of 1 m/s slows by 5 m/s^2."""
STRETCHED, MOST_STRETCHED = 0.97, 0.995
"""Shares of an arm's length: up to the first a hand can be pinned; the second limits the way to a pin. An elbow that
locks would jump."""
NEAREST, NEAR_SOFT = 0.15, 0.05
"""Smallest distance of a wrist from its shoulder, metres, and metres over which it is approached."""
MOST_LEAN = math.radians(40.0)
"""Largest bend of the spine that moves the head: people lean so far while they sit or stand and talk."""
_HEAD_OFF, _CLEARS = 0.03, 0.025
"""Metres by which the head may miss its place, which lies on a curve about the hips; and by which a hand may be moved
out of the body: one on the surface is moved by 0.0125."""
_SPINE = ("Spine", "Spine1", "Spine2", "Spine3")
_ITERATIONS, _GAIN = 10, 1.3
"""Of the bend of the spine: the head turns about points that are a quarter nearer than the lowest joint."""
_POLE_OF_ELBOW = np.array([0.0, -1.0, -0.5])
"""Direction to which the elbow of a straight arm bends."""
Problem = Callable[[Place, str, str], InputError]


@dataclass(frozen=True)
class PlacedPin:
    """A pin on the frames of a motion: it is reached in frame `at`, and left after frame `until`; number: in the
    plan."""

    pin: PosePin
    number: int = field(compare=False)
    at: int
    until: int


@dataclass(frozen=True)
class PinGroup:
    """Pins whose ranges overlap, and the frames `first` to `last` - 1 that they change. fade: frames of `REACH`; stop:
    frames of `STOPS`; error: makes the error of a place in the plan."""

    pins: tuple[PlacedPin, ...]
    first: int
    last: int
    fade: int
    stop: int
    error: Problem = field(compare=False, repr=False)


def pin_groups(plan: GesturePlan, fps: float, count: int) -> tuple[PinGroup, ...]:
    """The pins of a plan on `count` frames, in groups that do not overlap, by their times."""
    fade, stop = max(round(REACH * fps), 1), max(round(STOPS * fps), 1)
    placed = [PlacedPin(pin, number, *(min(round(time * fps), count - 1) for time in (pin.time, pin.time + pin.hold)))
              for number, pin in enumerate(plan.pins)]
    groups: list[list[PlacedPin]] = []
    for pin in sorted(placed, key=lambda one: (one.at, one.number)):
        if groups and pin.at - max(one.until for one in groups[-1]) < 2 * fade:
            groups[-1].append(pin)
        else:
            groups.append([pin])
    return tuple(PinGroup(tuple(pins), max(pins[0].at - fade + 1, 0), min(max(one.until for one in pins) + fade, count),
                          fade, stop, plan.error) for pins in groups)


def pinned(motion: Motion, plan: GesturePlan) -> Motion:
    """A motion on the default skeleton with the pins of a plan. `InputError` for a place that cannot be reached, with
    the line of the pin if the plan was read from a file."""
    rotations = motion.rotations.copy()
    for group in pin_groups(plan, motion.fps, len(motion)):
        rows = slice(group.first, group.last)
        rotations[rows] = with_group(replace(motion, rotations=motion.rotations[rows],
                                             root_positions=motion.root_positions[rows]), group).rotations
    return replace(motion, rotations=rotations)


def with_group(motion: Motion, group: PinGroup) -> Motion:
    """The frames of a group with its pins."""
    lift = standing(motion).root_positions
    made = replace(motion, rotations=motion.rotations.copy(), root_positions=lift)
    by_joint: dict[int, list[PlacedPin]] = {}
    for pin in group.pins:
        by_joint.setdefault(_joint(motion.skeleton, pin, group.error), []).append(pin)
    share = np.zeros(len(motion))
    for joint in sorted(by_joint):  # parents first
        _check_apart(by_joint[joint], group)
        places = [pin for pin in by_joint[joint] if pin.pin.position is not None]
        turns = [pin for pin in by_joint[joint] if pin.pin.rotation is not None]
        if places:
            move = _move_head if motion.skeleton.names[joint] == "Head" else _move_hand
            course = _Course(places, group)
            move(made, joint, course, group.error)
            share = np.maximum(share, course.share)
        if turns:
            _turn(made, joint, _Course(turns, group))
    _clear(made, motion, share, group)
    return replace(made, root_positions=motion.root_positions)


def _joint(skeleton: Skeleton, pin: PlacedPin, error: Problem) -> int:
    if pin.pin.joint not in skeleton.names:
        raise error(("pins", pin.number, "joint"), f"is {shown(pin.pin.joint)}, which the skeleton does not have",
                    f"give one of {', '.join(skeleton.names[:16])}, ...")
    return skeleton.index(pin.pin.joint)


def _check_apart(pins: Sequence[PlacedPin], group: PinGroup) -> None:
    for before, pin in zip(pins, pins[1:], strict=False):
        if pin.at <= before.until:
            raise group.error(("pins", pin.number, "time"), f"is {pin.pin.time:g}, when another pin of "
                              f"{pin.pin.joint} holds", "give another time, or remove one of the two")


class _Course:
    """How strongly the pins of a joint act in the frames of a group."""

    def __init__(self, pins: Sequence[PlacedPin], group: PinGroup) -> None:
        self.pins, frames = pins, np.arange(group.first, group.last, dtype=np.float64)
        self.rows = [(pin.at - group.first, pin.until - group.first) for pin in pins]
        self.shares: list[Array] = []
        """[T] of each pin."""
        self.sources: list[Array | None] = []
        """[T] frames c(t) of each pin that holds; None for one that is passed."""
        untils = [-math.inf, *(pin.until for pin in pins[:-1])]
        ats = [*(pin.at for pin in pins[1:]), math.inf]
        for pin, before, after in zip(pins, untils, ats, strict=True):
            rise, fall = (gap if gap < 2 * group.fade else group.fade for gap in (pin.at - before, after - pin.until))
            away = np.where(frames < pin.at, (pin.at - frames) / rise, np.maximum(frames - pin.until, 0.0) / fall)
            s = 1.0 - np.minimum(away, 1.0)
            self.shares.append(s * s * s * (s * (6.0 * s - 15.0) + 10.0))
            self.sources.append(None if pin.until == pin.at else np.clip(
                _stopped(frames, pin, min(group.stop, rise), min(group.stop, fall)) - group.first, 0, len(frames) - 1))

    @property
    def share(self) -> Array:
        """[T] of all pins, 0 to 1."""
        return np.asarray(np.minimum(np.sum(self.shares, axis=0), 1.0))

    def added(self, difference: Callable[[int, Array | None], Array]) -> Array:
        """[T, 3] the sum of the differences of the pins. difference: number of the pin, its frames [T] or None -> the
        difference [T, 3], or [3]."""
        return np.asarray(np.sum([share[:, None] * difference(at, source) for at, (share, source)
                                  in enumerate(zip(self.shares, self.sources, strict=True))], axis=0))


def _stopped(frames: Array, pin: PlacedPin, before: float, after: float) -> Array:
    """[T] the frames c(t) of a pin that holds; before, after: frames in which it slows down and sets off."""
    rise = np.clip((frames - pin.at) / before + 1.0, 0.0, 1.0)
    fall = np.clip((pin.until - frames) / after + 1.0, 0.0, 1.0)
    early = pin.at - before / 2.0 * (1.0 - rise ** 2)
    late = pin.until + after / 2.0 * (1.0 - fall ** 2)
    return np.where(frames < pin.at, early, np.where(frames > pin.until, late, frames))


# ----------------------------------------------------------------------------------------------------------- hands

def _moved(path: Array, course: _Course) -> Array:
    """[T, 3] the path of a joint through its pins."""
    def difference(at: int, source: Array | None) -> Array:
        position = np.array(course.pins[at].pin.position, dtype=np.float64)
        if source is None:
            return position - path[course.rows[at][0]]
        return position - CubicSpline(np.arange(len(path)), path)(source)

    return path + course.added(difference)


def _move_hand(motion: Motion, hand: int, course: _Course, error: Problem) -> None:
    """Move a hand in the rotations of a motion."""
    skeleton, pose = motion.skeleton, pose_of(motion)
    side = skeleton.names[hand].removesuffix("Hand")
    chain = skeleton.index(side + "Arm"), skeleton.index(side + "ForeArm"), hand
    wrist, shoulder = pose.places[side + "Hand"], pose.places[side + "Arm"]
    length = float(sum(np.linalg.norm(skeleton.offsets[joint]) for joint in chain[1:]))
    way = _moved(wrist, course) - shoulder
    far = np.linalg.norm(way, axis=-1)
    for pin, (first, last) in zip(course.pins, course.rows, strict=True):
        _check_reach(pin, side, far[first:last + 1], length, error)
    near = np.flatnonzero(course.share)
    keep = (1.0 - (1.0 - course.share) ** 4)[near]
    limited = far[near] + keep * (_limited(far[near], length) - far[near])
    goal = shoulder[near] + way[near] * (limited / np.maximum(far[near], 1e-9))[:, None]
    turns = {skeleton.index(joint): turn[near] for joint, turn in pose.turns.items()}
    turned = swing(wrist[near] - shoulder[near], goal - shoulder[near])
    for joint in chain[:2]:
        turns[joint] = turned @ turns[joint]
    bend(turns, BelowShoulder(skeleton, chain[0], shoulder[near]), chain, goal, _POLE_OF_ELBOW)
    for joint in chain[:2]:
        _write(motion, near, joint, np.swapaxes(turns[skeleton.parents[joint]], -1, -2) @ turns[joint])


def _check_reach(pin: PlacedPin, side: str, far: Array, length: float, error: Problem) -> None:
    place = ("pins", pin.number, "position")
    if far.max() > STRETCHED * length + 1e-9:
        raise error(place, f"is {far.max():.2f} m from the {side.lower()} shoulder at {pin.pin.time:.2f} s, and the "
                    f"arm reaches {STRETCHED * length:.2f} m", "give a nearer place")
    if far.min() < NEAREST + NEAR_SOFT - 1e-9:
        raise error(place, f"is {far.min():.2f} m from the {side.lower()} shoulder at {pin.pin.time:.2f} s, and a "
                    f"wrist gets no nearer than {NEAREST + NEAR_SOFT:.2f} m", "give a place farther away")


def _limited(far: Array, length: float) -> Array:
    """Distances [T] of a wrist from its shoulder within what an arm can do, without a kink."""
    free, room = STRETCHED * length, (MOST_STRETCHED - STRETCHED) * length
    over = np.maximum(far - free, 0.0)
    return np.minimum(far, free) + room * np.tanh(over / room) + soft(NEAREST - far, NEAR_SOFT)


def _write(motion: Motion, near: NDArray[np.intp], joint: int, local: Array) -> None:
    """Put local rotations [n, 3, 3] of a joint into the frames `near` [n], on the side of the quaternions there."""
    new, old = Rotation.from_matrix(local).as_quat(scalar_first=True), motion.rotations[near, joint]
    motion.rotations[near, joint] = np.where(np.sum(new * old, axis=-1, keepdims=True) < 0.0, -new, new)


def _clear(made: Motion, before: Motion, share: Array, group: PinGroup) -> None:
    """Move hands out of the body where a pin has brought them there."""
    near = np.flatnonzero(share)
    if not len(near):
        return
    free = cleared(made, _sits(made))
    changed = np.flatnonzero((free.rotations != made.rotations).any(axis=(0, 2)))
    if not len(changed):
        return
    wrists, moved = (pose_of(motion).places for motion in (made, free))
    for pin in group.pins:
        joint, rows = pin.pin.joint, slice(pin.at - group.first, pin.until - group.first + 1)
        if pin.pin.position is not None and joint != "Head" and \
                np.linalg.norm(wrists[joint][rows] - moved[joint][rows], axis=-1).max() > _CLEARS:
            raise group.error(("pins", pin.number, "position"), f"is inside the body at {pin.pin.time:.2f} s",
                              "give a place farther ahead")
    keep = (1.0 - (1.0 - share) ** 4)[near, None]
    for node in changed:
        old, new = made.rotations[near, node], free.rotations[near, node]
        new = np.where(np.sum(new * old, axis=-1, keepdims=True) < 0.0, -new, new)
        mixed = rotation.normalise(old + keep * (new - old))
        made.rotations[near, node] = np.where((new == old).all(axis=-1, keepdims=True), old, mixed)


def _sits(motion: Motion) -> bool:
    if "LeftUpLeg" not in motion.skeleton.names:
        return False
    from gesticulator.contacts.lap import is_seated

    return is_seated(motion)


# ------------------------------------------------------------------------------------------------- head and rotations

def _move_head(motion: Motion, head: int, course: _Course, error: Problem) -> None:
    """Move the head in the rotations of a motion; see `MOST_LEAN`."""
    skeleton, pose = motion.skeleton, pose_of(motion)
    spine = [skeleton.index(name) for name in _SPINE]
    joints = [pose.places[name] for name in (*_SPINE, "Head")]
    goal = _moved(joints[-1], course)
    lean = _lean(joints, goal)
    for pin, (first, last) in zip(course.pins, course.rows, strict=True):
        rows = slice(first, last + 1)
        off = np.linalg.norm(_leant(joints, lean)[rows] - goal[rows], axis=-1).max()
        if off > _HEAD_OFF or np.linalg.norm(lean[rows], axis=-1).max() > MOST_LEAN:
            raise error(("pins", pin.number, "position"), f"is out of the head's reach at {pin.pin.time:.2f} s: by "
                        f"bending the spine it comes within {max(off, 0.01):.2f} m", "give a nearer place")
    near = np.flatnonzero(course.share)
    neck = skeleton.parents[head]
    above = pose.turns[skeleton.names[skeleton.parents[spine[0]]]][near]
    for at, joint in enumerate(spine):
        turned = _part(lean[near], at, len(spine)) @ pose.turns[skeleton.names[joint]][near]
        _write(motion, near, joint, np.swapaxes(above, -1, -2) @ turned)
        above = turned
    turned = _part(lean[near], len(spine) - 1, len(spine)) @ pose.turns[skeleton.names[neck]][near]
    _write(motion, near, head, np.swapaxes(turned, -1, -2) @ pose.turns["Head"][near])


def _part(lean: Array, at: int, count: int) -> Array:
    """[T, 3, 3] the turn of the joint `at` of a spine of `count` joints that leans by [T, 3] as a whole."""
    return np.asarray(Rotation.from_rotvec(lean * ((at + 1.0) / count)).as_matrix())


def _leant(joints: Sequence[Array], lean: Array) -> Array:
    """[T, 3] the place of the head. joints: [T, 3] places of the spine's joints and of the head."""
    place, count = joints[0], len(joints) - 1
    for at, (low, high) in enumerate(zip(joints, joints[1:], strict=False)):
        place = place + np.einsum("tij,tj->ti", _part(lean, at, count), high - low)
    return np.asarray(place)


def _lean(joints: Sequence[Array], goal: Array) -> Array:
    """[T, 3] axis times angle of the bend of the spine that brings the head nearest to its goal [T, 3]."""
    lean = np.zeros_like(goal)
    for _ in range(_ITERATIONS):
        off = swing(_leant(joints, lean) - joints[0], goal - joints[0])
        lean = lean + _GAIN * Rotation.from_matrix(off).as_rotvec()
    return lean


def _turn(motion: Motion, joint: int, course: _Course) -> None:
    """Turn a joint in the rotations of a motion."""
    path = motion.rotations[:, joint].copy()

    def difference(at: int, source: Array | None) -> Array:
        goal = rotation.normalise(np.array(course.pins[at].pin.rotation, dtype=np.float64))
        there = path[course.rows[at][0]] if source is None else rotation.interpolate(path, source)
        return rotation.to_exponential_map(rotation.multiply(rotation.conjugate(there), goal))

    near = np.flatnonzero(course.share)
    turned = rotation.multiply(path, rotation.from_exponential_map(course.added(difference)))[near]
    old = path[near]
    motion.rotations[near, joint] = np.where(np.sum(turned * old, axis=-1, keepdims=True) < 0.0, -turned, turned)
