"""`gesticulator serve` and `gesticulator live`."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import logging
import multiprocessing
import os
import queue
import signal
import socket
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from logging.handlers import QueueHandler, QueueListener
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from multiprocessing.synchronize import Event
from typing import TYPE_CHECKING

from data_module.errors import InputError
from data_module.files import read_text
from gesticulator.cli import Command

if TYPE_CHECKING:
    from gesticulator.live.limits import ServerLimits
    from gesticulator.live.server import ServerAddress

LOG = logging.getLogger("gesticulator.live")
TOKEN_VARIABLE = "GESTICULATOR_TOKEN"
"""Environment variable with the token, which keeps it out of process lists."""
LOG_LINES = 10_000
"""Lines of the log that may wait to be written; later ones are dropped."""
LOG_SECONDS = 2.0
"""Time for the lines that wait when the process ends."""
_LIMITS = {"streams": "maximum number of streams", "stream_seconds": "maximum duration of a stream",
           "waiting_seconds": "maximum of waiting audio", "message_bytes": "maximum message length",
           "unread_bytes": "maximum of unread poses", "quiet_seconds": "time that a client may send nothing",
           "drain_seconds": "time for open streams after SIGTERM"}
"""Field of `ServerLimits` -> help of its option."""
_MOST_WORKERS = 256
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8
"""Numbers of parameters of glibc's `mallopt`."""
_OWN_PAGES = 1 << 20
"""Bytes from which a piece of memory gets pages of its own."""


@dataclass(frozen=True)
class Launch:
    """The configuration of a server, picklable for workers. vmc: "HOST:PORT" or None; live: serve the page of
    `gesticulator live`; browser: open it when ready."""

    address: ServerAddress
    limits: ServerLimits
    workers: int = 1
    vmc: str | None = None
    bundle: str | None = None
    threads: int = 1
    live: bool = False
    browser: bool = False


def arguments(p: argparse.ArgumentParser) -> None:
    from gesticulator.live.limits import ServerLimits

    where = p.add_argument_group("address and access")
    where.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1, this machine)")
    where.add_argument("--port", type=int, default=8765, help="port (default 8765; 0 chooses a free one)")
    where.add_argument("--origin", action="append", default=[], metavar="URL",
                       help="origin of web pages that may connect, such as https://example.org (pages on this machine "
                       "always may); can be repeated")
    where.add_argument("--token-file", metavar="FILE", help="a file with the token that clients must send (or set "
                       f"{TOKEN_VARIABLE})")
    where.add_argument("--no-token", action="store_true", help="require no token for another --host")
    limits, defaults = p.add_argument_group("limits of each worker"), ServerLimits()
    for name, text in _LIMITS.items():
        default = getattr(defaults, name)
        limits.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default,
                            metavar="S" if isinstance(default, float) else "N",
                            help=f"{text} (default {default:{'g' if isinstance(default, float) else ''}})")
    p.add_argument("--workers", type=int, default=1, metavar="N", help="number of processes, one per core (default 1)")
    _output_arguments(p, "the first stream", "per worker")


