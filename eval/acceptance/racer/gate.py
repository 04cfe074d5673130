"""The gate before any reinforcement learning: do two rewards that share nothing agree on what a lexeme is worth?

Two ensembles of other recordings, seeds and sizes score every lexeme in the performer's context: their correlation over
lexemes, state by state, is how much of a reward is more than its own noise. Asked of single blocks, and of the sum over
the eight blocks that follow, where one lexeme is put in the place of the performer's and the rest is left.

Where they do not agree, either the models are poor or there is nothing to be heard. The control tells which: a model
of the same sizes is taught with the sound of each recording rolled by `ROLLED` blocks, which leaves motion, lexemes,
voices and statistics as they were, and takes away only what the sound of the moment tells. What the right sound buys
over the rolled one, on recordings that neither heard, is all that audio can teach here. What fools it: retrieval among
windows of other recordings, which the voice alone decides.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.layers import freeze
from data_module.types import Array
from eval import stats
from eval.acceptance.bounds import Verdict, at_least, judged, skipped
from eval.baselines.controls import ROLLED
from eval.context import EvalContext
from eval.metrics.ranking import agreement
from gesticulator.bundle.config import FitSettings
from gesticulator.training import fit as fitting
from gesticulator.training.stages.advantage import gains
from gesticulator.training.stages.reward import RewardWindows, added_by, block_audio
from interpreters.episodes import Demonstration
from interpreters.reward import RewardEnsemble
from interpreters.reward_table import EnsembleReward
from lexicon.movement import MovementLexicon

SINGLE, RETURNS = 0.6, 0.4
"""Least agreement on single lexemes, and on returns of `HORIZON` blocks."""
HORIZON = 8
STATES, LEXEMES = 12, 24
"""Decisions of each recording whose returns are compared, and lexemes tried in each."""
_CHECKS, _WINDOWS = 8, 64


@dataclass(frozen=True)
class RewardAgreement:
    """Correlations over lexemes, by recording: of single blocks, and of returns."""

    single: stats.Interval
    returns: stats.Interval


def agreed(first: EnsembleReward, second: EnsembleReward, takes: Sequence[Demonstration]) -> RewardAgreement:
    """Of two rewards over the performer's decisions in speech."""
    rows: dict[str, list[Array]] = {"single": [], "returns": []}
    for take in takes:
        rng = np.random.default_rng(take.recording)
        actions, blocks = torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks)
        every = [table.sequence_every(actions, blocks).double().numpy() for table in (first, second)]
        said = np.flatnonzero(~take.silent)
        said = said[said > 0]
        rows["single"].append(agreement(*(one[said] for one in every)))
        at = rng.permutation(said[said + HORIZON <= len(actions)])[:STATES]
        tried = np.stack([rng.permutation(first.size)[:LEXEMES] for _ in at]) if len(at) else np.zeros((0, 0), int)
        if len(at):
            rows["returns"].append(agreement(*(
                one[at[:, None], tried] + gains(table, actions, blocks, at, tried, 1.0)
                for one, table in zip(every, (first, second), strict=True))))
    found = {key: stats.mean_interval(np.concatenate(own), groups=np.repeat(np.arange(len(own)), [len(o) for o in own]))
             for key, own in rows.items() if own}
    return RewardAgreement(found["single"], found.get("returns", stats.Interval.undefined()))


def clauses(context: EvalContext, tables: Sequence[EnsembleReward], takes: Sequence[Demonstration]) -> list[Verdict]:
    """Both correlations against their bounds, and what one model of each says alone."""
    teacher, judge = tables
    whole = agreed(teacher, judge, takes)
    alone = agreed(teacher.of([0], 0.0), judge.of([0], 0.0), takes)
    size = len(teacher.tables)
    reason = f"{size} and {len(judge.tables)} models; one of each: "
    return [judged("two ensembles agree on single lexemes, r", whole.single, at_least(SINGLE),
                   reason=f"{reason}{alone.single.text()}"),
            judged(f"two ensembles agree on returns of {HORIZON} blocks, r", whole.returns, at_least(RETURNS),
                   reason=f"{reason}{alone.returns.text()}")]


