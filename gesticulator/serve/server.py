"""The server: WebSocket streams, `/healthz` and `/metrics` on one port, and one compute thread for all streams."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http
import itertools
import json
import logging
import signal
import socket
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from data_module.errors import InputError
from gesticulator.serve.connection import CLOSE_SECONDS, Connection, Workplace
from gesticulator.serve.metrics import CONTENT_TYPE, ServerMetrics, exposition, read_figures, write_figures
from gesticulator.serve.protocol import CloseCode, RefusedError, StreamRequest, published
from gesticulator.serve.settings import SOCKET_BYTES, ServerLimits

if TYPE_CHECKING:
    from gesticulator.serve.session import Session
    from gesticulator.serve.vmc import VmcOutput

LOG = logging.getLogger("gesticulator.serve")
ANSWER_SECONDS = 10.0
"""Least time for finishing received audio when the server stops, seconds."""
SAVE_SECONDS = 1.0
"""Interval in seconds at which a worker writes its metrics for the others."""
_BACKLOG = 512
"""Connections waiting to be accepted: enough for a burst of hundreds per second."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_PING_SECONDS = 20.0
"""Ping interval, seconds; a vanished client is noticed after two of them."""
_SOUND_QUEUE = 4
"""Messages read ahead by the WebSocket library; our own queue is bounded in seconds of audio."""


