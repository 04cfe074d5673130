"""What a scripted performance did with its plan: beats where they were meant, no clip twice in a row, audible size.

Theory: a stroke's beat is where its arms brake hardest (`motion_beats`, mode A), so it is found anew on the motion, and
set beside the time at which it was planned. What fools it: a motion that brakes all the time hits every plan, so the
share that hits by chance (the plan shifted in time) belongs beside it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_module.motion.motion_beats import acting_positions, acting_speed, beats_of_speed
from data_module.truth import PlayedStroke
from data_module.types import Array, Motion, Speech

TOLERANCE = 0.02
"""Seconds: how near a motion beat must be to its plan."""
_ACTING = {"right": (0, 1), "left": (2, 3), "both": (0, 1, 2, 3)}


def stroke_misses(motion: Motion, strokes: Sequence[PlayedStroke], shift: float = 0.0) -> Array:
    """Seconds from each planned beat (plus `shift`) to the nearest motion beat of its acting arms, [strokes]."""
    positions = acting_positions(motion)
    found = {hand: beats_of_speed(acting_speed(positions[:, list(joints)], motion.fps), motion.fps)
             for hand, joints in _ACTING.items()}
    out = np.full(len(strokes), np.inf)
    for k, stroke in enumerate(strokes):
        times = found[stroke.hand]
        if len(times):
            out[k] = float(np.abs(times - (stroke.beat + shift) % motion.duration).min())
    return out


def gain_features(speech: Speech, times: Array) -> Array:
    """What low-level audio says about the vigour of syllables at `times`: [n, 6], levels in dB and brightness.

    Levels over 0.2, 0.6 and 2 s against the recording's median speech level; the same of the sound above 1 kHz, whose
    share grows with vocal effort.
    """
    hop = speech.sample_rate // 100
    count = len(speech.samples) // hop
    frames = speech.samples[:count * hop].reshape(count, hop).astype(np.float64)
    bright = np.diff(speech.samples[:count * hop], prepend=0.0).reshape(count, hop).astype(np.float64)
    powers = np.stack([(frames ** 2).mean(axis=1), (bright ** 2).mean(axis=1)]) + 1e-10
    loud = powers[:, powers[0] > np.percentile(powers[0], 40)]
    middle = 10.0 * np.log10(np.median(loud, axis=1))
    out = np.zeros((len(times), 6))
    for column, width in enumerate((0.2, 0.6, 2.0)):
        for k, time in enumerate(times):
            low, high = int(max(0, (time - width / 3.0) * 100)), int(min(count, (time + width * 2.0 / 3.0) * 100))
            mean = powers[:, low:max(high, low + 1)].mean(axis=1)
            out[k, column::3] = 10.0 * np.log10(mean) - middle
    return out


def gain_r2(train: Sequence[tuple[Array, Array]], test: Sequence[tuple[Array, Array]]) -> Array:
    """R2 of stroke gain (log) from audio features on each test recording's strokes; a linear fit on the others.

    Each pair is features [n, 6] and gains [n]. The variance is that about the training mean, over all test strokes.
    """
    x, y = np.concatenate([f for f, _ in train]), np.log(np.concatenate([g for _, g in train]))
    mean, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    design = np.column_stack([(x - mean) / scale, np.ones(len(x))])
    weights = np.linalg.solve(design.T @ design + 1.0 * np.eye(design.shape[1]), design.T @ y)
    pairs = [(np.log(g), np.column_stack([(f - mean) / scale, np.ones(len(f))]) @ weights) for f, g in test if len(g)]
    spread = np.concatenate([(g - y.mean()) ** 2 for g, _ in pairs]).mean()
    return np.array([1.0 - ((g - said) ** 2).mean() / spread for g, said in pairs])


def longest_repetition(clips: Sequence[str]) -> int:
    """The longest run of one clip in a row (1: none twice)."""
    longest = run = min(len(clips), 1)
    for before, now in zip(clips, clips[1:], strict=False):
        run = run + 1 if now == before else 1
        longest = max(longest, run)
    return longest
