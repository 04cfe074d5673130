"""Inertialisation, and the minimum-jerk step: seamless transitions from one motion to another."""

from __future__ import annotations

import numpy as np

from data_module.types import Array


def minimum_jerk(s: Array) -> Array:
    """The minimum-jerk step s^3 (10 - 15 s + 6 s^2) from 0 to 1, for s within [0, 1]."""
    return s ** 3 * (10.0 - 15.0 * s + 6.0 * s * s)


def quintic_offset(before: Array, target: Array, times: Array, fade: float, fps: float) -> Array:
    """[M, D] the offset to add to the new motion at `times`: the gap to the old motion, its velocity and acceleration
    fade to zero by a quintic.

    before: [3, D] the last frames of the old motion; target: [3, D] the new motion at the same three frames. times: [M]
    seconds of the new frames, the first one frame after `before`. fade: seconds until the offset is zero. With s = t /
    fade, x = x0 (1 - 10 s3 + 15 s4 - 6 s5) + v0 fade (s - 6 s3 + 8 s4 - 3 s5) + a0 fade2 / 2 (s2 - 3 s3 + 3 s4 - s5).
    Zeros if `before` holds fewer than three frames.
    """
    if len(before) < 3:
        return np.zeros((len(times), target.shape[1]))
    gap = before - target
    x, v = gap[2], (gap[2] - gap[1]) * fps
    a = (gap[2] - 2.0 * gap[1] + gap[0]) * fps * fps
    s = np.clip((times - times[0] + 1.0 / fps) / fade, 0.0, 1.0)[:, None]
    s2, s3, s4, s5 = s ** 2, s ** 3, s ** 4, s ** 5
    return (x * (1.0 - 10.0 * s3 + 15.0 * s4 - 6.0 * s5) + v * fade * (s - 6.0 * s3 + 8.0 * s4 - 3.0 * s5)
            + 0.5 * a * fade * fade * (s2 - 3.0 * s3 + 3.0 * s4 - s5))
