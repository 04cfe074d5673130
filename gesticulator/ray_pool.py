"""Batches on a Ray cluster: each worker loads the models once; a worker that dies or is slow is replaced.

Each worker has one task at a time, so that tasks start in order. The task of a worker that died is given to the next
one. When no tasks are waiting, a task that takes far longer than the others is also given to an idle worker, and the
first result counts: results are written atomically and are identical.
"""

from __future__ import annotations

import contextlib
import os
import socket
import statistics
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from data_module.errors import InputError, one_line
from data_module.settings import whole_number
from gesticulator.batch import Doing, Maker, TaskOutcome, attempted

ATTEMPTS = 3
"""Attempts at a task whose worker dies: the task itself is the likelier cause (memory) than chance."""
SLOW, SLOW_SECONDS = 3.0, 10.0
"""A task is slow if it takes this many times the median duration of finished tasks, and at least this many seconds."""
PULSE = 2.0
"""Seconds without a result after which the connection to the head of the cluster is checked."""
STARTS = 3
"""Attempts to start a cluster on this machine."""
MISSED = 3
"""Failed checks in a row after which the head counts as lost: a busy machine may miss one."""
_LOCAL, _CLIENT = "local:", "ray://"
_MOST_WORKERS = 10_000


def check_ray(given: str) -> None:
    """`InputError` if Ray is not installed or the value of --ray is invalid."""
    if find_spec("ray") is None:
        raise InputError("--ray", "needs Ray, which is not installed", "pip install 'gesticulator[scale]', or use "
                         "--shard")
    if given.startswith(_LOCAL) and not whole_number(given[len(_LOCAL):], _MOST_WORKERS):
        raise InputError(f"--ray {given[:40]}", "is not a number of workers", "write --ray local:4")


class RayWorker:
    """A worker process of the cluster, with the models loaded."""

    def __init__(self, make: Maker) -> None:
        self._doing: Doing | None = None
        try:
            self._doing = make()
        except (InputError, OSError) as error:  # if raised here, it would look like a dead worker and be retried
            self._fault = one_line(error)

    def do(self, number: int) -> TaskOutcome | str:
        """Process a task; returns the error message if this worker could not load the models."""
        return self._fault if self._doing is None else attempted(self._doing, number)


def done_on_ray(given: str, make: Maker, numbers: Sequence[int], doubles: bool = True) -> Iterator[TaskOutcome]:
    """Process tasks on a cluster; outcomes arrive in the order in which tasks finish.

    given: "auto" (the cluster running here, else this machine), the address of a cluster, or "local:N" for N workers on
    this machine; doubles: whether slow tasks may run twice at a time. `InputError` if no cluster answers, if it is
    lost, or if a worker cannot load the models.
    """
    check_ray(given)
    import ray

    # A connection that the caller made stays open afterwards.
    mine = _connect(ray, given)
    pool = None
    try:
        count = int(given[len(_LOCAL):]) if given.startswith(_LOCAL) else int(ray.cluster_resources().get("CPU", 1))
        # We restart dead workers, not Ray: until Ray has restarted one, every task given to it would fail.
        kind, maker = ray.remote(num_cpus=1, max_restarts=0)(RayWorker), ray.put(make)
        pool = _Pool(ray, partial(kind.remote, maker), deque(numbers), doubles, _Head.of(ray, given))
        yield from pool.outcomes(min(count, len(numbers)))
    except ConnectionError as error:  # raised by a Ray client (ray://)
        raise _lost(given, str(error)) from None
    finally:
        if pool is not None:
            pool.dismiss()
        if mine:
            ray.shutdown()


# ------------------------------------------------------------------------------------------------- the connection

def _connect(ray: Any, given: str) -> bool:
    """Connect to the cluster; returns whether this process made the connection and must close it."""
    if ray.is_initialized():
        return False
    # Workers import packages from the same paths and use one thread each, as on a single machine.
    environment = {name: os.environ[name] for name in ("PYTHONPATH", "GESTICULATOR_DATA") if name in os.environ} \
        | {"OMP_NUM_THREADS": "1"}
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR",
                               "runtime_env": {"env_vars": environment}}
    try:
        if given.startswith(_LOCAL):
            _start_here(ray, {**options, "num_cpus": int(given[len(_LOCAL):])})
        elif given == "auto" and not _runs_here():
            _start_here(ray, options)
        elif given == "auto":
            ray.init(address="auto", **options)
        else:
            # Ray itself would retry an unreachable address for minutes.
            if not _answers(given):
                raise ConnectionError("nothing answers there")
            ray.init(address=given, **options)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - Ray raises a plain Exception where it cannot be reached
        raise InputError(f"--ray {given}", f"cannot be reached ({' '.join(str(error).split())[:100]})",
                         "check the address, and RAY_AUTH_MODE where the cluster has a token, or say local:N"
                         ) from None
    return True


def _start_here(ray: Any, options: dict[str, Any]) -> None:
    """Start a cluster on this machine; retried because Ray gives up if one of its processes takes over 30 s to start,
    which happens on a busy machine."""
    for left in reversed(range(STARTS)):
        try:
            ray.init(address="local", include_dashboard=False, **options)
            return
        except Exception as error:  # noqa: BLE001 - Ray raises a plain Exception where it cannot start
            ray.shutdown()
            if not left:
                raise InputError("--ray", f"Ray does not start on this machine ({' '.join(str(error).split())[:200]})",
                                 "try again when the machine is less busy, or use --shard") from None


def _runs_here() -> bool:
    """Whether there is a running cluster for "auto". A killed cluster leaves its address file, and Ray would wait
    forever."""
    address = os.environ.get("RAY_ADDRESS", "")
    if not address:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            place = Path(os.environ.get("RAY_TMPDIR", tempfile.gettempdir()))
            address = (place / "ray" / "ray_current_cluster").read_text(encoding="utf-8").strip()
    return bool(address) and _answers(address)


