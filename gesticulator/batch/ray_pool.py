"""Work on a Ray cluster: each worker loads the models once, and one that dies, or that is slow, is replaced.

Each worker has one task at a time, so that those that come first are begun first. What a worker was doing when it died
is given to the next one. When nothing waits any more, a task that takes far longer than the others is done a second
time by a worker that is free, and whichever is ready first counts: results are written whole and are the same.
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
from gesticulator.batch.run import Doing, Maker, TaskOutcome, attempted

ATTEMPTS = 3
"""How often a task is tried whose worker dies: more likely it is what kills them (memory) than chance."""
SLOW, SLOW_SECONDS = 3.0, 10.0
"""A task is slow that takes so many times the median of those before it, and so many seconds at the least."""
PULSE = 2.0
"""Seconds after which, where nothing was heard, the head of the cluster is asked whether it is there."""
STARTS = 3
"""Times that a cluster of this machine is tried to be started."""
MISSED = 3
"""Times without an answer after which it is not: a busy machine may miss one."""
_LOCAL, _CLIENT = "local:", "ray://"
_MOST_WORKERS = 10_000


def check_ray(given: str) -> None:
    """`InputError` where Ray is not installed, or what --ray names is none."""
    if find_spec("ray") is None:
        raise InputError("--ray", "needs Ray, which is not installed", "pip install 'gesticulator[scale]', or use "
                         "--shard")
    if given.startswith(_LOCAL) and not whole_number(given[len(_LOCAL):], _MOST_WORKERS):
        raise InputError(f"--ray {given[:40]}", "is no number of workers", "write --ray local:4")


class RayWorker:
    """What a worker of the cluster holds: the models."""

    def __init__(self, make: Maker) -> None:
        self._doing: Doing | None = None
        try:
            self._doing = make()
        except (InputError, OSError) as error:  # raised here, it would look like a death and be tried again
            self._fault = one_line(error)

    def do(self, number: int) -> TaskOutcome | str:
        """Do a task; why this worker can do none, where it cannot."""
        return self._fault if self._doing is None else attempted(self._doing, number)


def done_on_ray(given: str, make: Maker, numbers: Sequence[int], doubles: bool = True) -> Iterator[TaskOutcome]:
    """Do tasks on the cluster; given: "auto" (the one that runs here, else this machine), the address of one, or
    "local:N" for N workers here; doubles: whether what is slow may be done twice at a time. What is done comes as it is
    done. `InputError` where no cluster answers, where it is lost, and where a worker cannot load what it needs."""
    check_ray(given)
    import ray

    mine = _connect(ray, given)
    pool = None
    try:
        count = int(given[len(_LOCAL):]) if given.startswith(_LOCAL) else int(ray.cluster_resources().get("CPU", 1))
        # One that died is not started again by Ray but by us: until it stands, all it is given would fail.
        kind, maker = ray.remote(num_cpus=1, max_restarts=0)(RayWorker), ray.put(make)
        pool = _Pool(ray, partial(kind.remote, maker), deque(numbers), doubles, _Head.of(ray, given))
        yield from pool.outcomes(min(count, len(numbers)))
    except ConnectionError as error:  # of a client (ray://)
        raise _lost(given, str(error)) from None
    finally:
        if pool is not None:
            pool.dismiss()
        if mine:
            ray.shutdown()


# ------------------------------------------------------------------------------------------------- the connection

def _connect(ray: Any, given: str) -> bool:
    """Whether the connection is ours to close."""
    if ray.is_initialized():
        return False
    # Packages are found by workers where they are found here, and each has one thread, as on one machine.
    told = {name: os.environ[name] for name in ("PYTHONPATH", "GESTICULATOR_DATA") if name in os.environ} \
        | {"OMP_NUM_THREADS": "1"}
    there: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR", "runtime_env": {"env_vars": told}}
    try:
        if given.startswith(_LOCAL):
            _start_here(ray, {**there, "num_cpus": int(given[len(_LOCAL):])})
        elif given == "auto" and not _runs_here():
            _start_here(ray, there)
        elif given == "auto":
            ray.init(address="auto", **there)
        else:
            # Ray tries for minutes to reach what is not there.
            if not _answers(given):
                raise ConnectionError("nothing answers there")
            ray.init(address=given, **there)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - Ray raises a plain Exception where it cannot be reached
        raise InputError(f"--ray {given}", f"cannot be reached ({' '.join(str(error).split())[:100]})",
                         "check the address, and RAY_AUTH_MODE where the cluster has a token, or say local:N"
                         ) from None
    return True


def _start_here(ray: Any, options: dict[str, Any]) -> None:
    """Start a cluster on this machine. Ray gives up where a process of its own has not begun within 30 s, which on a
    busy machine happens: it is tried again."""
    for left in reversed(range(STARTS)):
        try:
            ray.init(address="local", include_dashboard=False, **options)
            return
        except Exception as error:  # noqa: BLE001 - Ray raises a plain Exception where it cannot start
            ray.shutdown()
            if not left:
                raise InputError("--ray", f"Ray does not start on this machine ({' '.join(str(error).split())[:200]})",
                                 "try again when less runs here, or use --shard") from None


def _runs_here() -> bool:
    """Whether there is a cluster that "auto" finds. The note of one that was killed stays, and Ray would wait for it
    without end."""
    address = os.environ.get("RAY_ADDRESS", "")
    if not address:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            place = Path(os.environ.get("RAY_TMPDIR", tempfile.gettempdir()))
            address = (place / "ray" / "ray_current_cluster").read_text(encoding="utf-8").strip()
    return bool(address) and _answers(address)


def _answers(address: str) -> bool:
    """Whether something listens at an address such as "head:6379" or "ray://head:10001"; True where it is of another
    kind, which Ray may know."""
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
    """The head of the cluster, which is asked now and then whether it is there: Ray itself waits for it for a minute
    and then ends the process. address: empty for what is not asked (a client notices by itself)."""

    given: str
    address: str
    missed: int = 0

    @classmethod
    def of(cls, ray: Any, given: str) -> _Head:
        """Of the cluster that Ray is connected to."""
        client = given.startswith(_CLIENT)
        return cls(given, "" if client else str(ray.get_runtime_context().gcs_address))

    def check(self) -> None:
        """`InputError` where it did not answer several times in a row."""
        self.missed = 0 if not self.address or _answers(self.address) else self.missed + 1
        if self.missed >= MISSED:
            raise _lost(self.given, f"nothing answers at {self.address}")

    def assure(self) -> None:
        """Ask until it has answered, or is lost: what is begun without it would wait for it."""
        self.check()
        while self.missed:
            time.sleep(PULSE / 4)
            self.check()


def _lost(given: str, why: str) -> InputError:
    return InputError(f"--ray {given}", f"the cluster is lost ({' '.join(why.split())[:100]})",
                      "start it again, and then the same command: what is done stays")


# ----------------------------------------------------------------------------------------------------- the workers

@dataclass
class _Going:
    """A task that a worker does, and since when."""

    worker: Any
    number: int
    began: float = field(default_factory=time.monotonic)


@dataclass
class _Pool:
    """The workers and what they do. hire: begins a worker; waiting: numbers, those to begin first; doubles: see
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
    """Seconds of computing of what is done."""
    left: set[int] = field(default_factory=set)
    """What is not done yet."""

    def outcomes(self, workers: int) -> Iterator[TaskOutcome]:
        """Do everything."""
        self.left = set(self.waiting)
        for _ in range(workers):
            self._employ(self.hire())
        while self.left:
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
        """What became of a task; None where it is to be done again, or is being done."""
        try:
            found = self.ray.get(reference)
        except self.ray.exceptions.RayActorError as error:
            told = " ".join(str(error).split())
            if "creation task" in told:
                raise InputError("a worker", f"could not begin ({told[-160:]})",
                                 "install the same program on every machine") from None
            self.head.assure()
            outcome = None
            if task.number in self.left and not any(task.number == other.number for other in self.running.values()):
                if self.tried[task.number] < ATTEMPTS:
                    self.waiting.appendleft(task.number)
                else:
                    outcome = TaskOutcome(task.number, 0.0, f"its worker died {ATTEMPTS} times ({told[:120]})", 0.0, "")
            if self.waiting and not self.idle:
                self.idle.append(self.hire())
            while self.idle and self.waiting:
                self._employ(self.idle.pop())
            return outcome
        if isinstance(found, str):
            raise InputError("a worker", f"cannot do its work ({found})", "give all machines the same files")
        self.times.append(found.time)
        self._employ(task.worker)
        return TaskOutcome(**vars(found))

    def _employ(self, worker: Any) -> None:
        """Give a worker the next task, or none."""
        if not self.waiting:
            self.idle.append(worker)
            return
        number = self.waiting.popleft()
        self.tried[number] = self.tried.get(number, 0) + 1
        self.running[worker.do.remote(number)] = _Going(worker, number)

    def _double(self) -> None:
        """Give what is slow to workers that are free, the slowest first."""
        if not (self.doubles and self.idle and self.times):
            return
        limit, now = max(SLOW_SECONDS, SLOW * statistics.median(self.times)), time.monotonic()
        for task in sorted(self.running.values(), key=lambda task: task.began):
            twice = sum(other.number == task.number for other in self.running.values()) > 1
            if self.idle and now - task.began > limit and task.number in self.left and not twice:
                worker = self.idle.pop()
                self.running[worker.do.remote(task.number)] = _Going(worker, task.number)

    def dismiss(self) -> None:
        """End what is still being done though nobody waits for it."""
        if not self.running:
            return
        with contextlib.suppress(self.ray.exceptions.RayError, ConnectionError):
            for task in self.running.values():
                self.ray.kill(task.worker)
            # Until they have ended they may still write.
            self.ray.wait(list(self.running), num_returns=len(self.running), timeout=PULSE)
