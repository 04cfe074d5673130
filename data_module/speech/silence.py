"""How loud a recording is, frame by frame: where nobody speaks, and how loud the voice generally is.

Silence is a level against a running noise floor.
Nothing here looks further than `LOOK_AHEAD` seconds ahead, and nothing needs the loudest part of the recording, so a
stream gets the same answer as a file.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, Samples, Speech

FRAME = 0.01
"""Seconds of a frame; frame f covers [f, f + 1) x FRAME."""
MEMORY = 10.0
"""Seconds of the past that the noise floor is estimated from."""
MARGIN = 6.0
"""Decibels above the floor where sound begins to count: steady noise stays below, quiet speech rises above."""
QUIETEST = -60.0
"""dBFS: what is fainter counts as silence whatever the floor, unless all of the recording so far was faint."""
BELOW_LOUDEST = 35.0
"""Decibels under the loudest 0.1 s so far where silence begins in a faint recording. Speech reaches -25 dBFS as it is
usually recorded (of eleven recordings tried the least did -22), and there the limit stays at `QUIETEST`."""
FAINTEST_SPEECH = -90.0
"""dBFS: no speech is looked for below it. 16 bits end at -98, and their last bit is noise."""
FAINT_EVIDENCE = 1.5
"""Seconds of sound above the noise and below `QUIETEST` before a recording counts as faint: breaths and handling before
the first word last less (0.7 s at most in the recordings tried)."""
SHORTEST_PAUSE = 0.35
"""Seconds: a shorter gap belongs to the speech around it (a stop consonant's closure lasts up to 0.2 s)."""
LOOK_AHEAD = SHORTEST_PAUSE + 0.05
"""Seconds of sound after a frame that are needed to be sure of it: a pause, and half a step of the noise floor."""

TYPICAL_LEVEL = -26.0
"""dBFS: the mean level of the loud frames of speech recorded as it should be (active level about -23)."""

STEP = 10
"""Frames that are averaged and judged at a time: 0.1 s."""

_PERCENTILE = 0.1
_START, _START_CAP = 1.0, -45.0
_STEADY = 2.0  # decibels between the loudest and the faintest 0.1 s; white noise of a second has 0.5
_BLIP = 2
_NEARLY_ALL = 0.9
_PIECE = 10_000  # frames
_FAINTEST = -120.0
_VOICE_PRIOR, _VOICE_MEMORY = 5.0, 30.0  # seconds of speech


def frame_levels(samples: Samples, sample_rate: int) -> Array:
    """RMS of each frame in dBFS (a full-scale sine is -3), [F]; the last frame may be short."""
    size = max(1, round(FRAME * sample_rate))
    whole = len(samples) // size
    power = np.empty(-(-len(samples) // size))
    for start in range(0, whole, _PIECE):  # in double precision a whole hour would not fit
        frames = samples[start * size:min(start + _PIECE, whole) * size].reshape(-1, size).astype(np.float64)
        # Each frame is summed by itself, so that it comes out alike wherever it stands.
        power[start:start + len(frames)] = np.add.reduce(frames * frames, axis=1) / size
    if whole < len(power):
        power[whole] = np.mean(samples[whole * size:].astype(np.float64) ** 2)
    return 10.0 * np.log10(np.maximum(power, 10.0 ** (_FAINTEST / 10.0)))


@dataclass(frozen=True)
class LoudnessStep:
    """Some frames [F] of sound: their levels in dBFS, the noise floor under them, what is silent whatever the floor
    (`quietest`), and which of them are no louder than the noise."""

    levels: Array
    floor: Array
    limit: Array
    silent: NDArray[np.bool_]


class LoudnessTracker:
    """Noise floor and silence of sound as it arrives, a step of 0.1 s (10 frames) at a time; the last may be shorter.

    The floor is a low percentile of the past `MEMORY` seconds. Levels are first averaged over a step, which makes
    steady noise steady. In the first second there is hardly a past, so a floor above an ordinary room is not believed
    yet.
    """

    def __init__(self) -> None:
        self._means: deque[float] = deque(maxlen=round(MEMORY / (FRAME * STEP)))
        self._steps = self._faint = 0
        self._loudest = -math.inf

    def step(self, levels: Array) -> LoudnessStep:
        """The next frames, 1 to 10 of them; fewer than 10 are the last."""
        mean = _step_mean(levels)
        self._means.append(mean)
        floor = sorted(self._means)[int(_PERCENTILE * (len(self._means) - 1))]
        if self._steps * STEP * FRAME < _START:
            floor = min(floor, _START_CAP)
        self._steps += 1
        self._loudest = max(self._loudest, mean)
        count = self._faint + np.cumsum((levels > floor + MARGIN) & (levels <= QUIETEST))
        self._faint = int(count[-1])
        under = min(max(self._loudest - BELOW_LOUDEST, FAINTEST_SPEECH), QUIETEST)
        limit = np.where(count * FRAME >= FAINT_EVIDENCE, under, QUIETEST)
        return LoudnessStep(levels, np.full(len(levels), floor), limit, levels <= np.maximum(floor + MARGIN, limit))


def _step_mean(levels: Array) -> float:
    """Levels of a step averaged, a short one filled up with its last frame."""
    return float(np.concatenate([levels, np.repeat(levels[-1:], STEP - len(levels))]).mean())


def loudness(levels: Array) -> LoudnessStep:
    """What `LoudnessTracker` says of all frames [F] of a recording."""
    tracker = LoudnessTracker()
    steps = [tracker.step(levels[start:start + STEP]) for start in range(0, len(levels), STEP)]
    return LoudnessStep(levels, *(np.concatenate(part) for part in zip(
        *((step.floor, step.limit, step.silent) for step in steps), strict=True)))


def noise_floor(levels: Array) -> Array:
    """The running noise floor in dBFS for each frame, [F], see `LoudnessTracker`."""
    return loudness(levels).floor


def quietest(levels: Array) -> Array:
    """dBFS for each frame [F] below which everything is silent, as known by then.

    `QUIETEST`, until a recording has had `FAINT_EVIDENCE` of sound that stands out of its noise and is fainter; from
    then on at most `BELOW_LOUDEST` under the loudest 0.1 s so far. A recording with the usual level has its loudest
    sounds first, so that nothing changes for it; one that a microphone took 46 dB too low is heard after a phrase.
    """
    return loudness(levels).limit


def silent_frames(samples: Samples, sample_rate: int) -> NDArray[np.bool_]:
    """True for each frame of `FRAME` seconds that is no louder than the noise, [F]."""
    return loudness(frame_levels(samples, sample_rate)).silent


class PauseTracker:
    """Of silent frames, as they arrive, those in a pause of `SHORTEST_PAUSE` or longer; the world outside is silent.

    A blip of one or two loud frames (a click, a lip) does not end a pause. A frame is told as soon as it is certain:
    one in a pause when it has lasted long enough, one of speech at once.
    """

    def __init__(self) -> None:
        self._shortest = round(SHORTEST_PAUSE / FRAME)
        self._speaks = False
        self._blip = self._held = 0
        self._run = self._shortest  # frames that the pause has lasted; before the start it was silent

    def step(self, silent: Iterable[bool]) -> list[bool]:
        """What is certain by some more frames, in the order of frames: none, or several that were waited for."""
        told: list[bool] = []
        for one in silent:
            if one:
                self._quiet(self._blip + 1, told)
                self._blip = 0
            elif self._speaks:
                told.append(False)
            else:
                self._blip += 1
                if self._blip > _BLIP:
                    told += [False] * (self._held + self._blip)
                    self._speaks, self._blip, self._held, self._run = True, 0, 0, 0
        return told

    def finish(self) -> list[bool]:
        """What was not certain yet; nothing follows."""
        rest = [True] * self.waiting
        self._blip = self._held = 0
        return rest

    @property
    def waiting(self) -> int:
        """Frames that are not certain yet; all lie in a silence that may become a pause."""
        return self._held + self._blip

    def _quiet(self, count: int, told: list[bool]) -> None:
        self._speaks = False
        self._run, self._held = self._run + count, self._held + count
        if self._run >= self._shortest:
            told += [True] * self._held
            self._held = 0


def pauses(silent: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of the silent frames those in a pause, [F], see `PauseTracker`."""
    tracker = PauseTracker()
    return np.array(tracker.step(silent.tolist()) + tracker.finish(), dtype=bool)


def silent_blocks(speech: Speech, edges: Array) -> NDArray[np.bool_]:
    """True for each block between neighbouring `edges` [N + 1] seconds that lies in a pause, [N]."""
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    first = np.clip(frame_after(edges), 0, len(quiet))
    return np.array([in_pause(quiet[start:stop]) for start, stop in itertools.pairwise(first)], dtype=bool)


def frame_after(edges: Array) -> NDArray[np.int64]:
    """The first frame of the block that begins at each edge [...] (seconds): a frame belongs to the block that its
    middle lies in."""
    return np.ceil(np.asarray(edges) / FRAME - 0.5).astype(np.int64)


def in_pause(quiet: NDArray[np.bool_]) -> bool:
    """Whether a block of these frames, each in a pause or not, is silent: nearly all (0.9) of them must be."""
    return len(quiet) > 0 and int(np.count_nonzero(quiet)) >= _NEARLY_ALL * len(quiet)


def frame_before(times: Array) -> NDArray[np.int64]:
    """The frame that each of `times` [...] (seconds) ends or lies in: on the border of two the first."""
    return np.ceil(np.asarray(times) / FRAME - 1e-6).astype(np.int64) - 1


def quiet_at(speech: Speech, times: Array) -> NDArray[np.bool_]:
    """Whether each of `times` [...] (seconds, the end of what is meant) lies in a pause; past the end all is silent.

    A recording that begins with steady noise is silent from its start: the noise floor is not believed in the first
    second, but a voice is not steady (`SteadyStart`).
    """
    levels = frame_levels(speech.samples, speech.sample_rate)
    start, heard = SteadyStart(), loudness(levels).silent
    silent = [start.step(levels[at:at + STEP], heard[at:at + STEP]) for at in range(0, len(levels), STEP)]
    quiet = np.append(pauses(np.concatenate([*silent, start.finish()])), True)
    return quiet[np.clip(frame_before(times), 0, len(quiet) - 1)]


class SteadyStart:
    """Silent frames, with those of the first second up to which, and `SHORTEST_PAUSE` on, the level has not varied more
    than noise does. Step by step of 0.1 s, as `LoudnessTracker`."""

    def __init__(self) -> None:
        self._ahead = round(SHORTEST_PAUSE / (FRAME * STEP))
        self._least, self._most = math.inf, -math.inf
        self._steps = 0
        self._waiting: list[tuple[bool, NDArray[np.bool_]]] = []  # of the first second or not, silent frames

    def step(self, levels: Array, silent: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """What is certain by some more frames [F] of levels that are silent or not: [F'], also from steps before."""
        mean = _step_mean(levels)
        self._least, self._most = min(self._least, mean), max(self._most, mean)
        self._waiting.append((self._steps * STEP * FRAME < _START, silent))
        self._steps += 1
        if self._most - self._least >= _STEADY:
            return self._told(len(self._waiting), steady=False)
        certain = max(len(self._waiting) - self._ahead, 0)
        first = next((n for n, (early, _) in enumerate(self._waiting) if early), len(self._waiting))
        return self._told(max(certain, first), steady=True)

    def finish(self) -> NDArray[np.bool_]:
        """What was not certain yet."""
        return self._told(len(self._waiting), steady=True)

    def _told(self, count: int, steady: bool) -> NDArray[np.bool_]:
        told = [np.ones_like(silent) if steady and early else silent for early, silent in self._waiting[:count]]
        del self._waiting[:count]
        return np.concatenate([np.zeros(0, bool), *told])


def reference_level(samples: Samples, sample_rate: int, edges: Array) -> Array:
    """How loud this voice in this recording generally is, in dBFS, for each block [N], as known at the block's end.

    The mean level of the frames louder than the noise, with a slow memory of 30 s of speech that starts at
    `TYPICAL_LEVEL` with the weight of 5 s. It takes off the gain of a microphone, while the effort of a phrase, which
    changes every few seconds, stays in the features.
    """
    heard, voice = loudness(frame_levels(samples, sample_rate)), VoiceLevel()
    voice.feed(heard)
    return np.array([voice.block(stop) for stop in edges[1:]])


class VoiceLevel:
    """`reference_level` of speech as it arrives; edges are told in their order, those before the last are forgotten."""

    def __init__(self) -> None:
        self._total, self._count, self._first = [0.0], [0], 0  # of the frames up to each, from frame `_first` on
        self._level, self._weight = TYPICAL_LEVEL, _VOICE_PRIOR

    def feed(self, heard: LoudnessStep) -> None:
        """Some more frames."""
        for level, silent in zip(heard.levels.tolist(), heard.silent.tolist(), strict=True):
            self._total.append(self._total[-1] + (0.0 if silent else level))
            self._count.append(self._count[-1] + (not silent))

    def block(self, edge: float) -> float:
        """The level as known at the end of the next block, seconds, whose frames were fed."""
        last = min(max(round(edge / FRAME) - self._first, 0), len(self._total) - 1)
        summed, seconds = self._total[last] - self._total[0], (self._count[last] - self._count[0]) * FRAME
        del self._total[:last], self._count[:last]
        self._first += last
        self._level = (self._level * self._weight + summed * FRAME) / (self._weight + seconds)
        self._weight = min(self._weight + seconds, _VOICE_MEMORY)
        return self._level
