"""Where the beats of a plan lie in another export of its sound.

The map of the sounds (`data_module.speech.sound_map`) has frames of 20 ms; here it is made as fine as the beats are:
each stretch is shifted so that the onsets of both sounds meet. Where the sound is the same, beats move by that shift;
elsewhere a beat on an onset moves to the onset that is nearest to it. In a pause nothing tells what was cut or
inserted, so there it is put where the fewest blocks change.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from data_module.speech.fingerprint import RATE
from data_module.speech.sound_map import SoundMap, Stretch
from data_module.types import Array
from gesticulator.plan.checks import LONGEST, SHORTEST
from gesticulator.plan.plan import DrawnBlocks

TOLERANCE = 0.06
"""Seconds between a moved beat and the onset that it moves to; in the same sound at another tempo `_SAME_ONSET`."""
_SAME_ONSET = 0.02
_GRID = 0.015
"""Seconds within which onsets of both sounds are the same, for the fine shift of a stretch."""
_SHORT = 0.1
"""Seconds of sound that may be added where some is cut, and the reverse; with more the sound was replaced."""
_FRAME = 1.0 / RATE + 1e-4
RATIOS = (0.4, 1.6)
"""Least and largest length of a moved block over its old one."""
_ODD = 10.0
"""Cost of a block that does not fit, in `_disorder`."""


@dataclass(frozen=True)
class BeatPlace:
    """A beat in the new sound: the end of the block before it and the start of the block after it, seconds; they differ
    where sound was inserted. fits: whether there is an onset, if it was one."""

    end: float
    start: float
    fits: bool = True


class BeatMap:
    """The map of a plan's times onto the new sound."""

    def __init__(self, sounds: SoundMap, drawn: DrawnBlocks, onsets: Array) -> None:
        """onsets: [n] of the new sound, seconds."""
        for at in range(len(sounds.stretches) - 1):
            sounds = _settled(sounds, at, drawn.edges)
        before = np.array([edge for edge, flag in zip(drawn.edges[1:], drawn.flags, strict=True) if flag == "onset"])
        self.stretches = tuple(_refined(stretch, before, onsets) for stretch in sounds.stretches)
        self._onsets = onsets

    def place(self, beat: float, onset: bool = False) -> BeatPlace | None:
        """A beat in the new sound; None where the sound was replaced. onset: it lies on one."""
        times = _located(self.stretches, beat)
        if times is None or not onset:
            return None if times is None else BeatPlace(*times)
        nearest = _nearest(self.stretches, beat)
        # The shift of the same sound is more exact than onsets, which lie on a grid of 10 ms.
        if nearest.same:
            return BeatPlace(*times)
        alike = nearest.alike
        snapped = [self._onset_near(time, _SAME_ONSET if alike else TOLERANCE) for time in times]
        fits = alike or any(time is not None for time in snapped)
        end, start = (time if near is None else near for time, near in zip(times, snapped, strict=True))
        return BeatPlace(min(end, start), start, fits)

    def _onset_near(self, time: float, within: float) -> float | None:
        near = self._onsets[np.abs(self._onsets - time) <= within + 1e-9]
        return float(near[np.abs(near - time).argmin()]) if len(near) else None

    def moment(self, time: float) -> float | None:
        """A moment in the new sound; None where its sound was cut or replaced."""
        near = _nearest(self.stretches, time)
        if not near.times[0] - TOLERANCE <= time <= near.times[-1] + TOLERANCE:
            return None
        return self.anywhere(time) if _beyond(near, time) > 0 else near.at(time)

    def anywhere(self, time: float) -> float:
        """A moment in the new sound, also where the sound was cut or replaced: linear between the stretches."""
        # Never backwards, though stretches may overlap by a frame in the new sound.
        times, there = (np.concatenate([getattr(stretch, name) for stretch in self.stretches])
                        for name in ("times", "there"))
        return float(np.interp(time, times, np.maximum.accumulate(there)))

    def at(self, time: float) -> float:
        """`anywhere` as a plan stores it: in microseconds, and not before the start."""
        return round(max(self.anywhere(time), 0.0), 6)


