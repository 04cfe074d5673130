"""The server: WebSocket streams, health and metrics on one port, and one compute thread for all streams."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import itertools
import logging
import math
import signal
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from importlib import resources
from typing import TYPE_CHECKING, Any

from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from gesticulator.live.connection import CLOSE_SECONDS, ComputeThread, Connection
from gesticulator.live.limits import ServerAddress, ServerLimits
from gesticulator.live.metrics import ServerMetrics
from gesticulator.live.protocol import CloseCode, RefusedError, StreamRequest, published

if TYPE_CHECKING:
    from gesticulator.live.session import Session
    from gesticulator.live.vmc import VmcOutput

LOG = logging.getLogger("gesticulator.live")
_SILENT = logging.getLogger("gesticulator.live.websockets")
_SILENT.setLevel(logging.CRITICAL)  # the library would print a traceback for every invalid message of a client
FINISH_SECONDS = 10.0
"""Least time for finishing received audio when the server stops, seconds."""
RETRY_SECONDS = 5.0
"""Time after which a client that was refused for lack of a place may try again."""
_PING_SECONDS = 20.0
"""Ping interval, seconds; a vanished client is noticed after two of them."""
_MESSAGES_AHEAD = 4
"""Messages read ahead by the WebSocket library; the queue of a connection is bounded in seconds of audio."""
_TEXT = "text/plain; charset=utf-8"
_PAGE_KINDS = {".js": "text/javascript", ".css": "text/css", ".txt": "text/plain"}


def live_pages() -> dict[str, bytes]:
    """URL path -> file of the page of `gesticulator live`."""
    folder = resources.files("gesticulator") / "assets" / "live"
    names = ("live.html", "live.css", "capture.js", "licences.txt")
    return {f"/{name}".removesuffix("live.html"): (folder / name).read_bytes() for name in names} | {
        "/live.min.js": gzip.decompress((folder / "live.min.js.gz").read_bytes())}


@dataclass
class LiveServer:
    """Serves streams until stopped.

    open_session: creates a session for a stream's name and request, in the compute thread; output: also receives the
    motion, beside the WebSocket; pages: URL path -> file.
    """

    address: ServerAddress
    limits: ServerLimits
    open_session: Callable[[str, StreamRequest], Session]
    output: VmcOutput | None = None
    pages: Mapping[str, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.metrics = ServerMetrics()
        self.compute = ComputeThread()
        self.connections: set[Connection] = set()
        self.metrics.streams.set_function(lambda: len(self.connections))
        self.metrics.waiting_seconds.set_function(lambda: sum(stream.waiting_seconds for stream in self.connections))
        self.metrics.unread_bytes.set_function(lambda: sum(stream.unread_bytes for stream in self.connections))
        self.draining = False
        self._numbers = itertools.count(1)
        self._stop = asyncio.Event()

    def stop(self) -> None:
        """Stop: no new streams, `drain_seconds` for open ones, then finish them. A second call aborts at once."""
        # Whoever presses Ctrl C twice does not want to wait for the streams.
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
        server = await serve(
            self._serve_one, sock=listening, process_request=self._answer, select_subprotocol=_subprotocol,
            max_size=self.limits.message_bytes, max_queue=_MESSAGES_AHEAD, compression=None,
            ping_interval=_PING_SECONDS, ping_timeout=_PING_SECONDS, close_timeout=CLOSE_SECONDS,
            logger=_SILENT, server_header=None)
        playing = None if self.output is None else asyncio.create_task(self.output.play())
        try:
            if ready is not None:
                ready()
            await self._stop.wait()
            await self._drain(server)
        finally:
            if playing is not None:
                playing.cancel()
            server.close()
            await server.wait_closed()
            self.compute.stop()

    # ------------------------------------------------------------ streams

    def admit(self, connection: Connection, request: StreamRequest) -> None:
        """Give a connection a place; `RefusedError` if there is none or the token is wrong."""
        # The token comes first: a stranger learns nothing about how full the server is.
        if not self.address.accepts(request.token):
            raise RefusedError(CloseCode.BAD_TOKEN, "the token is missing or wrong")
        if self.draining:
            raise RefusedError(CloseCode.GOING_AWAY, "the server is shutting down", retry_after=1.0)
        if self.full:
            raise RefusedError(CloseCode.TOO_MANY_STREAMS, f"there are {len(self.connections)} streams", RETRY_SECONDS)
        self.connections.add(connection)

    @property
    def full(self) -> bool:
        """Whether another stream would be refused."""
        return len(self.connections) >= self.limits.streams

    async def _serve_one(self, ws: ServerConnection) -> None:
        connection = Connection(ws, str(next(self._numbers)), self)
        try:
            await connection.run()
        finally:
            self.connections.discard(connection)
            self.metrics.closed.labels(str(int(connection.code))).inc()
            peer = ws.remote_address
            LOG.info("stream %s from %s: %.1f s of sound, %d frames, %d %s", connection.name,
                     f"{peer[0]}:{peer[1]}" if peer else "?", connection.seconds, connection.frames, connection.code,
                     " ".join(connection.reason.split()))

    async def _drain(self, server: Server) -> None:
        self.draining = True
        # No new connections; the open ones go on.
        server.close(close_connections=False)
        if self.connections:
            LOG.info("stopping: %d streams have %g s", len(self.connections), self.limits.drain_seconds)
        await self._wait_for_streams(self.limits.drain_seconds)
        for connection in list(self.connections):
            await connection.leave()
        await self._wait_for_streams(max(self.limits.drain_seconds, FINISH_SECONDS))
        for connection in self.connections:
            connection.socket.transport.abort()

    async def _wait_for_streams(self, seconds: float) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while self.connections:
                    await asyncio.sleep(0.02)

    # ------------------------------------------------------------ HTTP requests

    async def _answer(self, ws: ServerConnection, request: Request) -> Response | None:
        """None to open a WebSocket, else the HTTP response."""
        path = request.path.partition("?")[0]
        if path == published()["path"]:
            origin = request.headers.get("Origin")
            return None if origin is None or self.address.admits(origin) else _response(
                HTTPStatus.FORBIDDEN, b"pages of this origin may not connect; see --origin\n")
        if not self.address.is_host(request.headers.get("Host", "")):
            return _response(HTTPStatus.FORBIDDEN, b"this is not the server of that name; see --origin\n")
        if path == "/healthz":
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, b"stopping\n") if self.draining \
                else _response(HTTPStatus.OK, b"ok\n")
        if path == "/readyz":
            return self._readiness()
        if path == "/metrics":
            return self._metrics(request)
        if path in self.pages:
            kind = _PAGE_KINDS.get(path[path.rfind("."):], "text/html")
            return _response(HTTPStatus.OK, self.pages[path], f"{kind}; charset=utf-8")
        return _response(HTTPStatus.NOT_FOUND,
                         f"there are {published()['path']}, /healthz, /readyz and /metrics\n".encode())

    def _metrics(self, request: Request) -> Response:
        """The metrics, to anybody if the server has no token."""
        # RFC 6750: Authorization: Bearer TOKEN.
        kind, _, token = request.headers.get("Authorization", "").partition(" ")
        if self.address.token and not (kind.lower() == "bearer" and self.address.accepts(token.strip())):
            return _response(HTTPStatus.UNAUTHORIZED, b"send Authorization: Bearer TOKEN\n",
                             more={"WWW-Authenticate": "Bearer"})
        return _response(HTTPStatus.OK, generate_latest(self.metrics.registry), CONTENT_TYPE_LATEST)

    def _readiness(self) -> Response:
        """Whether another stream would be admitted."""
        text = f"{len(self.connections)} of {self.limits.streams} streams\n"
        if self.draining or self.full:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, f"{'stopping' if self.draining else 'full'}: "
                             f"{text}".encode(), more={"Retry-After": str(math.ceil(RETRY_SECONDS))})
        return _response(HTTPStatus.OK, f"ok: {text}".encode())


def _subprotocol(ws: ServerConnection, offered: Any) -> Any:
    """The protocol's name if it is offered; a client without one is served too, since the hello holds the version."""
    return published()["subprotocol"] if published()["subprotocol"] in offered else None


def _response(status: HTTPStatus, body: bytes, kind: str = _TEXT, more: Mapping[str, str] | None = None) -> Response:
    headers = Headers({"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close",
                       "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", **(more or {})})
    return Response(status.value, status.phrase, headers, body)


