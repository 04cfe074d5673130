"""Pitch of speech: known answers, another library, and what it must not depend on."""

import librosa
import numpy as np
import pytest
from performances import example

from data_module.speech.silence import PITCH_HOP, PITCH_WINDOW, PitchLevel, pitch_of
from data_module.types import Samples
from gesticulator.sampling.candidates import with_pitch

RATE = 16000
EXAMPLE_VOICE = example().samples


def voice(frequency: float, seconds: float = 0.5) -> Samples:
    """Pulses through a vowel's first formant."""
    pulses = np.zeros(round(seconds * RATE))
    pulses[np.round(np.arange(0, seconds - 1e-3, 1 / frequency) * RATE).astype(int)] = 1.0
    ringing = np.exp(-np.arange(200) / 40.0) * np.sin(2 * np.pi * 600.0 * np.arange(200) / RATE)
    return (0.3 * np.convolve(pulses, ringing)[:len(pulses)]).astype(np.float32)


@pytest.mark.parametrize("frequency", [80.0, 110.0, 200.0, 330.0, 450.0])
def test_the_pitch_of_pulses_is_their_rate(frequency: float) -> None:
    logs, voiced = pitch_of(voice(frequency), RATE)
    assert voiced[3:-3].all()
    np.testing.assert_allclose(2.0 ** logs[3:-3], frequency, rtol=0.01)


def test_noise_and_silence_have_none() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.1, 2 * RATE).astype(np.float32)
    assert pitch_of(noise, RATE)[1].mean() < 0.05
    assert not pitch_of(np.zeros(RATE, np.float32), RATE)[1].any()
    assert len(pitch_of(voice(100.0, 0.03), RATE)[0]) == 0, "shorter than a frame"


def test_it_is_the_pitch_that_librosa_finds() -> None:
    samples = EXAMPLE_VOICE[:10 * RATE]
    logs, voiced = pitch_of(samples, RATE)
    theirs, said, _ = librosa.pyin(samples, fmin=70, fmax=500, sr=RATE, hop_length=round(PITCH_HOP * RATE),
                                   frame_length=round(PITCH_WINDOW * RATE), center=False)
    count = min(len(logs), len(theirs))
    both = voiced[:count] & said[:count]
    assert both.mean() > 0.8 * said.mean()
    apart = np.abs(logs[:count] - np.log2(np.where(both, theirs[:count], 1.0)))[both]
    assert np.median(apart) < 0.01
    assert (apart > 0.5).mean() < 0.02, "octave errors"


def test_neither_level_nor_faint_noise_change_it() -> None:
    samples = EXAMPLE_VOICE[:5 * RATE]
    logs, voiced = pitch_of(samples, RATE)
    np.testing.assert_allclose(pitch_of(0.5 * samples, RATE)[0][voiced], logs[voiced], atol=1e-9)
    noise = np.random.default_rng(2).normal(0.0, 0.001, len(samples)).astype(np.float32)
    again, still = pitch_of(samples + noise, RATE)
    both = voiced & still
    assert both.sum() > 0.95 * voiced.sum()
    assert np.median(np.abs(again - logs)[both]) < 0.002


def test_a_block_is_measured_from_the_mean_of_the_voice_so_far() -> None:
    level = PitchLevel()
    np.testing.assert_allclose(level.block(voice(100.0), RATE, 4), 0.0, atol=0.01)
    # As long as the first: the mean is now half an octave higher.
    np.testing.assert_allclose(level.block(voice(200.0), RATE, 4), 0.5, atol=0.02)
    assert not level.block(np.zeros(RATE // 2, np.float32), RATE, 4).any()
    np.testing.assert_allclose(level.block(voice(200.0), RATE, 4), 1 / 3, atol=0.02)


def test_where_the_voice_is_high_the_trunk_that_turns_counts() -> None:
    times = np.arange(-3, 11) * 0.05
    trunk = np.zeros((3, len(times), 6))
    early = np.minimum(np.maximum(times, 0.0), 0.25)
    trunk[0, :, 0] = trunk[0, :, 3] = 0.5 * early  # 1 rad/s of two joints together, while the voice is high
    trunk[1, :, 1] = np.maximum(times - 0.25, 0.0)  # 1 rad/s while it is low
    pitch = np.repeat([0.5, -0.5], 5)
    high, low, still = with_pitch(trunk, times, pitch)
    assert high > still > low
    # Over the mean of the three, a third of 1 rad/s: ((2/3) .5 + (1/3) .5) / .25 in one half of the frames each.
    np.testing.assert_allclose([high, low, still], [1.0, -1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(with_pitch(trunk, times, 0 * pitch), 0.0)
