"""The group `motion`: does it read as a person? One bundle beside the corpus, other systems and a real take.

Everything is a mean over renderings: of the real take's voice with several seeds, and of every voice of the test split.
The corpus is the test split's own motion for those voices. The figures are those of `eval.metrics.eye` and `timing`;
the bounds that they must keep stand in `bounds.toml`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from data_module.blocks import cut
from eval.acceptance import timing
from eval.acceptance.bounds import Measured, Results, bounds_of, mark
from eval.acceptance.timing import Timed
from eval.metrics import EYE_METRICS, eye
from eval.metrics.eye import ReferenceSpace
from eval.metrics.eye.sample import CORPUS, POOLED, TO_CORPUS, EyeSample, heading
from eval.renderings import TEST, AcceptanceVoice, Pair, RenderedSystem
from eval.stats import Interval
from eval.table import Cell, Column, Table

OURS, REAL, WITHOUT_SOUND = "ours", "real take", "statistical"
"""`WITHOUT_SOUND`: the bundle with an interpreter that ignores the sound."""
ON_TAKE, ON_TEST = "BEAT voice", "test split"
"""Sets of stimuli: the voice of the real take, and those of the store's test split."""
SHOWN = ("eye_hand_height_correlation", "eye_hand_speed_correlation", "eye_one_handed", "eye_one_hanging", "eye_head",
         "eye_chest", *(f"eye_speed_{percent}" for percent in eye.hands.PERCENTILES), "eye_stroke_amplitude",
         "eye_stroke_amplitude_90", "eye_seam", TO_CORPUS, POOLED, "eye_frechet", "eye_above_1", "eye_rolled_1",
         "eye_above_2", "eye_rolled_2", "eye_silence_speed", "eye_drift", "eye_repetition", "eye_hand_in_torso")
"""Rows of the comparison below those with a bound."""
Intervals = dict[str, Interval]


def sample_of(pairs: Sequence[tuple[AcceptanceVoice, Pair]], space: ReferenceSpace | None) -> EyeSample:
    """Renderings measured; the interval draws those of one group of voices together."""
    sample = EyeSample()
    for spoken, (rendering, late) in pairs:
        sample.add(rendering.motion, spoken.heard, rendering.edges, space, group=spoken.group or spoken.name,
                   rolled=None if late is None else late.motion)
    return sample


def own_motion(voices: Sequence[AcceptanceVoice], space: ReferenceSpace | None) -> EyeSample:
    """The motion of the speakers themselves, with seams where a system would cut; a real take has no seams."""
    sample = EyeSample()
    for spoken in voices:
        if spoken.own is not None:
            # Nothing was joined in a real take; a corpus is judged at the seams that a system would have made.
            edges = cut(spoken.speech).edges if spoken.place == TEST else None
            sample.add(spoken.own, spoken.heard, edges, space, group=spoken.group or spoken.name)
    return sample


def renderings_on(system: RenderedSystem, voices: Sequence[AcceptanceVoice], renderings: int
                  ) -> list[tuple[AcceptanceVoice, Pair]]:
    """The real take's voice with every seed; of the test split each voice once, with a seed of its own."""
    return [(said, pair) for k, said in enumerate(voices)
            for pair in system.pairs(said, [k % renderings] if said.place == TEST else range(renderings))]


def comparison(on: str, figures: Mapping[str, Mapping[str, Interval]]) -> Table:
    """The figures of all systems beside each other, those with a bound first; "!" where a system misses it."""
    bounds = bounds_of("motion")
    # First what is judged, then what is only shown, each figure once.
    judged = [name for name in bounds if name in EYE_METRICS or name in timing.TITLES]
    rows = [row for row in dict.fromkeys((*judged, *timing.TITLES, *SHOWN))
            if any(row in values and math.isfinite(values[row].mean) for values in figures.values())]
    cells: dict[str, dict[str, Cell]] = {}
    for row in rows:
        digits, limits = _digits(row), bounds.get(row)
        # A limit that is relative to another set differs from column to column, so none is printed beside the row.
        plain = limits is not None and not (limits.over or limits.limit)
        cells[timing.TITLES.get(row) or heading(row)] = {
            "bound": limits.bound.text(digits) if limits is not None and plain else "",
            **{name: values[row].text(digits) + (mark(row, values[row]) if plain else "") if row in values else None
               for name, values in figures.items()}}
    columns = {"bound": Column("bound"), **{name: Column(name) for name in figures}}
    return Table(f"Beside others, {on}", columns, cells, "figure", ['"!": outside of the bound.'],
                 facts={"figures": {name: {row: values[row].to_dict() for row in rows if row in values}
                                    for name, values in figures.items()}})


def _digits(row: str) -> int:
    return EYE_METRICS[row].digits if row in EYE_METRICS else timing.DIGITS.get(row, 1)


def measure(systems: Sequence[RenderedSystem], voices: Sequence[AcceptanceVoice], renderings: int,
            space: ReferenceSpace | None) -> tuple[Results, list[Table]]:
    """The group `motion` of the first system, and tables of all beside each other."""
    takes, tests = ([voice for voice in voices if (voice.place == TEST) == test] for test in (False, True))
    corpus, real = own_motion(tests, space) if tests else None, own_motion(takes, space)
    results: Results = {}
    tables = []
    for on, chosen in ((ON_TAKE, takes), (ON_TEST, tests)):
        if not chosen:
            continue
        figures: dict[str, Intervals] = {}
        timed: dict[str, list[Timed]] = {}
        for system in systems:
            pairs = renderings_on(system, chosen, renderings)
            if pairs:
                timed[system.name] = [Timed.of(rendering.motion, voice) for voice, (rendering, _) in pairs]
                figures[system.name] = {**sample_of(pairs, space).figures(space, corpus),
                                        **timing.figures(timed[system.name])}
        if corpus is not None:
            figures[CORPUS] = _own_figures(tests, corpus, space, corpus)
            results |= {(name, CORPUS): Measured(value) for name, value in figures[CORPUS].items()}
        if real.windows:
            figures[REAL] = _own_figures(takes, real, space, corpus)
        # Without a store or a space some figures are not there at all: their rows say why instead of vanishing.
        results |= {(name, on): Measured() for name in (timing.PITCH_P, POOLED, TO_CORPUS)}
        results |= {(name, on): Measured(value) for name, value in figures[OURS].items()}
        tables.append(comparison(on, figures))
        if len(chosen) > 1:
            tables.append(timing.paired_table(timed, OURS))
    return results, tables


def _own_figures(voices: Sequence[AcceptanceVoice], sample: EyeSample, space: ReferenceSpace | None,
                 corpus: EyeSample | None) -> Intervals:
    """The figures of the speakers' own motion."""
    return {**sample.figures(space, corpus),
            **timing.figures([Timed.of(voice.own, voice) for voice in voices if voice.own is not None])}
