"""Lexeme interpreters judged as policies over one lexicon, one generator and the same test speech (RG Table 6, more).

The lexemes that are judged are the ones that the generator then plays, gate open. Rows: `performer` is the true lexemes
with the silent hint, `lstm` and `statistical` draw as the bundle draws, `cql` chooses as the bundle has it (arg max,
RACER), `majority` never changes, `greedy` takes the lexeme of the highest training reward at each block by trying them
all, and `random` draws any lexeme alike. What is measured, and what fools it: `eval.runner.policy`.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from tqdm import tqdm

from data_module.errors import InputError
from data_module.types import Array, Motion
from eval import stats
from eval.baselines.controls import Majority, Random
from eval.clip.measure import measure, motion_values
from eval.metrics import fgd, gesture_features
from eval.rows.row import COLUMNS, DECISIONS, EPISODE, PLAYED, VALUES, RowColumn
from eval.runner.context import EvalContext
from eval.runner.policy import RARE, SEED, Choices, Decisions, Policy, PolicyJudge, Rewards, greedy, perform, walk
from eval.table import Cell, Column, Marked, Table
from gesticulator.bundle import bundle as bundles
from gesticulator.pipeline import Gesticulator
from gesticulator.training.stages.reward import reward_table, taught_reward
from interpreters.base import LexemeInterpreter

PAIRS = (("cql", "lstm"), ("cql", "statistical"))
PARTS: dict[str, Mapping[str, RowColumn]] = {
    **{part: columns for part, columns in DECISIONS.items() if part not in (VALUES, PLAYED)},
    "motion": {key: COLUMNS[key] for key in ("pmb_above_chance", "speech_speed", "silence_speed", "maje", "mad")}}
Values = dict[str, Array]
"""[recordings] of one row, by column."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store and a bundle."""
    EvalContext.arguments(parser)


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """The tables, motion measured by our own networks of gesture features and the papers' where it is."""
    context = EvalContext.of(arguments)
    return policies(context, gesture_features.networks(context.store, context.work, context.progress))


def rows_of(bundle: bundles.Bundle, lstm: LexemeInterpreter, cql: LexemeInterpreter) -> dict[str, Policy]:
    """The policies that choose by scores, as the bundle would have them choose."""
    selection = bundle.config.selection
    top = selection.top or None
    return {"lstm": Policy(lstm, selection.temperature, top), "lstm arg max": Policy(lstm),
            "statistical": Policy(bundle.statistical(), selection.temperature, top),
            "cql": Policy(cql, selection.q_temperature, top), "majority": Policy(Majority(bundle)),
            "random": Policy(Random(len(bundle.vectors)), 1.0)}


def choices(rows: Mapping[str, Policy], decisions: Decisions, rewards: Rewards, progress: bool) -> dict[str, Choices]:
    """What every row of the table did."""
    truth = [take.lexemes for take in decisions.takes]
    out = {"performer": Choices(truth, truth)}
    for name, policy in tqdm(rows.items(), desc="lexemes", disable=not progress):
        out[name] = Choices(*([walk(policy, decisions, take, teacher)[0] for take in decisions.takes]
                              for teacher in (False, True)))
    out["greedy"] = Choices(*([greedy(rewards, decisions, take, teacher) for take in decisions.takes]
                              for teacher in (False, True)))
    return out


