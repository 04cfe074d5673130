"""The model of a batch on a cluster: times that are known, bounds that are proven, and a line through points."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.benchmark_files import benchmark

model = benchmark("cluster_model")
Costs, Workers, simulate = model.BatchCosts, model.Workers, model.simulate
SECOND = Costs(start=0.0, per_second=1.0, per_file=0.0)
"""A second of work for each second of sound, and nothing else."""


def test_one_worker_does_everything_one_after_the_other() -> None:
    costs = Costs(start=5.0, per_second=0.1, per_file=0.5, plan=0.25, dispatch=0.125)
    made = simulate([10.0, 20.0, 30.0], costs, Workers(1))
    assert made.wall == pytest.approx(3 * 0.25 + 5 + (1.5 + 2.5 + 3.5) + 3 * 0.125)
    assert made.used == pytest.approx(7.5) and made.driver == pytest.approx(3 * 0.375) and made.again == 0


def test_equal_recordings_fill_whole_rounds() -> None:
    costs = Costs(start=4.0, per_second=0.05, per_file=0.0)
    assert simulate([10.0] * 640, costs, Workers(64)).wall == pytest.approx(4 + 10 * 0.5)
    assert simulate([10.0] * 641, costs, Workers(64)).wall == pytest.approx(4 + 11 * 0.5)
    assert simulate([10.0] * 3, costs, Workers(64)).wall == pytest.approx(4.5)


def test_longest_first_is_grahams_example() -> None:
    """3, 3, 2, 2, 2 on two workers: 7, where the best order has 6 (Graham 1969)."""
    assert simulate([2, 3, 2, 3, 2], SECOND, Workers(2)).wall == 7
    assert model.least([2, 3, 2, 3, 2], SECOND, 2) == 6


@given(st.lists(st.floats(0.1, 100), min_size=1, max_size=40), st.integers(1, 8))
def test_longest_first_is_within_the_proven_bounds(seconds: list[float], count: int) -> None:
    """No sharing out beats the mean load or the longest; any greedy one is at most the mean load plus the longest."""
    wall = simulate(seconds, SECOND, Workers(count)).wall
    assert model.least(seconds, SECOND, count) <= wall + 1e-9
    assert wall <= sum(seconds) / count + max(seconds) * (1 - 1 / count) + 1e-9


def test_a_driver_that_is_slower_than_its_workers_sets_the_pace() -> None:
    costs = Costs(start=0.0, per_second=0.1, per_file=0.0, dispatch=0.05)
    made = simulate([10.0] * 1000, costs, Workers(64))  # workers want one every 1/64 s, and the driver takes 0.05
    assert made.wall == pytest.approx(1.0 + 1000 * 0.05)
    assert simulate([10.0] * 1000, costs, Workers(128)).wall == pytest.approx(made.wall)


def test_a_slow_worker_does_its_share() -> None:
    """Eleven in ten seconds, one of them by a worker that is ten times slower."""
    made = simulate([1.0] * 99, SECOND, Workers(2, speeds={0: 0.1}))
    assert made.wall == pytest.approx(90.0) and made.efficiency(2) == pytest.approx(0.55)


def test_a_lost_worker_costs_what_it_was_doing_and_a_start() -> None:
    costs = Costs(start=4.0, per_second=1.0, per_file=0.0)
    made = simulate([10.0, 10.0], costs, Workers(1, lost={0: 19.0}))
    assert made.again == 1
    assert made.wall == pytest.approx(4 + 10 + 5 + 4 + 10)  # died at 19 s, 5 s into the second
    assert simulate([10.0, 10.0], costs, Workers(1, lost={0: 1.0})).wall == pytest.approx(1 + 4 + 20)
    assert simulate([10.0], costs, Workers(1, lost={0: 99.0})).again == 0


def test_a_line_is_found_again_and_is_never_below_nothing() -> None:
    seconds = np.array([3.0, 10.0, 30.0, 60.0])
    assert model.line(seconds, 0.02 + 0.057 * seconds) == pytest.approx((0.02, 0.057))
    offset, slope = model.line(seconds, 0.057 * seconds - 0.05)
    assert offset == 0 and 0.03 < slope < 0.057


def test_the_command_prints_what_the_model_says(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
                                                tmp_path: Path) -> None:
    (tmp_path / "costs.json").write_text('{"costs": {"start": 4, "per_second": 0.06, "per_file": 0, "plan": 0, '
                                         '"dispatch": 0}}')
    monkeypatch.setattr(sys, "argv", ["cluster_model.py", "simulate", "--costs", str(tmp_path / "costs.json"),
                                      "--cores", "64", "--files", "64000", "--dispatch", "0.0001"])
    model.main()
    assert "| 64 cores | 10.1 |" in capsys.readouterr().out  # 4 + 1000 * 0.6 + what waits for the driver


def test_what_the_goal_allows_meets_it_just() -> None:
    costs = Costs(start=4.0, per_second=0.06, per_file=0.01, plan=0.0005, dispatch=0.0)
    just = model.allowed(costs)
    goal = [model.GOAL_SECONDS] * model.GOAL_FILES
    made = simulate(goal, model.replace(costs, per_second=just), Workers(model.CLUSTER))
    assert made.wall == pytest.approx(60 * model.GOAL_MINUTES, rel=1e-6)


def test_a_gigabit_link_is_filled_by_as_many_cores_as_write_so_much() -> None:
    """20 hours of sound an hour and core, 360 MB each: 2 MB/s of 117."""
    assert model.link_cores(Costs(0.0, 0.05, 0.0), 360e6) == pytest.approx(58.5)


def test_the_stored_table_is_that_of_the_stored_figures() -> None:
    results = Path(__file__).parents[1] / "docs" / "results"
    assert (results / "cluster.md").read_text() == model.table(json.loads((results / "cluster.json").read_text()))
