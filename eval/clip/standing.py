"""How a motion with legs stands: how far planted feet slide, and how far the knees are bent.

Positions of the motion's own joints are measured, Y up. A foot is planted while its ankle and its ball are within
`PLANTED` of the lowest that they are. A knee's bend is the angle between thigh and shin: a skeleton whose bones are not
straight at rest always has some degrees of it. What fools them: a body that is pushed about as a whole slides, and one
that floats has no planted foot and slides nowhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data_module.motion import kinematics
from data_module.motion.skeletons import find_table
from data_module.types import Array, Motion
from eval.stats import runs

__all__ = ["knee_bend", "slide"]

PLANTED = 0.003
"""Metres over its lowest height within which a joint is on the floor."""


def slide(motion: Motion) -> float:
    """Metres over which an ankle or ball goes at most, along the floor, while its foot is planted."""
    positions = kinematics.positions_of(motion)
    places = {name: positions[:, joint] for name, joint in find_table(motion.skeleton.names).items()}
    # The 1st percentile, as a single frame may lie lower by a rounding of the rotations.
    longest = 0.0
    for side in ("Left", "Right"):
        foot = places[side + "Foot"], places[side + "ToeBase"]
        planted: NDArray[np.bool_] = np.logical_and(
            *(part[:, 1] < np.percentile(part[:, 1], 1) + PLANTED for part in foot))
        paths = [part[start:stop, [0, 2]] for part in foot for start, stop in runs(planted)]
        longest = max([longest, *(float(np.linalg.norm(np.ptp(path, axis=0))) for path in paths)])
    return longest


def knee_bend(hip: Array, knee: Array, ankle: Array) -> Array:
    """[T] degrees by which a knee is bent, from the places [T, 3] of its leg's joints."""
    thigh, shin = knee - hip, ankle - knee
    cosine = np.sum(thigh * shin, -1) / (np.linalg.norm(thigh, axis=-1) * np.linalg.norm(shin, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
