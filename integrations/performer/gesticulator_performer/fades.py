"""How what is left of one motion fades out under the next."""

import numpy as np

from data_module.motion.kinematics import fade_weights
from data_module.types import Array


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