def _output_arguments(p: argparse.ArgumentParser, stream: str, threads: str) -> None:
    p.add_argument("--vmc", metavar="HOST:PORT", help=f"also send the poses of {stream} by VMC, such as "
                   "127.0.0.1:39539")
    p.add_argument("--bundle", metavar="NAME|DIR", help="trained weights: default, paper, or a folder")
    p.add_argument("--threads", type=int, default=1, metavar="N", help=f"torch threads {threads} (default 1)")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT; exit code 0."""
    check_library()
    from gesticulator.live.limits import ServerLimits
    from gesticulator.live.server import ServerAddress

    return launch(Launch(
        ServerAddress(args.host, args.port, tuple(args.origin), read_token(args)),
        ServerLimits(**{name: getattr(args, name) for name in _LIMITS}), args.workers, args.vmc, args.bundle,
        args.threads))


def check_library() -> None:
    """`InputError` without the packages of the extra `live`."""
    try:
        import jsonschema  # noqa: F401
        import prometheus_client  # noqa: F401
        import websockets  # noqa: F401
    except ImportError as error:
        raise InputError("serve", f"needs the package {error.name}", "pip install 'gesticulator[live]'") from None


def read_token(args: argparse.Namespace) -> str:
    """The token that clients must send, "" for none; `InputError` if other machines could connect without one."""
    token = os.environ.get(TOKEN_VARIABLE, "")
    if args.token_file is not None:
        token = read_text(args.token_file, "write one line into it", 1 << 12).strip()
        if not token:
            raise InputError(args.token_file, "holds no token", "write one into it")
    if not (token or args.no_token) and args.host not in ("127.0.0.1", "::1", "localhost"):
        raise InputError(f"--host {args.host}", "lets other machines connect", "give a --token-file, or --no-token")
    return token


COMMAND = Command(
    "answer audio with poses, live, over a WebSocket", arguments, run,
    examples=(
        "serve",
        "serve --port 9000 --workers 4",
        "serve --host 0.0.0.0 --token-file token.txt --origin https://example.org",
        "serve --vmc 127.0.0.1:39539",
    ))


def live_arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--port", type=int, default=8765, help="port (default 8765; 0 chooses a free one)")
    p.add_argument("--no-browser", action="store_true", help="serve the page without opening it")
    _output_arguments(p, "the stream", "to use")


def run_live(args: argparse.Namespace) -> int:
    """Serve the page on this machine until SIGTERM or SIGINT; exit code 0."""
    check_library()
    from gesticulator.live.limits import ServerLimits
    from gesticulator.live.server import ServerAddress

    return launch(Launch(ServerAddress(port=args.port), ServerLimits(drain_seconds=1.0), vmc=args.vmc,
                         bundle=args.bundle, threads=args.threads, live=True, browser=not args.no_browser))


LIVE = Command(
    "open a page that gestures to your microphone or to a recording", live_arguments, run_live,
    examples=(
        "live",
        "live --port 9000 --no-browser",
    ))


# ---------------------------------------------------------------- processes


def launch(config: Launch) -> int:
    """Serve until SIGTERM or SIGINT; exit code 0, or 1 if a worker ended by itself. `InputError` for an invalid
    configuration."""
    from gesticulator.bundle.files import bundle_folder
    from gesticulator.live.vmc import VmcOutput
    from gesticulator.options import RANGES

    if not 1 <= config.workers <= _MOST_WORKERS:
        raise InputError(f"--workers {config.workers}", "is out of range", f"choose 1 to {_MOST_WORKERS}")
    RANGES["threads"].check("--threads", config.threads)
    # Checked here, since a worker's error would come after the models are loaded.
    if config.vmc is not None:
        VmcOutput(config.vmc).close()
        if config.workers > 1:
            raise InputError("--vmc", "works with one worker only", "leave --workers out")
    if not bundle_folder(config.bundle).is_dir():
        raise InputError(config.bundle or "--bundle", "is not a folder", "give default, paper, or a trained bundle")
    with log_to_stderr(), config.address.listen() as listening:
        host, port = listening.getsockname()[:2]
        LOG.info("listening on ws://%s:%d/stream, /healthz, /readyz and /metrics", f"[{host}]" if ":" in host else host,
                 port)
        code = 0
        if config.workers == 1:
            _serve(config, listening)
        else:
            code = _serve_by_workers(config, listening)
        LOG.info("stopped")
    return code


@contextlib.contextmanager
def log_to_stderr() -> Iterator[None]:
    """Print the server's log on standard error, a line per event, from a thread of its own: a pipe that is not read any
    more must not stop the server."""
    lines: queue.Queue[logging.LogRecord] = queue.Queue(LOG_LINES)
    writer = logging.StreamHandler()
    writer.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    listener = QueueListener(lines, writer)
    LOG.handlers[:] = [_DroppingHandler(lines)]
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    listener.start()
    try:
        yield
    finally:
        stopping = threading.Thread(target=listener.stop, daemon=True)
        stopping.start()
        stopping.join(LOG_SECONDS)


class _DroppingHandler(QueueHandler):
    """Drops the lines for which there is no room."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the library's name
        """Say nothing, since standard error is what is not read."""


