"""Words, cues, pins, curves and the other times of a plan on another export of its sound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from data_module.controls import FEATURES
from gesticulator.editing.moved_beats import BeatMap
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
)

_NEAR = 0.3
"""Seconds within which a word of a new transcript is the old one."""
_LEAST = 0.02
"""Seconds: shorter ranges are dropped."""


def moved_sections(plan: GesturePlan, beats: BeatMap, words: Sequence[PlanWord] | None, duration: float
                   ) -> tuple[dict[str, Any], list[str], int]:
    """The parts of a plan with times, moved, for `dataclasses.replace`; a line for each pin and cue that is lost; and
    the number of words that are lost.

    words: those of a new transcript, or None to move the old ones; duration: seconds that the blocks will cover.
    """
    # Words come first: cues at words are looked for among those that are left, or among the new ones.
    moved = [_word(word, beats) for word in plan.words]
    now = tuple(words) if words is not None else tuple(word for word in moved if word is not None)
    cues, pins = [], []
    losses = []
    for cue in plan.cues:
        moved_cue, before = _cue(cue, plan, beats, now)
        if moved_cue is None:
            losses.append(lost(f"cue {cue.gesture}" + (f" at \"{cue.word}\"" if cue.word else ""), before))
        else:
            cues.append(moved_cue if moved_cue.time is None else replace(moved_cue, time=min(moved_cue.time, duration)))
    for pin in plan.pins:
        moved_pin = _pin(pin, beats)
        if moved_pin is None:
            losses.append(lost(f"pin of {pin.joint}", pin.time))
        else:
            pins.append(replace(moved_pin, time=min(moved_pin.time, duration)))
    parts = {
        "words": now, "cues": tuple(cues), "pins": tuple(pins), "knobs": moved_knobs(plan.knobs, beats),
        "units": tuple(unit for unit in (_unit(unit, beats) for unit in plan.units) if unit is not None),
        "meanings": tuple(_meaning(meaning, beats, duration) for meaning in plan.meanings
                          if beats.moment((meaning.start + meaning.end) / 2) is not None),
        "curves": tuple(_curve(curve, beats) for curve in plan.curves),
        "made_by": {**plan.made_by, "settings": _settings(plan.made_by.get("settings", {}), beats)}}
    return parts, losses, 0 if words is not None else moved.count(None)


def lost(item: str, time: float) -> str:
    """The line about a pin, a cue or an edit at a time of the old sound, seconds, that has no place in the new one."""
    return f"the {item} at {time:.2f} s is lost: its sound is gone or is another one"


def _at(beats: BeatMap, time: float) -> float:
    return round(max(beats.anywhere(time), 0.0), 6)


def _range(beats: BeatMap, start: float, end: float) -> tuple[float, float] | None:
    """A range of seconds; None if little of it is left."""
    first, last = _at(beats, start), _at(beats, end)
    return (first, last) if last - first >= _LEAST else None


def _word(word: PlanWord, beats: BeatMap) -> PlanWord | None:
    # A word that was cut in the middle, or spoken again, is not the word of the plan.
    inside = beats.moment(word.start) is not None and beats.moment(word.end) is not None
    times = _range(beats, word.start, word.end)
    if times is None or not inside or beats.replaced(word.start, word.end) > 0.5:
        return None
    return replace(word, start=times[0], end=times[1])


def _cue(cue: GestureCue, plan: GesturePlan, beats: BeatMap, words: Sequence[PlanWord]
         ) -> tuple[GestureCue | None, float]:
    """A cue, None for a lost one, and its seconds in the old sound."""
    if cue.time is not None:
        now = beats.moment(cue.time)
        return (None if now is None else replace(cue, time=round(max(now, 0.0), 6))), cue.time
    # A cue names the n-th occurrence, and n changes when earlier ones are cut: the word is found by its time.
    spoken = [word for word in plan.words if plain_word(word.text) == plain_word(cue.word or "")]
    if len(spoken) < cue.occurrence:
        return cue, 0.0  # reported when the plan is rendered, as before
    before = spoken[cue.occurrence - 1].start
    now = beats.moment(before)
    if now is None:
        return None, before
    equal = [word for word in words if plain_word(word.text) == plain_word(cue.word or "")]
    distance, occurrence = min(((abs(word.start - now), at) for at, word in enumerate(equal, 1)), default=(_NEAR, 0))
    return (replace(cue, occurrence=occurrence) if distance < _NEAR else None), before


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


def _meaning(meaning: PlanMeaning, beats: BeatMap, duration: float) -> PlanMeaning:
    time = None if meaning.time is None else min(_at(beats, meaning.time), duration)
    return replace(meaning, start=_at(beats, meaning.start), end=_at(beats, meaning.end), time=time)


def moved_knobs(knobs: PlanKnobs, beats: BeatMap) -> PlanKnobs:
    """Knobs with their ranges of stillness moved."""
    ranges = (_range(beats, start, end) for start, end in knobs.hold_still)
    return replace(knobs, hold_still=tuple(range_ for range_ in ranges if range_ is not None))


def _points(times: Sequence[float], values: Sequence[float], beats: BeatMap
            ) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The points of a curve; of points that meet in a cut the first remains."""
    # Points that meet in a cut would not rise any more, which a plan must.
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
