"""The group `motion`: does it read as a person? One bundle beside the corpus, other systems and a real take.

Everything is a mean over renderings: of the real take's voice with several seeds, and of every voice of the test split.
The corpus is the test split's own motion for those voices. The figures are those of `eval.metrics.eye` and `timing`;
the bounds that they must keep stand in `bounds.toml`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from data_module.blocks import cut
from data_module.types import Array, Motion
from eval.acceptance import timing
from eval.acceptance.bounds import Measured, Results, bounds_of, mark
from eval.acceptance.timing import Timed
from eval.metrics import EYE_METRICS, eye, pmb
from eval.metrics.eye import ReferenceSpace, VoiceActivity, common_body, voice
from eval.metrics.eye.sample import CORPUS, POOLED, TO_CORPUS, EyeSample, heading
from eval.metrics.fgd import frechet_distance
from eval.metrics.mismatch import Mismatch, mismatch, wrapped
from eval.renderings import TEST, AcceptanceVoice, Pair, RenderedSystem
from eval.stats import Interval
from eval.table import Cell, Column, Table

OURS, REAL, WITHOUT_SOUND = "ours", "real take", "statistical"
"""`WITHOUT_SOUND`: the bundle with an interpreter that ignores the sound."""
ON_TAKE, ON_TEST = "BEAT voice", "test split"
"""Sets of stimuli: the voice of the real take, and those of the store's test split."""
PIECE, LEAST_PIECE = 20.0, 8.0
"""Seconds of a piece of the mismatch test, and of the last one of a voice."""
HALVINGS = 200
SHOWN = ("eye_hand_height_correlation", "eye_hand_speed_correlation", "eye_one_handed", "eye_one_hanging", "eye_head",
         "eye_chest", *(f"eye_speed_{percent}" for percent in eye.hands.PERCENTILES), "eye_stroke_amplitude",
         "eye_stroke_amplitude_90", "eye_seam", TO_CORPUS, POOLED, "eye_frechet", "eye_above_1", "eye_rolled_1",
         "eye_above_2", "eye_rolled_2", "eye_silence_speed", "eye_drift", "eye_repetition", "eye_variation",
         "eye_units", "eye_unit_length", "eye_freeze_head", "eye_hand_in_torso")
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
            edges = cut(spoken.speech).edges if spoken.place == TEST else None
            sample.add(spoken.own, spoken.heard, edges, space, group=spoken.group or spoken.name)
    return sample


