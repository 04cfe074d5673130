"""Who computes next: one thread, turns of at most a block, fair by what each client and each stream has used.

A *turn* computes for `TURN_SECONDS`, or for one block where that takes longer, and then others are served. The next
turn goes to the account (a tenant, or an address) that has used least processor time, and within it to the stream that
has used least. A stream that needs little, as a microphone does, is therefore served before one that always wants more,
whatever that one asks for: sound, idle time, catching up or rewinding.

A stream whose poses are made for a while ahead of what is played (`AHEAD_SECONDS`) can wait: it is served while no
other one wants a turn. So a long answer that was sent at once, or a minute of idle time, takes what others leave.

Use is counted as virtual time. A new stream begins at the present, so that many new ones are no way to be served first.
An account or a stream that comes back after it wanted nothing starts `CREDIT_SECONDS`
before the present, so that it is served soon and nothing can be saved up.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

T = TypeVar("T")
TURN_SECONDS = 0.015
"""Time after which a turn ends at the next step: a block takes about as long, so a turn takes at most 30 ms."""
CREDIT_SECONDS = 0.1
"""Use, seconds, that who returns is behind the present: a few turns."""


AHEAD_SECONDS = 1.0
"""Poses ahead of what is played, seconds, with which a stream can wait."""


@dataclass(eq=False)
class Account:
    """What shares a fair part: all streams of a tenant or of an address. used: seconds, in virtual time."""

    name: str = ""
    used: float = 0.0
    wanted: int = 0
    """Turns that wait or run."""
    virtual: float = 0.0
    """Present of its streams: use of the one that was served last."""


@dataclass(eq=False)
class Member:
    """A stream that computes."""

    account: Account = field(default_factory=Account)
    used: float = 0.0
    new: bool = True
    waits: bool = False
    """Whether it can wait: see the module."""


@dataclass(eq=False)
class _Turn:
    member: Member
    job: Callable[[], Any]
    future: Future[Any]
    number: int


class Scheduler:
    """The compute thread. A member waits for one turn at a time."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._turns: list[_Turn] = []
        self._changed = threading.Condition()
        self._numbers = 0
        self._virtual = 0.0
        self._begun: float | None = None
        self._ended = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread; a scheduler that is not started is served by `serve_next`."""
        self._thread = threading.Thread(target=self._run, name="compute", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread after the turn that is running; waiting turns are cancelled."""
        with self._changed:
            self._ended = True
            for turn in self._turns:
                turn.future.cancel()
            self._turns.clear()
            self._changed.notify_all()

    def submit(self, member: Member, job: Callable[[], T]) -> Future[T]:
        """Ask for a turn."""
        account = member.account
        with self._changed:
            if not account.wanted:
                account.used = max(account.used, self._virtual - CREDIT_SECONDS)
            account.wanted += 1
            member.used = max(member.used, account.virtual - (0.0 if member.new else CREDIT_SECONDS))
            member.new = False
            self._numbers += 1
            future: Future[T] = Future()
            self._turns.append(_Turn(member, job, future, self._numbers))
            self._changed.notify_all()
        return future

    async def run(self, member: Member, job: Callable[[], T]) -> T:
        """Wait for a turn, and for its result."""
        return await asyncio.wrap_future(self.submit(member, job))

    @property
    def stuck_seconds(self) -> float:
        """Time since the running turn began; 0 if none is running."""
        begun = self._begun
        return 0.0 if begun is None else max(0.0, self._clock() - begun)

    @property
    def waiting(self) -> int:
        """Turns that wait."""
        return len(self._turns)

    def serve_next(self) -> bool:
        """Run the next turn in the calling thread; False if none waits."""
        with self._changed:
            turn = self._take()
        if turn is None:
            return False
        self._serve(turn)
        return True

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or bool(self._turns))
                if self._ended:
                    return
                turn = self._take()
            if turn is not None:
                self._serve(turn)
            del turn  # it holds its stream, which may be the last one for hours

    def _take(self) -> _Turn | None:
        """The turn of whoever has used least. Called with the lock held."""
        if not self._turns:
            return None
        turn = min(self._turns, key=lambda one: (one.member.waits, one.member.account.used, one.member.used,
                                                 one.number))
        self._turns.remove(turn)
        account = turn.member.account
        self._virtual = max(self._virtual, account.used)
        account.virtual = max(account.virtual, turn.member.used)
        return turn

    def _serve(self, turn: _Turn) -> None:
        if turn.future.set_running_or_notify_cancel():
            self._begun = begun = self._clock()
            result, error = None, None
            try:
                result = turn.job()
            except BaseException as failure:  # noqa: BLE001 - it belongs to who asked
                error = failure
            self._begun = None
            took = max(0.0, self._clock() - begun)
            turn.member.used += took
            turn.member.account.used += took
            with contextlib.suppress(Exception):  # cancelled meanwhile
                turn.future.set_exception(error) if error is not None else turn.future.set_result(result)
        with self._changed:
            turn.member.account.wanted -= 1
