"""A spoken phrase with its words and phones, and the simulated recording: room, noise and level."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.signal import lfilter, oaconvolve

from data_module.types import Array, Samples, Word

RATE = 16000


@dataclass(frozen=True)
class Phone:
    """A phone, seconds; `word` is the index of its word."""

    name: str
    start: float
    end: float
    vowel: bool
    word: int

    def moved(self, seconds: float, words: int = 0) -> Phone:
        return replace(self, start=self.start + seconds, end=self.end + seconds, word=self.word + words)


@dataclass(frozen=True)
class Sounded:
    """A spoken phrase: samples at 16 kHz, words and phones in seconds from the first sample."""

    samples: Samples
    words: tuple[Word, ...]
    phones: tuple[Phone, ...]


def word_spans(texts: list[str], phones: tuple[Phone, ...]) -> tuple[Word, ...]:
    """Each word from the start of its first phone to the end of its last; every word has at least one phone."""
    spans: dict[int, tuple[float, float]] = {}
    for phone in phones:
        start, end = spans.get(phone.word, (phone.start, phone.end))
        spans[phone.word] = (min(start, phone.start), max(end, phone.end))
    return tuple(Word(text, *spans[index]) for index, text in enumerate(texts))


def trimmed(samples: Samples, phones: tuple[Phone, ...], margin: float = 0.02) -> tuple[Samples, tuple[Phone, ...]]:
    """Cut the silence before the first and after the last phone, except for a faded margin of `margin` seconds."""
    first = max(0, round((phones[0].start - margin) * RATE))
    last = min(len(samples), round((phones[-1].end + margin) * RATE))
    cut = samples[first:last].copy()
    ramp = np.linspace(0, 1, min(round(margin * RATE), len(cut)), dtype=np.float32)
    cut[:len(ramp)] *= ramp
    cut[len(cut) - len(ramp):] *= ramp[::-1]
    longest = len(cut) / RATE
    moved = (phone.moved(-first / RATE) for phone in phones)
    return cut, tuple(replace(p, start=max(0.0, p.start), end=min(longest, p.end)) for p in moved)


def read_at(samples: Samples, speed: Array, phones: tuple[Phone, ...]) -> tuple[Samples, tuple[Phone, ...]]:
    """Play samples at a varying speed [N] (1: unchanged), which raises pitch and formants and shortens the times."""
    clock = np.concatenate(([0.0], np.cumsum(1 / speed)))
    played = np.interp(np.arange(int(clock[-1])), clock, np.arange(len(clock), dtype=np.float64))
    out = map_coordinates(samples, played[None], order=3, mode="nearest").astype(np.float32)
    marks = np.array([[p.start, p.end] for p in phones]) * RATE
    times = np.interp(marks, np.arange(len(clock)), clock) / RATE
    return out, tuple(replace(p, start=float(s), end=float(e)) for p, (s, e) in zip(phones, times, strict=True))


def with_tilt(samples: Samples, effort: float) -> Samples:
    """Tilt the spectrum at constant energy, brighter with effort: loud voices have stronger high frequencies."""
    before = float(np.sqrt(np.mean(samples ** 2))) + 1e-9
    shaped = lfilter([1.0, -0.45 * effort], [1.0], samples)
    return np.asarray(shaped * (before / (float(np.sqrt(np.mean(shaped ** 2))) + 1e-9)), dtype=np.float32)


def decibels(value: float) -> float:
    return float(10 ** (value / 20))


def in_a_room(samples: Samples, rng: np.random.Generator) -> Samples:
    """Add an exponential reverb of 0.15 to 0.5 s, 6 to 26 dB below the direct sound; onsets do not move."""
    length = float(rng.uniform(0.15, 0.5))
    below = float(rng.uniform(6, 26))
    time = np.arange(round(length * RATE)) / RATE
    tail = rng.standard_normal(len(time)) * 10 ** (-3 * time / length)
    tail[:round(0.004 * RATE)] = 0
    tail = lfilter([1.0], [1.0, -0.5], tail)
    tail *= decibels(-below) / np.sqrt(np.sum(tail ** 2))
    tail[0] = 1.0
    return np.asarray(oaconvolve(samples, tail.astype(np.float32))[:len(samples)], dtype=np.float32)


def noise_floor(count: int, rng: np.random.Generator) -> Samples:
    """[count] coloured noise of -65 to -45 dBFS: white noise through a one-pole low pass."""
    level, pole = float(rng.uniform(-65, -45)), float(rng.uniform(0.0, 0.97))
    noise = lfilter([np.sqrt(1 - pole ** 2)], [1.0, -pole], rng.standard_normal(count, dtype=np.float32))
    return np.asarray(noise * decibels(level), dtype=np.float32)


def recorded(samples: Samples, active: NDArray[np.bool_], rng: np.random.Generator) -> Samples:
    """Record dry speech: room, a level of -30 to -18 dBFS over the `active` samples, noise; peaks below 1."""
    wet = in_a_room(samples, rng)
    level = float(np.sqrt(np.mean(wet[active] ** 2))) if active.any() else 1.0
    wet *= np.float32(decibels(float(rng.uniform(-30, -18))) / max(level, 1e-9))
    peak = float(np.abs(wet).max(initial=0))
    wet *= np.float32(min(1.0, 0.9 / max(peak, 1e-9)))
    return np.clip(wet + noise_floor(len(wet), rng), -1, 1).astype(np.float32)