def policies(context: EvalContext, by: Sequence[gesture_features.Features]) -> list[Table]:
    """Every table. by: what the Frechet distance is measured in.

    InputError for a bundle without a Q-network and both reward models, or without the lstm to compare with, and for a
    store without a test recording.
    """
    bundle, corpus = context.bundle, context.corpus
    lstm, cql, reward, judge = bundle.interpreter, bundle.q_network, bundle.reward, bundle.reward_judge
    if lstm is None or cql is None or reward is None or judge is None:
        raise InputError("the bundle", "lacks the lstm, the Q-network or, in --work, one of the two reward models",
                         "use one over a lexicon, with schedules.reward.steps and schedules.cql.steps, and the work "
                         "folder of its training")
    decisions = Decisions.of(bundle, corpus, context.labels, context.limit)
    if not decisions.takes:
        raise InputError(context.store.path, "has no test recording with a decision in it", "build the store again")
    table = reward_table(reward, bundle.lexicon, corpus)
    policy_judge = PolicyJudge(decisions, {"": table, "judge_": reward_table(judge, bundle.lexicon, corpus)}, lstm,
                               [context.labels[corpus.blocks_of(r)] for r in corpus.recordings("train")])
    rows = rows_of(bundle, lstm, cql)
    chosen = choices(rows, decisions, table, context.progress)
    recordings = [context.store.load(corpus.names[take.recording]) for take in decisions.takes]
    motions, values = dict[str, list[Motion]](), dict[str, Values]()
    for name, own in chosen.items():
        motions[name] = perform(Gesticulator(bundle), recordings, own.free, name, context.progress)
        values[name] = columns([
            policy_judge.lexeme_values(take, own.free[k], own.forced[k])
            | motion_values(measure(motion, recording.speech), motion, recording.motion, seed=k)
            for k, (take, motion, recording) in enumerate(zip(decisions.takes, motions[name], recordings,
                                                              strict=True))])
    gamma = cql.config.gamma
    taught = taught_reward(table, corpus, bundle.config.episodes.baseline)
    q = columns([policy_judge.score_values(rows["cql"], take, taught, gamma) for take in decisions.takes])
    sizes = [len(take.blocks) - 1 for take in decisions.takes]
    facts = {**context.described(), "decisions": sum(sizes),
             "settings": {"episode": EPISODE, "rare": RARE, "gamma": gamma, "seed": SEED,
                          "temperatures": {name: policy.temperature for name, policy in rows.items()}}}
    return [*compared(values, sizes, facts), fgd_table(motions, [recording.motion for recording in recordings], by),
            q_table(q)]


def columns(rows: Sequence[dict[str, float]]) -> Values:
    """Each key's values, one a recording."""
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def compared(rows: Mapping[str, Values], sizes: Sequence[int], facts: Mapping[str, Any] | None = None) -> list[Table]:
    """Intervals of all rows and of the paired differences; sizes: decisions of each recording."""
    found = []
    for part, shown in PARTS.items():
        weights = {key: sizes if column.by_blocks else None for key, column in shown.items()}
        body: dict[str, dict[str, Cell]] = {
            name: {key: stats.mean_interval(row[key], weights[key]) for key in shown} for name, row in rows.items()}
        body |= {f"{a} - {b}": {key: stats.paired(rows[a][key], rows[b][key], weights[key]) for key in shown}
                 for a, b in PAIRS}
        found.append(Table(f"Policies: {part}", {key: column.shown() for key, column in shown.items()}, body, "policy"))
    note = "Means with bootstrap 95 % intervals over recordings; differences are paired."
    return [replace(found[0], notes=[note], facts=facts or {}), *found[1:]]


def q_table(values: Values) -> Table:
    """What the Q values tell."""
    return Table("Policies: Q values of cql", {"mean": Column("mean", digits=3)}, {
        DECISIONS[VALUES][key].title: {"mean": stats.mean_interval(own)} for key, own in values.items()})


def fgd_table(motions: Mapping[str, list[Motion]], real: list[Motion], by: Sequence[gesture_features.Features]
              ) -> Table:
    """FGD of all rows and the paired differences, by each network."""
    body: dict[str, dict[str, Cell]] = {name: {} for name in (*motions, *(f"{a} - {b}" for a, b in PAIRS))}
    shown = {f"{one.name}, {one.frames} at {one.fps:g} fps": one for one in by}
    figures: dict[str, Any] = {key: {} for key in shown}
    for key, one in shown.items():
        theirs = gesture_features.pooled(real, one)
        ours = {name: gesture_features.pooled(own, one) for name, own in motions.items()}
        for name, own in ours.items():
            figure = fgd.measure(own, theirs, one, paired=True)
            figures[key][name] = figure.to_dict()
            cell = stats.Interval(figure.distance, figure.interval.low, figure.interval.high, len(real))
            body[name][key] = Marked(cell, "*", figure.reason) if figure.reason else cell
        for a, b in PAIRS:
            body[f"{a} - {b}"][key] = fgd.difference(ours[a], ours[b], theirs)
    return Table("Policies: FGD", {key: Column(key) for key in shown}, body, "policy",
                 ["\\*: fewer windows than the network's features call for (see `eval.metrics.fgd`)."],
                 {"figures": figures})