# ------------------------------------------------------------------------------------- what is there to be heard

def rolled_blocks(context: EvalContext, by: int) -> NDArray[np.int64]:
    """[N] for every block the one `by` blocks before it in its recording, from the end again at the beginning."""
    corpus = context.corpus
    out = np.arange(len(corpus.silent))
    for recording in range(len(corpus.names)):
        own = corpus.blocks_of(recording)
        out[own] = np.roll(own, by % max(1, len(own)))
    return out


def taught(context: EvalContext, steps: int, by: int) -> dict[str, Array]:
    """A model of the teacher's sizes, taught with the sound rolled by so many blocks, on the test split so rolled.

    told: nats by which the sound tells the last lexeme better than the lexeme before does; worse: share of lexemes that
    suit the sound less than the performer's (chance 0.5); motion_r1, chance_r1: retrieval; each [checks].
    """
    corpus, bundle = context.corpus, context.bundle
    lexicon = bundle.block_models.lexicon
    if not isinstance(lexicon, MovementLexicon):
        raise TypeError("the control needs a lexicon of movements")
    config = replace(bundle.config.reward, members=1, choice=1.0, rivals=0)
    audio = block_audio(corpus)[torch.as_tensor(rolled_blocks(context, by))]
    labels, known = context.labels, corpus.recordings("train")
    with torch.random.fork_rng():
        torch.manual_seed(1)
        model = RewardEnsemble(config, corpus.motion.shape[1], corpus.motion.shape[2], audio.shape[2])

    def windows(recordings: Sequence[int]) -> RewardWindows:
        return RewardWindows(corpus, audio, corpus.motion, recordings, config, labels, None, bundle.transitions,
                             added_by(lexicon))

    learn, check = windows(known), windows(context.numbers("test"))
    settings = FitSettings(steps=steps, batch=64, rate=1e-3, schedule="cosine", weight_decay=0.05)
    with tempfile.TemporaryDirectory() as scratch:
        fitting.fit(f"reward, sound rolled by {by}", model, fitting.Task(
            lambda rng: learn.sample(rng, settings.batch), before_step=model.before_step), settings, Path(scratch),
            fitting.FitOptions(seed=1, checkpoint_seconds=float("inf"), progress=context.progress))
    freeze(model)
    found = [model.figures(check.sample(fitting.generator_for(5, i), _WINDOWS, 1.0)) for i in range(_CHECKS)]
    return {key: np.array([row[key] for row in found]) for key in ("told", "worse", "motion_r1", "chance_r1")}


def control_clauses(context: EvalContext, steps: int) -> list[Verdict]:
    """What the right sound tells, what rolled sound tells, and the difference; shown, not judged."""
    if steps == 0:
        why = "no retraining was asked for (--control-steps)"
        return [skipped("what sound tells of a lexeme, nats, over retrained with rolled sound", why)]
    if not isinstance(context.bundle.lexicon, MovementLexicon):
        return [skipped("what sound tells of a lexeme, nats, over retrained with rolled sound",
                        "the lexicon is not one of movements")]
    right, wrong = taught(context, steps, 0), taught(context, steps, ROLLED)
    about = f"{steps} steps each; windows of the test split"
    return [
        judged("what sound tells of a lexeme, nats", stats.mean_interval(right["told"]), digits=3, reason=about),
        judged("the same, retrained with rolled sound", stats.mean_interval(wrong["told"]), digits=3),
        judged("what sound tells of a lexeme, nats, over retrained with rolled sound",
               stats.paired(right["told"], wrong["told"]), digits=3,
               reason="all that the sound of the moment can teach a reward here"),
        judged("lexemes that suit the sound less than the performer's, %",
               stats.mean_interval(100 * right["worse"]), digits=1, reason="chance 50"),
        judged("the same, retrained with rolled sound, %", stats.mean_interval(100 * wrong["worse"]), digits=1),
        judged("windows of 8 recordings' that find their sound, %", stats.mean_interval(
            100 * right["motion_r1"]), digits=1, reason=f"rolled {100 * float(wrong['motion_r1'].mean()):.1f}, chance "
            f"{100 * float(right['chance_r1'].mean()):.1f}")]
