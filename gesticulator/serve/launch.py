"""Starts a server: in this process, or as several workers that share a socket and are restarted when they die."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError
from data_module.files import lock
from gesticulator.serve.metrics import figures_file
from gesticulator.serve.settings import ServerLimits

if TYPE_CHECKING:
    from gesticulator.pipeline import Gesticulator
    from gesticulator.serve.output_process import OutputProcess
    from gesticulator.serve.server import ServerAddress
    from gesticulator.serve.vmc import PoseOutput, VmcOutput

LOG = logging.getLogger("gesticulator.serve")
SAMPLE_RATE = 16000
"""Sampling rate of the models, Hz."""
_MEASURED, _TRIES = 2, 4
"""Audio by which the cost of a stream is measured, seconds, and how often; the first answer begins later."""
_SYLLABLES = 3.5
"""Syllables per second of it, as of speech: blocks are as long as their beats say."""
_SENDING = 1.3
"""Cost of a stream in a server, over that of its models: packets are packed and sent (docs/serve.md: .065 over .05)."""
_WARM = "warm"
"""Marker file: a worker of this server has warmed up."""
_TURN_SECONDS = 0.05
_MOST_WORKERS = 256
_SHORT_LIFE = 5.0
"""A worker that dies sooner, in seconds, did no work."""
_MOST_SHORT_LIVES = 5
"""Short-lived workers in a row after which the server gives up."""


@dataclass(frozen=True)
class Launch:
    """The configuration of a server, picklable for workers. address: where to listen, and who may connect; vmc, osc:
    "HOST:PORT" or None; osc_axes: see `gesticulator.serve.osc`; live: serve the page of `gesticulator live`; browser:
    open it when ready."""

    address: ServerAddress
    limits: ServerLimits
    workers: int = 1
    vmc: str | None = None
    bundle: str | None = None
    threads: int = 1
    live: bool = False
    browser: bool = False
    osc: str | None = None
    osc_axes: str = "y-up"

    def outputs(self) -> list[Callable[[], VmcOutput]]:
        """What also receives the motion, to be made: `InputError` for an invalid target then."""
        found: list[Callable[[], VmcOutput]] = []
        if self.vmc is not None:
            from gesticulator.serve.vmc import VmcOutput

            found.append(partial(VmcOutput, self.vmc))
        if self.osc is not None:
            from gesticulator.serve.osc import OscOutput

            found.append(partial(OscOutput, self.osc, self.osc_axes))
        return found


def launch(config: Launch) -> int:
    """Serve until SIGTERM or SIGINT; exit code 0. `InputError` for an invalid configuration."""
    from gesticulator.bundle.files import bundle_folder
    from gesticulator.options import RANGES
    from gesticulator.serve.log import log_to_stderr

    if not 1 <= config.workers <= _MOST_WORKERS:
        raise InputError(f"--workers {config.workers}", "is out of range", f"choose 1 to {_MOST_WORKERS}")
    RANGES["threads"].check("--threads", config.threads)
    for make in config.outputs():
        output = make()
        output.close()
        if config.workers > 1:
            raise InputError(output.option, "works with one worker only", "leave --workers out")
    if not bundle_folder(config.bundle).is_dir():
        raise InputError(config.bundle or "--bundle", "is not a folder", "give default, paper, or a trained bundle")
    log_to_stderr(LOG)
    address = config.address
    with contextlib.ExitStack() as opened:
        listening = opened.enter_context(address.listen())
        figures = address.listen_for_metrics()
        if figures is not None:
            opened.enter_context(figures)
        host, port = listening.getsockname()[:2]
        host = f"[{host}]" if ":" in host else host
        LOG.info("listening on ws://%s:%d/stream, /healthz, /readyz and /metrics", host, port)
        if figures is not None:
            LOG.info("metrics at http://%s:%d/metrics", address.metrics_host or host, figures.getsockname()[1])
        sockets = Sockets(listening, figures)
        if config.workers == 1:
            serve_here(config, sockets)
        else:
            with tempfile.TemporaryDirectory(prefix="gesticulator-") as folder:
                _Parent(config, sockets, Path(folder)).run()
    LOG.info("stopped")
    return 0


@dataclass(frozen=True)
class Sockets:
    """Where a server listens. figures: for metrics alone, or None."""

    listening: socket.socket
    figures: socket.socket | None = None

    def close(self) -> None:
        for one in (self.listening, self.figures):
            if one is not None:
                one.close()


def serve_here(config: Launch, sockets: Sockets, worker: int = 0, folder: Path | None = None) -> None:
    """Load the models and serve in this process until stopped.

    The threads of numpy's matrix products are limited with torch's: beside a stream's small products the others wait
    in a loop, which costs more than the stream.
    """
    from gesticulator.cli import limited_threads
    from gesticulator.serve.memory import limit_heap

    limit_heap()
    with limited_threads(config.threads):
        _serve(config, sockets, worker, folder)


def _serve(config: Launch, sockets: Sockets, worker: int, folder: Path | None) -> None:
    import asyncio

    from gesticulator.pipeline import Gesticulator
    from gesticulator.serve.memory import freeze_loaded
    from gesticulator.serve.server import LiveServer
    from gesticulator.serve.session import session_opener

    system = Gesticulator.from_pretrained(config.bundle)
    cost = _warm_up_in_turn(system, folder)
    freeze_loaded()
    listening = sockets.listening

    async def serve() -> None:
        outputs, output = _outputs(config)
        if config.live:
            from gesticulator.serve.page import pages
        server = LiveServer(
            config.address, config.limits, session_opener(system, config.limits), output,
            pages() if config.live else {}, folder, worker, cost)
        for one in outputs:
            one.start()
        _end_with_parent(server.stop)
        LOG.info("worker %d has room for %d streams", worker, server.room.capacity)
        await server.run(listening, lambda: _tell_ready(config, listening, worker), sockets.figures)
        for one in outputs:
            one.stop()

    asyncio.run(serve())


def _outputs(config: Launch) -> tuple[list[OutputProcess], PoseOutput | None]:
    """What also receives the motion, each in a process of its own, and all of it as one."""
    if not config.outputs():
        return [], None
    from gesticulator.serve.output_process import OutputProcess
    from gesticulator.serve.vmc import SeveralOutputs

    outputs = [OutputProcess(make) for make in config.outputs()]
    return outputs, SeveralOutputs(outputs)


def _warm_up_in_turn(system: Gesticulator, folder: Path | None) -> float:
    """Warm up; returns the cost of a stream. One worker first and the others after it: numba caches code compiled
    for librosa in files, and two processes that write them at once crash in a third of cases."""
    with contextlib.ExitStack() as held:
        while folder is not None and not (folder / _WARM).exists():
            try:
                held.enter_context(lock(folder / "first", "a worker's start"))
                break
            except InputError:  # another worker holds it; the system releases the lock if it dies
                time.sleep(_TURN_SECONDS)
        system.warm()
        if system.reads_text:
            system.warm(text=True)
        if folder is not None:
            (folder / _WARM).touch()
    return _measured_cost(system)


def _measured_cost(system: Gesticulator) -> float:
    """Seconds of the clock that a server needs for a second of speech: the best of a few tries, so that what else the
    machine does for a moment does not count, plus what goes into sending."""
    import numpy as np

    noise = np.random.default_rng(0).normal(0, 0.1, _MEASURED * SAMPLE_RATE)
    noise *= np.clip(np.sin(2 * np.pi * _SYLLABLES * np.arange(len(noise)) / SAMPLE_RATE), 0, 1)
    stream, took = system.stream(latency="low"), []
    for _ in range(_TRIES):
        begin = time.perf_counter()
        stream.feed(noise.astype(np.float32))
        took.append(time.perf_counter() - begin)
    return _SENDING * min(took[1:]) / _MEASURED


def _end_with_parent(stop: Callable[[], None]) -> None:
    """In a worker: stop when the parent process ends, even if it is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    import asyncio

    loop, sentinel = asyncio.get_running_loop(), parent.sentinel

    def ended() -> None:
        loop.remove_reader(sentinel)
        LOG.warning("the process that started this worker is gone")
        stop()

    with contextlib.suppress(NotImplementedError):  # Windows, which ends both together
        loop.add_reader(sentinel, ended)


