"""Point by point, what the eye must see: ours beside the corpus, other systems and a real take.

Everything is a mean over renderings: of the real take's voice with several seeds, and of every voice of the test split.
The corpus is the test split's own motion for those voices. The figures are `eval.metrics.eye`'s and `timing`'s; what
they must keep stands in `bounds`, and what each system makes of that in the comparison.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from data_module.blocks import cut
from data_module.types import Array, Motion
from eval.acceptance.motion import bounds, timing
from eval.acceptance.motion.bounds import Figures
from eval.acceptance.motion.timing import Timed
from eval.claim import ANY, Bound, Verdict, at_most, judged, skipped
from eval.metrics import eye, pmb
from eval.metrics.eye import ReferenceSpace, VoiceActivity, common_body, voice
from eval.metrics.eye.sample import CORPUS, POOLED, TO_CORPUS, EyeSample, heading
from eval.metrics.mismatch import Mismatch, mismatch, wrapped
from eval.renderings import TEST, AcceptanceVoice, Pair, RenderedSystem
from eval.stats import Interval
from eval.table import Cell, Column, Table

OURS, REAL, DEAF = "ours", "real take", "statistical"
"""`DEAF`: ours with an interpreter that ignores the sound."""
PIECE, LEAST_PIECE = 20.0, 8.0
"""Seconds of a piece of the mismatch test, and of the last one of a voice."""
REPEATS = 0.1
"""Share by which repetition may differ from the corpus'."""
POOLED_BOUND = 15.0
"""Frechet distance of all windows on the real take's voice from real people's."""
_HALVED = 200
SHOWN = ("eye_hand_height_correlation", "eye_hand_speed_correlation", "eye_one_handed", "eye_one_hanging", "eye_head",
         "eye_chest", *(f"eye_speed_{percent}" for percent in eye.hands.PERCENTILES), "eye_stroke_amplitude",
         "eye_stroke_amplitude_90", "eye_seam", TO_CORPUS, POOLED, "eye_frechet", "eye_above_1", "eye_rolled_1",
         "eye_above_2", "eye_rolled_2", "eye_silence_speed", "eye_drift", "eye_repetition", "eye_variation",
         "eye_units", "eye_unit_length", "eye_freeze_head", "eye_hand_in_torso")
"""Rows of the comparison below those with a bound."""


def sample_of(pairs: Sequence[tuple[AcceptanceVoice, Pair]], space: ReferenceSpace | None) -> EyeSample:
    """Renderings measured; those of one group of voices are drawn together."""
    sample = EyeSample()
    for said, (made, late) in pairs:
        sample.add(made.motion, said.heard, made.edges, space, group=said.group or said.name,
                   rolled=None if late is None else late.motion)
    return sample


def own_motion(voices: Sequence[AcceptanceVoice], space: ReferenceSpace | None) -> EyeSample:
    """What the speakers themselves do, with seams where a system would cut; a real take has none to be judged by."""
    sample = EyeSample()
    for said in voices:
        if said.own is not None:
            edges = cut(said.speech).edges if said.place == TEST else None
            sample.add(said.own, said.heard, edges, space, group=said.group or said.name)
    return sample


# ----------------------------------------------------------------------------------------------------------- clauses

def clauses(where: str, ours: Figures, corpus: Figures | None, judged_pooled: bool) -> list[Verdict]:
    """What is asked of ours on some voices; where: their name; judged_pooled: whether the distance of all windows
    together from real people's has its bound here. Without a corpus what is asked against it is not measured."""
    pooled = f"window Frechet to the reference, {where}"
    to_corpus = f"window Frechet to the corpus, {where}"
    return [*bounds.verdicts(where, ours), *_against_corpus(where, ours, corpus),
            _distance(pooled, ours, POOLED, at_most(POOLED_BOUND) if judged_pooled else ANY),
            _distance(to_corpus, ours, TO_CORPUS, ANY),
            *(judged(f"{heading(row)}, {where}", ours[row], ANY, digits=0, reason="shown only: people are at chance")
              for row in ("eye_above_1", "eye_above_2") if row in ours)]


