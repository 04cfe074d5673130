"""Training in several processes started by `torchrun`, on one or more machines.

Each process takes its rows of every batch (`data_module.parallel`), and gradients are summed: the weights follow the
same path as in one process with the whole batch. Random numbers are generated for the whole batch, and each process
takes those of its rows. Everything but training steps (k-means, statistics, closed forms, validation, files) is done by
the first process; the others wait and receive the result. In a single process everything here does nothing.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from typing import Any, TypeVar, cast

import torch
from torch import Tensor, nn
from torch import distributed as process_group
from torch.utils._python_dispatch import TorchDispatchMode

from data_module.errors import InputError
from data_module.parallel import rows_of_draws, share, shares, sharing

T = TypeVar("T")

_PATIENCE = timedelta(hours=12)
"""Timeout while the first process labels a corpus or validates; torchrun itself ends all processes when one dies."""
_leading = False
"""Whether the first process is working for all, during which nothing may wait for the others."""


def expected() -> int:
    """Number of processes according to `torchrun`; 1 without it."""
    return int(os.environ.get("WORLD_SIZE", "1"))


@contextlib.contextmanager
def joined(device: str = "cpu") -> Iterator[str]:
    """Join the processes started by `torchrun`; gives the device of this one ("cuda:1"). Does nothing without torchrun.

    InputError if a machine has fewer GPUs than processes.
    """
    if expected() == 1:
        yield device
        return
    place = int(os.environ.get("LOCAL_RANK", "0"))
    if device == "cuda":
        if place >= torch.cuda.device_count():
            local = os.environ.get("LOCAL_WORLD_SIZE", "1")
            raise InputError("--device cuda", f"this machine has {torch.cuda.device_count()} GPUs for {local} "
                             "processes", "start fewer with --nproc_per_node")
        device = f"cuda:{place}"
        torch.cuda.set_device(place)
    # gloo carries Python objects and CPU tensors, NCCL the gradients on GPUs.
    process_group.init_process_group("cpu:gloo,cuda:nccl" if device != "cpu" else "gloo", timeout=_PATIENCE)
    try:
        yield device
    finally:
        process_group.destroy_process_group()


def _in_group() -> bool:
    return process_group.is_available() and process_group.is_initialized()


def processes() -> int:
    """Number of processes that share a training step."""
    return process_group.get_world_size() if _in_group() and not _leading else 1


def leads() -> bool:
    """Whether this process writes files and prints messages."""
    return not _in_group() or process_group.get_rank() == 0


# ------------------------------------------------------------------------------------------- done once, by the first

@contextlib.contextmanager
def _by_itself() -> Iterator[None]:
    global _leading
    _leading = True
    try:
        yield
    finally:
        _leading = False


def lead(work: Callable[[], T]) -> T:
    """The result of `work`, computed by the first process and sent to the others. If it fails, the others exit too:
    SystemExit with the exit code of the first process, which prints the error."""
    if processes() == 1:
        return work()
    outcome: list[Any] = [None, None]
    try:
        if leads():
            with _by_itself():
                outcome[1] = work()
    except BaseException as error:
        outcome[0] = 2 if isinstance(error, InputError) else 1
        raise
    finally:
        process_group.broadcast_object_list(outcome, device=torch.device("cpu"))
    if outcome[0] is not None:
        raise SystemExit(outcome[0])
    return cast(T, outcome[1])


def lead_first(work: Callable[[], T]) -> T:
    """The result of `work`, computed by the first process and then by the others, which find the files it has
    written."""
    if processes() == 1:
        return work()
    results: list[T] = []
    lead(lambda: results.append(work()))
    if not results:
        with _by_itself():
            results.append(work())
    return results[0]


def lead_model(model: nn.Module, work: Callable[[], Any]) -> None:
    """Apply `work`, which changes a model's state, in the first process and copy the state to the others."""
    def changed() -> None:
        work()

    lead(changed)
    spread(model)


@torch.no_grad()
def spread(model: nn.Module) -> None:
    """Copy the first process's weights to all."""
    if processes() > 1:
        for value in model.state_dict().values():
            process_group.broadcast(value, 0)


# ----------------------------------------------------------------------------------------------------- a training step

@contextlib.contextmanager
def dividing() -> Iterator[None]:
    """Context in which a batch is divided among the processes: its rows, its sums, and its random numbers."""
    alone = processes() == 1
    with contextlib.nullcontext() if alone else sharing(process_group.get_rank(), processes()):
        yield


@contextlib.contextmanager
def batch_draws() -> Iterator[None]:
    """Context in which random numbers are those of this process's rows of the batch."""
    if shares() == 1:
        yield
        return
    # The fused attention kernels generate their dropout internally, which cannot be divided.
    with BatchDraws(), nn.attention.sdpa_kernel(nn.attention.SDPBackend.MATH):
        yield


