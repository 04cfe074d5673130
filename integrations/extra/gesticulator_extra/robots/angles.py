"""Our motion as joint angles of a Unitree G1.

A robot does not take rotations: each hinge turns about one axis within limits. As for any character
(`gesticulator.characters.retarget`) the directions of bones are copied. Let R be the trunk's rotation, u and f the
directions of an upper arm and a forearm, H the orientation of the hand. From the trunk outwards, with Rx, Ry, Rz
rotations about the axes of `gesticulator_extra.robots.g1`,

    R = Rz(waist yaw) Rx(waist roll) Ry(waist pitch)
    u = R S Ry(shoulder pitch) S' Rx(shoulder roll) (-z)                     S, S': how the shoulder's links are mounted
    f = U Rz(shoulder yaw) Ry(elbow) x                                              U: the upper arm, solved before
    H = F Rx(wrist roll) Ry(wrist pitch) Rz(wrist yaw)                              F: the forearm, solved before

where each pair is two hinges that point something (`gesticulator_extra.robots.pan_tilt`). The robot has no neck, no
shoulder blades and no fingers.

The equations are solved one after the other for all frames at once. Each solution is limited to the joints' angles and
speeds before the next, which can then compensate for the error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation, skeletons
from data_module.types import Array, Motion
from gesticulator_extra.robots import g1, legs
from gesticulator_extra.robots.limits import MARGIN, held
from gesticulator_extra.robots.pan_tilt import pan_over_time, tilt_at

_TO_ROBOT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Our axes (X left, Y up, Z ahead) to the robot's (X ahead, Y left, Z up)."""
_SIDES = ("left", "right")
_ACROSS = np.diag([1.0, -1.0, 1.0])
"""Mirrors the right side to the left."""
_HAND = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""From the robot's hand (fingers along x, thumb along z, the left palm to -y) to our left hand at rest: fingers to the
left, thumb ahead, palm down."""
ASIDE = np.radians(3.0)
"""Angular error above which a body part is reported, radians."""
SLIPS = 0.005
"""Displacement above which a foot is reported, metres."""


@dataclass(frozen=True)
class RobotMotion:
    """T frames of a G1. Frame t is the pose at t / fps seconds.

    places: [T, 3] metres and turns: [T, 4] (unit quaternions, w first) of the pelvis, X ahead, Y left, Z up, the floor
    at 0. angles: [T, 29] radians, in the order of `gesticulator_extra.robots.g1.NAMES`. aside: body part -> share of
    frames in which its error exceeds `ASIDE` (or, for a foot, `SLIPS`) because of the joint limits.
    """

    places: Array
    turns: Array
    angles: Array
    fps: float
    aside: Mapping[str, float]

    def __len__(self) -> int:
        return len(self.angles)

    def note(self) -> str | None:
        """One line about the parts that the robot could not follow; None if there are none."""
        if not self.aside:
            return None
        parts = [f"{part} in {100.0 * self.aside[part]:.1f} %"
                for part in sorted(self.aside, key=lambda part: -self.aside[part])]
        return f"the G1 cannot follow within 3 degrees: {', '.join(parts)} of frames"


class _Body:
    """A robot whose joints are set from the pelvis outwards, each within its limits of angle and speed."""

    def __init__(self, frames: int, fps: float) -> None:
        self.angles = np.zeros((frames, len(g1.JOINTS)))
        self.fps = fps
        self.aside: dict[str, float] = {}

    def set(self, indices: list[int], wanted: Array) -> Array:
        """Set joints to `wanted` [T, n], limited in angle and speed; returns the limited angles [T, n]."""
        limited = held(wanted, g1.LOW[indices], g1.HIGH[indices], g1.SPEED[indices], self.fps)
        self.angles[:, indices] = limited
        return limited

    def note(self, part: str, is_aside: NDArray[np.bool_]) -> None:
        """Record the share of frames [T] in which a part is off its target."""
        share = float(is_aside.mean())
        if share:
            self.aside[part] = share


class _Arm:
    """The left arm of a robot, or the mirrored right one: pitches and elbow are the same, rolls and yaws change
    sign."""

    def __init__(self, body: _Body, side: str) -> None:
        self.body = body
        self.indices = g1.joints_of(side, "arm")
        self.left = g1.joints_of("left", "arm")
        self.sign = [1.0 if side == "left" or g1.JOINTS[index].axis == "y" else -1.0 for index in self.indices]

    def limits(self, number: int) -> tuple[float, float]:
        """The limits of the left arm's joint, radians."""
        index = self.left[number]
        return float(g1.LOW[index]) + MARGIN, float(g1.HIGH[index]) - MARGIN

    def set(self, number: int, wanted: Array) -> Array:
        """Set a joint to `wanted` [T]; returns its limited angles [T]."""
        sign = self.sign[number]
        return np.asarray(sign * self.body.set([self.indices[number]], sign * wanted[:, None])[:, 0])

    def turn(self, number: int, way: Array, liked: Array | float = 0.0) -> Array:
        """[T] the angles of one joint, given their cosine and sine `way` [T, 2]; liked: [T] preferred angles."""
        flat = np.concatenate([way, np.zeros((len(way), 1))], axis=-1)
        return self.set(number, pan_over_time(flat, liked + np.zeros(len(way)), self.body.fps, self.limits(number),
                                              (0.0, 0.0)))

    def point(self, number: int, way: Array, liked: Array | float = 0.0, offset: float = 0.0) -> tuple[Array, Array]:
        """[T] the angles of two joints that point along `way` [T, 3] (`gesticulator_extra.robots.pan_tilt`); the
        second is zero at a tilt of `offset`. liked: [T] preferred first angle where the direction does not determine
        it."""
        low, high = self.limits(number + 1)
        tilt = (low + offset, high + offset)
        pan = self.set(number, pan_over_time(way, liked + np.zeros(len(way)), self.body.fps, self.limits(number), tilt))
        return pan, self.set(number + 1, tilt_at(pan, way, tilt) - offset)


