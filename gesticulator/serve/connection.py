"""One client: what came waits in a bounded queue, is worked on piece by piece, and its poses wait in another.

Three tasks share a connection. `_read` takes messages and refuses what is too much; `_work` hands pieces of sound to
the one thread that computes, in turn with all other streams; `_write` sends. A client that does not read fills its
own queue of poses: then work on its stream stops, and nobody else notices.
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
"""Sound that is worked on at a time: short enough that others wait little, long enough that calls cost little."""
IDLE_SECONDS = 0.1
"""Idle motion that is made at a time while a client asked for it until there is sound."""
CLOSE_SECONDS = 2.0
"""How long a client may take to answer a close; then the connection is cut."""
_REASON_BYTES = 120
"""A close frame holds 123 bytes of reason."""


@dataclass(frozen=True)
class _Sound:
    samples: Samples
    heard: bool
    """Another's voice."""
    arrived: float
    """time.monotonic()"""
    effort: Effort = Effort.FULL


@dataclass(frozen=True)
class _Command:
    message: dict[str, Any]


@dataclass(frozen=True)
class Workplace:
    """What connections share.

    compute: runs a function in the thread that computes, and waits for it. open_session: makes a session of a request,
    in that thread. output: gets the motion too, beside the WebSocket.
    """

    limits: ServerLimits
    metrics: ServerMetrics
    compute: Callable[[Callable[[], Any]], Awaitable[Any]]
    open_session: Callable[[str, StreamRequest], Session]
    output: VmcOutput | None = None
    token: str = ""


class Connection:
    """One client's stream from its hello to its end."""

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
        """time.monotonic() up to which idle motion was made; None where it is not asked for."""
        self._waits = "idle"
        """How she waits meanwhile: "idle" or "think"."""
        self._leaving = False
        self._pace = Pace()
        self._taken_back = 0.0
        """Seconds that cannot have been played by an interruption that waits to be worked on."""
        self._keeps_up = False
        """Sound that is late is worked on at less cost, or passed over."""

    async def run(self) -> None:
        """Serve the client. Whatever it does, this returns."""
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
            self._note(closed)
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
        """Answer what was received, and close: the server is stopping."""
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
                    task.result()  # raises what ended it
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(reader, worker, writer, return_exceptions=True)
        await self._close(self.code, self.reason if self._leaving else "")

    async def _read(self, request: StreamRequest) -> None:
        """Take messages until the client finishes; `RefusedError` where it sends too much, too little or nonsense."""
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
            told = read_message(message)
            if told["type"] == "hello":
                raise RefusedError(CloseCode.BAD_MESSAGE, "a second hello came")
            heard = told["type"] == "listen" or (heard and told["type"] != "speak")
            self._pace.arrived(float(told.get("seconds", 0.0)))
            if told["type"] == "interrupt":
                await self._drop_waiting(request)
            await self._wait_with(_Command(told), 0.0)
            if told["type"] == "finish":
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
        """Let go of the avatar's own sound that was not worked on: it will not be heard."""
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
        """Turn what waits into poses, piece by piece, until the stream is finished."""
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
                await self._end()
                return

    def _count_sound(self, sound: _Sound, seconds: float, took: float) -> None:
        """Count a piece of sound that was worked on; took: seconds."""
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
        """What to work on now: the next command, half a second of sound at most, or None for idle motion that is due.

        Waits until there is something, and until the client has read enough. lacking: seconds of her own sound that
        would change nothing if they came alone, so that they are not worth the way to the thread that computes.
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
        """Whether nothing waits, or less of the avatar's own sound than that, and more may come."""
        if not self._waiting:
            return True
        if self._waiting_seconds >= lacking - 1e-6 or self._leaving or self._idling is not None:
            return False
        return all(isinstance(item, _Sound) and not item.heard for item in self._waiting)

    def _piece(self, sample_rate: int) -> _Sound:
        """Half a second of the sound that waits, or as much as there is of one voice; all of it, to be passed over,
        where it comes too late."""
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
        """Wait for a change; False where idle motion is due before one comes. Called with the lock held."""
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
        """Wait until fewer poses are unread than may be; `RefusedError` after too long. Called with the lock held."""
        limits = self.place.limits
        try:
            async with asyncio.timeout(limits.unread_seconds):
                await self._changed.wait_for(lambda: self._unread_bytes < limits.unread_bytes)
        except TimeoutError:
            raise RefusedError(CloseCode.UNREAD, f"{self._unread_bytes} bytes of poses were not read for "
                          f"{limits.unread_seconds:g} s") from None

    async def _put(self, answer: SessionAnswer) -> None:
        """Queue an answer for the client, and show its motion elsewhere."""
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

    async def _end(self) -> None:
        async with self._changed:
            self._unread.append(None)
            self._changed.notify_all()

    def _count_unread(self, size: int) -> None:
        self._unread_bytes += size
        self.place.metrics.add("unread_bytes", size)

    async def _write(self) -> None:
        """Send what is queued until the end; each message counts as unread until the system took it."""
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

    def _note(self, closed: ConnectionClosed) -> None:
        """Remember how the connection came to its end."""
        if closed.rcvd is not None and not (closed.sent is not None and closed.rcvd_then_sent is False):
            self.code, self.reason = closed.rcvd.code, "closed by the client"
        elif closed.sent is not None:
            self.code, self.reason = closed.sent.code, closed.sent.reason or "closed by the server"
        else:
            self.code, self.reason = 1006, "the connection broke"

    async def refuse(self, refused: RefusedError) -> None:
        """Tell the client why, where it still listens, and close."""
        self.code, self.reason = refused.code, refused.reason
        told = json.dumps({"type": "error", "code": int(refused.code), "message": refused.reason})
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            async with asyncio.timeout(1.0):
                await self.socket.send(told)
        await self._close(refused.code, refused.reason)

    async def _close(self, code: int, reason: str) -> None:
        """Close, or cut the connection of a client that does not even read the close."""
        short = reason.encode()[:_REASON_BYTES].decode(errors="ignore")
        # The client's answer comes after what it sent before, which nobody reads any more.
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


_MOST_WAITING = 10_000
"""Messages that may wait: a minute of 6 ms packets, and no more of empty commands."""
