"""`gesticulator serve` and `gesticulator live`."""

from __future__ import annotations

import argparse
import asyncio
import gc
import logging
import os
import sys
import threading
import webbrowser

from data_module.errors import InputError
from data_module.files import read_text
from data_module.registry import Requirement
from gesticulator.cli import Command, limited_threads
from gesticulator.live.limits import ServerAddress, ServerLimits

LOG = logging.getLogger("gesticulator.live")
TOKEN_VARIABLE = "GESTICULATOR_TOKEN"
"""Environment variable with the token, which keeps it out of process lists."""
_LIMITS = {"streams": "maximum number of streams", "stream_seconds": "maximum duration of a stream",
           "waiting_seconds": "maximum of waiting audio", "unread_bytes": "maximum of unread poses",
           "drain_seconds": "time for open streams after SIGTERM"}
"""Field of `ServerLimits` -> help of its option."""


def arguments(p: argparse.ArgumentParser) -> None:
    where = p.add_argument_group("address and access")
    where.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1, this machine)")
    where.add_argument("--port", type=int, default=8765, help="port (default 8765; 0 chooses a free one)")
    where.add_argument("--origin", action="append", default=[], metavar="URL",
                       help="origin of web pages that may connect, such as https://example.org (pages on this machine "
                       "always may); can be repeated")
    where.add_argument("--token-file", metavar="FILE", help="a file with the token that clients must send (or set "
                       f"{TOKEN_VARIABLE})")
    where.add_argument("--no-token", action="store_true", help="require no token for another --host")
    limits, defaults = p.add_argument_group("limits"), ServerLimits()
    for name, text in _LIMITS.items():
        default = getattr(defaults, name)
        limits.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default,
                            metavar="S" if isinstance(default, float) else "N",
                            help=f"{text} (default {default:{'g' if isinstance(default, float) else ''}})")
    _common_arguments(p, "the first stream")
    p.add_argument("--core-share", type=float, help=argparse.SUPPRESS)  # commands of before the release still start


def _common_arguments(p: argparse.ArgumentParser, stream: str) -> None:
    p.add_argument("--vmc", metavar="HOST:PORT", help=f"also send the poses of {stream} by VMC, such as "
                   "127.0.0.1:39539")
    p.add_argument("--bundle", metavar="NAME|DIR", help="trained weights: default, paper, or a folder")
    p.add_argument("--threads", type=int, default=1, metavar="N", help="threads of matrix products (default 1)")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT; exit code 0."""
    check_library()
    address = ServerAddress(args.host, args.port, tuple(args.origin), read_token(args))
    return serve(args, address, ServerLimits(**{name: getattr(args, name) for name in _LIMITS}))


def check_library() -> None:
    """`InputError` without the packages of the extra `live`."""
    for module in ("jsonschema", "prometheus_client", "websockets"):
        Requirement(module, module, "live").check("serve")


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
        "serve --port 9000 --streams 4",
        "serve --host 0.0.0.0 --token-file token.txt --origin https://example.org",
        "serve --vmc 127.0.0.1:39539",
    ))


def live_arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--port", type=int, default=8765, help="port (default 8765; 0 chooses a free one)")
    p.add_argument("--no-browser", action="store_true", help="serve the page without opening it")
    _common_arguments(p, "the stream")


def run_live(args: argparse.Namespace) -> int:
    """Serve the page on this machine until SIGTERM or SIGINT; exit code 0."""
    check_library()
    return serve(args, ServerAddress(port=args.port), ServerLimits(drain_seconds=1.0), page=True)


LIVE = Command(
    "open a page that gestures to your microphone or to a recording", live_arguments, run_live,
    examples=(
        "live",
        "live --port 9000 --no-browser",
    ))


def serve(args: argparse.Namespace, address: ServerAddress, limits: ServerLimits, page: bool = False) -> int:
    """Load the models and serve until SIGTERM or SIGINT; exit code 0. `InputError` for an invalid configuration.

    page: serve the page of `gesticulator live`, too, and open it.
    """
    import numpy as np

    from data_module.speech.audio import SAMPLE_RATE
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.live.server import LiveServer, live_pages
    from gesticulator.live.session import session_opener
    from gesticulator.live.vmc import VmcOutput
    from gesticulator.options import RANGES

    RANGES["threads"].check("--threads", args.threads)
    # Errors come before the port is opened; each model is loaded when it is first used.
    output = None if args.vmc is None else VmcOutput(args.vmc)
    gesticulator = Gesticulator.from_pretrained(args.bundle)
    _log_to_stderr()
    # By default Python lets a thread that computes run for 5 ms before the loop may read and send: with five changes
    # between the two for each block, a stream beside a busy one was 0.3 s late.
    sys.setswitchinterval(0.001)
    # Beside a stream's small matrix products further threads wait in a loop, which costs more than the stream.
    with address.listen() as listening, limited_threads(args.threads):
        host, port = listening.getsockname()[:2]
        LOG.info("listening on ws://%s:%d/stream, /healthz, /readyz and /metrics", f"[{host}]" if ":" in host else host,
                 port)
        # The first stream would otherwise wait for the models to be loaded. Silence would not reach the generator.
        noise = np.random.default_rng(0).normal(0.0, 0.05, 2 * SAMPLE_RATE)
        gesticulator.stream(text=gesticulator.reads_text, face="full", legs=True).feed(noise.astype(np.float32))
        # An ended stream is a circle of tasks, exceptions and frames, which the collector looks for when there are many
        # new objects for the known ones. So the models must not count as known: the second collection notes that.
        gc.collect()
        gc.freeze()
        gc.collect()

        def ready() -> None:
            LOG.info("ready")
            if page:
                _open_page(port, not args.no_browser)

        server = LiveServer(address, limits, session_opener(gesticulator, limits), output, live_pages() if page else {})
        asyncio.run(server.run(listening, ready))
    LOG.info("stopped")
    return 0


def _log_to_stderr() -> None:
    """Print the server's log on standard error, a line per event."""
    writer = logging.StreamHandler()
    writer.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    LOG.handlers[:] = [writer]
    LOG.setLevel(logging.INFO)
    LOG.propagate = False


def _open_page(port: int, browser: bool) -> None:
    page = f"http://127.0.0.1:{port}/"
    LOG.info("the page is %s", page)
    if browser:
        # In a thread: opening may block until the browser has loaded the page.
        threading.Thread(target=webbrowser.open, args=(page,), daemon=True).start()