def to_robot(motion: Motion) -> RobotMotion:
    """A motion of our character (16, 46 or 54 joints) on the robot.

    The pelvis stays over one place, with the legs in one stance; a motion with legs (54 joints) moves the pelvis like
    the hips, over feet that stay in place. ValueError for another skeleton.
    """
    size = len(motion.skeleton)
    if size not in skeletons.CHARACTERS or not motion.skeleton.same_joints(skeletons.CHARACTERS[size]):
        raise ValueError("the motion is not on one of our skeletons: bring it onto one with to_character")
    world = dict(zip(motion.skeleton.names, np.moveaxis(_matrices(kinematics.global_rotations(
        motion.skeleton, motion.rotations)), 1, 0), strict=True))
    body = _Body(len(motion), motion.fps)
    places, pelvis = legs.stand(motion, world["Hips"])
    for side in _SIDES:
        body.set(g1.joints_of(side, "leg"), legs.reach(side, pelvis, places))
        body.note(f"{side} foot", legs.off_its_place(side, body.angles, pelvis, places) > SLIPS)
    trunk = _waist(body, pelvis, world["Spine3"])
    for side in _SIDES:
        _arm(body, side, trunk, {part: world[side.title() + part] for part in ("Arm", "ForeArm", "Hand")})
    turns = Rotation.from_matrix(pelvis).as_quat(scalar_first=True)
    return RobotMotion(places, rotation.continuous(turns), body.angles, motion.fps, body.aside)


def _matrices(quaternions: Array) -> Array:
    """[T, J, 3, 3] world rotations in the robot's axes from quaternions [T, J, 4] in ours."""
    flat = Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_matrix()
    return (_TO_ROBOT @ flat @ _TO_ROBOT.T).reshape(*quaternions.shape[:-1], 3, 3)


def _waist(body: _Body, pelvis: Array, chest: Array) -> Array:
    """[T, 3, 3] rotation of the robot's trunk, following our chest within the limits of the waist."""
    order = [g1.INDEX[f"waist_{part}_joint"] for part in ("yaw", "roll", "pitch")]
    apart = Rotation.from_matrix(np.swapaxes(pelvis, -1, -2) @ chest)
    angles = body.set(order, np.unwrap(apart.as_euler("ZXY"), axis=0))
    trunk = pelvis @ Rotation.from_euler("ZXY", angles).as_matrix()
    body.note("trunk", _apart(trunk, chest) > ASIDE)
    return trunk


def _arm(body: _Body, side: str, trunk: Array, world: Mapping[str, Array]) -> None:
    """Set the seven angles of an arm. trunk: [T, 3, 3]; world: "Arm", "ForeArm", "Hand" -> [T, 3, 3]."""
    if side == "right":
        trunk, world = _mirrored(trunk), {name: _mirrored(turn) for name, turn in world.items()}
    arm = _Arm(body, side)
    mounted, counter = (g1.rest_turn(g1.JOINTS[index]) for index in arm.left[:2])
    # Shoulder: S^T R^T u pans about y, starting from hanging down, and tilts towards y.
    frame = trunk @ mounted
    mount = float(Rotation.from_matrix(counter).as_rotvec()[0])
    pitch, roll = arm.point(0, _in(frame, world["Arm"][..., 1])[:, [2, 0, 1]] * [-1.0, -1.0, 1.0], offset=mount)
    upper = frame @ g1.hinge("y", pitch) @ counter @ g1.hinge("x", roll)
    body.note(f"{side} upper arm", _angle(-upper[..., 2], world["Arm"][..., 1]) > ASIDE)
    # Elbow: a straight elbow is prepared to bend as ours would, ahead if the arm is held out with the palm down.
    bends = _in(upper, world["Arm"][..., 0])
    yaw, elbow = arm.point(2, _in(upper, world["ForeArm"][..., 1]) * [1.0, 1.0, -1.0],
                           np.arctan2(bends[:, 1], bends[:, 0]))
    lower = upper @ g1.hinge("z", yaw) @ g1.hinge("y", elbow)
    body.note(f"{side} forearm", _angle(lower[..., 0], world["ForeArm"][..., 1]) > ASIDE)
    # Hand: if it cannot roll far enough, the fingers still point where ours do.
    goal = world["Hand"] @ _HAND
    apart = np.swapaxes(lower, -1, -2) @ goal
    way = np.stack([apart[:, 2, 2], -apart[:, 1, 2]], axis=-1)
    roll = arm.turn(4, way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9))
    rolled = lower @ g1.hinge("x", roll)
    pitch, yaw = arm.point(5, _in(rolled, goal[..., 0])[:, [0, 2, 1]] * [1.0, -1.0, 1.0])
    body.note(f"{side} hand", _apart(rolled @ g1.hinge("y", pitch) @ g1.hinge("z", yaw), goal) > ASIDE)


def _angle(a: Array, b: Array) -> Array:
    """[T] radians between unit directions [T, 3]."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0)))


def _apart(a: Array, b: Array) -> Array:
    """[T] radians between rotations [T, 3, 3]."""
    return np.asarray(Rotation.from_matrix(np.swapaxes(a, -1, -2) @ b).magnitude())


def _mirrored(turns: Array) -> Array:
    return _ACROSS @ turns @ _ACROSS


def _in(frame: Array, direction: Array) -> Array:
    """[T, 3] a world direction [T, 3] in the axes of a frame [T, 3, 3]."""
    return np.einsum("tji,tj->ti", frame, direction)