@dataclass(frozen=True)
class ServerAddress:
    """Where to listen, and who may connect.

    port: 0 for any free one. origins: web pages that may connect, such as "https://example.org"; pages of this machine
    and clients other than browsers always may. token: required in a client's hello; "" for none.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
    token: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise InputError(f"port {self.port}", "is not a port", "choose 0 (any free one) to 65535")

    @property
    def local(self) -> bool:
        """Whether only this machine can connect."""
        return self.host in _LOOPBACK

    def listen(self) -> socket.socket:
        """Open a listening socket; `InputError` if that fails."""
        try:
            family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
            listening = socket.create_server((self.host, self.port), family=family, backlog=_BACKLOG)
        except (OSError, UnicodeError) as error:
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            raise InputError(f"{self.host}:{self.port}", "is taken" if taken else f"cannot be listened on ({error})",
                             "choose another --port" if taken else "choose another --host or --port") from None
        for direction in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            listening.setsockopt(socket.SOL_SOCKET, direction, SOCKET_BYTES)  # connections inherit it
        # asyncio sets it only for sockets with an explicit protocol; without it, every other packet waits 40 ms.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listening


@dataclass(frozen=True)
class Page:
    """A file served to browsers."""

    body: bytes
    kind: str


@dataclass
class LiveServer:
    """Serves streams until stopped.

    open_session: creates a session for a stream's name and request; output: also receives the motion; pages: URL path
    -> file; folder: where workers of one server share their metrics.
    """

    address: ServerAddress
    limits: ServerLimits
    open_session: Callable[[str, StreamRequest], Session]
    output: VmcOutput | None = None
    pages: Mapping[str, Page] = field(default_factory=dict)
    folder: Path | None = None
    worker: int = 0

    def __post_init__(self) -> None:
        self.metrics = ServerMetrics(self.worker)
        self.connections: set[Connection] = set()
        self.draining = False
        # One thread: Python runs one at a time. Use more workers for more cores.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="compute")
        self._numbers = itertools.count(1)
        self._stop = asyncio.Event()
        self._save_failed = False
        """Whether the last attempt to write the metrics failed."""

    def stop(self) -> None:
        """Stop: no new streams, `drain_seconds` for open ones, then finish them. A second call aborts at once."""
        if self._stop.is_set():
            for connection in self.connections:
                connection.socket.transport.abort()
        self._stop.set()

    async def run(self, listening: socket.socket, ready: Callable[[], None] | None = None) -> None:
        """Serve on a listening socket until `stop`, SIGTERM or SIGINT."""
        published()  # report a missing schema before anyone connects
        loop = asyncio.get_running_loop()
        for name in (signal.SIGTERM, signal.SIGINT):
            with contextlib.suppress(NotImplementedError, ValueError, RuntimeError):  # Windows; not the main thread
                loop.add_signal_handler(name, self.stop)
        await self._save()  # so that each worker can report the metrics of all ready ones
        server = await serve(
            self._serve_one, sock=listening, process_request=self._answer, select_subprotocol=_subprotocol,
            max_size=self.limits.message_bytes, max_queue=_SOUND_QUEUE, compression=None, open_timeout=10,
            ping_interval=_PING_SECONDS, ping_timeout=_PING_SECONDS, close_timeout=CLOSE_SECONDS, logger=_quiet(),
            server_header=None)
        saver = asyncio.create_task(self._keep_saving())
        try:
            if ready is not None:
                ready()
            await self._stop.wait()
            await self._drain(server)
        finally:
            saver.cancel()
            server.close()
            await server.wait_closed()
            self._thread.shutdown(wait=False, cancel_futures=True)

    async def compute(self, job: Callable[[], Any]) -> Any:
        """Run a job in the compute thread, after those queued."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, job)

    async def _serve_one(self, ws: ServerConnection) -> None:
        name = f"{self.worker}-{next(self._numbers)}"
        place = Workplace(self.limits, self.metrics, self.compute, self.open_session, self.output, self.address.token)
        connection = Connection(ws, name, place)
        if self.draining or len(self.connections) >= self.limits.streams:
            code = CloseCode.GOING_AWAY if self.draining else CloseCode.TOO_MANY_STREAMS
            reason = "the server is shutting down" if self.draining else \
                f"the server has its {self.limits.streams} streams"
            await connection.refuse(RefusedError(code, reason))
            self._log(connection)
            return
        self.connections.add(connection)
        self.metrics.add("streams")
        self.metrics.add("streams_total")
        try:
            await connection.run()
        finally:
            self.connections.discard(connection)
            self.metrics.add("streams", -1)
            self._log(connection)

    def _log(self, connection: Connection) -> None:
        self.metrics.count("closed_total", connection.code)
        peer = connection.socket.remote_address
        LOG.info("stream %s from %s: %.1f s of sound, %d frames, %d %s", connection.name,
                 f"{peer[0]}:{peer[1]}" if peer else "?", connection.seconds, connection.frames, connection.code,
                 " ".join(connection.reason.split()))

    async def _drain(self, server: Server) -> None:
        self.draining = True
        self.metrics.numbers["draining"] = 1
        # The system refuses later connections; with workers, the sockets of the others and the parent are closed too.
        server.close(close_connections=False)
        if self.connections:
            LOG.info("stopping: %d streams have %g s", len(self.connections), self.limits.drain_seconds)
        await self._wait_for_streams(self.limits.drain_seconds)
        for connection in list(self.connections):
            await connection.leave()
        await self._wait_for_streams(max(self.limits.drain_seconds, ANSWER_SECONDS))
        for connection in self.connections:
            connection.socket.transport.abort()

    async def _wait_for_streams(self, seconds: float) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while self.connections:
                    await asyncio.sleep(0.02)

    async def _keep_saving(self) -> None:
        while self.folder is not None:
            await asyncio.sleep(SAVE_SECONDS)
            await self._save()

    async def _save(self) -> None:
        """Write the metrics for the other workers, in a thread so that a slow disk blocks no stream."""
        if self.folder is None:
            return
        text = json.dumps(self.metrics.figures())
        try:
            await asyncio.to_thread(write_figures, self.folder, self.worker, text)
        except Exception as error:  # noqa: BLE001 - whatever it is, the next attempt may succeed
            if not self._save_failed:
                LOG.warning("cannot write the metrics for the other workers (%s: %s)", type(error).__name__, error)
            self._save_failed = True
        else:
            self._save_failed = False

    # ------------------------------------------------------------ HTTP requests

    async def _answer(self, ws: ServerConnection, request: Request) -> Response | None:
        """None to open a WebSocket, else the HTTP response."""
        path = request.path.partition("?")[0]
        if path == published()["path"]:
            origin = request.headers.get("Origin")
            if origin is None or self._may(origin):
                return None
            return self._refusal(http.HTTPStatus.FORBIDDEN, "pages of this origin may not connect; see --origin\n")
        if path == "/healthz":
            return self._refusal(http.HTTPStatus.SERVICE_UNAVAILABLE, "stopping\n") if self.draining \
                else _response(http.HTTPStatus.OK, b"ok\n", "text/plain; charset=utf-8")
        if path == "/metrics":
            others = [] if self.folder is None else await asyncio.to_thread(read_figures, self.folder, self.worker)
            text = exposition([self.metrics.figures(), *others])
            return _response(http.HTTPStatus.OK, text.encode(), CONTENT_TYPE)
        if path in self.pages:
            return _response(http.HTTPStatus.OK, self.pages[path].body, self.pages[path].kind)
        return self._refusal(http.HTTPStatus.NOT_FOUND, f"there are {published()['path']}, /healthz and /metrics\n")

    def _refusal(self, status: http.HTTPStatus, text: str) -> Response:
        self.metrics.count("refused_total", status)
        return _response(status, text.encode(), "text/plain; charset=utf-8")

    def _may(self, origin: str) -> bool:
        """Whether a web page of that origin may connect.

        The page's host is compared with names of this machine, not with the request's Host, which a page whose name was
        re-resolved to 127.0.0.1 would match.
        """
        if "*" in self.address.origins or origin in self.address.origins:
            return True
        try:
            host = urlsplit(origin).hostname
        except ValueError:
            return False
        return self.address.local and host in _LOOPBACK


def _subprotocol(ws: ServerConnection, offered: Any) -> Any:
    """Our subprotocol if it is offered; a client without one is served too, since the hello holds the version."""
    return published()["subprotocol"] if published()["subprotocol"] in offered else None


def _response(status: http.HTTPStatus, body: bytes, kind: str) -> Response:
    headers = Headers({"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close",
                       "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"})
    return Response(status.value, status.phrase, headers, body)


def _quiet() -> logging.Logger:
    """The WebSocket library's log, silenced: it would print a traceback for every invalid client message."""
    log = logging.getLogger("gesticulator.serve.websockets")
    log.setLevel(logging.CRITICAL)
    return log


def log_to_stderr() -> None:
    """Print the server's log on standard error, one line per event."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    LOG.handlers[:] = [handler]
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
