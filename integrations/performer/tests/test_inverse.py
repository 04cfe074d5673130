"""Speech made for motion: phrases found in the motion, vowels put on beats, sound stretched to meet them."""

from __future__ import annotations

import numpy as np
import pytest
from gesticulator_performer import inverse
from gesticulator_performer.inverse import (
    NO_VOWEL,
    Candidates,
    Wanted,
    Window,
    assign,
    make_pool,
    phrase_texts,
    phrase_windows,
)
from gesticulator_performer.joints import FPS, facing_positions
from gesticulator_performer.sound import RATE
from gesticulator_performer.takes import arms_speed
from gesticulator_performer.talks import features_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_takes import library, moving

from data_module.motion.motion_beats import beats_of_speed


def test_phrases_of_motion_are_what_lies_between_its_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inverse, "_MOVED_SHARE", 0.0)
    spans = [(0.6, 3.0), (3.8, 6.4), (7.4, 9.6), (10.3, 13.4)]
    # Arms that move at about 1 m/s, a stroke each 0.4 s, in the spans and rest elsewhere.
    time = np.arange(round(14.0 * FPS)) / FPS
    speed = np.full(len(time), 0.02)
    for a, b in spans:
        inside = (time >= a) & (time < b)
        speed[inside] += 1.0 + 0.5 * np.cos(2 * np.pi * (time[inside] - a) / 0.4)
    windows = phrase_windows(speed, np.random.default_rng(0))
    assert len(windows) == len(spans)
    for window, (a, b) in zip(windows, spans, strict=True):
        assert abs(window.start - a) < 0.3 and abs(window.end - b) < 0.3


@pytest.mark.parametrize(("vowels", "duration", "window", "beats"), [
    ([0.2, 0.7, 1.2, 1.7], 2.0, (5.0, 7.0), [5.2, 5.7, 6.2, 6.7]), ([0.2], 3.0, (5.0, 6.0), [5.2])])
def test_beats_are_met_at_the_voices_own_rate_and_what_is_too_long_is_refused(
        vowels: list[float], duration: float, window: tuple[float, float], beats: list[float]) -> None:
    count = len(vowels)
    phrase = Candidates(np.array([7]), np.array([duration]), np.array([vowels]), np.ones((1, count)))
    wanted = Wanted(Window(*window), np.array(beats), np.ones(count), np.zeros((count, 7)))
    match = assign(phrase, wanted, np.ones((1, count, count)))
    if duration > 2.0:
        assert match is None
    else:
        assert match is not None and match.phrase == 7 and match.beats == 4
        assert match.anchors[:, 1] - match.anchors[:, 0] == pytest.approx(5.0, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_every_assignment_is_monotone_and_in_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, places = 12, 8
    vowels = np.cumsum(rng.uniform(0.12, 0.45, (count, places)), axis=1)
    lengths = rng.integers(3, places + 1, count)
    duration = vowels[np.arange(count), lengths - 1] + 0.2
    vowels[np.arange(places) >= lengths[:, None]] = NO_VOWEL
    candidates = Candidates(np.arange(count), duration, vowels, rng.normal(0.0, 1.0, (count, places)))
    beats = np.cumsum(rng.uniform(0.05, 0.7, 5)) + 1.0
    wanted = Wanted(Window(1.0, float(beats[-1]) + 0.3), beats, rng.uniform(0.4, 2.0, 5), np.zeros((5, 7)))
    match = assign(candidates, wanted, rng.uniform(0.0, 2.0, (count, places, 5)))
    if match is None:
        return
    steps = np.diff(match.anchors, axis=0)
    assert (steps > 0).all()
    assert (steps[:, 0] / steps[:, 1]).min() >= inverse.SLOWEST - 1e-9
    assert (steps[:, 0] / steps[:, 1]).max() <= inverse.FASTEST + 1e-9
    inner = match.anchors[1:-1]
    assert all(np.abs(vowels[match.phrase] - a).min() < 1e-9 and np.abs(beats - b).min() < 1e-9 for a, b in inner)
    assert len(inner) == match.beats


def test_speech_for_motion_stresses_its_beats_and_pauses_in_its_rests() -> None:
    pool = make_pool("rms", phrase_texts(np.random.default_rng(5), 220, "train", set()))
    lib = library(1)
    logs = moving(40.0, 11)
    # Rests: the arms slow down to nothing every four seconds.
    time = np.arange(len(logs)) / FPS
    clock = np.cumsum(np.clip(3.0 * np.abs(np.sin(np.pi * time / 4.0)), 0.0, 1.0)) / FPS
    at = clock / clock[-1] * (len(logs) - 1)
    logs = np.stack([np.interp(at, np.arange(len(logs)), column) for column in logs.reshape(len(logs), -1).T], axis=-1)
    places = facing_positions(lib.rotations(logs.reshape(-1, 16, 3)))
    made, again = (inverse.speech_for(places, pool, features_of(places),
                                      np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(made.speech.samples, again.speech.samples)
    assert len(made.speech.samples) == round(len(places) / FPS * RATE)
    speed = arms_speed(places)
    beats = beats_of_speed(speed, FPS)
    vowels = np.array([s.vowel for s in made.syllables])
    phrases = made.phrases
    assert len(phrases) >= 6
    assert all(a.end <= b.start for a, b in zip(phrases, phrases[1:], strict=False))
    spoken = np.array([b for b in beats if any(p.start < b < p.end for p in phrases)])
    off = np.abs(vowels[None] - spoken[:, None] - 0.038).min(axis=1)
    shifts = 0.31 + 0.9 * np.arange(20.0)
    chance = np.abs(vowels - (spoken[:, None, None] + shifts[:, None]) % 40.0 - 0.038).min(axis=-1)
    assert np.mean(off < 0.1) > np.mean(chance < 0.1) + 0.1
    words = made.speech.words
    assert words and all(w.end >= w.start for w in words)
    assert all(any(p.start - 0.05 <= w.start <= p.end + 0.05 for p in phrases) for w in words)
