"""Passing a client on to the worker that keeps its stream.

Workers accept connections from one socket, so a client that comes back reaches any of them. The name of its session
says which one has it; a worker that gets another one's client opens a WebSocket to that worker, over a Unix socket in
the folder that they share, and carries messages both ways.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from websockets.asyncio.client import unix_connect
from websockets.exceptions import ConnectionClosed, WebSocketException

from data_module.errors import InputError
from data_module.files import parse_json
from gesticulator.serve.protocol import published

if TYPE_CHECKING:
    from websockets.asyncio.connection import Connection as Socket
    from websockets.asyncio.server import ServerConnection

CAN_RELAY = hasattr(socket, "AF_UNIX")
"""Not on Windows, where a client that reaches another worker replays its sound."""
_OPEN_SECONDS = 5.0
"""Time for the other worker to answer a hello; it does so in milliseconds."""
_QUEUE = 4
"""Messages that wait in this worker: few, since the other one keeps those that a client may have missed."""

_NO_CODE = 1005
"""A close frame without a code, which cannot be sent as one."""


def inner_socket(folder: Path, worker: int) -> Path:
    """Where a worker takes the clients of others."""
    return folder / f"{worker}.sock"


def worker_of(session: str) -> int | None:
    """The worker that a session's name names, see `new_session`."""
    found = re.match(r"(\d{1,3})-", session)
    return None if found is None else int(found[1])


def is_inner(ws: ServerConnection) -> bool:
    """Whether a connection comes from another worker."""
    own = ws.transport.get_extra_info("socket")
    return CAN_RELAY and own is not None and own.family == socket.AF_UNIX


async def relay(ws: ServerConnection, hello: str, address: str, place: Path, begun: Callable[[], None]) -> bool:
    """Carry messages between a client and another worker until one of them is gone; False if that worker does not go on
    with the session, and nothing was sent.

    hello: the client's, as it came; address: the client's; place: `inner_socket`; begun: called when it goes on.
    """
    try:
        async with asyncio.timeout(_OPEN_SECONDS):
            inner = await unix_connect(str(place), f"ws://worker{published()['path']}", compression=None, max_size=None,
                                       max_queue=_QUEUE, ping_interval=None,
                                       additional_headers={"X-Forwarded-For": address})
            try:
                await inner.send(hello)
                answer = await inner.recv(decode=True)
            except BaseException:
                inner.transport.abort()
                raise
    except (OSError, WebSocketException, TimeoutError):
        return False
    if not _goes_on(answer):
        await inner.close()
        return False
    begun()
    pumps = {asyncio.create_task(_carry(ws, inner)), asyncio.create_task(_carry(inner, ws))}
    try:
        await ws.send(answer)
        await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
    except ConnectionClosed:
        pass
    finally:
        for pump in pumps:
            pump.cancel()
        await asyncio.gather(*pumps, return_exceptions=True)
        await asyncio.gather(_end_as(inner, ws), _end_as(ws, inner))
    return True


def _goes_on(answer: str) -> bool:
    try:
        told = parse_json(answer, "worker", "")
    except InputError:
        return False
    return isinstance(told, dict) and bool(told.get("resumed"))


async def _carry(source: Socket, target: Socket) -> None:
    """Each message as it comes, until one of the two is gone."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            message: Any = await source.recv()
            await target.send(message)


async def _end_as(ended: Socket, other: Socket) -> None:
    """End a connection as the other one ended: with its code, or by breaking it. Nothing if it goes on, or both did."""
    closed = other.protocol.close_rcvd
    if other.protocol.close_code is None or ended.protocol.close_code is not None:
        return
    if closed is None:
        ended.transport.abort()
        return
    try:
        async with asyncio.timeout(_OPEN_SECONDS):
            await ended.close(1000 if closed.code == _NO_CODE else closed.code, closed.reason)
    except TimeoutError:
        ended.transport.abort()