def _answers(address: str) -> bool:
    """Whether something listens at an address such as "head:6379" or "ray://head:10001"; True for other forms of
    address, which Ray may know."""
    host, mark, port = address.removeprefix(_CLIENT).rpartition(":")
    if not mark or whole_number(port, 65535) is None:
        return True
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=PULSE):
            return True
    except OSError:
        return False


@dataclass
class _Head:
    """Checks that the head of the cluster is alive: Ray itself waits a minute and then ends the process. address: empty
    for a Ray client, which notices by itself."""

    given: str
    address: str
    missed: int = 0

    @classmethod
    def of(cls, ray: Any, given: str) -> _Head:
        """The head of the cluster that Ray is connected to."""
        client = given.startswith(_CLIENT)
        return cls(given, "" if client else str(ray.get_runtime_context().gcs_address))

    def check(self) -> None:
        """`InputError` after several failed checks in a row."""
        self.missed = 0 if not self.address or _answers(self.address) else self.missed + 1
        if self.missed >= MISSED:
            raise _lost(self.given, f"nothing answers at {self.address}")

    def assure(self) -> None:
        """Check until the head answers or counts as lost: a worker started without it would hang."""
        self.check()
        while self.missed:
            time.sleep(PULSE / 4)
            self.check()


def _lost(given: str, why: str) -> InputError:
    return InputError(f"--ray {given}", f"the cluster is lost ({' '.join(why.split())[:100]})",
                      "restart it and repeat the command: finished recordings are kept")


# ----------------------------------------------------------------------------------------------------- the workers

@dataclass
class _Going:
    """A running task: its worker, number and start time."""

    worker: Any
    number: int
    began: float = field(default_factory=time.monotonic)


@dataclass
class _Pool:
    """The workers and their tasks. hire: starts a worker; waiting: task numbers in order; doubles: see
    `done_on_ray`."""

    ray: Any
    hire: Callable[[], Any]
    waiting: deque[int]
    doubles: bool
    head: _Head
    running: dict[Any, _Going] = field(default_factory=dict)
    idle: list[Any] = field(default_factory=list)
    tried: dict[int, int] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)
    """Computing times of finished tasks, seconds."""
    left: set[int] = field(default_factory=set)
    """Unfinished task numbers."""

    def outcomes(self, workers: int) -> Iterator[TaskOutcome]:
        """Process all tasks."""
        self.left = set(self.waiting)
        for _ in range(workers):
            self._employ(self.hire())
        while self.left:
            # With a timeout, because a lost cluster would otherwise block forever.
            ready, _ = self.ray.wait(list(self.running), num_returns=1, timeout=PULSE)
            if not ready:
                self.head.check()
            for reference in ready:
                outcome = self._ended(self.running.pop(reference), reference)
                if outcome is not None and outcome.number in self.left:
                    self.left.remove(outcome.number)
                    yield outcome
            self._double()

    def _ended(self, task: _Going, reference: Any) -> TaskOutcome | None:
        """The outcome of a task; None if it will be retried or is still running elsewhere."""
        try:
            result = self.ray.get(reference)
        except self.ray.exceptions.RayActorError as error:
            message = " ".join(str(error).split())
            # `RayWorker` itself reports models that cannot be loaded, so here the program on that machine differs.
            if "creation task" in message:
                raise InputError("a worker", f"could not start ({message[-160:]})",
                                 "install the same program on every machine") from None
            self.head.assure()
            outcome = None
            if task.number in self.left and not any(task.number == other.number for other in self.running.values()):
                if self.tried[task.number] < ATTEMPTS:
                    # To the front: it has waited longest, and tasks are ordered by duration.
                    self.waiting.appendleft(task.number)
                else:
                    outcome = TaskOutcome(task.number, 0, f"its worker died {ATTEMPTS} times ({message[:120]})", 0, "")
            if self.waiting and not self.idle:
                self.idle.append(self.hire())
            while self.idle and self.waiting:
                self._employ(self.idle.pop())
            return outcome
        if isinstance(result, str):
            raise InputError("a worker", f"cannot do its work ({result})", "give all machines the same files")
        self.times.append(result.time)
        self._employ(task.worker)
        return TaskOutcome(**vars(result))

    def _employ(self, worker: Any) -> None:
        """Give a worker the next task, or mark it idle."""
        if not self.waiting:
            self.idle.append(worker)
            return
        number = self.waiting.popleft()
        self.tried[number] = self.tried.get(number, 0) + 1
        self.running[worker.do.remote(number)] = _Going(worker, number)

    def _double(self) -> None:
        """Give slow tasks to idle workers too, the slowest first."""
        if not (self.doubles and self.idle and self.times):
            return
        # The median, since a few long recordings would raise a mean.
        limit, now = max(SLOW_SECONDS, SLOW * statistics.median(self.times)), time.monotonic()
        for task in sorted(self.running.values(), key=lambda task: task.began):
            twice = sum(other.number == task.number for other in self.running.values()) > 1
            if self.idle and now - task.began > limit and task.number in self.left and not twice:
                worker = self.idle.pop()
                self.running[worker.do.remote(task.number)] = _Going(worker, task.number)

    def dismiss(self) -> None:
        """Kill workers whose results are no longer needed."""
        if not self.running:
            return
        with contextlib.suppress(self.ray.exceptions.RayError, ConnectionError):
            for task in self.running.values():
                self.ray.kill(task.worker)
            # They may still write files until they have exited.
            self.ray.wait(list(self.running), num_returns=len(self.running), timeout=PULSE)
