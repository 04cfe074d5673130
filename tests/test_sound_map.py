"""Two exports of one recording are aligned: what both have is found where it is, and nothing else."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from performances import example

from data_module.errors import InputError
from data_module.speech.audio import amplified, resample
from data_module.speech.fingerprint import RATE, fingerprint, fingerprint_frames, fingerprint_text
from data_module.speech.sound_map import GAP, OPEN, SHORTEST, SoundMap, _matches, aligned
from data_module.types import Speech


@pytest.fixture(scope="module")
def speech() -> Speech:
    return example(12.0)


def unlike(frames: np.ndarray, other: np.ndarray) -> float:
    """Mean difference of two fingerprints of equal length, in steps of 3 dB over all bands."""
    return float(np.abs(frames.astype(int) - other.astype(int)).sum(axis=1).mean())


@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_a_fingerprint_comes_back_from_its_text(seed: int, count: int) -> None:
    frames = np.random.default_rng(seed).integers(0, 16, (count, 12), dtype=np.uint8)
    text = fingerprint_text(frames)
    assert len(text) == 8 * count
    np.testing.assert_array_equal(fingerprint_frames(text), frames)


@pytest.mark.parametrize("text", ["", "AAAA", "A" * 9, "=" * 8, "ä" * 8, "AAAAAA A"])
def test_what_is_no_fingerprint_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not a fingerprint"):
        fingerprint_frames(text)


def test_level_rate_and_a_little_noise_leave_the_fingerprint(speech: Speech) -> None:
    frames = fingerprint(speech)
    np.testing.assert_array_equal(fingerprint(amplified(speech, -6.0)), frames)
    assert unlike(fingerprint(resample(speech, 48000)), frames) < 1.0
    noise = np.random.default_rng(0).normal(scale=1e-3, size=len(speech.samples))
    assert unlike(fingerprint(replace(speech, samples=(speech.samples + noise).astype(np.float32))), frames) < 3.0
    assert unlike(frames[::-1], frames) > 30.0, "the measure can tell"


def cost_of(one: np.ndarray, other: np.ndarray, pairs: np.ndarray) -> int:
    """The cost of an alignment from its definition."""
    ends = [(-1, -1), *map(tuple, pairs.tolist()), (len(one), len(other))]
    gaps = [max(after - before - 1, 0) for two in pairwise(ends) for before, after in zip(*two, strict=True)]
    matched = sum(int(np.abs(one[i].astype(int) - other[j].astype(int)).sum()) for i, j in pairs.tolist())
    return matched + sum(OPEN + GAP * gap for gap in gaps if gap)


def least_cost(one: np.ndarray, other: np.ndarray) -> int:
    """The least cost of all alignments, by Gotoh's recursion cell by cell."""
    far = 10**9
    table = {(0, 0): (0, far, far)}
    for i in range(len(one) + 1):
        for j in range(len(other) + 1):
            if i == j == 0:
                continue
            match = skip = add = far
            if i and j:
                match = min(table[i - 1, j - 1]) + int(np.abs(one[i - 1].astype(int) - other[j - 1].astype(int)).sum())
            if i:
                m, s, a = table[i - 1, j]
                skip = min(m + OPEN, s, a + OPEN) + GAP
            if j:
                m, s, a = table[i, j - 1]
                add = min(m + OPEN, s + OPEN, a) + GAP
            table[i, j] = match, skip, add
    return min(table[len(one), len(other)])


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.integers(1, 3))
def test_the_alignment_costs_the_least(seed: int, count: int, other: int, values: int) -> None:
    rng = np.random.default_rng(seed)
    frames = 5 * rng.integers(0, values + 1, (count, 12), dtype=np.uint8)
    others = 5 * rng.integers(0, values + 1, (other, 12), dtype=np.uint8)
    both = min(count, other)
    others[:both // 2] = frames[both - both // 2:both]  # so that something matches
    pairs = _matches(frames, others)
    assert (np.diff(pairs, axis=0) > 0).all()
    assert cost_of(frames, others, pairs) == least_cost(frames, others)


def check_order(sounds: SoundMap) -> None:
    """Times rise within each stretch, and stretches follow each other in both recordings."""
    for stretch in sounds.stretches:
        assert (np.diff(stretch.times) > 0).all() and (np.diff(stretch.there) > 0).all()
    for before, after in pairwise(sounds.stretches):
        assert before.times[-1] < after.times[0] and before.there[-1] < after.there[0]


@given(st.integers(0, 2**32 - 1), st.lists(st.tuples(st.sampled_from(["cut", "insert", "replace"]),
                                                     st.integers(5, 80)), max_size=4))
def test_what_remains_of_a_recording_is_found_at_its_exact_shift(seed: int, edits: list[tuple[str, int]]) -> None:
    rng = np.random.default_rng(seed)

    def sound(frames: int) -> np.ndarray:
        return rng.integers(6, 16, (frames, 12), dtype=np.uint8)  # loud enough for speech

    one, other, shifts = [], [], []
    for kind, size in [*edits, ("end", 0)]:
        kept = sound(int(rng.integers(2 * SHORTEST, 80)))
        begin = sum(map(len, one))
        shifts.append((begin, begin + len(kept), sum(map(len, other)) - begin))
        one.append(kept)
        other.append(kept)
        if kind in ("cut", "replace"):
            one.append(sound(size))
        if kind in ("insert", "replace"):
            other.append(sound(size))
    found = aligned(np.concatenate(one), np.concatenate(other))
    check_order(found)
    for begin, end, shift in shifts:
        middle = (begin + end) / 2 / RATE
        inside = [stretch for stretch in found.stretches if stretch.times[0] <= middle <= stretch.times[-1]]
        assert len(inside) == 1 and inside[0].at(middle) == pytest.approx(middle + shift / RATE, abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(30, 200), st.integers(30, 200))
def test_unrelated_sounds_have_nothing_in_common_and_the_map_still_rises(seed: int, count: int, other: int) -> None:
    rng = np.random.default_rng(seed)
    found = aligned(*(rng.integers(6, 16, (frames, 12), dtype=np.uint8) for frames in (count, other)))
    check_order(found)
    assert found.speech == 0.0 and len(found.stretches) == 2


def test_long_sounds_of_very_different_lengths_are_refused_before_memory_is_taken() -> None:
    hour, half = (np.zeros((60 * RATE * minutes, 12), np.uint8) for minutes in (60, 30))
    with pytest.raises(InputError, match="lasts 1800 s, and the old one 3600 s"):
        aligned(hour, half)


def test_a_band_of_shifts_finds_what_all_shifts_find(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    one = rng.integers(6, 16, (900, 12), dtype=np.uint8)
    other = np.concatenate([one[:300], one[360:600], rng.integers(6, 16, (40, 12), dtype=np.uint8), one[600:]])
    whole = _matches(one, other)
    monkeypatch.setattr("data_module.speech.sound_map.REACH", 100)
    np.testing.assert_array_equal(_matches(one, other), whole)


def test_speech_at_another_tempo_is_followed(speech: Speech) -> None:
    import librosa

    faster = Speech(librosa.effects.time_stretch(speech.samples, rate=1.05), 16000)
    found = aligned(fingerprint(speech), fingerprint(faster))
    check_order(found)
    assert found.speech > 0.9
    for time in np.arange(1.0, 11.5, 0.5).tolist():
        nearest = min(found.stretches, key=lambda one: max(one.times[0] - time, time - one.times[-1], 0.0))
        assert nearest.at(time) == pytest.approx(time / 1.05, abs=0.12)
