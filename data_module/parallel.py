"""Distributed training: the division of a batch among processes, and sums over the whole batch.

A batch is divided among the processes by rows. A loss that averages over rows, masked or not, or compares rows with
each other, uses `batch_ratio`, `batch_mean`, `batch_moments`, `batch_sum` or `batch_rows`. With one process, and
outside of a training step, these are plain sums, means and rows.

Every process computes the same loss from them. The trainer (`gesticulator.training.distributed`) starts each backward
pass with 1 / processes and sums the gradients; sums over processes are also sums in the backward pass. A part of a loss
that is the same in all processes thus counts once, and one from the process's rows counts as a mean.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor

from data_module.errors import InputError

F = TypeVar("F", bound=Callable[..., Any])


@dataclass
class _Sharing:
    """The number of processes that share the current batch, the index of this one, and the dimension of rows in random
    tensors, None if all processes draw the same."""

    rank: int = 0
    size: int = 1
    rows: int | None = 0


_sharing = _Sharing()


@contextmanager
def sharing(rank: int, size: int) -> Iterator[None]:
    """Divide the current batch among `size` processes, of which this is number `rank`."""
    before = _sharing.rank, _sharing.size
    _sharing.rank, _sharing.size = rank, size
    try:
        yield
    finally:
        _sharing.rank, _sharing.size = before


def shares() -> int:
    """Number of processes that share the current batch."""
    return _sharing.size


def share() -> int:
    return _sharing.rank


@contextmanager
def draws_along(dimension: int | None) -> Iterator[None]:
    """Set the dimension of the batch's rows in random tensors (by default the first); None: they are of the whole
    batch, and the same in every process."""
    before, _sharing.rows = _sharing.rows, dimension
    try:
        yield
    finally:
        _sharing.rows = before


def rows_of_draws() -> int | None:
    """The dimension of the batch's rows in random tensors; None for none."""
    return _sharing.rows


def own_rows(count: int) -> slice:
    """This process's part of `count` rows of a batch. InputError if they cannot be divided evenly."""
    if count % _sharing.size:
        raise InputError(f"a batch of {count}", f"cannot be divided among {_sharing.size} processes",
                         "choose a batch that is a multiple of the processes")
    rows = count // _sharing.size
    return slice(_sharing.rank * rows, (_sharing.rank + 1) * rows)


class _Sum(torch.autograd.Function):
    """The sum over processes, forward and backward."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        total = values.detach().clone(memory_format=torch.contiguous_format)
        torch.distributed.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return _Sum.forward(ctx, gradients[0])


class _Rows(torch.autograd.Function):
    """The rows of all processes concatenated; backward, the sum of their gradients for the rows of this one."""

    @staticmethod
    def forward(ctx: Any, values: Tensor) -> Tensor:
        ctx.rows = slice(_sharing.rank * len(values), (_sharing.rank + 1) * len(values))
        parts = [torch.empty_like(values, memory_format=torch.contiguous_format) for _ in range(_sharing.size)]
        torch.distributed.all_gather(parts, values.detach().contiguous())
        return torch.cat(parts)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return _Sum.forward(ctx, gradients[0])[ctx.rows]


def batch_sum(values: Tensor) -> Tensor:
    """[...] the sum over all processes."""
    return values if _sharing.size == 1 else _Sum.apply(values)


def batch_rows(values: Tensor) -> Tensor:
    """[B, ...] the rows of the whole batch, from this process's [B / processes, ...]."""
    return values if _sharing.size == 1 else _Rows.apply(values)


def batch_ratio(total: Tensor, count: Tensor) -> Tensor:
    """[] total / max(count, 1), both summed over the whole batch: a mean with a mask."""
    if _sharing.size == 1:
        return total / count.clamp_min(1.0)
    total, count = batch_sum(torch.stack([total, count.to(total)])).unbind()
    return total / count.clamp_min(1.0)


def batch_mean(values: Tensor) -> Tensor:
    """[] the mean of all elements of the whole batch; processes may have different numbers of them."""
    if _sharing.size == 1:
        return values.mean()
    return batch_ratio(values.sum(), values.new_full((), values.numel()))


def batch_moments(rows: Tensor) -> tuple[Tensor, Tensor, int]:
    """Mean [D] and biased variance [D] of the rows [B, D] of the whole batch, and their number; processes may have
    different numbers of rows."""
    if _sharing.size == 1:
        return rows.mean(0), rows.var(0, unbiased=False), len(rows)
    total = batch_sum(torch.cat([rows.sum(0), rows.new_full((1,), len(rows))]))
    count = total[-1].detach()
    # In two passes, as E[x^2] - E[x]^2 loses its digits where the mean is large.
    mean = total[:-1] / count.clamp_min(1.0)
    return mean, batch_sum((rows - mean).square().sum(0)) / count.clamp_min(1.0), int(count)


def full_precision(function: F) -> F:
    """Compute a function of tensors in single precision under `torch.autocast` too, because nearest neighbours and
    targets of losses must not be rounded to three digits."""

    @functools.wraps(function)
    def precise(*args: Any, **kwargs: Any) -> Any:
        device = next((value.device.type for value in args if isinstance(value, Tensor)), "cpu")
        if not torch.is_autocast_enabled(device):
            return function(*args, **kwargs)
        # Inputs computed under autocast are in half precision already: widening them keeps the further steps exact.
        widened = [value.float() if isinstance(value, Tensor) and value.dtype in _NARROW else value for value in args]
        with torch.autocast(device, enabled=False):
            return function(*widened, **kwargs)

    return precise  # type: ignore[return-value]


_NARROW = (torch.bfloat16, torch.float16)
