"""Fresh starts of preparations: their poses, and the offset that joins them to what was shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from data_module.speech.audio import load_speech
from eval.metrics.eye import arms, common_body
from gesticulator.gesticulator import Gesticulator
from gesticulator.sampling.loop import Keys
from gesticulator.systems.movement import FADES, Offset, first_pose

NAMES = ["Spine", "LeftArm", "RightArm"]
REST = np.concatenate([np.full(3, 9.0), np.full(3, 2.0), np.full(3, -4.0)])


@given(st.floats(0.0, 100.0), st.floats(-2.0, 2.0), st.floats(-5.0, 5.0))
def test_an_offset_begins_with_the_pose_and_velocity_shown_and_ends_at_rest(begin: float, pose: float, speed: float
                                                                            ) -> None:
    offset = Offset(begin, np.array([pose]), np.array([speed]))
    step = 1e-3
    start = offset.at(begin + step * np.arange(4.0))[:, 0]
    end = offset.at(begin + FADES - step * np.arange(4.0))[:, 0]
    assert start[0] == pytest.approx(pose, abs=1e-9) and end[0] == pytest.approx(0.0, abs=1e-9)
    assert (start[1] - start[0]) / step == pytest.approx(speed, abs=0.02)
    assert (end[1] - end[0]) / step == pytest.approx(0.0, abs=0.01)
    for path in (start, end):
        assert np.diff(path, 2)[0] / step ** 2 == pytest.approx(0.0, abs=0.6 * (abs(pose) + abs(speed)) + 1e-3)
    assert (offset.at(begin + FADES + np.array([1e-6, 1.0, 50.0])) == 0).all()


def test_first_poses_lie_between_the_speakers_pose_and_rest_each_arm_for_itself() -> None:
    keys = Keys(1)
    poses = np.stack([first_pose(keys.uniform(0.2 * n, 2), keys.posture(0.2 * n), NAMES, REST) for n in range(2000)])
    shares = poses[:, [3, 6]] / REST[[3, 6]]
    assert shares.min() > -0.45 and shares.max() < 0.55
    assert stats.kstest(shares.ravel(), stats.uniform(-0.45, 1.0).cdf).pvalue > 0.01
    assert abs(stats.spearmanr(*shares.T).statistic) < 0.1


def test_the_trunk_wanders_over_seconds_by_the_seed() -> None:
    postures = np.stack([Keys(seed).posture(0.4 * n) for seed in range(4) for n in range(2000)])
    assert postures.std(0) == pytest.approx([1, 1, 1], abs=0.1), "standard normal"
    r = [np.corrcoef(postures[:-lag, 0], postures[lag:, 0])[0, 1] for lag in (1, 20)]
    assert r[0] > 0.95 and abs(r[1]) < 0.15, "near for a block, independent after eight seconds"
    assert first_pose(np.zeros(2), np.array([1.0, -2.0, 0.5]), NAMES, REST)[:3] == pytest.approx([0.8, -1.6, 0.4])


def test_a_voice_is_told_by_the_shape_of_its_spectrum_with_a_little_noise_and_at_any_level() -> None:
    rng = np.random.default_rng(0)
    spectra = rng.normal(size=(300, 40)) @ rng.normal(size=(40, 40)) / 6.0
    voices = np.array([Keys(3).of_voice(spectrum) for spectrum in spectra])
    assert voices.min() >= 1 and voices.max() <= 64 and len(set(voices.tolist())) > 50
    assert np.bincount(voices).max() < 30, "no pattern is nearest to most"
    noisy = spectra + 0.04 * spectra.std(axis=1, keepdims=True) * rng.normal(size=spectra.shape)
    assert np.mean([Keys(3, 0, 9).of_voice(spectrum - 6.0) for spectrum in noisy] == voices) > 0.85, "r = .999"
    assert Keys(3).of_voice(np.zeros(40)) >= 1, "digital silence"


def test_trunks_do_not_lean_alike_at_the_same_second_of_different_readings(system: Gesticulator, outside_data: Path
                                                                              ) -> None:
    readings = [file for file in sorted((outside_data / "voices" / "train_clean").glob("*.flac"))
                if file.stat().st_size > 180_000][:150:25]
    if not readings:
        pytest.skip("voices is not in GESTICULATOR_DATA")
    leans = [arms.leans(common_body(system(load_speech(file), seed=0).motion)) for file in readings]
    assert arms.alike(leans) < 0.25, "0.38 where postures are keyed by seed and time alone"
