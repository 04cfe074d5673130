"""Blocks: what is cut and stretched comes back, exactly on the beats."""

import itertools
import math

import numpy as np
import pytest
import pytsmod
from bursts import blocks_of, waving
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import correlate1d

from data_module import blocks as blocking
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.representation import ROTATIONS
from data_module.speech.beats import BeatSettings
from data_module.types import Array, Blocks, Samples, Speech

RATE = 16000
DURATIONS = st.lists(st.integers(4, 10), min_size=1, max_size=12).map(lambda ticks: np.array(ticks) * 0.05)


def lasting(durations: Array) -> Blocks:
    """Blocks that last so many seconds, one after the other."""
    return blocks_of(np.concatenate([[0.0], np.cumsum(durations)]), 10)


def buzz(seconds: float) -> Samples:
    time = np.arange(round(seconds * RATE)) / RATE
    return (0.1 * np.sum([np.sin(2 * np.pi * 130 * h * time) / h for h in range(1, 12)], axis=0)).astype(np.float32)


def rms(sound: Array, axis: int | None = None) -> Array:
    return np.sqrt(np.mean(np.square(sound.astype(np.float64)), axis=axis))


def test_a_block_has_room_for_the_longest_interval() -> None:
    assert blocking.BlockSettings().frames == 10
    assert blocking.BlockSettings(BeatSettings(0.3, 0.6)).frames == 12
    assert blocking.BlockSettings(fps=15.0).frames == 8
    assert blocking.BlockSettings(BeatSettings(0.2, 0.55)).frames == 11  # 0.55 x 20 is a little more than 11 in floats
    for fps in (0.0, -1.0, float("nan"), 1.0):
        with pytest.raises(InputError):
            blocking.BlockSettings(fps=fps)


def test_cut_tiles_the_recording() -> None:
    syllables = np.abs(np.sin(np.pi * np.arange(6 * RATE) / RATE / 0.25)).astype(np.float32)
    sound = np.concatenate([buzz(2.0), np.zeros(3 * RATE, np.float32), buzz(1.0)]) * syllables
    blocks = blocking.cut(Speech(sound, RATE))
    assert blocks.edges[0] == 0
    assert blocks.edges[-1] == 6.0
    assert (blocks.durations <= 0.5 + 1e-9).all()
    middle = (blocks.edges[:-1] > 2.1) & (blocks.edges[1:] < 4.9)
    assert middle.sum() >= 4
    assert blocks.silent[middle].all()
    assert not blocks.silent[blocks.edges[1:] < 1.9].any()


@pytest.mark.parametrize("hertz", [110.0, 220.0, 440.0, 1000.0])
def test_stretching_keeps_pitch_level_and_length(hertz: float) -> None:
    time = np.arange(3 * RATE) / RATE
    blocks = lasting(np.array([0.5, 0.2, 0.25, 0.3, 0.45, 0.4, 0.5, 0.4]))
    out = blocking.stretch_speech(Speech(np.sin(2 * np.pi * hertz * time).astype(np.float32), RATE), blocks)
    assert out.shape == (8, 8000)
    assert out.dtype == np.float32
    spectra = np.abs(np.fft.rfft(out * np.hanning(8000), 80000, axis=1))
    assert (np.abs(spectra.argmax(axis=1) * RATE / 80000 / hertz - 1) < 0.02).all()
    assert np.abs(rms(out[1:], 1) * np.sqrt(2) - 1).max() < 0.02


def test_a_block_of_full_length_is_untouched_and_zeros_stay_zeros() -> None:
    sound = np.concatenate([buzz(0.5), np.zeros(8000, np.float32), buzz(0.4)])
    sound[16000 + 1600:16000 + 3200] = 0.0
    out = blocking.stretch_speech(Speech(sound, RATE), lasting(np.array([0.5, 0.3, 0.2, 0.4])))
    assert np.array_equal(out[0], sound[:8000])
    assert not out[1:3].any()
    assert not out[3, 2000:4000].any()
    assert rms(out[3, :1900]) > 0.05
    assert np.isfinite(out).all()


def test_clicks_at_the_beats_stay_at_the_ends_of_their_blocks() -> None:
    """WSOLA may shift a frame by 8 ms, and repeats a click in frames 16 ms apart: that is the spread allowed here."""
    away = (np.arange(8000) - 4000) / RATE  # seconds from the seam of two blocks
    centres = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        blocks = lasting(rng.integers(4, 10, 12) * 0.05)
        sound = 1e-5 * rng.standard_normal(round(blocks.edges[-1] * RATE))
        for edge in blocks.edges[1:-1]:
            place = round(edge * RATE)
            sound[place - 32:place] += rng.standard_normal(32)
        power = blocking.stretch_speech(Speech(sound.astype(np.float32), RATE), blocks).astype(np.float64) ** 2
        for before, after in itertools.pairwise(power):
            seam = np.concatenate([before[4000:], after[:4000]])
            assert seam[np.abs(away) < 0.04].sum() > 0.95 * seam.sum()
            centres.append(np.sum(seam * away) / seam.sum())
    assert np.median(np.abs(centres)) < 0.009
    assert np.max(np.abs(centres)) < 0.024


