"""The server: WebSocket streams, health and metrics on one port, and one compute thread for all streams."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http
import ipaddress
import itertools
import json
import logging
import math
import os
import signal
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve, unix_serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from data_module.errors import InputError
from gesticulator.serve.connection import CLOSE_SECONDS, Connection, Workplace
from gesticulator.serve.door import Door, Tenant, TenantKeys, bare_address, network_of
from gesticulator.serve.governor import PRIOR_COST, RETRY_SECONDS, REVIEW_SECONDS, Governor, Room
from gesticulator.serve.memory import RELEASE_SECONDS, release_ended
from gesticulator.serve.metrics import CONTENT_TYPE, ServerMetrics, exposition, read_figures, write_figures
from gesticulator.serve.pace import Effort
from gesticulator.serve.protocol import CloseCode, RefusedError, StreamRequest, published
from gesticulator.serve.relay import CAN_RELAY, inner_socket, is_inner, relay, worker_of
from gesticulator.serve.scheduler import Account, Scheduler
from gesticulator.serve.settings import OPENS_AT_ONCE, SOCKET_BYTES, ServerLimits

if TYPE_CHECKING:
    from gesticulator.serve.session import Session
    from gesticulator.serve.vmc import PoseOutput

LOG = logging.getLogger("gesticulator.serve")
ANSWER_SECONDS = 10.0
"""Least time for finishing received audio when the server stops, seconds."""
SAVE_SECONDS = 1.0
"""Interval in seconds at which a worker writes its metrics for the others."""
STUCK_SECONDS = 5.0
"""Time of a turn, which takes 30 ms, after which `/healthz` fails."""
DEAD_SECONDS = 60.0
"""The same after which a worker that others replace ends itself."""
OPEN_SECONDS = 5.0
"""Time for a client to send its HTTP request."""
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
    and clients other than browsers always may. token: required in a client's hello, and for `/metrics`; "" for none.
    keys: a file of tenants' keys, see `TenantKeys`. proxies: networks of proxies that are believed about who a client
    is (X-Forwarded-For). metrics_port: where `/metrics` is, without a token, in place of the port of streams.
    metrics_host: the address of that port, "" for that of streams.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
    token: str = ""
    keys: Path | None = None
    proxies: tuple[str, ...] = ()
    metrics_port: int | None = None
    metrics_host: str = ""

    def __post_init__(self) -> None:
        for port in (self.port, self.metrics_port or 0):
            if not 0 <= port <= 65535:
                raise InputError(f"port {port}", "is not a port", "choose 0 (any free one) to 65535")
        for network in self.proxies:
            try:
                ipaddress.ip_network(network)
            except ValueError:
                raise InputError(f"--trusted-proxy {network}", "is not an address or a network",
                                 "such as 10.0.0.0/8") from None

    @property
    def local(self) -> bool:
        """Whether only this machine can connect."""
        return self.host in _LOOPBACK

    def believed(self, address: str) -> bool:
        """Whether it is the address of a trusted proxy."""
        try:
            found = ipaddress.ip_address(address.partition("%")[0])
        except ValueError:
            return False
        return any(found in ipaddress.ip_network(network) for network in self.proxies)

    def listen_for_metrics(self) -> socket.socket | None:
        """Open the listening socket of the metrics, or None if they have none; `InputError` if that fails."""
        if self.metrics_port is None:
            return None
        return replace(self, host=self.metrics_host or self.host, port=self.metrics_port).listen()

    def listen(self) -> socket.socket:
        """Open a listening socket for streams; `InputError` if that fails."""
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
    -> file; folder: where workers of one server share their metrics; cost: computing time of a second of speech,
    seconds, as measured before the first stream; None for the usual one.
    """

    address: ServerAddress
    limits: ServerLimits
    open_session: Callable[[str, StreamRequest], Session]
    output: PoseOutput | None = None
    pages: Mapping[str, Page] = field(default_factory=dict)
    folder: Path | None = None
    worker: int = 0
    cost: float | None = None

    def __post_init__(self) -> None:
        self.metrics = ServerMetrics(self.worker)
        self.connections: set[Connection] = set()
        self.relayed: set[Connection] = set()
        """Connections whose streams another worker has."""
        self.draining = False
        # One thread: Python runs one at a time. Use more workers for more cores.
        self.scheduler = Scheduler()
        self.governor = Governor(self.limits.core_share, self.limits.streams,
                                 PRIOR_COST if self.cost is None else self.cost)
        self.door = Door(self.limits.guests, self.limits.address_guests)
        self.keys = TenantKeys(self.address.token, self.address.keys)
        self._accounts: dict[str, Account] = {}
        self._numbers = itertools.count(1)
        self._stop = asyncio.Event()
        self._left = 0
        """Connections that ended since memory was released."""
        self._save_failed = False
        """Whether the last attempt to write the metrics failed."""

    def stop(self) -> None:
        """Stop: no new streams, `drain_seconds` for open ones, then finish them. A second call aborts at once."""
        if self._stop.is_set():
            for connection in self.connections | self.relayed:
                connection.socket.transport.abort()
        self._stop.set()

    async def run(self, listening: socket.socket, ready: Callable[[], None] | None = None,
                  figures: socket.socket | None = None) -> None:
        """Serve on a listening socket until `stop`, SIGTERM or SIGINT. figures: where health and metrics are served
        besides."""
        published()  # report a missing schema before anyone connects
        loop = asyncio.get_running_loop()
        for name in (signal.SIGTERM, signal.SIGINT):
            with contextlib.suppress(NotImplementedError, ValueError, RuntimeError):  # Windows; not the main thread
                loop.add_signal_handler(name, self.stop)
        await self._save()  # so that each worker can report the metrics of all ready ones
        self.scheduler.start()
        server = await self._listen(listening, self._answer)
        inner = [] if figures is None else [await self._listen(figures, self._tell)]
        inner += await self._listen_to_workers()
        kept = (self._keep_saving(), self._keep_reviewing(), self._keep_releasing())
        tasks = [asyncio.create_task(one) for one in kept]
        try:
            if ready is not None:
                ready()
            await self._stop.wait()
            await self._drain(server)
        finally:
            for task in tasks:
                task.cancel()
            for one in (server, *inner):
                one.close()
                await one.wait_closed()
            self.scheduler.stop()

    async def _listen(self, listening: socket.socket, answer: Callable[..., Any]) -> Server:
        return await serve(self._serve_one, sock=listening, process_request=answer, **self._settings())

    async def _listen_to_workers(self) -> list[Server]:
        """Take clients of other workers that have a session here; none if there are no others."""
        if self.folder is None or not CAN_RELAY:
            return []
        place = inner_socket(self.folder, self.worker)
        try:
            place.unlink(missing_ok=True)  # of the worker whose place this one took
            return [await unix_serve(self._serve_one, str(place), process_request=self._answer, **self._settings())]
        except OSError as error:
            LOG.warning("worker %d cannot take clients of the others (%s): they replay their sound", self.worker, error)
            return []

    def _settings(self) -> dict[str, Any]:
        return {
            "select_subprotocol": _subprotocol, "create_connection": partial(_Guest, self),
            "max_size": self.limits.message_bytes, "max_queue": _SOUND_QUEUE, "compression": None,
            "open_timeout": OPEN_SECONDS, "ping_interval": _PING_SECONDS, "ping_timeout": _PING_SECONDS,
            "close_timeout": CLOSE_SECONDS, "logger": _quiet(), "server_header": None}

    # ------------------------------------------------------------ streams

    def admit(self, connection: Connection, request: StreamRequest) -> Connection | None:
        """Give a connection a place, or find the stream that it resumes; see `Host`."""
        tenant = self.keys.tenant(request.token)
        if tenant is None:
            self.door.wrong(connection.address)
            self.metrics.add("wrong_tokens_total")
            raise RefusedError(CloseCode.BAD_TOKEN, "the token is lacking or wrong")
        self.door.leave(connection.socket)  # type: ignore[arg-type]
        connection.tenant = tenant.name
        if request.resume is not None:
            for other in self.connections:
                if other.session == request.resume["session"] and other.tenant == tenant.name:
                    return other
        if is_inner(connection.socket):
            raise RefusedError(CloseCode.TOO_MANY_STREAMS, "the session is gone")  # the other worker opens a stream
        self._check_room(connection, tenant)
        connection.priority = tenant.priority
        connection.member.account = self._account(tenant.name or connection.address)
        self.connections.add(connection)
        self.metrics.add("streams")
        self.metrics.add("streams_total")
        return None

    async def passed_on(self, connection: Connection, request: StreamRequest) -> bool:
        """Serve a client that comes back at the worker that has its session; see `Host`."""
        worker = None if request.resume is None else worker_of(request.resume["session"])
        if self.folder is None or worker is None or worker == self.worker or is_inner(connection.socket) \
                or self.keys.tenant(request.token) is None:
            return False

        def begun() -> None:
            self.door.leave(connection.socket)  # type: ignore[arg-type]
            self.relayed.add(connection)
            self.metrics.add("relayed_total")

        try:
            went_on = await relay(connection.socket, connection.hello, connection.address,
                                  inner_socket(self.folder, worker), begun)
        finally:
            self.relayed.discard(connection)
        if went_on:
            connection.code = connection.socket.close_code or CloseCode.NORMAL
            connection.reason = f"went on at worker {worker}"
        return went_on

    def _check_room(self, connection: Connection, tenant: Tenant) -> None:
        """`RefusedError` if there is no place for another stream. Streams whose clients are gone give way."""
        if self.draining:
            raise RefusedError(CloseCode.GOING_AWAY, "the server is shutting down", retry_after=1.0)
        client = f"tenant {tenant.name}" if tenant.name else connection.address
        wait = self.door.open_wait(client, self.limits.address_opens, OPENS_AT_ONCE)
        if wait > 0:
            raise RefusedError(CloseCode.TOO_MANY_STREAMS, "this client opens streams too fast", math.ceil(wait))
        same = [one for one in self.connections if (one.tenant == tenant.name if tenant.name
                                                    else one.address == connection.address)]
        most = tenant.streams or self.limits.address_streams
        room = self.room
        for full, streams in ((bool(most) and len(same) >= most, same), (not room.open, list(self.connections))):
            parked = [one for one in streams if one.parked]
            if full and not parked:
                reason = room.reason if streams is not same else f"there are {len(same)} streams of this client"
                raise RefusedError(CloseCode.TOO_MANY_STREAMS, reason, RETRY_SECONDS)
            if full:
                parked[0].give_up()
                self.connections.discard(parked[0])
                self.metrics.add("streams", -1)
                return

    @property
    def room(self) -> Room:
        """Whether another stream would be admitted."""
        return self.governor.room(len(self.connections))

    def _account(self, name: str) -> Account:
        """What all streams of a tenant or an address share; forgotten with the last of them."""
        account = self._accounts.setdefault(name, Account(name))
        used = {one.member.account.name for one in self.connections}
        for gone in [other for other in self._accounts if other not in used and other != name]:
            del self._accounts[gone]
        return account

    def effort(self, connection: Connection) -> Effort:
        """How a stream is served while compute is short."""
        return self.governor.effort(connection, self.governor.ranked(self._by_age())) if self.governor.depth \
            else Effort.FULL

    def worked(self, seconds: float, took: float) -> None:
        """Seconds of speech took so much computing."""
        self.governor.worked(seconds, took)

    def _by_age(self) -> list[Connection]:
        return sorted(self.connections, key=lambda one: one.number)

    async def _keep_reviewing(self) -> None:
        while True:
            await asyncio.sleep(REVIEW_SECONDS)
            self.governor.review(self._by_age())
            if self.folder is not None and self.scheduler.stuck_seconds > DEAD_SECONDS:
                LOG.error("worker %d computes one turn for more than %g s: it ends, to be replaced", self.worker,
                          DEAD_SECONDS)
                os._exit(70)

    async def _keep_releasing(self) -> None:
        while True:
            await asyncio.sleep(RELEASE_SECONDS)
            if self._left:
                self._left = 0
                release_ended()

    async def _serve_one(self, ws: ServerConnection) -> None:
        number = next(self._numbers)
        place = Workplace(self.limits, self.metrics, self.scheduler, self.open_session, self, self.output)
        connection = Connection(ws, f"{self.worker}-{number}", place, self._address_of(ws, ws.request))
        connection.number = number
        try:
            if self.draining:
                await connection.refuse(RefusedError(CloseCode.GOING_AWAY, "the server is shutting down", 1.0))
            else:
                await connection.run()
        finally:
            self.door.leave(ws)  # type: ignore[arg-type]
            if connection in self.connections:
                self.connections.discard(connection)
                self.metrics.add("streams", -1)
            self._left += 1
            self._log(connection)

    def _address_of(self, ws: ServerConnection, request: Request | None) -> str:
        """The client's address, by a trusted proxy's word if it came through one, or by another worker's."""
        if request is not None and is_inner(ws):
            return request.headers.get("X-Forwarded-For", "")
        peer = ws.remote_address
        address = str(peer[0]) if peer else ""
        if request is not None and self.address.believed(address):
            for told in reversed(",".join(request.headers.get_all("X-Forwarded-For")).split(",")):
                client = bare_address(told)
                if client and not self.address.believed(client):
                    return network_of(client)
        return network_of(address)

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
        for connection in self.connections | self.relayed:
            connection.socket.transport.abort()

    async def _wait_for_streams(self, seconds: float) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while self.relayed or any(not one.parked for one in self.connections):
                    await asyncio.sleep(0.02)

    async def _keep_saving(self) -> None:
        while self.folder is not None:
            await asyncio.sleep(SAVE_SECONDS)
            await self._save()

    async def _save(self) -> None:
        """Write the metrics for the other workers, in a thread so that a slow disk blocks no stream."""
        if self.folder is None:
            return
        self._measure()
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
            return self._opening(ws, request)
        if path == "/metrics" and self.address.metrics_port is not None:
            return self._refusal(http.HTTPStatus.NOT_FOUND, "the metrics are at another port\n")
        if path == "/metrics" and not self._may_read(request):
            refused = self._refusal(http.HTTPStatus.UNAUTHORIZED, "send Authorization: Bearer TOKEN\n")
            refused.headers["WWW-Authenticate"] = "Bearer"
            return refused
        if path in self.pages:
            return _response(http.HTTPStatus.OK, self.pages[path].body, self.pages[path].kind)
        return await self._tell(ws, request)

    async def _tell(self, ws: ServerConnection, request: Request) -> Response:
        """Health and metrics."""
        path = request.path.partition("?")[0]
        if path == "/healthz":
            return self._health()
        if path == "/readyz":
            return self._readiness()
        if path == "/metrics":
            self._measure()
            others = [] if self.folder is None else await asyncio.to_thread(read_figures, self.folder, self.worker)
            text = exposition([self.metrics.figures(), *others])
            return _response(http.HTTPStatus.OK, text.encode(), CONTENT_TYPE)
        return self._refusal(http.HTTPStatus.NOT_FOUND,
                             f"there are {published()['path']}, /healthz, /readyz and /metrics\n")

    def _opening(self, ws: ServerConnection, request: Request) -> Response | None:
        """None for a WebSocket that may be opened."""
        origin = request.headers.get("Origin")
        if origin is not None and not self._may(origin):
            return self._refusal(http.HTTPStatus.FORBIDDEN, "pages of this origin may not connect; see --origin\n")
        address = self._address_of(ws, request)
        wait = self.door.wait(address)
        if wait > 0:
            refused = self._refusal(http.HTTPStatus.TOO_MANY_REQUESTS, "too many wrong tokens from this address\n")
            refused.headers["Retry-After"] = str(math.ceil(wait))
            return refused
        self.metrics.add("guests_cut_total", self.door.enter(ws, address))  # type: ignore[arg-type]
        return None

    def _may_read(self, request: Request) -> bool:
        """Whether a request may read the metrics: with the server's own token, if there are tokens."""
        if not self.keys:
            return True
        kind, _, token = request.headers.get("Authorization", "").partition(" ")
        return kind.lower() == "bearer" and self.keys.tenant(token.strip()) == Tenant()

    def _health(self) -> Response:
        """Whether the server works: its compute thread goes on, and it is not stopping."""
        stuck = self.scheduler.stuck_seconds
        if stuck > STUCK_SECONDS:
            return self._refusal(http.HTTPStatus.SERVICE_UNAVAILABLE, f"one turn has been computed for {stuck:.0f} s\n")
        return self._refusal(http.HTTPStatus.SERVICE_UNAVAILABLE, "stopping\n") if self.draining \
            else _response(http.HTTPStatus.OK, b"ok\n", "text/plain; charset=utf-8")

    def _readiness(self) -> Response:
        """Whether another stream would be admitted, and what the server has room for."""
        health, room = self._health(), self.room
        if health.status_code != http.HTTPStatus.OK:
            return health
        if not room.open:
            refused = self._refusal(http.HTTPStatus.SERVICE_UNAVAILABLE, f"full: {room.reason}\n")
            refused.headers["Retry-After"] = str(math.ceil(RETRY_SECONDS))
            return refused
        text = f"ok: {room.streams} of {room.capacity} streams\n"
        return _response(http.HTTPStatus.OK, text.encode(), "text/plain; charset=utf-8")

    def _measure(self) -> None:
        """Bring the gauges up to date that nothing else counts."""
        room = self.room
        for name, value in (("capacity_streams", room.capacity), ("promised_load", room.load),
                            ("downgraded_steps", self.governor.depth), ("guests", len(self.door)),
                            ("stuck_seconds", self.scheduler.stuck_seconds)):
            self.metrics.set(name, value)

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


class _Guest(ServerConnection):
    """A connection that is counted from its first byte until its hello or its end."""

    def __init__(self, server: LiveServer, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._live = server

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        peer = transport.get_extra_info("peername")
        address = str(peer[0]) if peer else ""
        # Behind a proxy, whose client it is becomes known with the request.
        known = "" if self._live.address.believed(address) else network_of(address)
        self._live.metrics.add("guests_cut_total", self._live.door.enter(self, known))

    def connection_lost(self, exc: Exception | None) -> None:
        self._live.door.leave(self)
        super().connection_lost(exc)

    def cut(self) -> None:
        """End the connection at once: there are too many like it."""
        self.transport.abort()


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
