"""The Unitree G1 with 29 joints: names, positions, axes and limits.

Axes are those of MuJoCo: X ahead, Y to the left, Z up; metres, radians, seconds. At zero the robot stands straight with
hanging upper arms and forearms pointing ahead, palms facing each other.

The values are facts about the machine. They were read from the model of 29 joints (`g1_29dof_rev_1_0`) that the PyPI
package `mjlab` has under `asset_zoo/robots/unitree_g1`, motor speeds from its `g1_constants.py`. That model is
Unitree's (BSD 3-Clause); nothing of it is copied here, and tests compare this table with it where it is installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.types import Array

AXES: Mapping[str, tuple[float, float, float]] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_UNTURNED = (1.0, 0.0, 0.0, 0.0)
_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]
_Row = tuple[str, _Vector, _Quaternion, str, float, float, float]


@dataclass(frozen=True)
class RobotJoint:
    """A hinge, and the link that it carries.

    name: as in the model. parent: the joint that carries it, "" for the pelvis. place: [3] metres, turn: a unit
    quaternion, w first: the link in its parent's axes with the hinge at zero. axis: "x", "y" or "z" of the link. low,
    high: radians. speed: maximum of the motor, radians per second.
    """

    name: str
    parent: str
    place: _Vector
    turn: _Quaternion
    axis: str
    low: float
    high: float
    speed: float


# Maximum speeds of the four kinds of motor, radians per second.
_ARM, _WRIST, _TURN, _KNEE = 37.0, 22.0, 32.0, 20.0

_WAIST = (
    RobotJoint("waist_yaw_joint", "", (0.0, 0.0, 0.0), _UNTURNED, "z", -2.618, 2.618, _TURN),
    RobotJoint("waist_roll_joint", "waist_yaw_joint", (-0.0039635, 0.0, 0.044), _UNTURNED, "x", -0.52, 0.52, _ARM),
    RobotJoint("waist_pitch_joint", "waist_roll_joint", (0.0, 0.0, 0.0), _UNTURNED, "y", -0.52, 0.52, _ARM),
)
# Limbs of the left side: name, place, turn, axis, limits, speed; each is attached to the one before.
_LEFT_LEG = (
    ("hip_pitch", (0.0, 0.064452, -0.1027), _UNTURNED, "y", -2.5307, 2.8798, _TURN),
    ("hip_roll", (0.0, 0.052, -0.030465), (0.996179, 0.0, -0.0873386, 0.0), "x", -0.5236, 2.9671, _KNEE),
    ("hip_yaw", (0.025001, 0.0, -0.12412), _UNTURNED, "z", -2.7576, 2.7576, _TURN),
    ("knee", (-0.078273, 0.0021489, -0.17734), (0.996179, 0.0, 0.0873386, 0.0), "y", -0.087267, 2.8798, _KNEE),
    ("ankle_pitch", (0.0, -9.4445e-05, -0.30001), _UNTURNED, "y", -0.87267, 0.5236, _ARM),
    ("ankle_roll", (0.0, 0.0, -0.017558), _UNTURNED, "x", -0.2618, 0.2618, _ARM),
)
_LEFT_ARM = (
    ("shoulder_pitch", (0.0039563, 0.10022, 0.24778), (0.990264, 0.139201, 0.0, 0.0), "y", -3.0892, 2.6704, _ARM),
    ("shoulder_roll", (0.0, 0.038, -0.013831), (0.990268, -0.139172, 0.0, 0.0), "x", -1.5882, 2.2515, _ARM),
    ("shoulder_yaw", (0.0, 0.00624, -0.1032), _UNTURNED, "z", -2.618, 2.618, _ARM),
    ("elbow", (0.015783, 0.0, -0.080518), _UNTURNED, "y", -1.0472, 2.0944, _ARM),
    ("wrist_roll", (0.1, 0.00188791, -0.01), _UNTURNED, "x", -1.97222, 1.97222, _ARM),
    ("wrist_pitch", (0.038, 0.0, 0.0), _UNTURNED, "y", -1.61443, 1.61443, _WRIST),
    ("wrist_yaw", (0.046, 0.0, 0.0), _UNTURNED, "z", -1.61443, 1.61443, _WRIST),
)
SOLE = 0.035
"""Height of the ankles' last joint above the sole, metres."""


def _limb(side: str, rows: tuple[_Row, ...], carrier: str) -> tuple[RobotJoint, ...]:
    """A limb of the "left" side, or its mirror image."""
    out = []
    above = carrier
    for part, place, turn, axis, low, high, speed in rows:
        if side == "right":
            place, turn = (place[0], -place[1], place[2]), (turn[0], -turn[1], turn[2], -turn[3])
            if axis != "y":
                low, high = -high, -low
        name = f"{side}_{part}_joint"
        out.append(RobotJoint(name, above, place, turn, axis, low, high, speed))
        above = name
    return tuple(out)


JOINTS: tuple[RobotJoint, ...] = (
    *_limb("left", _LEFT_LEG, ""), *_limb("right", _LEFT_LEG, ""), *_WAIST,
    *_limb("left", _LEFT_ARM, _WAIST[-1].name), *_limb("right", _LEFT_ARM, _WAIST[-1].name))
"""In the model's order, which is MuJoCo's."""
NAMES: tuple[str, ...] = tuple(joint.name for joint in JOINTS)
INDEX: Mapping[str, int] = {name: index for index, name in enumerate(NAMES)}
LOW: Array = np.array([joint.low for joint in JOINTS])
HIGH: Array = np.array([joint.high for joint in JOINTS])
SPEED: Array = np.array([joint.speed for joint in JOINTS])


def joints_of(side: str, limb: str) -> list[int]:
    """The indices of the joints of the "left" or "right" "arm" (seven) or "leg" (six), from the trunk outwards."""
    rows = _LEFT_ARM if limb == "arm" else _LEFT_LEG
    return [INDEX[f"{side}_{row[0]}_joint"] for row in rows]


def hinge(axis: str, angles: Array) -> Array:
    """[..., 3, 3] rotations by angles [...] in radians about a local axis."""
    return Rotation.from_rotvec(np.asarray(angles).reshape(-1, 1) * np.array(AXES[axis])).as_matrix().reshape(
        *np.shape(angles), 3, 3)


def rest_turn(joint: RobotJoint) -> Array:
    """[3, 3] a link's axes in its parent's axes, at zero."""
    return Rotation.from_quat(joint.turn, scalar_first=True).as_matrix()


def forward(angles: Array, turns: Array, places: Array, joints: list[int] | None = None) -> tuple[Array, Array]:
    """Forward kinematics: positions [T, n, 3] and axes [T, n, 3, 3] of the links in the world.

    angles: [T, 29]; turns: [T, 3, 3] and places: [T, 3] of the pelvis. joints: n joints, parents before children and
    with all of their parents; default: all 29.
    """
    chosen = list(range(len(JOINTS))) if joints is None else joints
    rows = {"": (places, turns)}
    for index in chosen:
        joint = JOINTS[index]
        place, turn = rows[joint.parent]
        rows[joint.name] = (place + turn @ np.array(joint.place),
                            turn @ rest_turn(joint) @ hinge(joint.axis, angles[:, index]))
    links = [rows[JOINTS[index].name] for index in chosen]
    return np.stack([place for place, _ in links], axis=1), np.stack([turn for _, turn in links], axis=1)
