"""A client that comes back: a lost connection is opened again, and what had no poses yet is sent once more.

The new connection is a new stream for the server, which begins at rest; the client numbers its frames on, so a few
frames may come twice. Show the poses with a `SteadyPlayer`, which idles while there are none and blends where another
stream begins.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from pipecat_gesticulator.client import LONGEST_MESSAGE, GestureStream
from pipecat_gesticulator.protocol import SUBPROTOCOL, Hello, Poses, Welcome

FIRST_WAIT, LONGEST_WAIT = 0.25, 10.0
"""Seconds before the second try to come back (the first one is made at once), and at most; each wait is twice the last
one, times 0.5 to 1 by chance, and what the server asks for (`retry_after`) is added. New poses end the series."""
FINAL = {4400, 4401, 4408, 4413}
"""Close codes after which it is no use to come back."""


class RefusedError(ConnectionError):
    """The server refused the stream. code: of `CLOSE_CODES`; retry_after: seconds, or None."""

    def __init__(self, message: str, code: int, retry_after: float | None = None) -> None:
        super().__init__(message)
        self.code, self.retry_after = code, retry_after


@dataclass(frozen=True)
class _Sent:
    """A message. start, until: the media times of the whole conversation that it is about, seconds; other_voice:
    whether it comes after `listen`, and its sound is another person's voice."""

    message: bytes | dict[str, Any]
    start: float
    until: float
    other_voice: bool


