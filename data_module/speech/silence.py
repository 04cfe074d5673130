"""How loud a recording is, frame by frame: where nobody speaks, and how loud the voice generally is.

Silence is a level against a running noise floor.
Nothing here looks further than `LOOK_AHEAD` seconds ahead, and nothing needs the loudest part of the recording, so a
stream gets the same answer as a file.
"""

from __future__ import annotations

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

_STEP = 10
_PERCENTILE = 0.1
_START, _START_CAP = 1.0, -45.0
_STEADY = 2.0  # decibels between the loudest and the faintest 0.1 s; white noise of a second has 0.5
_BLIP = 2
_NEARLY_ALL = 0.9
_FAINTEST = -120.0
_VOICE_PRIOR, _VOICE_MEMORY = 5.0, 30.0  # seconds of speech


def frame_levels(samples: Samples, sample_rate: int) -> Array:
    """RMS of each frame in dBFS (a full-scale sine is -3), [F]; the last frame may be short."""
    size = max(1, round(FRAME * sample_rate))
    whole = len(samples) // size
    power = np.empty(-(-len(samples) // size))
    # einsum accumulates in double without a double copy of an hour of sound
    frames = samples[:whole * size].reshape(whole, size)
    power[:whole] = np.einsum("fs,fs->f", frames, frames, dtype=np.float64, casting="safe") / size
    if whole < len(power):
        power[whole] = np.mean(samples[whole * size:].astype(np.float64) ** 2)
    return 10.0 * np.log10(np.maximum(power, 10.0 ** (_FAINTEST / 10.0)))


def noise_floor(levels: Array) -> Array:
    """The running noise floor in dBFS for each frame, [F]: a low percentile of the past `MEMORY` seconds.

    Levels are first averaged over steps of 0.1 s, which makes steady noise steady. In the first second there is
    hardly a past, so a floor above an ordinary room is not believed yet.
    """
    means = _step_means(levels)
    steps = len(means)
    span = round(MEMORY / (FRAME * _STEP))
    past = np.concatenate([np.full(span - 1, np.inf), means])
    ordered = np.sort(np.lib.stride_tricks.sliding_window_view(past, span), axis=1)
    known = np.minimum(np.arange(1, steps + 1), span)
    floor = ordered[np.arange(steps), (_PERCENTILE * (known - 1)).astype(int)]
    beginning = np.arange(steps) * _STEP * FRAME < _START
    floor[beginning] = np.minimum(floor[beginning], _START_CAP)
    return np.repeat(floor, _STEP)[:len(levels)]


def _step_means(levels: Array) -> Array:
    """Levels averaged over steps of 0.1 s, the last one filled up with its last frame, [steps]."""
    steps = -(-len(levels) // _STEP)
    padded = np.concatenate([levels, np.repeat(levels[-1:], steps * _STEP - len(levels))])
    means: Array = padded.reshape(steps, _STEP).mean(axis=1)
    return means


def quietest(levels: Array, floor: Array) -> Array:
    """dBFS for each frame [F] below which everything is silent, as known by then.

    `QUIETEST`, until a recording has had `FAINT_EVIDENCE` of sound that stands out of its noise and is fainter; from
    then on at most `BELOW_LOUDEST` under the loudest 0.1 s so far. A recording with the usual level has its loudest
    sounds first, so that nothing changes for it; one that a microphone took 46 dB too low is heard after a phrase.
    """
    faint = (levels > floor + MARGIN) & (levels <= QUIETEST)
    loudest = np.repeat(np.maximum.accumulate(_step_means(levels)), _STEP)[:len(levels)]
    follows = np.cumsum(faint) * FRAME >= FAINT_EVIDENCE
    return np.where(follows, np.clip(loudest - BELOW_LOUDEST, FAINTEST_SPEECH, QUIETEST), QUIETEST)


def silent_frames(samples: Samples, sample_rate: int) -> NDArray[np.bool_]:
    """True for each frame of `FRAME` seconds that is no louder than the noise, [F]."""
    levels = frame_levels(samples, sample_rate)
    floor = noise_floor(levels)
    return levels <= np.maximum(floor + MARGIN, quietest(levels, floor))


def pauses(silent: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of the silent frames those in a pause of `SHORTEST_PAUSE` or longer, [F]; the world outside is silent.

    A blip of one or two loud frames (a click, a lip) does not end a pause.
    """
    edge = round(SHORTEST_PAUSE / FRAME)
    state = np.concatenate([np.ones(edge, bool), silent, np.ones(edge, bool)])
    for value, longest in ((False, _BLIP), (True, edge - 1)):
        starts = np.flatnonzero(np.diff(state, prepend=not state[0]))
        ends = np.append(starts[1:], len(state))
        for start, end in zip(starts, ends, strict=True):
            if state[start] == value and end - start <= longest:
                state[start:end] = not value
    return state[edge:-edge]


def silent_blocks(speech: Speech, edges: Array) -> NDArray[np.bool_]:
    """True for each block between neighbouring `edges` [N + 1] seconds that lies in a pause, [N].

    Nearly all (0.9) of its frames must belong to a pause.
    """
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    before = np.concatenate([[0], np.cumsum(quiet)])
    # A frame belongs to the block that its middle lies in.
    first = np.clip(np.ceil(np.asarray(edges) / FRAME - 0.5).astype(int), 0, len(quiet))
    count = np.diff(first)
    return (count > 0) & (np.diff(before[first]) >= _NEARLY_ALL * count)


def quiet_at(speech: Speech, times: Array) -> NDArray[np.bool_]:
    """Whether each of `times` [...] (seconds, the end of what is meant) lies in a pause; past the end all is silent.

    A recording that begins with steady noise is silent from its start: the noise floor is not believed in the first
    second, but a voice is not steady.
    """
    silent = silent_frames(speech.samples, speech.sample_rate) | _steady_start(speech)
    quiet = np.append(pauses(silent), True)
    # A time on the border of two frames belongs to the one that it ends.
    return quiet[np.clip(np.ceil(np.asarray(times) / FRAME - 1e-6).astype(int) - 1, 0, len(quiet) - 1)]


def _steady_start(speech: Speech) -> NDArray[np.bool_]:
    """True for frames [F] of the first second up to which, and `SHORTEST_PAUSE` on, the level has not varied more than
    noise does."""
    levels = frame_levels(speech.samples, speech.sample_rate)
    means = _step_means(levels)
    ahead = round(SHORTEST_PAUSE / (FRAME * _STEP))
    varied = np.maximum.accumulate(means) - np.minimum.accumulate(means)
    known = varied[np.minimum(np.arange(len(means)) + ahead, len(means) - 1)]
    steady = (known < _STEADY) & (np.arange(len(means)) * _STEP * FRAME < _START)
    return np.repeat(steady, _STEP)[:len(levels)]


def reference_level(samples: Samples, sample_rate: int, edges: Array) -> Array:
    """How loud this voice in this recording generally is, in dBFS, for each block [N], as known at the block's end.

    The mean level of the frames louder than the noise, with a slow memory of 30 s of speech that starts at
    `TYPICAL_LEVEL` with the weight of 5 s. It takes off the gain of a microphone, while the effort of a phrase, which
    changes every few seconds, stays in the features.
    """
    levels = frame_levels(samples, sample_rate)
    loud = ~silent_frames(samples, sample_rate)
    total = np.concatenate([[0.0], np.cumsum(np.where(loud, levels, 0.0))])
    count = np.concatenate([[0], np.cumsum(loud)])
    last = np.clip(np.round(np.asarray(edges) / FRAME).astype(int), 0, len(levels))
    sums, seconds = np.diff(total[last]), np.diff(count[last]) * FRAME
    out = np.empty(len(last) - 1)
    level, weight = TYPICAL_LEVEL, _VOICE_PRIOR
    for block, (summed, heard) in enumerate(zip(sums, seconds, strict=True)):
        level = (level * weight + summed * FRAME) / (weight + heard)
        weight = min(weight + heard, _VOICE_MEMORY)
        out[block] = level
    return out