def halves(corpus: EyeSample, space: ReferenceSpace) -> Interval:
    """How far one half of the corpus' recordings lies from the other, over `HALVINGS` ways to halve them.

    It is what a distance between so few recordings is by chance; the interval holds 95 % of the ways.
    """
    windows, rng = [space.see(each) for each in corpus.windows], np.random.default_rng(0)
    if len(windows) < 2:
        return Interval.undefined(len(windows))
    distances = []
    for _ in range(HALVINGS):
        order = rng.permutation(len(windows))
        first, second = (eye.frechet.moments_of(np.concatenate([windows[k] for k in half]))
                         for half in (order[:len(windows) // 2], order[len(windows) // 2:]))
        if first is None or second is None:  # fewer windows than a covariance takes
            return Interval.undefined(len(windows))
        distances.append(frechet_distance(first, second))
    # The spread of the halvings themselves, not of their mean: it is the range of distances that chance gives.
    low, high = np.percentile(distances, [2.5, 97.5])
    return Interval(float(np.mean(distances)), float(low), float(high), len(windows))


def mismatches(pieces: Sequence[tuple[Motion, VoiceActivity]]) -> tuple[Mismatch, Mismatch]:
    """Is the right sound preferred to another's, by PMB at 0.1 s of each detector? Motion and sound are cut into
    pieces of `PIECE`; another's onsets go round and round until they are as long."""
    beats: list[tuple[Array, Array]] = []
    onsets: list[tuple[Array, Array]] = []
    lengths: list[float] = []
    for motion, activity in pieces:
        hands = common_body(motion).hands
        detected = voice.hand_beats(hands), voice.summed_beats(hands)
        length = min(motion.duration, activity.duration)
        for start in np.arange(0.0, max(length - LEAST_PIECE, 0.1), PIECE):
            stop = min(start + PIECE, length)
            first, second = (times[(times >= start) & (times < stop)] - start for times in detected)
            beats.append((first, second))
            first, second = (times[(times >= start) & (times < stop)] - start for times in activity.onsets)
            onsets.append((first, second))
            lengths.append(stop - start)

    def table(detector: int) -> Array:
        return np.array([[pmb.pmb(moved[detector], wrapped(said[detector], length, duration), voice.DELTA)
                          for said, length in zip(onsets, lengths, strict=True)]
                         for moved, duration in zip(beats, lengths, strict=True)])

    return mismatch(table(0)), mismatch(table(1))


def mismatch_figure(pieces: Sequence[tuple[Motion, VoiceActivity]]) -> Measured:
    """p of the first detector; real people are at chance in it."""
    first, second = mismatches(pieces)
    remark = (f"right {first.right:.0f} %, wrong {first.wrong:.0f} %, {first.difference.n} pieces; second detector p "
              f"{second.p_value:.4f}")
    return Measured(Interval.exact(first.p_value, first.difference.n), first.reason or remark)


def renderings_on(system: RenderedSystem, voices: Sequence[AcceptanceVoice], renderings: int
                  ) -> list[tuple[AcceptanceVoice, Pair]]:
    """The real take's voice with every seed; of the test split each voice once, with a seed of its own."""
    return [(said, pair) for k, said in enumerate(voices)
            for pair in system.pairs(said, [k % renderings] if said.place == TEST else range(renderings))]


def comparison(on: str, figures: Mapping[str, Mapping[str, Interval]]) -> Table:
    """The figures of all systems beside each other, those with a bound first; "!" where a system misses it."""
    bounds = bounds_of("motion")
    judged = [name for name in bounds if name in EYE_METRICS or name in timing.TITLES]
    rows = [row for row in dict.fromkeys((*judged, *timing.TITLES, *SHOWN))
            if any(row in values and math.isfinite(values[row].mean) for values in figures.values())]
    cells: dict[str, dict[str, Cell]] = {}
    for row in rows:
        digits, limits = _digits(row), bounds.get(row)
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
    corpus = own_motion(tests, space) if tests else None
    results: Results = {}
    tables, pieces = [], []
    for on, chosen in ((ON_TAKE, takes), (ON_TEST, tests)):
        if not chosen:
            continue
        figures, paired, pairs = _measured(systems, chosen, renderings, space, corpus)
        if corpus is not None:
            figures[CORPUS] = _own_figures(tests, corpus, space, corpus)
            results |= {(name, CORPUS): Measured(value) for name, value in figures[CORPUS].items()}
        real = own_motion(takes, space)
        if real.windows:
            figures[REAL] = _own_figures(takes, real, space, corpus)
        results |= {(name, on): Measured(value) for name, value in figures[OURS].items()}
        results |= {(name, on): Measured() for name in (timing.PITCH_P, POOLED, TO_CORPUS)
                    if name not in figures[OURS]}
        tables += [comparison(on, figures), *paired]
        pieces += pairs
    if corpus is not None:
        results["halves", ON_TEST] = Measured(Interval.undefined() if space is None else halves(corpus, space),
                                              f"halved at random in {HALVINGS} ways")
    return results | {("mismatch_p", ""): mismatch_figure(pieces)}, tables


def _measured(systems: Sequence[RenderedSystem], voices: Sequence[AcceptanceVoice], renderings: int,
              space: ReferenceSpace | None, corpus: EyeSample | None
              ) -> tuple[dict[str, Intervals], list[Table], list[tuple[Motion, VoiceActivity]]]:
    """The figures of every system that has motion for these voices; the first system paired with the others; and its
    motion with the sound, each voice once, as the same voice twice would be its own wrong sound."""
    figures: dict[str, Intervals] = {}
    timed: dict[str, list[Timed]] = {}
    once: dict[str, tuple[Motion, VoiceActivity]] = {}
    for system in systems:
        pairs = renderings_on(system, voices, renderings)
        if system.name == OURS:
            once = {voice.name: (rendering.motion, voice.heard) for voice, (rendering, _) in reversed(pairs)}
        if pairs:
            timed[system.name] = [Timed.of(rendering.motion, voice) for voice, (rendering, _) in pairs]
            figures[system.name] = {**sample_of(pairs, space).figures(space, corpus),
                                    **timing.figures(timed[system.name])}
    beside = [timing.paired_table(timed, OURS)] if len(voices) > 1 else []
    return figures, beside, list(once.values())


def _own_figures(voices: Sequence[AcceptanceVoice], sample: EyeSample, space: ReferenceSpace | None,
                 corpus: EyeSample | None) -> Intervals:
    """The figures of the speakers' own motion."""
    return {**sample.figures(space, corpus),
            **timing.figures([Timed.of(voice.own, voice) for voice in voices if voice.own is not None])}
