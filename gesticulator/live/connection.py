"""One client's stream: messages wait in a bounded queue, are processed block by block, and poses wait in another.

Three tasks share a stream. `_read` takes messages and rejects excess; `_work` submits one step at a time to the compute
thread, which takes the steps of all streams in the order of their arrival, so that streams take turns; `_write` sends.
A client that does not read fills its own queue of poses: then its stream pauses, and other streams are not affected.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from websockets.exceptions import ConnectionClosed

from data_module.errors import InputError
from gesticulator.live.pace import Effort, Pace
from gesticulator.live.protocol import CloseCode, RefusedError, StreamRequest, read_hello, read_message
from gesticulator.live.session import MOST_WORDS, SessionAnswer

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

    from data_module.types import Samples
    from gesticulator.live.limits import ServerLimits
    from gesticulator.live.metrics import ServerMetrics
    from gesticulator.live.session import Session, Work
    from gesticulator.live.vmc import VmcOutput

T = TypeVar("T")

TURN_SECONDS = 0.015
"""Time after which a turn ends at the next step: a block takes about as long, so a turn takes at most 30 ms."""
PIECE_SECONDS = 0.25
"""Audio taken up at a time, seconds, at most a block; how late a stream is is decided anew for each piece."""
IDLE_SECONDS = 0.1
"""Idle motion generated at a time, seconds, after a client requested it until audio arrives."""
CLOSE_SECONDS = 2.0
"""Time for a client to answer a close frame, seconds; then the connection is aborted."""
_REASON_BYTES = 120
"""Bytes of the reason in a close frame; the limit is 123."""
_COMMAND = 10
"""Words for which a command counts: two thousand of them may wait, more than come at once."""
_MOST_WAITING = 10_000
"""Most queued messages: a minute of 6 ms packets; bounds empty commands too."""
_MESSAGES_PER_SECOND, _AT_ONCE = 500.0, 2.0
"""Messages that are read from a client, and seconds of them that it may send at once: three times those of a microphone
with 6 ms packets. A flood of short ones would take the event loop, which serves everybody; a text counts as one for
each ten words."""
_SHORT = 2000
"""Characters of a message that is checked at once, within half a millisecond."""
_WAITS = ("idle", "think")


@dataclass(frozen=True)
class _Sound:
    samples: Samples
    other_voice: bool
    """Whether another person speaks, to whom the character listens."""
    arrived: float
    """time.monotonic()"""
    effort: Effort = Effort.FULL


@dataclass(frozen=True)
class _Command:
    message: dict[str, Any]

    @property
    def seconds(self) -> float:
        """Media time of a wait; 0 for other commands."""
        return float(self.message.get("seconds", 0.0)) if self.message["type"] in _WAITS else 0.0


class ComputeThread:
    """The one thread that computes for all streams, first come first served. Python runs one thread at a time, so more
    threads would compute no faster: start another server for another core."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, "compute")
        self._turn = asyncio.Lock()  # wakes those that wait in the order of their arrival

    async def run(self, job: Callable[[], T]) -> T:
        """Wait for the thread, and for the job's result.

        The next job is handed over by the event loop, which reads what clients sent in between. Jobs that followed each
        other without a gap would starve it on a busy machine, and sound that was not read is not known to be late.
        """
        async with self._turn:
            return await asyncio.get_running_loop().run_in_executor(self._executor, job)

    def stop(self) -> None:
        """Drop the jobs that wait; the running one ends by itself."""
        self._executor.shutdown(wait=False, cancel_futures=True)


class Host(Protocol):
    """What a connection needs of its server (`LiveServer`)."""

    limits: ServerLimits
    metrics: ServerMetrics
    compute: ComputeThread
    output: VmcOutput | None

    def open_session(self, name: str, request: StreamRequest, /) -> Session:
        """The session of a stream, made in the compute thread."""

    def admit(self, connection: Connection, request: StreamRequest) -> None:
        """Take a stream in, or raise `RefusedError`."""


