"""The table of the figures for the eye: figures down, systems across, with the range of real people and the controls.

A value outside of the range of real people is marked "!". The last column names the controls that lie inside the range
by the same figure: what is known to be wrong and passes. A figure that a control passes proves nothing of that kind of
wrong, however good its value. Which figures refuse a control stands in the table of controls.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from data_module.types import Array, Motion
from eval import stats
from eval.baselines import controls as baselines
from eval.metrics import EYE_METRICS, eye
from eval.metrics.eye import ReferenceSpace, VoiceActivity, frechet
from eval.stats import Interval
from eval.table import Cell, Column, Table

POOLED, TO_CORPUS = "eye_frechet_pooled", "eye_frechet_corpus"
ROLLED = {"eye_above_1": "eye_rolled_1", "eye_above_2": "eye_rolled_2"}
"""PMB above chance, and what it is when the system hears the sound rolled."""
_TITLES = {POOLED: "window Frechet distance to real, all clips together",
           TO_CORPUS: "window Frechet distance to the corpus, all clips together",
           "eye_rolled_1": "the same with the sound rolled by 60 blocks, %, first",
           "eye_rolled_2": "the same with the sound rolled by 60 blocks, %, second"}
CONTROLS = ("mirrored", "still", "reversed", "jitter", "bobbing", "splayed", "frozen")
CORPUS = "corpus"


def rows() -> list[str]:
    """The figures of a table, top to bottom."""
    out: list[str] = []
    for name in eye.FIGURES:
        out.append(name)
        if name in ROLLED:
            out.append(ROLLED[name])
    return [*out, POOLED, TO_CORPUS]


def heading(name: str) -> str:
    """Title and unit of a row."""
    return _TITLES[name] if name in _TITLES else EYE_METRICS[name].heading


@dataclass
class EyeSample:
    """What was measured of one system. values: figure -> one of each clip; windows: of each clip, [n, 40]; groups: of
    each clip, those of one group are alike; seconds: of all clips."""

    values: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in rows()})
    windows: list[Array] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, motion: Motion, heard: VoiceActivity | None = None, edges: Array | None = None,
            space: ReferenceSpace | None = None, *, group: str = "", rolled: Motion | None = None) -> None:
        """Measure a clip. heard: of its own speech; edges: of its own blocks; rolled: what the system makes of the same
        sound rolled."""
        body = eye.common_body(motion)
        found = eye.of_body(body, heard, edges, space)
        if rolled is not None and heard is not None:
            late = eye.figures(rolled, heard)
            found |= {name: late[own] for own, name in ROLLED.items()}
        for name, values in self.values.items():
            values.append(found.get(name, math.nan))
        self.windows.append(frechet.windows(body))
        self.groups.append(group or str(len(self.groups)))
        self.seconds += body.duration

    def figures(self, space: ReferenceSpace | None = None, corpus: EyeSample | None = None) -> dict[str, Interval]:
        """Every row: the mean of the clips with its interval (groups are drawn together), and the distances of all
        windows together."""
        # Renderings of one recording alone are the unit; of several recordings, the recordings are.
        groups = self.groups if len(set(self.groups)) > 1 else None
        out = {name: stats.mean_interval(values, groups=groups) if len(values) > 1 else Interval.exact(values[0], 1)
               for name, values in self.values.items()}
        if space is not None:
            out[POOLED] = self.pooled(space, None)
            if corpus is not None:
                out[TO_CORPUS] = self.pooled(space, corpus)
        return out

    def pooled(self, space: ReferenceSpace, other: EyeSample | None) -> Interval:
        """Frechet distance of all windows together from real people's, or from another sample's, with the basic
        bootstrap's interval over clips."""
        seen = [space.see(windows) for windows in self.windows]
        target = space.real if other is None else space.moments(np.concatenate(other.windows))
        if target is None:
            return Interval.undefined(len(seen))

        def distance(chosen: Array) -> float:
            own = frechet.Moments.of(np.concatenate([seen[k] for k in chosen]))
            return math.nan if own is None else frechet.frechet(own, target)

        return stats.of_set(distance, len(seen), least=0.0)


