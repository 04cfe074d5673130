"""Batches on a Ray cluster. Ray schedules the tasks and gives that of a worker that died to another one.

A task is a recording. As many are in flight as the cluster has processors, so that they start in their order, the
longest first; a worker process loads the models for its first task and keeps them for the next ones.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

from data_module.errors import InputError, one_line
from data_module.settings import whole_number
from gesticulator.batch import Doing, Maker, ManifestRow, attempted

ATTEMPTS = 3
"""Attempts at a task whose worker dies: the task itself is the likelier cause (memory) than chance."""
_LOCAL = "local:"
_MOST_WORKERS = 10_000
_LOADED: dict[str, Doing] = {}
"""In a worker process: the loaded models, by the identity of their maker."""


def check_ray(given: str) -> None:
    """`InputError` if Ray is not installed or the value of --ray is invalid."""
    if find_spec("ray") is None:
        raise InputError("--ray", "needs Ray, which is not installed", "pip install 'gesticulator[scale]', or use "
                         "--shard")
    if given.startswith(_LOCAL) and not whole_number(given[len(_LOCAL):], _MOST_WORKERS):
        raise InputError(f"--ray {given[:40]}", "is not a number of workers", "write --ray local:4")


def done_on_ray(given: str, make: Maker, rows: Sequence[ManifestRow]) -> Iterator[ManifestRow]:
    """Process the recordings of rows on a cluster; their rows come in the order in which they finish.

    given: "auto" (the cluster running here), the address of a cluster, or "local:N" for N workers on this machine.
    `InputError` if no cluster answers, if it is lost, or if a worker cannot load the models.
    """
    import ray

    # A connection that the caller made stays open afterwards.
    connected = not ray.is_initialized()
    try:
        if connected:
            _connect(ray, given)
        # One processor for a task, because the models use one thread.
        task = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_do)
        workers = int(ray.cluster_resources().get("CPU", 1))
        # In a list, Ray does not fetch it for every task: the maker holds all jobs.
        maker, waiting, running = [ray.put(make)], deque(rows), dict[Any, ManifestRow]()
        while waiting or running:
            while waiting and len(running) < workers:
                row = waiting.popleft()
                running[task.remote(maker, row)] = row
            (reference, *_), _ = ray.wait(list(running))
            yield _done(ray, reference, running.pop(reference))
    except ConnectionError as error:
        raise InputError(f"--ray {given}", f"cannot be reached ({_short(error)})", "check the address, and "
                         "RAY_AUTH_MODE where the cluster has a token; finished recordings are kept") from None
    finally:
        if connected:
            ray.shutdown()


def _connect(ray: Any, given: str) -> None:
    """Connect to a cluster, or start one on this machine."""
    # Workers import packages from the same paths and use one thread each, as on a single machine.
    environment = {name: os.environ[name] for name in ("PYTHONPATH", "GESTICULATOR_DATA") if name in os.environ}
    where: dict[str, Any] = {"address": given}
    if given.startswith(_LOCAL):
        where = {"address": "local", "num_cpus": int(given[len(_LOCAL):]), "include_dashboard": False}
    # Workers must not print into the terminal of the command.
    ray.init(**where, log_to_driver=False, logging_level="ERROR",
             runtime_env={"env_vars": {**environment, "OMP_NUM_THREADS": "1"}})


def _do(maker: list[Any], row: ManifestRow) -> ManifestRow | str:
    """In a worker: process a recording; returns the error message if the models cannot be loaded here."""
    import ray

    # A worker process may outlive a batch: another one has other settings.
    key = maker[0].hex()
    if key not in _LOADED:
        try:
            _LOADED[key] = ray.get(maker[0])()
        except (InputError, OSError) as error:  # not an error of this recording: none could be done here
            return one_line(error)
    return attempted(_LOADED[key], row)


def _done(ray: Any, reference: Any, row: ManifestRow) -> ManifestRow:
    """The row of a task that ended."""
    try:
        result = ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # `_do` reports errors of users itself, so the program differs there
        raise InputError("a worker", f"could not start ({_short(error)})", "install the same program on every machine"
                         ) from None
    except ray.exceptions.RayError as error:
        return replace(row, error=f"its worker died {ATTEMPTS} times ({_short(error)})")
    if isinstance(result, str):
        raise InputError("a worker", f"cannot do its work ({result})", "give all machines the same files")
    return ManifestRow(**vars(result))


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[-120:]
