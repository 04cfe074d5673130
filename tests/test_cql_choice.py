"""How `--interpreter cql` chooses: sampled by default, arg max at temperature 0, with one warning."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from benchmark_files import benchmark

from eval.acceptance.bounds import Bound
from eval.renderings import spread_evenly
from gesticulator.bundle import bundle as bundles
from gesticulator.options import InferenceOptions
from gesticulator.pipeline import Gesticulator, InterpreterWarning
from gesticulator.training.presets import preset

cql = benchmark("cql")


@pytest.fixture(scope="module")
def shipped() -> bundles.Bundle:
    return bundles.load(bundles.SHIPPED)


def temperature(system: Gesticulator, **asked: object) -> float:
    options = InferenceOptions.of(dict(asked))  # type: ignore[arg-type]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InterpreterWarning)
        return system.cast(options, text=False).temperature


def test_the_shipped_q_network_is_sampled_and_temperature_0_is_arg_max(shipped: bundles.Bundle) -> None:
    system = Gesticulator(shipped)
    by_default = temperature(system, interpreter="cql")
    assert by_default == shipped.config.selection.q_temperature == preset("default").selection.q_temperature > 0
    assert temperature(system, interpreter="cql", temperature=0.0) == 0.0
    assert temperature(system, interpreter="lstm") == shipped.config.selection.temperature


def test_the_published_presets_keep_the_greedy_choice() -> None:
    for name in ("racer-trinity", "racer-chinese", "paper-trinity"):
        assert preset(name).selection.q_temperature == 0


def test_a_policy_that_is_no_better_is_remarked_upon_once(shipped: bundles.Bundle) -> None:
    system = Gesticulator(shipped)
    options = InferenceOptions.of({"interpreter": "cql"})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for name in ("lstm", "statistical", "advantage"):
            system.cast(InferenceOptions.of({"interpreter": name}), text=False)
        assert not caught
        for _ in range(3):
            system.cast(options, text=False)
    assert [type(one.message) for one in caught] == [InterpreterWarning]
    assert "lstm" in str(caught[0].message) and "\n" not in str(caught[0].message)


def test_streams_of_one_gesticulator_remark_once(shipped: bundles.Bundle) -> None:
    system = Gesticulator(shipped)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(2):
            system.stream(16000, interpreter="cql")
    assert [one for one in caught if issubclass(one.category, InterpreterWarning)] == caught[:1]


# The table


def played(*sequences: list[int], silent: list[bool] | None = None) -> object:
    own = cql.Played()
    for sequence in sequences:
        own.add(np.array(sequence), np.array(silent or [False] * len(sequence)), {"eye_seam": 1.0})
    return own


def test_shares_entropy_and_runs_are_of_voiced_blocks() -> None:
    row = cql.cells(played([0, 0, 0, 1], [2, 3, 4, 5]), 6, None)
    assert (row["commonest"].mean, row["most"], row["used"].mean) == (50.0, 75.0, 3.0)
    assert row["pooled"] == pytest.approx(100 * 3 / 8)
    assert row["nats"].mean == pytest.approx((0.5623351446 + np.log(4)) / 2)
    assert row["run"].mean == 2.0 and "frechet" not in row
    quiet = cql.cells(played([0, 0, 0, 1], silent=[True, True, False, False]), 6, None)
    assert quiet["commonest"].mean == 50.0, "blocks without voice do not count"


def test_twice_the_margin() -> None:
    assert cql.doubled(Bound(4.0, 8.0)) == Bound(2.0, 10.0)
    assert cql.doubled(Bound(high=3.0)).high == 6.0


def test_recordings_are_spread_over_the_split() -> None:
    assert spread_evenly(list(range(11)), 3) == [0, 5, 10] and spread_evenly([1, 2], 5) == [1, 2]
