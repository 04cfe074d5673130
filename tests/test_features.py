"""Features: known levels of known sounds, and nothing that depends on the company a window is in."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.speech.front_ends import MelFrontEnd
from data_module.speech.learned_front_ends import FRONT_ENDS, front_end
from data_module.speech.silence import TYPICAL_LEVEL, reference_level
from data_module.speech.speech_encoder import SpeechEncoder, runner_of
from data_module.types import Array, Samples
from gesticulator.bundle.features import Normaliser

RATE = 16000
MEL = MelFrontEnd()


def noise(count: int, rms: float, seed: int = 0) -> Samples:
    return (rms * np.random.default_rng(seed).standard_normal((count, 24000))).astype(np.float32)


@given(st.integers(0, 99), st.floats(0.01, 50), st.floats(-100, 100))
def test_a_normaliser_gives_zero_mean_unit_spread(seed: int, scale: float, shift: float) -> None:
    values = np.random.default_rng(seed).standard_normal((40, 5, 3)) * scale + shift
    values[..., 1] = shift
    normaliser = Normaliser.fit(values)
    out = normaliser.apply(values)
    assert np.allclose(out.mean(axis=(0, 1)), 0, atol=1e-6)
    assert np.allclose(out.std(axis=(0, 1)), [1, 0, 1], atol=1e-6)


@pytest.mark.parametrize("rms", [0.3, 0.01, 0.001])
def test_white_noise_has_its_power_in_every_band(rms: float) -> None:
    low = MEL.encode(noise(4, rms)).low
    assert np.allclose(low[:, :, -1].mean(), 2 * np.log(rms), atol=0.02)
    # the mean of a logarithm lies below the logarithm of the mean, most in the narrow bands
    bands = low[:, 2:-2, :-2].mean(axis=(0, 1)) - 2 * np.log(rms)
    assert (bands < 0.0).all()
    assert (bands > -0.65).all()
    assert (bands[16:] > -0.3).all()


@pytest.mark.parametrize("hertz", [150.0, 700.0, 3000.0])
def test_a_tone_is_loudest_in_the_band_at_its_frequency(hertz: float) -> None:
    time = np.arange(24000) / RATE
    low = MEL.encode(np.sin(2 * np.pi * hertz * time).astype(np.float32)[None]).low[0]
    # mel as Slaney's toolbox has it: linear to 1 kHz, then logarithmic; 34 corners from 0 to 8 kHz
    mel = hertz * 3 / 200 if hertz < 1000 else 15 + 27 * np.log(hertz / 1000) / np.log(6.4)
    top = 15 + 27 * np.log(8) / np.log(6.4)
    assert abs(np.argmax(low[15, :32]) + 1 - mel / top * 33) < 1
    assert np.allclose(low[2:-2, 33], np.log(0.5), atol=0.02)


def test_silence_is_the_floor_and_a_click_is_an_onset_in_its_own_frame() -> None:
    windows = np.zeros((30, 24000), np.float32)
    for frame in range(30):
        windows[frame, frame * 800 + 400] = 0.5
    low = MEL.encode(windows).low
    assert np.allclose(MEL.encode(np.zeros((1, 24000), np.float32)).low[0, :, [0, 20, 33]], np.log(1e-8))
    for frame in range(30):
        assert np.argmax(low[frame, :, 33]) == frame
        if frame:
            assert np.argmax(low[frame, :, 32]) == frame
        if 1 <= frame <= 28:  # a frame's spectra lie evenly about its middle
            assert np.allclose(low[frame, frame - 1, :32], low[frame, frame + 1, :32], atol=0.01)


def hum(count: int) -> Samples:
    """A tone of 200 Hz with overtones up to 6.8 kHz that comes and goes five times a second, at the typical level."""
    time = np.arange(24000 * count) / RATE
    tones = sum(np.sin(2 * np.pi * 200 * k * time) / k for k in range(1, 35))
    gated = tones * np.clip(np.sin(2 * np.pi * 2.5 * time), 0.0, None) ** 2
    level = 10 ** (TYPICAL_LEVEL / 20)
    return (level * gated / np.sqrt(np.mean(gated ** 2))).reshape(count, -1).astype(np.float32)


def apart(front: MelFrontEnd, one: Samples, other: Samples) -> float:
    """Root mean square difference of the features in their own deviations."""
    low, again = (front.encode(windows, np.full(len(windows), TYPICAL_LEVEL)).low for windows in (one, other))
    moves = low.std((0, 1)) > 1e-3
    return float(np.sqrt(np.mean(((low - again)[..., moves] / low.std((0, 1))[moves]) ** 2)))


def test_robust_features_hear_the_voice_and_neither_hiss_nor_faint_noise() -> None:
    robust, sound = MelFrontEnd(robust=True), hum(3)
    time = np.arange(sound.size).reshape(sound.shape) / RATE
    hissing = sound + (0.003 * np.sin(2 * np.pi * 7600 * time)).astype(np.float32)
    assert apart(MEL, sound, hissing) > 0.2 and apart(robust, sound, hissing) < 0.03
    noisy = sound + noise(3, 0.001)
    assert apart(MEL, sound, noisy) > 0.4 and apart(robust, sound, noisy) < 0.1
    assert apart(robust, sound, np.roll(sound, RATE // 10, axis=1)) > 0.5, "but it hears the voice come and go"


def stack() -> SpeechEncoder:
    torch.manual_seed(0)
    return SpeechEncoder(8)


def speech_like(count: int) -> Samples:
    """Windows in which loudness and colour change from frame to frame."""
    rng = np.random.default_rng(4)
    sound = noise(count, 0.1).reshape(count, 30, 800)
    sound[:, ::2] = np.diff(sound[:, ::2], prepend=0, axis=-1)
    return (sound * rng.uniform(0.05, 1, (count, 30, 1))).reshape(count, -1).astype(np.float32)


@pytest.mark.parametrize("kind", FRONT_ENDS)
def test_every_front_end_keeps_the_contract(kind: str) -> None:
    front, windows = front_end(kind, MEL, encoder=runner_of(stack())), speech_like(7)
    assert front.name == kind
    reference = np.linspace(-40, -20, 7)
    whole = front.encode(windows, reference)
    for level in (whole.low, whole.high):
        assert level.shape == (7, 30, front.width)
        assert level.dtype == np.float32
        assert np.isfinite(level).all()
        # the rows of a window differ, and so do windows
        assert (level.std(axis=1) > 1e-4).any(axis=-1).all()
        assert not np.allclose(level[0], level[1], atol=1e-3)
    for at in range(7):  # alone as in company
        alone = front.encode(windows[at:at + 1], reference[at:at + 1])
        assert np.allclose(alone.low[0], whole.low[at], atol=1e-5)
        assert np.allclose(alone.high[0], whole.high[at], atol=1e-5)
    turned = front.encode(windows[::-1], reference[::-1])
    assert np.allclose(turned.low[::-1], whole.low, atol=1e-5)
    assert np.allclose(turned.high[::-1], whole.high, atol=1e-5)
    silence = front.encode(np.zeros((1, 24000), np.float32))
    assert np.isfinite(silence.low).all() and np.isfinite(silence.high).all()
    assert front.encode(windows[:0]).low.shape == (0, 30, front.width)
    with pytest.raises(ValueError):
        front.encode(windows[:, :-1])


def test_a_front_end_that_is_not_to_be_had_is_refused_by_name() -> None:
    for name, message in (("mfcc", "no 'mfcc'; choose from mel, vqwav2vec"),
                          ("vqwav2vec", "needs a trained speech encoder")):
        with pytest.raises(InputError, match=message):
            front_end(name, MEL)
    for layers in ((0, 8), (2, 9), (2,), (1, 2, 3)):
        with pytest.raises(InputError, match="two numbers from 1 to 8"):
            front_end("vqwav2vec", MEL, encoder=runner_of(stack()), layers=layers)


def voice(gains: Array, block: float = 0.4) -> Samples:
    """Blocks of buzz, each with its gain in dB, a sixth of each block quiet."""
    time = np.arange(round(block * RATE)) / RATE
    buzz = np.sum([np.sin(2 * np.pi * 125 * h * time) / h for h in range(1, 12)], axis=0)
    buzz = buzz / np.sqrt(np.mean(buzz ** 2)) * (time < block * 5 / 6) * 10 ** (TYPICAL_LEVEL / 20)
    return np.concatenate([buzz * 10 ** (gain / 20) for gain in gains]).astype(np.float32)


def test_the_reference_finds_the_gain_and_leaves_the_effort() -> None:
    edges = np.arange(301) * 0.4
    flat = reference_level(voice(np.zeros(300)), RATE, edges)
    # It is expected 6 dB under the loudest until the voice is known; a buzz is as loud as its loudest.
    assert np.abs(flat - TYPICAL_LEVEL).max() < 6.5 and np.abs(flat[60:] - TYPICAL_LEVEL).max() < 1.0
    quiet = reference_level(voice(np.full(300, -15.0)), RATE, edges)
    np.testing.assert_allclose(quiet, flat - 15.0, atol=1e-4)
    effort = np.repeat(np.tile([9.0, -9.0], 15), 10)  # phrases of 4 s, 18 dB apart
    level = reference_level(voice(effort), RATE, edges)
    assert np.ptp(level[150:]) < 4
    assert np.abs(np.diff(level)).max() < 1


def test_the_reference_knows_only_the_past_and_waits_in_silence() -> None:
    gains = np.random.default_rng(0).uniform(-9, 9, 60)
    edges = np.arange(61) * 0.4
    whole = reference_level(voice(gains), RATE, edges)
    part = reference_level(voice(gains[:30]), RATE, edges[:31])
    assert np.allclose(part[:28], whole[:28])
    pause = np.concatenate([voice(gains), np.zeros(20 * RATE, np.float32)])
    after = reference_level(pause, RATE, np.arange(110) * 0.4)
    assert np.allclose(after[61:], after[61])
