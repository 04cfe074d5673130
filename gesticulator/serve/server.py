"""The server: WebSocket streams, `/healthz` and `/metrics` on one port, one thread that computes for all streams."""

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
"""How long the answer to what was received may take, at least, once a server stops."""
SAVE_SECONDS = 1.0
"""How often a worker writes its figures for the others."""
_BACKLOG = 512
"""Connections that wait to be accepted: a burst of hundreds a second."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_PING_SECONDS = 20.0
"""A client whose machine is gone is noticed after two of them."""
_SOUND_QUEUE = 4
"""Messages that the WebSocket library reads ahead; ours are counted in seconds of sound."""


@dataclass(frozen=True)
class ServerAddress:
    """Where to listen, and who may come.

    port: 0 for any that is free. origins: web pages that may connect, such as "https://example.org"; pages of this
    machine and programs that are no browsers always may. token: what a client's hello must hold; "" for none.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
    token: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise InputError(f"port {self.port}", "is none", "choose 0 (any that is free) to 65535")

    @property
    def local(self) -> bool:
        """True where only this machine can connect."""
        return self.host in _LOOPBACK

    def listen(self) -> socket.socket:
        """A socket that listens; `InputError` where that cannot be."""
        try:
            family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
            listening = socket.create_server((self.host, self.port), family=family, backlog=_BACKLOG)
        except (OSError, UnicodeError) as error:
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            raise InputError(f"{self.host}:{self.port}", "is taken" if taken else f"cannot be listened on ({error})",
                             "choose another --port" if taken else "choose another --host or --port") from None
        for direction in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            listening.setsockopt(socket.SOL_SOCKET, direction, SOCKET_BYTES)  # connections inherit it
        # asyncio sets it only where a socket names its protocol; without it, every other packet waits 40 ms.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listening


@dataclass(frozen=True)
class Page:
    """A file that the server gives to a browser."""

    body: bytes
    kind: str


@dataclass
class LiveServer:
    """Serves streams until it is told to stop.

    open_session: makes a session of a stream's name and request; output: gets the motion too; pages: path -> what a
    browser gets there; folder: where workers of one server tell each other their figures.
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
        # One thread: the models hold one set of weights and Python runs one thread at a time. More cores, more workers.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="compute")
        self._numbers = itertools.count(1)
        self._stop = asyncio.Event()
        self._untold = False
        """The last attempt to tell the other workers the figures failed."""

    def stop(self) -> None:
        """End: no new streams, `drain_seconds` for those that are open, then their rest. Twice: at once."""
        if self._stop.is_set():
            for connection in self.connections:
                connection.socket.transport.abort()
        self._stop.set()

    async def run(self, listening: socket.socket, ready: Callable[[], None] | None = None) -> None:
        """Serve on a socket that listens, until `stop` is called or SIGTERM or SIGINT comes."""
        published()  # an installation without the schema is told of before anybody connects
        loop = asyncio.get_running_loop()
        for name in (signal.SIGTERM, signal.SIGINT):
            with contextlib.suppress(NotImplementedError, ValueError, RuntimeError):  # Windows; not the main thread
                loop.add_signal_handler(name, self.stop)
        await self._save()  # who is asked for the figures can tell those of all that are ready
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
        """Run a job in the thread that computes, after those that wait."""
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
        # Later connects are refused by the system; with workers, the others' and the parent's socket are closed too.
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
        """Tell the other workers the figures. A thread writes them, so that a slow disk stops no stream."""
        if self.folder is None:
            return
        text = json.dumps(self.metrics.figures())
        try:
            await asyncio.to_thread(write_figures, self.folder, self.worker, text)
        except Exception as error:  # noqa: BLE001 - whatever it is, the next second may do better
            if not self._untold:
                LOG.warning("the other workers cannot be told the figures (%s: %s)", type(error).__name__, error)
            self._untold = True
        else:
            self._untold = False

    async def _figures(self) -> str:
        others = [] if self.folder is None else await asyncio.to_thread(read_figures, self.folder, self.worker)
        return exposition([self.metrics.figures(), *others])

    # ------------------------------------------------------------ what is asked before there is a WebSocket

    async def _answer(self, ws: ServerConnection, request: Request) -> Response | None:
        """None to open a WebSocket; else the response."""
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
            return _response(http.HTTPStatus.OK, (await self._figures()).encode(), CONTENT_TYPE)
        if path in self.pages:
            return _response(http.HTTPStatus.OK, self.pages[path].body, self.pages[path].kind)
        return self._refusal(http.HTTPStatus.NOT_FOUND, f"there are {published()['path']}, /healthz and /metrics\n")

    def _refusal(self, status: http.HTTPStatus, text: str) -> Response:
        self.metrics.count("refused_total", status)
        return _response(status, text.encode(), "text/plain; charset=utf-8")

    def _may(self, origin: str) -> bool:
        """Whether a web page of that origin may connect.

        The page's host is held against names of this machine and not against the request's own Host, which a page
        that had its name's address changed to 127.0.0.1 would match.
        """
        if "*" in self.address.origins or origin in self.address.origins:
            return True
        try:
            host = urlsplit(origin).hostname
        except ValueError:
            return False
        return self.address.local and host in _LOOPBACK


def _subprotocol(ws: ServerConnection, offered: Any) -> Any:
    """Ours where it is offered. A client that names none is served as well: the hello tells the version."""
    return published()["subprotocol"] if published()["subprotocol"] in offered else None


def _response(status: http.HTTPStatus, body: bytes, kind: str) -> Response:
    headers = Headers({"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close",
                       "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"})
    return Response(status.value, status.phrase, headers, body)


def _quiet() -> logging.Logger:
    """The WebSocket library's own log: garbage from a client is no news, and would come with a traceback."""
    log = logging.getLogger("gesticulator.serve.websockets")
    log.setLevel(logging.CRITICAL)
    return log


def log_to_stderr() -> None:
    """Print the server's log, a line for each event, on standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    LOG.handlers[:] = [handler]
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
