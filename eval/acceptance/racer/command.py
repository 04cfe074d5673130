"""Does RACER pay? Every clause of its acceptance, with figure, interval, bound, verdict and reason.

    gesticulator probe racer --data STORE [--bundle DIR] --work DIR [--renderings 1] [--limit 12] [--seconds 40]
                             [--split val] [--control-steps 300] [--json FILE]

Groups: the gate of the reward; the judge on motion as it is played; aliveness; timing; the mismatch test; whether the
values are honest; the knob; what it costs. A clause that does not hold is kept, with what is known of why. `--work` is
the work folder of the bundle's training: the reward models lie there, and renderings are kept there. Intervals are
bootstrap 95 % over recordings. beta is the bundle's own, chosen on the validation split (`--split val` shows the knob
there, by the judge), never here.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import write_text
from eval import stats
from eval.ablate.policy import Decisions, PolicyJudge
from eval.acceptance.bounds import HIGH, POSITIVE, Bound, Verdict, at_least, at_most, judged, verdict_table
from eval.acceptance.racer import gate, values
from eval.acceptance.racer.playing import (
    CQL,
    CQL_MATCHED,
    LSTM,
    MAJORITY,
    MATCHED,
    PERFORMER,
    RANDOM,
    JudgedVoice,
    PlayedFigures,
    PlayedPolicy,
    advantage_row,
    figures,
    policies,
)
from eval.context import EvalContext
from eval.metrics import fgd, gesture_features
from eval.metrics.diversity import distinct_2, diversity, longest_run
from eval.renderings import BundleSystem, KeptRenderings, held_out_voices
from eval.stats import Interval
from eval.table import Cell, Column, Table
from gesticulator.bundle.files import bundle_folder, read_index
from gesticulator.training.stages.q_network import takes_of
from gesticulator.training.stages.reward import context_of, reward_table

BETAS = (0.0, 0.5, 1.0, 2.0)
"""Of the knob; 0 is the lstm."""
RECORDINGS = 12
"""Least test recordings for a verdict; fewer are said to decide nothing."""
GAIN_SHARE, DIVERSITY, RUNS, PAIRS, SPEED, FGD, PMB = 0.4, 0.9, 1.5, 0.9, 0.1, 0.1, -3.0
MOVED = 0.05
"""Share of the figures for the eye that may differ by chance alone."""
_SHOWN = {"judge": Column("judge", digits=4), "reward": Column("training reward", digits=4),
          "pmb": Column("PMB above chance", "%", 1), "speech_speed": Column("hands in speech", "m/s", 3),
          "silence_speed": Column("hands in silence", "m/s", 3)}
_CHOSEN = {"judge_return": Column("judging return", digits=3), "return": Column("training return", digits=3),
           "lexeme_diversity": Column("diversity", "nats"), "longest_run": Column("longest run", digits=1),
           "distinct_2": Column("distinct-2"), "rare": Column("out of distribution", "%", 1)}


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle, its work folder, and how much is measured."""
    EvalContext.arguments(parser)
    add = parser.add_argument
    add("--renderings", type=int, default=1, metavar="N", help="seeds per policy (default 1)")
    add("--seconds", type=float, default=40.0, metavar="S", help="seconds of each recording (default 40)")
    add("--split", default="test", choices=("val", "test"), help="split to use; val to choose beta")
    add("--control-steps", type=int, default=300, metavar="N",
        help="training steps of the two reward models with correct and shifted audio (default 300; 0 for none)")
    add("--json", type=Path, metavar="FILE",
        help="output file for the list of criteria, such as docs/results/racer_acceptance.json")


@dataclass(frozen=True)
class RacerMeasures:
    """All that the clauses are read from. played: by row; chosen: lexemes of whole recordings by row, [recordings] by
    column; betas: of the knob, in order, and the bundle's own."""

    played: Mapping[str, PlayedFigures]
    chosen: Mapping[str, values.Columns]
    betas: Sequence[float]
    beta: float

    @property
    def ours(self) -> str:
        """The row of the bundle's own beta."""
        return advantage_row(self.beta)

    def paired(self, key: str, first: str, second: str) -> Interval:
        """The mean of one row less another's, voice by voice."""
        return stats.paired(self.played[first].values[key], self.played[second].values[key])

    def mean(self, key: str, row: str) -> float:
        """Of a row's clips."""
        return stats.mean(self.played[row].values[key])


