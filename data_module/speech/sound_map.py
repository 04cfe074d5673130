"""Alignment of a recording with another export of it, by their fingerprints (`aligned`).

Frames a_i of the old recording and b_j of the new one are matched, in order, at the cost d(i, j) = sum over bands of
|a_i - b_j|; a frame without a match costs `GAP`, and each gap `OPEN` more (the alignment of Gotoh 1982 with affine
gaps; costs are whole numbers, so the result does not depend on the machine). Identical stretches are matched at one
shift, cuts and insertions are one gap each. Matches in stretches that are too short, or too unlike, are dropped: two
sentences always have some frames in common.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.speech.fingerprint import BANDS, RATE, Frames
from data_module.types import Array

__all__ = ["SoundMap", "Stretch", "aligned"]

GAP, OPEN = 12, 36
"""Costs; a match is worse than two gaps where the bands differ by 6 dB on average."""
UNLIKE = 20.0
"""Largest mean cost of a stretch. Exports of one sound (MP3, 8 kHz, noise at -50 dB) have 0 to 9, other speech 50."""
SAME, ALIKE = 7.0, 12.0
"""Largest mean cost of a stretch with the same sound (half a frame of shift costs 6), and of one with
the same sound at another tempo."""
SHORTEST = 20
"""Least number of frames of speech in a stretch (0.4 s); unrelated speech matches for up to half of that."""
DRIFT, BRIDGE = 3, 10
"""Most frames by which the shift may change between two parts of one stretch, and most frames between them: speech at
another tempo is one stretch."""
SPEECH = (6.0, 9.0)
"""Mean value of a frame from which it counts as speech (21 to 12 dB below the loud frames): 9 dB above the noise."""
_NOISE, _ABOVE_NOISE = 10.0, 3.0
# Largest share of frames of speech in a pause: breaths, and the last of a word.
_PAUSE = 0.2
REACH = 20 * RATE
"""Frames by which the shift of two recordings may exceed the difference of their lengths."""
# Most bytes of the trace: two recordings of an hour whose lengths differ by half a minute.
_MOST_KEPT = 700_000_000
_MATCH, _SKIP, _ADD = 0, 1, 2
_FAR = 1 << 28
Shifts = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Stretch:
    """A stretch that both recordings have. times, there: [M] seconds in the old and in the new one, both rising; linear
    between them. cost: mean cost of its frames of speech."""

    times: Array
    there: Array
    cost: float = 0.0

    @property
    def alike(self) -> bool:
        """Whether the sound is the same, perhaps at another tempo, and not only similar."""
        return self.cost <= ALIKE

    @property
    def same(self) -> bool:
        """Whether it is the same sound at one shift, so that whatever lies in it moves by that shift alone."""
        return self.cost <= SAME and float(np.ptp(self.there - self.times)) < 1e-9

    def at(self, time: float) -> float:
        """The time there, seconds; beyond the ends with the shift of the nearer one."""
        if time <= self.times[0]:
            return time + float(self.there[0] - self.times[0])
        if time >= self.times[-1]:
            return time + float(self.there[-1] - self.times[-1])
        return float(np.interp(time, self.times, self.there))

    def between(self, start: float | None = None, end: float | None = None) -> Stretch:
        """The stretch with another start or end, in seconds of the old recording."""
        begin = float(self.times[0]) if start is None else start
        stop = float(self.times[-1]) if end is None else end
        inner = (self.times > begin) & (self.times < stop)
        times = np.unique(np.concatenate([[begin], self.times[inner], [stop]]))
        return Stretch(times, np.array([self.at(time) for time in times.tolist()]), self.cost)

    def shifted(self, seconds: float) -> Stretch:
        """The stretch with all times there shifted."""
        return Stretch(self.times, self.there + seconds, self.cost)


@dataclass(frozen=True)
class SoundMap:
    """The stretches that two recordings have in common, in order and without overlap in either.

    old, new: their fingerprints. speech: share of the old one's frames of speech that lie in the stretches.
    """

    old: Frames
    new: Frames
    stretches: tuple[Stretch, ...]
    speech: float

    def sliding(self, at: int) -> tuple[int, int]:
        """By how many frames the boundary between stretch `at` and the next could lie earlier and later: as far as the
        sound is equal at both shifts, as in a pause, where nothing tells what was cut."""
        before, after = self.stretches[at:at + 2]
        first, last = round(float(before.times[-1]) * RATE), round(float(after.times[0]) * RATE)
        reach = round(min(float(before.times[-1] - before.times[0]), 2.0) * RATE)
        earlier = self._equal(range(last - 1, last - 1 - reach, -1), round(_shift(after, 0) * RATE))
        reach = round(min(float(after.times[-1] - after.times[0]), 2.0) * RATE)
        later = self._equal(range(first + 1, first + 1 + reach), round(_shift(before, -1) * RATE))
        return earlier, later

    def _equal(self, frames: range, shift: int) -> int:
        """How many of the frames, from the first on, are equal to those of the new recording at a shift."""
        for count, frame in enumerate(frames):
            if not (0 <= frame < len(self.old) and 0 <= frame + shift < len(self.new)) \
                    or _distances(self.old[frame], self.new[frame + shift]) > UNLIKE:
                return count
        return len(frames)

    def slid(self, at: int, frames: int) -> SoundMap:
        """The map with the boundary after stretch `at` moved by some frames, within `sliding`."""
        before, after = self.stretches[at:at + 2]
        moved = (before.between(end=float(before.times[-1]) + frames / RATE),
                 after.between(start=float(after.times[0]) + frames / RATE))
        return replace(self, stretches=(*self.stretches[:at], *moved, *self.stretches[at + 2:]))


def _shift(stretch: Stretch, point: int) -> float:
    return float(stretch.there[point] - stretch.times[point])


def aligned(old: Frames, new: Frames) -> SoundMap:
    """The map of an old recording onto a new one, from their fingerprints [F, BANDS] and [G, BANDS]. `InputError` for
    long recordings of very different lengths.

    The first stretch is the moment before both recordings, and the last the moment after them.
    """
    pairs = _matches(old, new)
    costs = _distances(old[pairs[:, 0]], new[pairs[:, 1]])
    speech = _spoken(old)
    stretches = []
    covered = np.zeros(len(old), bool)
    for first, last in _chains(pairs):
        chain, cost = pairs[first:last], costs[first:last]
        spoken = speech[chain[:, 0]]
        if spoken.sum() >= SHORTEST and cost[spoken].mean() <= UNLIKE:
            covered[chain[:, 0]] = True
            stretches.append(_stretch(chain, float(cost[spoken].mean())))
    begin, end = (np.array([-1.0]) / RATE,) * 2, (np.array([len(old)]) / RATE, np.array([len(new)]) / RATE)
    joined = _joined([Stretch(*begin), *stretches, Stretch(*end)], speech, _spoken(new))
    return SoundMap(old, new, tuple(joined), float(covered[speech].mean()) if speech.any() else 0.0)


def _spoken(frames: Frames) -> Flags:
    """[F] the frames of speech."""
    levels = frames.mean(axis=1)
    return levels >= np.clip(np.percentile(levels, _NOISE) + _ABOVE_NOISE, *SPEECH)


def _joined(stretches: list[Stretch], speech: Flags, new_speech: Flags) -> list[Stretch]:
    """The stretches continued through pauses that are unlike in both recordings, such as by their noise: a pause is a
    pause. Two stretches that meet then are one."""
    out, last = stretches[:1], len(stretches) - 1
    for at, after in enumerate(stretches[1:], 1):
        before = out[-1]
        frames = [range(round(float(old[-1]) * RATE) + 1, round(float(two[0]) * RATE))
                  for old, two in ((before.times, after.times), (before.there, after.there))]
        pause = min(map(len, frames))
        if pause and max(speech[frames[0].start:frames[0].stop].mean(),
                         new_speech[frames[1].start:frames[1].stop].mean()) <= _PAUSE:
            before = before.between(end=float(before.times[-1]) + pause / RATE)
            if max(map(len, frames)) == pause and 1 < at < last:
                out[-1] = Stretch(np.concatenate([before.times, after.times]),
                                  np.concatenate([before.there, after.there]), max(before.cost, after.cost))
                continue
        out[-1:] = [before, after]
    return out


def _distances(old: Frames, new: Frames) -> NDArray[np.int32]:
    """[..., ] costs of matches."""
    return np.abs(old.astype(np.int16) - new.astype(np.int16)).sum(axis=-1, dtype=np.int32)


def _chains(pairs: Shifts) -> list[tuple[int, int]]:
    """The parts (first, last + 1) of the matches [M, 2] that are stretches: the shift drifts, but does not jump."""
    steps = np.diff(pairs, axis=0)
    jumps = (np.abs(steps[:, 1] - steps[:, 0]) > DRIFT) | (steps.max(axis=1, initial=0) > BRIDGE)
    edges = [0, *(np.flatnonzero(jumps) + 1).tolist(), len(pairs)]
    return [(first, last) for first, last in pairwise(edges) if first < last]


def _stretch(chain: Shifts, cost: float) -> Stretch:
    """A stretch from its matches [M, 2]: the ends of its runs of one shift are its points."""
    shifts = chain[:, 1] - chain[:, 0]
    ends = np.flatnonzero(np.diff(shifts))
    points = np.unique(np.concatenate([[0], ends, ends + 1, [len(chain) - 1]]))
    return Stretch(chain[points, 0] / RATE, chain[points, 1] / RATE, cost)


# ------------------------------------------------------------------------------------------------ the alignment

def _matches(old: Frames, new: Frames) -> Shifts:
    """[M, 2] indices of the matched frames, rising in both columns: the alignment of least cost."""
    low, width = _band(len(old), len(new))
    # Frames beyond the ends of the new recording match nothing.
    # 100 is far from all values of a fingerprint (0 to 15), so that no match is cheaper than a gap there.
    padded = np.full((len(old) + width, BANDS), 100, np.int16)
    inside = slice(max(low, 0), min(low + len(padded), len(new)))
    padded[inside.start - low:inside.stop - low] = new[inside]
    trace = np.empty((len(old) + 1, width), np.uint8)
    # best[s][k]: cost of all before frame i of the old and frame i + low + k of the new one, ending in state s.
    start = np.arange(width) + low
    best = np.full((3, width), _FAR, np.int32)
    best[_MATCH, start == 0] = 0
    best[_ADD, start > 0] = OPEN + GAP * start[start > 0]
    trace[0] = _ADD << 4
    for i, frame in enumerate(old.astype(np.int16)):
        # Column k of row i is the pair (i, i + low + k): the band around the diagonal, as a rectangle.
        cost = np.abs(padded[i:i + width] - frame).sum(axis=1, dtype=np.int32)
        best, trace[i + 1] = _row(best, cost)
    return _traced(trace, best, low, len(new) - len(old) - low)


def _band(old: int, new: int) -> tuple[int, int]:
    """The least shift that is considered, and the number of shifts."""
    low, high = max(-old, min(new - old, 0) - REACH), min(new, max(new - old, 0) + REACH)
    width = high - low + 1
    if old * width > _MOST_KEPT:
        raise InputError("the new sound", f"lasts {new / RATE:.0f} s, and the old one {old / RATE:.0f} s, too much "
                         "of a difference for sounds of this length", "give another export of the whole sound")
    return low, width


def _row(best: NDArray[np.int32], cost: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """The next row of the costs [3, W], and the states before each of its states, two bits for each. cost: [W] of the
    matches."""
    width = len(cost)
    before = best.argmin(axis=0)
    match = best[before, np.arange(width)] + cost
    # A skipped frame of the old recording lowers the shift by one.
    opened, going_on = best[_MATCH] + OPEN, best[_SKIP]
    skip, from_skip = np.full(width, _FAR, np.int32), np.zeros(width, np.uint8)
    skip[:-1] = np.minimum(opened, going_on)[1:] + GAP
    from_skip[:-1] = (going_on < opened)[1:]
    # An added frame of the new recording raises it by one, any number of times within the row.
    source = np.minimum(match, skip) + OPEN
    ramp = GAP * np.arange(width, dtype=np.int32)
    # The minimum over all beginnings of the gap in one pass: its cost is linear in its length, so it splits into a part
    # of the end and one of the beginning.
    least = np.minimum.accumulate(source - ramp)
    add = np.full(width, _FAR, np.int32)
    add[1:] = least[:-1] + ramp[1:]
    begins = np.zeros(width, np.uint8)
    begins[1:] = source[:-1] + GAP == add[1:]
    # The state before an added frame: a longer gap, or what the gap began after.
    state = np.where(begins == 0, _ADD, np.where(np.concatenate([[False], (skip < match)[:-1]]), _SKIP, _MATCH))
    trace = before.astype(np.uint8) | from_skip << 2 | state.astype(np.uint8) << 4
    return np.minimum(np.stack([match, skip, add]), _FAR), trace


def _traced(trace: NDArray[np.uint8], best: NDArray[np.int32], low: int, column: int) -> Shifts:
    """[M, 2] the matches of the path that ends in this column of the last row; see `_row`."""
    state, row, pairs = int(best[:, column].argmin()), len(trace) - 1, list[tuple[int, int]]()
    while row > 0:
        entry = int(trace[row, column])
        if state == _MATCH:
            row -= 1
            pairs.append((row, column))
            state = entry & 3
        elif state == _SKIP:
            state = _SKIP if entry >> 2 & 3 else _MATCH
            row, column = row - 1, column + 1
        else:
            state, column = entry >> 4, column - 1
    return np.array([(at, at + low + column) for at, column in reversed(pairs)], np.int64).reshape(-1, 2)
