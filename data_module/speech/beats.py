"""The beats that speech and motion are cut at (RG 4.2.1).

A beat is certain when sound has been heard up to d_max + d_min after the beat before it and `onsets.LOOK_AHEAD` more,
and often earlier, so a stream gets what a file gets. The rule that the paper prints, which needs the whole recording,
is kept as the option "paper"; "even" hears nothing and gives blocks of one fixed length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.errors import InputError
from data_module.speech.onsets import merged, onsets_of
from data_module.speech.silence import FRAME, silent_frames
from data_module.types import Array, BeatFlag, Beats, Speech

__all__ = ["BeatSettings", "BeatTracker", "find_beats"]

RULES = ("bounded", "strongest", "paper", "even")
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


class BeatTracker:
    """Beats of sound as it arrives: `place_beats`, one after the other as each becomes certain.

    The rule "paper" needs the whole recording, so there all beats come at the end.
    """

    def __init__(self, settings: BeatSettings, start: float = 0.0) -> None:
        """start: seconds of the first beat."""
        self.settings = settings
        self.last = start
        self._onsets, self._strengths = list[float](), list[float]()
        self._loud: list[float] = []
        self._kept = -np.inf  # the last onset that is no merged one
        self._frames = self._beats = 0

    def step(self, onsets: Sequence[tuple[float, float]], silent: Sequence[bool], certain: float, heard: float
             ) -> list[tuple[float, BeatFlag]]:
        """The beats that are certain. onsets: more of them (seconds, dB), complete before `certain` seconds; silent:
        more frames; heard: seconds of sound so far."""
        self._take(onsets, silent)
        out = []
        while self._certain(certain, heard):
            out.append(self._next(None))
        return out

    def finish(self, onsets: Sequence[tuple[float, float]], silent: Sequence[bool], duration: float
               ) -> list[tuple[float, BeatFlag]]:
        """The beats that are left, the last at the end of a recording of `duration` seconds."""
        self._take(onsets, silent)
        if self.settings.rule == "paper":
            beats = _paper_beats(np.array(self._onsets), np.array(self._loud), duration, self.settings)
            return [beat for beat in beats if beat[0] > self.last]
        out = []
        while self.last < duration:
            out.append(self._next(duration))
        return out

    def _take(self, onsets: Sequence[tuple[float, float]], silent: Sequence[bool]) -> None:
        for time, strength in onsets:
            if time - self._kept >= self.settings.merge - _EPS:
                self._onsets.append(time)
                self._strengths.append(strength)
                self._kept = time
        self._loud += [(self._frames + n) * FRAME for n, quiet in enumerate(silent) if not quiet]
        self._frames += len(silent)

    def _certain(self, onsets_until: float, heard: float) -> bool:
        """Whether nothing that is still to come can move the next beat."""
        s, low, high = self.settings, self.last + self.settings.d_min, self.last + self.settings.d_max
        if s.rule == "even":
            return heard >= (self._beats + 1) * s.d_max + min(s.d_min, s.d_max / 2)
        if s.rule == "paper":
            return False
        if self._frames * FRAME >= high + FRAME and min(onsets_until, heard) >= high + s.d_min:
            return True
        near = next((time for time in self._onsets if time >= low - _EPS), None)
        if near is None or near >= onsets_until or s.rule != "bounded":
            return False
        if near <= high + _EPS:  # the first in reach, and the end is too far to forbid it
            return heard >= near + s.d_min
        # Room must be left for an onset beyond, and nothing lies before it.
        return near < high + s.d_min and self._frames * FRAME >= high + FRAME

    def _next(self, end: float | None) -> tuple[float, BeatFlag]:
        s = self.settings
        if s.rule == "even":
            beat = _even_beat(self._beats + 1, s, end)
        else:
            strengths = np.array(self._strengths) if s.rule == "strongest" else None
            beat = next_beat(self.last, np.array(self._onsets), np.array(self._loud), end, s, strengths)
        self.last = beat[0]
        self._beats += 1
        old = sum(time < self.last for time in self._onsets)
        del self._onsets[:old], self._strengths[:old]
        del self._loud[:sum(time < self.last for time in self._loud)]
        return beat


def _even_beat(number: int, settings: BeatSettings, end: float | None) -> tuple[float, BeatFlag]:
    """Beat `number` (from 1) of `_even_beats`; end: the end of the recording, None while it is far."""
    time = number * settings.d_max  # a multiple, not a running sum: an hour of steps must not drift
    if end is None:
        return time, BeatFlag.EVEN_PSEUDO
    if number >= np.ceil(end / settings.d_max - _EPS):
        return end, BeatFlag.BOUNDARY
    return min(time, end - min(settings.d_min, settings.d_max / 2)), BeatFlag.EVEN_PSEUDO


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
    onsets, strengths = onsets_of(speech.samples, speech.sample_rate)
    loud = np.flatnonzero(~silent_frames(speech.samples, speech.sample_rate)).astype(np.float64) * FRAME
    return place_beats(onsets, loud, speech.duration, settings, strengths)
