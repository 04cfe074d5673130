"""Our motion as joint angles of a Unitree G1.

A robot cannot be given rotations: each of its hinges turns about one axis, and only so far. As on any character
(`gesticulator.characters.retarget`) what is copied is where bones point. Let R be the trunk's rotation, u and f the
directions in which an upper arm and a forearm point, H how the hand is held. From the trunk outwards, with Rx, Ry,
Rz turns about the axes of `gesticulator.export.robots.g1`,

    R = Rz(waist yaw) Rx(waist roll) Ry(waist pitch)
    u = R S Ry(shoulder pitch) S' Rx(shoulder roll) (-z)                     S, S': how the shoulder's links are mounted
    f = U Rz(shoulder yaw) Ry(elbow) x                                              U: the upper arm, found before
    H = F Rx(wrist roll) Ry(wrist pitch) Rz(wrist yaw)                              F: the forearm, found before

of which each pair is two hinges that point something (`gesticulator.export.robots.pan_tilt`). The robot has no neck, no
shoulder blades and no fingers.

They are solved one after the other for all frames at once. Each is held within the joints' limits and speeds before the
next, which then makes up for what was cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_module.motion import kinematics, rotation, skeletons
from data_module.types import Array, Motion
from gesticulator.export.robots import g1, legs
from gesticulator.export.robots.limits import MARGIN, held
from gesticulator.export.robots.pan_tilt import pan_over_time, tilt_at

_TO_ROBOT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Our axes (X left, Y up, Z ahead) to the robot's (X ahead, Y left, Z up)."""
_SIDES = ("left", "right")
_ACROSS = np.diag([1.0, -1.0, 1.0])
"""Takes the right side to the left one."""
_HAND = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The robot's hand (fingers along x, thumb along z, the left palm to -y) on our left hand at rest: fingers to the left,
thumb ahead, palm down."""
ASIDE = np.radians(3.0)
"""Radians from which on a part of the body that points aside is told of."""
SLIPS = 0.005
"""Metres, the same of a foot."""

@dataclass(frozen=True)
class RobotMotion:
    """T frames of a G1. Frame t is the pose at t / fps seconds.

    places: [T, 3] metres and turns: [T, 4] (unit quaternions, w first) of the pelvis, X ahead, Y left, Z up, the floor
    at 0. angles: [T, 29] radians, in the order of `gesticulator.export.robots.g1.NAMES`. aside: part of the body -> the
    share of frames in which it points more than `ASIDE` from where it should, or, of a foot, is more than `SLIPS` off
    its place, for what the joints cannot do.
    """

    places: Array
    turns: Array
    angles: Array
    fps: float
    aside: Mapping[str, float]

    def __len__(self) -> int:
        return len(self.angles)

    def note(self) -> str | None:
        """What the robot could not do, in one line; None where it could do all."""
        if not self.aside:
            return None
        said = [f"{part} in {100.0 * self.aside[part]:.1f} %"
                for part in sorted(self.aside, key=lambda part: -self.aside[part])]
        return f"what the G1 cannot follow within 3 degrees: {', '.join(said)} of frames"


class _Body:
    """A robot whose joints are set from the pelvis outwards, each within its limits of angle and speed."""

    def __init__(self, frames: int, fps: float) -> None:
        self.angles = np.zeros((frames, len(g1.JOINTS)))
        self.fps = fps
        self.aside: dict[str, float] = {}

    def set(self, indices: list[int], wanted: Array) -> Array:
        """[T, n] the angles that the joints take when `wanted` is asked for."""
        kept = held(wanted, g1.LOW[indices], g1.HIGH[indices], g1.SPEED[indices], self.fps)
        self.angles[:, indices] = kept
        return kept

    def note(self, part: str, is_aside: NDArray[np.bool_]) -> None:
        """Remember in how many frames [T] a part is not where it should be."""
        share = float(is_aside.mean())
        if share:
            self.aside[part] = share


class _Arm:
    """The left arm of a robot, or the right one seen in a mirror, where pitches and the elbow are the same, and rolls
    and yaws change their sign."""

    def __init__(self, body: _Body, side: str) -> None:
        self.body = body
        self.indices = g1.joints_of(side, "arm")
        self.left = g1.joints_of("left", "arm")
        self.sign = [1.0 if side == "left" or g1.JOINTS[index].axis == "y" else -1.0 for index in self.indices]

    def limits(self, number: int) -> tuple[float, float]:
        """Those of the left arm's joint of a number, radians."""
        index = self.left[number]
        return float(g1.LOW[index]) + MARGIN, float(g1.HIGH[index]) - MARGIN

    def set(self, number: int, wanted: Array) -> Array:
        """[T] the angles that a joint takes."""
        sign = self.sign[number]
        return np.asarray(sign * self.body.set([self.indices[number]], sign * wanted[:, None])[:, 0])

    def turn(self, number: int, way: Array, liked: Array | float = 0.0) -> Array:
        """[T] the angles of one joint; way: [T, 2] its cosine and sine."""
        flat = np.concatenate([way, np.zeros((len(way), 1))], axis=-1)
        return self.set(number, pan_over_time(flat, liked + np.zeros(len(way)), self.body.fps, self.limits(number),
                                              (0.0, 0.0)))

    def point(self, number: int, way: Array, liked: Array | float = 0.0, offset: float = 0.0) -> tuple[Array, Array]:
        """[T] the angles of two joints that point along way [T, 3] (`gesticulator.export.robots.pan_tilt`); the second
        is at zero where the tilt is `offset`. liked: [T] the first where the way does not tell it."""
        low, high = self.limits(number + 1)
        tilt = (low + offset, high + offset)
        pan = self.set(number, pan_over_time(way, liked + np.zeros(len(way)), self.body.fps, self.limits(number), tilt))
        return pan, self.set(number + 1, tilt_at(pan, way, tilt) - offset)