def run(arguments: argparse.Namespace) -> list[Table]:
    """All clauses as one table, and the tables that they are read from; InputError for what cannot be used."""
    for name, value in (("--renderings", arguments.renderings), ("--seconds", arguments.seconds)):
        if not value > 0:
            raise InputError(name, f"is {value}", "give more than 0")
    context = EvalContext.of(arguments)
    own = context.bundle
    lacking = [what for what, part in (("advantage", own.advantage), ("interpreter", own.interpreter),
                                       ("reward (in --work)", own.reward), ("reward_judge (in --work)",
                                                                            own.reward_judge)) if part is None]
    if lacking:
        raise InputError("probe racer", f"finds no {', '.join(lacking)}",
                         "use a bundle with schedules.advantage.steps, and --work with the work folder of its training")
    folder = bundle_folder(arguments.bundle)
    clauses, shown = accepted(context, folder, arguments)
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        write_text(arguments.json, json.dumps([entry(clause) for clause in clauses], indent=1) + "\n")
    facts = {**context.described(), "beta": own.config.selection.beta, "renderings": arguments.renderings,
             "seconds": arguments.seconds, "split": arguments.split}
    return [verdict_table("Acceptance of RACER", clauses, [_decides(context, arguments)], facts), *shown]


def entry(clause: Verdict) -> dict[str, Any]:
    """A clause for JSON: name, value, low, high, bound, holds, reason; null where nothing is known."""
    held = {key: value for key, value in clause.entry.items() if key != "n"}
    return {key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in held.items()}


def _decides(context: EvalContext, arguments: argparse.Namespace) -> str:
    count = len(context.numbers(arguments.split))
    told = f"{count} recordings of the {arguments.split} split, {arguments.renderings} renderings of each."
    return told if count >= RECORDINGS else f"{told} Fewer than {RECORDINGS}: a verdict decides nothing."


def accepted(context: EvalContext, folder: Path, arguments: argparse.Namespace) -> tuple[list[Verdict], list[Table]]:
    """The clauses of all groups, and what they are read from."""
    bundle, corpus = context.bundle, context.corpus
    assert bundle.reward is not None and bundle.reward_judge is not None
    shared = context_of(bundle.lexicon, corpus)
    tables = {"": reward_table(bundle.reward, bundle.lexicon, corpus, context=shared),
              "judge_": reward_table(bundle.reward_judge, bundle.lexicon, corpus, context=shared)}
    takes = [take for take in takes_of(corpus, context.labels, arguments.split)
             if len(take.blocks) > 2 * gate.HORIZON][:context.limit]
    if not takes:
        raise InputError(context.store.path, f"has no recording in its {arguments.split} split that is long enough",
                         "build a larger store")
    decisions = Decisions(corpus, takes, bundle.silent, bundle.config.silence.mask, len(bundle.vectors))
    assert bundle.interpreter is not None
    judge = PolicyJudge(decisions, tables, bundle.interpreter,
                        [context.labels[corpus.blocks_of(r)] for r in corpus.recordings("train")])
    beta = bundle.config.selection.beta
    rows, _ = policies(context, BETAS, beta)
    ours = BundleSystem("ours", folder, KeptRenderings(context.work / "racer"), bundle)
    voices = [JudgedVoice.of(ours, voice) for voice in held_out_voices(
        context.store, context.limit, bundle.config.motion.joints, arguments.split, arguments.seconds)]
    played = {PERFORMER: figures(ours, voices, None, 1),
              **{name: figures(ours, voices, row, arguments.renderings) for name, row in rows.items()}}
    measures = RacerMeasures(played, values.chosen_lexemes(context, judge, rows), BETAS, beta)
    by = gesture_features.networks(context.store, context.work, context.progress)
    clauses = [*gate.clauses(context, [tables[""], tables["judge_"]], takes),
               *gate.control_clauses(context, arguments.control_steps),
               *won(measures, rows), *alive(measures, by, [one.voice.own for one in voices], arguments.renderings),
               *timed(measures), *values.honesty_clauses(values.honesty(context, decisions, tables)),
               *knob(measures), *values.cost_clauses(context, list(read_index(folder)["files"]))]
    return clauses, [row_table("Rendered motion", _SHOWN, {n: row.values for n, row in played.items()}),
                     row_table("Lexemes on recorded speech", _CHOSEN, measures.chosen)]