def test_a_block_is_stretched_from_its_surroundings_alone() -> None:
    sound = buzz(3.0) * np.linspace(0.2, 1, 3 * RATE, dtype=np.float32)
    blocks = lasting(np.array([0.3, 0.4, 0.25, 0.45, 0.3]))
    whole = blocking.stretch_speech(Speech(sound, RATE), blocks)
    assert np.array_equal(whole, blocking.stretch_speech(Speech(sound, RATE), blocks))
    elsewhere = sound.copy()
    elsewhere[:round((0.7 - 0.04) * RATE)] = 0.5
    elsewhere[round((0.95 + 0.04) * RATE):] = -0.5
    assert np.array_equal(blocking.stretch_speech(Speech(elsewhere, RATE), blocks)[2], whole[2])


@given(st.integers(700, 3000), st.floats(0.4, 2.9), st.integers(0, 10**6))
def test_the_stretching_is_pytsmods_bit_for_bit(length: int, factor: float, seed: int) -> None:
    """It is given another linear interpolation than scipy's."""
    assert pytsmod.wsola is not blocking._WSOLA
    sound = np.random.default_rng(seed).normal(size=length)
    anchors = np.array([[0, 300, length - 1], [0, 300, 300 + round(factor * (length - 301))]])
    whole = pytsmod.wsola(sound, anchors, win_size=512, syn_hop_size=256, tolerance=128)
    np.testing.assert_array_equal(blocking._WSOLA(sound, anchors, win_size=512, syn_hop_size=256, tolerance=128), whole)


@given(st.integers(1, 40), st.floats(0.02, 0.3), st.integers(0, 10**6))
def test_smoothing_is_scipys_correlation_with_a_gaussian(count: int, sigma: float, seed: int) -> None:
    frames = np.random.default_rng(seed).normal(size=(count, 5))
    half = int(2.0 * sigma * 20.0 + 1e-9)
    weights = np.exp(-0.5 * (np.arange(-half, half + 1) / (sigma * 20.0)) ** 2)
    expected = correlate1d(frames, weights / weights.sum(), axis=0, mode="mirror")
    np.testing.assert_allclose(blocking.smooth(frames, 20.0, sigma), expected, atol=1e-13)


def test_windows_hold_three_blocks_and_zeros_outside() -> None:
    stretched = np.arange(1, 13, dtype=np.float32).reshape(4, 3)
    windows = blocking.windows_of(stretched)
    assert windows.tolist() == [[0, 0, 0, 1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 6, 7, 8, 9],
                                [4, 5, 6, 7, 8, 9, 10, 11, 12], [7, 8, 9, 10, 11, 12, 0, 0, 0]]
    assert blocking.windows_of(stretched[:1]).tolist() == [[0, 0, 0, 1, 2, 3, 0, 0, 0]]
    assert blocking.samples_per_frame(16000, 20.0) == 800


@given(durations=DURATIONS, seed=st.integers(0, 5))
def test_motion_comes_back_exactly_on_the_beats(durations: Array, seed: int) -> None:
    blocks = lasting(durations)
    motion = waving(frames=round(durations.sum() * 60) + 1, fps=60.0, seed=seed)
    knots = blocking.normalise_motion(motion, blocks)
    assert knots.shape == (len(blocks), 10, 48)
    out = blocking.denormalise(knots, blocking.first_pose(motion), blocks, 20.0, smooth_over=0)
    assert len(out) == round(durations.sum() * 20)
    sampled = ROTATIONS.vectors(motion, np.arange(0, len(motion), 3) / 60.0)
    wanted = rotation.from_exponential_map(sampled.reshape(-1, 16, 3))[:len(out)]
    found = rotation.from_exponential_map(out.reshape(-1, 16, 3))
    error = rotation.angle_between(wanted, found).max(axis=1)
    beats = np.round(blocks.edges[:-1] * 20).astype(int)
    assert error[beats].max() < 1e-6
    assert error.max() < 0.002  # elsewhere within the error of interpolation