def controls(motion: Motion, heard: VoiceActivity | None, space: ReferenceSpace | None) -> dict[str, EyeSample]:
    """Every one of `CONTROLS`, made of a real motion of the 16-joint character; bobbing needs its speech."""
    made = {"mirrored": baselines.mirrored([motion]), "still": baselines.mean_pose([motion]),
            "reversed": baselines.reversed_in_time([motion]), "jitter": baselines.jittered([motion], 0)}
    if heard is not None:
        made["bobbing"] = baselines.bobbing([motion], [heard.onsets[0]])
    made["splayed"] = baselines.splayed([motion])
    if heard is not None:
        made["frozen"] = baselines.frozen_in_pauses([motion], [heard.silent])
    out = {}
    for name, clips in made.items():
        out[name] = EyeSample()
        # Edges as a system would have them: what has no seams must not be praised where there are no edges.
        out[name].add(clips[0], heard, np.arange(0.0, clips[0].duration, 0.35), space)
    return out


def passing(name: str, of_controls: Mapping[str, Mapping[str, Interval]]) -> list[str]:
    """The controls that lie in the range of real people by a figure, and those that are known to."""
    known = EYE_METRICS[name].fooled_by if name in EYE_METRICS else ()
    return [control for control in CONTROLS if control in known or (
        control in of_controls and eye.within(name, of_controls[control][name].mean))]


def eye_tables(samples: Mapping[str, EyeSample], of_controls: Mapping[str, EyeSample], space: ReferenceSpace | None,
               title: str, notes: Sequence[str] = (), facts: Mapping[str, Any] | None = None) -> list[Table]:
    """The table of the systems, and that of the controls; rows without any value are left out."""
    corpus = samples.get(CORPUS)
    figures = {name: sample.figures(space, corpus) for name, sample in samples.items()}
    wrong = {name: sample.figures(space, corpus) for name, sample in of_controls.items()}
    shown = [row for row in rows() if any(math.isfinite(own[row].mean) for own in figures.values())]
    seconds = ", ".join(f"{name} {sample.seconds:.0f} s in {len(sample.groups)}" for name, sample in samples.items())
    head = (f"Motion and clips: {seconds}. Means over clips with bootstrap 95 % intervals; for one recording "
            "rendered several times the interval is over seeds only.")
    marks = ('"!": outside the range of two real people (whole and in halves, widened by a quarter; or a rule: seams, '
             "freezes, torso, yaw, drift, Frechet). Last column: negative controls that this figure does not detect.")
    systems = Table(title, {**{name: Column(name) for name in samples}, "range": Column("real people"),
                            "controls": Column("passed by")},
                    {heading(row): {**{name: _cell(row, own[row]) for name, own in figures.items()},
                                    "range": _range(row), "controls": ", ".join(passing(row, wrong))} for row in shown},
                    head="figure", notes=[head, marks, *notes],
                    facts={"figures": {name: {row: own[row].to_dict() for row in shown}
                                       for name, own in figures.items()}, **(facts or {})})
    controls_table = Table("Controls, made of the real take" if wrong else "Controls",
                           {name: Column(name) for name in wrong},
                           {heading(row): {name: _cell(row, own[row]) for name, own in wrong.items()}
                            for row in shown if any(math.isfinite(own[row].mean) for own in wrong.values())},
                           head="figure", notes=[_verdicts(wrong)] if wrong else [],
                           facts={"figures": {name: {row: own[row].to_dict() for row in shown}
                                              for name, own in wrong.items()}})
    return [systems, controls_table] if wrong else [systems]


def _verdicts(wrong: Mapping[str, Mapping[str, Interval]]) -> str:
    """How many figures refuse each control."""
    told = []
    for control, figures in wrong.items():
        known = [name for name in figures if eye.within(name, figures[name].mean) is not None]
        refused = [name for name in known if eye.within(name, figures[name].mean) is False]
        told.append(f"{control}: {len(refused)} of {len(known)} figures refuse it")
    return "; ".join(told) + "."


def _digits(row: str) -> int:
    return EYE_METRICS[row].digits if row in EYE_METRICS else 0 if row in ROLLED.values() else 1


def _cell(row: str, value: Interval) -> Cell:
    if not math.isfinite(value.mean):
        return None
    outside = eye.within(row, value.mean) is False
    return value.text(_digits(row)) + (" !" if outside else "")


def _range(row: str) -> str:
    if row not in eye.RANGES:
        return ""
    low, high = eye.RANGES[row]
    return f"{low:.{_digits(row)}f} to {high:.{_digits(row)}f}"
