"""Syllables of speech: vowel onsets, loudness, duration, pitch and prominence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, find_peaks, resample_poly, sosfiltfilt

from data_module.types import Array, Samples, Speech, Word
from gesticulator_performer.tables import table

HOP = 0.01
"""Seconds between the measurements of loudness and pitch."""
LOWEST, HIGHEST = 60.0, 420.0
"""Range of the pitch search, hertz: from a creaking bass to a high voice."""
FUNCTION_WORDS = {language: frozenset(words.split())
                  for language, words in table("words.toml")["function_words"].items()}


@dataclass(frozen=True)
class Syllable:
    """A spoken syllable, seconds. `vowel` is the onset of its vowel, where a gesture's beat belongs.

    word: index into the words of the speech. loudness: dB against the recording's median syllable. pitch: semitones
    against the recording's median (0 where unvoiced). prominence: z-score, the weighted sum of loudness, duration and
    pitch with a bonus for content words.
    """

    start: float
    vowel: float
    end: float
    word: int
    loudness: float
    pitch: float
    prominence: float


@dataclass(frozen=True)
class Phrase:
    """A stretch of speech between pauses, seconds, with the effort (-1 to 1) it was spoken with."""

    start: float
    end: float
    effort: float


@dataclass(frozen=True)
class Spoken:
    """Speech with everything that the performer uses; `speech.words` holds the words, `language` is ISO 639-1."""

    speech: Speech
    syllables: tuple[Syllable, ...]
    phrases: tuple[Phrase, ...]
    language: str


@dataclass(frozen=True)
class Nucleus:
    """Start, vowel onset and end of a syllable (seconds), and the index of its word (-1: unknown)."""

    start: float
    vowel: float
    end: float
    word: int


def is_function_word(text: str, language: str = "en") -> bool:
    return re.sub(r"[^\w']", "", text.lower()) in FUNCTION_WORDS.get(language, ())


def listen(speech: Speech, phrases: Sequence[Phrase], nuclei: Sequence[Nucleus] | None = None,
           language: str = "en") -> tuple[Syllable, ...]:
    """The syllables of speech with their prominence. nuclei: the known syllable times; without them vowels are detected
    in the signal, within the words if they are known, else within the phrases. prominence = .5 loudness + .4 duration +
    .5 pitch (each a z-score over the recording), content words +.3, function words -.9."""
    level, pitch = loudness(speech), pitch_track(speech.samples, speech.sample_rate)
    places = list(nuclei) if nuclei is not None else find_nuclei(speech, phrases, pitch)
    if not places:
        return ()
    loud = np.array([level[_frames(p.vowel, min(p.end, p.vowel + 0.2), len(level))].max() for p in places])
    high = _semitones(pitch, places)
    long = np.log(np.array([max(p.end - p.start, 0.03) for p in places]))
    loud -= np.median(loud)
    score = 0.5 * _z(loud) + 0.4 * _z(long) + 0.5 * _z(high)
    words = speech.words or ()
    for index, place in enumerate(places):
        if place.word >= 0:
            score[index] += -0.9 if is_function_word(words[place.word].text, language) else 0.3
    return tuple(Syllable(p.start, p.vowel, p.end, p.word, float(a), float(b), float(c))
                 for p, a, b, c in zip(places, loud, high, score, strict=True))


def find_syllables(speech: Speech, language: str) -> Spoken:
    """The phrases and syllables of a real voice, detected in the signal (and in the words, if they are known)."""
    phrases = find_phrases(speech)
    return Spoken(speech, listen(speech, phrases, language=language), phrases, language)


def loudness(speech: Speech) -> Array:
    """[T] dB of the RMS of 20 ms every 10 ms; frame t is centred on t * 10 ms."""
    hop = round(HOP * speech.sample_rate)
    count = len(speech.samples) // hop + 1
    padded = np.pad(speech.samples.astype(np.float64) ** 2, (hop, 2 * hop))
    total = np.concatenate(([0.0], np.cumsum(padded)))
    first = np.arange(count) * hop
    power = np.maximum(total[first + 2 * hop] - total[first], 0) / (2 * hop)
    return np.asarray(10 * np.log10(power + 1e-9))


def pitch_track(samples: Samples, sample_rate: int) -> Array:
    """[T] Hz every 10 ms, frame t centred on t * 10 ms, 0 where unvoiced. The peak of the autocorrelation divided by
    that of the window (Boersma 1993), with a slight preference for short lags."""
    rate = 8000
    low = resample_poly(samples, rate, sample_rate) if sample_rate != rate else samples
    size, hop, padded_size = 320, round(HOP * rate), 512
    count = len(samples) * rate // sample_rate // hop + 1
    padded = np.pad(np.asarray(low, dtype=np.float32), (size // 2, size + hop))
    window = np.hanning(size).astype(np.float32)
    shape = np.fft.irfft(np.abs(np.fft.rfft(window, padded_size)) ** 2)
    shortest, longest = int(rate / HIGHEST), int(rate / LOWEST)
    lags = np.arange(shortest, longest + 1)
    weight = shape[0] / shape[lags] * (1 - 0.12 * np.log2(lags / shortest) / np.log2(longest / shortest))
    track = np.zeros(count)
    frames = np.lib.stride_tricks.sliding_window_view(padded, size)[::hop][:count]
    for first in range(0, count, 4096):
        block = frames[first:first + 4096]
        block = (block - block.mean(axis=1, keepdims=True)) * window
        power = np.abs(np.fft.rfft(block, padded_size, axis=1)) ** 2
        correlation = np.fft.irfft(power, axis=1)
        quiet = correlation[:, 0] < 1e-3
        score = correlation[:, lags] / (correlation[:, :1] + 1e-12) * weight
        best = score.argmax(axis=1)
        inner = np.clip(best, 1, len(lags) - 2)
        row = np.arange(len(block))
        left, middle, right = score[row, inner - 1], score[row, inner], score[row, inner + 1]
        bend = left - 2 * middle + right
        shift = np.where(np.abs(bend) > 1e-9, 0.5 * (left - right) / np.where(bend == 0, 1, bend), 0)
        hertz = rate / (lags[inner] + np.clip(shift, -0.5, 0.5))
        track[first:first + len(block)] = np.where((score[row, best] > 0.5) & ~quiet, hertz, 0)
    return track


def find_nuclei(speech: Speech, phrases: Sequence[Phrase], pitch: Array) -> list[Nucleus]:
    """Detect vowels: peaks of at least 2 dB in the voiced energy of 300 to 2500 Hz, at least 90 ms apart. The vowel
    onset is where the energy rises fastest before the peak; syllables meet at the minima between peaks."""
    band = butter(2, (300, 2500), "bandpass", fs=speech.sample_rate, output="sos")
    voice = Speech(sosfiltfilt(band, speech.samples).astype(np.float32), speech.sample_rate)
    level = gaussian_filter1d(loudness(voice), 2.0)
    spans = [(w.start, w.end, i) for i, w in enumerate(speech.words) if w.text] if speech.words else \
            [(p.start, p.end, -1) for p in phrases]
    floor = float(np.percentile(level, 95)) - 30
    peaks, _ = find_peaks(level, prominence=2, distance=9, height=floor)
    voiced = gaussian_filter1d((pitch > 0).astype(float), 2.0)
    peaks = peaks[voiced[np.minimum(peaks, len(voiced) - 1)] > 0.3]
    rise = np.gradient(level)
    nuclei: list[Nucleus] = []
    for start, end, word in spans:
        inside = peaks[(peaks * HOP >= start) & (peaks * HOP < end)]
        if len(inside) == 0 and word >= 0:
            frames = _frames(start, end, len(level))
            inside = np.array([frames.start + int(level[frames].argmax())])
        valleys = [a + int(level[a:b + 1].argmin()) for a, b in zip(inside.tolist(), inside[1:].tolist(), strict=False)]
        cuts = [start, *(HOP * valley for valley in valleys), end]
        for peak, left, right in zip(inside, cuts, cuts[1:], strict=False):
            first = min(max(int(np.ceil(left / HOP)), peak - 15), peak)
            onset = first + int(rise[first:peak + 1].argmax())
            nuclei.append(Nucleus(left, float(np.clip(onset * HOP, left, right)), right, word))
    return nuclei


def find_phrases(speech: Speech, gap: float = 0.25) -> tuple[Phrase, ...]:
    """Stretches between pauses of `gap` seconds or more, from the words if they are known, else from loudness. effort:
    the phrase's loudness relative to the median phrase, 6 dB for 1, clipped to [-1, 1]."""
    level = loudness(speech)
    spans = _joined([w for w in speech.words if w.text], gap) if speech.words else _loud_spans(level, gap)
    louds = np.array([np.percentile(level[_frames(start, end, len(level))], 80) for start, end in spans])
    efforts = np.clip((louds - np.median(louds)) / 6, -1, 1) if len(louds) else louds
    return tuple(Phrase(start, end, float(effort)) for (start, end), effort in zip(spans, efforts, strict=True))