def _against_corpus(where: str, ours: Figures, corpus: Figures | None) -> list[Verdict]:
    """Repetition and drift beside the corpus'."""
    names = f"{heading('eye_repetition')} over the corpus', {where}", f"{heading('eye_drift')}, {where}"
    if corpus is None:
        return [skipped(name, "no store was given") for name in names]
    own, theirs = ours["eye_repetition"], corpus["eye_repetition"].mean
    return [judged(names[0], own.times(1.0 / theirs), Bound(1 - REPEATS, 1 + REPEATS),
                   reason=f"{own.mean:.2f} and {theirs:.2f}"),
            judged(names[1], ours["eye_drift"], at_most(corpus["eye_drift"].mean), digits=1,
                   reason="the bound is the corpus'")]


def _distance(name: str, ours: Figures, row: str, bound: Bound) -> Verdict:
    if row not in ours or not math.isfinite(ours[row].mean):
        return skipped(name, "no reference space, or no store")
    return judged(name, ours[row], bound, digits=1, reason="all windows together")


def halves(corpus: EyeSample, space: ReferenceSpace) -> Interval:
    """How far one half of the corpus' recordings lies from the other, over `_HALVED` ways to halve them.

    It is what a distance between so few recordings is by chance; the interval holds 95 % of the ways.
    """
    seen, rng = [space.see(windows) for windows in corpus.windows], np.random.default_rng(0)
    if len(seen) < 2:
        return Interval.undefined(len(seen))
    found = []
    for _ in range(_HALVED):
        order = rng.permutation(len(seen))
        one, other = (eye.frechet.Moments.of(np.concatenate([seen[k] for k in part]))
                      for part in (order[:len(seen) // 2], order[len(seen) // 2:]))
        if one is None or other is None:  # fewer windows than a covariance takes
            return Interval.undefined(len(seen))
        found.append(eye.frechet.frechet(one, other))
    low, high = np.percentile(found, [2.5, 97.5])
    return Interval(float(np.mean(found)), float(low), float(high), len(seen))


def halves_clause(corpus: EyeSample, space: ReferenceSpace | None) -> Verdict:
    """Shown and not judged: what the distance to the corpus is to be read beside."""
    name = "window Frechet of one half of the corpus' recordings to the other, test split"
    if space is None:
        return skipped(name, "no reference space")
    return judged(name, halves(corpus, space), ANY, digits=1, reason=f"halved at random in {_HALVED} ways")


# ---------------------------------------------------------------------------------------------------------- mismatch

def mismatches(pieces: Sequence[tuple[Motion, VoiceActivity]]) -> tuple[Mismatch, Mismatch]:
    """Is the right sound preferred to another's, by PMB at 0.1 s of each detector? Motion and sound are cut into
    pieces of `PIECE`; another's onsets go round and round until they are as long."""
    beats: list[tuple[Array, Array]] = []
    onsets: list[tuple[Array, Array]] = []
    lengths: list[float] = []
    for motion, heard in pieces:
        hands = common_body(motion).hands
        own = voice.hand_beats(hands), voice.summed_beats(hands)
        length = min(motion.duration, heard.duration)
        for start in np.arange(0.0, max(length - LEAST_PIECE, 0.1), PIECE):
            stop = min(start + PIECE, length)
            first, second = (times[(times >= start) & (times < stop)] - start for times in own)
            beats.append((first, second))
            first, second = (times[(times >= start) & (times < stop)] - start for times in heard.onsets)
            onsets.append((first, second))
            lengths.append(stop - start)

    def table(detector: int) -> Array:
        return np.array([[pmb.pmb(mine[detector], wrapped(theirs[detector], length, own), voice.DELTA)
                          for theirs, length in zip(onsets, lengths, strict=True)]
                         for mine, own in zip(beats, lengths, strict=True)])

    return mismatch(table(0)), mismatch(table(1))


def mismatch_clause(pieces: Sequence[tuple[Motion, VoiceActivity]]) -> Verdict:
    """Shown and not judged: real people are at chance in it."""
    first, second = mismatches(pieces)
    told = (f"right {first.right:.0f} %, wrong {first.wrong:.0f} %, {first.difference.n} pieces; second detector p "
            f"{second.p_value:.4f}")
    return judged("mismatch test, p, first detector", Interval.exact(first.p_value, first.difference.n), ANY, digits=4,
                  reason=first.reason or told)


# ------------------------------------------------------------------------------------------------------------- group

def renderings_on(system: RenderedSystem, voices: Sequence[AcceptanceVoice], renderings: int
                  ) -> list[tuple[AcceptanceVoice, Pair]]:
    """The real take's voice with every seed; of the test split each voice once, with a seed of its own."""
    return [(said, pair) for k, said in enumerate(voices)
            for pair in system.pairs(said, [k % renderings] if said.place == TEST else range(renderings))]


def comparison(where: str, figures: Mapping[str, Figures]) -> Table:
    """The figures of all systems beside each other, those with a bound first; "!" where a system misses it."""
    rows = [row for row in (*bounds.BOUNDS, *timing.TITLES, *SHOWN)
            if any(row in own and math.isfinite(own[row].mean) for own in figures.values())]
    rows = list(dict.fromkeys(rows))
    cells: dict[str, dict[str, Cell]] = {}
    for row in rows:
        digits = bounds.digits(row)
        cells[bounds.title(row)] = {
            "bound": bounds.BOUNDS[row].text(digits) if row in bounds.BOUNDS else "",
            **{name: own[row].text(digits) + bounds.mark(row, own[row]) if row in own else None
               for name, own in figures.items()}}
    columns = {"bound": Column("bound"), **{name: Column(name) for name in figures}}
    return Table(f"Beside others, {where}", columns, cells, "figure", ['"!": outside of the bound.'],
                 facts={"figures": {name: {row: own[row].to_dict() for row in rows if row in own}
                                    for name, own in figures.items()}})


def run(systems: Sequence[RenderedSystem], voices: Sequence[AcceptanceVoice], renderings: int,
        space: ReferenceSpace | None) -> tuple[list[Verdict], list[Table]]:
    """Everything of this group. systems: ours first."""
    taken, tested = ([said for said in voices if (said.place == TEST) == test] for test in (False, True))
    corpus = own_motion(tested, space) if tested else None
    found, tables, pieces = [], [], []
    for where, heard in (("BEAT voice", taken), ("test split", tested)):
        if not heard:
            continue
        figures, paired, own = _measured(systems, heard, renderings, space, corpus)
        if corpus is not None:
            figures[CORPUS] = _own_figures(tested, corpus, space, corpus)
        real = own_motion(taken, space)
        if real.windows:
            figures[REAL] = _own_figures(taken, real, space, corpus)
        found += clauses(where, figures[OURS], figures.get(CORPUS), heard is taken)
        tables += [comparison(where, figures), *paired]
        pieces += own
    beside = [] if corpus is None else [halves_clause(corpus, space)]
    return [*found, *beside, mismatch_clause(pieces)], tables


def _measured(systems: Sequence[RenderedSystem], voices: Sequence[AcceptanceVoice], renderings: int,
              space: ReferenceSpace | None, corpus: EyeSample | None
              ) -> tuple[dict[str, dict[str, Interval]], list[Table], list[tuple[Motion, VoiceActivity]]]:
    """The figures of every system that has motion for these voices; ours paired with the others; and ours
    with its sound, each voice once, as the same voice twice would be its own wrong sound."""
    figures: dict[str, dict[str, Interval]] = {}
    timed: dict[str, list[Timed]] = {}
    once: dict[str, tuple[Motion, VoiceActivity]] = {}
    for system in systems:
        pairs = renderings_on(system, voices, renderings)
        if system.name == OURS:
            once = {said.name: (made.motion, said.heard) for said, (made, _) in reversed(pairs)}
        if pairs:
            timed[system.name] = [Timed.of(made.motion, said) for said, (made, _) in pairs]
            figures[system.name] = {**sample_of(pairs, space).figures(space, corpus),
                                    **timing.figures(timed[system.name])}
    beside = [timing.paired_table(timed, OURS)] if len(voices) > 1 else []
    return figures, beside, list(once.values())


def _own_figures(voices: Sequence[AcceptanceVoice], sample: EyeSample, space: ReferenceSpace | None,
                 corpus: EyeSample | None) -> dict[str, Interval]:
    """Of what the speakers themselves do."""
    return {**sample.figures(space, corpus),
            **timing.figures([Timed.of(said.own, said) for said in voices if said.own is not None])}
