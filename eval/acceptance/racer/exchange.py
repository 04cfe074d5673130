"""The models exchanged: critics that the judge taught, judged by the reward that teaches. The sign must be the same.

They are no part of a bundle. They are trained when it is asked for, kept in the work folder, and used from then on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np

from eval import stats
from eval.acceptance.racer.playing import MATCHED, PlayedPolicy
from eval.claim import Bound, Verdict, judged, skipped
from eval.runner.context import EvalContext
from eval.runner.policy import Decisions, Policy, every_reward, taken, walk
from gesticulator.bundle.config import Config
from gesticulator.training.stages import ADVANTAGE, Run
from gesticulator.training.stages.advantage import exchanged_stage
from interpreters.advantage import AdvantageInterpreter
from interpreters.reward_table import EnsembleReward

NAME = "models exchanged: training reward of lexemes by critics that the judge taught, less the lstm's"


def clauses(context: EvalContext, tables: Mapping[str, EnsembleReward], decisions: Decisions,
            rows: Mapping[str, PlayedPolicy], train: bool) -> list[Verdict]:
    """One clause; not judged where there are no such critics."""
    config: Config = context.bundle.config
    run = Run(config, context.store, context.work, progress=context.progress)
    stage = exchanged_stage()
    if not train and not run.finished(stage):
        return [skipped(NAME, "no critics were taught by the judge (--exchange)")]
    if not run.finished(ADVANTAGE):
        return [skipped(NAME, "--work is not the work folder of the bundle's training")]
    critics = run.get(stage)
    bundle = context.bundle.with_parts(advantage=critics)
    ours = cast(AdvantageInterpreter, bundle.interpreter_named("advantage"))
    temperature = config.selection.temperature
    lstm = replace(rows[MATCHED])
    assert isinstance(lstm.interpreter, str)
    pair = {"ours": Policy(ours.steered(config.selection.beta, temperature), temperature),
            "lstm": Policy(bundle.interpreter_named(lstm.interpreter), lstm.temperature or 0.0)}
    earned: dict[str, list[float]] = {name: [] for name in pair}
    for take in decisions.takes:
        for name, policy in pair.items():
            free = walk(policy, decisions, take)[0]
            earned[name].append(float(taken(every_reward(tables[""], take, free), free[1:]).mean()))
    between = stats.paired(np.array(earned["ours"]), np.array(earned["lstm"]))
    return [judged(NAME, between, Bound(low=0.0, strict=True), digits=4, reason="by lexeme, free-running")]
