"""Words, cues, pins, curves and the other times of a plan on another export of its sound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from data_module.controls import FEATURES
from gesticulator.editing.moved_beats import BeatMap
from gesticulator.editing.retiming_report import MovedItem
from gesticulator.plan.checks import plain_word
from gesticulator.plan.plan import (
    GestureCue,
    GesturePhase,
    GesturePlan,
    GestureUnit,
    KnobCurve,
    PlanKnobs,
    PlanMeaning,
    PlanWord,
    PosePin,
    SoundAlignment,
)

_NEAR = 0.3
"""Seconds within which a word of a new transcript is the old one."""
_LEAST = 0.02
"""Seconds: shorter ranges are dropped."""


@dataclass(frozen=True)
class MovedSections:
    """The parts of a plan with times, moved, for `dataclasses.replace`; what happened to pins and cues; and the number
    of words that are gone."""

    parts: dict[str, Any]
    items: tuple[MovedItem, ...]
    words_lost: int


def moved_sections(plan: GesturePlan, beats: BeatMap, words: Sequence[PlanWord] | None, duration: float
                   ) -> MovedSections:
    """words: those of a new transcript, or None to move the old ones; duration: seconds that the blocks will cover."""
    moved = [_word(word, beats) for word in plan.words]
    now = tuple(words) if words is not None else tuple(word for word in moved if word is not None)
    cues = [_cue(cue, plan, beats, now) for cue in plan.cues]
    pins = [_pin(pin, beats) for pin in plan.pins]
    items = [MovedItem(f"cue {cue.gesture}" + (f" at \"{cue.word}\"" if cue.word else ""), before, after)
             for cue, (_, before, after) in zip(plan.cues, cues, strict=True)]
    items += [MovedItem(f"pin of {pin.joint}", pin.time, None if new is None else new.time)
              for pin, new in zip(plan.pins, pins, strict=True)]
    made_by = {**plan.made_by, "settings": _settings(plan.made_by.get("settings", {}), beats)}
    parts = {
        "words": now, "cues": tuple(_within(cue, duration) for cue, _, _ in cues if cue is not None),
        "pins": tuple(replace(pin, time=min(pin.time, duration)) for pin in pins if pin is not None),
        "knobs": moved_knobs(plan.knobs, beats),
        "units": tuple(unit for unit in (_unit(unit, beats) for unit in plan.units) if unit is not None),
        "meanings": tuple(_meaning(one, beats, duration) for one in plan.meanings
                          if beats.moment((one.start + one.end) / 2) is not None),
        "curves": tuple(_curve(curve, beats) for curve in plan.curves), "made_by": made_by,
        "alignment": alignment_of(beats, plan)}
    return MovedSections(parts, tuple(items), 0 if words is not None else moved.count(None))


def _at(beats: BeatMap, time: float) -> float:
    return round(max(beats.anywhere(time), 0.0), 6)


def _range(beats: BeatMap, start: float, end: float) -> tuple[float, float] | None:
    """A range of seconds; None if little of it is left."""
    first, last = _at(beats, start), _at(beats, end)
    return (first, last) if last - first >= _LEAST else None


def _word(word: PlanWord, beats: BeatMap) -> PlanWord | None:
    inside = beats.moment(word.start) is not None and beats.moment(word.end) is not None
    times = _range(beats, word.start, word.end)
    if times is None or not inside or beats.replaced(word.start, word.end) > 0.5:
        return None
    return replace(word, start=times[0], end=times[1])


def _cue(cue: GestureCue, plan: GesturePlan, beats: BeatMap, words: Sequence[PlanWord]
         ) -> tuple[GestureCue | None, float, float | None]:
    """A cue, and its seconds before and now; None for what is lost."""
    if cue.time is not None:
        now = beats.moment(cue.time)
        return (None, cue.time, None) if now is None else (replace(cue, time=round(max(now, 0.0), 6)), cue.time, now)
    spoken = [word for word in plan.words if plain_word(word.text) == plain_word(cue.word or "")]
    if len(spoken) < cue.occurrence:
        return cue, 0.0, 0.0  # reported when the plan is rendered, as before
    before = spoken[cue.occurrence - 1].start
    now = beats.moment(before)
    equal = [word for word in words if plain_word(word.text) == plain_word(cue.word or "")]
    near = [(abs(word.start - now), at) for at, word in enumerate(equal, 1)] if now is not None else []
    distance, occurrence = min(near, default=(_NEAR, 0))
    if now is None or distance >= _NEAR:
        return None, before, None
    return replace(cue, occurrence=occurrence), before, equal[occurrence - 1].start


def _within(cue: GestureCue, duration: float) -> GestureCue:
    return cue if cue.time is None or cue.time <= duration else replace(cue, time=duration)


def _pin(pin: PosePin, beats: BeatMap) -> PosePin | None:
    now = beats.moment(pin.time)
    if now is None:
        return None
    hold = max(beats.anywhere(pin.time + pin.hold) - now, 0.0) if pin.hold else 0.0
    return replace(pin, time=round(max(now, 0.0), 6), hold=round(hold, 6))


def _unit(unit: GestureUnit, beats: BeatMap) -> GestureUnit | None:
    times = _range(beats, unit.start, unit.end)
    if times is None or beats.replaced(unit.start, unit.end) > 0.5:
        return None
    phases = [(phase.kind, _range(beats, phase.start, phase.end)) for phase in unit.phases]
    return replace(unit, start=times[0], end=times[1], phases=tuple(
        GesturePhase(kind, *range_) for kind, range_ in phases if range_ is not None))


def _meaning(one: PlanMeaning, beats: BeatMap, duration: float) -> PlanMeaning:
    time = None if one.time is None else min(_at(beats, one.time), duration)
    return replace(one, start=_at(beats, one.start), end=_at(beats, one.end), time=time)


def moved_knobs(knobs: PlanKnobs, beats: BeatMap) -> PlanKnobs:
    """Knobs with their ranges of stillness moved."""
    ranges = (_range(beats, start, end) for start, end in knobs.hold_still)
    return replace(knobs, hold_still=tuple(range_ for range_ in ranges if range_ is not None))


def _points(times: Sequence[float], values: Sequence[float], beats: BeatMap
            ) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The points of a curve; of points that meet in a cut the first remains."""
    points: list[tuple[float, float]] = []
    for time, value in zip(times, values, strict=True):
        now = _at(beats, time)
        if not points or now > points[-1][0]:
            points.append((now, value))
    return tuple(time for time, _ in points), tuple(value for _, value in points)