def _joined(words: Sequence[Word], gap: float) -> list[tuple[float, float]]:
    spans: list[tuple[float, float]] = []
    for word in words:
        if spans and word.start - spans[-1][1] < gap:
            spans[-1] = (spans[-1][0], max(word.end, spans[-1][1]))
        else:
            spans.append((word.start, word.end))
    return spans


def _loud_spans(level: Array, gap: float) -> list[tuple[float, float]]:
    smooth = gaussian_filter1d(level, 3.0)
    threshold = max(float(np.percentile(smooth, 95)) - 28, float(np.percentile(smooth, 5)) + 6)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (smooth > threshold).astype(int), [0]))))
    pieces = [Word("x", a * HOP, b * HOP) for a, b in edges.reshape(-1, 2)]
    return [(start, end) for start, end in _joined(pieces, gap) if end - start > 0.08]


def _frames(start: float, end: float, count: int) -> slice:
    first = min(max(round(start / HOP), 0), count - 1)
    return slice(first, min(max(round(end / HOP), first + 1), count))


def _semitones(pitch: Array, places: Sequence[Nucleus]) -> Array:
    voiced = pitch[pitch > 0]
    if len(voiced) == 0:
        return np.zeros(len(places))
    middle = float(np.median(voiced))
    medians = np.zeros(len(places))
    for index, place in enumerate(places):
        inside = pitch[_frames(place.vowel, place.end, len(pitch))]
        inside = inside[inside > 0]
        if len(inside):
            semitones = 12 * np.log2(inside / middle)
            # A jump of an octave is an error of the pitch tracker.
            folded = semitones - 12 * np.sign(semitones)
            medians[index] = float(np.median(np.where(np.abs(semitones) > 9, folded, semitones)))
    return medians


def _z(values: Array) -> Array:
    return np.asarray(np.clip((values - values.mean()) / (values.std() + 1e-6), -3, 3))
