"""One client connection: messages wait in a bounded queue, are processed piece by piece, and poses wait in another.

Three tasks share a connection. `_read` takes messages and rejects excess; `_work` hands pieces of audio to the compute
thread, in turn with all other streams; `_write` sends. A client that does not read fills its own queue of poses: then
its stream pauses, and other streams are not affected.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from websockets.exceptions import ConnectionClosed

from data_module.errors import InputError
from gesticulator.serve.pace import Effort, Pace
from gesticulator.serve.protocol import CloseCode, RefusedError, StreamRequest, read_hello, read_message

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

    from data_module.types import Samples
    from gesticulator.serve.metrics import ServerMetrics
    from gesticulator.serve.session import Session, SessionAnswer
    from gesticulator.serve.settings import ServerLimits
    from gesticulator.serve.vmc import VmcOutput

PIECE_SECONDS = 0.5
"""Audio processed at a time, seconds: short enough that other streams wait little, long enough for low overhead."""
IDLE_SECONDS = 0.1
"""Idle motion generated at a time, seconds, after a client requested it until audio arrives."""
CLOSE_SECONDS = 2.0
"""Time for a client to answer a close frame, seconds; then the connection is aborted."""
_REASON_BYTES = 120
"""Bytes of the reason in a close frame; the limit is 123."""
_MOST_WAITING = 10_000
"""Most queued messages: a minute of 6 ms packets; bounds empty commands too."""


@dataclass(frozen=True)
class _Sound:
    samples: Samples
    heard: bool
    """Whether it is another's voice."""
    arrived: float
    """time.monotonic()"""
    effort: Effort = Effort.FULL


@dataclass(frozen=True)
class _Command:
    message: dict[str, Any]


@dataclass(frozen=True)
class Workplace:
    """Resources shared by connections.

    compute: runs a function in the compute thread and awaits it. open_session: creates a session for a request, in that
    thread. output: also receives the motion, beside the WebSocket.
    """

    limits: ServerLimits
    metrics: ServerMetrics
    compute: Callable[[Callable[[], Any]], Awaitable[Any]]
    open_session: Callable[[str, StreamRequest], Session]
    output: VmcOutput | None = None
    token: str = ""


