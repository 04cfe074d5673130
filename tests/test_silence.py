"""Silence: noise of a room is silent, a quiet voice is not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from data_module.speech import silence
from data_module.types import Array, Samples, Speech

RATE = 16000


def room(seconds: float, dbfs: float, colour: float = 0.0, seed: int = 0) -> Samples:
    noise = np.random.default_rng(seed).standard_normal(round(seconds * RATE) + RATE)
    noise = lfilter([1.0], [1.0, -colour], noise)[RATE:]
    return (noise / np.std(noise) * 10 ** (dbfs / 20)).astype(np.float32)


def voice(seconds: float, dbfs: float) -> Samples:
    """A buzz in syllables of a quarter of a second, never quite interrupted."""
    time = np.arange(round(seconds * RATE)) / RATE
    buzz = np.sum([np.sin(2 * np.pi * 120 * h * time) / h for h in range(1, 15)], axis=0)
    sound = buzz * (0.15 + np.sin(np.pi * time / 0.25) ** 2)
    return (sound / np.std(sound) * 10 ** (dbfs / 20)).astype(np.float32)


def steps(seconds: float, step: float = 0.25) -> Array:
    return np.linspace(0, seconds, round(seconds / step) + 1)


def test_frame_levels_are_dbfs() -> None:
    time = np.arange(RATE) / RATE
    sine = np.sin(2 * np.pi * 100 * time).astype(np.float32)
    assert np.allclose(silence.frame_levels(sine, RATE), -3.0103, atol=1e-3)
    assert np.allclose(silence.frame_levels(sine * 0.1, RATE), -23.0103, atol=1e-3)
    assert len(silence.frame_levels(sine[:15901], RATE)) == 100
    assert (silence.frame_levels(np.zeros(500, np.float32), RATE) == -120).all()


def test_the_floor_is_the_percentile_of_the_past_ten_seconds() -> None:
    levels = np.random.default_rng(0).normal(-70, 5, 2500)
    floor = silence.loudness(levels).floor
    means = levels.reshape(-1, 10).mean(axis=1)
    for step in (3, 9, 10, 60, 101, 200, 249):
        last = step + 1 if step < 10 else step  # in the first second a step is classified by itself
        past = means[max(0, last - 100):last]
        assert floor[10 * step] == np.percentile(past, 10, method="lower")
        assert (floor[10 * step:10 * step + 10] == floor[10 * step]).all()


@pytest.mark.parametrize("size", [1, 2, 7, 10, 33])
def test_frames_are_classified_at_once_after_the_first_second_and_alike_in_any_pieces(size: int) -> None:
    levels = np.random.default_rng(1).normal(-60, 12, 437)
    whole, tracker, start = silence.loudness(levels), silence.LoudnessTracker(), silence.SteadyStart()
    steps, quiet = [], []
    for first in range(0, len(levels), size):
        last = min(first + size, len(levels))
        steps.append(tracker.step(levels[first:last], ended=last == len(levels)))
        quiet.append(start.step(steps[-1].levels, steps[-1].silent))
        certain = sum(len(step.levels) for step in steps)
        assert certain == (last if last >= 100 else last - last % 10)
    for name in ("levels", "floor", "limit", "ground", "silent", "expected"):
        assert np.array_equal(np.concatenate([getattr(step, name) for step in steps]), getattr(whole, name)), name
    assert np.array_equal(np.concatenate([*quiet, start.finish()]), whole.silent), "it varies more than steady noise"


@pytest.mark.parametrize("size", [2, 10])
def test_a_steady_first_second_is_silent_until_it_varies(size: int) -> None:
    """0.3 s of look-ahead: what is steady until 0.7 s is silent up to 0.4 s, and from there on it is what it is."""
    for steady, silent in ((70, 40), (300, 100)):
        levels = np.full(400, -40.0)
        levels[steady:] -= 20.0 * (np.arange(400 - steady) % 20 < 10)
        loud, start, out = np.zeros(400, bool), silence.SteadyStart(), list[bool]()
        for first in range(0, 400, size):
            out += start.step(levels[first:first + size], loud[first:first + size]).tolist()
        out += start.finish().tolist()
        assert out == [True] * silent + [False] * (400 - silent)


@pytest.mark.parametrize("dbfs", [-90, -65, -50, -42])
@pytest.mark.parametrize("colour", [0.0, 0.97])
def test_a_minute_of_room_noise_is_silent(dbfs: float, colour: float) -> None:
    noise = room(60.0, dbfs, colour)
    assert silence.silent_blocks(Speech(noise, RATE), steps(60.0)).all()


@pytest.mark.parametrize(("speech", "noise"), [(-45, -90), (-30, -50), (-23, -40), (-10, -60)])
def test_a_quiet_voice_is_not_silent(speech: float, noise: float) -> None:
    sound = np.concatenate([np.zeros(2 * RATE, np.float32), voice(20.0, speech)]) + room(22.0, noise)
    silent = silence.silent_blocks(Speech(sound, RATE), steps(22.0))
    assert silent[:7].all()
    assert not silent[9:].any()


def test_a_voice_that_starts_at_once_is_heard() -> None:
    assert not silence.silent_blocks(Speech(voice(5.0, -25) + room(5.0, -60), RATE), steps(5.0)).any()
    held = np.sin(2 * np.pi * 200 * np.arange(8 * RATE // 10) / RATE).astype(np.float32) * np.float32(0.1)
    held[:RATE // 10] *= np.linspace(0.0, 1.0, RATE // 10, dtype=np.float32)  # a sound that is held begins gradually
    sound = np.concatenate([held, voice(4.0, -25)])
    assert not silence.silent_blocks(Speech(sound, RATE), steps(0.75)).any()


def test_a_pause_is_long_enough_and_a_blip_does_not_end_it() -> None:
    frames = round(silence.SHORTEST_PAUSE / silence.FRAME)
    loud, quiet = np.zeros(50, bool), np.ones
    for length, expected in ((frames - 1, False), (frames, True)):
        state = np.concatenate([loud, quiet(length, bool), loud])
        assert silence.pauses(state)[50:50 + length].all() == expected
        assert not silence.pauses(state)[:50].any()
    blip = np.concatenate([loud, quiet(25, bool), [False, False], quiet(25, bool), loud])
    assert silence.pauses(blip)[50:102].all()
    blip = np.concatenate([loud, quiet(25, bool), [False] * 3, quiet(25, bool), loud])
    assert not silence.pauses(blip).any()


def test_blocks_are_silent_by_their_own_frames() -> None:
    sound = np.concatenate([voice(3.0, -20), np.zeros(2 * RATE, np.float32), voice(3.0, -20)])
    edges = np.array([0, 1.0, 2.8, 3.2, 3.5, 4.98, 5.2, 8.0])
    assert silence.silent_blocks(Speech(sound, RATE), edges).tolist() == [False, False, False, True, True, False, False]
    assert silence.silent_blocks(Speech(np.zeros(RATE, np.float32), RATE), np.array([0, 0.004, 1.0])).tolist()[1]
