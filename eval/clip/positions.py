"""Files of positions, of which only the directions of bones count: TED's joints in one array, or points by joint."""

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.arrays import as_floats, read_npy, read_npz
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.representation import CROWN_OFFSET, NOSE_OFFSET, TED_JOINTS, rotations_from_positions
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion

POINTS = ("Waist", "Neck", "Head", "LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand")
"""Joints of a file of points: the waist half way up the back, the neck between the shoulders, the head where it sits on
the neck, the left at +X. Others are not read."""
_EPS = 1e-9
_FARTHEST = 1e9
"""Units, whichever they are, of a position: a thousand kilometres in millimetres."""


def read_positions(path: str | os.PathLike[str], fps: float) -> Motion:
    """Positions [T, 10, 3] of TED's joints as motion of the 16-joint character; InputError for anything else."""
    points = _checked(path, read_npy(path), TED_JOINTS)
    # Turned about the vertical so that the shoulders on the whole lie along X.
    across = (points[:, 4] - points[:, 7]).mean(axis=0)
    yaw = rotation.from_exponential_map(np.array([0.0, np.arctan2(across[2], across[0]), 0.0]))
    return rotations_from_positions(rotation.rotate(yaw, points), fps)


def read_points(path: str | os.PathLike[str], fps: float) -> Motion:
    """Positions [T, 3] by joint (`POINTS`) as motion of the 16-joint character, whose head goes with the neck and is
    `absent`; InputError for anything else."""
    held = read_npz(path, POINTS)
    if set(held) != set(POINTS) or len({array.shape for array in held.values()}) > 1:
        raise InputError(path, "has other joints, or not the same frames of each",
                         f"it should hold {', '.join(POINTS)}, [T, 3] each")
    points = _checked(path, np.stack([held[name] for name in POINTS], axis=-2), POINTS)
    waist, neck, head, left, right = (points[:, POINTS.index(name)]
                                      for name in ("Waist", "Neck", "Head", "LeftArm", "RightArm"))
    # No point says where the head looks: a nose and a crown that stand on it as the chest does decide nothing.
    up, ahead = (way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), _EPS)
                 for way in (neck - waist, np.cross(left - right, neck - waist)))
    motion = rotations_from_positions(np.stack(
        [waist, neck, head + NOSE_OFFSET[1] * up + NOSE_OFFSET[2] * ahead,
         head + CROWN_OFFSET[1] * up + CROWN_OFFSET[2] * ahead, *points.swapaxes(0, 1)[3:]], axis=1), fps)
    motion.rotations[:, CHARACTER.index("Head")] = (1.0, 0.0, 0.0, 0.0)
    return replace(motion, absent=(*motion.absent, "Head"))


def _checked(path: str | os.PathLike[str], points: NDArray[Any], joints: Sequence[str]) -> Array:
    """Positions [T, J, 3] of a file in double precision."""
    if points.dtype.kind not in "fiu" or points.shape[1:] != (len(joints), 3) or len(points) == 0:
        raise InputError(path, f"has {points.dtype} of shape {points.shape}",
                         f"it should be numbers, [T, {len(joints)}, 3], of {', '.join(joints)}")
    points = as_floats(points)
    # NaN fails the comparison, too. Joints in one place have no bones.
    if not (np.abs(points) < _FARTHEST).all() or not (np.ptp(points, axis=1) > _EPS).any(1).all():
        raise InputError(path, "has positions that are not numbers, far too large or all in one place",
                         "fill or cut these frames")
    return points
