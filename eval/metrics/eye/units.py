"""Gesture units and phrases: do the hands hold, prepare before the word, and keep moving through short pauses?

Theory: a gesture unit goes from rest to rest (`data_module.motion.phases`). v is the speed of
`eval.metrics.eye.together.hand_speeds`; a pause is a silence of 0.3 s or more.

- held: percentage of speech and hands in which a hand 6 cm over the hips or higher is under 0.15 m/s for 0.25 s or
  more.
- pauses with a moving hand: percentage of the time of pauses in which the faster hand is over 0.15 m/s.
- speed in pauses: geometric mean over pauses of the mean speed within over that 0.6 s before and after.
- speed and loudness: correlation of the logarithm of hand speed with loudness in dB over half seconds.
- variation in speech: as `together.variation`, over speech.

Of several recordings together (`Leads`): the first movement after silences of 0.4 s or more, where the faster hand
first rises over 0.3 m/s between 1 s before the voice, in the silence, and 1.5 s after it; and the percentage of such
silences in which it is before the voice, with its chance over circular shifts of the motion.

Good: real speakers hold 4 to 16 % of speech, keep moving in 61 to 84 % of pauses at .5 to .8 of the speed around them,
and begin before the voice in 65 to 79 % of cases where chance has 56 to 70. Correlation with loudness is -.03 to .56.

What fools them: hands that never stop have moving pauses, and "begin" before the voice as often as chance has it, so
read that share beside its chance. A motion that is frozen in pauses has none of them. Played backwards a motion keeps
holds and pauses and loses the lead.

    >>> int(lasting(np.array([True] * 5 + [False] + [True] * 30), 0.3 * HZ).sum())
    30
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.motion.phases import lasting, runs
from data_module.types import Array
from eval.metrics.eye.arms import frozen
from eval.metrics.eye.body import HZ, CommonBody
from eval.metrics.eye.hands import HANGS, MOVES, correlation
from eval.metrics.eye.together import hand_speeds, variation
from eval.metrics.eye.voice import TRACK_HZ, VoiceActivity

HELD = 0.15
"""m/s: a hand that is slower is held, or rests."""
PAUSE, HOLD = 0.3, 0.25
"""Seconds of a pause, and of a hold, at least."""
_AROUND = 0.6
"""Seconds before and after a pause that its speed is compared with."""
_EASE = 0.02
"""m/s added to speeds before their logarithm: the noise of a still hand."""
_SILENCE, _BEFORE, _AFTER = 0.4, 1.0, 1.5
"""Seconds: the shortest silence before a first movement, and where it is looked for about the voice's return."""
_SEED = 1
_DEPTH = 50.0
"""dB under the loud half seconds under which silence is not told apart."""


def silent_frames(voice: VoiceActivity, frames: int) -> NDArray[np.bool_]:
    """[frames] at 60 Hz, whether the voice is silent."""
    # The sound may be a frame shorter than the motion.
    at = (np.arange(frames) / HZ * TRACK_HZ).astype(int)
    return np.asarray(voice.silent[np.minimum(at, len(voice.silent) - 1)])


def _held(body: CommonBody, speed: Array, speech: NDArray[np.bool_]) -> dict[str, float]:
    # Less than a second of speech has no hold to speak of.
    if speech.sum() <= HZ:
        return {}
    shares = [(lasting(speed[:, hand] < HELD, HOLD * HZ) & (body.hands[:len(speed), hand, 1] > HANGS))[speech].mean()
              for hand in (0, 1)]
    return {"eye_held": 100.0 * float(np.mean(shares))}


def _pauses(speed: Array, pauses: NDArray[np.bool_]) -> dict[str, float]:
    mean, out = speed.mean(axis=1), {}
    if pauses.sum() > HZ / 2:
        out["eye_pause_moving"] = 100.0 * float((speed.max(axis=1)[pauses] > HELD).mean())
    around, ratios = round(_AROUND * HZ), []
    for begin, stop in runs(pauses):
        # A pause at either end of the recording has no speed around it on one side.
        if begin > around and stop < len(mean) - around:
            beside = np.concatenate([mean[begin - around:begin], mean[stop:stop + around]]).mean()
            ratios.append(math.log((mean[begin:stop].mean() + _EASE) / (beside + _EASE)))
    if len(ratios) > 2:
        out["eye_pause_speed"] = math.exp(float(np.mean(ratios)))
    return out


