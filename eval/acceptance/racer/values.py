"""Are the values honest, and what do policies choose on recorded speech? Lexemes alone, nothing is drawn.

The value of a state is held against the discounted sum of the rewards that followed it, on the performer's own
lexemes. What fools a rank correlation with the return is the sound: some speech earns more whatever is done, and a
value that knew nothing else would rank well. So beside it stands the partial correlation, over the lexemes of each
state, of Q with the judge's reward given log pi_b: a value that only repeats what people do has none.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from data_module.types import Array
from eval import stats
from eval.ablate.policy import Decisions, Policy, PolicyJudge, rank_correlation, return_to_go, taken, walk
from eval.acceptance.bounds import ANY, Bound, Verdict, at_least, at_most, judged
from eval.acceptance.racer.playing import PERFORMER, PlayedPolicy, teacher_inputs
from eval.context import EvalContext
from gesticulator.training.stages.interpreter import teacher_logits
from gesticulator.training.stages.reward import taught_reward
from interpreters.advantage import AdvantageInterpreter
from interpreters.base import BlockFeatures, LexemeInterpreter
from interpreters.reward_table import EnsembleReward

BIAS, SPEARMAN, PARTIAL, MILLISECONDS = 0.2, 0.3, 0.2, 3.0
_TIMED = 60
"""Blocks over which the cost of one is measured, after as many to warm up."""

Columns = dict[str, Array]
"""[recordings] by column."""


def partial_correlations(x: Array, y: Array, given: Array) -> Array:
    """[n] over the columns of [n, S] each: r of x and y with what `given` tells of both taken off; NaN where undefined.

    (r_xy - r_xg r_yg) / sqrt((1 - r_xg^2) (1 - r_yg^2))
    """
    def r(first: Array, second: Array) -> Array:
        one, other = (rows - rows.mean(1, keepdims=True) for rows in (first, second))
        norm = np.sqrt((one ** 2).sum(1) * (other ** 2).sum(1))
        return np.divide((one * other).sum(1), norm, out=np.full(len(one), np.nan), where=norm > 0)

    xy, xg, yg = r(x, y), r(x, given), r(y, given)
    rest = np.sqrt((1 - xg ** 2).clip(0) * (1 - yg ** 2).clip(0))
    return np.divide(xy - xg * yg, rest, out=np.full(len(xy), np.nan), where=rest > 1e-6)


@torch.no_grad()
def honesty(context: EvalContext, decisions: Decisions, tables: Mapping[str, EnsembleReward]) -> dict[str, Columns]:
    """By system ("advantage", and "cql" where there is one): bias in standard deviations of the returns, Spearman's rho
    with the return-to-go, and the partial correlation with the judge's reward; [recordings] each."""
    bundle, config = context.bundle, context.bundle.config
    prior, critics, network = bundle.interpreter, bundle.advantage, bundle.q_network
    assert prior is not None and critics is not None
    taught = taught_reward(tables[""], context.corpus, config.episodes.baseline)
    rows: dict[str, list[dict[str, float]]] = {"advantage": [], **({} if network is None else {"cql": []})}
    for take in decisions.takes:
        actions, blocks = torch.as_tensor(take.lexemes), torch.as_tensor(take.blocks)
        earned = taken(taught.sequence_every(actions, blocks)[1:].double().numpy(), take.lexemes[1:])
        rewards = tables["judge_"].sequence_every(actions, blocks)[1:].double().numpy()
        odds = teacher_logits(prior, context.corpus, take.blocks, take.lexemes).log_softmax(-1)
        heard = teacher_inputs(context, take.recording)
        found = critics.values(*heard)
        worth = critics.advantage(found, odds[None])[0]
        value = (found.value[0].mean(-1) + worth.gather(1, actions[1:, None])[:, 0]) * critics.unit
        told = {"advantage": (value.double().numpy(), worth.double().numpy(), config.advantage.gamma)}
        if network is not None:
            q = network.values(*heard)[0].double().numpy()
            told["cql"] = (taken(q, take.lexemes[1:]), q, config.cql.gamma)
        for name, (values, q, gamma) in told.items():
            # The last blocks of a recording have little left to earn: what is told of them is not asked.
            returns = return_to_go(earned, gamma)
            kept = slice(0, max(2, len(returns) - round(3 / (1 - gamma))))
            spread = float(returns[kept].std()) or float("nan")
            rows[name].append({
                "bias": float((values[kept] - returns[kept]).mean()) / spread,
                "spearman": rank_correlation(values[kept], returns[kept]),
                "partial": float(np.nanmean(partial_correlations(q, rewards, odds.double().numpy())))})
    return {name: {key: np.array([row[key] for row in own]) for key in own[0]} for name, own in rows.items()}


