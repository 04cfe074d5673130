"""A client that comes back: a lost connection is opened again, and the sound is replayed from the first missing
frame.

The new connection is a new stream for the server, which begins at rest; the client numbers its frames on. Show the
poses with a `SteadyPlayer`, which idles while there are none and blends where another stream begins.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage, InvalidStatus

from pipecat_gesticulator.client import LONGEST_MESSAGE, GestureStream
from pipecat_gesticulator.protocol import SUBPROTOCOL, Hello, Poses, Welcome

FIRST_WAIT, LONGEST_WAIT = 0.25, 10.0
"""Seconds before the second try to come back (the first one is made at once), and at most; each wait is twice the last
one, times 0.5 to 1 by chance, and what the server asks for (`retry_after`) is added."""
LASTED = 5.0
"""Seconds that a connection must hold before the next loss is a new one. Until then waits go on growing, and patience
goes on running out, so that a server that accepts and breaks is not visited again and again."""
JOURNAL_BYTES = 2**23
"""Sent messages that are kept to be sent once more: 174 s of 16-bit sound at 24 kHz."""
FIRST_TRIES = 4
"""How often the first connection is tried where a server answers and then breaks it: its worker died, or is too
busy."""
FINAL = {4400, 4401, 4408, 4413}
"""Close codes after which it is no use to come back."""


class RefusedError(ConnectionError):
    """The server refused the stream. code: of `CLOSE_CODES`; retry_after: seconds, or None."""

    def __init__(self, message: str, code: int, retry_after: float | None = None) -> None:
        super().__init__(message)
        self.code, self.retry_after = code, retry_after


@dataclass(frozen=True)
class _Sent:
    """A message. start: media time at which it begins, seconds, of the whole conversation; seconds: that it lasts;
    other_voice: whether it comes after `listen`, and its sound is another person's voice."""

    message: bytes | dict[str, Any]
    start: float
    seconds: float
    other_voice: bool