class ResumingStream(GestureStream):
    """As `GestureStream`, on as many connections as it takes. Iterating gives `Poses`, the server's events, and
    `{"type": "lost"}` and `{"type": "back"}`."""

    def __init__(self, url: str, hello: Hello, patience: float = 300.0,
                 pause: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        """patience: seconds of waiting after which a lost server is given up (`ConnectionError`); pause: waits."""
        self._url, self._hello, self._patience, self._pause = url, hello, patience, pause
        self._wait, self._waited, self._retry_after = 0.0, 0.0, 0.0
        """Seconds before the next try by the client's rule, of all waits since the last poses, and those that the
        server asked for in addition."""
        self._socket: ClientConnection | None = None
        self._journal: deque[_Sent] = deque()
        """Messages about times whose poses have not come."""
        self._unsent: deque[_Sent] = deque()
        """Messages that the connection that is being opened still has to send."""
        self._base, self._source = 0.0, -1
        """Media time at which this connection began, that of a frame; connections before it."""
        self._stale = False
        """Whether an interruption reached back before that."""
        self._end = 0
        """Number of the first frame that has not come, or that an interruption took back."""
        self._interrupting = 0
        """Interruptions that the server has not answered yet: packets that still come were made before them."""
        self._time, self._other_voice, self._done = 0.0, False, False
        self.welcome: Welcome

    async def close(self) -> None:
        """Let go of the server."""
        self._done = True
        if self._socket is not None:
            await self._socket.close()

    async def send(self, sound: bytes) -> None:
        """Send mono sound in the format of the hello; while the connection is lost, it is kept."""
        rate = self._hello.sample_rate * (2 if self._hello.format == "pcm16" else 4)
        longest = int(self.welcome.limits["message_bytes"]) // 4 * 4
        for start in range(0, len(sound), longest):
            piece = sound[start:start + longest]
            await self._record(piece, len(piece) / rate)

    async def interrupt(self, time: float | None = None) -> None:
        """The voice was cut off. time: seconds of media time that were played; left out, all frames that came are."""
        at = self._end / self._hello.fps if time is None else min(time, self._time)
        self._end, self._time = min(self._end, math.ceil(at * self._hello.fps - 1e-6)), at
        # What was sent for later times is not sent again.
        self._journal = deque(sent for sent in self._journal if sent.start < at)
        await self._say({"type": "interrupt", "time": at})
        self._stale = at < self._base
        if self._stale and self._socket is not None:
            # The server knows nothing of what was before this connection: the next one begins there.
            await self._socket.close()

    async def __aiter__(self) -> AsyncIterator[Poses | dict[str, Any]]:
        while not self._done:
            socket = self._socket
            if socket is None:
                yield {"type": "lost"}
                await self._come_back()
                yield {"type": "back"}
                continue
            with suppress(ConnectionClosed):
                async for message in socket:
                    event = self._read(message)
                    if isinstance(event, dict) and event["type"] == "error":
                        if event["code"] in FINAL:
                            raise RefusedError(event["message"], event["code"])
                        self._retry_after = float(event.get("retry_after") or 0.0)
                        continue
                    yield event
                    if isinstance(event, dict) and event["type"] == "done":
                        self._done = True
                        return
            self._socket = None

    def _read(self, message: str | bytes) -> Poses | dict[str, Any]:
        if isinstance(message, bytes):
            poses = Poses.unpack(message)
            first = poses.first + round(self._base * self._hello.fps)
            if not self._interrupting:
                if first + len(poses) > self._end:
                    self._end, self._wait, self._waited = first + len(poses), 0.0, 0.0
                while self._journal and self._journal[0].until <= self._end / self._hello.fps:
                    self._journal.popleft()
            return replace(poses, first=first, source=self._source)
        event: dict[str, Any] = json.loads(message)
        if event["type"] == "interrupted":
            self._interrupting = max(0, self._interrupting - 1)
        for name in ("time", "start", "end"):
            if name in event:
                event[name] += self._base
        return event

    async def _say(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind in ("listen", "speak"):
            self._other_voice = kind == "listen"
        if kind == "finish":
            await self._record(message, math.inf)
        elif kind == "words":
            await self._record(message, 0.0, max((word["end"] for word in message["words"]), default=0.0))
        else:
            await self._record(message, float(message.get("seconds", 0.0)))

    async def _record(self, message: bytes | dict[str, Any], seconds: float, until: float = 0.0) -> None:
        """Keep a message until there are poses for its time, and send it if there is a connection."""
        sent = _Sent(message, self._time, max(self._time + seconds, until), self._other_voice)
        if math.isfinite(seconds):
            self._time += seconds
        self._journal.append(sent)
        if self._socket is None:
            self._unsent.append(sent)
            return
        with suppress(ConnectionClosed):  # a loss is noticed by the reader
            await self._transmit(self._socket, message)

    async def _transmit(self, socket: ClientConnection, message: bytes | dict[str, Any]) -> None:
        if isinstance(message, dict) and message["type"] == "interrupt":
            self._interrupting += 1
        await socket.send(self._shifted(message))

    def _shifted(self, message: bytes | dict[str, Any]) -> bytes | str:
        """A message with its times in this connection's media time."""
        if isinstance(message, bytes):
            return message
        if "time" in message:
            message = {**message, "time": max(0.0, message["time"] - self._base)}
        if "words" in message:
            message = {**message, "words": [
                {**word, "start": max(0.0, word["start"] - self._base), "end": word["end"] - self._base}
                for word in message["words"] if word["end"] >= self._base]}
        return json.dumps(message)

    async def _come_back(self) -> None:
        """Connect again, however often it takes."""
        problem: Exception | None = None
        while True:
            wait = self._retry_after + self._wait * random.uniform(0.5, 1.0)
            self._wait, self._retry_after = min(max(2 * self._wait, FIRST_WAIT), LONGEST_WAIT), 0.0
            self._waited += wait
            if self._waited > self._patience:
                raise ConnectionError(f"the server did not come back: {problem or 'it breaks each connection'}"
                                      ) from problem
            await self._pause(wait)
            try:
                await self.open()
                return
            except RefusedError as error:
                if error.code in FINAL:
                    raise
                self._retry_after, problem = error.retry_after or 0.0, error
            except (OSError, InvalidHandshake, ConnectionClosed, TimeoutError, ValueError) as error:
                problem = error

    async def open(self) -> None:
        """Connect, and send what has no poses yet. A server that is not there, or says no, is an error."""
        socket = await open_socket(self._url, subprotocols=[SUBPROTOCOL], max_size=LONGEST_MESSAGE,  # type: ignore[list-item]
                                   compression=None)
        try:
            await socket.send(self._hello.text())
            text = str(await socket.recv(decode=True))
            answer = json.loads(text)
            if answer.get("type") == "error":
                raise RefusedError(answer["message"], answer["code"], answer.get("retry_after"))
            self.welcome = Welcome.read(text)
            self._source, self._stale, self._interrupting = self._source + 1, False, 0
            self._unsent = deque(self._journal)
            first = self._journal[0] if self._journal else _Sent(b"", self._time, self._time, self._other_voice)
            # Where a frame begins: of a time between two, we and the server would round up to different frames.
            self._base = round(first.start * self._hello.fps) / self._hello.fps
            if first.other_voice:
                await socket.send(json.dumps({"type": "listen"}))
            while self._unsent:  # what is said meanwhile is sent in its turn
                await self._transmit(socket, self._unsent.popleft().message)
            if self._stale:
                raise ConnectionError("an interruption reached back before the connection while it was opened")
        except BaseException:
            await socket.close()
            raise
        self._socket = socket


@asynccontextmanager
async def connect_resuming(url: str, hello: Hello, patience: float = 300.0) -> AsyncIterator[ResumingStream]:
    """Open a stream that comes back; see `client.connect`."""
    stream = ResumingStream(url, hello, patience)
    await stream.open()
    try:
        yield stream
    finally:
        await stream.close()
