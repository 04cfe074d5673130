"""Onsets and beats: intervals whatever the sound, and no peeking into the future."""

import warnings
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.speech import onsets
from data_module.speech.audio import load_speech
from data_module.speech.beats import RULES, BeatSettings, BeatTracker, find_beats, next_beat
from data_module.speech.mel import mel_bands
from data_module.speech.onsets import LOOK_AHEAD, OnsetTracker, RiseTracker, detect_onsets, merged
from data_module.speech.silence import LoudnessTracker, frame_levels
from data_module.types import Array, BeatFlag, Beats, Samples, Speech
from eval.pictures import intervals

RATE = 16000
RANGES = [(0.2, 0.5), (0.3, 0.6), (0.2, 1.0), (0.5, 1.0), (0.25, 0.5)]
EVERYWHERE = np.arange(0, 30, 0.01)
NOWHERE = np.zeros(0)

times = st.lists(st.floats(0, 12, allow_nan=False), max_size=40).map(lambda values: np.unique(np.array(values, float)))
loudness = st.one_of(times, st.just(EVERYWHERE), st.just(NOWHERE))


def clicks(at: Array, seconds: float, noise: float = 0.0, seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)
    sound = noise * rng.standard_normal(round(seconds * RATE))
    for time in at:
        start = round(time * RATE)
        sound[start:start + 80] += 0.5 * rng.standard_normal(80)
    return sound.astype(np.float32)


