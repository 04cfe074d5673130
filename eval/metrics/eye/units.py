"""Gesture units and phrases: do the hands hold, prepare before the word, and keep moving through short pauses?

Theory: a gesture unit goes from rest to rest: preparation, strokes, holds, retraction (Kendon). A hand rests where it
is under 0.15 m/s for 0.4 s within 10 cm of its home (its own 10 % height), or for 0.8 s anywhere; it moves over
0.3 m/s. v is the speed of `eval.metrics.eye.together.hand_speeds`; a pause is a silence of 0.3 s or more.

Without the sound, of each hand: units a minute; their median and 90 % length, seconds; percentage of time in them;
strokes a unit, median (from one minimum of speed to the next with movement between, preparation and return counted);
percentage of units with one or two strokes.

With the sound:

- held: percentage of speech and hands in which a hand 6 cm over the hips or higher is under 0.15 m/s for 0.25 s or
  more; holds: how many of them begin in a minute of speech, for each hand.
- pauses with a moving hand: percentage of the time of pauses in which the faster hand is over 0.15 m/s.
- speed in pauses: geometric mean over pauses of the mean speed within over that 0.6 s before and after.
- first movement: after silences of 0.4 s or more, where the faster hand first rises over 0.3 m/s between 1 s before the
  voice, in the silence, and 1.5 s after it: median, seconds, negative before the voice; and the percentage of such
  silences in which it is before the voice, with its chance over 50 circular shifts of the motion (`Leads` pools them
  over recordings).
- speed and loudness: correlation of the logarithm of hand speed with loudness in dB over half seconds, of all time
  and of speech alone (within 22 dB of the loud half seconds).
- variation in speech: as `together.variation`, over speech.

Good: real speakers hold 4 to 16 % of speech, keep moving in 61 to 84 % of pauses at .5 to .8 of the speed around them,
and begin before the voice in 65 to 79 % of cases where chance has 56 to 70. Correlation with loudness is -.03 to .56.

What fools them: hands that never stop have moving pauses, and "begin" before the voice as often as chance has it, so
read that share beside its chance. A motion that is frozen in pauses has none of them. Played backwards a motion keeps
holds and pauses and loses the lead.

    >>> int(lasting(np.array([True] * 5 + [False] + [True] * 30), 0.3).sum())
    30
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from data_module.types import Array
from eval.metrics.eye.body import HZ, CommonBody
from eval.metrics.eye.hands import HANGS, MOVES, correlation
from eval.metrics.eye.together import hand_speeds, variation
from eval.metrics.eye.voice import TRACK_HZ, VoiceActivity
from eval.stats import runs

HELD = 0.15
"""m/s: a hand that is slower is held, or rests."""
PAUSE, HOLD = 0.3, 0.25
"""Seconds of a pause, and of a hold, at least."""
_REST_AT_HOME, _REST_ANYWHERE, _HOME = 0.4, 0.8, 0.10
"""Seconds of rest near home and anywhere; metres over the 10 % height that are near."""
_PROMINENCE = 0.12
"""m/s: what a minimum of speed must lie under its surroundings to end a stroke."""
_AROUND = 0.6
"""Seconds before and after a pause that its speed is compared with."""
_EASE = 0.02
"""m/s added to speeds before their logarithm: the noise of a still hand."""
_SILENCE, _BEFORE, _AFTER = 0.4, 1.0, 1.5
"""Seconds: the shortest silence before a first movement, and where it is looked for about the voice's return."""
_SHIFTS, _SEED = 50, 1
_CLEAR, _DEPTH = 22.0, 50.0
"""dB under the loud half seconds that count as speech, and under which silence is not told apart."""


def lasting(mask: NDArray[np.bool_], seconds: float) -> NDArray[np.bool_]:
    """[T] the runs of a mask [T] that last so many seconds at least."""
    out = np.zeros(len(mask), bool)
    for begin, stop in runs(mask).tolist():
        out[begin:stop] = stop - begin >= round(seconds * HZ)
    return out


def gesture_units(height: Array, speed: Array) -> list[tuple[int, int]]:
    """Frames from and to of the units of a hand with height [T] metres and speed [T] m/s."""
    slow = speed < HELD
    rests = lasting(slow & (height < np.percentile(height, 10) + _HOME), _REST_AT_HOME) | lasting(slow, _REST_ANYWHERE)
    return [(begin, stop) for begin, stop in runs(~rests).tolist() if speed[begin:stop].max() > MOVES]


