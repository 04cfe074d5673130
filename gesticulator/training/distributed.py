"""Training in several processes, on one machine or more, as `torchrun` starts them.

Each process takes its rows of every batch (`data_module.parallel`), and the gradients are added up: the weights go the
way that one process with the whole batch would have gone. Random numbers are drawn for the whole batch, and each
process takes those of its rows. What is not a training step (k-means, statistics, closed forms, validation, files) is
done by the first process; the others wait and take over what it found. Alone, everything here does nothing.
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
"""For the first process, which may label a corpus or validate meanwhile; torchrun itself ends all when one dies."""
_leading = False
"""Whether the first process does something for all: nothing that runs meanwhile may wait for the others."""


def expected() -> int:
    """Processes that `torchrun` says there are; 1 without it."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def on_this_machine() -> int:
    """Of these the ones on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))


@contextlib.contextmanager
def joined(device: str = "cpu") -> Iterator[str]:
    """Join the processes that `torchrun` started, for a while; gives the device of this one ("cuda:1").

    InputError where a machine has fewer GPUs than processes. Without torchrun it does nothing.
    """
    if expected() == 1:
        yield device
        return
    place = int(os.environ.get("LOCAL_RANK", "0"))
    if device == "cuda":
        if place >= torch.cuda.device_count():
            raise InputError("--device cuda", f"this machine has {torch.cuda.device_count()} GPUs and is to run "
                             f"{on_this_machine()} processes", "start fewer with --nproc_per_node")
        device = f"cuda:{place}"
        torch.cuda.set_device(place)
    process_group.init_process_group("cpu:gloo,cuda:nccl" if device != "cpu" else "gloo", timeout=_PATIENCE)
    try:
        yield device
    finally:
        process_group.destroy_process_group()


def _in_group() -> bool:
    return process_group.is_available() and process_group.is_initialized()


def processes() -> int:
    """Among how many processes a training step is divided."""
    return process_group.get_world_size() if _in_group() and not _leading else 1


def leads() -> bool:
    """Whether this process writes the files and talks to the user."""
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
    """What `work` gives, done by the first process alone; the others wait for it and get the same. Where it fails they
    end too: SystemExit with the exit code of the first process, as it tells the user why."""
    if processes() == 1:
        return work()
    told: list[Any] = [None, None]
    try:
        if leads():
            with _by_itself():
                told[1] = work()
    except BaseException as error:
        told[0] = 2 if isinstance(error, InputError) else 1
        raise
    finally:
        process_group.broadcast_object_list(told, device=torch.device("cpu"))
    if told[0] is not None:
        raise SystemExit(told[0])
    return cast(T, told[1])


def lead_first(work: Callable[[], T]) -> T:
    """What `work` gives, done by the first process and then by the others, who find the files that it has written."""
    if processes() == 1:
        return work()
    kept: list[T] = []
    lead(lambda: kept.append(work()))
    if not kept:
        with _by_itself():
            kept.append(work())
    return kept[0]


def lead_model(model: nn.Module, work: Callable[[], Any]) -> None:
    """Do to a model what changes its state: the first process does it, and the others take its state over."""
    def changed() -> None:
        work()

    lead(changed)
    spread(model)


@torch.no_grad()
def spread(model: nn.Module) -> None:
    """Give every process the first one's weights."""
    if processes() > 1:
        for value in model.state_dict().values():
            process_group.broadcast(value, 0)


# ----------------------------------------------------------------------------------------------------- a training step

@contextlib.contextmanager
def dividing() -> Iterator[None]:
    """For a while a batch is divided among the processes: its rows, its sums, and what is drawn at random for it."""
    if processes() == 1:
        yield
        return
    with sharing(process_group.get_rank(), processes()):
        yield


@contextlib.contextmanager
def batch_draws() -> Iterator[None]:
    """For a while random numbers are those of the batch's rows that are this process's."""
    if shares() == 1:
        yield
        return
    # The fused kernels of attention draw their dropout inside: no one could divide it.
    with BatchDraws(), nn.attention.sdpa_kernel(nn.attention.SDPBackend.MATH):
        yield