@dataclass(frozen=True)
class Leads:
    """First movements about the voice's return, pooled over recordings. seconds: [n], one for each silence that has
    one, negative before the voice; before_by_chance, count_by_chance: [shifts] how many are before the voice, and how
    many there are, when the motion is shifted circularly."""

    seconds: Array
    before_by_chance: Array
    count_by_chance: Array

    @property
    def before(self) -> float:
        """Percentage of first movements that come before the voice."""
        return 100.0 * float((self.seconds < 0).mean()) if len(self.seconds) else math.nan

    @property
    def _shares(self) -> Array:
        """[shifts with a movement] the share before the voice."""
        some = self.count_by_chance > 0
        return self.before_by_chance[some] / self.count_by_chance[some]

    @property
    def chance(self) -> float:
        """The mean percentage under circular shifts."""
        return 100.0 * float(self._shares.mean()) if len(self._shares) else math.nan

    @property
    def p(self) -> float:
        """Share of the shifts in which at least as many come before the voice; the observed order counts as one."""
        if not len(self.seconds) or not len(self._shares):
            return math.nan
        return float((1 + (self._shares >= self.before / 100.0 - 1e-12).sum()) / (1 + len(self._shares)))

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


def leads(body: CommonBody, voice: VoiceActivity, shifts: int) -> Leads:
    """The first movements of a recording, and those under so many circular shifts of the motion."""
    frames = _frames(body, voice)
    fast = hand_speeds(body)[:frames].max(axis=1)
    rate = HZ / TRACK_HZ
    silences = [(round(begin * rate), round(stop * rate))
                for begin, stop in runs(voice.silent[:round(frames / rate)])]
    # The voice must come back within the recording, half a second before its end at the latest.
    silences = [(begin, stop) for begin, stop in silences
                if stop - begin >= _SILENCE * HZ and stop < frames - HZ / 2]
    counts, before = np.zeros(shifts), np.zeros(shifts)
    # Shorter clips have too few places to shift to.
    if frames > 10 * HZ:
        for at, shift in enumerate(np.random.default_rng(_SEED).integers(round(HZ), frames - round(HZ), shifts)):
            moved = _first_movements(np.roll(fast, shift), silences)
            counts[at], before[at] = len(moved), (moved < 0).sum()
    return Leads(_first_movements(fast, silences), before, counts)


def _loudness(speed: Array, voice: VoiceActivity) -> dict[str, float]:
    # Digital silence at -120 dB would decide the correlation by itself.
    level = np.maximum(voice.level, np.percentile(voice.level, 95) - _DEPTH)
    half, track = round(HZ / 2), TRACK_HZ // 2
    count = min(len(speed) // half, len(level) // track)
    if count <= 8:
        return {}
    fast = np.log(speed[:count * half].reshape(count, half).mean(axis=1) + _EASE)
    loud = level[:count * track].reshape(count, track).mean(axis=1)
    return {"eye_loud": correlation(np.stack([fast, loud], axis=1))}


def _frames(body: CommonBody, voice: VoiceActivity) -> int:
    """Frames that motion and sound have in common."""
    return min(len(body), int(len(voice.silent) * HZ / TRACK_HZ))


def figures(body: CommonBody, voice: VoiceActivity) -> dict[str, float]:
    """Every figure of this chapter, without those that there is too little of."""
    frames = _frames(body, voice)
    if frames < 2 * HZ:
        return {}
    speed = hand_speeds(body)[:frames]
    pauses, mean = lasting(silent_frames(voice, frames), PAUSE * HZ), speed.mean(axis=1)
    return {**_held(body, speed, ~pauses), **_pauses(speed, pauses), **_loudness(mean, voice),
            "eye_variation_speech": variation(mean, ~pauses), "eye_frozen": frozen(body, ~pauses)}
