"""Training in several processes started by `torchrun`, on one or more machines.

`gesticulator.training.fit` wraps a model in DistributedDataParallel: each process draws its share of a batch and
computes its loss, and the gradients are averaged. Everything else (corpora, k-means, closed forms) is computed by the
first process, then by the others, which read the files that it has left. In a single process nothing here has an
effect.
"""

import contextlib
import os
from collections.abc import Iterator
from datetime import timedelta
from typing import Any, TypeVar, cast

import torch
from torch import distributed as process_group

from data_module.errors import InputError

T = TypeVar("T")

_PATIENCE = timedelta(hours=12)
"""Timeout while the first process labels a corpus; torchrun itself ends all processes when one dies."""
_in_turn = False
"""Whether processes are taking turns, during which none may wait for another."""


@contextlib.contextmanager
def joined(device: str = "cpu") -> Iterator[str]:
    """Join the processes started by `torchrun`; gives the device of this one ("cuda:1"). Does nothing without torchrun.

    InputError if a machine has fewer GPUs than processes.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield device
        return
    place = int(os.environ.get("LOCAL_RANK", "0"))
    if device == "cuda":
        if place >= torch.cuda.device_count():
            raise InputError("--device cuda", f"this machine has only {torch.cuda.device_count()} GPUs",
                             "start no more processes than that with --nproc_per_node")
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
    return process_group.get_world_size() if _in_group() else 1


def rank() -> int:
    """The number of this process; 0, which writes files and prints messages, without a group."""
    return process_group.get_rank() if _in_group() else 0


@contextlib.contextmanager
def first() -> Iterator[None]:
    """Context that the first process goes through before the others, which find the files it has written. Nested ones
    have no effect: the others, waiting for the outer one, would not come to the inner one."""
    global _in_turn
    if processes() == 1 or _in_turn:
        yield
        return
    if rank():
        _wait()
    _in_turn = True
    try:
        yield
    finally:
        _in_turn = False
    if not rank():
        _wait()


def _wait() -> None:
    # A message instead of a barrier, which would have to know the device of this process.
    agreed(None)


def agreed(value: T) -> T:
    """The value of the first process, for all."""
    if processes() == 1:
        return value
    values: list[Any] = [value]
    process_group.broadcast_object_list(values, device=torch.device("cpu"))
    return cast(T, values[0])
