"""Levels of a recording: silence relative to a running noise floor, pauses, and the typical level and pitch of the
voice.

The look-ahead is at most `LOOK_AHEAD` seconds, and nothing depends on what is loudest later in the recording, so a
stream gives the same result as a file. All limits are relative to the loudest 0.1 s so far, so the same recording at
another level gives the same result; the absolute ones, `QUIETEST` and below, only matter for what is silent before the
first word and in a recording that is about 20 dB too low.
"""

import itertools
import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, Samples, Speech

FRAME = 0.01
"""Seconds of a frame; frame f covers [f, f + 1) x FRAME."""
MEMORY = 10.0
"""Seconds of the past from which the noise floor is estimated."""
MARGIN = 6.0
"""Decibels above the floor at which sound begins: steady noise stays below, quiet speech rises above."""
QUIETEST = -70.0
"""dBFS below which everything is silent whatever the floor, unless all of the recording so far was faint."""
BELOW_LOUDEST = 35.0
"""Silence limit, decibels under the loudest 0.1 s so far. Speech usually reaches -25 dBFS (the lowest of eleven
recordings reached -23), so that its limit is about -60."""
FAINTEST_SPEECH = -90.0
"""Least level of speech, dBFS. 16 bits end at -98, and the last bit is noise."""
FAINT_EVIDENCE = 1.5
"""Seconds of sound above the noise after which the limit may be below `QUIETEST`: breaths and handling before the first
word are shorter (at most 0.7 s in eleven recordings)."""
SHORTEST_PAUSE = 0.35
"""Least length of a pause, seconds; a shorter gap is part of the speech (the closure of a stop lasts up to 0.2 s)."""
LOOK_AHEAD = SHORTEST_PAUSE + 0.05
"""Seconds of sound after a frame that are needed to classify it: a pause, and in the first second half a step of the
noise floor."""

TYPICAL_LEVEL = -26.0
"""Mean level of the loud frames of well recorded speech, dBFS (active level about -23)."""

STEP = 10
"""Frames that are averaged and classified at a time: 0.1 s."""

_PERCENTILE = 0.1
_START, _START_CAP = 1.0, 20.0  # seconds, and decibels under the loudest 0.1 s so far
_NOISE_RANGE = 8.0  # decibels between the loudest and the faintest 0.1 s of a room's noise: 1 to 5 in ten recordings
_STEADY = 2.0  # decibels between the loudest and the faintest 0.1 s; white noise of a second has 0.5
_BLIP = 2
_NEARLY_ALL = 0.9
_PIECE = 10_000  # frames
_FAINTEST = -120.0
_VOICE_PRIOR, _VOICE_MEMORY = 5.0, 30.0  # seconds of speech
# Decibels by which the mean of the loud frames is below the loudest 0.1 s of the first second of speech (-1 to 10, mean
# 5, in eleven recordings).
_VOICE_BELOW = 6.0
# Decibels by which a voice is expected above the noise before the first word.
_VOICE_ABOVE = 20.0