def backward(total: Tensor, parameters: Sequence[Tensor]) -> None:
    """Compute the gradients of a loss computed while `dividing`, identical in all processes."""
    count = processes()
    if count == 1:
        total.backward()
        return
    # `total` is already that of the whole batch in every process, so the sum of the gradients counts it `count`
    # times.
    (total / count).backward()
    dense = [p.grad for p in parameters if p.grad is not None and not p.grad.is_sparse]
    if dense:
        # One message for all gradients: many small ones cost more latency than bandwidth.
        together = torch.cat([gradient.flatten() for gradient in dense])
        process_group.all_reduce(together)
        for gradient, summed in zip(dense, together.split([g.numel() for g in dense]), strict=True):
            gradient.copy_(summed.view_as(gradient))
    for parameter in parameters:
        if parameter.grad is not None and parameter.grad.is_sparse:
            parameter.grad = _sparse_sum(parameter.grad)


def _sparse_sum(gradient: Tensor) -> Tensor:
    """The sum of the processes' sparse gradients [N, D], each with different rows."""
    rows, values = gradient._indices()[0], gradient._values()
    counts = torch.zeros(processes(), dtype=torch.long, device=rows.device)
    counts[process_group.get_rank()] = len(rows)
    process_group.all_reduce(counts)
    most, sizes = int(counts.max()), counts.tolist()
    parts = []
    for part in (rows, values):
        # all_gather needs equal shapes, so shorter parts are padded and cut again.
        padded = part.new_zeros(most, *part.shape[1:])
        padded[:len(part)] = part
        every = [torch.empty_like(padded) for _ in sizes]
        process_group.all_gather(every, padded)
        parts.append(torch.cat([rows_of[:size] for rows_of, size in zip(every, sizes, strict=True)]))
    return torch.sparse_coo_tensor(parts[0][None], parts[1], gradient.shape, check_invariants=False)


def mean(figures: dict[str, float]) -> dict[str, float]:
    """The mean of each figure over all processes."""
    if processes() == 1:
        return figures
    values = torch.tensor(list(figures.values()), dtype=torch.float64)
    process_group.all_reduce(values)
    return dict(zip(figures, (values / processes()).tolist(), strict=True))


_aten = torch.ops.aten
_SIZED = {_aten.rand.default: 0, _aten.randn.default: 0, _aten.randint.default: 1, _aten.randint.low: 2}
"""Random functions with a size -> position of the size argument."""
_ALIKE = {_aten.rand_like.default, _aten.randn_like.default, _aten.randint_like.default, _aten.randint_like.low_dtype}
"""Random functions with the shape of another tensor."""
_FILLED = {_aten.bernoulli_.float, _aten.exponential_.default, _aten.uniform_.default, _aten.normal_.default}
"""Random functions that fill a tensor."""


class BatchDraws(TorchDispatchMode):
    """Generates every random tensor for the whole batch, as a single process would, and narrows it to this process's
    rows,
    so that the noise of a row does not depend on the process that computes it.

    A process with n rows (of the batch, or of a flattened form of it) gets rows n * share to n * (share + 1) of n *
    shares. The cost of generating all rows is small compared with the layers.
    """

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if rows_of_draws() is None:
            return func(*args, **kwargs)
        if func in _SIZED:
            place = _SIZED[func]
            size = list(args[place])
            # Generate the numbers of all rows, then keep ours: a row's noise does not depend on the division.
            size[self._rows(size)] *= shares()
            return self._own(func(*args[:place], size, *args[place + 1:], **kwargs))
        if func in _ALIKE:
            return self._own(func(_whole(args[0], self._rows(args[0].shape)), *args[1:], **kwargs))
        if func in _FILLED:
            drawn = func(_whole(args[0], self._rows(args[0].shape)), *args[1:], **kwargs)
            return args[0].copy_(self._own(drawn))
        if func is _aten.native_dropout.default and args[1] and args[2]:
            mask = self._own(func(torch.ones_like(_whole(args[0], self._rows(args[0].shape))), *args[1:])[1])
            return args[0] * mask / (1 - args[1]), mask
        if func is _aten.multinomial.default and args[1] == 1:  # as in torch: by an exponential race
            race = _whole(args[0], self._rows(args[0].shape)).exponential_(1.0)
            return (args[0] / self._own(race)).argmax(-1, keepdim=True)
        return func(*args, **kwargs)

    @staticmethod
    def _rows(shape: Sequence[int]) -> int:
        rows = rows_of_draws() or 0
        if len(shape) <= rows:
            raise ValueError(f"a random tensor of shape {tuple(shape)} has no rows of the batch")
        return rows

    @staticmethod
    def _own(whole: Tensor) -> Tensor:
        rows = rows_of_draws() or 0
        count = whole.shape[rows] // shares()
        return whole.narrow(rows, share() * count, count)


def _whole(part: Tensor, rows: int) -> Tensor:
    """An empty tensor like `own` but with all rows and the same memory layout: random functions fill memory in
    order."""
    size = list(part.shape)
    size[rows] *= shares()
    strides = part.stride()
    order = sorted(range(part.dim()), key=lambda axis: -strides[axis])
    laid = torch.empty([size[axis] for axis in order], dtype=part.dtype, device=part.device)
    return laid.permute([order.index(axis) for axis in range(part.dim())])
