"""Entropy, motion variance and the order of lexemes: hand cases, scipy, and what the chapter says fools them."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.distance import cdist
from scipy.stats import entropy

from eval.metrics.diversity import diversity, longest_run, motion_variance

LABELS = st.lists(st.integers(0, 7), min_size=1, max_size=60)


def test_the_entropy_of_one_lexeme_is_zero_and_of_none_undefined() -> None:
    assert str(diversity([3] * 9, 4)) == "0.0"
    assert math.isnan(diversity([], 4)) and diversity([0, 0], 1) == 0


@given(labels=LABELS)
def test_entropy_agrees_with_scipy_whatever_the_lexemes_are_called(labels: list[int]) -> None:
    got = diversity(labels, 8)
    counts = list(Counter(labels).values())
    assert got == pytest.approx(float(entropy(counts)), abs=1e-12)
    assert got == pytest.approx(diversity([7 - label for label in labels], 8))
    assert 0 <= got <= math.log(8) + 1e-12


def test_few_blocks_make_it_too_small_by_about_what_the_chapter_says() -> None:
    rng = np.random.default_rng(0)
    lost = [math.log(20) - diversity(rng.integers(0, 20, 200), 20) for _ in range(300)]
    assert np.mean(lost) == pytest.approx(19 / 400, rel=0.1)


@pytest.mark.parametrize("labels", [[0, 4], [-1, 0], [0.5, 1.0], [[0, 1]]])
def test_labels_outside_the_lexicon_are_refused(labels: list[object]) -> None:
    with pytest.raises(ValueError):
        diversity(labels, 4)  # type: ignore[arg-type]


def test_motion_variance_undefined_and_refused() -> None:
    assert math.isnan(motion_variance(np.zeros((2, 3)), [0, 1], np.ones((4, 3))))
    assert math.isnan(motion_variance(np.zeros((0, 3)), [], np.ones((4, 3))))
    for latents, labels, vectors in [(np.zeros((2, 3)), [0], np.ones((4, 3))), (np.zeros((2, 3)), [0, 4],
                                                                              np.ones((4, 3))),
                                     (np.zeros((2, 3)), [0, 1], np.ones((4, 2))),
                                     (np.full((2, 3), np.nan), [0, 1], np.ones((4, 3)))]:
        with pytest.raises(ValueError):
            motion_variance(latents, labels, vectors)


@given(labels=LABELS)
def test_runs_agree_with_plain_loops(labels: list[int]) -> None:
    longest = run = 1
    for before, now in zip(labels, labels[1:], strict=False):
        run = run + 1 if now == before else 1
        longest = max(longest, run)
    assert longest_run([labels]) == longest


def test_the_longest_run_stays_within_a_recording() -> None:
    assert longest_run([[1, 1], [1, 1, 1], [2]]) == 3
    assert longest_run([[0, 1, 0]]) == 1 and longest_run([[0, 0, 0, 3, 3, 3, 3, 1, 1, 0]]) == 4
    assert math.isnan(longest_run([])) and math.isnan(longest_run([[]]))


@given(labels=LABELS, seed=st.integers(0, 99))
def test_motion_variance_is_scipys_by_label(labels: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    latents, vectors, own = rng.normal(size=(len(labels), 3)), rng.normal(size=(8, 3)), np.array(labels)
    distances = cdist(latents, vectors)[np.arange(len(own)), own]
    often = [lexeme for lexeme, count in Counter(labels).items() if count > 1]
    got = motion_variance(latents, labels, vectors)
    assert math.isnan(got) == (not often)
    if often:
        counts = np.array([labels.count(lexeme) for lexeme in often])
        with np.errstate(invalid="ignore"):  # of the labels between, which do not occur
            each = np.asarray(ndimage.variance(distances, own, often)) * counts / (counts - 1)
        assert got == pytest.approx(each.mean(), abs=1e-12)