def frame_levels(samples: Samples, sample_rate: int) -> Array:
    """RMS of each frame in dBFS (a full-scale sine is -3), [F]; the last frame may be short."""
    size = max(1, round(FRAME * sample_rate))
    whole = len(samples) // size
    power = np.empty(-(-len(samples) // size))
    for start in range(0, whole, _PIECE):  # in double precision a whole hour would not fit
        frames = samples[start * size:min(start + _PIECE, whole) * size].reshape(-1, size).astype(np.float64)
        # Each frame is summed separately, so that the result does not depend on its position.
        power[start:start + len(frames)] = np.add.reduce(frames * frames, axis=1) / size
    if whole < len(power):
        power[whole] = np.mean(samples[whole * size:].astype(np.float64) ** 2)
    return 10.0 * np.log10(np.maximum(power, 10.0 ** (_FAINTEST / 10.0)))


@dataclass(frozen=True)
class LoudnessStep:
    """Some frames [F] of sound: their levels in dBFS, the noise floor, the level below which everything is silent
    (`BELOW_LOUDEST`), the level from which a rise is counted, the silent frames, and the level that the voice should
    have, judging by the loudest 0.1 s so far. While there is little evidence of a voice, a rise is counted from the
    noise: from an absolute level, the first onsets would depend on the gain.
    """

    levels: Array
    floor: Array
    limit: Array
    ground: Array
    silent: NDArray[np.bool_]
    expected: Array


class LoudnessTracker:
    """Noise floor and silence of streamed sound. The floor is a low percentile of the past `MEMORY` seconds of levels
    averaged over steps of 0.1 s (`STEP` frames), which reduces the variance of steady noise. A frame is classified at
    once, by the steps before its own. In the first second there is little past: there a step is classified by itself,
    when it is complete, and the floor is that of an ordinary room, 20 dB under the loudest 0.1 s, as soon as the level
    varies more than that of noise."""

    def __init__(self) -> None:
        self._means: deque[float] = deque(maxlen=round(MEMORY / (FRAME * STEP)))
        self._current = np.zeros(0)  # the levels of the step that is not complete
        self._steps = self._above_noise = 0
        self._percentile = 0.0
        self._loudest, self._faintest = -math.inf, math.inf

    def step(self, levels: Array, ended: bool = False) -> LoudnessStep:
        """The frames that are certain after some more levels [F] and, if the sound has ended with them, the rest."""
        out = []
        while len(levels) or (ended and len(self._current)):
            lacking = STEP - len(self._current)
            new, levels = levels[:lacking], levels[lacking:]
            self._current = np.concatenate([self._current, new])
            whole = len(self._current) == STEP or (ended and not len(levels))
            if not self._early and len(new):
                out.append(self._classified(new))
            if whole:
                self._learn()
                if self._early:
                    out.append(self._classified(self._current))
                self._current = np.zeros(0)
                self._steps += 1
        return _joined(out)

    @property
    def _early(self) -> bool:
        return self._steps * STEP * FRAME < _START

    def _learn(self) -> None:
        """Take the current step into the floor."""
        mean = _step_mean(self._current)
        self._means.append(mean)
        # A percentile and no minimum, which a single dropout of the sound would set for ten seconds.
        self._percentile = sorted(self._means)[int(_PERCENTILE * (len(self._means) - 1))]
        self._loudest, self._faintest = max(self._loudest, mean), min(self._faintest, max(mean, QUIETEST))

    def _classified(self, levels: Array) -> LoudnessStep:
        floor, spoken = self._percentile, self._loudest > self._faintest + _NOISE_RANGE
        if spoken and self._early:
            floor = min(floor, self._loudest - _START_CAP)
        under = max(self._loudest - BELOW_LOUDEST, FAINTEST_SPEECH)
        limit = ground = np.full(len(levels), under)
        if self._above_noise * FRAME < FAINT_EVIDENCE:
            count = self._above_noise + np.cumsum(levels > floor + MARGIN)
            self._above_noise = int(count[-1])
            evident = count * FRAME >= FAINT_EVIDENCE
            limit = np.where(evident, under, max(under, QUIETEST))
            noise = floor if floor > FAINTEST_SPEECH else QUIETEST  # without noise there is no other measure
            ground = np.where(evident, under, max(under, noise))
        expected = self._loudest + (-_VOICE_BELOW if spoken else _VOICE_ABOVE)
        silent = levels <= np.maximum(floor + MARGIN, limit)
        return LoudnessStep(levels, np.full(len(levels), floor), limit, ground, silent, np.full(len(levels), expected))


def _step_mean(levels: Array) -> float:
    return float(np.concatenate([levels, np.repeat(levels[-1:], STEP - len(levels))]).mean())


def _joined(steps: Sequence[LoudnessStep]) -> LoudnessStep:
    if len(steps) == 1:  # most pieces of a stream end within a step
        return steps[0]
    none = np.zeros(0)
    every = LoudnessStep(none, none, none, none, np.zeros(0, bool), none), *steps
    return LoudnessStep(*(np.concatenate([getattr(step, field.name) for step in every])
                          for field in fields(LoudnessStep)))


def loudness(levels: Array) -> LoudnessStep:
    """The result of `LoudnessTracker` for all frames [F] of a recording."""
    return LoudnessTracker().step(levels, ended=True)


def silent_frames(samples: Samples, sample_rate: int) -> NDArray[np.bool_]:
    return loudness(frame_levels(samples, sample_rate)).silent


class PauseTracker:
    """Streaming detection of pauses of at least `SHORTEST_PAUSE` in silent frames; before the start there is silence.
    One or two loud frames (a click) do not end a pause. Results are returned as soon as they are certain: for a frame
    of a pause when it has lasted long enough, for a frame of speech at once."""

    def __init__(self) -> None:
        self._shortest = round(SHORTEST_PAUSE / FRAME)
        self._speaks = False
        self._blip = self._held = 0
        self._run = self._shortest  # frames that the pause has lasted; before the start it was silent

    def step(self, silent: Iterable[bool]) -> list[bool]:
        """The results, in order, that are certain after some more frames; possibly none."""
        certain: list[bool] = []
        for quiet in silent:
            if quiet:
                self._quiet(self._blip + 1, certain)
                self._blip = 0
            elif self._speaks:
                certain.append(False)
            else:
                self._blip += 1
                if self._blip > _BLIP:
                    certain += [False] * (self._held + self._blip)
                    self._speaks, self._blip, self._held, self._run = True, 0, 0, 0
        return certain

    def finish(self) -> list[bool]:
        rest = [True] * self.waiting
        self._blip = self._held = 0
        return rest

    @property
    def waiting(self) -> int:
        """Number of frames without a result, all in a silence that may become a pause."""
        return self._held + self._blip

    def _quiet(self, count: int, certain: list[bool]) -> None:
        self._speaks = False
        self._run, self._held = self._run + count, self._held + count
        if self._run >= self._shortest:
            certain += [True] * self._held
            self._held = 0


def pauses(silent: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The frames in a pause, [F], from silent frames; see `PauseTracker`."""
    tracker = PauseTracker()
    return np.array(tracker.step(silent.tolist()) + tracker.finish(), dtype=bool)


def silent_blocks(speech: Speech, edges: Array) -> NDArray[np.bool_]:
    """True for each block between neighbouring `edges` [N + 1] seconds that lies in a pause, [N]."""
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    first = np.clip(frame_after(edges), 0, len(quiet))
    return np.array([in_pause(quiet[start:stop]) for start, stop in itertools.pairwise(first)], dtype=bool)


def frame_after(edges: Array) -> NDArray[np.int64]:
    """The first frame of the block that begins at each edge [...] (seconds): a frame belongs to the block that contains
    its middle."""
    return np.ceil(np.asarray(edges) / FRAME - 0.5).astype(np.int64)


def in_pause(quiet: NDArray[np.bool_]) -> bool:
    """Whether a block is silent: at least 0.9 of its frames are in a pause."""
    return len(quiet) > 0 and int(np.count_nonzero(quiet)) >= _NEARLY_ALL * len(quiet)


def frame_before(times: Array) -> NDArray[np.int64]:
    """The frame that contains each of `times` [...] (seconds); on a border the earlier one."""
    return np.ceil(np.asarray(times) / FRAME - 1e-6).astype(np.int64) - 1


class SteadyStart:
    """Silent frames, including steady noise in the first second, where the noise floor is limited: frames up to which,
    and `SHORTEST_PAUSE` on, the level, averaged over steps of 0.1 s, has varied no more than that of noise."""

    def __init__(self) -> None:
        self._early = round(_START / FRAME)  # frames of the first second that were not returned
        self._ahead = STEP * round(SHORTEST_PAUSE / (FRAME * STEP))
        self._least, self._most = math.inf, -math.inf
        self._levels = np.zeros(0)  # of the step that is not complete
        self._waiting = np.zeros(0, bool)  # silent frames that were not returned

    def step(self, levels: Array, silent: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The results [F'] that are certain after some more levels and silent frames [F], possibly from earlier ones.
        """
        self._waiting = np.concatenate([self._waiting, silent])
        if self._early:
            self._levels = np.concatenate([self._levels, levels])
            while len(self._levels) >= STEP:
                step, self._levels = np.split(self._levels, [STEP])
                self._learn(step)
        return self._released()

    def finish(self) -> NDArray[np.bool_]:
        """The remaining results, at the end of the sound."""
        if len(self._levels):
            self._learn(self._levels)
        self._ahead, self._levels = 0, self._levels[:0]
        return self._released()

    def _learn(self, levels: Array) -> None:
        mean = _step_mean(levels)
        self._least, self._most = min(self._least, mean), max(self._most, mean)

    def _released(self) -> NDArray[np.bool_]:
        steady = self._most - self._least < _STEADY
        certain = max(len(self._waiting) - len(self._levels) - self._ahead, 0)
        early = min(certain, self._early) if steady else self._early
        out, self._waiting = self._waiting, self._waiting[:0]
        if early < self._early:
            out, self._waiting = out[:early], out[early:]
        if steady:
            out = np.concatenate([np.ones(early, bool), out[early:]])
        self._early -= min(early, len(out))
        return out


def reference_level(samples: Samples, sample_rate: int, edges: Array) -> Array:
    """The typical level of the voice in dBFS at the end of each block [N]. The mean level of the non-silent frames,
    averaged over 30 s of speech, starting at `LoudnessStep.expected` with the weight of 5 s. Subtracting it removes the
    gain of the recording, while the effort of a phrase, which changes every few seconds, stays in the features."""
    frames, voice = loudness(frame_levels(samples, sample_rate)), VoiceLevel()
    voice.feed(frames)
    return np.array([voice.block(stop) for stop in edges[1:]])


class VoiceLevel:
    """Streaming `reference_level`; edges are given in order."""

    def __init__(self) -> None:
        self._total, self._count, self._first = [0.0], [0], 0  # of the frames up to each, from frame `_first` on
        self._expected = [TYPICAL_LEVEL]
        self._level = self._weight = 0.0

    def feed(self, frames: LoudnessStep) -> None:
        for level, silent in zip(frames.levels.tolist(), frames.silent.tolist(), strict=True):
            self._total.append(self._total[-1] + (0.0 if silent else level))
            self._count.append(self._count[-1] + (not silent))
        self._expected += frames.expected.tolist()

    def block(self, edge: float) -> float:
        """The level at the end of the next block, at `edge` seconds, whose frames have been fed."""
        last = min(max(round(edge / FRAME) - self._first, 0), len(self._total) - 1)
        summed, seconds = self._total[last] - self._total[0], (self._count[last] - self._count[0]) * FRAME
        expected = self._expected[last]
        del self._total[:last], self._count[:last], self._expected[:last]
        self._first += last
        if seconds:
            self._level = (self._level * self._weight + summed * FRAME) / (self._weight + seconds)
            self._weight = min(self._weight + seconds, _VOICE_MEMORY)
        # The expectation fades out with the evidence: after 30 s of speech the level is measured alone.
        prior = _VOICE_PRIOR * (1.0 - self._weight / _VOICE_MEMORY)
        return (prior * expected + self._weight * self._level) / (prior + self._weight)


# ------------------------------------------------------------------------------------------------------ its pitch

# Hertz of voices.
_LOWEST, _HIGHEST = 70.0, 500.0
PITCH_WINDOW, PITCH_HOP = 0.04, 0.01
"""Length of a frame and time between frames, seconds: nearly three periods of the lowest voice."""
# Share of a frame that must repeat for it to be voiced.
_VOICED = 0.5
# Share by which a peak must be higher than one an octave above it: twice the period repeats as well.
_OCTAVE = 0.02
# Mean power of a frame without sound: 16 bits end at -98 dBFS.
_NO_SOUND = 1e-10
# Seconds of voice over which its mean pitch is remembered.
_PITCH_MEMORY = 20.0


def pitch_of(samples: Samples, sample_rate: int) -> tuple[Array, NDArray[np.bool_]]:
    """log2 of the frequency in hertz, and whether the sound is voiced, of each whole frame, both [F].

    By the autocorrelation of the frames (Boersma 1993). A frame's is divided by that of its window, so that the height
    of a peak is the share of the sound that repeats; the lag of the highest peak is the period. samples: [n]; frame f
    covers `PITCH_WINDOW` seconds from f x `PITCH_HOP`. The frequency of an unvoiced frame means nothing.
    """
    size, hop = round(PITCH_WINDOW * sample_rate), round(PITCH_HOP * sample_rate)
    if len(samples) < size:
        return np.zeros(0), np.zeros(0, dtype=bool)
    frames = np.array([samples[start:start + size] for start in range(0, len(samples) - size + 1, hop)], np.float32)
    # An offset would repeat at every lag.
    frames = frames - frames.mean(axis=1, keepdims=True)
    shortest, longest = int(sample_rate / _HIGHEST), int(np.ceil(sample_rate / _LOWEST)) + 1
    window, of_window = _pitch_window(size, longest + 1)
    repeats = _autocorrelation(frames * window, longest + 1)
    power = repeats[:, :1]
    share = np.where(power > _NO_SOUND * size, repeats / np.maximum(power, 1e-30) / of_window, 0.0)
    here, lags = share[:, shortest:longest], np.arange(shortest, longest)
    peak = (here >= share[:, shortest - 1:longest - 1]) & (here >= share[:, shortest + 1:longest + 1])
    height = np.where(peak, here - _OCTAVE * np.log2(lags / shortest), -np.inf)
    best = lags[height.argmax(axis=1)]
    rows = np.arange(len(share))
    left, middle, right = (share[rows, best + step].astype(np.float64) for step in (-1, 0, 1))
    # The vertex of the parabola through the peak and its neighbours: lags are whole samples, too coarse for high
    # voices.
    bend = left - 2.0 * middle + right
    shift = np.where(bend < -1e-12, 0.5 * (left - right) / np.where(bend < -1e-12, bend, 1.0), 0.0)
    return np.log2(sample_rate / (best + np.clip(shift, -0.5, 0.5))), (middle >= _VOICED) & np.isfinite(
        height.max(axis=1))


def _autocorrelation(frames: Samples, lags: int) -> Samples:
    """[F, lags] of frames [F, n], in single precision, which is faster."""
    # Padded with zeros, or the product of spectra would be a circular correlation.
    size = 1 << int(np.ceil(np.log2(frames.shape[1] + lags)))
    spectrum = np.fft.rfft(frames, size, axis=1)
    power = spectrum.real ** 2 + spectrum.imag ** 2
    return np.asarray(np.fft.irfft(power, size, axis=1)[:, :lags], dtype=np.float32)


@lru_cache(maxsize=4)
def _pitch_window(size: int, lags: int) -> tuple[Samples, Samples]:
    """[size] the window of a frame, and [1, lags] the autocorrelation of that window, 1 at lag 0."""
    window = np.hanning(size).astype(np.float32)
    repeats = _autocorrelation(window[None], lags)
    return window, repeats / repeats[:, :1]


class PitchLevel:
    """Pitch of the blocks of a recording, in octaves over the mean of the voice so far."""

    def __init__(self) -> None:
        self._mean, self._seconds = 0.0, 0.0

    def block(self, samples: Samples, sample_rate: int, count: int) -> Array:
        """[count] octaves at equal steps of the block [n], the last at its end; 0 where it is not voiced."""
        logs, voiced = pitch_of(samples, sample_rate)
        if not voiced.any():
            return np.zeros(count)
        seconds = PITCH_HOP * float(voiced.sum())
        self._seconds = min(self._seconds + seconds, _PITCH_MEMORY)
        # A running mean with the weight of the voice so far, limited so that it follows a change of speaker.
        self._mean += (float(logs[voiced].mean()) - self._mean) * min(seconds / self._seconds, 1.0)
        middles = PITCH_WINDOW / 2 + PITCH_HOP * np.arange(len(logs))
        times = len(samples) / sample_rate * np.arange(1, count + 1) / count
        nearest = np.abs(times[:, None] - middles).argmin(axis=1)
        return np.where(voiced[nearest], logs[nearest] - self._mean, 0.0)
