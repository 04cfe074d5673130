"""Can a style be heard? Amplitude, tempo and hand speed told from 8 s of sound, on recordings that were left out.

Theory: ridge regression from what a listener has (loudness, its contrast, the spectrum's shape against it, how often
vowels begin, how much and how long there is silence) to the style that was asked for in the middle of 8 s, and to
log(hand speed + 2 cm/s) over them. Each recording is told by a fit on all others, so its text was never heard; the
penalty is chosen on the others alone. R2 is 1 less the squared error over the squared distance from the mean of the
others, over all windows.

- by sound alone: nothing else is known. This is what an acceptance may claim.
- voice known: the fit also knows which voice it is, so it may learn how that voice sounds in general.
- voice and performer known: besides, who moves.

What fools it: windows of a recording are alike, so few recordings leave a wide interval however many windows there are;
a style that is tied to a voice would be told by the voice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks, stft

from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.store import Recording
from data_module.types import Array, Speech
from eval import stats
from eval.metrics.eye.body import HZ, CommonBody
from eval.stats import Interval

WINDOW, STEP = 8.0, 4.0
"""Seconds of a window, and from one to the next."""
TARGETS = ("amplitude", "tempo", "log hand speed")
KNOWN = ("sound alone", "voice known", "voice and performer known")
PENALTIES = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
FEWEST = 4
"""Recordings from which on there is something to leave out."""
_BANDS = 16
_LOUD = 30.0
"""dB under the loudest 5 % below which a frame is a pause."""
_STILL = 0.02
"""m/s under the logarithm."""


@dataclass(frozen=True)
class StyledWindows:
    """The windows of one recording. features: [n, F]; targets: [n, 3] as in `TARGETS`; voice, performer: names."""

    features: Array
    targets: Array
    voice: str
    performer: str


def windows_of(recording: Recording, body: CommonBody) -> StyledWindows | None:
    """The windows of a recording whose style is known; None where there is none."""
    knots = recording.truth.style if recording.truth else ()
    centres = np.arange(WINDOW / 2, min(recording.speech.duration, body.duration) - WINDOW / 2, STEP)
    if not knots or not len(centres):
        return None
    times = [knot.time for knot in knots]
    amplitude, tempo = (np.interp(centres, times, [getattr(knot, name) for knot in knots]) for name in TARGETS[:2])
    speed = body.hand_speed.mean(axis=1)
    moved = [speed[round((c - WINDOW / 2) * HZ):round((c + WINDOW / 2) * HZ)].mean() for c in centres]
    targets = np.stack([amplitude, tempo, np.log(np.array(moved) + _STILL)], axis=1)
    return StyledWindows(heard(recording.speech, centres), targets, recording.info.voice, recording.info.speaker)


def heard(speech: Speech, centres: Array) -> Array:
    """[n, F] what is heard in the windows about `centres` (seconds)."""
    samples = resample(speech, SAMPLE_RATE).samples.astype(np.float64)
    frequencies, _, spectrum = stft(samples, SAMPLE_RATE, nperseg=512, noverlap=352)
    power = np.abs(spectrum) ** 2
    edges = np.geomspace(100, 7600, _BANDS + 1)
    bands = np.array([power[(frequencies >= low) & (frequencies < max(high, low + 32))].sum(axis=0)
                      for low, high in zip(edges[:-1], edges[1:], strict=True)])
    bands = 10.0 * np.log10(bands + 1e-10)
    middle = 10.0 * np.log10(power[(frequencies >= 300) & (frequencies < 3000)].sum(axis=0) + 1e-10)
    active = middle > np.percentile(middle, 95) - _LOUD
    peaks = find_peaks(np.convolve(middle, np.hanning(9) / np.hanning(9).sum(), "same"), prominence=2.0, distance=6)[0]
    peaks = peaks[active[peaks]]
    return np.array([_window(bands, middle, active, peaks, round((c - WINDOW / 2) * 100)) for c in centres])


def _window(bands: Array, middle: Array, active: NDArray[np.bool_], peaks: NDArray[np.int64], first: int) -> Array:
    """[F] of the frames from `first` on."""
    span = slice(first, first + round(WINDOW * 100))
    spoken = active[span]
    if spoken.sum() < 50:
        spoken = np.ones_like(spoken)
    own, level = bands[:, span][:, spoken], middle[span][spoken]
    begins = np.flatnonzero(np.diff(active[span].astype(int)) == 1)
    rate = ((peaks >= span.start) & (peaks < span.stop)).sum() / max(spoken.sum() / 100.0, 0.5)
    flux = np.abs(np.diff(bands[:, span], axis=1))[:, spoken[1:]].mean(axis=1)
    pauses = [float(b - a) / 100.0 for a, b in stats.runs(~active[span]) if b - a >= 15]  # of 0.15 s or more
    return np.concatenate([
        own.mean(axis=1) - level.mean(), own.std(axis=1), flux,
        [level.mean(), level.std(), np.percentile(level, 90) - np.percentile(level, 30), np.log(rate + 0.5),
         np.log(flux.mean()), 1.0 - active[span].mean(), len(begins), np.log(0.1 + max(pauses, default=0.0)),
         np.log(0.1 + (float(np.mean(pauses)) if pauses else 0.0))]])


def told(recordings: Sequence[StyledWindows]) -> dict[str, dict[str, Interval]]:
    """Of each of `KNOWN`: R2 of each of `TARGETS` with a bootstrap interval over recordings; empty for fewer than
    `FEWEST` recordings."""
    if len(recordings) < FEWEST:
        return {}
    voices, performers = _one_hot([r.voice for r in recordings]), _one_hot([r.performer for r in recordings])
    nothing = np.zeros((len(recordings), 0))
    known = dict(zip(KNOWN, (nothing, voices, np.concatenate([voices, performers], axis=1)), strict=True))
    return {name: _scores([(np.column_stack([r.features, np.tile(own, (len(r.features), 1))]), r.targets)
                           for r, own in zip(recordings, rows, strict=True)]) for name, rows in known.items()}


def _one_hot(names: Sequence[str]) -> Array:
    """[n, kinds] which of its kinds each name is."""
    kinds = sorted(set(names))
    return np.array([[float(name == kind) for kind in kinds] for name in names])


def _scores(rows: Sequence[tuple[Array, Array]]) -> dict[str, Interval]:
    """R2 of each target, each recording told by a fit on the others."""
    wrong, apart = np.zeros((len(rows), len(TARGETS))), np.zeros((len(rows), len(TARGETS)))
    for k, (x, y) in enumerate(rows):
        others = [*rows[:k], *rows[k + 1:]]
        mean = np.concatenate([target for _, target in others]).mean(axis=0)
        wrong[k] = ((y - _predicted(others, x)) ** 2).sum(axis=0)
        apart[k] = ((y - mean) ** 2).sum(axis=0)

    def r2(chosen: Array, column: int) -> float:
        return float(1.0 - wrong[chosen, column].sum() / apart[chosen, column].sum())

    return {name: stats.of_set(lambda chosen, c=column: r2(chosen, c), len(rows), basic=False, draws=stats.DRAWS)
            for column, name in enumerate(TARGETS)}


def _predicted(train: Sequence[tuple[Array, Array]], x: Array) -> Array:
    """[n, 3] what ridge regressions on `train` say of features [n, F]; the penalty of each target by five folds."""
    folds = [list(range(start, len(train), 5)) for start in range(min(5, len(train)))]
    wrong = np.zeros((len(PENALTIES), len(TARGETS)))
    for held in folds:
        kept = [pair for k, pair in enumerate(train) if k not in held]
        inside, truth = (np.concatenate([train[k][part] for k in held]) for part in (0, 1))
        wrong += ((_ridge(kept, inside) - truth) ** 2).sum(axis=1)
    best = wrong.argmin(axis=0)
    return _ridge(train, x)[best, :, np.arange(len(TARGETS))].T


def _ridge(train: Sequence[tuple[Array, Array]], x: Array) -> Array:
    """[penalties, n, 3] what ridge regressions on `train` say of features [n, F]."""
    known, targets = (np.concatenate([pair[part] for pair in train]) for part in (0, 1))
    mean, scale, middle = known.mean(axis=0), known.std(axis=0) + 1e-6, targets.mean(axis=0)
    u, s, v = np.linalg.svd((known - mean) / scale, full_matrices=False)
    onto = ((x - mean) / scale) @ v.T
    inside = u.T @ (targets - middle)
    return np.stack([onto @ ((s / (s * s + penalty))[:, None] * inside) + middle for penalty in PENALTIES])
