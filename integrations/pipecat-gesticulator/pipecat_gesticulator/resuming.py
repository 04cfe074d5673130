"""A client that comes back: a lost connection is opened again, and the stream goes on where it was.

The server keeps the state of a lost stream for a minute. Within it, both sides send once more what the other one has
not got, and no frame differs from those of a connection that held. If the state is gone too, as after a crash, the
client opens a new stream and replays the sound from the first frame that it lacks; its frames are numbered on. Show the
poses with a `SteadyPlayer`, which idles while there are none and blends where another stream begins.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidMessage, InvalidStatus

from pipecat_gesticulator.client import LONGEST_MESSAGE
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
    heard: whether it is another's voice."""

    message: bytes | dict[str, Any]
    start: float
    seconds: float
    heard: bool


class ResumingStream:
    """As `GestureStream`, on as many connections as it takes. Iterating gives `Poses`, the server's events, and
    `{"type": "lost"}` and `{"type": "back", "resumed": ...}`."""

    def __init__(self, url: str, hello: Hello, patience: float = 300.0, *, chance: Callable[[], float] = random.random,
                 clock: Callable[[], float] = time.monotonic,
                 pause: Callable[[float], Awaitable[None]] = asyncio.sleep) -> None:
        """patience: seconds after which a lost server is given up (`ConnectionError`); chance: numbers of [0, 1);
        clock and pause: seconds that go by, and waiting for them."""
        self._url, self._hello, self._patience = url, hello, patience
        self._chance, self._clock, self._pause = chance, clock, pause
        self._wait, self._asked = 0.0, 0.0
        """Seconds before the next try: of its own, and that the server asked for."""
        self._opened, self._lost_since = -math.inf, 0.0
        self._socket: ClientConnection | None = None
        self._journal: deque[_Sent] = deque()
        self._journal_bytes = 0
        self._numbered = 0
        """Messages that this session sent, or will."""
        self._got = 0
        """Messages of the server that came in this session, after its hello."""
        self._session: str | None = None
        self._offset, self._source = 0, 0
        """Frames before this session's first one; sessions before it."""
        self._anew_next = False
        """Whether the next connection begins a new session, though there is one that could be resumed."""
        self._closing: set[asyncio.Task[None]] = set()
        """Connections that are let go of."""
        self._end = 0
        """Number of the first frame that has not come, or that an interruption took back."""
        self._cut: float = math.inf
        """The first frame that an interruption took back, until the server's packet that replaces it; those that were
        on their way come first."""
        self._time, self._heard, self._done = 0.0, False, False
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

    # --------------------------------------------------------------------------------------------------- as ever

    async def send(self, sound: bytes) -> None:
        """Send mono sound in the format of the hello; while the connection is lost, it is kept."""
        size = _sample_bytes(self._hello)
        longest = int(self.welcome.limits["message_bytes"]) // 4 * 4
        for start in range(0, len(sound), longest):
            piece = sound[start:start + longest]
            await self._say(piece, len(piece) / size / self._hello.sample_rate)

    async def idle(self, seconds: float | None = None) -> None:
        """Ask for idle motion: for so many seconds, or until there is sound."""
        await self._say({"type": "idle"} if seconds is None else {"type": "idle", "seconds": seconds}, seconds or 0.0)

    async def think(self, seconds: float | None = None) -> None:
        """As `idle`, while an answer is thought of."""
        await self._say({"type": "think"} if seconds is None else {"type": "think", "seconds": seconds}, seconds or 0.0)

    async def interrupt(self, time: float | None = None) -> None:
        """The voice was cut off. time: seconds of media time that were played; left out, all frames that came are."""
        at = self._end / self._hello.fps if time is None else min(time, self._time)
        self._end = min(self._end, math.ceil(at * self._hello.fps - 1e-6))
        self._cut = min(self._cut, self._end)
        self._time = at
        # What was sent for later is not to be said again; the messages are still counted.
        self._journal = deque(_cut_end(one, at, self._hello) for one in self._journal)
        self._journal_bytes = sum(_size(one.message) for one in self._journal)
        if self._end < self._offset:
            # The server's session knows nothing of what was before it.
            self._leave_session()
        await self._say({"type": "interrupt", "time": at}, 0.0)

    async def add_words(self, words: Iterable[tuple[str, float, float]]) -> None:
        """What is said: text, start and end in seconds of media time; for a stream with the option text."""
        await self._say({"type": "words", "words": [{"text": text, "start": start, "end": end}
                                                    for text, start, end in words]}, 0.0)

    async def listen(self) -> None:
        """Sound that is sent from now on is another's voice."""
        self._heard = True
        await self._say({"type": "listen"}, 0.0)

    async def speak(self) -> None:
        """Sound that is sent from now on is the avatar's own voice, as at the beginning."""
        self._heard = False
        await self._say({"type": "speak"}, 0.0)

    async def finish(self) -> None:
        """No more sound comes; the rest of the poses does, and then iterating ends."""
        await self._say({"type": "finish"}, 0.0)

    async def __aiter__(self) -> AsyncIterator[Poses | dict[str, Any]]:
        while not self._done:
            socket = self._socket
            if socket is None:
                yield {"type": "lost"}
                resumed = await self._come_back()
                yield {"type": "back", "resumed": resumed}
                continue
            try:
                async for message in socket:
                    if self._socket is not socket:
                        break  # the session was left
                    self._got += 1
                    found = self._read(message)
                    if isinstance(found, dict) and found.get("type") == "error":
                        if found["code"] in FINAL:
                            raise RefusedError(found["message"], found["code"])
                        self._asked = float(found.get("retry_after") or 0.0)
                        continue
                    yield found
                    if isinstance(found, dict) and found.get("type") == "done":
                        self._done = True
                        return
            except ConnectionClosed:
                pass
            if not self._done and self._socket is socket:
                self._socket = None

    # --------------------------------------------------------------------------------------------------- internals

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

    def _leave_session(self) -> None:
        """Go on with a new session, at the first frame that did not come or was taken back."""
        self._anew_next = True
        if self._socket is not None:
            closing = asyncio.create_task(self._socket.close())
            self._closing.add(closing)
            closing.add_done_callback(self._closing.discard)
            self._socket = None

    async def _say(self, message: bytes | dict[str, Any], seconds: float) -> None:
        said = _Sent(message, self._time, seconds, self._heard)
        self._time += seconds
        # A session begins at a frame, which may lie after an interruption.
        begin = 0.0 if self._anew_next else self._offset / self._hello.fps
        sent = _cut_start(said, begin, self._hello) if seconds else said
        if sent is None:
            return
        self._journal.append(sent)
        self._journal_bytes += _size(sent.message)
        self._numbered += 1
        while self._journal_bytes > JOURNAL_BYTES:
            self._journal_bytes -= _size(self._journal.popleft().message)
        await self._transmit(sent.message)

    async def _transmit(self, message: bytes | dict[str, Any]) -> None:
        """Send, where there is a connection; one that is lost is noticed by who reads."""
        if self._socket is None:
            return
        with suppress(ConnectionClosed):
            await self._socket.send(message if isinstance(message, bytes) else self._shifted(message))

    def _shifted(self, message: dict[str, Any]) -> str:
        """A command with its times in this session's media time."""
        back = self._offset / self._hello.fps
        if back and "time" in message:
            message = {**message, "time": max(0.0, message["time"] - back)}
        if back and "words" in message:
            message = {**message, "words": [
                {**word, "start": max(0.0, word["start"] - back), "end": max(0.0, word["end"] - back)}
                for word in message["words"] if word["end"] >= back]}
        return json.dumps(message)

    async def _come_back(self) -> bool:
        """Connect again, however often it takes; whether the session went on."""
        if self._clock() - self._opened >= LASTED:
            self._wait, self._lost_since = 0.0, self._clock()
        problem: Exception | None = None
        while True:
            if self._clock() - self._lost_since + self._wait + self._asked > self._patience:
                raise ConnectionError(f"the server did not come back: {problem or 'it breaks each connection'}"
                                      ) from problem
            if self._wait + self._asked:
                await self._pause(self._asked + self._wait * (0.5 + 0.5 * self._chance()))
            self._wait, self._asked = min(max(2 * self._wait, FIRST_WAIT), LONGEST_WAIT), 0.0
            try:
                before = self._source
                await self._connect()
                return self._source == before
            except RefusedError as error:
                if error.code in FINAL:
                    raise
                self._asked = error.retry_after or 0.0
                problem = error
            except (OSError, InvalidHandshake, ConnectionClosed, TimeoutError, ValueError) as error:
                self._asked = _retry_after(error)
                problem = error

    async def _connect(self) -> None:
        """Open a connection on which the stream goes on."""
        socket = await open_socket(self._url, subprotocols=[SUBPROTOCOL], max_size=LONGEST_MESSAGE,  # type: ignore[list-item]
                                   compression=None)
        try:
            greeting = json.loads(self._hello.text()) | {"resumable": True}
            if self._session is not None and not self._anew_next:
                greeting["resume"] = {"session": self._session, "messages": self._got}
            await socket.send(json.dumps(greeting))
            text = await socket.recv(decode=True)
            answer = json.loads(text)
            if answer.get("type") == "error":
                raise RefusedError(answer["message"], answer["code"], answer.get("retry_after"))
            self.welcome = Welcome.read(str(text))
            heard = int(answer["messages"]) if answer.get("resumed") else 0
            if not answer.get("resumed"):
                self._anew(answer.get("session"))
            # Messages that are said meanwhile wait in the journal, and are sent in their turn.
            while heard < self._numbered:
                message = self._journal[heard - self._numbered].message
                heard += 1
                await socket.send(message if isinstance(message, bytes) else self._shifted(message))
            if self._anew_next:
                raise ConnectionError("an interruption reached back before the session while it was opened")
        except BaseException:
            await socket.close()
            raise
        self._socket, self._opened = socket, self._clock()

    def _anew(self, session: str | None) -> None:
        """Begin a new session at the first frame that did not come."""
        first = self._session is None
        self._session, self._got, self._anew_next = session, 0, False
        if first:
            return
        self._offset = self._end
        self._cut = math.inf
        self._source += 1
        begin = self._offset / self._hello.fps
        later = [one for one in (_cut_start(sent, begin, self._hello) for sent in self._journal) if one is not None]
        if later and later[0].heard:
            later.insert(0, _Sent({"type": "listen"}, begin, 0.0, True))
        self._journal = deque(later)
        self._journal_bytes = sum(_size(one.message) for one in later)
        self._numbered = len(later)


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
    asked = error.response.headers.get("Retry-After", "") if isinstance(error, InvalidStatus) else ""
    return float(asked) if asked.isascii() and asked.isdigit() and len(asked) < 6 else 0.0


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
        # A sample in which the session begins is left out: rounded, several sessions could last a frame longer.
        first = _sample_bytes(hello) * math.ceil(lost * hello.sample_rate - 1e-6)
        return replace(sent, message=sent.message[first:], start=max(sent.start, begin), seconds=sent.seconds - lost)
    if sent.message["type"] in ("idle", "think") and "seconds" in sent.message:
        left = min(sent.seconds, end - begin)
        if left < 0 or (left == 0 and sent.seconds > 0):
            return None
        return replace(sent, message={**sent.message, "seconds": left}, start=max(sent.start, begin), seconds=left)
    # What was said after an interruption may lie in the frame before the one at which the session begins.
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