def _curve(curve: KnobCurve, beats: BeatMap) -> KnobCurve:
    times, values = _points(curve.times, curve.values, beats)
    return replace(curve, times=times, values=values)


def _settings(settings: dict[str, Any], beats: BeatMap) -> dict[str, Any]:
    """The settings of the generation, with the curves of the hand controls moved."""
    out = dict(settings)
    for name in (f"hand_{feature}" for feature in FEATURES):
        if isinstance(out.get(name), dict):
            times, values = _points(out[name]["times"], out[name]["values"], beats)
            out[name] = {"times": list(times), "values": list(values)}
    return out


def alignment_of(beats: BeatMap, plan: GesturePlan) -> SoundAlignment:
    """The map from the new sound back to the one that the plan was made for."""
    points: list[tuple[float, float]] = []
    for stretch in beats.stretches:
        for there, here in zip(stretch.times.tolist(), stretch.there.tolist(), strict=True):
            place = (round(max(here, 0.0), 6), round(max(there, 0.0), 6))
            if not points or all(new > old for old, new in zip(points[-1], place, strict=True)):
                points.append(place)
    kept = [point for before, point in pairwise([(-1.0, -1.0), *points]) if point > before]
    return SoundAlignment(plan.sound.sha256, plan.sound.duration, tuple(here for here, _ in kept),
                          tuple(there for _, there in kept))
