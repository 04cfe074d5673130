"""How far the planted feet of a motion with legs slide.

Positions of the motion's own joints are measured, Y up. A foot is planted while its ankle and its ball are within
`PLANTED` of the lowest that they are. What fools it: a body that is pushed about as a whole slides, and one
that floats has no planted foot and slides nowhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data_module.motion import kinematics
from data_module.motion.skeletons import find_table
from data_module.types import Motion
from eval.stats import runs

__all__ = ["slide"]

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
