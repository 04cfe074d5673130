"""Recordings on a Ray cluster: a model is loaded once in each worker, and a worker that dies is replaced.

Each worker has one recording at a time, so that those that come first are begun first; what a worker was doing when it
died is given to the next one.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

from data_module.errors import InputError
from gesticulator.batch import Doing, Maker, TaskOutcome, attempted

ATTEMPTS = 3
"""How often a recording is tried whose worker dies: more likely it is what kills them (memory) than chance."""
_LOCAL = "local:"


def check_ray(given: str) -> None:
    """`InputError` where Ray is not installed, or what --ray names is none."""
    if find_spec("ray") is None:
        raise InputError("--ray", "needs Ray, which is not installed", "pip install 'gesticulator[scale]', or use "
                         "--shard")
    if given.startswith(_LOCAL) and not (given[len(_LOCAL):].isdecimal() and int(given[len(_LOCAL):])):
        raise InputError(f"--ray {given}", "is no number of workers", "write --ray local:4")


class RayWorker:
    """What a worker of the cluster holds: the models."""

    def __init__(self, make: Maker) -> None:
        self._doing: Doing = make()

    def do(self, number: int) -> TaskOutcome:
        """Do a recording."""
        return attempted(self._doing, number)


def done_on_ray(given: str, make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Do recordings on the cluster; given: "auto" (the one that runs here, else this machine), the address of one, or
    "local:N" for N workers here. What is done comes as it is done. `InputError` where no cluster answers."""
    check_ray(given)
    import ray

    mine = _connect(ray, given)
    try:
        count = int(given[len(_LOCAL):]) if given.startswith(_LOCAL) else int(ray.cluster_resources().get("CPU", 1))
        # One that died is not started again by Ray but by us: until it stands, all it is given would fail.
        kind, maker = ray.remote(num_cpus=1, max_restarts=0)(RayWorker), ray.put(make)
        yield from _shared_out(ray, partial(kind.remote, maker), min(count, len(numbers)), numbers)
    finally:
        if mine:
            ray.shutdown()


def _connect(ray: Any, given: str) -> bool:
    """Whether the connection is ours to close."""
    if ray.is_initialized():
        return False
    # Packages are found by workers where they are found here, and each has one thread, as on one machine.
    told = {name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ} | {"OMP_NUM_THREADS": "1"}
    options: dict[str, Any] = {"include_dashboard": False, "log_to_driver": False, "logging_level": "ERROR",
                               "runtime_env": {"env_vars": told}}
    try:
        if given.startswith(_LOCAL):
            ray.init(address="local", num_cpus=int(given[len(_LOCAL):]), **options)
        elif given == "auto":
            try:
                ray.init(address="auto", **{k: v for k, v in options.items() if k != "include_dashboard"})
            except ConnectionError:
                ray.init(address="local", **options)
        else:
            ray.init(address=given, **{k: v for k, v in options.items() if k != "include_dashboard"})
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InputError(f"--ray {given}", f"cannot be reached ({str(error).splitlines()[0][:100]})",
                         "check the address, or say local:N") from None
    return True


def _shared_out(ray: Any, hire: Callable[[], Any], workers: int, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    waiting, tried = deque(numbers), dict.fromkeys(numbers, 0)
    running: dict[Any, tuple[Any, int]] = {}

    def begin(worker: Any) -> None:
        if waiting:
            number = waiting.popleft()
            tried[number] += 1
            running[worker.do.remote(number)] = (worker, number)

    for _ in range(workers):
        begin(hire())
    while running:
        for ready in ray.wait(list(running), num_returns=1)[0]:
            worker, number = running.pop(ready)
            try:
                yield ray.get(ready)
            except ray.exceptions.RayActorError as error:
                worker = hire()
                if tried[number] < ATTEMPTS:
                    waiting.appendleft(number)
                else:
                    told = " ".join(str(error).split())[:120]
                    yield TaskOutcome(number, 0.0, f"its worker died {ATTEMPTS} times ({told})", 0.0, "")
            begin(worker)
