"""Layers that the sibling models share."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

SLOPE = 0.2
"""Negative slope of every LeakyReLU."""
_FEW_ROWS = 64
"""Of all sequences of a batch together, up to which an LSTM is quicker without oneDNN."""


def convolutions(widths: Sequence[int], kernel: int = 3, *, norm: bool = True, last_linear: bool = False
                 ) -> nn.Sequential:
    """1-D convolutions of the same length, widths[0] channels in, widths[-1] out, over [B, D, T].

    Each is followed by batch normalisation (when `norm`) and LeakyReLU; the last one by neither when `last_linear`.
    """
    layers: list[nn.Module] = []
    for index, (a, b) in enumerate(pairwise(widths)):
        layers.append(nn.Conv1d(a, b, kernel, padding=kernel // 2))
        if last_linear and index == len(widths) - 2:
            break
        if norm:
            layers.append(BatchNorm(b))
        layers.append(nn.LeakyReLU(SLOPE))
    return nn.Sequential(*layers)


class BatchNorm(nn.BatchNorm1d):
    """Batch normalisation over [B, D, T] or [B, D], in training by the moments of the whole batch, also where several
    processes share it."""

    def forward(self, input: Tensor) -> Tensor:
        """The same shape."""
        if not self.training:
            return super().forward(input)
        from data_module.parallel import batch_moments, shares  # only training asks for them

        if shares() == 1:
            return super().forward(input)
        rows = input.transpose(1, 2).flatten(0, 1) if input.dim() == 3 else input
        mean, variance, count = batch_moments(rows)
        with torch.no_grad():
            assert self.running_mean is not None and self.running_var is not None and self.momentum is not None
            assert self.num_batches_tracked is not None
            self.num_batches_tracked += 1
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / max(count - 1, 1)), self.momentum)
        scale = self.weight * (variance + self.eps).rsqrt()
        shift = self.bias - mean * scale
        return input * scale[:, None] + shift[:, None] if input.dim() == 3 else input * scale + shift


def run_lstm(lstm: nn.LSTM, rows: Tensor, hidden: tuple[Tensor, Tensor] | None = None
             ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """What `lstm(rows, hidden)` gives, rows [B, T, W] first in the batch; cheaper for the few rows of a live block.

    On a processor torch packs all weights anew at each call, which then takes most of the time: 0.3 ms of 0.5 for 8
    rows of 192 units. Where there are few rows and no gradient, they are therefore taken one by one.

    Under `torch.autocast` on a processor that has no LSTM in half precision, it is computed in single precision.
    """
    if rows.device.type == "cpu" and torch.is_autocast_enabled("cpu") \
            and not _has_narrow_lstm(torch.get_autocast_dtype("cpu")):
        with torch.autocast("cpu", enabled=False):
            return run_lstm(lstm, rows.float(), None if hidden is None else (hidden[0].float(), hidden[1].float()))
    few = rows.shape[0] * rows.shape[1] <= _FEW_ROWS and rows.device.type == "cpu"
    if not few or torch.is_grad_enabled() or lstm.training:
        out, hidden = lstm(rows, hidden)
        return out, hidden
    ends: list[tuple[Tensor, Tensor]] = []
    for layer, (told_by, remembered_by, bias, bias_too) in enumerate(lstm.all_weights):
        told, again = functional.linear(rows, told_by, bias + bias_too), remembered_by.t()
        h, c = (None, None) if hidden is None else (hidden[0][layer], hidden[1][layer])
        steps = []
        for gates in told.unbind(1):
            into, forget, new, out_of = (gates if h is None else torch.addmm(gates, h, again)).chunk(4, -1)
            added = into.sigmoid() * new.tanh()
            c = added if c is None else torch.addcmul(added, forget.sigmoid(), c)
            h = out_of.sigmoid() * c.tanh()
            steps.append(h)
        assert h is not None and c is not None
        rows = torch.stack(steps, 1)
        ends.append((h, c))
    return rows, (torch.stack([h for h, _ in ends]), torch.stack([c for _, c in ends]))


@functools.cache
def _has_narrow_lstm(dtype: torch.dtype) -> bool:
    """Whether this processor has an LSTM in half precision. oneDNN has linear layers and convolutions in bfloat16
    everywhere, an LSTM only where the processor multiplies in it; there is no other way to know than to try."""
    state, weights = torch.zeros(1, 1, 1), [torch.zeros(4, 1), torch.zeros(4, 1), torch.zeros(4), torch.zeros(4)]
    try:
        with torch.no_grad(), torch.autocast("cpu", dtype):
            torch.lstm(state, (state, state), weights, True, 1, 0.0, True, False, True)
    except RuntimeError:
        return False
    return True


class BlockLinear(nn.Module):
    """One fully connected layer on the rows of three consecutive blocks (or of the middle one), giving K rows.

    E_A of the paper (RG 5.2, Eq. 17) reads the block before, the block itself and the block after; its FC on text
    (RG 6.1) reads T_i alone: blocks is 3 or 1. bottleneck: width that every row is brought to first by one layer that
    all rows share, which saves most of the weights where rows are wide; 0 leaves it out (the paper).
    """

    def __init__(self, frames: int, width_in: int, width: int, blocks: int = 3, bottleneck: int = 0) -> None:
        super().__init__()
        if blocks not in (1, 3):
            raise ValueError("rows are read from 1 block or from 3")
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
    """Windows [B, ..., 3K, D] of the block before, the block and the block after, with zeros for the block after in
    those of the B that are left out [B]."""
    after = torch.arange(windows.shape[-2], device=windows.device) >= windows.shape[-2] * 2 // 3
    where = left_out.reshape(-1, *[1] * (windows.dim() - 1)) & after[:, None]
    return windows.masked_fill(where, 0.0)


def parameter_count(module: nn.Module) -> int:
    """The number of trained values."""
    return sum(p.numel() for p in module.parameters())


def freeze(module: nn.Module) -> nn.Module:
    """Evaluation mode, and no gradient for its own weights (gradients still pass through to its inputs)."""
    module.eval()
    for parameter in module.parameters():
        parameter.requires_grad_(False)
    return module


def masked_mean(values: Tensor, mask: Tensor | None) -> Tensor:
    """Mean of values [..., D] over the entries that `mask` (broadcastable, 0 or 1) keeps, of the whole batch."""
    from data_module.parallel import batch_mean, batch_ratio  # only training asks for them

    if mask is None:
        return batch_mean(values)
    weights = mask.to(values.dtype).expand_as(values)
    return batch_ratio((values * weights).sum(), weights.sum())
