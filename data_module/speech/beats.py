"""Onsets of the sound, and the beats that speech and motion are cut at (RG 4.2.1).

Onsets are found with a look-ahead of `LOOK_AHEAD` seconds and beats with one of d_max + d_min more; nothing needs the
loudest moment of the recording, so a stream gets what a file gets. The rule that the paper prints, which needs the
whole recording, is kept as the option "paper"; "even" hears nothing and gives blocks of one fixed length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.speech.silence import FRAME, QUIETEST, frame_levels, noise_floor, quietest, silent_frames
from data_module.types import Array, BeatFlag, Beats, Samples, Speech

RULES = ("bounded", "strongest", "paper", "even")
LOOK_AHEAD = 0.25
"""Seconds of sound after an onset that `detect_onsets` needs to be sure of it."""

_HOP = 0.01
"""Seconds between spectra."""
_WINDOW = 0.128
"""Seconds of a spectrum, librosa's usual 2048 samples at 16 kHz."""
_BANDS = 128
"""Mel bands, librosa's usual number."""
_LAG = 3
"""Spectra (30 ms) over which the rise is taken."""
_FAINTEST = 1e-6
"""Mel power that counts as nothing: what white noise of -80 dBFS has."""
_AROUND = 0.1
"""Seconds on both sides of a peak that make its surroundings."""
_PEAK = 0.03
"""Seconds on both sides in which a peak is the highest."""
_RISE = 1.2
"""Decibels that a peak stands above its surroundings."""
_AUDIBLE = (-0.02, 0.08)
"""Seconds about an onset in which a frame must be louder than the noise."""
_PIECE = 4000
"""Spectra (40 s) that are computed at a time: an hour's would not fit."""
_EPS = 1e-9
"""Seconds: what is closer is the same time."""


@dataclass(frozen=True)
class BeatSettings:
    """How beats are placed. Seconds; every interval between beats lies in [d_min, d_max].

    merge: onsets closer than this count as one. rule: "bounded", the first onset in reach; "strongest", the one of them
    at which the sound rises most; "paper" (RG 4.2.1, guarded); or "even": beats d_max apart whatever the sound, for a
    codec of a fixed rate such as RACER's. Only "even" may have d_min = d_max: no
    remainder could be divided then, and the last two intervals share it, each d_max / 2 or longer.
    """

    d_min: float = 0.2
    d_max: float = 0.5
    merge: float = 0.05
    rule: str = "bounded"

    def __post_init__(self) -> None:
        if not 0 < self.d_min < np.inf or not self.d_max < np.inf:
            raise InputError("d_min", f"is {self.d_min}, which is no interval between beats", "give 0.2, for example")
        one_rate = self.rule == "even" and abs(self.d_max - self.d_min) <= _EPS
        if self.d_max < 2 * self.d_min - _EPS and not one_rate:
            raise InputError("d_max", f"is {self.d_max}, less than twice d_min ({self.d_min})",
                             "an interval that is too long must be divisible into two that are not too short")
        if not self.merge >= 0:
            raise InputError("merge", f"is {self.merge}", "give 0 or more seconds")
        if self.rule not in RULES:
            raise InputError("rule", f"is {self.rule!r}", f"choose from {', '.join(RULES)}")