def fits(length: float, before: float) -> bool:
    """Whether a block may have another length than before, seconds."""
    return SHORTEST <= length <= LONGEST and RATIOS[0] - 1e-6 <= length / before <= RATIOS[1] + 1e-6


def _beyond(stretch: Stretch, time: float) -> float:
    return max(float(stretch.times[0]) - time, time - float(stretch.times[-1]), 0.0)


def _nearest(stretches: Sequence[Stretch], time: float) -> Stretch:
    """The stretch with the least distance to a time; of two, the one that is longer."""
    return min(stretches, key=lambda stretch: (_beyond(stretch, time), float(stretch.times[0] - stretch.times[-1])))


def _located(stretches: Sequence[Stretch], time: float) -> tuple[float, float] | None:
    """The times there just before and just after a moment; None where the sound was replaced."""
    time = min(time, float(stretches[-1].times[-1]))
    near = [stretch for stretch in stretches if _beyond(stretch, time) <= _FRAME]
    if near:
        end, start = near[0].at(time), near[-1].at(time)
        return (end, start) if end <= start else ((end + start) / 2,) * 2
    before, after = next(pair for pair in pairwise(stretches) if time < pair[1].times[0])
    # Both sides of a cut meet in the middle of what is left of it.
    if float(after.there[0] - before.there[-1]) <= _SHORT:  # the sound of this moment was cut
        return (float(before.there[-1] + after.there[0]) / 2,) * 2
    nearest = _nearest((before, after), time)
    if _beyond(nearest, time) > TOLERANCE:
        return None
    return (float(np.clip(nearest.at(time), before.there[-1], after.there[0])),) * 2


def _refined(stretch: Stretch, before: Array, onsets: Array) -> Stretch:
    """A stretch shifted so that its onsets meet those of the new sound [n]. before: [m] the old onsets."""
    # Two onsets at least: one alone may be moved by noise.
    inside = before[(before >= stretch.times[0]) & (before <= stretch.times[-1])]
    if len(inside) < 2 or not len(onsets):
        return stretch
    moved = np.array([stretch.at(time) for time in inside.tolist()])
    away = onsets[np.abs(onsets[:, None] - moved).argmin(axis=0)] - moved
    away = np.round(away[np.abs(away) <= _GRID], 6)
    if len(away) < 2:
        return stretch
    values, counts = np.unique(away, return_counts=True)
    most = int(counts.argmax())
    # Onsets have a grid of 10 ms: most agree if the shift is a multiple of it, and their mean is the shift otherwise.
    return stretch.shifted(float(values[most] if counts[most] >= 0.6 * len(away) else away.mean()))


def _settled(sounds: SoundMap, at: int, edges: Sequence[float]) -> SoundMap:
    """The map with the boundary after stretch `at` where it changes the fewest blocks."""
    before, after = sounds.stretches[at:at + 2]
    # Where both sounds have something between two stretches, nothing was only cut or only inserted.
    if min(float(after.times[0] - before.times[-1]), float(after.there[0] - before.there[-1])) > _SHORT:
        return sounds
    # Only blocks near the boundary can change, so only they are counted for each place of it.
    earlier, later = sounds.sliding(at)
    window = (float(before.times[-1]) - earlier / RATE - LONGEST, float(after.times[0]) + later / RATE + LONGEST)
    blocks = [(start, end) for start, end in pairwise(edges) if start < window[1] and end > window[0]]
    candidates = sorted(range(-earlier, later + 1), key=abs)
    maps = [sounds.slid(at, frames) for frames in candidates]
    return min(maps, key=lambda slid: _disorder(slid.stretches, blocks))


def _disorder(stretches: Sequence[Stretch], blocks: Sequence[tuple[float, float]]) -> float:
    """How much a map changes the lengths of blocks: the sum of |log ratio|, and `_ODD` for each that does not fit."""
    total, last = 0.0, None
    for start, end in blocks:
        first, stop = _located(stretches, start), _located(stretches, end)
        if first is None or stop is None:
            last = None
            continue
        length, before = stop[0] - first[1], end - start
        total += abs(math.log(length / before)) if fits(length, before) else _ODD
        if last is not None and 1e-6 < first[1] - last < SHORTEST:  # an insertion that is too short for a block
            total += _ODD
        last = stop[0]
    return round(total, 3)