@given(gaps=st.lists(st.floats(0.02, 0.06), min_size=6, max_size=20), seed=st.integers(0, 99))
def test_the_cubic_is_exact_at_knots_smooth_and_local(gaps: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(gaps)
    values = rng.standard_normal((len(times), 2))
    assert np.allclose(blocking.hermite(times, values, times), values, atol=1e-9)
    inner = times[1:-1]
    tiny = 1e-7
    before = (blocking.hermite(times, values, inner) - blocking.hermite(times, values, inner - tiny)) / tiny
    after = (blocking.hermite(times, values, inner + tiny) - blocking.hermite(times, values, inner)) / tiny
    assert np.allclose(before, after, atol=1e-3 * np.abs(before).max())
    parabola = np.stack([1 + 2 * times - 3 * times ** 2], axis=1)
    at = np.linspace(times[1], times[-2], 50)
    assert np.allclose(blocking.hermite(times, parabola, at)[:, 0], 1 + 2 * at - 3 * at ** 2, atol=1e-9)
    knot = len(times) // 2
    changed = values.copy()
    changed[knot] += 5
    dense = np.linspace(times[0], times[-1], 400)
    apart = np.abs(blocking.hermite(times, changed, dense) - blocking.hermite(times, values, dense)).max(axis=1) > 1e-9
    assert (dense[apart] > times[knot - 2]).all()
    assert (dense[apart] < times[min(knot + 2, len(times) - 1)]).all()


@given(st.lists(st.tuples(st.integers(1, 4), st.booleans()), min_size=3, max_size=12), st.integers(0, 9))
def test_a_path_whose_look_ahead_changes_is_whole_and_smooth(pushes: list[tuple[int, bool]], seed: int) -> None:
    """Knots of a line give that line whatever the mode; those of a slow swing give it nearly, and its speed too: a
    slope that was used on one side of a knot is used on the other one."""
    rng, fps = np.random.default_rng(seed), 240.0
    path, line = (blocking.KnotPath(np.zeros(1), fps, 0.0) for _ in range(2))
    end, out, straight = 0.0, [], []
    for count, prompt in pushes:
        times = end + np.cumsum(rng.uniform(0.02, 0.05, count))
        end = float(times[-1])
        path.prompt = line.prompt = prompt
        out.append(path.push(times, np.sin(4.0 * times)[:, None]))
        straight.append(line.push(times, 3.0 * times[:, None]))
        certain = end if prompt else end - 0.05
        assert path.next >= math.floor(certain * fps), "frames come as early as the mode allows"
    out.append(path.finish(end))
    straight.append(line.finish(end))
    frames, times = np.concatenate(out)[:, 0], np.arange(round(end * fps)) / fps
    assert len(frames) == round(end * fps), "none is missing and none comes twice"
    np.testing.assert_allclose(np.concatenate(straight)[:, 0], 3.0 * times, atol=1e-9)
    # The slope of a line is wrong by 4^2 * 0.05 / 2 = 0.4, which moves the cubic by 0.4 * 0.05 * 4 / 27 a side.
    np.testing.assert_allclose(frames, np.sin(4.0 * times), atol=6e-3)
    np.testing.assert_allclose(np.diff(frames) * fps, 4.0 * np.cos(4.0 * (times[1:] - 0.5 / fps)), atol=0.5)
    assert np.abs(np.diff(frames, 2)).max(initial=0.0) * fps < 0.35, "the speed does not jump at a knot"


def smoothed(frames: Array, fps: float) -> Array:
    """Frames [T, D] with a knot on each, where the cubic is exact, after the smoothing alone."""
    path = blocking.KnotPath(frames[0], fps)
    return np.concatenate([path.push(np.arange(1, len(frames)) / fps, frames[1:]), path.finish(len(frames) / fps)])


def test_smoothing_is_five_taps_at_20_fps_and_the_same_in_seconds_elsewhere() -> None:
    impulse = np.zeros((21, 1))
    impulse[10] = 1
    weights = np.exp(-0.5 * np.array([2, 1, 0, 1, 2]) ** 2)
    assert np.allclose(smoothed(impulse, 20.0)[8:13, 0], weights / weights.sum())
    assert smoothed(impulse, 20.0)[[7, 13]].max() == 0
    for fps in (30.0, 60.0, 120.0):
        time = np.arange(200) / fps
        line = np.stack([3 * time], axis=1)
        assert np.allclose(smoothed(line, fps)[20:-20], line[20:-20])
        step = (time >= 100 / fps).astype(float)[:, None]
        rise = smoothed(step, fps)
        assert np.count_nonzero((rise > 1e-12) & (rise < 1 - 1e-12)) == 2 * round(0.1 * fps)
    mirrored = np.array([[1.0], [5.0], [2.0], [7.0]])
    wide = np.concatenate([mirrored[2:0:-1], mirrored, 2 * mirrored[-1] - mirrored[-2:-4:-1]])
    assert np.allclose(smoothed(mirrored, 20.0)[:, 0], np.convolve(wide[:, 0], weights / weights.sum(), "valid"))
    assert np.array_equal(smoothed(mirrored[:1], 20.0), mirrored[:1])