def backward(total: Tensor, parameters: Sequence[Tensor]) -> None:
    """The gradients of a loss that was computed while `dividing`, the same in every process."""
    count = processes()
    if count == 1:
        total.backward()
        return
    (total / count).backward()
    dense = [p.grad for p in parameters if p.grad is not None and not p.grad.is_sparse]
    if dense:
        together = torch.cat([gradient.flatten() for gradient in dense])
        process_group.all_reduce(together)
        for gradient, summed in zip(dense, together.split([g.numel() for g in dense]), strict=True):
            gradient.copy_(summed.view_as(gradient))
    for parameter in parameters:
        if parameter.grad is not None and parameter.grad.is_sparse:
            parameter.grad = _sparse_sum(parameter.grad)


def _sparse_sum(gradient: Tensor) -> Tensor:
    """The sum of the processes' sparse gradients [N, D], in which each has rows of its own."""
    rows, values = gradient._indices()[0], gradient._values()
    counts = torch.zeros(processes(), dtype=torch.long, device=rows.device)
    counts[process_group.get_rank()] = len(rows)
    process_group.all_reduce(counts)
    most, sizes = int(counts.max()), counts.tolist()
    parts = []
    for own in (rows, values):
        filled = own.new_zeros(most, *own.shape[1:])
        filled[:len(own)] = own
        every = [torch.empty_like(filled) for _ in sizes]
        process_group.all_gather(every, filled)
        parts.append(torch.cat([part[:size] for part, size in zip(every, sizes, strict=True)]))
    return torch.sparse_coo_tensor(parts[0][None], parts[1], gradient.shape, check_invariants=False)


def mean(figures: dict[str, float]) -> dict[str, float]:
    """The mean of each figure over the processes."""
    if processes() == 1:
        return figures
    values = torch.tensor(list(figures.values()), dtype=torch.float64)
    process_group.all_reduce(values)
    return dict(zip(figures, (values / processes()).tolist(), strict=True))


_aten = torch.ops.aten
_SIZED = {_aten.rand.default: 0, _aten.randn.default: 0, _aten.randint.default: 1, _aten.randint.low: 2}
"""Draws of a size, which is the argument of that number."""
_ALIKE = {_aten.rand_like.default, _aten.randn_like.default, _aten.randint_like.default,
          _aten.randint_like.low_dtype}
"""Draws in the shape of another tensor."""
_FILLED = {_aten.bernoulli_.float, _aten.exponential_.default, _aten.uniform_.default, _aten.normal_.default}
"""Draws into a tensor that is there."""


class BatchDraws(TorchDispatchMode):
    """Every random tensor is drawn for the whole batch, as one process would draw it, and cut down to the rows of this
    one: the noise of a row does not depend on who computes it.

    A process that has n rows (of the batch, or of anything that the batch was flattened to) is given rows n * share to
    n * (share + 1) of n * shares. Drawing for all is what this costs: it is little beside the layers.
    """

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if rows_of_draws() is None:
            return func(*args, **kwargs)
        if func in _SIZED:
            place = _SIZED[func]
            size = list(args[place])
            size[self._rows(size)] *= shares()
            return self._own(func(*args[:place], size, *args[place + 1:], **kwargs))
        if func in _ALIKE:
            return self._own(func(_whole(args[0], self._rows(args[0].shape)), *args[1:], **kwargs))
        if func in _FILLED:
            drawn = func(_whole(args[0], self._rows(args[0].shape)), *args[1:], **kwargs)
            return args[0].copy_(self._own(drawn))
        if func is _aten.native_dropout.default and args[1] and args[2]:
            kept = self._own(func(torch.ones_like(_whole(args[0], self._rows(args[0].shape))), *args[1:])[1])
            return args[0] * kept / (1 - args[1]), kept
        if func is _aten.multinomial.default and args[1] == 1:  # as torch draws one: by an exponential race
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


def _whole(own: Tensor, rows: int) -> Tensor:
    """An empty tensor like one of this process's rows, of all rows, and laid out in memory alike: a draw fills memory
    in its order."""
    size = list(own.shape)
    size[rows] *= shares()
    strides = own.stride()
    order = sorted(range(own.dim()), key=lambda axis: -strides[axis])
    laid = torch.empty([size[axis] for axis in order], dtype=own.dtype, device=own.device)
    return laid.permute([order.index(axis) for axis in range(own.dim())])