class ResumingStream(GestureStream):
    """As `GestureStream`, on as many connections as it takes. Iterating gives `Poses`, the server's events, and
    `{"type": "lost"}` and `{"type": "back"}`."""

    def __init__(self, url: str, hello: Hello, patience: float = 300.0, *, chance: Callable[[], float] = random.random,
                 clock: Callable[[], float] = time.monotonic,
                 pause: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        """patience: seconds after which a lost server is given up (`ConnectionError`); chance: numbers of [0, 1);
        clock and pause: seconds that go by, and waiting for them."""
        self._url, self._hello, self._patience = url, hello, patience
        self._chance, self._clock, self._pause = chance, clock, pause
        self._wait, self._retry_after = 0.0, 0.0
        """Seconds before the next try: by the client's rule, and those that the server asked for in addition."""
        self._opened, self._lost_since = -math.inf, 0.0
        self._socket: ClientConnection | None = None
        self._journal: deque[_Sent] = deque()
        self._journal_bytes = 0
        self._unsent: deque[_Sent] = deque()
        """Messages that the connection that is being opened still has to send."""
        self._offset, self._source = 0, 0
        """Frames before this connection's first one; connections before it."""
        self._replay_again = False
        """Whether an interruption reached back before the first frame of this connection."""
        self._closing: set[asyncio.Task[None]] = set()
        """Connections that are being closed."""
        self._end = 0
        """Number of the first frame that has not come, or that an interruption took back."""
        self._cut: float = math.inf
        """The first frame that an interruption took back, until the server's packet that replaces it; those that were
        on their way come first."""
        self._time, self._other_voice, self._done = 0.0, False, False
        self.welcome: Welcome

    @property
    def connected(self) -> bool:
        """Whether there is a connection now."""
        return self._socket is not None

    @property
    def time(self) -> float:
        """Media time of what was sent, seconds."""
        return self._time

    async def open(self) -> None:
        """Connect for the first time. A server that is not there, or says no, is an error at once; one that breaks the
        connection before its hello is called again, `FIRST_TRIES` times in all."""
        for tries in range(1, FIRST_TRIES + 1):
            try:
                await self._connect()
                break
            except (InvalidMessage, ConnectionClosed, ConnectionResetError, TimeoutError):
                if tries == FIRST_TRIES:
                    raise
                await self._pause(FIRST_WAIT * 2 ** (tries - 1) * (0.5 + 0.5 * self._chance()))
        self._lost_since = self._opened

    async def close(self) -> None:
        """Let go of the server."""
        self._done = True
        if self._socket is not None:
            await self._socket.close()

    async def send(self, sound: bytes) -> None:
        """Send mono sound in the format of the hello; while the connection is lost, it is kept."""
        size = _sample_bytes(self._hello)
        longest = int(self.welcome.limits["message_bytes"]) // 4 * 4
        for start in range(0, len(sound), longest):
            piece = sound[start:start + longest]
            await self._record(piece, len(piece) / size / self._hello.sample_rate)

    async def interrupt(self, time: float | None = None) -> None:
        """The voice was cut off. time: seconds of media time that were played; left out, all frames that came are."""
        at = self._end / self._hello.fps if time is None else min(time, self._time)
        self._end = min(self._end, math.ceil(at * self._hello.fps - 1e-6))
        self._cut = min(self._cut, self._end)
        self._time = at
        # What was sent for later times is not replayed.
        self._journal = deque(_cut_end(sent, at, self._hello) for sent in self._journal)
        self._journal_bytes = sum(_size(sent.message) for sent in self._journal)
        if self._end < self._offset:
            # The server knows nothing of what was before this connection.
            self._leave_connection()
        await self._say({"type": "interrupt", "time": at})

    async def __aiter__(self) -> AsyncIterator[Poses | dict[str, Any]]:
        while not self._done:
            socket = self._socket
            if socket is None:
                yield {"type": "lost"}
                await self._come_back()
                yield {"type": "back"}
                continue
            try:
                async for message in socket:
                    if self._socket is not socket:
                        break  # this connection was left
                    event = self._read(message)
                    if isinstance(event, dict) and event.get("type") == "error":
                        if event["code"] in FINAL:
                            raise RefusedError(event["message"], event["code"])
                        self._retry_after = float(event.get("retry_after") or 0.0)
                        continue
                    yield event
                    if isinstance(event, dict) and event.get("type") == "done":
                        self._done = True
                        return
            except ConnectionClosed:
                pass
            if not self._done and self._socket is socket:
                self._socket = None

    def _read(self, message: str | bytes) -> Poses | dict[str, Any]:
        if isinstance(message, bytes):
            poses = Poses.unpack(message)
            poses = replace(poses, first=poses.first + self._offset, source=self._source)
            if poses.first <= self._cut:
                self._end, self._cut = poses.first + len(poses), math.inf
            return poses
        event: dict[str, Any] = json.loads(message)
        for name in ("time", "start", "end"):
            if name in event:
                event[name] += self._offset / self._hello.fps
        return event

    def _leave_connection(self) -> None:
        """Go on with another connection, at the first frame that did not come or was taken back."""
        self._replay_again = True
        if self._socket is not None:
            closing = asyncio.create_task(self._socket.close())
            self._closing.add(closing)
            closing.add_done_callback(self._closing.discard)
            self._socket = None

    async def _say(self, message: dict[str, Any]) -> None:
        if message["type"] in ("listen", "speak"):
            self._other_voice = message["type"] == "listen"
        waits = message["type"] in ("idle", "think")
        await self._record(message, float(message.get("seconds", 0.0)) if waits else 0.0)

    async def _record(self, message: bytes | dict[str, Any], seconds: float) -> None:
        """Keep a message that lasts some seconds of media time for a replay, and send it if there is a connection."""
        whole = _Sent(message, self._time, seconds, self._other_voice)
        self._time += seconds
        # A connection begins at a frame, which may lie after an interruption.
        start = 0.0 if self._replay_again else self._offset / self._hello.fps
        sent = _cut_start(whole, start, self._hello) if seconds else whole
        if sent is None:
            return
        self._journal.append(sent)
        self._journal_bytes += _size(sent.message)
        while self._journal_bytes > JOURNAL_BYTES:
            self._journal_bytes -= _size(self._journal.popleft().message)
        if self._socket is None:
            self._unsent.append(sent)
            return
        with suppress(ConnectionClosed):  # a loss is noticed by the reader
            await self._transmit(self._socket, sent.message)

    async def _transmit(self, socket: ClientConnection, message: bytes | dict[str, Any]) -> None:
        await socket.send(message if isinstance(message, bytes) else self._shifted(message))

    def _shifted(self, message: dict[str, Any]) -> str:
        """A command with its times in this connection's media time."""
        back = self._offset / self._hello.fps
        if back and "time" in message:
            message = {**message, "time": max(0.0, message["time"] - back)}
        if back and "words" in message:
            message = {**message, "words": [
                {**word, "start": max(0.0, word["start"] - back), "end": max(0.0, word["end"] - back)}
                for word in message["words"] if word["end"] >= back]}
        return json.dumps(message)

    async def _come_back(self) -> None:
        """Connect again, however often it takes."""
        if self._clock() - self._opened >= LASTED:
            self._wait, self._lost_since = 0.0, self._clock()
        problem: Exception | None = None
        while True:
            if self._clock() - self._lost_since + self._wait + self._retry_after > self._patience:
                raise ConnectionError(f"the server did not come back: {problem or 'it breaks each connection'}"
                                      ) from problem
            if self._wait + self._retry_after:
                await self._pause(self._retry_after + self._wait * (0.5 + 0.5 * self._chance()))
            self._wait, self._retry_after = min(max(2 * self._wait, FIRST_WAIT), LONGEST_WAIT), 0.0
            try:
                await self._connect()
                return
            except RefusedError as error:
                if error.code in FINAL:
                    raise
                self._retry_after = error.retry_after or 0.0
                problem = error
            except (OSError, InvalidHandshake, ConnectionClosed, TimeoutError, ValueError) as error:
                self._retry_after = _retry_after(error)
                problem = error

    async def _connect(self) -> None:
        """Open a connection on which the stream goes on."""
        socket = await open_socket(self._url, subprotocols=[SUBPROTOCOL], max_size=LONGEST_MESSAGE,  # type: ignore[list-item]
                                   compression=None)
        try:
            await socket.send(self._hello.text())
            text = str(await socket.recv(decode=True))
            answer = json.loads(text)
            if answer.get("type") == "error":
                raise RefusedError(answer["message"], answer["code"], answer.get("retry_after"))
            self.welcome = Welcome.read(text)
            self._replay()
            while self._unsent:  # what is said meanwhile is sent in its turn
                await self._transmit(socket, self._unsent.popleft().message)
            if self._replay_again:
                raise ConnectionError("an interruption reached back before the connection while it was opened")
        except BaseException:
            await socket.close()
            raise
        self._socket, self._opened = socket, self._clock()

    def _replay(self) -> None:
        """Begin at the first frame that did not come: let the messages from there on wait to be sent."""
        self._replay_again = False
        if self._opened > -math.inf:  # not the first connection
            self._offset, self._cut = self._end, math.inf
            self._source += 1
            start = self._offset / self._hello.fps
            later = [sent for sent in (_cut_start(sent, start, self._hello) for sent in self._journal)
                     if sent is not None]
            if later and later[0].other_voice:
                later.insert(0, _Sent({"type": "listen"}, start, 0.0, True))
            self._journal = deque(later)
            self._journal_bytes = sum(_size(sent.message) for sent in later)
        self._unsent = deque(self._journal)


@asynccontextmanager
async def connect_resuming(url: str, hello: Hello, patience: float = 300.0) -> AsyncIterator[ResumingStream]:
    """Open a stream that comes back; see `client.connect`."""
    stream = ResumingStream(url, hello, patience)
    await stream.open()
    try:
        yield stream
    finally:
        await stream.close()


def _retry_after(error: Exception) -> float:
    """Seconds for which a proxy that refused by an HTTP status asks to wait; 0 where it does not say."""
    text = error.response.headers.get("Retry-After", "") if isinstance(error, InvalidStatus) else ""
    return float(text) if text.isascii() and text.isdigit() and len(text) < 6 else 0.0


def _size(message: bytes | dict[str, Any]) -> int:
    return len(message) if isinstance(message, bytes) else 100


def _sample_bytes(hello: Hello) -> int:
    return 2 if hello.format == "pcm16" else 4


def _cut_start(sent: _Sent, begin: float, hello: Hello) -> _Sent | None:
    """What of a message lies after a media time; None for nothing."""
    end = sent.start + sent.seconds
    if isinstance(sent.message, bytes):
        if end <= begin + 1e-9:
            return None
        lost = max(0.0, begin - sent.start)
        # A sample in which the connection begins is left out: rounded, several of them could last a frame longer.
        first = _sample_bytes(hello) * math.ceil(lost * hello.sample_rate - 1e-6)
        return replace(sent, message=sent.message[first:], start=max(sent.start, begin), seconds=sent.seconds - lost)
    if sent.message["type"] in ("idle", "think") and "seconds" in sent.message:
        left = min(sent.seconds, end - begin)
        if left < 0 or (left == 0 and sent.seconds > 0):
            return None
        return replace(sent, message={**sent.message, "seconds": left}, start=max(sent.start, begin), seconds=left)
    # What was said after an interruption may lie in the frame before the one at which the connection begins.
    return sent if sent.start > begin - 1.0 / hello.fps or sent.message["type"] == "words" else None


def _cut_end(sent: _Sent, end: float, hello: Hello) -> _Sent:
    """What of a message lies before a media time; it is still one message."""
    left = max(0.0, min(sent.seconds, end - sent.start))
    if isinstance(sent.message, bytes):
        last = _sample_bytes(hello) * round(left * hello.sample_rate)
        return replace(sent, message=sent.message[:last], seconds=left)
    if sent.message["type"] == "interrupt":  # taken back, too
        return replace(sent, message={**sent.message, "time": min(sent.message["time"], end)})
    if sent.seconds > left:
        return replace(sent, message={**sent.message, "seconds": left}, seconds=left)
    return sent
