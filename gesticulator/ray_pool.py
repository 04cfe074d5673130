"""Batches on a Ray cluster. Ray schedules the tasks and gives that of a worker that died to another one.

A task is a recording. As many are in flight as the cluster has processors, so that they start in their order, the
longest first; a worker process loads the models for its first task and keeps them for the next ones.
"""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
from collections import deque
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from data_module.errors import InputError, one_line
from data_module.settings import whole_number
from gesticulator.batch import Doing, Maker, TaskOutcome, attempted

ATTEMPTS = 3
"""Attempts at a task whose worker dies: the task itself is the likelier cause (memory) than chance."""
PULSE = 2.0
"""Seconds without a result after which the connection to the head of the cluster is checked."""
MISSED = 3
"""Failed checks in a row after which the head counts as lost: a busy machine may miss one."""
_LOCAL, _CLIENT = "local:", "ray://"
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


def done_on_ray(given: str, make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Process tasks on a cluster; outcomes arrive in the order in which tasks finish.

    given: "auto" (the cluster running here, else this machine), the address of a cluster, or "local:N" for N workers on
    this machine. `InputError` if no cluster answers, if it is lost, or if a worker cannot load the models.
    """
    check_ray(given)
    import ray

    # A connection that the caller made stays open afterwards.
    connected = not ray.is_initialized()
    if connected:
        _connect(ray, given)
    running: dict[Any, int] = {}
    try:
        workers = int(given[len(_LOCAL):]) if given.startswith(_LOCAL) else int(ray.cluster_resources().get("CPU", 1))
        task = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_do)
        # In a list, Ray does not fetch it for every task: the maker holds all jobs.
        maker, waiting, missed = [ray.put(make)], deque(numbers), 0
        while waiting or running:
            while waiting and len(running) < workers:
                number = waiting.popleft()
                running[task.remote(maker, number)] = number
            # With a timeout, because a lost cluster would otherwise block forever.
            ready, _ = ray.wait(list(running), num_returns=1, timeout=PULSE)
            missed = 0 if ready or _head_answers(ray, given) else missed + 1
            if missed >= MISSED:
                raise _lost(given, "its head does not answer")
            for reference in ready:
                yield _outcome(ray, given, reference, running.pop(reference))
    except ConnectionError as error:  # raised by a Ray client (ray://)
        raise _lost(given, str(error)) from None
    finally:
        with contextlib.suppress(ray.exceptions.RayError, ConnectionError):
            for reference in running:
                ray.cancel(reference, force=True)
        if connected:
            ray.shutdown()


def _do(maker: list[Any], number: int) -> TaskOutcome | str:
    """In a worker: process a task; returns the error message if the models cannot be loaded here."""
    import ray

    key = maker[0].hex()
    if key not in _LOADED:
        try:
            _LOADED[key] = ray.get(maker[0])()
        except (InputError, OSError) as error:  # not an error of this task: no task could be done here
            return one_line(error)
    return attempted(_LOADED[key], number)


def _outcome(ray: Any, given: str, reference: Any, number: int) -> TaskOutcome:
    """The outcome of a task that ended."""
    try:
        result = ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # `_do` reports errors of users itself, so the program differs there
        raise InputError("a worker", f"could not start ({' '.join(str(error).split())[-160:]})",
                         "install the same program on every machine") from None
    except ray.exceptions.RayError as error:
        if not _head_answers(ray, given):
            raise _lost(given, str(error)) from None
        return TaskOutcome(number, 0, f"its worker died {ATTEMPTS} times ({' '.join(str(error).split())[:120]})", 0, "")
    if isinstance(result, str):
        raise InputError("a worker", f"cannot do its work ({result})", "give all machines the same files")
    return TaskOutcome(**vars(result))


def _connect(ray: Any, given: str) -> None:
    """Connect to the cluster, or start one on this machine."""
    # Workers import packages from the same paths and use one thread each, as on a single machine.
    environment = {name: os.environ[name] for name in ("PYTHONPATH", "GESTICULATOR_DATA") if name in os.environ}
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR",
                               "runtime_env": {"env_vars": {**environment, "OMP_NUM_THREADS": "1"}}}
    try:
        if given.startswith(_LOCAL):
            ray.init(address="local", include_dashboard=False, num_cpus=int(given[len(_LOCAL):]), **options)
        elif given == "auto" and not _runs_here():
            ray.init(address="local", include_dashboard=False, **options)
        else:
            # Ray itself would retry an unreachable address for minutes.
            if given != "auto" and not _answers(given):
                raise ConnectionError("nothing answers there")
            ray.init(address=given, **options)
    except Exception as error:  # noqa: BLE001 - Ray raises a plain Exception where it cannot be reached
        raise InputError(f"--ray {given}", f"cannot be reached ({' '.join(str(error).split())[:100]})",
                         "check the address, and RAY_AUTH_MODE where the cluster has a token, or say local:N"
                         ) from None


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


def _head_answers(ray: Any, given: str) -> bool:
    """Whether the head of the cluster is alive: Ray itself waits a minute and then ends the process. A Ray client
    notices by itself."""
    return given.startswith(_CLIENT) or _answers(str(ray.get_runtime_context().gcs_address))


def _lost(given: str, why: str) -> InputError:
    return InputError(f"--ray {given}", f"the cluster is lost ({' '.join(why.split())[:100]})",
                      "restart it and repeat the command: finished recordings are kept")