def to_robot(motion: Motion) -> RobotMotion:
    """A motion of our character (16, 46 or 54 joints) on the robot.

    The pelvis stands over one place, and the legs in one stance; a motion with legs (54 joints) moves the pelvis as it
    does the hips, over feet that stay. ValueError for a motion of something else.
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
    """[T, J, 3, 3] world rotations, in the robot's axes, of [T, J, 4] in ours."""
    flat = Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_matrix()
    return (_TO_ROBOT @ flat @ _TO_ROBOT.T).reshape(*quaternions.shape[:-1], 3, 3)


def _waist(body: _Body, pelvis: Array, chest: Array) -> Array:
    """[T, 3, 3] the robot's trunk, turned as our chest is, as far as its waist goes."""
    order = [g1.INDEX[f"waist_{part}_joint"] for part in ("yaw", "roll", "pitch")]
    apart = Rotation.from_matrix(np.swapaxes(pelvis, -1, -2) @ chest)
    angles = body.set(order, np.unwrap(apart.as_euler("ZXY"), axis=0))
    trunk = pelvis @ Rotation.from_euler("ZXY", angles).as_matrix()
    body.note("trunk", _apart(trunk, chest) > ASIDE)
    return trunk


def _arm(body: _Body, side: str, trunk: Array, world: Mapping[str, Array]) -> None:
    """The seven angles of an arm. trunk: [T, 3, 3]; world: "Arm", "ForeArm", "Hand" -> [T, 3, 3]."""
    if side == "right":
        trunk, world = _mirrored(trunk), {name: _mirrored(turn) for name, turn in world.items()}
    arm = _Arm(body, side)
    mounted, counter = (g1.rest_turn(g1.JOINTS[index]) for index in arm.left[:2])
    # Shoulder: S^T R^T u pans about y from hanging on, and tilts towards y.
    frame = trunk @ mounted
    mount = float(Rotation.from_matrix(counter).as_rotvec()[0])
    pitch, roll = arm.point(0, _in(frame, world["Arm"][..., 1])[:, [2, 0, 1]] * [-1.0, -1.0, 1.0], offset=mount)
    upper = frame @ g1.hinge("y", pitch) @ counter @ g1.hinge("x", roll)
    body.note(f"{side} upper arm", _angle(-upper[..., 2], world["Arm"][..., 1]) > ASIDE)
    # Elbow: where it is straight, it is ready to bend as ours is, ahead when the arm is held out with its palm down.
    bends = _in(upper, world["Arm"][..., 0])
    yaw, elbow = arm.point(2, _in(upper, world["ForeArm"][..., 1]) * [1.0, 1.0, -1.0],
                           np.arctan2(bends[:, 1], bends[:, 0]))
    lower = upper @ g1.hinge("z", yaw) @ g1.hinge("y", elbow)
    body.note(f"{side} forearm", _angle(lower[..., 0], world["ForeArm"][..., 1]) > ASIDE)
    # Hand: where it cannot roll as far, its fingers still point where ours do.
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
    """[T] radians between turns [T, 3, 3]."""
    return np.asarray(Rotation.from_matrix(np.swapaxes(a, -1, -2) @ b).magnitude())


def _mirrored(turns: Array) -> Array:
    return _ACROSS @ turns @ _ACROSS


def _in(frame: Array, direction: Array) -> Array:
    """[T, 3] a direction of the world [T, 3] in the axes of a frame [T, 3, 3]."""
    return np.einsum("tji,tj->ti", frame, direction)