class Connection:
    """A client's stream from its hello to its end."""

    def __init__(self, socket: ServerConnection, name: str, workplace: Workplace) -> None:
        self.socket, self.name, self.place = socket, name, workplace
        self.reason = "closed by the client"
        self.code: int = CloseCode.NORMAL
        self.frames = 0
        self.seconds = 0.0
        self._waiting: deque[_Sound | _Command] = deque()
        self._waiting_seconds = 0.0
        self._unread: deque[bytes | str | None] = deque()
        self._unread_bytes = 0
        self._changed = asyncio.Condition()
        self._idling: float | None = None
        """time.monotonic() up to which idle motion was generated; None if it is not requested."""
        self._waits = "idle"
        """The kind of idle motion: "idle" or "think"."""
        self._leaving = False
        self._pace = Pace()
        self._taken_back = 0.0
        """Seconds that cannot have been played at the time of a pending interruption."""
        self._keeps_up = False
        """Whether late audio is processed at lower cost or skipped."""

    async def run(self) -> None:
        """Serve the client; returns whatever the client does."""
        try:
            request = await self._hello()
            session = await self.place.compute(lambda: self.place.open_session(self.name, request))
            await self.socket.send(json.dumps(session.welcome()))
            await self._serve(request, session)
        except RefusedError as refused:
            await self.refuse(refused)
        except InputError as error:
            await self.refuse(RefusedError(CloseCode.BAD_MESSAGE, str(error)))
        except ConnectionClosed as closed:
            self._record_close(closed)
        except Exception as error:  # noqa: BLE001 - one stream's failure must end that stream alone
            await self.refuse(RefusedError(CloseCode.FAILED, f"the stream failed ({type(error).__name__}: {error})"))
        finally:
            if self.place.output is not None:
                self.place.output.leave(self.name)
            self.place.metrics.add("waiting_seconds", -self._waiting_seconds)
            self.place.metrics.add("unread_bytes", -self._unread_bytes)
            self._waiting.clear()
            self._unread.clear()

    async def leave(self) -> None:
        """Finish processing and close, because the server is stopping."""
        async with self._changed:
            self._leaving = True
            self._changed.notify_all()

    async def _hello(self) -> StreamRequest:
        from hmac import compare_digest

        try:
            async with asyncio.timeout(self.place.limits.hello_seconds):
                message = await self.socket.recv()
        except TimeoutError:
            raise RefusedError(CloseCode.TOO_QUIET, "no hello came") from None
        if not isinstance(message, str):
            raise RefusedError(CloseCode.BAD_MESSAGE, "the first message must be a hello, as text")
        request = read_hello(message)
        if not compare_digest(request.token.encode(), self.place.token.encode()) and self.place.token:
            raise RefusedError(CloseCode.BAD_TOKEN, "the token is lacking or wrong")
        return request

    async def _serve(self, request: StreamRequest, session: Session) -> None:
        self._keeps_up = request.keeps_up
        reader = asyncio.create_task(self._read(request))
        worker = asyncio.create_task(self._work(session))
        writer = asyncio.create_task(self._write())
        tasks = {reader, worker, writer}
        try:
            while writer in tasks:
                done, tasks = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()  # re-raise its exception
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(reader, worker, writer, return_exceptions=True)
        await self._close(self.code, self.reason if self._leaving else "")

    async def _read(self, request: StreamRequest) -> None:
        """Take messages until the client finishes; `RefusedError` for too much, too little or invalid data."""
        limits, heard = self.place.limits, False
        while True:
            try:
                async with asyncio.timeout(limits.quiet_seconds):
                    message = await self.socket.recv()
            except TimeoutError:
                raise RefusedError(CloseCode.TOO_QUIET, f"nothing came for {limits.quiet_seconds:g} s") from None
            if isinstance(message, bytes):
                samples = request.samples(message)
                if len(samples):
                    await self._wait_with(_Sound(samples, heard, time.monotonic()), len(samples) / request.sample_rate)
                continue
            command = read_message(message)
            if command["type"] == "hello":
                raise RefusedError(CloseCode.BAD_MESSAGE, "a second hello came")
            heard = command["type"] == "listen" or (heard and command["type"] != "speak")
            self._pace.arrived(float(command.get("seconds", 0.0)))
            if command["type"] == "interrupt":
                await self._drop_waiting(request)
            await self._wait_with(_Command(command), 0.0)
            if command["type"] == "finish":
                return

    async def _wait_with(self, item: _Sound | _Command, seconds: float) -> None:
        limits = self.place.limits
        self.seconds += seconds
        if self.seconds > limits.stream_seconds:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"a stream takes {limits.stream_seconds:g} s of sound")
        if self._waiting_seconds + seconds > limits.waiting_seconds or len(self._waiting) >= _MOST_WAITING:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"more than {limits.waiting_seconds:g} s of sound, or "
                          f"{_MOST_WAITING} messages, wait to be worked on")
        self.place.metrics.add("sound_seconds_total", seconds)
        self._pace.arrived(seconds)
        async with self._changed:
            self._waiting.append(item)
            self._count_waiting(seconds)
            self._changed.notify_all()

    async def _drop_waiting(self, request: StreamRequest) -> None:
        """Drop unprocessed audio of the avatar, which will not be played."""
        self._taken_back = max(self._taken_back, self._pace.ahead)
        self._pace.forget()
        async with self._changed:
            kept: deque[_Sound | _Command] = deque()
            for item in self._waiting:
                if isinstance(item, _Sound) and not item.heard:
                    self._count_waiting(-len(item.samples) / request.sample_rate)
                else:
                    kept.append(item)
            self._waiting = kept

    def _count_waiting(self, seconds: float) -> None:
        self._waiting_seconds += seconds
        self.place.metrics.add("waiting_seconds", seconds)

    async def _work(self, session: Session) -> None:
        """Turn queued messages into poses, piece by piece, until the stream is finished."""
        while True:
            item = await self._next(session.request.sample_rate, session.lacking)
            begin = time.monotonic()
            session.unplayed(max(self._pace.ahead, self._taken_back))
            if isinstance(item, _Sound):
                answer = await self._compute(lambda sound=item: session.feed(sound.samples, sound.heard, sound.effort))  # type: ignore[misc]
                self._count_sound(item, len(item.samples) / session.request.sample_rate, time.monotonic() - begin)
            elif item is None:
                self._pace.arrived(IDLE_SECONDS)
                answer = await self._compute(lambda: session.wait(self._waits, IDLE_SECONDS))
            else:
                answer = await self._compute(lambda command=item: session.obey(command.message))  # type: ignore[misc]
                if item.message["type"] == "interrupt":
                    self._taken_back = 0.0
                if item.message in ({"type": "idle"}, {"type": "think"}):
                    self._waits, self._idling = item.message["type"], begin
            await self._put(answer)
            if isinstance(item, _Command) and item.message["type"] == "finish":
                self.reason = self.reason if self._leaving else "finished"
                async with self._changed:
                    self._unread.append(None)
                    self._changed.notify_all()
                return

    def _count_sound(self, sound: _Sound, seconds: float, took: float) -> None:
        """Count a processed piece of audio; took: processing time in seconds."""
        metrics = self.place.metrics
        metrics.time("answer_seconds", time.monotonic() - sound.arrived)
        if sound.effort != Effort.NONE:
            self._pace.worked(seconds, took)
        if sound.effort != Effort.FULL:
            metrics.add("passed_seconds_total" if sound.effort == Effort.NONE else "hurried_seconds_total", seconds)

    async def _compute(self, job: Callable[[], SessionAnswer]) -> SessionAnswer:
        def timed() -> tuple[SessionAnswer, float]:
            begin = time.perf_counter()
            return job(), time.perf_counter() - begin

        answer, seconds = await self.place.compute(timed)
        self.place.metrics.time("compute_seconds", seconds)
        return answer

    async def _next(self, sample_rate: int, lacking: float) -> _Sound | _Command | None:
        """The next item: a command, up to half a second of audio, or None for idle motion that is due.

        Waits for an item, and until the client has read enough. lacking: seconds of the avatar's audio below which
        processing would produce nothing, and is not worth a round trip to the compute thread.
        """
        async with self._changed:
            await self._room()
            while self._too_little(lacking):
                if self._leaving:
                    self.code, self.reason = CloseCode.GOING_AWAY, "the server is shutting down"
                    return _Command({"type": "finish"})
                if not await self._sleep():
                    return None
            item = self._waiting[0]
            if isinstance(item, _Command):
                self._waiting.popleft()
                return item
            self._idling = None
            return self._piece(sample_rate)

    def _too_little(self, lacking: float) -> bool:
        """Whether the queue holds less than `lacking` seconds of the avatar's audio, and more may come."""
        if not self._waiting:
            return True
        if self._waiting_seconds >= lacking - 1e-6 or self._leaving or self._idling is not None:
            return False
        return all(isinstance(item, _Sound) and not item.heard for item in self._waiting)

    def _piece(self, sample_rate: int) -> _Sound:
        """Up to half a second of queued audio of one voice; all of it, to be skipped, if it comes too late."""
        first = self._waiting[0]
        assert isinstance(first, _Sound)
        self.place.metrics.time("late_seconds", self._pace.late(self._waiting_seconds))
        effort = self._pace.effort(self._waiting_seconds) if self._keeps_up and not first.heard else Effort.FULL
        most = int((self._waiting_seconds if effort == Effort.NONE else PIECE_SECONDS) * sample_rate) + 1
        pieces: list[Samples] = []
        while self._waiting and most > 0:
            item = self._waiting[0]
            if isinstance(item, _Command) or item.heard != first.heard:
                break
            pieces.append(item.samples[:most])
            most -= len(pieces[-1])
            if len(pieces[-1]) < len(item.samples):
                self._waiting[0] = _Sound(item.samples[len(pieces[-1]):], item.heard, item.arrived)
            else:
                self._waiting.popleft()
        samples = np.concatenate(pieces)
        self._count_waiting(-len(samples) / sample_rate)
        return _Sound(samples, first.heard, first.arrived, effort)

    async def _sleep(self) -> bool:
        """Wait for a change; False if idle motion is due first. Called with the lock held."""
        if self._idling is None:
            await self._changed.wait()
            return True
        left = self._idling + IDLE_SECONDS - time.monotonic()
        if left > 0:
            try:
                async with asyncio.timeout(left):
                    await self._changed.wait()
            except TimeoutError:
                pass
            else:
                return True
        self._idling += IDLE_SECONDS
        return False

    async def _room(self) -> None:
        """Wait until few enough poses are unread; `RefusedError` after a timeout. Called with the lock held."""
        limits = self.place.limits
        try:
            async with asyncio.timeout(limits.unread_seconds):
                await self._changed.wait_for(lambda: self._unread_bytes < limits.unread_bytes)
        except TimeoutError:
            raise RefusedError(CloseCode.UNREAD, f"{self._unread_bytes} bytes of poses were not read for "
                          f"{limits.unread_seconds:g} s") from None

    async def _put(self, answer: SessionAnswer) -> None:
        """Queue an answer for the client, and pass its motion to the other output."""
        for frames in answer.frames:
            self.frames += len(frames)
            self.place.metrics.add("frames_total", len(frames))
            if self.place.output is not None:
                self.place.output.take(self.name, frames)
        async with self._changed:
            for message in answer.messages:
                self._unread.append(message)
                self._count_unread(len(message))
            self._changed.notify_all()

    def _count_unread(self, size: int) -> None:
        self._unread_bytes += size
        self.place.metrics.add("unread_bytes", size)

    async def _write(self) -> None:
        """Send queued messages until the end; each counts as unread until the system has accepted it."""
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: bool(self._unread))
                message = self._unread[0]
            if message is None:
                return
            await self.socket.send(message)
            async with self._changed:
                self._unread.popleft()
                self._count_unread(-len(message))
                self._changed.notify_all()
            self.place.metrics.add("sent_bytes_total", len(message))

    def _record_close(self, closed: ConnectionClosed) -> None:
        """Record why the connection ended."""
        if closed.rcvd is not None and not (closed.sent is not None and closed.rcvd_then_sent is False):
            self.code, self.reason = closed.rcvd.code, "closed by the client"
        elif closed.sent is not None:
            self.code, self.reason = closed.sent.code, closed.sent.reason or "closed by the server"
        else:
            self.code, self.reason = 1006, "the connection broke"

    async def refuse(self, refused: RefusedError) -> None:
        """Send the client the reason, if it is still connected, and close."""
        self.code, self.reason = refused.code, refused.reason
        message = json.dumps({"type": "error", "code": int(refused.code), "message": refused.reason})
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            async with asyncio.timeout(1.0):
                await self.socket.send(message)
        await self._close(refused.code, refused.reason)

    async def _close(self, code: int, reason: str) -> None:
        """Close, or abort the connection of a client that does not answer the close frame."""
        short = reason.encode()[:_REASON_BYTES].decode(errors="ignore")
        # The client's answer comes after earlier messages, which must be read first.
        swallowing = asyncio.create_task(self._swallow())
        try:
            async with asyncio.timeout(CLOSE_SECONDS):
                await self.socket.close(code, short)
        except TimeoutError:
            self.socket.transport.abort()
        finally:
            swallowing.cancel()

    async def _swallow(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self.socket.recv()