def _tell_ready(config: Launch, listening: socket.socket, worker: int) -> None:
    LOG.info("worker %d is ready", worker)
    if config.live:
        page = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        LOG.info("the page is %s", page)
        if config.browser:
            import threading
            import webbrowser

            # In a thread: opening may block until the browser has loaded the page.
            threading.Thread(target=webbrowser.open, args=(page,), daemon=True).start()


def _worker(config: Launch, sockets: Sockets, number: int, folder: str) -> None:
    """Main function of a worker process."""
    from data_module.errors import one_line_errors
    from gesticulator.serve.log import log_to_stderr

    log_to_stderr(LOG)
    with one_line_errors("gesticulator serve"):
        serve_here(config, sockets, number, Path(folder))


class _Parent:
    """Keeps worker processes alive that accept on one socket, and forwards the signal to stop."""

    def __init__(self, config: Launch, sockets: Sockets, folder: Path) -> None:
        self.config, self.sockets, self.folder = config, sockets, folder
        self.context = multiprocessing.get_context("spawn")
        self.workers: dict[int, BaseProcess] = {}
        self.born: dict[int, float] = {}
        self.short_lives = 0
        # The signal handler writes a byte here, so that one call waits for workers and signals.
        self.woken, self.waker = os.pipe()

    def run(self) -> None:
        """Run until a signal comes and the workers have drained."""
        for name in (signal.SIGTERM, signal.SIGINT):
            signal.signal(name, lambda *_: os.write(self.waker, b"."))
        for number in range(self.config.workers):
            self._start(number)
        try:
            while self.woken not in wait([self.woken, *(worker.sentinel for worker in self.workers.values())]):
                self._replace_dead()
        finally:
            self.sockets.close()
            for worker in self.workers.values():
                with contextlib.suppress(OSError):
                    worker.terminate()  # SIGTERM: it drains
            patience = time.monotonic() + 2 * self.config.limits.drain_seconds + 5
            for worker in self.workers.values():
                worker.join(max(0.0, patience - time.monotonic()))
                if worker.is_alive():
                    worker.kill()
                    worker.join()

    def _start(self, number: int) -> None:
        worker = self.context.Process(target=_worker, args=(self.config, self.sockets, number, str(self.folder)),
                                      name=f"gesticulator-worker-{number}", daemon=True)
        worker.start()
        self.workers[number], self.born[number] = worker, time.monotonic()

    def _replace_dead(self) -> None:
        for number, worker in self.workers.items():
            if worker.is_alive():
                continue
            worker.join()
            lived = time.monotonic() - self.born[number]
            self.short_lives = self.short_lives + 1 if lived < _SHORT_LIFE else 0
            if self.short_lives >= _MOST_SHORT_LIVES:
                raise InputError("workers", "exit right after starting", "see their output")
            figures_file(self.folder, number).unlink(missing_ok=True)  # its streams are gone
            LOG.error("worker %d (process %d) died with exit code %s; another takes its place", number, worker.pid,
                      worker.exitcode)
            if lived < _SHORT_LIFE:
                time.sleep(0.2)
            self._start(number)
