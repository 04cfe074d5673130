"""Who computes next, who is admitted, and who is downgraded: on clocks that are not real."""

from __future__ import annotations

import logging
import os
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from gesticulator.serve.door import GUESS_SECONDS, GUESSES, Door, Tenant, TenantKeys, network_of, read_keys
from gesticulator.serve.governor import PRIOR_COST, REVIEW_SECONDS, Governor
from gesticulator.serve.pace import Effort
from gesticulator.serve.scheduler import CREDIT_SECONDS, Account, Member, Scheduler


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Machine:
    """A compute thread on a clock that only its turns move. Streams want a turn of `cost` seconds every `period`."""

    clock: Clock = field(default_factory=Clock)
    waits: dict[str, list[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.scheduler = Scheduler(self.clock)
        self.due: list[tuple[float, str, Member, float, float]] = []

    def stream(self, name: str, account: Account, cost: float, period: float, start: float = 0.0) -> None:
        self.due.append((start, name, Member(account), cost, period))
        self.waits[name] = []

    def run(self, seconds: float) -> None:
        while self.clock.now < seconds:
            self._submit()
            if not self.scheduler.serve_next():
                self.clock.now = max(self.clock.now, min(one[0] for one in self.due))

    def _submit(self) -> None:
        for number, (at, name, member, cost, period) in enumerate(self.due):
            if at > self.clock.now:
                continue

            def job(number: int = number, at: float = at, name: str = name, cost: float = cost,
                    period: float = period) -> None:
                self.waits[name].append(self.clock.now - at)
                self.clock.now += cost
                # One that always wants more has its next turn ready when this one is done.
                self.due[number] = (max(at + period, self.clock.now), *self.due[number][1:])

            self.due[number] = (np.inf, name, member, cost, period)
            self.scheduler.submit(member, job)


def late(waits: list[float]) -> float:
    return float(np.quantile(waits, 0.99))


def test_a_stream_that_needs_little_waits_for_one_turn_of_one_that_always_wants_more() -> None:
    alone, beside = Machine(), Machine()
    for machine in (alone, beside):
        for number in range(8):
            machine.stream(f"good {number}", Account(f"{number}"), 0.015, 0.3, 0.037 * number)
    hungry = Account("hungry")
    for number in range(60):
        beside.stream(f"bad {number}", hungry, 0.015, 0.0)
    alone.run(60.0)
    beside.run(60.0)
    for number in range(8):
        assert late(beside.waits[f"good {number}"]) <= late(alone.waits[f"good {number}"]) + 0.015 + 1e-6
        assert len(beside.waits[f"good {number}"]) >= len(alone.waits[f"good {number}"]) - 1
    served = sum(len(beside.waits[f"bad {number}"]) for number in range(60))
    assert served * 0.015 > 60.0 * (1 - 8 * 0.015 / 0.3) * 0.95, "what is left over is not wasted"


def test_new_streams_are_not_served_before_old_ones_and_what_can_wait_is_served_last() -> None:
    scheduler, account, order = Scheduler(Clock()), Account(), []
    old, ahead = Member(account), Member(account, waits=True)
    scheduler.submit(old, lambda: None)
    scheduler.submit(ahead, lambda: None)
    while scheduler.serve_next():
        pass
    old.used = account.virtual = 3.0
    old.used -= 0.05
    for name, member in (("ahead", ahead), *((f"new {k}", Member(account)) for k in range(3)), ("old", old)):
        scheduler.submit(member, lambda name=name: order.append(name))  # type: ignore[misc]
    while scheduler.serve_next():
        pass
    assert order == ["old", "new 0", "new 1", "new 2", "ahead"]


def test_streams_are_opened_as_fast_as_they_may() -> None:
    clock = Clock()
    door, opened = Door(9, 9, clock), 0
    for _ in range(3000):
        opened += door.open_wait("1.2.3.4", 2.0, 24) == 0
        clock.now += 0.01
    assert 24 + 58 <= opened <= 24 + 60 and door.open_wait("1.2.3.5", 2.0, 24) == 0
    door.open_wait("1.2.3.4", 2.0, 24)
    assert 0 < door.open_wait("1.2.3.4", 2.0, 24) <= 0.5


def test_streams_of_one_address_share_its_part_and_each_other_fairly() -> None:
    machine, one, other = Machine(), Account("one"), Account("other")
    for number in range(9):
        machine.stream(f"one {number}", one, 0.01, 0.0)
    machine.stream("other", other, 0.03, 0.0)
    machine.run(30.0)
    used = {name: len(waits) * (0.03 if name == "other" else 0.01) for name, waits in machine.waits.items()}
    assert used["other"] == pytest.approx(15.0, abs=0.2)
    assert all(used[f"one {number}"] == pytest.approx(15.0 / 9, abs=0.2) for number in range(9))


def test_who_was_away_has_saved_nothing_up() -> None:
    machine, old, new = Machine(), Account("old"), Account("new")
    machine.stream("old", old, 0.01, 0.0)
    machine.stream("new", new, 0.01, 0.0, start=20.0)
    machine.run(20.5)
    counts = Counter({name: sum(1 for _ in waits) for name, waits in machine.waits.items()})
    assert 0.25 - 0.01 <= counts["new"] * 0.01 <= 0.25 + CREDIT_SECONDS / 2 + 0.02


def test_a_failing_or_cancelled_turn_ends_nothing_else() -> None:
    scheduler, member = Scheduler(), Member()
    failing, cancelled = scheduler.submit(member, lambda: 1 // 0), scheduler.submit(member, lambda: 1)
    last = scheduler.submit(Member(), lambda: 7)
    assert cancelled.cancel()
    while scheduler.serve_next():
        pass
    assert isinstance(failing.exception(), ZeroDivisionError) and last.result() == 7
    assert scheduler.stuck_seconds == 0.0 and member.account.wanted == 0


def test_a_turn_that_does_not_end_is_seen() -> None:
    clock, seen = Clock(), []
    scheduler = Scheduler(clock)

    def job() -> None:
        clock.now += 7.0
        seen.append(scheduler.stuck_seconds)

    scheduler.submit(Member(), job)
    scheduler.serve_next()
    assert seen == [7.0] and scheduler.stuck_seconds == 0.0


# ---------------------------------------------------------------- the governor


@dataclass(eq=False)
class Speaker:
    """A microphone: a second of sound a second, and what of it was not answered."""

    priority: int = 0
    lateness: float | None = 0.0
    effort: Effort = Effort.FULL
    saving: float = 0.0


def govern(speakers: list[Speaker], power: list[float], cost: dict[Effort, float]) -> list[list[Effort]]:
    """Streams on a machine whose power (computing seconds per second) is given for each second; efforts at each end."""
    clock, history = Clock(), []
    governor = Governor(0.85, 64, clock=clock)
    for share in power:
        for _ in range(round(1 / REVIEW_SECONDS)):
            ranked = governor.ranked(speakers)
            left = share * REVIEW_SECONDS
            for speaker in speakers:
                speaker.effort = governor.effort(speaker, ranked)
                speaker.lateness = 0.0 if speaker.effort == Effort.NONE else (speaker.lateness or 0.0) + REVIEW_SECONDS
            # Fair: the latest first, as far as the time goes.
            for speaker in sorted(speakers, key=lambda one: -(one.lateness or 0.0)):
                if speaker.effort == Effort.NONE:
                    left -= cost[Effort.NONE] * REVIEW_SECONDS
            while left > 1e-9:
                speaker = max(speakers, key=lambda one: one.lateness or 0.0)
                piece = min(0.05, speaker.lateness or 0.0, left / cost[speaker.effort])
                if piece <= 0:
                    break
                speaker.lateness = (speaker.lateness or 0.0) - piece
                left -= piece * cost[speaker.effort]
            clock.now += REVIEW_SECONDS
            governor.review(speakers)
        ranked = governor.ranked(speakers)
        history.append([governor.effort(speaker, ranked) for speaker in speakers])
    return history


COST = {Effort.FULL: 0.06, Effort.LOW: 0.06, Effort.LESS: 0.03, Effort.NONE: 0.01}
STEPS = [Effort.FULL, Effort.LESS, Effort.NONE]
"""Of a stream that has low look-ahead anyway."""


def test_with_time_enough_nobody_is_downgraded() -> None:
    history = govern([Speaker() for _ in range(12)], [1.0] * 30, COST)
    assert all(effort == Effort.FULL for row in history for effort in row)


def test_the_newest_of_the_lowest_priority_goes_first_and_the_first_keeps_its_gestures() -> None:
    """Twelve streams that need 0.72 of a core have 0.24: four hurried ones fit beside eight that idle."""
    speakers = [Speaker(priority=int(number < 2)) for number in range(12)]
    history = govern(speakers, [0.24] * 60, COST)
    for row in history:
        levels = [STEPS.index(effort) for effort in row]
        assert max(levels) - min(levels) <= 1, "all hurry before the first one idles"
        assert levels == sorted(levels), "older ones, here of higher priority too, are never below newer ones"
    settled = history[-20:]
    assert np.mean([row.count(Effort.LESS) for row in settled]) > 3.0
    assert all(speaker.lateness is not None and speaker.lateness < 2.5 for speaker in speakers)
    assert all(row[0] != Effort.NONE for row in history), "whoever came first gestures throughout"


def test_streams_are_restored_in_reverse_order_when_there_is_time_again() -> None:
    history = govern([Speaker() for _ in range(6)], [0.08] * 20 + [1.0] * 120, COST)
    assert Effort.NONE in history[19]
    assert history[-1] == [Effort.FULL] * 6
    for row in history:
        levels = [STEPS.index(effort) for effort in row]
        assert levels == sorted(levels)


def test_full_look_ahead_goes_first_then_quality_then_gestures_and_all_come_back_in_reverse_order() -> None:
    """Eight streams, every other one with full look-ahead, on a machine that loses its time and has it again."""
    speakers = [Speaker(priority=number // 4, saving=0.6 * (number % 2)) for number in range(8)]
    order = sorted(range(8), key=lambda number: (speakers[number].priority, -number))
    long = [number for number in order if speakers[number].saving]
    states = []
    for depth in range(4 + 8 + 8 + 1):
        state = dict.fromkeys(range(8), Effort.FULL)
        state.update(dict.fromkeys(long[:depth], Effort.LOW))
        state.update(dict.fromkeys(order[:max(0, depth - 4)], Effort.LESS))
        state.update(dict.fromkeys(order[:max(0, depth - 12)], Effort.NONE))
        states.append([state[number] for number in range(8)])
    history = govern(speakers, [0.10] * 20 + [1.0] * 160, COST)
    visited = [states.index(row) for row in history]
    assert max(visited) > 12 and visited[-1] == 0
    down = visited.index(max(visited))
    assert all(now <= before for before, now in pairwise(visited[down + 20:])), "nothing is restored out of order"
    assert {4, 3, 2, 1} <= set(visited[down:]), "look-ahead comes back last, one stream after the other"


def test_a_lateness_that_low_look_ahead_makes_up_for_goes_no_further_and_is_not_forgotten() -> None:
    """Half a second late: poses of low look-ahead come 0.6 s earlier, so no quality is lost, and it stays so until the
    sound is caught up."""
    governor, speaker = Governor(0.85, 12, clock=(clock := Clock())), Speaker(saving=0.6)
    efforts = []
    for late in [0.5] * 100 + [0.0] * 100:
        clock.now += REVIEW_SECONDS
        speaker.lateness = late
        governor.review([speaker])
        efforts.append(governor.effort(speaker, governor.ranked([speaker])))
    assert efforts[:100] == [Effort.LOW] * 100 and efforts[-1] == Effort.FULL
    assert efforts[100:].count(Effort.LOW) == pytest.approx(2.0 / REVIEW_SECONDS, abs=1)


def test_a_stream_that_is_rendered_whole_is_never_downgraded() -> None:
    governor = Governor(0.85, 12, clock=(clock := Clock()))
    whole, other = Speaker(lateness=None), Speaker(lateness=5.0)
    for _ in range(40):
        clock.now += REVIEW_SECONDS
        governor.review([whole, other])
    ranked = governor.ranked([whole, other])
    assert governor.effort(whole, ranked) == Effort.FULL and governor.effort(other, ranked) == Effort.NONE


@given(st.floats(0.001, 2.0), st.floats(0.05, 1.0), st.integers(1, 64))
def test_what_is_admitted_fits_into_what_may_be_promised(cost: float, share: float, most: int) -> None:
    governor = Governor(share, most)
    for _ in range(100):
        governor.worked(2.0, 2.0 * cost)
    assert governor.cost == pytest.approx(cost, rel=0.01)
    open_ones = 0
    while governor.room(open_ones).open:
        open_ones += 1
    assert open_ones >= 1, "the first one is always admitted"
    assert open_ones <= most and (open_ones == 1 or open_ones * governor.cost <= share + 1e-6)
    assert open_ones == most or (open_ones + 1) * governor.cost > share
    assert governor.room(open_ones).reason and governor.room(open_ones).capacity == open_ones


def test_nobody_is_admitted_while_somebody_is_downgraded() -> None:
    governor = Governor(0.85, 12, clock=(clock := Clock()))
    assert governor.room(3).open and governor.cost == PRIOR_COST
    for _ in range(3):
        clock.now += REVIEW_SECONDS
        governor.review([Speaker(lateness=0.5)])
    assert governor.depth and not governor.room(3).open and governor.room(0).open


# ---------------------------------------------------------------- the door


class Caller:
    def __init__(self) -> None:
        self.gone = False

    def cut(self) -> None:
        self.gone = True


@given(st.lists(st.tuples(st.integers(0, 5), st.booleans()), max_size=80))
def test_there_are_never_more_guests_than_that_and_the_newest_is_in(events: list[tuple[int, bool]]) -> None:
    door, callers = Door(7, 3), []
    for address, leaves in events:
        if leaves and callers:
            door.leave(callers[address % len(callers)][0])
        caller = Caller()
        callers.append((caller, str(address)))
        before = sum(one.gone for one, _ in callers)
        assert door.enter(caller, str(address)) == sum(one.gone for one, _ in callers) - before
        assert not caller.gone and len(door) <= 7
    for address in range(6):
        assert sum(1 for caller, where in callers if where == str(address) and caller in door._guests) <= 3


def test_tokens_are_guessed_slowly_and_an_address_is_forgiven() -> None:
    clock = Clock()
    door = Door(9, 9, clock)
    guesses = 0
    for _ in range(10_000):  # a thousand seconds of a machine that guesses whenever it may
        if door.wait("1.2.3.4") == 0:
            door.wrong("1.2.3.4")
            guesses += 1
        clock.now += 0.1
    assert guesses <= GUESSES + 1000 / GUESS_SECONDS + 1
    door.wrong("1.2.3.4")
    assert 0 < door.wait("1.2.3.4") <= 2 * GUESS_SECONDS and door.wait("1.2.3.5") == 0
    clock.now += door.wait("1.2.3.4")
    assert door.wait("1.2.3.4") == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("address", "counted"), [
    ("1.2.3.4", "1.2.3.4"), ("::ffff:1.2.3.4", "1.2.3.4"), ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
    ("fe80::1%eth0", "fe80::/64"), ("no address", "no address")])
def test_an_address_is_counted_as_what_one_machine_has(address: str, counted: str) -> None:
    assert network_of(address) == counted


def test_keys_are_rotated_while_the_server_runs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    clock, file, turn = Clock(), tmp_path / "keys", iter(range(1, 9))

    def write(text: str) -> None:
        file.write_text(text)
        os.utime(file, ns=(0, next(turn) * 10**9))
        clock.now += 2.0

    write("# tenants\nacme first-key-of-acme streams=3 priority=2\n\nother key-of-the-other\n")
    keys = TenantKeys("the server's own", file, clock)
    assert keys.tenant("first-key-of-acme") == Tenant("acme", 3, 2)
    assert keys.tenant("key-of-the-other") == Tenant("other")
    assert keys.tenant("the server's own") == Tenant()
    assert keys.tenant("") is None and keys.tenant("\ud800") is None and keys.tenant("key") is None
    write("acme first-key-of-acme\nacme second-key-of-acme\n")
    assert keys.tenant("first-key-of-acme") == keys.tenant("second-key-of-acme") == Tenant("acme")
    assert keys.tenant("key-of-the-other") is None
    write("acme second-key-of-acme\n")
    assert keys.tenant("first-key-of-acme") is None and keys.tenant("second-key-of-acme") == Tenant("acme")
    with caplog.at_level(logging.WARNING, "gesticulator.serve"):
        write("acme\n")
        assert keys.tenant("second-key-of-acme") == Tenant("acme"), "a broken file locks nobody out"
        file.unlink()
        clock.now += 2.0
        assert keys.tenant("second-key-of-acme") == Tenant("acme")
    logged = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert [line.count("\n") for line in logged] == [0, 0]


@pytest.mark.parametrize(("text", "wrong"), [
    ("", "no keys"), ("acme", "no key"), ("acme short", "shorter"), ("acme long-enough-key streams=x", "setting"),
    ("acme long-enough-key what=1", "setting"), ("a long-enough-key\nb long-enough-key", ":2")])
def test_a_file_of_keys_that_is_wrong_says_where(text: str, wrong: str, tmp_path: Path) -> None:
    file = tmp_path / "keys"
    file.write_text(text)
    with pytest.raises(InputError, match=wrong):
        read_keys(file)
