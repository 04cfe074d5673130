"""Products of few rows with the weights of a layer, as a live block needs them on a CPU.

torch (MKL) copies all of a weight before it multiplies, so that one row takes as long as sixteen. NumPy's BLAS does not
for products as small as those here, of `_COLUMNS` columns at a time: they take a third of the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

__all__ = ["Linear", "Product", "few", "products_of", "version"]

_COLUMNS = 32
"""Columns of a product."""
_MOST = (1 << 18) // _COLUMNS
"""Numbers in the rows: up to these the BLAS uses one thread for a product, as more would wait for each other."""

_LEAST = 1 << 15
"""Numbers in a weight: with fewer the call takes longer than the product."""


def few(rows: Tensor) -> bool:
    """Whether `Product` is faster for these rows: they are few, in single precision and on a CPU, and need no
    gradient."""
    return (rows.numel() <= _MOST and rows.device.type == "cpu" and rows.dtype is torch.float32
            and not torch.is_grad_enabled() and not torch.is_autocast_enabled("cpu"))


class Product:
    """x W^T + b of few rows x [M, K] on a CPU, for the weight W [N, K] and the bias b [N] of a layer."""

    def __init__(self, weight: Tensor, bias: Tensor | None = None) -> None:
        """The weight is copied: a later change has no effect."""
        self._width, depth = weight.shape
        columns = nn.functional.pad(weight.detach(), (0, 0, 0, -self._width % _COLUMNS))
        self._columns = columns.view(-1, _COLUMNS, depth).transpose(1, 2).contiguous().numpy()
        self._bias = None if bias is None else bias.detach().clone().numpy()

    def __call__(self, rows: Tensor) -> Tensor:
        """[M, N] of rows [M, K] for which `few` holds."""
        count, blocks = len(rows), len(self._columns)
        out = np.empty((count, blocks, _COLUMNS), np.float32)
        np.matmul(rows.detach().numpy(), self._columns, out=out.transpose(1, 0, 2))
        made = out.reshape(count, -1)
        if blocks * _COLUMNS > self._width:
            made = made[:, :self._width].copy()
        if self._bias is not None:
            made += self._bias
        return torch.from_numpy(made)


def version(tensors: Iterable[Tensor]) -> list[tuple[int, int]]:
    """What tells whether any of these tensors has been changed or replaced."""
    return [(one.data_ptr(), 0 if one.is_inference() else one._version) for one in tensors]


def products_of(module: nn.Module, layers: Sequence[tuple[Tensor, Tensor | None]]) -> list[Product]:
    """The `Product` of each weight and bias of a module, cached until they change."""
    now = version(one for pair in layers for one in pair if one is not None)
    held: tuple[object, list[Product]] | None = module.__dict__.get("_products")
    if held is None or held[0] != now:
        with torch.inference_mode(False), torch.no_grad():
            held = now, [Product(*pair) for pair in layers]
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
