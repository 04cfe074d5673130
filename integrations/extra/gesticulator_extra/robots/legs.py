"""Standing legs of a G1: the path of the pelvis, and angles that keep both feet flat in place."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.motion import skeletons
from data_module.types import Array, Motion
from gesticulator_extra.robots import g1

_STANCE = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3}
"""Stance, radians: bent knees, so that legs can stretch by 26 mm, and flat feet (the angles sum to zero)."""
_LEG_SHARE = 0.70
"""Length of the robot's leg from hip to ankle relative to ours (0.58 and 0.825 m); scales the travel of the hips."""
_STEPS = 15
"""Iterations; five suffice if the feet can be reached."""
_DAMPING = 1e-6
"""Damping near stretched legs, metres and radians squared."""
_LEAP = 0.2
"""Largest change of a joint per iteration, radians."""
_STRAIGHT = 0.03
"""Least bend of a knee, radians: the bending direction of a straight leg is undefined."""


def _stance(side: str) -> Array:
    """[29] the stance of one leg, zero elsewhere."""
    angles = np.zeros(len(g1.JOINTS))
    for part, angle in _STANCE.items():
        angles[g1.INDEX[f"{side}_{part}_joint"]] = angle
    return angles


def _foot(side: str) -> Array:
    """[3] metres from the pelvis to the last joint of an ankle in the stance."""
    places, _ = g1.forward(_stance(side)[None], np.eye(3)[None], np.zeros((1, 3)), g1.joints_of(side, "leg"))
    return np.asarray(places[0, -1])


def height() -> float:
    """Metres from the floor to the pelvis of the standing robot."""
    return g1.SOLE - float(_foot("left")[2])


def stand(motion: Motion, hips: Array) -> tuple[Array, Array]:
    """Positions [T, 3] and rotations [T, 3, 3] of the pelvis. hips: [T, 3, 3] our hips, in the robot's axes.

    It faces the mean direction of our hips, over the origin. With legs it moves and tilts as our hips do.
    """
    heading = _heading(hips)
    places = np.tile([0.0, 0.0, height()], (len(motion), 1))
    if not skeletons.has_legs(motion):
        return places, np.tile(heading, (len(motion), 1, 1))
    travel = motion.root_positions - motion.root_positions.mean(axis=0)
    return places + _LEG_SHARE * travel[:, [2, 0, 1]], hips


def _heading(hips: Array) -> Array:
    """[3, 3] the mean rotation of hips [T, 3, 3] about the vertical."""
    ahead = hips[..., 0].mean(axis=0)
    return Rotation.from_euler("z", np.arctan2(ahead[1], ahead[0])).as_matrix()


def reach(side: str, pelvis: Array, places: Array) -> Array:
    """[T, 6] angles of a leg that keep its foot flat in place under a pelvis with positions `places` [T, 3] and
    rotations `pelvis` [T, 3, 3]: damped Gauss-Newton on position and rotation of the foot, all frames at once."""
    leg = g1.joints_of(side, "leg")
    goal, turned = _goal(side, pelvis)
    low = np.where([g1.NAMES[index].endswith("knee_joint") for index in leg], _STRAIGHT, g1.LOW[leg])
    angles = np.tile(_stance(side), (len(pelvis), 1))
    lines = np.array([g1.AXES[g1.JOINTS[index].axis] for index in leg])  # [6, 3] in their links' axes
    for _ in range(_STEPS):
        spots, turns = g1.forward(angles, pelvis, places, leg)
        miss = np.concatenate([goal - spots[:, -1], Rotation.from_matrix(
            turned @ np.swapaxes(turns[:, -1], -1, -2)).as_rotvec()], axis=-1)
        if np.abs(miss).max() < 1e-9:
            break
        hinges = np.einsum("tnij,nj->tni", turns, lines)
        slope = np.concatenate([np.cross(hinges, spots[:, -1:] - spots), hinges], axis=-1).swapaxes(-1, -2)
        back = slope.swapaxes(-1, -2)
        step = np.linalg.solve(back @ slope + _DAMPING * np.eye(len(leg)), back @ miss[..., None])[..., 0]
        angles[:, leg] = np.clip(angles[:, leg] + np.clip(step, -_LEAP, _LEAP), low, g1.HIGH[leg])
    return np.asarray(angles[:, leg])


def _goal(side: str, pelvis: Array) -> tuple[Array, Array]:
    """Target of the last joint of an ankle: position [3] in metres and axes [3, 3]."""
    heading = _heading(pelvis)
    return heading @ _foot(side) + np.array([0.0, 0.0, height()]), heading


def off_its_place(side: str, angles: Array, pelvis: Array, places: Array) -> Array:
    """[T] displacement of a foot in metres. angles: [T, 29] radians."""
    leg = g1.joints_of(side, "leg")
    spots, _ = g1.forward(angles, pelvis, places, leg)
    return np.asarray(np.linalg.norm(spots[:, -1] - _goal(side, pelvis)[0], axis=-1))
