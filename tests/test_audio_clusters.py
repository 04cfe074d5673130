"""Clusters of sound beside lexemes (RG Fig. 14): entropies by their definition, real ties and none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.metrics import audio_clusters


@given(st.integers(0, 99), st.integers(1, 6), st.integers(1, 6))
def test_conditional_entropy_is_the_joint_less_the_marginal(seed: int, rows: int, columns: int) -> None:
    table = np.random.default_rng(seed).integers(0, 4, (rows, columns))
    table[0, 0] += 1
    clusters, lexemes = (np.repeat(own.ravel(), table.ravel()) for own in np.indices(table.shape))
    joint, marginal = (-(p[p > 0] * np.log(p[p > 0])).sum() for p in (table / table.sum(), table.sum(1) / table.sum()))
    assert audio_clusters.conditional_entropy(clusters, lexemes) == pytest.approx(joint - marginal, abs=1e-9)


def test_association_finds_the_tie_and_no_other() -> None:
    rng = np.random.default_rng(0)
    lexemes = rng.integers(0, 6, 1200)
    tied = np.where(rng.random(1200) < 0.7, lexemes, rng.integers(0, 6, 1200))
    loose = rng.integers(0, 6, 1200)
    found = audio_clusters.association({"loose": loose, "tied": tied, "same": lexemes}, np.split(lexemes, 8), turns=40)
    assert found["same"]["entropy"] == pytest.approx(0)
    assert found["same"]["by_chance"] == pytest.approx(np.log(6), abs=0.05)
    gain = {name: level["by_chance"] - level["entropy"] for name, level in found.items()}
    assert abs(gain["loose"]) < 0.02 and found["loose"]["p"] > 0.05
    assert gain["tied"] > 0.4 and found["tied"]["p"] == pytest.approx(1 / 41)
    assert found["tied"]["alone"] == pytest.approx(np.log(6), abs=0.01)
    # Who performs is no tie: lexemes and clusters that only differ between recordings gain nothing.
    own = [np.full(150, number % 3) for number in range(8)]
    who = audio_clusters.association({"who": np.repeat(np.arange(8), 150)}, own, turns=20)["who"]
    assert who["entropy"] == pytest.approx(0) and who["by_chance"] == pytest.approx(0) and who["p"] == 1


@pytest.mark.parametrize("count", [30, 25, 1])
def test_turning_keeps_the_lexemes_in_their_order(count: int) -> None:
    out = audio_clusters.turned(np.arange(count), np.random.default_rng(3))
    shift = int(np.flatnonzero(out == 0)[0])
    assert np.array_equal(np.roll(np.arange(count), shift), out) and (count == 1 or 10 <= shift <= count - 10)


def test_clusters_are_those_that_were_put_in() -> None:
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 5, 300)
    points = (10 * rng.standard_normal((5, 7))[truth] + 0.1 * rng.standard_normal((300, 7))).astype(np.float32)
    found = audio_clusters.cluster(points, 5)
    assert len(set(zip(found.tolist(), truth.tolist(), strict=True))) == 5
    assert audio_clusters.cluster(points[:3], 50).max() == 2