class Connection:
    """A client's stream from its hello to its end."""

    def __init__(self, socket: ServerConnection, name: str, server: Host) -> None:
        """server: has the limits, metrics and compute thread that all connections share."""
        self.socket, self.name, self.server = socket, name, server
        self.reason = "closed by the client"
        self.code: int = CloseCode.NORMAL
        self.frames = 0
        self.seconds = 0.0
        self._waiting: deque[_Sound | _Command] = deque()
        self.waiting_seconds = 0.0
        self._waiting_idle = 0.0
        """Seconds of waits that are queued or being computed."""
        self._waiting_words = 0
        """Words that are queued; each command counts as `_COMMAND` of them."""
        self._unread: deque[bytes | str | None] = deque()
        self.unread_bytes = 0
        self._changed = asyncio.Condition()
        self._idling: float | None = None
        """time.monotonic() up to which idle motion was generated; None if it is not requested."""
        self._waits = "idle"
        """The kind of idle motion: "idle" or "think"."""
        self._cut_at = math.inf
        """Media time at which an interruption ends all waits."""
        self._leaving = False
        self._pace = Pace()
        self._taken_back = 0.0
        """Seconds that cannot have been played at the time of a pending interruption."""
        self._keeps_up = False
        """Whether late audio is processed at lower cost or skipped."""

    async def run(self) -> None:
        """Serve the client; never raises, whatever the client sends."""
        try:
            request = await self._hello()
            self.server.admit(self, request)
            # Opening a stream computes too, so it takes its turn in the compute thread.
            session = await self.server.compute.run(lambda: self.server.open_session(self.name, request))
            await self.socket.send(json.dumps(session.welcome()))
            await self._serve(request, session)
        except RefusedError as refused:
            await self.refuse(refused)
        except InputError as error:
            await self.refuse(RefusedError(CloseCode.BAD_MESSAGE, str(error)))
        except ConnectionClosed as closed:
            # 1006 of RFC 6455: closed without a close frame.
            self.code = 1006 if closed.rcvd is None else closed.rcvd.code
        except Exception as error:  # noqa: BLE001 - one stream's failure must end that stream alone
            await self.refuse(RefusedError(CloseCode.FAILED, f"the stream failed ({type(error).__name__}: {error})"))
        finally:
            if self.server.output is not None:
                self.server.output.leave(self.name)
            self._waiting.clear()
            self._unread.clear()

    async def leave(self) -> None:
        """Finish processing and close, because the server is stopping."""
        async with self._changed:
            self._leaving = True
            self._changed.notify_all()

    async def _hello(self) -> StreamRequest:
        try:
            async with asyncio.timeout(self.server.limits.hello_seconds):
                message = await self.socket.recv()
        except TimeoutError:
            raise RefusedError(CloseCode.TOO_QUIET, "no hello came") from None
        if not isinstance(message, str):
            raise RefusedError(CloseCode.BAD_MESSAGE, "the first message must be a hello, as text")
        return read_hello(message)

    async def _serve(self, request: StreamRequest, session: Session) -> None:
        """Read, compute and write until all is written."""
        self._keeps_up = request.keeps_up
        writer = asyncio.create_task(self._write())
        # Three tasks, so that a client that only sends, only reads or does neither holds up nothing but its own stream.
        started = {writer, asyncio.create_task(self._read(request)), asyncio.create_task(self._work(session))}
        running = set(started)
        try:
            while writer in running:
                done, running = await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()  # re-raise its exception
        finally:
            for task in started:
                task.cancel()
            await asyncio.gather(*started, return_exceptions=True)
        await self._close(self.code, self.reason if self._leaving else "")

    async def _read(self, request: StreamRequest) -> None:
        """Take messages until the client finishes; `RefusedError` for too much, too little or invalid data."""
        limits, other_voice, paid = self.server.limits, False, 0.0
        while True:
            paid = max(paid, (now := time.monotonic()) - _AT_ONCE)
            if paid > now:
                await asyncio.sleep(paid - now)
            try:
                async with asyncio.timeout(limits.quiet_seconds):
                    message = await self.socket.recv()
            except TimeoutError:
                raise RefusedError(CloseCode.TOO_QUIET, f"nothing came for {limits.quiet_seconds:g} s") from None
            paid += (1 if isinstance(message, bytes) else 1 + len(message) / 600) / _MESSAGES_PER_SECOND
            if isinstance(message, bytes):
                samples = request.samples(message)
                sound = _Sound(samples, other_voice, time.monotonic())
                await self._wait_with(sound, len(samples) / request.sample_rate)
                continue
            # Checking a long message takes longer than a block, and the loop serves everybody.
            command = read_message(message) if len(message) < _SHORT else \
                await self.server.compute.run(partial(read_message, message))
            if command["type"] == "hello":
                raise RefusedError(CloseCode.BAD_MESSAGE, "a second hello came")
            other_voice = command["type"] == "listen" or (other_voice and command["type"] != "speak")
            self._pace.arrived(float(command.get("seconds", 0.0)))
            if command["type"] == "interrupt":
                # Applied at once, not when the command's turn comes: waits that are being computed end now.
                self._cut_at = float(command.get("time", -math.inf))
                await self._drop_waiting(request)
            await self._wait_with(_Command(command), 0.0)
            if command["type"] == "finish":
                return

    async def _wait_with(self, item: _Sound | _Command, seconds: float) -> None:
        limits = self.server.limits
        self.seconds += seconds
        if self.seconds > limits.stream_seconds:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"a stream takes {limits.stream_seconds:g} s of sound")
        waits = item.seconds if isinstance(item, _Command) else 0.0
        self._waiting_words += _COMMAND + len(item.message.get("words", ())) if isinstance(item, _Command) else 0
        # Waits count like audio: each second of them costs as much to compute.
        waiting = self.waiting_seconds + self._waiting_idle + seconds + waits
        if waiting > limits.waiting_seconds or len(self._waiting) >= _MOST_WAITING or self._waiting_words > MOST_WORDS:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"more than {limits.waiting_seconds:g} s of sound and waits, "
                               f"{MOST_WORDS} words, or {_MOST_WAITING} messages, wait to be worked on")
        self.server.metrics.sound_seconds.inc(seconds)
        self._pace.arrived(seconds)
        async with self._changed:
            if seconds or isinstance(item, _Command):
                self._waiting.append(item)
            self._waiting_idle += waits
            self.waiting_seconds += seconds
            self._changed.notify_all()

    async def _drop_waiting(self, request: StreamRequest) -> None:
        """Drop unprocessed audio of the avatar, which will not be played."""
        # Read before `forget`: what was sent and not played can be taken back.
        self._taken_back = max(self._taken_back, self._pace.ahead)
        self._pace.forget()
        if self.waiting_seconds < 1e-6:
            return  # the queue is long where somebody only interrupts
        async with self._changed:
            # Commands and the other speaker's voice stay: they do not belong to the interrupted answer.
            self._waiting = deque(item for item in self._waiting if isinstance(item, _Command) or item.other_voice)
            left = sum(len(item.samples) for item in self._waiting if isinstance(item, _Sound))
            self.waiting_seconds = left / request.sample_rate

    async def _work(self, session: Session) -> None:
        """Turn queued messages into poses, turn by turn, until the stream is finished."""
        while True:
            item = await self._next(session.request.sample_rate, session.lacking)
            begin = time.monotonic()
            session.unplayed(max(self._pace.ahead, self._taken_back))
            if isinstance(item, _Sound):
                await self._compute(session, session.feed(item.samples, item.other_voice, item.effort))
                now = time.monotonic()
                self.server.metrics.answer_seconds.observe(now - item.arrived)
                if item.effort != Effort.NONE:
                    self._pace.worked(len(item.samples) / session.request.sample_rate, now - begin)
            elif item is None:
                self._pace.arrived(IDLE_SECONDS)
                await self._compute(session, session.wait(self._waits, IDLE_SECONDS))
            else:
                await self._obey(session, item, begin)
                if item.message["type"] in ("finish", "leave"):
                    self.reason = self.reason if self._leaving else "finished"
                    async with self._changed:
                        self._unread.append(None)
                        self._changed.notify_all()
                    return

    async def _obey(self, session: Session, command: _Command, begin: float) -> None:
        try:
            await self._compute(session, session.obey(command.message), waits=command.seconds > 0)
        finally:
            # Not below 0, where the rounding of many sums could lead.
            self._waiting_idle = max(0.0, self._waiting_idle - command.seconds)
        if command.message["type"] == "interrupt":
            self._taken_back, self._cut_at = 0.0, math.inf
        if command.message in ({"type": "idle"}, {"type": "think"}):
            self._waits, self._idling = command.message["type"], begin

    async def _compute(self, session: Session, work: Work, waits: bool = False) -> None:
        """Do some work turn by turn, and queue its answers. One that `waits` ends at an interruption, and all work
        pauses while the client does not read."""
        done = False
        while not done and not (waits and session.until >= self._cut_at):
            answer, done, elapsed = await self.server.compute.run(lambda: _turn(work))
            self.server.metrics.compute_seconds.observe(elapsed)
            await self._put(answer)
            if not done:
                async with self._changed:
                    await self._room()
        work.close()

    async def _next(self, sample_rate: int, lacking: float) -> _Sound | _Command | None:
        """The next item: a command, up to `PIECE_SECONDS` of audio, or None for idle motion that is due.

        Waits for an item, and until the client has read enough. lacking: seconds of the avatar's audio below which
        processing would produce nothing, and is not worth a round trip to the compute thread.
        """
        async with self._changed:
            await self._room()
            while self._too_little(lacking):
                if self._leaving:
                    self.code, self.reason = CloseCode.GOING_AWAY, "the server is shutting down"
                    return _Command({"type": "leave"})
                if not await self._sleep():
                    return None
            item = self._waiting[0]
            if isinstance(item, _Command):
                self._waiting.popleft()
                self._waiting_words -= _COMMAND + len(item.message.get("words", ()))
                return item
            self._idling = None
            return self._piece(sample_rate)

    def _too_little(self, lacking: float) -> bool:
        """Whether the queue holds less than `lacking` seconds of the avatar's audio, and more may come."""
        if not self._waiting:
            return True
        if self.waiting_seconds >= lacking - 1e-6 or self._leaving or self._idling is not None:
            return False
        return all(isinstance(item, _Sound) and not item.other_voice for item in self._waiting)

    def _piece(self, sample_rate: int) -> _Sound:
        """Up to `PIECE_SECONDS` of queued audio of one voice; all of it, to be skipped, if it comes too late."""
        first = self._waiting[0]
        assert isinstance(first, _Sound)
        paced = self._keeps_up and not first.other_voice
        # Another speaker's voice costs little, so only the avatar's is hurried or skipped.
        effort = self._pace.effort(self.waiting_seconds) if paced else Effort.FULL
        # All of a skipped piece at once: it costs nothing.
        # One sample more: the product is rounded down, and a rest of a sample would be a piece of its own.
        most = int((self.waiting_seconds if effort == Effort.NONE else PIECE_SECONDS) * sample_rate) + 1
        pieces: list[Samples] = []
        while self._waiting and most > 0:
            item = self._waiting[0]
            if isinstance(item, _Command) or item.other_voice != first.other_voice:
                break
            pieces.append(item.samples[:most])
            most -= len(pieces[-1])
            if len(pieces[-1]) < len(item.samples):
                self._waiting[0] = _Sound(item.samples[len(pieces[-1]):], item.other_voice, item.arrived)
            else:
                self._waiting.popleft()
        samples = np.concatenate(pieces)
        self.waiting_seconds -= len(samples) / sample_rate
        return _Sound(samples, first.other_voice, first.arrived, effort)

    async def _sleep(self) -> bool:
        """Wait for a change; False if idle motion is due first. Called with the lock held."""
        if self._idling is None:
            await self._changed.wait()
            return True
        # By the clock of the server: idle motion without an end must not run ahead of the client that watches it.
        left = self._idling + IDLE_SECONDS - time.monotonic()
        if left > 0:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(left):
                    await self._changed.wait()
                return True
        self._idling += IDLE_SECONDS
        return False

    async def _room(self) -> None:
        """Wait until few enough poses are unread; `RefusedError` after a timeout. Called with the lock held."""
        limits = self.server.limits
        try:
            async with asyncio.timeout(limits.unread_seconds):
                await self._changed.wait_for(lambda: self.unread_bytes < limits.unread_bytes)
        except TimeoutError:
            raise RefusedError(CloseCode.UNREAD, f"{self.unread_bytes} bytes of poses were not read for "
                               f"{limits.unread_seconds:g} s") from None

    async def _put(self, answer: SessionAnswer) -> None:
        """Queue an answer for the client, and pass its motion to the other output."""
        for frames in answer.frames:
            self.frames += len(frames)
            self.server.metrics.frames.inc(len(frames))
            if self.server.output is not None:
                self.server.output.take(self.name, frames)
        async with self._changed:
            self._unread.extend(answer.messages)
            self.unread_bytes += sum(map(len, answer.messages))
            self._changed.notify_all()

    async def _write(self) -> None:
        """Send queued messages until the end; each counts as unread until the system has accepted it."""
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: bool(self._unread))
                # It stays in the queue while it is sent, so that it counts as unread.
                message = self._unread[0]
            if message is None:
                return
            await self.socket.send(message)
            async with self._changed:
                self._unread.popleft()
                self.unread_bytes -= len(message)
                self._changed.notify_all()
            self.server.metrics.sent_bytes.inc(len(message))

    async def refuse(self, refused: RefusedError) -> None:
        """Send the client the reason, if it is still connected, and close."""
        self.code, self.reason = refused.code, refused.reason
        again = {} if refused.retry_after is None else {"retry_after": refused.retry_after}
        message = json.dumps({"type": "error", "code": int(refused.code), "message": refused.reason, **again})
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            async with asyncio.timeout(1.0):
                await self.socket.send(message)
        await self._close(refused.code, refused.reason)

    async def _close(self, code: int, reason: str) -> None:
        """Close, or abort the connection of a client that does not answer the close frame."""
        # Cut in bytes, not in characters, which may take four.
        short = reason.encode("utf-8", "replace")[:_REASON_BYTES].decode(errors="ignore")
        try:
            async with asyncio.timeout(CLOSE_SECONDS):
                closing = asyncio.create_task(self.socket.close(code, short))
                # The client's answer comes after earlier messages, which must be read first.
                with contextlib.suppress(ConnectionClosed):
                    while True:
                        await self.socket.recv()
                await closing
        except TimeoutError:
            self.socket.transport.abort()


def _turn(work: Work) -> tuple[SessionAnswer, bool, float]:
    """Some steps of a work, in the compute thread: its answer, whether it is done, and the time that it took."""
    begin, answer, done = time.perf_counter(), SessionAnswer(), True
    for part in work:
        answer.messages += part.messages
        answer.frames += part.frames
        # Whole steps only: a step that has begun is finished.
        if time.perf_counter() - begin >= TURN_SECONDS:
            done = False
            break
    return answer, done, time.perf_counter() - begin