def detect_onsets(samples: Samples, sample_rate: int, merge: float = 0.05) -> Array:
    """Onsets of the sound in seconds, rising, [n].

    A peak of librosa's onset strength (the mean rise of the log-mel bands over 30 ms) that stands 1.2 dB above its
    surroundings of 0.1 s on both sides and is louder than the running noise floor. Decibels make the threshold
    independent of the gain, so nothing is scaled by the file's maximum. Of onsets closer than `merge` seconds the
    first stays.
    """
    strength = onset_strength(samples, sample_rate)
    peaks = _peaks(strength, round(_PEAK / _HOP), round(_AROUND / _HOP))
    # A window of the spectrum sees a rise half a window early; of the plateau that `_LAG` makes, the first is the peak.
    times = peaks * _HOP + (_WINDOW / 2 // _HOP - (_LAG - 1)) * _HOP
    audible = ~silent_frames(samples, sample_rate)
    before = np.concatenate([[0], np.cumsum(audible)])
    first, last = (np.clip(np.round((times + shift) / FRAME).astype(int), 0, len(audible)) for shift in _AUDIBLE)
    return merged(times[before[last] > before[first]], merge)


def strength_at(samples: Samples, sample_rate: int, onsets: Array) -> Array:
    """How much the sound rises at onsets of `detect_onsets` [n] seconds: dB, [n]."""
    strength = onset_strength(samples, sample_rate)
    frames = np.round(onsets / _HOP - (_WINDOW / 2 // _HOP - (_LAG - 1))).astype(int)
    return np.asarray(strength[np.clip(frames, 0, len(strength) - 1)])


def merged(times: Array, closest: float) -> Array:
    """Rising times with every one dropped that is closer than `closest` to the last one kept."""
    kept: list[float] = []
    for time in np.asarray(times, dtype=np.float64):
        if not kept or time - kept[-1] >= closest - _EPS:
            kept.append(float(time))
    return np.array(kept)


def onset_strength(samples: Samples, sample_rate: int) -> Array:
    """librosa's onset strength in dB every 10 ms, [F]; value f belongs to the spectrum centred on f / 100 s."""
    import librosa

    hop = round(_HOP * sample_rate)
    window = 2 * round(_WINDOW * sample_rate / 2)
    bands = librosa.filters.mel(sr=sample_rate, n_fft=window, n_mels=_BANDS, fmax=sample_rate / 2)
    frames = len(samples) // hop + 1
    padded = np.concatenate([np.zeros(window // 2 + _LAG * hop, np.float32), samples,
                             np.zeros(window // 2 + hop, np.float32)])
    covered = _covered(window, hop)
    faintest = _faintest(samples, sample_rate, frames)
    strength = np.empty(frames)
    for start in range(0, frames, _PIECE):  # an hour's spectrogram would not fit
        stop = min(start + _PIECE, frames)
        piece = padded[start * hop:(stop + _LAG - 1) * hop + window]
        spectrum = librosa.stft(piece, n_fft=window, hop_length=hop, center=False)
        power = bands @ (spectrum.real ** 2 + spectrum.imag ** 2)
        power /= covered[np.minimum(np.arange(start - _LAG, stop), len(covered) - 1).clip(0)]
        decibels = 10.0 * np.log10(np.maximum(power, faintest[np.arange(start - _LAG, stop).clip(0)]))
        rise = librosa.onset.onset_strength(S=decibels, sr=sample_rate, lag=_LAG, center=False)
        strength[start:stop] = rise[_LAG:_LAG + stop - start]
    strength[:_LAG] = 0.0  # nothing but padding lies before them
    # Single precision leaves ties open; rounding closes them the same way in every piece.
    return np.round(strength, 3)


def _faintest(samples: Samples, sample_rate: int, frames: int) -> NDArray[np.float32]:
    """The mel power [F] that counts as nothing: `_FAINTEST`, and as much less as silence begins lower."""
    levels = frame_levels(samples, sample_rate)
    lower = quietest(levels, noise_floor(levels)) - QUIETEST
    lower = np.concatenate([lower, np.repeat(lower[-1:], max(0, frames - len(lower)))])[:frames]
    return np.float32(_FAINTEST) * (10.0 ** (lower / 10.0)).astype(np.float32)


def _covered(window: int, hop: int) -> Array:
    """Share of the power of the first spectra's windows that lies in the recording, until it is 1: a recording that
    begins in steady sound rises only because the windows fill, and that is no onset."""
    power = np.hanning(window + 1)[:-1] ** 2
    inside = np.cumsum(power[::-1])[::-1] / power.sum()
    return np.concatenate([inside[window // 2::-hop], [1.0]])


def _peaks(strength: Array, reach: int, around: int) -> NDArray[np.int64]:
    """Frames that are the highest within `reach` frames and `_RISE` above the mean within `around` frames."""
    count = len(strength)
    padded = np.pad(strength, reach, constant_values=-np.inf)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1)
    total = np.concatenate([[0.0], np.cumsum(strength)])
    low = np.maximum(np.arange(count) - around, 0)
    high = np.minimum(np.arange(count) + around + 1, count)
    mean = (total[high] - total[low]) / (high - low)
    return np.flatnonzero((strength >= highest) & (strength >= mean + _RISE))


def next_beat(beat: float, onsets: Array, loud: Array, end: float | None,
              settings: BeatSettings, strengths: Array | None = None) -> tuple[float, BeatFlag]:
    """The beat that follows `beat` by the bounded rule (or, with strengths, the strongest), and why it stands there.

    onsets, loud: rising seconds of the onsets and of the frames louder than the noise. end: the end of the recording,
    None while it is not known. strengths: dB of the onsets; of those in reach the first of the strongest is taken, and
    without strengths the first. Only what lies before beat + d_max + d_min is looked at; `end` must be told when it
    lies there.
    """
    low, high = beat + settings.d_min, beat + settings.d_max
    horizon = high + settings.d_min
    if end is not None and end >= horizon:
        end = None
    first_near = int(np.searchsorted(onsets, low - _EPS))
    near = onsets[first_near:np.searchsorted(onsets, horizon)]
    fits = (near <= high + _EPS) & (True if end is None else end - near >= settings.d_min - _EPS)
    if fits.any():
        rises = None if strengths is None else strengths[first_near:first_near + len(near)]
        at = int(fits.argmax()) if rises is None else int(np.where(fits, rises, -np.inf).argmax())
        return float(near[at]), BeatFlag.ONSET
    if end is not None and end <= high + _EPS:
        return end, BeatFlag.BOUNDARY
    # Leave room for what comes next: an onset (even one that the end will rule out: it cannot be known yet), the end.
    ahead = [float(onset) for onset in near[near > high + _EPS][:1]] + ([end] if end is not None else [])
    latest = max(low, min([high, *(time - settings.d_min for time in ahead)]))
    first = int(np.searchsorted(loud, low - _EPS))
    if first < len(loud) and loud[first] <= latest + _EPS:
        return float(np.clip(loud[first], low, latest)), BeatFlag.LOUD_PSEUDO
    return latest, BeatFlag.EVEN_PSEUDO


def place_beats(onsets: Array, loud: Array, duration: float, settings: BeatSettings | None = None,
                strengths: Array | None = None) -> Beats:
    """Beats from onsets: a pure function of rising seconds (RG 4.2.1; `next_beat`, `_paper_beats` and `_even_beats`
    tell the rules).

    onsets: [n]; loud: [m] the times of the frames louder than the noise; strengths: [n] dB of the onsets, for the rule
    "strongest". 0 and `duration` are beats. Every interval
    lies in [d_min, d_max], unless the whole recording is shorter than d_min, or d_min = d_max (`_even_beats`).
    """
    settings = settings or BeatSettings()
    every, onsets = np.asarray(onsets, dtype=np.float64), merged(onsets, settings.merge)
    if settings.rule != "strongest":
        strengths = None
    elif strengths is None or len(strengths) != len(every):
        raise ValueError("the strongest onset is found by the strengths of all of them")
    else:
        strengths = strengths[np.searchsorted(every, onsets)]
    loud = np.asarray(loud, dtype=np.float64)
    if settings.rule == "even":
        return _even_beats(duration, settings)
    if settings.rule == "paper":
        beats = _paper_beats(onsets, loud, duration, settings)
    else:
        beats = [(0.0, BeatFlag.BOUNDARY)]
        while beats[-1][0] < duration:
            beats.append(next_beat(beats[-1][0], onsets, loud, duration, settings, strengths))
    return Beats(np.array([time for time, _ in beats]), np.array([flag for _, flag in beats], dtype=np.int8))


def _paper_beats(onsets: Array, loud: Array, duration: float, settings: BeatSettings) -> list[tuple[float, BeatFlag]]:
    """RG 4.2.1 with its holes closed: a pseudo-beat keeps d_min to both neighbours and both sides are filled again."""
    beats = [(0.0, BeatFlag.BOUNDARY)]
    for onset in onsets:
        if onset - beats[-1][0] >= settings.d_min - _EPS and duration - onset >= settings.d_min - _EPS:
            beats.append((float(onset), BeatFlag.ONSET))
    beats.append((duration, BeatFlag.BOUNDARY))
    done = beats[:1]
    todo = beats[:0:-1]  # a stack: the next beat to reach is its last
    while todo:
        start, stop = done[-1][0], todo[-1][0]
        gap = stop - start
        if gap <= settings.d_max + _EPS:
            done.append(todo.pop())
            continue
        first = int(np.searchsorted(loud, start + settings.d_min - _EPS))
        if first < len(loud) and loud[first] <= stop - settings.d_min + _EPS:
            time = float(np.clip(loud[first], start + settings.d_min, stop - settings.d_min))
            todo.append((time, BeatFlag.LOUD_PSEUDO))
            continue
        pieces = int(np.ceil(gap / settings.d_max - _EPS))
        done += [(start + gap * piece / pieces, BeatFlag.EVEN_PSEUDO) for piece in range(1, pieces)]
    return done


def _even_beats(duration: float, settings: BeatSettings) -> Beats:
    """Beats d_max apart: what the bounded rule gives where nothing is heard.

    When less than d_min is left at the end, the last beat but one moves forward to d_min before the end, so the
    remainder is shared by the last two intervals. With d_min = d_max nothing shorter than d_max is allowed and nothing
    longer fits in a block; there d_max / 2 stands for d_min, and it is the last two intervals alone that may be
    shorter than d_max.
    """
    shortest = min(settings.d_min, settings.d_max / 2)
    count = max(1, int(np.ceil(duration / settings.d_max - _EPS)))
    # Multiples, not a running sum: an hour of steps must not drift.
    times = np.arange(count + 1, dtype=np.float64) * settings.d_max
    times[-1] = duration
    if count > 1:
        times[-2] = min(times[-2], duration - shortest)
    flags = np.full(count + 1, BeatFlag.EVEN_PSEUDO, dtype=np.int8)
    flags[[0, -1]] = BeatFlag.BOUNDARY
    return Beats(times, flags)


def find_beats(speech: Speech, settings: BeatSettings | None = None) -> Beats:
    """The beats of a recording: its onsets, pseudo-beats between them, its start and its end (RG 4.2.1)."""
    settings = settings or BeatSettings()
    if settings.rule == "even":
        return _even_beats(speech.duration, settings)
    onsets = detect_onsets(speech.samples, speech.sample_rate, settings.merge)
    audible = ~silent_frames(speech.samples, speech.sample_rate)
    loud = np.flatnonzero(audible).astype(np.float64) * FRAME
    strengths = (strength_at(speech.samples, speech.sample_rate, onsets) if settings.rule == "strongest" else None)
    return place_beats(onsets, loud, speech.duration, settings, strengths)
