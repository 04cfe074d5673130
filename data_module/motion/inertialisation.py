"""Inertialisation, and the minimum-jerk step: seamless transitions from one motion to another."""

from __future__ import annotations

import numpy as np

from data_module.types import Array


def minimum_jerk(s: Array) -> Array:
    """The minimum-jerk step s^3 (10 - 15 s + 6 s^2) from 0 to 1, for s within [0, 1]."""
    return s ** 3 * (10.0 - 15.0 * s + 6.0 * s * s)


def fade_weights(s: Array) -> tuple[Array, Array, Array]:
    """The quintic by which what remains of an old motion fades over s from 0 to 1: the factors, shaped like s, on its
    position, its velocity and its acceleration (time in units of the fade). With s3 for the cube of s:

        1 - 10 s3 + 15 s4 - 6 s5,   s - 6 s3 + 8 s4 - 3 s5,   (s2 - 3 s3 + 3 s4 - s5) / 2

    Each begins with its own derivative at 1 and the two others at 0, and ends with all three at 0.
    """
    s2, s3, s4, s5 = s ** 2, s ** 3, s ** 4, s ** 5
    return (1.0 - 10.0 * s3 + 15.0 * s4 - 6.0 * s5, s - 6.0 * s3 + 8.0 * s4 - 3.0 * s5,
            0.5 * (s2 - 3.0 * s3 + 3.0 * s4 - s5))


def quintic_offset(before: Array, target: Array, times: Array, fade: float, fps: float) -> Array:
    """[M, D] the offset to add to the new motion at `times`: the gap to the old motion, its velocity and acceleration
    fade to zero (`fade_weights`).

    before: [3, D] the last frames of the old motion; target: [3, D] the new motion at the same three frames. times: [M]
    seconds of the new frames, the first one frame after `before`. fade: seconds until the offset is zero. Zeros if
    `before` holds fewer than three frames.
    """
    if len(before) < 3:
        return np.zeros((len(times), target.shape[1]))
    gap = before - target
    v, a = (gap[2] - gap[1]) * fps, (gap[2] - 2.0 * gap[1] + gap[0]) * fps * fps
    place, velocity, acceleration = fade_weights(np.clip((times - times[0] + 1.0 / fps) / fade, 0.0, 1.0)[:, None])
    return gap[2] * place + v * fade * velocity + a * fade * fade * acceleration
