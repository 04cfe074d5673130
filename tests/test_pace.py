"""A stream that is late: a server is simulated, second by second, on a clock that is not real."""

import numpy as np
import pytest

from gesticulator.live.pace import CATCH_UP_SECONDS, SKIP_SECONDS, Effort, Pace

CHUNK, PIECE = 0.02, 0.5


class SlowServer:
    """Works on one stream; full, less, none: seconds of work for a second of sound at each effort."""

    def __init__(self, full: float, less: float, none: float = 0.05) -> None:
        self.now, self.sent, self.done = 0.0, 0, 0.0
        self.pace = Pace(lambda: self.now)
        self.cost = {Effort.FULL: full, Effort.LESS: less, Effort.NONE: none}
        self.late: list[float] = []
        """How much sound had been played and not worked on, whenever a piece was done."""
        self.seconds = dict.fromkeys(Effort, 0.0)
        self.rests = 0
        """How often it began to skip."""

    def run(self, arrivals: np.ndarray, play: float = 0.0, stall: tuple[float, float] = (-1.0, 0.0)) -> None:
        """arrivals: [n] seconds at which each 20 ms of sound come; play: when they begin to be played; stall: when
        nothing is worked on, and for how long."""
        effort = Effort.FULL
        while self.done < len(arrivals) * CHUNK - 1e-9:
            self._take(arrivals)
            waiting = self.sent * CHUNK - self.done
            if waiting < 1e-9:
                self.now = arrivals[self.sent]
                continue
            if 0 <= stall[0] <= self.now:
                self._go_to(self.now + stall[1], arrivals)
                stall = (-1.0, 0.0)
                continue
            before, effort = effort, self.pace.effort(waiting)
            self.rests += effort == Effort.NONE != before
            piece = waiting if effort == Effort.NONE else min(waiting, PIECE)
            took = piece * self.cost[effort]
            self._go_to(self.now + took, arrivals)
            if effort != Effort.NONE:
                self.pace.worked(piece, took)
            self.seconds[effort] += piece
            self.done += piece
            self.late.append(min(self.now - play, self.sent * CHUNK) - self.done)

    def _go_to(self, time: float, arrivals: np.ndarray) -> None:
        while self.sent < len(arrivals) and arrivals[self.sent] <= time:
            self.now = float(arrivals[self.sent])
            self._take(arrivals)
        self.now = time

    def _take(self, arrivals: np.ndarray) -> None:
        while self.sent < len(arrivals) and arrivals[self.sent] <= self.now:
            self.pace.arrived(CHUNK)
            self.sent += 1


def microphone(seconds: float) -> np.ndarray:
    return np.arange(1, round(seconds / CHUNK) + 1) * CHUNK


@pytest.mark.parametrize(("full", "less"), [(0.3, 0.2), (1.3, 0.7), (1.05, 1.02), (2.0, 1.5), (8.0, 5.0)])
def test_however_slow_it_is_a_microphone_is_not_late_for_long(full: float, less: float) -> None:
    server = SlowServer(full, less)
    server.run(microphone(120.0))
    # A piece at full cost may be under way before it is noticed, and one at less cost before there is nothing for it.
    assert max(server.late) < SKIP_SECONDS + 1.2 + PIECE * (full + less)
    assert sum(server.seconds.values()) == pytest.approx(120.0)
    if less < 1.0:
        assert server.seconds[Effort.NONE] == 0.0, "less is enough"
    else:
        assert 0.9 * (1 - 1 / less) * 120 - 3 < server.seconds[Effort.NONE] < 110, "and some is still gestured"
    if full < 1.0:
        assert server.seconds[Effort.LESS] == 0.0, "who has time does not hurry"


def test_a_stream_that_cannot_keep_up_rests_for_a_while_rather_than_stuttering() -> None:
    server = SlowServer(2.0, 1.5)
    server.run(microphone(120.0))
    assert server.rests > 3 and server.seconds[Effort.NONE] / server.rests > 1.5


def test_a_moment_without_work_is_caught_up_and_nothing_is_passed_over() -> None:
    server = SlowServer(0.2, 0.15)
    server.run(microphone(20.0), stall=(5.0, 3.0))
    assert server.seconds[Effort.NONE] == 0.0 and 1.0 < server.seconds[Effort.LESS] < 5.0
    assert max(server.late) < 3.1 and server.late[-1] < 0.1
    caught = [late for late in server.late if late > 0.3]
    assert len(caught) * PIECE * 0.15 < CATCH_UP_SECONDS


@pytest.mark.parametrize("drift", [0.99, 1.01])
def test_a_clock_that_is_slow_or_fast_changes_nothing_after_a_quarter_of_an_hour(drift: float) -> None:
    """A microphone whose second is not ours: 9 s are sent too much or too few, and three seconds without work are still
    noticed at once and caught up."""
    server = SlowServer(0.2, 0.15)
    server.run(microphone(900.0) / drift, stall=(880.0, 3.0))
    assert server.seconds[Effort.NONE] == 0.0 and 1.0 < server.seconds[Effort.LESS] < 5.0
    assert server.pace.ahead < 2 * CHUNK


def test_an_answer_that_comes_at_once_is_not_late_while_it_waits() -> None:
    server = SlowServer(0.9, 0.5)
    server.run(np.concatenate([np.zeros(round(10 / CHUNK)), np.full(round(10 / CHUNK), 4.0)]))
    assert server.seconds[Effort.FULL] == pytest.approx(20.0)


def test_an_answer_that_cannot_be_drawn_as_fast_as_it_is_played_is_passed_over_in_parts() -> None:
    server = SlowServer(3.0, 2.0)
    server.run(np.zeros(round(60 / CHUNK)))
    assert max(server.late) < SKIP_SECONDS + 1.2 + PIECE * 5.0 and server.seconds[Effort.NONE] > 0.0


def test_what_is_not_played_any_more_is_not_ahead() -> None:
    now = [0.0]
    pace = Pace(lambda: now[0])
    pace.arrived(10.0)
    now[0] = 2.5
    assert pace.ahead == pytest.approx(7.5, rel=0.02) and pace.late(8.0) == pytest.approx(0.5, abs=0.06)
    pace.forget()
    assert pace.ahead == 0.0 and pace.late(0.4) == pytest.approx(0.4)