def row_table(title: str, columns: Mapping[str, Column], rows: Mapping[str, Mapping[str, Any]]) -> Table:
    """Means with their intervals."""
    body: dict[str, dict[str, Cell]] = {
        name: {key: stats.mean_interval(own[key]) for key in columns} for name, own in rows.items()}
    return Table(title, dict(columns), body, "policy")


# ------------------------------------------------------------------------------------------------------ the clauses

def positive(name: str, difference: Interval, reason: str = "", digits: int = 4) -> Verdict:
    """A difference whose whole interval must lie above 0."""
    return judged(name, difference, POSITIVE, digits=digits, reason=reason)


def won(measures: RacerMeasures, rows: Mapping[str, PlayedPolicy]) -> list[Verdict]:
    """The judge on generated motion."""
    ours = measures.ours
    gain = measures.paired("judge", ours, MATCHED)
    taught = measures.paired("reward", ours, MATCHED)
    temperature = rows[MATCHED].temperature
    worse = measures.paired("judge", ours, PERFORMER)
    share = gain.mean / taught.mean if taught.mean > 0 else float("nan")
    out = [positive(f"judge on motion: {ours} less the lstm at equal entropy", gain,
                    f"the lstm at T = {temperature:g}; less the lstm as shipped "
                    f"{measures.paired('judge', ours, LSTM).text(4)}"),
           judged("judge on motion: no worse than the performer", worse, Bound(low=0.0, of=HIGH), digits=4,
                  reason="ours less the performer's own motion"),
           judged("judge's gain over the training reward's", share, at_least(GAIN_SHARE),
                  reason=f"{gain.text(4)} of {taught.text(4)}" if taught.mean > 0
                  else f"the training reward itself does not rise ({taught.text(4)})")]
    out += [positive(f"judge on motion: {ours} less {row}", measures.paired("judge", ours, row))
            for row in (RANDOM, MAJORITY)]
    if CQL in measures.played:
        out += [judged(f"judge on motion: literal CQL ({row.split(', ')[1]}) less the lstm at equal entropy",
                       measures.paired("judge", row, MATCHED), digits=4) for row in (CQL, CQL_MATCHED)]
    return out


def alive(measures: RacerMeasures, by: Sequence[gesture_features.Features], real: Sequence[Any], seeds: int
          ) -> list[Verdict]:
    """Variety, runs, speeds, support, distance, and the figures for the eye."""
    ours, lstm, own = (measures.played[row] for row in (measures.ours, MATCHED, PERFORMER))
    size = int(max(int(row.max()) for row in (*ours.lexemes, *lstm.lexemes, *own.lexemes))) + 1

    def variety(row: PlayedFigures) -> float:
        return float(np.mean([diversity(lexemes, size).nats for lexemes in row.lexemes]))

    runs = {name: float(np.mean([longest_run([lexemes]) for lexemes in row.lexemes]))
            for name, row in (("ours", ours), ("own", own), ("lstm", lstm))}
    pairs = {name: float(np.mean([distinct_2([lexemes]) for lexemes in row.lexemes]))
             for name, row in (("ours", ours), ("own", own), ("lstm", lstm))}
    speed, still = (measures.mean(key, measures.ours) / max(measures.mean(key, PERFORMER), 1e-9)
                    for key in ("speech_speed", "silence_speed"))
    theirs = [measures.mean(key, MATCHED) / max(measures.mean(key, PERFORMER), 1e-9)
              for key in ("speech_speed", "silence_speed")]
    chosen = measures.chosen
    rare = stats.paired(chosen[measures.ours]["rare"], chosen[PERFORMER]["rare"])
    out = [
        judged("alive: diversity over the performer's", variety(ours) / variety(own), at_least(DIVERSITY),
               reason=f"the lstm's {variety(lstm) / variety(own):.2f}"),
        judged("alive: longest run over the performer's", runs["ours"] / runs["own"], at_most(RUNS),
               reason=f"the lstm's {runs['lstm'] / runs['own']:.2f}"),
        judged("alive: distinct pairs over the performer's", pairs["ours"] / pairs["own"], at_least(PAIRS),
               reason=f"the lstm's {pairs['lstm'] / pairs['own']:.2f}"),
        judged("alive: hands in speech over the performer's", speed, Bound(1 - SPEED, 1 + SPEED),
               reason=f"the lstm's {theirs[0]:.2f}"),
        judged("alive: hands in silence over the performer's", still, at_most(1.0),
               reason=f"the lstm's {theirs[1]:.2f}; rest is a rule, not a policy's choice"),
        judged("alive: out of distribution, % less the performer's", rare, at_most(0.0), digits=1,
               reason=f"of {float(np.nanmean(chosen[PERFORMER]['rare'])):.1f} %")]
    if by:
        one, other = (gesture_features.pooled(row.motions[::seeds], by[0]) for row in (ours, lstm))
        apart = fgd.difference(one, other, gesture_features.pooled(list(real), by[0]))
        out.append(judged("alive: FGD less the lstm's", apart, Bound(high=FGD, of=HIGH), reason=by[0].name))
    out.append(_seen_alike(ours, lstm))
    return out


