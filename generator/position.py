"""The positional block P (RG Eq. 8)."""

from __future__ import annotations

import torch
from torch import Tensor


def positional_block(frames: int, width: int, beta: float = 10_000.0, direction: str = "forward") -> Tensor:
    """P [K, width]: p(k, 2j) = sin(k / beta^(2j / width)), p(k, 2j + 1) = cos of the same, k = 0..K-1 (RG Eq. 8).

    The paper prints K where the frame index k must stand (its literal form is the same on every frame).
    direction "to_beat" counts the frames that are left to the beat instead.
    """
    if direction not in ("forward", "to_beat"):
        raise ValueError(f"direction must be forward or to_beat, not {direction!r}")
    if width % 2:
        raise ValueError("the positional block needs an even width")
    k = torch.arange(frames, dtype=torch.float64)
    if direction == "to_beat":
        k = k.flip(0)
    rates = beta ** (-torch.arange(0, width, 2, dtype=torch.float64) / width)
    angles = k[:, None] * rates
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(1).float()
