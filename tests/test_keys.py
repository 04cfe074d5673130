"""Keyed random numbers: their distributions, their independence, and that nothing but the keys matters."""

import numpy as np
import pytest
from scipy import special, stats

from gesticulator.sampling.loop import Keys, _log_normal
from interpreters.base import select

LEXEMES = 60


def test_the_normal_distribution_function_is_scipys_far_into_both_tails() -> None:
    numbers = np.concatenate([np.linspace(-9, 9, 2001), [0.0]])
    np.testing.assert_allclose(_log_normal(numbers), special.log_ndtr(numbers), rtol=1e-13)


def gumbel(keys: Keys, times: np.ndarray) -> np.ndarray:
    """[T, S] Gumbel noise at times [T]."""
    return np.stack([keys.gumbel(float(time), LEXEMES) for time in times])


@pytest.mark.parametrize("within", [0.0, 0.03, 0.05])
def test_the_noise_of_choices_is_gumbel_and_that_of_motion_normal(within: float) -> None:
    times = 0.2 * np.arange(200) + within
    assert stats.kstest(gumbel(Keys(5), times).ravel(), stats.gumbel_r.cdf).pvalue > 0.01
    motion = np.concatenate([Keys(5).noise(float(time), (5, 12)).ravel() for time in times])
    assert stats.kstest(motion, stats.norm.cdf).pvalue > 0.01


def test_noise_of_other_keys_blocks_and_kinds_is_independent() -> None:
    times = 0.2 * np.arange(150) + 0.05
    first = gumbel(Keys(1), times)
    motion = np.stack([Keys(1).noise(float(time), (1, LEXEMES))[0] for time in times])
    plan = np.stack([Keys(1).plan(float(time), LEXEMES) for time in times])
    for other in (plan, gumbel(Keys(2), times), gumbel(Keys(1, 1), times), np.roll(first, 1, axis=0),
                  np.roll(first, 1, axis=1), motion):
        rank = stats.spearmanr(first.ravel(), other.ravel())
        assert abs(rank.statistic) < 4.0 / np.sqrt(first.size), "four standard errors"


def test_equal_keys_give_equal_noise_in_any_order_of_calls() -> None:
    times = np.random.default_rng(0).uniform(0, 4000, 50)
    forward = gumbel(Keys(3, 2), times)
    assert np.array_equal(forward[::-1], gumbel(Keys(3, 2), times[::-1]))
    assert np.array_equal(Keys(3).noise(7.0, (4, 5)), Keys(3).noise(7.0, (4, 5)))


def test_noise_changes_gradually_with_time() -> None:
    near, far = (np.corrcoef(np.concatenate([np.stack([Keys(0).noise(0.37 * n, (1, 50))[0],
                                                       Keys(0).noise(0.37 * n + later, (1, 50))[0]], axis=1)
                                             for n in range(100)]).T)[0, 1] for later in (0.01, 0.2))
    assert near > 0.97 and abs(far) < 0.06


def test_a_choice_with_keyed_noise_has_the_probabilities_of_the_scores() -> None:
    scores, temperature = np.log(np.array([0.5, 0.3, 0.15, 0.05])), 1.3
    chosen = [select(scores, temperature=temperature, noise=Keys(9).gumbel(0.2 * n, 4)) for n in range(4000)]
    expected = np.exp(scores / temperature) / np.exp(scores / temperature).sum()
    assert stats.chisquare(np.bincount(chosen, minlength=4), 4000 * expected).pvalue > 0.01


def test_a_small_change_of_scores_rarely_changes_the_choice() -> None:
    """As often as the total variation of the two distributions says, up to a factor of two (Gumbel coupling)."""
    rng = np.random.default_rng(0)
    changed, apart = 0, 0.0
    for n in range(2000):
        one = rng.normal(size=LEXEMES)
        two = one + 0.05 * rng.normal(size=LEXEMES)
        noise = Keys(4).gumbel(0.2 * n, LEXEMES)
        changed += select(one, temperature=1.0, noise=noise) != select(two, temperature=1.0, noise=noise)
        p, q = (np.exp(scores) / np.exp(scores).sum() for scores in (one, two))
        apart += 0.5 * np.abs(p - q).sum()
    assert 0.7 * apart < changed < 2.2 * apart


def test_activity_is_standard_normal_waxes_over_seconds_and_is_keyed() -> None:
    far = np.array([Keys(seed).activity(6.0 * n) for seed in range(8) for n in range(100)])
    assert stats.kstest(far, stats.norm.cdf).pvalue > 0.01
    path = np.array([Keys(3).activity(0.1 * n) for n in range(3000)])
    near, second, later = (np.corrcoef(path[:-n], path[n:])[0, 1] for n in (3, 30, 60))
    assert near > 0.95 and second < 0.6 and abs(later) < 0.3
    assert Keys(3).activity(1.25) == Keys(3).activity(1.25) != Keys(3, 1).activity(1.25)


def test_another_voice_has_other_numbers() -> None:
    for numbers in (lambda keys, time: keys.posture(20.0 * time)[0], lambda keys, time: keys.noise(time, (1, 3))[0, 1]):
        first, other = (np.array([numbers(Keys(2, 0, voice), 0.2 * n) for n in range(1500)]) for voice in (7, 8))
        assert abs(np.corrcoef(first, other)[0, 1]) < 0.1
