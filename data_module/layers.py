"""Layers shared by lexicon, generator and interpreters (`data_module.layers_run` plays them)."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from data_module.layers_run import SLOPE


def convolutions(widths: Sequence[int], kernel: int = 3, *, norm: bool = True, last_linear: bool = False
                 ) -> nn.Sequential:
    """1-D convolutions of the same length, widths[0] channels in, widths[-1] out, over [B, D, T]. Each is followed by
    batch normalisation (when `norm`) and LeakyReLU; the last one by neither when `last_linear`."""
    layers: list[nn.Module] = []
    for index, (a, b) in enumerate(pairwise(widths)):
        layers.append(nn.Conv1d(a, b, kernel, padding=kernel // 2))
        if last_linear and index == len(widths) - 2:
            break
        if norm:
            layers.append(nn.BatchNorm1d(b))
        layers.append(nn.LeakyReLU(SLOPE))
    return nn.Sequential(*layers)


class BlockLinear(nn.Module):
    """One fully connected layer from the rows of three consecutive blocks (or of the middle one) to K rows.

    E_A of the paper (RG 5.2, Eq. 17) has the previous, current and next block as input, its FC on text (RG 6.1) only
    T_i: blocks is 3 or 1. bottleneck: width of a projection shared by all rows, which saves most of the weights for
    wide rows; 0 for none (the paper).
    """

    def __init__(self, frames: int, width_in: int, width: int, blocks: int = 3, bottleneck: int = 0) -> None:
        super().__init__()
        if blocks not in (1, 3):
            raise ValueError("blocks must be 1 or 3")
        self.frames, self.width, self.blocks = frames, width, blocks
        self.narrow = nn.Linear(width_in, bottleneck) if bottleneck else None
        self.linear = nn.Linear(blocks * frames * (bottleneck or width_in), frames * width)

    def forward(self, windows: Tensor) -> Tensor:
        """[..., 3K, D] to [..., K, width]."""
        if self.blocks == 1:
            windows = windows[..., self.frames:2 * self.frames, :]
        if self.narrow is not None:
            windows = self.narrow(windows)
        return self.linear(windows.flatten(-2)).unflatten(-1, (self.frames, self.width))


def repeat_frames(vector: Tensor, frames: int) -> Tensor:
    """[..., D] to [..., K, D]: the same vector on every frame of a block."""
    return vector.unsqueeze(-2).expand(*vector.shape[:-1], frames, vector.shape[-1])


def without_after(windows: Tensor, left_out: Tensor) -> Tensor:
    """Windows [B, ..., 3K, D] of the previous, current and next block, with zeros for the next block where left_out
    [B].
    """
    after = torch.arange(windows.shape[-2], device=windows.device) >= windows.shape[-2] * 2 // 3
    where = left_out.reshape(-1, *[1] * (windows.dim() - 1)) & after[:, None]
    return windows.masked_fill(where, 0.0)


def freeze(module: nn.Module) -> nn.Module:
    """Evaluation mode, and no gradient for the weights (gradients still pass to the inputs)."""
    module.eval()
    for parameter in module.parameters():
        parameter.requires_grad_(False)
    return module


def masked_mean(values: Tensor, mask: Tensor | None) -> Tensor:
    """[] mean of values [..., D], weighted by a mask (broadcastable); 0 where the mask is 0 throughout."""
    if mask is None:
        return values.mean()
    weights = mask.to(values.dtype).expand_as(values)
    # At least 1: a batch may hold nothing but padding, and 0 / 0 would end the training.
    return (values * weights).sum() / weights.sum().clamp_min(1.0)
