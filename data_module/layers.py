"""Layers shared by lexicon, generator and interpreters, and the fast paths for the few rows of a live block."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

SLOPE = 0.2
"""Negative slope of every LeakyReLU."""
# Most rows of a batch for which an LSTM is faster without oneDNN.
_FEW_ROWS = 64
# Columns of a product.
_COLUMNS = 32
# Numbers in the rows: up to these the BLAS uses one thread for a product, as more would wait for each other.
_MOST = (1 << 18) // _COLUMNS
# Numbers in a weight: with fewer the call takes longer than the product.
_LEAST = 1 << 15


def few(rows: Tensor) -> bool:
    """Whether `Product` is faster for these rows: they are few, in single precision and on a CPU, and need no
    gradient."""
    return (rows.numel() <= _MOST and rows.device.type == "cpu" and rows.dtype is torch.float32
            and not torch.is_grad_enabled())


class Product:
    """x W^T + b of few rows x [M, K] on a CPU, for the weight W [N, K] and the bias b [N] of a layer.

    torch (MKL) copies all of a weight before it multiplies, so that one row takes as long as sixteen. NumPy's BLAS does
    not for products as small as those here, of `_COLUMNS` columns at a time: for the rows of a live block they take a
    third to a half of the time.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None = None) -> None:
        """The weight is copied: a later change has no effect."""
        self._width, depth = weight.shape
        # Blocks of columns, each contiguous: the width of a product for which the BLAS copies nothing.
        columns = nn.functional.pad(weight.detach(), (0, 0, 0, -self._width % _COLUMNS))
        self._columns = columns.view(-1, _COLUMNS, depth).transpose(1, 2).contiguous().numpy()
        self._bias = None if bias is None else bias.detach().clone().numpy()

    def __call__(self, rows: Tensor) -> Tensor:
        """[M, N] of rows [M, K] for which `few` holds."""
        count, blocks = len(rows), len(self._columns)
        out = np.empty((count, blocks, _COLUMNS), np.float32)
        np.matmul(rows.detach().numpy(), self._columns, out=out.transpose(1, 0, 2))
        result = out.reshape(count, -1)
        if blocks * _COLUMNS > self._width:
            result = result[:, :self._width].copy()
        if self._bias is not None:
            result += self._bias
        return torch.from_numpy(result)


def version(tensors: Iterable[Tensor]) -> list[tuple[int, int]]:
    """A value that differs once any of these tensors has been changed or replaced: the address of each, and the number
    of its changes in place (0 for inference tensors, which do not count them)."""
    return [(tensor.data_ptr(), 0 if tensor.is_inference() else tensor._version) for tensor in tensors]


def products_of(module: nn.Module, layers: Sequence[tuple[Tensor, Tensor | None]]) -> list[Product]:
    """The `Product` of each weight and bias of a module, cached until they change."""
    now = version(tensor for pair in layers for tensor in pair if tensor is not None)
    held: tuple[object, list[Product], object] | None = module.__dict__.get("_products")
    if held is None or held[0] != now:
        with torch.inference_mode(False), torch.no_grad():
            # As long as the tensors are held, no other one has their addresses.
            held = now, [Product(*pair) for pair in layers], layers
        module.__dict__["_products"] = held
    return held[1]


class Linear(nn.Linear):
    """A linear layer that is fast for few rows, too."""

    def forward(self, input: Tensor) -> Tensor:
        """x W^T + b [..., N] of x [..., K]."""
        if self.in_features * self.out_features < _LEAST or not few(input):
            return super().forward(input)
        product = products_of(self, [(self.weight, self.bias)])[0]
        return product(input) if input.dim() == 2 else \
            product(input.reshape(-1, self.in_features)).view(*input.shape[:-1], -1)


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


def run_lstm(lstm: nn.LSTM, rows: Tensor, hidden: tuple[Tensor, Tensor] | None = None
             ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """`lstm(rows, hidden)` for rows [B, T, W], faster for the few rows of a live block.

    On a CPU torch packs all weights again at each call: 0.3 ms of 0.5 for 8 rows of 192 units. Few rows without
    gradient are therefore computed one by one, by `Product` if they are few enough for that.
    """
    # In training the module itself runs: it has dropout, and kernels for gradients.
    live = rows.shape[0] * rows.shape[1] <= _FEW_ROWS and rows.device.type == "cpu"
    if not live or torch.is_grad_enabled() or lstm.training:
        out, hidden = lstm(rows, hidden)
        return out, hidden
    batch, steps = rows.shape[:2]
    weights = [(weight, bias) for layer in lstm.all_weights for weight, bias in zip(layer[:2], layer[2:], strict=True)]
    maps = products_of(lstm, weights) if few(rows) else [
        functools.partial(functional.linear, weight=weight, bias=bias) for weight, bias in weights]
    ends: list[tuple[Tensor, Tensor]] = []
    for layer in range(lstm.num_layers):
        into, again = maps[2 * layer:2 * layer + 2]
        h, c = (rows.new_zeros(2, batch, lstm.hidden_size) if hidden is None else
                torch.stack([state[layer] for state in hidden])).unbind()
        out = []
        for inputs in into(rows.flatten(0, 1)).view(batch, steps, -1).unbind(1):
            # The order of the gates in torch's weights: input, forget, cell, output.
            enter, forget, new, leave = (inputs + again(h)).chunk(4, -1)
            c = torch.addcmul(enter.sigmoid() * new.tanh(), forget.sigmoid(), c)
            h = leave.sigmoid() * c.tanh()
            out.append(h)
        rows = torch.stack(out, 1)
        ends.append((h, c))
    return rows, (torch.stack([h for h, _ in ends]), torch.stack([c for _, c in ends]))


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
        self.narrow = Linear(width_in, bottleneck) if bottleneck else None
        self.linear = Linear(blocks * frames * (bottleneck or width_in), frames * width)

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


def parameter_count(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


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
