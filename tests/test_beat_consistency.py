"""Beat consistency by hand and against mir_eval; and what fools it, so that nobody forgets."""

from __future__ import annotations

import warnings

import mir_eval
import numpy as np
import pytest
from bursts import turned
from hypothesis import given
from hypothesis import strategies as st

from data_module.types import Motion
from eval.metrics.beat_consistency import consistency, joint_beats, mean_score, motion_joint_beats, onset_score

TIMES = st.lists(st.floats(0.0, 20.0), min_size=1, max_size=30, unique=True).map(lambda v: np.sort(np.array(v)))


def test_by_hand() -> None:
    onsets = np.array([1.0, 2.0])
    assert onset_score(np.array([1.0, 2.0, 5.0]), onsets) == 1.0
    assert onset_score(np.array([1.3]), onsets, 0.3) == pytest.approx((np.exp(-0.5) + np.exp(-49 / 18)) / 2)
    assert onset_score(np.zeros(0), onsets) == 0.0
    assert np.isnan(onset_score(np.array([1.0]), np.zeros(0)))
    assert mean_score([onsets, np.zeros(0)], onsets) == 0.5
    assert np.isnan(mean_score([], onsets))


@given(TIMES, TIMES, st.sampled_from([0.05, 0.1, 0.3]))
def test_cemgil_of_mir_eval_but_for_its_divisor(beats: np.ndarray, onsets: np.ndarray, sigma: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = mir_eval.beat.cemgil(onsets, beats, cemgil_sigma=sigma)[0]
    assert onset_score(beats, onsets, sigma) * len(onsets) == pytest.approx(theirs * 0.5 * (len(beats) + len(onsets)))


def test_minima_of_a_known_speed() -> None:
    """|sin| at 30 fps is least once a half period; the first column rests there, the second does not."""
    time = (np.arange(300) + 0.5) / 30.0
    wave = np.abs(np.sin(np.pi * time / 0.9))
    still, moving = joint_beats(np.stack([0.0 * wave, wave + 0.5], axis=1))
    assert len(still) == 0
    np.testing.assert_allclose(moving, 0.9 * np.arange(1, 12), atol=0.5 / 30)
    assert len(joint_beats(wave[:, None])[0]) < 11, "some of the minima at 0 lie under a tenth of the mean: rests"


def waving(fps: float = 30.0, seconds: float = 20.0) -> Motion:
    """The arms turn back every 0.8 s, never quite still."""
    phase = 2 * np.pi * np.arange(round(fps * seconds)) / fps / 1.6
    swing = np.outer(np.sin(phase), [0, 0, 0.6]) + np.outer(np.cos(phase), [0, 0.15, 0])
    return turned(len(phase), fps, {"RightArm": swing, "LeftArm": swing})


def test_only_joints_that_move_count_at_any_frame_rate() -> None:
    for fps in (30.0, 60.0):
        beats = motion_joint_beats(waving(fps))
        assert len(beats) == 4, "two elbows and two wrists"
        assert all(abs(len(own) - 25) <= 1 for own in beats)
    assert motion_joint_beats(waving().crop(0, 1)) == []


def test_perfect_input_and_its_chance() -> None:
    beats = motion_joint_beats(waving())
    score, chance = consistency(beats, beats[0], 20.0, 0.1)
    assert score == pytest.approx(1.0, abs=0.01) and chance < 0.6
    assert (score, chance) == consistency(beats, beats[0], 20.0, 0.1)
    for joints, onsets in (([], np.array([1.0])), ([np.array([1.0])], np.zeros(0))):
        assert np.isnan(consistency(joints, onsets, 5.0)).all()


@given(st.lists(st.floats(0, 1, width=16), min_size=0, max_size=40), st.integers(1, 7))
def test_joint_beats_by_plain_loops(column: list[float], order: int) -> None:
    wanted = []
    for t, speed in enumerate(column):
        around = [column[min(max(t + step, 0), len(column) - 1)] for step in range(-order, order + 1) if step]
        if all(speed < other for other in around) and speed > 0.1 * sum(column) / len(column):
            wanted.append((t + 0.5) / 30)
    np.testing.assert_allclose(joint_beats(np.array(column)[:, None], 30.0, order)[0], wanted)


def test_nonsense_is_refused() -> None:
    onsets = np.array([1.0])
    for beats in (np.array([np.nan]), np.array([np.inf]), np.ones((1, 2))):
        for pair in ((beats, onsets), (onsets, beats)):
            with pytest.raises(ValueError):
                onset_score(*pair)
    for speeds, fps in ((np.ones(5), 30.0), (np.full((5, 1), np.nan), 30.0), (np.ones((5, 1)), 0.0)):
        with pytest.raises(ValueError):
            joint_beats(speeds, fps)
    for duration in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError):
            consistency([onsets], onsets, duration)
