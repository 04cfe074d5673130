"""The beats at which speech and motion are cut (RG 4.2.1).

A beat is certain at the latest when there is sound up to d_max + d_min after the previous beat and `onsets.LOOK_AHEAD`
more, so a stream gives the same result as a file. The rule of the paper, which needs the whole recording, is the option
"paper"; "even" ignores the sound and gives blocks of fixed length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_module.errors import InputError
from data_module.speech.onsets import onsets_of
from data_module.speech.silence import FRAME, silent_frames
from data_module.types import Array, BeatFlag, Beats, Speech

__all__ = ["BeatSettings", "BeatTracker", "find_beats"]

RULES = ("bounded", "paper", "even")
# Tolerance of times, seconds.
_EPS = 1e-9


@dataclass(frozen=True)
class BeatSettings:
    """The placement of beats. Seconds; every interval between beats lies in [d_min, d_max].

    merge: onsets closer than this count as one. rule: "bounded", the first onset in reach; "paper" (RG
    4.2.1, with guards); or "even": beats d_max apart whatever the sound, for a codec of a
    fixed rate such as RACER's. Only "even" may have d_min = d_max; the last two intervals then share the remainder,
    each d_max / 2 or longer.
    """

    d_min: float = 0.2
    d_max: float = 0.5
    merge: float = 0.05
    rule: str = "bounded"

    def __post_init__(self) -> None:
        if not 0 < self.d_min < np.inf or not self.d_max < np.inf:
            raise InputError("d_min", f"is {self.d_min}, not a valid interval between beats", "give for example 0.2")
        # Fixed blocks need no room for a pseudo-beat.
        one_rate = self.rule == "even" and abs(self.d_max - self.d_min) <= _EPS
        if self.d_max < 2 * self.d_min - _EPS and not one_rate:
            raise InputError("d_max", f"is {self.d_max}, less than twice d_min ({self.d_min})",
                             "an interval that is too long must be divisible into two that are not too short")
        if not self.merge >= 0:
            raise InputError("merge", f"is {self.merge}", "give 0 or more seconds")
        if self.rule not in RULES:
            raise InputError("rule", f"is {self.rule!r}", f"choose from {', '.join(RULES)}")


def next_beat(beat: float, onsets: Array, loud: Array, end: float | None,
              settings: BeatSettings) -> tuple[float, BeatFlag]:
    """The beat after `beat` by the rule "bounded", and its flag.

    onsets, loud: rising seconds of the onsets and of the frames louder than the noise. end: the end of the recording,
    None while it is unknown. Only the time before beat + d_max + d_min matters; `end` must be given if it is earlier.
    """
    low, high = beat + settings.d_min, beat + settings.d_max
    horizon = high + settings.d_min
    # An end beyond the horizon restricts nothing: two intervals fit in before it. A stream does not know it yet, and
    # must decide alike.
    if end is not None and end >= horizon:
        end = None
    near = onsets[np.searchsorted(onsets, low - _EPS):np.searchsorted(onsets, horizon)]
    # The interval from the beat to the end must not be shorter than d_min, either.
    fits = (near <= high + _EPS) & (True if end is None else end - near >= settings.d_min - _EPS)
    if fits.any():
        return float(near[fits.argmax()]), BeatFlag.ONSET
    if end is not None and end <= high + _EPS:
        return end, BeatFlag.BOUNDARY
    # Leave room for the next onset (even one that the unknown end may exclude) and for the end.
    ahead = [float(onset) for onset in near[near > high + _EPS][:1]] + ([end] if end is not None else [])
    latest = max(low, min([high, *(time - settings.d_min for time in ahead)]))
    first = int(np.searchsorted(loud, low - _EPS))
    if first < len(loud) and loud[first] <= latest + _EPS:
        return float(np.clip(loud[first], low, latest)), BeatFlag.LOUD_PSEUDO
    return latest, BeatFlag.EVEN_PSEUDO


class BeatTracker:
    """The beats of streamed sound: each is returned when it is certain. With the rule "paper", which needs the whole
    recording, all beats come at the end."""

    def __init__(self, settings: BeatSettings, start: float = 0.0) -> None:
        self.settings = settings
        self.last = start
        self._onsets = self._loud = np.zeros(0)
        self._last_onset = -np.inf  # the last one that was not merged
        self._frames = self._beats = 0

    def step(self, onsets: Sequence[tuple[float, float]], silent: Sequence[bool], certain: float, available: float
             ) -> list[tuple[float, BeatFlag]]:
        """The beats that are certain. onsets: new ones (seconds, dB), complete up to `certain` seconds; silent: new
        frames; available: seconds of sound so far."""
        self._take(onsets, silent)
        out = []
        while self._certain(certain, available):
            out.append(self._next(None))
        return out

    def finish(self, onsets: Sequence[tuple[float, float]], silent: Sequence[bool], duration: float
               ) -> list[tuple[float, BeatFlag]]:
        """The remaining beats, the last at the end of a recording of `duration` seconds."""
        self._take(onsets, silent)
        if self.settings.rule == "paper":
            beats = _paper_beats(self._onsets, self._loud, duration, self.settings)
            return [beat for beat in beats if beat[0] > self.last]
        out = []
        while self.last < duration:
            out.append(self._next(duration))
        return out

    def _take(self, onsets: Sequence[tuple[float, float]], silent: Sequence[bool]) -> None:
        distinct = list[float]()
        for time, _ in onsets:
            if time - self._last_onset >= self.settings.merge - _EPS:
                distinct.append(time)
                self._last_onset = time
        self._onsets = np.concatenate([self._onsets, distinct]) if distinct else self._onsets
        loud = self._frames + np.flatnonzero(~np.asarray(silent, dtype=bool))
        self._loud = np.concatenate([self._loud, loud * FRAME])
        self._frames += len(silent)

    def _certain(self, onsets_until: float, available: float) -> bool:
        """Whether the next beat does not depend on future sound."""
        s, low, high = self.settings, self.last + self.settings.d_min, self.last + self.settings.d_max
        if s.rule == "even":
            return available >= (self._beats + 1) * s.d_max + min(s.d_min, s.d_max / 2)
        if s.rule == "paper":
            return False
        if self._frames * FRAME >= high + FRAME and min(onsets_until, available) >= high + s.d_min:
            return True
        # The first of each that may be a beat; infinity without any.
        near, loud = (min(times[times.searchsorted(low - _EPS):][:1].tolist(), default=np.inf)
                      for times in (self._onsets, self._loud))
        # No onset is in reach. A loud frame is the beat if it leaves room for an onset, and an end, right after it.
        if near > high + _EPS and min(onsets_until, available) > high + _EPS and loud <= max(low, high - s.d_min):
            return True
        if near >= onsets_until:
            return False
        if near <= high + _EPS:  # the first in reach, unless the end is too close
            return bool(available >= near + s.d_min)
        # The beat only has to leave room for this onset.
        return bool(near < high + s.d_min) and self._frames * FRAME >= high + FRAME

    def _next(self, end: float | None) -> tuple[float, BeatFlag]:
        s = self.settings
        if s.rule == "even":
            beat = _even_beat(self._beats + 1, s, end)
        else:
            beat = next_beat(self.last, self._onsets, self._loud, end, s)
        self.last = beat[0]
        self._beats += 1
        # Nothing before a beat can be a later beat, so memory does not grow with the recording.
        self._onsets, self._loud = (times[np.searchsorted(times, self.last):] for times in (self._onsets, self._loud))
        return beat


def _even_beat(number: int, settings: BeatSettings, end: float | None) -> tuple[float, BeatFlag]:
    """Beat `number` (from 1) of the rule "even": d_max after the one before. If less than d_min is left at the end of
    the recording, the last beat but one moves to d_min before it, so that the last two intervals share the remainder.
    With d_min = d_max, where no other interval is allowed, d_max / 2 replaces d_min. end: None while it is far."""
    time = number * settings.d_max  # a multiple, not a running sum: an hour of steps must not drift
    if end is None:
        return time, BeatFlag.EVEN_PSEUDO
    if number >= np.ceil(end / settings.d_max - _EPS):
        return end, BeatFlag.BOUNDARY
    return min(time, end - min(settings.d_min, settings.d_max / 2)), BeatFlag.EVEN_PSEUDO


def _paper_beats(onsets: Array, loud: Array, duration: float, settings: BeatSettings) -> list[tuple[float, BeatFlag]]:
    """RG 4.2.1 with guards: a pseudo-beat is at least d_min from both neighbours, and both sides are filled again."""
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
        # Nothing is loud there: the fewest equal parts that are not too long. As d_max is at least 2 d_min, they are
        # not too short.
        pieces = int(np.ceil(gap / settings.d_max - _EPS))
        done += [(start + gap * piece / pieces, BeatFlag.EVEN_PSEUDO) for piece in range(1, pieces)]
    return done


def find_beats(speech: Speech, settings: BeatSettings | None = None) -> Beats:
    """The beats of a recording: its onsets, pseudo-beats between them, its start and its end (RG 4.2.1)."""
    settings = settings or BeatSettings()
    onsets, silent = list[tuple[float, float]](), list[bool]()
    if settings.rule != "even":
        onsets = onsets_of(speech.samples, speech.sample_rate)
        silent = silent_frames(speech.samples, speech.sample_rate).tolist()
    # The whole recording at once: a file takes the path of a stream.
    beats = [(0.0, BeatFlag.BOUNDARY), *BeatTracker(settings).finish(onsets, silent, speech.duration)]
    return Beats(np.array([time for time, _ in beats]), np.array([flag for _, flag in beats], dtype=np.int8))