def babble(seconds: float, seed: int = 0) -> Samples:
    """Something like speech: a buzz in syllables of uneven length and loudness, over faint noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    buzz = np.sum([np.sin(2 * np.pi * 120 * h * time) / h for h in range(1, 12)], axis=0)
    envelope, at = np.zeros(len(time)), 0.3
    while at < seconds:
        length = rng.uniform(0.1, 0.3)
        rise, fall = np.clip((time - at) / 0.02, 0, 1), np.clip((at + length - time) / 0.05, 0, 1)
        envelope += rng.uniform(0.05, 0.3) * rise * fall
        at += length + rng.choice([0.05, 0.1, 0.9])
    return (buzz * envelope + 1e-3 * rng.standard_normal(len(time))).astype(np.float32)


def place_beats(onsets: Array, loud: Array, duration: float, settings: BeatSettings) -> Beats:
    """The beats of a recording whose onsets and loud moments are known, seconds."""
    tracker = BeatTracker(settings)
    tracker._loud = loud
    beats = [(0.0, BeatFlag.BOUNDARY), *tracker.finish([(onset, 0.0) for onset in onsets.tolist()], [], duration)]
    return Beats(np.array([time for time, _ in beats]), np.array([flag for _, flag in beats], np.int8))


def in_range(intervals: Array, settings: BeatSettings) -> bool:
    return bool((intervals >= settings.d_min - 1e-9).all() and (intervals <= settings.d_max + 1e-9).all())


@given(onsets=times, loud=loudness, extra=st.floats(0, 12), preset=st.sampled_from(RANGES), rule=st.sampled_from(RULES))
def test_every_interval_is_in_range(onsets: Array, loud: Array, extra: float, preset: tuple[float, float],
                                    rule: str) -> None:
    settings = BeatSettings(*preset, rule=rule)
    duration = preset[0] + extra
    beats = place_beats(onsets, loud, duration, settings)
    assert in_range(np.diff(beats.times), settings)
    assert beats.times[-1] == duration
    assert beats.flags[0] == beats.flags[-1] == BeatFlag.BOUNDARY
    assert (beats.flags[1:-1] != BeatFlag.BOUNDARY).all()
    for time, flag in zip(beats.times, beats.flags, strict=True):
        if flag == BeatFlag.ONSET:
            assert np.abs(onsets - time).min() < 1e-9


@given(onsets=times, loud=loudness, extra=st.floats(0, 12), preset=st.sampled_from(RANGES))
def test_a_beat_depends_on_nothing_beyond_its_horizon(onsets: Array, loud: Array, extra: float,
                                                      preset: tuple[float, float]) -> None:
    settings = BeatSettings(*preset)
    duration = preset[0] + extra
    onsets = merged(onsets, settings.merge)
    beats = place_beats(onsets, loud, duration, settings)
    for beat, following, flag in zip(beats.times[:-1], beats.times[1:], beats.flags[1:], strict=True):
        horizon = beat + settings.d_max + settings.d_min
        other_future = np.array([horizon + 0.01, horizon + 0.03])
        for tail in (NOWHERE, other_future):
            known = [np.concatenate([series[series < horizon], tail]) for series in (onsets, loud)]
            end = duration if duration < horizon else None
            assert next_beat(float(beat), *known, end, settings) == (following, flag)


BOUNDED = [
    # the first onset at least 0.2 s on is taken, one closer is passed over
    ([0.1, 0.3, 0.45, 0.7], NOWHERE, 1.1, [0, 0.3, 0.7, 1.1], [0, 1, 1, 0]),
    # an onset closer than 0.2 s to the end is dropped
    ([0.4, 0.75], NOWHERE, 0.8, [0, 0.4, 0.8], [0, 1, 0]),
    # nothing at all: the longest steps, and room left for the last one
    ([], NOWHERE, 1.6, [0, 0.5, 1.0, 1.4, 1.6], [0, 3, 3, 3, 0]),
    # something loud: the first loud frame 0.2 s on
    ([], np.array([0.05, 0.27, 0.28]), 0.9, [0, 0.27, 0.7, 0.9], [0, 2, 3, 0]),
    # a pseudo-beat keeps 0.2 s before the onset that follows
    ([0.6], NOWHERE, 1.1, [0, 0.4, 0.6, 1.1], [0, 3, 1, 0]),
    # and so it does where the onset comes just too late to be taken at once
    ([0.53], NOWHERE, 1.0, [0, 0.33, 0.53, 1.0], [0, 3, 1, 0]),
    # a recording shorter than a block
    ([0.05], NOWHERE, 0.15, [0, 0.15], [0, 0]),
]
PAPER = [
    ([], NOWHERE, 1.2, [0, 0.4, 0.8, 1.2], [0, 3, 3, 0]),
    ([1.2], np.array([0.9]), 1.7, [0, 0.45, 0.9, 1.2, 1.7], [0, 3, 2, 1, 0]),
    ([0.3, 0.4, 0.9], NOWHERE, 1.2, [0, 0.3, 0.6, 0.9, 1.2], [0, 1, 3, 1, 0]),
]


@pytest.mark.parametrize(("rule", "onsets", "loud", "duration", "times", "flags"), [
    *(("bounded", *row) for row in BOUNDED), *(("paper", *row) for row in PAPER)])
def test_the_rules_by_hand(rule: str, onsets: list[float], loud: Array, duration: float, times: list[float],
                           flags: list[int]) -> None:
    beats = place_beats(np.array(onsets, float), loud, duration, BeatSettings(rule=rule))
    assert np.allclose(beats.times, times)
    assert beats.flags.tolist() == flags


@pytest.mark.parametrize(("bounds", "duration", "times"), [
    # a multiple of d_max
    ((0.2, 0.4), 1.2, [0, 0.4, 0.8, 1.2]),
    # and one that floats make a little longer
    ((0.2, 0.4), 0.4 + 0.4 + 0.4, [0, 0.4, 0.8, 1.2]),
    # what is left is long enough to be an interval
    ((0.2, 0.4), 1.45, [0, 0.4, 0.8, 1.2, 1.45]),
    # what is left is too short: the beat before the end makes room
    ((0.2, 0.4), 1.3, [0, 0.4, 0.8, 1.1, 1.3]),
    # shorter than an interval
    ((0.2, 0.4), 0.3, [0, 0.3]),
    ((0.2, 0.4), 0.1, [0, 0.1]),
    # one length alone: half of it is what the end may have
    ((0.4, 0.4), 1.2, [0, 0.4, 0.8, 1.2]),
    ((0.4, 0.4), 1.45, [0, 0.4, 0.8, 1.2, 1.45]),
    ((0.4, 0.4), 1.3, [0, 0.4, 0.8, 1.1, 1.3]),
])
def test_even_beats_by_hand(bounds: tuple[float, float], duration: float, times: list[float]) -> None:
    beats = place_beats(np.array([0.17, 0.55]), EVERYWHERE, duration, BeatSettings(*bounds, rule="even"))
    assert np.allclose(beats.times, times)
    assert beats.flags.tolist() == [0, *[3] * (len(times) - 2), 0]


@pytest.mark.parametrize("noise", [0.0, 1e-4, 3e-3])
@pytest.mark.parametrize("step", [0.23, 0.37, 0.5])
def test_clicks_are_the_beats(step: float, noise: float) -> None:
    at = np.arange(0.4, 5.5, step)
    beats = find_beats(Speech(clicks(at, 6.0, noise), RATE))
    found = beats.times[beats.flags == BeatFlag.ONSET]
    assert len(found) == len(at)
    assert np.abs(found - at).max() <= 0.015


def test_steady_sound_has_no_onsets() -> None:
    time = np.arange(6 * RATE) / RATE
    noise = 0.01 * np.random.default_rng(0).standard_normal(6 * RATE)
    for sound, most in ((0 * time, 0), (noise, 0), (0.3 * np.sin(2 * np.pi * 220 * time), 1), (0 * time + 1, 1)):
        assert len(detect_onsets(sound.astype(np.float32), RATE)) <= most


def test_what_nobody_hears_is_no_onset() -> None:
    at = np.arange(0.4, 5.5, 0.5)
    assert len(detect_onsets(clicks(at, 6.0), RATE)) == len(at)
    assert len(detect_onsets(clicks(at, 6.0) * np.float32(1e-3), RATE)) == 0


def test_an_onset_closer_than_50_ms_is_the_same_onset() -> None:
    assert merged(np.array([0.1, 0.12, 0.16, 0.3]), 0.05).tolist() == [0.1, 0.16, 0.3]
    assert (np.diff(detect_onsets(babble(20.0), RATE)) >= 0.05 - 1e-9).all()


def test_onsets_do_not_depend_on_gain_nor_on_what_comes_later() -> None:
    sound = babble(20.0)
    whole = detect_onsets(sound, RATE)
    assert len(whole) > 20
    quieter = detect_onsets(sound / 2, RATE)
    np.testing.assert_allclose(quieter, whole, atol=1e-9)
    shout = np.concatenate([sound, np.clip(100 * babble(5.0, 1), -1, 1)])
    for later in (sound[:12 * RATE], shout):
        sure = min(len(later) / RATE, 20.0) - LOOK_AHEAD
        again = detect_onsets(later, RATE)
        assert np.allclose(again[again < sure], whole[whole < sure], atol=1e-9)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("seconds", [0.31, 3.0, 7.77])
def test_beats_of_sound_that_arrives_are_those_of_the_recording(rule: str, seconds: float) -> None:
    sound, settings = babble(seconds, 3), BeatSettings(rule=rule)
    loudness_of, onsets, beats = LoudnessTracker(), OnsetTracker(RATE), BeatTracker(settings)
    found, step = [(0.0, BeatFlag.BOUNDARY)], RATE // 10
    for start in range(0, len(sound) - step, step):
        heard = loudness_of.step(frame_levels(sound[start:start + step], RATE))
        more = onsets.step(sound[start:start + step], heard)
        new = beats.step(more, heard.silent.tolist(), onsets.known_until, (start + step) / RATE)
        assert all((start + step) / RATE - time <= settings.d_max + settings.d_min + LOOK_AHEAD for time, _ in new)
        found += new
    left = sound[len(range(0, len(sound) - step, step)) * step:]
    heard = loudness_of.step(frame_levels(left, RATE), ended=True)
    found += beats.finish(onsets.step(left, heard) + onsets.finish(), heard.silent.tolist(), len(sound) / RATE)
    whole = find_beats(Speech(sound, RATE), settings)
    assert [time for time, _ in found] == whole.times.tolist()
    assert [int(flag) for _, flag in found] == whole.flags.tolist()


@given(cuts=st.lists(st.integers(0, 2 * RATE), max_size=12).map(sorted))
@settings(max_examples=20, deadline=None)
def test_onset_strengths_do_not_depend_on_the_pieces_of_sound(cuts: list[int]) -> None:
    sound, ground = babble(2.0, 4), np.linspace(-60.0, -40.0, 200)
    tracker, strengths = RiseTracker(RATE), []
    for start, end in pairwise([0, *cuts, len(sound)]):
        # The noise floor is known for every whole 10 ms of sound.
        strengths.append(tracker.step(sound[start:end], ground[start // 160:end // 160]))
    whole = RiseTracker(RATE)
    expected = np.concatenate([whole.step(sound, ground), whole.finish()])
    np.testing.assert_array_equal(np.concatenate([*strengths, tracker.finish()]), expected)


def test_settings_that_cannot_hold_are_refused() -> None:
    for wrong in ({"d_min": 0.3, "d_max": 0.5}, {"d_min": 0.0}, {"d_max": float("inf")}, {"d_max": 0.1},
                  {"merge": -1.0}, {"d_min": float("nan")}, {"d_max": float("nan")}, {"d_min": -0.2}):
        for rule in RULES:
            with pytest.raises(InputError):
                BeatSettings(**wrong, rule=rule)
    with pytest.raises(InputError, match="other"):
        BeatSettings(rule="other")
    BeatSettings(0.25, 0.5)


def test_onsets_agree_with_librosa_on_real_speech(outside_data: Path) -> None:
    import librosa
    import mir_eval

    speech = load_speech(outside_data / "speech" / "en_sonnet_2.flac")
    theirs = merged(librosa.onset.onset_detect(y=speech.samples, sr=RATE, units="time"), 0.05)
    ours = detect_onsets(speech.samples, RATE)
    assert mir_eval.onset.f_measure(theirs, ours, window=0.05)[0] > 0.85


def test_spectra_and_their_rise_are_librosas_to_the_last_bit() -> None:
    import librosa

    sound = np.random.default_rng(0).standard_normal(4 * 160 + 2048).astype(np.float32)
    spectra = onsets._spectra(sound, onsets.RiseTracker(RATE)._hann, 160)
    np.testing.assert_array_equal(spectra.T, librosa.stft(sound, n_fft=2048, hop_length=160, center=False))


@settings(deadline=None, max_examples=100)
@given(st.sampled_from([8000, 16000, 22050, 48000]), st.integers(64, 1200), st.integers(1, 128),
       st.none() | st.floats(300.0, 4000.0), st.booleans())
def test_mel_bands_are_librosas_to_the_last_bit(rate: int, half: int, bands: int, top: float | None, area: bool
                                                ) -> None:
    import librosa

    with warnings.catch_warnings(action="ignore", category=UserWarning):  # some of so many bands are empty
        theirs = librosa.filters.mel(sr=rate, n_fft=2 * half, n_mels=bands, fmax=top, norm="slaney" if area else None)
    np.testing.assert_array_equal(mel_bands(rate, 2 * half, bands, top, equal_area=area), theirs)


@pytest.mark.parametrize(("apart", "beats"), [(0.33, (0.25, 0.4)), (0.77, (0.2, 0.55))])
def test_intervals_of_a_ticking_clock(apart: float, beats: tuple[float, float]) -> None:
    ticks = np.arange(apart, 5.9, apart)
    speech = Speech(clicks(ticks, 6.0, noise=1e-5), RATE)
    onsets, within = intervals.measure(speech)
    assert onsets.sum() == len(ticks) - 1 == onsets[int(apart / intervals.STEP)]
    assert intervals.within_bounds(onsets).startswith("100% of" if apart < 0.5 else "0% of")
    # Ticks that are too far apart get pseudo-beats between them.
    assert within.sum() == len(find_beats(speech).times) - 1
    assert within[round(beats[0] / intervals.STEP):round(beats[1] / intervals.STEP)].sum() >= within.sum() - 2