def stroke_peaks(speed: Array) -> NDArray[np.int64]:
    """The frame at which each stroke of a hand is fastest, of its speed [T] m/s."""
    ends = [0, *find_peaks(-speed, prominence=_PROMINENCE)[0].tolist(), len(speed) - 1]
    return np.array([begin + int(speed[begin:stop].argmax()) for begin, stop in zip(ends[:-1], ends[1:], strict=True)
                     if speed[begin:stop].max(initial=0.0) > MOVES], np.int64)


FIGURES = ("eye_units", "eye_unit_length", "eye_unit_length_90", "eye_unit_time", "eye_unit_strokes", "eye_unit_single")


def figures(body: CommonBody) -> dict[str, float]:
    """The figures of this chapter that need no sound."""
    speed, lengths, strokes = hand_speeds(body), [], []
    for hand in (0, 1):
        peaks = stroke_peaks(speed[:, hand])
        for begin, stop in gesture_units(body.hands[:, hand, 1], speed[:, hand]):
            lengths.append((stop - begin) / HZ)
            strokes.append(int(((peaks >= begin) & (peaks < stop)).sum()))
    out = dict.fromkeys(("eye_unit_length", "eye_unit_length_90", "eye_unit_strokes", "eye_unit_single"), math.nan)
    out |= {"eye_units": len(lengths) / 2 / (body.duration / 60),
            "eye_unit_time": 100 * sum(lengths) / 2 / body.duration}
    if lengths:
        out |= {"eye_unit_length": float(np.median(lengths)), "eye_unit_length_90": float(np.percentile(lengths, 90)),
                "eye_unit_strokes": float(np.median(strokes)),
                "eye_unit_single": 100.0 * float((np.array(strokes) <= 2).mean())}
    return out


# --------------------------------------------------------------------------------------------------- with the sound

def silent_frames(voice: VoiceActivity, frames: int) -> NDArray[np.bool_]:
    """[frames] at 60 Hz, whether the voice is silent."""
    at = (np.arange(frames) / HZ * TRACK_HZ).astype(int)
    return np.asarray(voice.silent[np.minimum(at, len(voice.silent) - 1)])


def _holds(body: CommonBody, speed: Array, speech: NDArray[np.bool_]) -> dict[str, float]:
    if speech.sum() <= HZ:
        return {}
    shares, count = [], 0
    for hand in (0, 1):
        raised, still = body.hands[:len(speed), hand, 1] > HANGS, lasting(speed[:, hand] < HELD, HOLD)
        shares.append((still & raised)[speech].mean())
        count += sum(bool(raised[begin:stop].mean() > 0.5 and speech[begin:stop].mean() > 0.5)
                     for begin, stop in runs(still).tolist())
    return {"eye_held": 100.0 * float(np.mean(shares)), "eye_holds": count / 2 / (speech.sum() / HZ / 60)}


def _pauses(speed: Array, pauses: NDArray[np.bool_]) -> dict[str, float]:
    mean, out = speed.mean(axis=1), {}
    if pauses.sum() > HZ / 2:
        out["eye_pause_moving"] = 100.0 * float((speed.max(axis=1)[pauses] > HELD).mean())
    around, ratios = round(_AROUND * HZ), []
    for begin, stop in runs(pauses).tolist():
        # A pause at either end of the recording has no speed around it on one side.
        if begin > around and stop < len(mean) - around:
            beside = np.concatenate([mean[begin - around:begin], mean[stop:stop + around]]).mean()
            ratios.append(math.log((mean[begin:stop].mean() + _EASE) / (beside + _EASE)))
    if len(ratios) > 2:
        out["eye_pause_speed"] = math.exp(float(np.mean(ratios)))
    return out


@dataclass(frozen=True)
class Leads:
    """First movements about the voice's return, pooled over recordings: of `silences` silences, [n] seconds, negative
    before the voice; by_chance: [shifts] the share before the voice when the motion is shifted circularly, each times
    how many movements it had, and [shifts] how many."""

    seconds: Array
    before_by_chance: Array
    count_by_chance: Array

    @property
    def before(self) -> float:
        """Percentage of first movements that come before the voice."""
        return 100.0 * float((self.seconds < 0).mean()) if len(self.seconds) else math.nan

    @property
    def chance(self) -> float:
        """The mean percentage under circular shifts."""
        some = self.count_by_chance > 0
        return 100.0 * float((self.before_by_chance[some] / self.count_by_chance[some]).mean()) if some.any() \
            else math.nan

    @property
    def p(self) -> float:
        """Share of the shifts in which at least as many come before the voice; the observed order counts as one."""
        some = self.count_by_chance > 0
        if not len(self.seconds) or not some.any():
            return math.nan
        shares = self.before_by_chance[some] / self.count_by_chance[some]
        return float((1 + (shares >= self.before / 100.0 - 1e-12).sum()) / (1 + some.sum()))

    @classmethod
    def pooled(cls, parts: Sequence[Leads]) -> Leads:
        """Of several recordings, each shifted by itself."""
        return cls(np.concatenate([part.seconds for part in parts]),
                   np.sum([part.before_by_chance for part in parts], 0),
                   np.sum([part.count_by_chance for part in parts], 0))