def _serve(config: Launch, listening: socket.socket, worker: int = 0, ready: Event | None = None) -> None:
    """Load the models and serve in this process until stopped.

    The threads of numpy's matrix products are limited with torch's: beside a stream's small products the others wait
    in a loop, which costs more than the stream.
    """
    import asyncio
    import gc

    from gesticulator.cli import limited_threads
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.live.server import LiveServer, live_pages
    from gesticulator.live.session import session_opener
    from gesticulator.live.vmc import VmcOutput

    def tell_ready() -> None:
        LOG.info("worker %d is ready", worker)
        if ready is not None:
            ready.set()
        if config.live:
            _open_page(listening.getsockname()[1], config.browser)

    async def serve() -> None:
        output = None if config.vmc is None else VmcOutput(config.vmc)
        server = LiveServer(config.address, config.limits, session_opener(system, config.limits), output,
                            live_pages() if config.live else {}, worker)
        if output is not None:
            output.start()
        await server.run(listening, tell_ready)
        if output is not None:
            output.stop()

    _limit_heap()
    with limited_threads(config.threads):
        system = Gesticulator.from_pretrained(config.bundle)
        system.warm()
        if system.reads_text:
            system.warm(text=True)
        gc.collect()
        gc.freeze()  # what is loaded is not looked at by later collections, see `LiveServer`
        asyncio.run(serve())


def _limit_heap() -> None:
    """Keep the heap of this process from growing with what passes through it; to be called before threads start.

    glibc gives each thread a heap of its own, and moves its threshold for pages of their own up to the largest array
    that was freed: a heap is then full of holes the size of arrays, which small objects between them keep."""
    with contextlib.suppress(AttributeError, OSError, TypeError):  # musl, macOS, Windows
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_ARENA_MAX, 1)
        mallopt(_MMAP_THRESHOLD, _OWN_PAGES)


def _open_page(port: int, browser: bool) -> None:
    page = f"http://127.0.0.1:{port}/"
    LOG.info("the page is %s", page)
    if browser:
        import webbrowser

        # In a thread: opening may block until the browser has loaded the page.
        threading.Thread(target=webbrowser.open, args=(page,), daemon=True).start()


def _serve_by_workers(config: Launch, listening: socket.socket) -> int:
    """Serve in several processes that accept on one socket. When one of them ends, all do, for a supervisor (systemd,
    compose) to start the server again."""
    context = multiprocessing.get_context("spawn")
    workers: list[BaseProcess] = []
    stopped, stop = os.pipe()
    # A pipe, because `wait` below does not return for a signal alone.
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: os.write(stop, b"."))
    with tempfile.TemporaryDirectory(prefix="gesticulator-") as folder:
        from gesticulator.live.metrics import SHARED_FOLDER

        os.environ[SHARED_FOLDER] = folder
        for number in range(config.workers):
            ready = context.Event()
            worker = context.Process(target=_worker, args=(config, listening, number, ready), daemon=True)
            worker.start()
            workers.append(worker)
            # The first one alone: it may compile code for the cache of numba, which two processes must not write at
            # the same time.
            while number == 0 and worker.is_alive() and not ready.wait(0.1):
                pass
        ended = wait([stopped, *(process.sentinel for process in workers)])
        for process in workers:
            process.terminate()  # SIGTERM: it drains
        for process in workers:
            process.join()
    if stopped in ended:
        return 0
    LOG.error("a worker ended by itself: see its output")
    return 1


def _worker(config: Launch, listening: socket.socket, number: int, ready: Event) -> None:
    """Main function of a worker process; it stops when its parent ends, even if that is killed."""
    from data_module.errors import one_line_errors

    parent = multiprocessing.parent_process()
    assert parent is not None

    def stop_with_parent() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=stop_with_parent, daemon=True).start()
    with one_line_errors("gesticulator serve"), log_to_stderr():
        _serve(config, listening, number, ready)
