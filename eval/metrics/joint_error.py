"""MAJE and MAD: how far the joints are from where the speaker's own were (RG 7.3.2, RACER 5.3).

Theory: MAJE is the mean absolute error of the joint positions, in mm; MAD the mean l2 norm of the difference between
the accelerations, in mm/s^2. Both are 0 for the speaker's own motion, and less is better. The papers give no formula
and others compute them in two ways each, so that figures of one name are not of one thing. Here:

- for MAJE the mean of the absolute values of the three coordinates, as public code has it; the length of the vector
  would be larger by a factor of sqrt(3) to 3. For MAD the length, as the papers say;
- acceleration in mm/s^2, divided by dt^2 as the unit says, and per squared frame, not divided, as public code has it.
  The papers print 0.5 to 4 "mm/s^2", which no moving hand keeps to: those are to be compared with the latter.

What fools them: they reward one answer where many are right. For MAJE the mean pose of the speaker, held still, beats
lively motion that is out of step, and for MAD any motion that keeps still beats any that moves with the right vigour at
other times. So neither tells good from bad among systems that gesture freely; give them beside the still mean pose. On
one real take (BEAT, pieces of 2.5 s at 60 fps) the motion of another moment has a MAJE of 34 mm and a MAD of
2483 mm/s^2, the motion reversed 26 and 2728, the mean pose 17 and 1455. With 2 cm of jitter it has 14 mm, the best of
these, and a MAD eighty times larger. MAD grows with the frame rate where motion is rough: compare at one rate only. A
root held in place would count as a joint that is always right: `motion_error` leaves it out.

A joint that is 3 mm off along one axis, at rest:

    >>> off = np.zeros((4, 1, 3)); off[..., 0] = 0.003
    >>> error = joint_error(off, np.zeros((4, 1, 3)), 30.0)
    >>> round(error.maje, 6), error.mad
    (1.0, 0.0)
"""

import math
from dataclasses import dataclass

import numpy as np

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import facing, upper_body
from data_module.types import Array, Motion

__all__ = ["JointError", "joint_error", "motion_error"]

MILLIMETRES = 1000.0
"""Per metre."""
_SAME_BONE = 1e-6  # metres


@dataclass(frozen=True)
class JointError:
    """Errors of one clip; NaN where nothing is to be compared, and `reason` says why.

    maje: mm, mean over coordinates (public code). mad: mm/s^2, mean length of a joint's acceleration error (RG 7.3.2);
    mad_per_frame: the same in mm per squared frame, as the published figures are.
    """

    maje: float
    mad: float
    mad_per_frame: float
    reason: str = ""


def joint_error(generated: Array, truth: Array, fps: float) -> JointError:
    """MAJE and MAD of positions [T, J, 3] in metres against the speaker's, at `fps` frames a second (RG 7.3.2).

    ValueError for shapes that differ, for an fps that is not positive, and for positions that are not finite.
    """
    places, reference = np.asarray(generated, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if places.shape != reference.shape or places.ndim != 3 or places.shape[2] != 3:
        raise ValueError(f"positions must both be [T, J, 3], not {places.shape} and {reference.shape}")
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"fps must be positive, not {fps}")
    error = MILLIMETRES * (places - reference)
    if not np.isfinite(error).all():
        raise ValueError("positions must be finite")
    # The acceleration errors are those of the error itself: differences are linear.
    braking = np.diff(error, n=2, axis=0)
    maje = float(np.abs(error).mean()) if error.size else math.nan
    mad = float(np.linalg.norm(braking, axis=-1).mean()) if braking.size else math.nan
    reason = "" if braking.size else "fewer than three frames" if error.size else "no joint is known in any frame"
    return JointError(maje, mad * fps ** 2, mad, reason)


def motion_error(generated: Motion, truth: Motion) -> JointError:
    """MAJE and MAD of a motion against the speaker's own, on the same skeleton, frame by frame.

    Of the character the 16 joints count, with fingers or without. Both are brought into their own facing frame with the
    root at the origin, as the models see them (RG 4.1.1). Joints that either source lacks do not count, nor does the
    root. ValueError when skeletons, lengths or frame rates differ: crop or resample first, and say so.
    """
    generated, truth = upper_body(generated), upper_body(truth)
    if not generated.skeleton.same_joints(truth.skeleton) or not np.allclose(
            generated.skeleton.offsets[1:], truth.skeleton.offsets[1:], rtol=0, atol=_SAME_BONE):
        raise ValueError("the motions are not of the same skeleton: their bodies would be compared, not their motion")
    if len(generated) != len(truth) or generated.fps != truth.fps:
        raise ValueError(f"{len(generated)} frames at {generated.fps} fps cannot be compared with {len(truth)} at "
                         f"{truth.fps}")
    # The root is at the origin in both, without error by construction.
    absent = {*generated.absent, *truth.absent, truth.skeleton.names[0]}
    known = [joint for joint, name in enumerate(truth.skeleton.names) if name not in absent]
    # Seen from the hips: the papers judge gestures, not where the speaker stands.
    first, second = (positions_of(facing(motion))[:, known] for motion in (generated, truth))
    return joint_error(first, second, truth.fps)
