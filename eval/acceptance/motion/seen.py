"""Point by point, what the eye must see: ours beside the corpus, unit selection, other systems and a real take.

Everything is a mean over renderings: of the real take's voice with several seeds, and of every voice of the test split.
The corpus is the test split's own motion for those voices. The figures are `eval.metrics.eye`'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from data_module.blocks import cut
from data_module.types import Array, Motion
from eval.baselines.unit_selection import NAME as UNITS
from eval.claim import ANY, Bound, Verdict, at_least, at_most, judged, skipped
from eval.metrics import EYE_METRICS, eye, pmb
from eval.metrics.eye import ReferenceSpace, VoiceActivity, common_body, voice
from eval.metrics.eye.sample import CORPUS, POOLED, TO_CORPUS, EyeSample, heading
from eval.metrics.mismatch import Mismatch, mismatch, wrapped
from eval.runner.renderings import TEST, AcceptanceVoice, Pair, RenderedSystem
from eval.stats import Interval
from eval.table import Cell, Column, Table

OURS, REAL = "ours", "real take"
PIECE, LEAST_PIECE = 20.0, 8.0
"""Seconds of a piece of the mismatch test, and of the last one of a voice."""
MIDDLE, ENDS = 0.2, 0.4
"""How far the percentiles of hand speed may be from the corpus': 25 to 95 %, and 5 and 99 %."""
REPEATS = 0.1
_HALVED = 200
TO_REFERENCE = 1.25
"""Times unit selection's distance from the reference."""
FINGERS = 30.0
"""Percent of the time that some finger moves: the least of the real people's range."""
SHOWN = ("eye_hand_height_correlation", "eye_hand_speed_correlation", "eye_one_handed", "eye_one_hanging", "eye_head",
         "eye_chest", *(f"eye_speed_{percent}" for percent in eye.hands.PERCENTILES), "eye_stroke_amplitude",
         "eye_stroke_amplitude_90", "eye_seam", TO_CORPUS, POOLED, "eye_frechet", "eye_above_1", "eye_rolled_1",
         "eye_above_2", "eye_rolled_2", "eye_silence_speed", "eye_drift", "eye_repetition", "eye_fingers",
         "eye_freeze_head", "eye_hand_in_torso")
"""Rows of the comparison."""
Figures = Mapping[str, Interval]


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

def clauses(where: str, ours: Figures, corpus: Figures | None, units: Figures | None) -> list[Verdict]:
    """What is asked of ours on some voices; where: their name. Without corpus or unit selection what is asked against
    them is not measured."""
    def eye_clause(name: str, bound: Bound, reason: str = "") -> Verdict:
        return judged(f"{_title(name)}, {where}", ours[name], bound, digits=_digits(name), reason=reason)

    out = [eye_clause("eye_hand_height_correlation", at_most(0.60)),
           eye_clause("eye_hand_speed_correlation", at_most(0.68)),
           eye_clause("eye_one_handed", at_least(18.0)), eye_clause("eye_one_hanging", at_least(12.0)),
           eye_clause("eye_head", Bound(7.0, 14.0)), eye_clause("eye_chest", Bound(4.0, 9.0)),
           *_against_corpus(where, ours, corpus),
           eye_clause("eye_stroke_amplitude", at_least(20.0)), eye_clause("eye_stroke_amplitude_90", at_least(38.0)),
           eye_clause("eye_seam", at_most(1.20)), *_distances(where, ours, units), *_timing(where, ours, units),
           eye_clause("eye_silence_speed", at_most(0.2))]
    name = f"{_title('eye_fingers')}, {where}"
    out.append(eye_clause("eye_fingers", at_least(FINGERS)) if math.isfinite(ours["eye_fingers"].mean)
               else skipped(name, "the motion has no finger joints"))
    return out


def _title(name: str) -> str:
    return heading(name).rsplit(",", 1)[0] if name.startswith("eye_speed") else heading(name)


def _digits(name: str) -> int:
    return EYE_METRICS[name].digits if name in EYE_METRICS else 1


def _against_corpus(where: str, ours: Figures, corpus: Figures | None) -> list[Verdict]:
    """Hand speed, repetition and drift beside the corpus'."""
    out = []
    wanted = [(f"eye_speed_{percent}", MIDDLE if 25 <= percent <= 95 else ENDS) for percent in eye.hands.PERCENTILES]
    for row, apart in (*wanted, ("eye_repetition", REPEATS)):
        name = f"{_title(row)} over the corpus', {where}"
        if corpus is None:
            out.append(skipped(name, "no store was given"))
        else:
            told = f"{ours[row].mean:.2f} and {corpus[row].mean:.2f}"
            out.append(judged(name, ours[row].times(1.0 / corpus[row].mean), Bound(1 - apart, 1 + apart),
                              reason=told))
    name = f"{heading('eye_drift')}, {where}"
    out.append(skipped(name, "no store was given") if corpus is None else
               judged(name, ours["eye_drift"], at_most(corpus["eye_drift"].mean), digits=1,
                      reason="the bound is the corpus'"))
    return out


