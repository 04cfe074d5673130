"""One client's stream: messages wait in a bounded queue, are processed turn by turn, and poses wait in another.

Three tasks share a stream. `_read` takes messages and rejects excess; `_work` asks for turns of the compute thread, in
competition with all other streams; `_write` sends. A client that does not read fills its own queue of poses: then its
stream pauses, and other streams are not affected.

A stream that its client may resume outlives its socket: without one, `_work` goes on until its queues are full or
empty, and the next socket sends what is missing on both sides (`Connection.attach`).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from websockets.exceptions import ConnectionClosed

from data_module.errors import InputError
from gesticulator.serve.pace import Effort, Pace
from gesticulator.serve.protocol import CloseCode, RefusedError, StreamRequest, read_hello, read_message
from gesticulator.serve.resume import SentMessages, new_session
from gesticulator.serve.scheduler import AHEAD_SECONDS, TURN_SECONDS, Account, Member, Scheduler
from gesticulator.serve.session import SessionAnswer

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection

    from data_module.types import Samples
    from gesticulator.serve.metrics import ServerMetrics
    from gesticulator.serve.session import Session, Work
    from gesticulator.serve.settings import ServerLimits
    from gesticulator.serve.vmc import PoseOutput

PIECE_SECONDS = 0.5
"""Audio taken up at a time, seconds; it is computed in turns of a block."""
IDLE_SECONDS = 0.1
"""Idle motion generated at a time, seconds, after a client requested it until audio arrives."""
STILL_SECONDS = 0.25
"""Audio passed over at a time, seconds, in a stream that idles because compute is short."""
CLOSE_SECONDS = 2.0
"""Time for a client to answer a close frame, seconds; then the connection is aborted."""
_REASON_BYTES = 120
"""Bytes of the reason in a close frame; the limit is 123."""
_MOST_WAITING = 10_000
"""Most queued messages: a minute of 6 ms packets; bounds empty commands too."""
_WAITS = ("idle", "think")
_DOWNGRADED = {Effort.LOW: "shortened_seconds_total", Effort.LESS: "hurried_seconds_total",
               Effort.NONE: "passed_seconds_total"}
"""Metrics of audio that was not processed as the client asked."""


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

    @property
    def seconds(self) -> float:
        """Media time of a wait; 0 for other commands."""
        return float(self.message.get("seconds", 0.0)) if self.message["type"] in _WAITS else 0.0


class Host(Protocol):
    """The server, as a connection sees it."""

    async def passed_on(self, connection: Connection, request: StreamRequest) -> bool:
        """Serve the client at another worker, if that one has its session, until the end; False if not."""

    def admit(self, connection: Connection, request: StreamRequest) -> Connection | None:
        """Give the connection a place, or find the stream that it resumes; `RefusedError` if there is no place or the
        token is wrong."""

    def effort(self, connection: Connection) -> Effort:
        """How the stream is served while compute is short."""

    def worked(self, seconds: float, took: float) -> None:
        """`seconds` of speech at full quality took so much computing."""


@dataclass(frozen=True)
class Workplace:
    """Resources shared by connections.

    scheduler: the compute thread. open_session: creates a session for a request, in that thread. output: also receives
    the motion, beside the WebSocket.
    """

    limits: ServerLimits
    metrics: ServerMetrics
    scheduler: Scheduler
    open_session: Callable[[str, StreamRequest], Session]
    host: Host
    output: PoseOutput | None = None


class Connection:
    """A client's stream from its hello to its end."""

    def __init__(self, socket: ServerConnection, name: str, workplace: Workplace, address: str = "") -> None:
        self.socket, self.name, self.place, self.address = socket, name, workplace, address
        self.reason = "closed by the client"
        self.code: int = CloseCode.NORMAL
        self.frames = 0
        self.seconds = 0.0
        self.member = Member(Account(address))
        self.number = 0
        """Later streams have higher ones."""
        self.priority = 0
        self.tenant = ""
        self.hello = ""
        """The client's hello, as it came."""
        self.session: str | None = None
        """What a client may resume it by."""
        self.parked = False
        """Whether it waits for its client to come back."""
        self._waiting: deque[_Sound | _Command] = deque()
        self._waiting_seconds = 0.0
        self._waiting_idle = 0.0
        """Seconds of waits that are queued or being computed."""
        self._unread: deque[bytes | str | None] = deque()
        self._unread_bytes = 0
        self._changed = asyncio.Condition()
        self._idling: float | None = None
        """time.monotonic() up to which idle motion was generated; None if it is not requested."""
        self._waits = "idle"
        """The kind of idle motion: "idle" or "think"."""
        self._computed: _Command | None = None
        """The wait that is being computed."""
        self._cut = False
        """Whether the wait that is being computed ends now."""
        self._cut_at = math.inf
        """Media time at which an interruption ends all waits."""
        self._leaving = False
        self._finishing = False
        """Whether no message is to come."""
        self._pace = Pace()
        self._taken_back = 0.0
        """Seconds that cannot have been played at the time of a pending interruption."""
        self._keeps_up = False
        """Whether late audio is processed at lower cost or skipped."""
        self._heard = False
        """Whether the sound that comes is another's voice."""
        self._heard_messages = 0
        """Messages of the client that were queued."""
        self._sent: SentMessages | None = None
        self._back = asyncio.Event()
        """Set when a parked stream has a new socket, or is given up."""
        self._detached: asyncio.Future[None] | None = None
        """Done when the socket that resumed the stream is no longer used by it."""
        self._welcome: dict[str, Any] = {}
        self.saving = 0.0
        """Seconds by which low look-ahead brings poses earlier, see `Governed`."""

    @property
    def lateness(self) -> float | None:
        """Seconds of sound that must have been played and are not answered; None if the stream is rendered whole."""
        return self._pace.late(self._waiting_seconds) if self._keeps_up else None

    async def run(self) -> None:
        """Serve the client; returns whatever the client does."""
        try:
            request = await self._hello()
            if await self.place.host.passed_on(self, request):
                return
            other = self.place.host.admit(self, request)
            if other is not None:
                if await other.attach(self.socket, request):
                    self.reason = f"went on as stream {other.name}"
                    return
                other.give_up()
                self.place.host.admit(self, replace(request, resume=None))
            session = await self.place.scheduler.run(self.member, lambda: self.place.open_session(self.name, request))
            self._welcome, self.saving = session.welcome(), session.saving
            if request.resumable:
                self.session = self.session or new_session(self.name.partition("-")[0])
                self._sent = SentMessages(self.place.limits.resume_bytes)
                self._welcome["session"] = self.session
            await self.socket.send(self._greeting(resumed=False))
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
            self._let_go()
            if self.place.output is not None:
                self.place.output.leave(self.name)
            self.place.metrics.add("waiting_seconds", -self._waiting_seconds)
            self.place.metrics.add("unread_bytes", -self._unread_bytes)
            self._waiting.clear()
            self._unread.clear()

    async def leave(self) -> None:
        """Finish processing and close, because the server is stopping; at once if the client is gone."""
        async with self._changed:
            self._leaving = True
            self._changed.notify_all()
        self._back.set()

    def give_up(self) -> None:
        """End a parked stream: its place is needed."""
        self._back.set()

    async def _hello(self) -> StreamRequest:
        try:
            async with asyncio.timeout(self.place.limits.hello_seconds):
                message = await self.socket.recv()
        except TimeoutError:
            raise RefusedError(CloseCode.TOO_QUIET, "no hello came") from None
        if not isinstance(message, str):
            raise RefusedError(CloseCode.BAD_MESSAGE, "the first message must be a hello, as text")
        self.hello = message
        return read_hello(message)

    def _greeting(self, resumed: bool) -> str:
        return json.dumps({**self._welcome, "resumed": resumed, "messages": self._heard_messages})

    # ------------------------------------------------------------------------------------------- sockets of a stream

    async def attach(self, socket: ServerConnection, request: StreamRequest) -> bool:
        """Go on with another socket, until it is lost or the stream ends; False if that cannot be: the client missed
        more than was kept."""
        assert request.resume is not None and self._sent is not None
        if self.parked is False:  # the client noticed first
            self.socket.transport.abort()
            for _ in range(100):
                if self.parked:
                    break  # type: ignore[unreachable]  # another task parks it meanwhile
                await asyncio.sleep(0.01)
        if not self.parked or self._leaving:
            return False
        async with self._changed:
            if not self._catch_up(int(request.resume["messages"])):
                return False
            self.parked = False
            self.socket = socket
            self._detached = detached = asyncio.get_running_loop().create_future()
        self.place.metrics.add("resumed_total")
        await socket.send(self._greeting(resumed=True))
        self._back.set()
        await detached
        return True

    def _catch_up(self, got: int) -> bool:
        """Queue again what the client did not get. got: messages that it got."""
        assert self._sent is not None
        beyond = got - self._sent.count
        if beyond > 0:  # the last one was sent, and the connection broke before that was known
            if beyond > 1 or not self._unread or self._unread[0] is None:
                return False
            message = self._unread.popleft()
            assert message is not None
            self._count_unread(-len(message))
            self._sent.add(message)
            return True
        again = self._sent.since(got)
        if again is None:
            return False
        self._unread.extendleft(reversed(again))
        self._count_unread(sum(map(len, again)))
        return True

    def _let_go(self) -> None:
        if self._detached is not None and not self._detached.done():
            self._detached.set_result(None)

    async def _park(self, worker: asyncio.Task[None], closed: ConnectionClosed) -> None:
        """Wait for another socket; raises `closed` if none comes, and what ends the worker."""
        self._back.clear()
        self._let_go()
        self.parked = True
        self.place.metrics.add("parked")
        back = asyncio.create_task(self._back.wait())
        until = time.monotonic() + self.place.limits.resume_seconds
        try:
            while not back.done() and (left := until - time.monotonic()) > 0:
                if worker.done():
                    worker.result()
                await asyncio.wait({back} if worker.done() else {back, worker}, timeout=left,
                                   return_when=asyncio.FIRST_COMPLETED)
            if self.parked:
                raise closed
        finally:
            back.cancel()
            self.parked = False
            self.place.metrics.add("parked", -1)

    async def _serve(self, request: StreamRequest, session: Session) -> None:
        self._keeps_up = request.keeps_up
        worker = asyncio.create_task(self._work(session))
        try:
            while True:
                try:
                    await self._talk(request, worker)
                    break
                except ConnectionClosed as closed:
                    gone = closed.rcvd is None or closed.rcvd.code == CloseCode.GOING_AWAY
                    if self._sent is None or self._leaving or not gone:
                        raise
                    await self._park(worker, closed)
        finally:
            worker.cancel()
            await asyncio.gather(worker, return_exceptions=True)
        await self._close(self.code, self.reason if self._leaving else "")

    async def _talk(self, request: StreamRequest, worker: asyncio.Task[None]) -> None:
        """Read and write on the present socket until all is written."""
        if worker.done():
            worker.result()
        writer = asyncio.create_task(self._write())
        own = {writer} if self._finishing else {writer, asyncio.create_task(self._read(request))}
        tasks = own | ({worker} if not worker.done() else set())
        try:
            while writer in tasks:
                done, tasks = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()  # re-raise its exception
        finally:
            for task in own:
                task.cancel()
            await asyncio.gather(*own, return_exceptions=True)

    async def _read(self, request: StreamRequest) -> None:
        """Take messages until the client finishes; `RefusedError` for too much, too little or invalid data."""
        limits, heard = self.place.limits, self._heard
        while True:
            try:
                async with asyncio.timeout(limits.quiet_seconds):
                    message = await self.socket.recv()
            except TimeoutError:
                raise RefusedError(CloseCode.TOO_QUIET, f"nothing came for {limits.quiet_seconds:g} s") from None
            if isinstance(message, bytes):
                samples = request.samples(message)
                await self._wait_with(_Sound(samples, heard, time.monotonic()), len(samples) / request.sample_rate)
                continue
            command = read_message(message)
            if command["type"] == "hello":
                raise RefusedError(CloseCode.BAD_MESSAGE, "a second hello came")
            heard = self._heard = command["type"] == "listen" or (heard and command["type"] != "speak")
            self._pace.arrived(float(command.get("seconds", 0.0)))
            if command["type"] == "interrupt":
                self._cut_at = float(command.get("time", -math.inf))
                await self._drop_waiting(request)
            self._finishing = command["type"] == "finish"
            await self._wait_with(_Command(command), 0.0)
            if self._finishing:
                return

    async def _wait_with(self, item: _Sound | _Command, seconds: float) -> None:
        limits = self.place.limits
        self.seconds += seconds
        if self.seconds > limits.stream_seconds:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"a stream takes {limits.stream_seconds:g} s of sound")
        waits = item.seconds if isinstance(item, _Command) else 0.0
        waiting = self._waiting_seconds + self._waiting_idle + seconds + waits
        if waiting > limits.waiting_seconds or len(self._waiting) >= _MOST_WAITING:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"more than {limits.waiting_seconds:g} s of sound and waits, "
                               f"or {_MOST_WAITING} messages, wait to be worked on")
        self.place.metrics.add("sound_seconds_total", seconds)
        self._pace.arrived(seconds)
        async with self._changed:
            self._heard_messages += 1
            if seconds or isinstance(item, _Command):
                self._waiting.append(item)
            if seconds and not item.heard:  # type: ignore[union-attr]
                self._end_early()
            self._waiting_idle += waits
            self._count_waiting(seconds)
            self._changed.notify_all()

    def _end_early(self) -> None:
        """End the waits that sound ends: the one that is being computed, and those that are queued."""
        for number, item in enumerate(self._waiting):
            if isinstance(item, _Command) and item.message.get("until_sound"):
                self._waiting_idle -= item.seconds
                self._waiting[number] = _Command({"type": item.message["type"], "seconds": 0.0})
        self._cut = self._computed is not None and bool(self._computed.message.get("until_sound"))

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
        """Turn queued messages into poses, turn by turn, until the stream is finished."""
        while True:
            still = self._keeps_up and self.place.host.effort(self) == Effort.NONE
            item = await self._next(session.request.sample_rate, max(session.lacking, STILL_SECONDS if still else 0.0))
            begin = time.monotonic()
            session.unplayed(max(self._pace.ahead, self._taken_back))
            if isinstance(item, _Sound):
                took = await self._compute(session, session.feed(item.samples, item.heard, item.effort))
                self._count_sound(item, len(item.samples) / session.request.sample_rate, time.monotonic() - begin, took)
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
        self._computed = command if command.seconds else None
        try:
            await self._compute(session, session.obey(command.message))
        finally:
            self._computed, self._cut = None, False
            self._waiting_idle = max(0.0, self._waiting_idle - command.seconds)
        if command.message["type"] == "interrupt":
            self._taken_back, self._cut_at = 0.0, math.inf
        if command.message in ({"type": "idle"}, {"type": "think"}):
            self._waits, self._idling = command.message["type"], begin

    def _count_sound(self, sound: _Sound, seconds: float, elapsed: float, took: float) -> None:
        """Count a processed piece of audio; elapsed: seconds it took, with the turns of others; took: without them."""
        metrics = self.place.metrics
        metrics.time("answer_seconds", time.monotonic() - sound.arrived)
        if sound.effort != Effort.NONE:
            self._pace.worked(seconds, elapsed)
        if sound.effort in (Effort.FULL, Effort.LOW) and not sound.heard:
            self.place.host.worked(seconds, took)
        if sound.effort in _DOWNGRADED:
            metrics.add(_DOWNGRADED[sound.effort], seconds)

    def _ends(self, session: Session) -> bool:
        """Whether the wait that is being computed ends here."""
        return self._computed is not None and (self._cut or session.until >= self._cut_at)

    async def _compute(self, session: Session, work: Work) -> float:
        """Do some work turn by turn, and queue its answers; returns seconds of computing. A wait ends when it is cut,
        and all work pauses while the client does not read."""
        spent, done = 0.0, False
        while not done and not self._ends(session):
            self.member.waits = self._pace.ahead - self._waiting_seconds - self._waiting_idle > AHEAD_SECONDS
            answer, done, took = await self.place.scheduler.run(self.member, lambda: _turn(work))
            self.place.metrics.time("compute_seconds", took)
            spent += took
            await self._put(answer)
            if not done:
                async with self._changed:
                    await self._room()
        work.close()
        return spent

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
                    return _Command({"type": "leave"})
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
        effort = self._effort() if self._keeps_up and not first.heard else Effort.FULL
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

    def _effort(self) -> Effort:
        """How the next piece is processed: as the server has time for, and not at all if it is hopelessly late."""
        level = self.place.host.effort(self)
        hopeless = self._pace.effort(self._waiting_seconds) == Effort.NONE
        return Effort.NONE if hopeless else level

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
        while self._unread_bytes >= limits.unread_bytes:
            parked = self.parked
            try:
                async with asyncio.timeout(limits.unread_seconds):
                    await self._changed.wait_for(lambda: self._unread_bytes < limits.unread_bytes)
            except TimeoutError:
                if not (parked or self.parked):
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
                if self._sent is not None:
                    self._sent.add(message)
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
        told = {} if refused.retry_after is None else {"retry_after": refused.retry_after}
        message = json.dumps({"type": "error", "code": int(refused.code), "message": refused.reason, **told})
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            async with asyncio.timeout(1.0):
                await self.socket.send(message)
        await self._close(refused.code, refused.reason)

    async def _close(self, code: int, reason: str) -> None:
        """Close, or abort the connection of a client that does not answer the close frame."""
        short = reason.encode("utf-8", "replace")[:_REASON_BYTES].decode(errors="ignore")
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


def _turn(work: Work) -> tuple[SessionAnswer, bool, float]:
    """Some steps of a work, in the compute thread: its answer, whether it is done, and the time that it took."""
    begin, answer, done = time.perf_counter(), SessionAnswer(), True
    for part in work:
        answer.messages += part.messages
        answer.frames += part.frames
        if time.perf_counter() - begin >= TURN_SECONDS:
            done = False
            break
    return answer, done, time.perf_counter() - begin