def honesty_clauses(found: Mapping[str, Columns]) -> list[Verdict]:
    """The advantage policy's against their bounds; those of literal CQL beside them, shown."""
    out = []
    for name, columns in found.items():
        binding = name == "advantage"
        bias = stats.mean_interval(columns["bias"])

        def bound(own: Bound, binding: bool = binding) -> Bound:
            return own if binding else ANY

        out += [judged(f"Q honest, {name}: bias, standard deviations of the return", bias,
                       bound(Bound(-BIAS, BIAS))),
                judged(f"Q honest, {name}: Spearman's rho with the return-to-go",
                       stats.mean_interval(columns["spearman"]), bound(at_least(SPEARMAN))),
                judged(f"Q honest, {name}: partial r with the judge's reward given log pi",
                       stats.mean_interval(columns["partial"]), bound(at_least(PARTIAL)))]
    return out


def interpreters_of(context: EvalContext, rows: Mapping[str, PlayedPolicy]) -> dict[str, Policy]:
    """The same policies as what `eval.ablate.policy.walk` takes."""
    bundle, selection = context.bundle, context.bundle.config.selection
    out = {}
    for name, row in rows.items():
        own: LexemeInterpreter = (bundle.interpreter_named(row.interpreter) if isinstance(row.interpreter, str)
                                  else row.interpreter)
        temperature = selection.temperature if row.temperature is None else row.temperature
        if isinstance(own, AdvantageInterpreter):
            own = own.steered(row.beta, temperature)
        out[name] = Policy(own, temperature, selection.top or None)
    return out


def chosen_lexemes(context: EvalContext, judge: PolicyJudge, rows: Mapping[str, PlayedPolicy]) -> dict[str, Columns]:
    """What every row, and the performer, chooses on recorded speech: `PolicyJudge.lexeme_values` by recording."""
    out = {}
    for name, policy in {PERFORMER: None, **interpreters_of(context, rows)}.items():
        values = []
        for take in judge.decisions.takes:
            free = take.lexemes if policy is None else walk(policy, judge.decisions, take)[0]
            values.append(judge.lexeme_values(take, free, free))
        out[name] = {key: np.array([row[key] for row in values]) for key in values[0]}
    return out


def milliseconds(context: EvalContext) -> float:
    """What a block costs the advantage interpreter once its window is full, on one thread: the median, of the
    processor's time, so that what else runs counts little."""
    system = context.bundle.interpreter_named("advantage")
    corpus = context.corpus
    decisions = Decisions.of(context.bundle, corpus, context.labels, 1)
    take, spent = decisions.takes[0], []
    state, previous = system.start(take.speaker, int(take.lexemes[0])), int(take.lexemes[0])
    for step in range(2 * _TIMED):
        features: BlockFeatures = decisions.features(int(take.blocks[1 + step % (len(take.blocks) - 1)]))
        begin = time.process_time()
        scores, state = system.step(state, features, previous)
        spent.append(time.process_time() - begin)
        previous = int(scores.argmax())
    return 1e3 * float(np.median(spent[_TIMED:]))


def cost_clauses(context: EvalContext, parts: Sequence[str]) -> list[Verdict]:
    """Milliseconds a block, and that the bundle holds no judge. parts: files of the bundle as it was read."""
    return [judged("cost of a block on one thread, ms", milliseconds(context), at_most(MILLISECONDS),
                   reason="behaviour policy and critics; time of the processor"),
            judged("reward models in the bundle", float(sum("reward" in part for part in parts)), at_most(0.0),
                   digits=0)]
