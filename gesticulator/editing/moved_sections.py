"""Words, cues, pins, curves and the other times of a plan on another export of its sound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from data_module.controls import FEATURES
from gesticulator.editing.moved_beats import BeatMap
from gesticulator.plan.checks import plain_word
from gesticulator.plan.plan import GestureCue, GesturePlan, PlanKnobs, PlanWord

_NEAR = 0.3
"""Seconds within which a word of a new transcript is the old one."""
_LEAST = 0.02
"""Seconds: shorter ranges are dropped."""


def moved_sections(plan: GesturePlan, beats: BeatMap, words: Sequence[PlanWord] | None, duration: float
                   ) -> tuple[dict[str, Any], list[str]]:
    """The parts of a plan with times, moved, for `dataclasses.replace`; and a line for each pin and cue that is lost.

    words: those of a new transcript, or None to move the old ones; duration: seconds that the blocks will cover.
    """
    # Words come first: cues at words are looked for among those that are left, or among the new ones.
    now = tuple(words) if words is not None else _spans(plan.words, beats, duration)
    cues, pins, losses = list[GestureCue](), [], []
    for cue in plan.cues:
        before = _said(cue, plan.words)
        moved = _cue(cue, before, beats, now, duration)
        if moved is None:
            losses.append(lost(f"cue {cue.gesture}" + (f" at \"{cue.word}\"" if cue.word else ""), before or 0.0))
        else:
            cues.append(moved)
    for pin in plan.pins:
        time = beats.moment(pin.time)
        if time is None:
            losses.append(lost(f"pin of {pin.joint}", pin.time))
        else:
            hold = max(beats.anywhere(pin.time + pin.hold) - time, 0.0) if pin.hold else 0.0
            pins.append(replace(pin, time=min(beats.at(pin.time), duration), hold=round(hold, 6)))
    settings = dict(plan.made_by.get("settings", {}))
    for name in (f"hand_{feature}" for feature in FEATURES):
        if isinstance(settings.get(name), dict):
            times, values = _points(settings[name]["times"], settings[name]["values"], beats)
            settings[name] = {"times": list(times), "values": list(values)}
    return {
        "words": now, "cues": tuple(cues), "pins": tuple(pins), "knobs": moved_knobs(plan.knobs, beats),
        "units": _spans(plan.units, beats, duration), "meanings": _spans(plan.meanings, beats, duration),
        "curves": tuple(replace(curve, **dict(zip(("times", "values"), _points(curve.times, curve.values, beats),
                                                  strict=True))) for curve in plan.curves),
        "made_by": {**plan.made_by, "settings": settings}}, losses


def lost(item: str, time: float) -> str:
    """The line about a pin, a cue or an edit at a time of the old sound, seconds, that has no place in the new one."""
    return f"the {item} at {time:.2f} s is lost: its sound is gone or is another one"


def _spans(records: Sequence[Any], beats: BeatMap, duration: float) -> tuple[Any, ...]:
    """Words, units, phases or meanings, without those of which little is left."""
    out = []
    for record in records:
        times = {name: min(beats.at(getattr(record, name)), duration) for name in ("start", "end", "time")
                 if getattr(record, name, None) is not None}
        # What was cut in the middle is not what the plan had.
        middle = beats.moment((record.start + record.end) / 2)
        if middle is not None and times["end"] - times["start"] >= min(_LEAST, record.end - record.start):
            inner = {"phases": _spans(record.phases, beats, duration)} if hasattr(record, "phases") else {}
            out.append(replace(record, **times, **inner))
    return tuple(out)


def _said(cue: GestureCue, words: Sequence[PlanWord]) -> float | None:
    """Seconds at which a cue stands in the old sound; None for one at a word that is not said."""
    if cue.time is not None:
        return cue.time
    spoken = [word.start for word in words if plain_word(word.text) == plain_word(cue.word or "")]
    return spoken[cue.occurrence - 1] if len(spoken) >= cue.occurrence else None


def _cue(cue: GestureCue, before: float | None, beats: BeatMap, words: Sequence[PlanWord], duration: float
         ) -> GestureCue | None:
    """A cue in the new sound; None for a lost one."""
    if before is None:
        return cue  # reported when the plan is rendered, as before
    now = beats.moment(before)
    if now is None or cue.time is not None:
        return None if now is None else replace(cue, time=min(beats.at(before), duration))
    # A cue names the n-th occurrence, and n changes when earlier ones are cut: the word is found by its time.
    equal = [word for word in words if plain_word(word.text) == plain_word(cue.word or "")]
    distance, occurrence = min(((abs(word.start - now), at) for at, word in enumerate(equal, 1)), default=(_NEAR, 0))
    return replace(cue, occurrence=occurrence) if distance < _NEAR else None


def moved_knobs(knobs: PlanKnobs, beats: BeatMap) -> PlanKnobs:
    """Knobs with their ranges of stillness moved."""
    ranges = ((beats.at(start), beats.at(end)) for start, end in knobs.hold_still)
    return replace(knobs, hold_still=tuple(range_ for range_ in ranges if range_[1] - range_[0] >= _LEAST))


def _points(times: Sequence[float], values: Sequence[float], beats: BeatMap
            ) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The points of a curve; of points that meet in a cut the first remains, as a plan's points must rise."""
    points: dict[float, float] = {}
    for time, value in zip(times, values, strict=True):
        points.setdefault(beats.at(time), value)
    return tuple(points), tuple(points.values())