def _first_movements(fast: Array, silences: Sequence[tuple[int, int]]) -> Array:
    """[n] seconds from the end of each silence (frames) to where a speed [T] first rises over `MOVES`."""
    out = []
    for begin, stop in silences:
        # Not before the silence began: a movement that still belongs to the last phrase is no preparation.
        start = max(begin, stop - round(_BEFORE * HZ), 0)
        window = fast[start:stop + round(_AFTER * HZ)]
        rises = np.flatnonzero((window[1:] >= MOVES) & (window[:-1] < MOVES))
        if len(rises):
            out.append((rises[0] + 1 + start - stop) / HZ)
    return np.array(out, dtype=np.float64)


def leads(body: CommonBody, voice: VoiceActivity, shifts: int = _SHIFTS) -> Leads:
    """The first movements of a recording, and those under circular shifts of the motion."""
    frames = _frames(body, voice)
    fast = hand_speeds(body)[:frames].max(axis=1)
    rate = HZ / TRACK_HZ
    silences = [(round(begin * rate), round(stop * rate))
                for begin, stop in runs(voice.silent[:round(frames / rate)]).tolist()]
    silences = [(begin, stop) for begin, stop in silences
                if stop - begin >= _SILENCE * HZ and stop < frames - HZ / 2]
    counts, before = np.zeros(shifts), np.zeros(shifts)
    if frames > 10 * HZ:
        for at, shift in enumerate(np.random.default_rng(_SEED).integers(round(HZ), frames - round(HZ), shifts)):
            moved = _first_movements(np.roll(fast, shift), silences)
            counts[at], before[at] = len(moved), (moved < 0).sum()
    return Leads(_first_movements(fast, silences), before, counts)


def _lead(body: CommonBody, voice: VoiceActivity) -> dict[str, float]:
    first = leads(body, voice)
    if len(first.seconds) < 3:
        return {}
    return {"eye_lead": float(np.median(first.seconds)), "eye_lead_before": first.before,
            "eye_lead_chance": first.chance}


def _loudness(speed: Array, voice: VoiceActivity) -> dict[str, float]:
    # Digital silence at -120 dB would decide the correlation by itself.
    level = np.maximum(voice.level, np.percentile(voice.level, 95) - _DEPTH)
    half, track = round(HZ / 2), TRACK_HZ // 2
    count = min(len(speed) // half, len(level) // track)
    if count <= 8:
        return {}
    fast = np.log(speed[:count * half].reshape(count, half).mean(axis=1) + _EASE)
    loud = level[:count * track].reshape(count, track).mean(axis=1)
    clear = loud > np.percentile(loud, 95) - _CLEAR
    pair = np.stack([fast, loud], axis=1)
    return {"eye_loud": correlation(pair),
            "eye_loud_speech": correlation(pair[clear]) if clear.sum() > 8 else math.nan}


def _frames(body: CommonBody, voice: VoiceActivity) -> int:
    """Frames that motion and sound have in common."""
    return min(len(body), int(len(voice.silent) * HZ / TRACK_HZ))


SOUND_FIGURES = ("eye_held", "eye_holds", "eye_pause_moving", "eye_pause_speed", "eye_lead", "eye_lead_before",
                 "eye_lead_chance", "eye_loud", "eye_loud_speech", "eye_variation_speech")


def sound_figures(body: CommonBody, voice: VoiceActivity) -> dict[str, float]:
    """The figures of this chapter that need the sound; NaN where there is too little of what they are of."""
    out, frames = dict.fromkeys(SOUND_FIGURES, math.nan), _frames(body, voice)
    if frames < 2 * HZ:
        return out
    speed = hand_speeds(body)[:frames]
    pauses = lasting(silent_frames(voice, frames), PAUSE)
    return out | _holds(body, speed, ~pauses) | _pauses(speed, pauses) | _lead(body, voice) \
        | _loudness(speed.mean(axis=1), voice) | {"eye_variation_speech": variation(speed.mean(axis=1), ~pauses)}
