"""The pose input of an interpreter: last pose, velocity and acceleration of the previous block."""

from __future__ import annotations

import torch
from torch import Tensor

FRAMES = 3
"""Frames needed for an acceleration."""


def pose_of(past: Tensor, durations: Tensor | None = None) -> Tensor:
    """[..., 3 D_m]: the last pose of the previous block, its velocity and its acceleration, in the time of this block.

    past: [..., K, D_m] normalised features of the previous block; durations: [..., 2] seconds of the previous and this
    block, equal if None. Every block has K frames, so with the ratio r = this / previous

        v = K r (x_K - x_{K-1}),    a = K r^2 (x_K - 2 x_{K-1} + x_{K-2}):

    v is the displacement over this block at that speed, a the change of v per frame, both in normalised units.
    ValueError for a block of fewer than three frames.
    """
    frames = past.shape[-2]
    if frames < FRAMES:
        raise ValueError(f"a velocity and an acceleration take {FRAMES} frames, and blocks here have {frames}")
    earlier, before, last = past[..., -3, :], past[..., -2, :], past[..., -1, :]
    ratio = past.new_ones(1) if durations is None else (durations[..., 1:] / durations[..., :1]).to(past)
    velocity = frames * ratio * (last - before)
    return torch.cat([last, velocity, frames * ratio ** 2 * (last - 2 * before + earlier)], dim=-1)