def _seen_alike(ours: PlayedFigures, lstm: PlayedFigures) -> Verdict:
    """How many figures for the eye differ from the lstm's beyond what chance alone would make of as many."""
    differs = []
    for name, values_ in ours.eyes.items():
        if np.isfinite(values_ - lstm.eyes[name]).sum() > 1:
            between = stats.paired(values_, lstm.eyes[name])
            differs.append((name.removeprefix("eye_"), between.low > 0 or between.high < 0))
    moved = [name for name, other in differs if other]
    most = max(1.0, math.ceil(2 * MOVED * len(differs)))
    return judged("alive: figures for the eye that differ from the lstm's", float(len(moved)), at_most(most),
                  digits=0, reason=f"of {len(differs)}, {MOVED:.0%} by chance: {', '.join(moved) or 'none'}")


def timed(measures: RacerMeasures) -> list[Verdict]:
    """PMB, and the mismatch test."""
    ours = measures.ours
    speeds = measures.mean("speech_speed", ours), measures.mean("speech_speed", MATCHED)
    beat = measures.paired("pmb", ours, MATCHED)
    own = measures.played[ours].values
    right = stats.paired(own["judge"], own["judge_shifted"])
    others = {row: stats.paired(measures.played[row].values["judge"], measures.played[row].values["judge_shifted"])
              for row in (PERFORMER, MATCHED)}
    return [judged("timing: PMB above chance less the lstm's, points", beat, at_least(PMB), digits=1,
                   reason=f"hands {speeds[0]:.3f} and {speeds[1]:.3f} m/s; beats cut the blocks, so this is no "
                   "win to claim"),
            positive("mismatch: own sound less that of eight blocks later, by the judge", right,
                     "; ".join(f"{row} {other.text(4)}" for row, other in others.items()))]


def knob(measures: RacerMeasures) -> list[Verdict]:
    """Training reward and judge must rise together with beta, and the floors hold."""
    names = [MATCHED if beta == 0 else advantage_row(beta) for beta in measures.betas]
    names[0] = LSTM
    out = []
    for key, title in (("reward", "training reward"), ("judge", "judge")):
        steps = [measures.mean(key, name) for name in names]
        rises = [after - before for before, after in zip(steps, steps[1:], strict=False)]
        told = ", ".join(f"{step:.4f}" for step in steps)
        whole = measures.paired(key, names[-1], names[0])
        out.append(judged(f"knob: least step of the {title} over beta {measures.betas[0]:g} to {measures.betas[-1]:g}",
                          min(rises), Bound(low=0.0, strict=True), digits=4,
                          reason=f"at beta {', '.join(f'{beta:g}' for beta in measures.betas)}: {told}; from the first "
                                 f"to the last {whole.text(4)}"))
    own = measures.chosen[PERFORMER]["lexeme_diversity"]
    least = min(float(np.nanmean(measures.chosen[name]["lexeme_diversity"]) / np.nanmean(own)) for name in names)
    out.append(judged("knob: least diversity over the performer's on the way", least, at_least(DIVERSITY)))
    return out