def _distances(where: str, ours: Figures, units: Figures | None) -> list[Verdict]:
    """Frechet to the corpus and to the reference."""
    out = []
    for row, told in ((TO_CORPUS, "to the corpus"), (POOLED, "to the reference")):
        name = f"window Frechet {told}, {where}"
        if row not in ours or not math.isfinite(ours[row].mean):
            out.append(skipped(name, "no reference space, or no store"))
        elif row == TO_CORPUS:
            out.append(judged(name, ours[row], at_most(4.0), digits=1, reason="all windows together"))
        elif units is None:
            out.append(judged(name, ours[row], ANY, digits=1, reason="no store for unit selection"))
        else:
            out.append(judged(name, ours[row], at_most(TO_REFERENCE * units[row].mean), digits=1,
                              reason=f"{TO_REFERENCE} times unit selection's {units[row].mean:.1f}"))
    return out


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


def _timing(where: str, ours: Figures, units: Figures | None) -> list[Verdict]:
    """PMB above chance, with the sound rolled, and both it and seams beside unit selection's."""
    first, second = ours["eye_above_1"], ours["eye_above_2"]
    out = [judged(f"PMB above chance, %, first detector, {where}", first, at_least(40.0), digits=0),
           judged(f"PMB above chance, %, second detector, {where}", second, ANY, digits=0,
                  reason="in addition to the first, which has the bound")]
    name = f"PMB of rolled sound, %, first detector, {where}"
    rolled = ours["eye_rolled_1"]
    out.append(judged(name, rolled, at_most(0.5 * first.mean), digits=0, reason="half of the right sound's")
               if math.isfinite(rolled.mean) else skipped(name, "the system was not rendered here"))
    for row, told in (("eye_seam", "seams beside unit selection's"), ("eye_above_1", "PMB beside unit selection's")):
        if units is None:
            out.append(skipped(f"{told}, {where}", "no store was given"))
        else:
            bound = at_most if row == "eye_seam" else at_least
            out.append(judged(f"{told}, {where}", ours[row], bound(units[row].mean), digits=_digits(row)))
    return out


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
    """p below .001 by the first detector."""
    first, second = mismatches(pieces)
    told = (f"right {first.right:.0f} %, wrong {first.wrong:.0f} %, {first.difference.n} pieces; second detector p "
            f"{second.p_value:.4f}")
    return judged("mismatch test, p, first detector", Interval.exact(first.p_value, first.difference.n),
                  Bound(high=0.001, strict=True), digits=4, reason=first.reason or told)


# ------------------------------------------------------------------------------------------------------------- group

def renderings_on(system: RenderedSystem, voices: Sequence[AcceptanceVoice], renderings: int
                  ) -> list[tuple[AcceptanceVoice, Pair]]:
    """The real take's voice with every seed; of the test split each voice once, with a seed of its own."""
    return [(said, pair) for k, said in enumerate(voices)
            for pair in system.pairs(said, [k % renderings] if said.place == TEST else range(renderings))]


def comparison(where: str, figures: Mapping[str, Figures]) -> Table:
    """The figures of all systems beside each other."""
    rows = [row for row in SHOWN if any(row in own and math.isfinite(own[row].mean) for own in figures.values())]
    cells: dict[str, dict[str, Cell]] = {
        heading(row): {name: own[row].text(_digits(row)) if row in own else None for name, own in figures.items()}
        for row in rows}
    return Table(f"Beside others, {where}", {name: Column(name) for name in figures}, cells, "figure",
                 facts={"figures": {name: {row: own[row].to_dict() for row in rows if row in own}
                                    for name, own in figures.items()}})


def run(systems: Sequence[RenderedSystem], voices: Sequence[AcceptanceVoice], renderings: int,
        space: ReferenceSpace | None) -> tuple[list[Verdict], list[Table]]:
    """Everything of this group. systems: ours first; unit selection among them where there is a store."""
    tested, taken = ([said for said in voices if (said.place == TEST) == test] for test in (True, False))
    corpus = own_motion(tested, space) if tested else None
    real = own_motion(taken, space) if taken else None
    of_corpus = None if corpus is None else corpus.figures(space)
    found, tables, pieces = [], [], []
    for where, heard in (("BEAT voice", taken), ("test split", tested)):
        if not heard:
            continue
        figures: dict[str, Figures] = {}
        for system in systems:
            pairs = renderings_on(system, heard, renderings)
            if pairs:
                figures[system.name] = sample_of(pairs, space).figures(space, corpus)
            if system.name == OURS:
                # The same voice twice would be its own wrong sound.
                once = {said.name: (made.motion, said.heard) for said, (made, _) in reversed(pairs)}
                pieces += list(once.values())
        found += clauses(where, figures[OURS], of_corpus, figures.get(UNITS))
        if of_corpus is not None:
            figures[CORPUS] = of_corpus
        if real is not None and real.windows:
            figures[REAL] = real.figures(space, corpus)
        tables.append(comparison(where, figures))
    beside = [] if corpus is None else [halves_clause(corpus, space)]
    return [*found, *beside, mismatch_clause(pieces)], tables
