"""The Q-network, trained by conservative Q-learning on the offline episodes (RACER 4.3, Eq. 11)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from data_module.errors import InputError
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.systems import system_of
from gesticulator.training import fit as fitting
from gesticulator.training.presets import LITERAL
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.corpus import Corpus, sizes
from gesticulator.training.stages.interpreter import INTERPRETER
from gesticulator.training.stages.lexicon import LABELS, TOKENS, Labelled, model_sizes
from gesticulator.training.stages.reward import REWARD, reward_table, step_reward
from gesticulator.training.stages.speech import CORPUS
from interpreters.base import BlockFeatures
from interpreters.cql import ConservativeQ, QNetwork, data_nll
from interpreters.episodes import BehaviourPolicies, Demonstration, Episodes, Reward, SilentLexemes, build
from interpreters.statistical import StatisticalInterpreter

_CHECKS, _WINDOWS = 4, 64
"""Validation batches, and windows in each."""


def takes_of(corpus: Corpus, labels: NDArray[np.int64], split: str) -> list[Demonstration]:
    """The performers' own decisions in the recordings of a split."""
    return [Demonstration(recording, int(corpus.speaker_of[recording]), blocks, labels[blocks], corpus.silent[blocks])
            for recording in corpus.recordings(split) for blocks in [corpus.blocks_of(recording)]]


def features_of(corpus: Corpus) -> Callable[[int], BlockFeatures]:
    """A function from block number to an interpreter's inputs; past motion is always the performer's, since nothing is
    generated here."""
    def features(block: int) -> BlockFeatures:
        # The interpreter may read the pose before the block, which in the data is the performer's.
        past, seconds = corpus.before(np.array([block]))
        return BlockFeatures(corpus.low[block].float(), corpus.high[block].float(), bool(corpus.silent[block]),
                             past=past[0], durations=(float(seconds[0, 0]), float(seconds[0, 1])))

    return features


def silent_of(labelled: Labelled) -> SilentLexemes:
    """The silent lexemes for `interpreters.episodes.build`."""
    return SilentLexemes(labelled.silent, labelled.nearest)


def _make_episodes(run: Run) -> Episodes:
    def make() -> Episodes:
        corpus, config, labelled = run.get(CORPUS), run.config, run.get(LABELS)
        frequencies = np.stack([labelled.inventory.frequencies[name] for name in corpus.statistics.speakers])
        others: dict[str, Any] = {"statistical": StatisticalInterpreter(frequencies, labelled.inventory.transitions,
                                                                        config.statistical)}
        if INTERPRETER.name in system_of(config).STAGES:
            others["sampled"] = run.get(INTERPRETER)
        return build(takes_of(corpus, labelled.hinted, "train"), config.episodes, step_reward(run),
                     silent=silent_of(labelled), vectors=run.get(TOKENS).vectors.numpy(),
                     policies=BehaviourPolicies(others, features_of(corpus)), seed=run.seed(EPISODES))

    return _cached(run, EPISODES, make)


def _cached(run: Run, node: Node[Episodes], make: Callable[[], Episodes]) -> Episodes:
    file = run.work / f"{node.name}-{run.key(node)}.npz"
    if file.exists():
        try:
            return Episodes.load(file)
        except InputError:
            pass  # truncated by a crash, or changed: compute again
    episodes = make()
    episodes.save(file)
    return episodes


def _episode_needs(config: Config) -> Sequence[Node[Any]]:
    return CORPUS, TOKENS, LABELS, REWARD, *((INTERPRETER,) if INTERPRETER.name in system_of(config).STAGES else ())


EPISODES: Node[Episodes] = Node("episodes", settings=("episodes", "statistical", "silence.hint"), needs=_episode_needs,
                                make=_make_episodes)
"""The offline data set of the training split, cached under the hash of its inputs (RACER 4.3)."""


def literal_reward(run: Run) -> Reward:
    """The reward of a step as published: the cosine of motion and audio (RACER Eq. 8), relative to nothing."""
    return reward_table(run.get(REWARD), run.get(TOKENS), run.get(CORPUS), literal=True).sequence


def _make_literal(run: Run) -> Episodes:
    def make() -> Episodes:
        corpus, labelled = run.get(CORPUS), run.get(LABELS)
        return build(takes_of(corpus, labelled.hinted, "train"), LITERAL, literal_reward(run),
                     silent=silent_of(labelled), vectors=run.get(TOKENS).vectors.numpy(),
                     seed=run.seed(LITERAL_EPISODES))

    return _cached(run, LITERAL_EPISODES, make)


LITERAL_EPISODES: Node[Episodes] = Node(
    "episodes_literal", settings=("silence.hint",), needs=lambda config: (CORPUS, TOKENS, LABELS, REWARD),
    make=_make_literal)
"""RACER's own data set: the lexemes of the performers and nothing else."""


def q_batch(corpus: Corpus, windows: dict[str, Tensor], lookahead: int = 1) -> dict[str, Tensor]:
    """Windows of episodes with the Q-network's inputs: audio [B, T + 1, 3K, d] and speaker one-hot [B, P].

    Without look-ahead the audio is that around the block before. Decisions begin with a recording's second block.
    """
    return {**windows, "audio": corpus.high[windows["block"] - (1 - lookahead)].float(),
            "speaker": functional.one_hot(windows["speaker"], len(corpus.statistics.speakers)).float()}


def new_q_network(config: Config, corpus: Corpus, vectors: Tensor, silent: NDArray[np.int64]) -> QNetwork:
    """An untrained Q-network over a codebook [S, D_s]."""
    return cast("QNetwork", models.build("q_network", sizes(config, corpus, vectors=vectors,
                                                            silent=tuple(silent.tolist()))))


def _train(run: Run, learner: ConservativeQ, folder: Path, stage: Stage[QNetwork], episodes: Episodes,
           reward: Reward) -> Figures:
    """Fit a Q-network to episodes; `reward` is that of a step of the validation recordings."""
    corpus, labelled, config = run.get(CORPUS), run.get(LABELS), learner.config
    held = build(takes_of(corpus, labelled.hinted, "val" if corpus.recordings("val") else "train"), LITERAL,
                 reward, silent=silent_of(labelled), vectors=run.get(TOKENS).vectors.numpy())
    # Windows of the plain recordings; precomputed window rewards belong to the training episodes.
    plain = Episodes(held.episodes)
    checks = [q_batch(corpus, plain.windows(fitting.generator_for(3, i), _WINDOWS, config.decisions), config.lookahead)
              for i in range(_CHECKS)]

    @torch.no_grad()
    def validate() -> Figures:
        return q_figures(learner, [{key: value.to(run.device) for key, value in b.items()} for b in checks])

    task = fitting.Task(lambda rng, size: q_batch(corpus, episodes.windows(rng, size, config.decisions),
                                                  config.lookahead), validate=validate,
                        before_step=learner.before_step)
    return run.fit(stage, learner, task, folder)


@torch.no_grad()
def q_figures(learner: ConservativeQ, batches: Sequence[dict[str, Tensor]]) -> dict[str, float]:
    """On the performers' own decisions: NLL of softmax(Q), accuracy of arg max, squared Bellman error, mean Q."""
    totals = np.zeros(4)
    for batch in batches:
        q = learner.online.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
        allowed = learner.online.allowed(batch["silent"])
        masked = q.masked_fill(~allowed, -torch.inf)
        valid, action = batch["valid"], batch["action"][..., None]
        nll = data_nll(q, batch["action"], allowed)
        right = (masked.argmax(-1, keepdim=True) == action)[..., 0].float()
        count = valid.sum()
        # Q of the performers' lexemes, the values that conservative learning raises.
        taken = q.gather(-1, action)[..., 0]
        error = learner.losses({**batch, "cloned": valid}).get("temporal_difference", torch.nan)
        totals += [float((nll * valid).sum() / count), float((right * valid).sum() / count), float(error),
                   float((taken * valid).sum() / count)]
    names = ("nll", "accuracy", "temporal_difference", "mean_q")
    return {name: float(value) for name, value in zip(names, totals / len(batches), strict=True)}


Q_NETWORK: Stage[QNetwork] = Stage(
    "q_network", settings=("cql", "silence.hint"), schedule="cql",
    needs=lambda config: (CORPUS, TOKENS, LABELS, REWARD, EPISODES),
    wanted=lambda config: config.schedules.cql.steps > 0, part="q_network",
    train=lambda run, learner, folder: _train(run, learner, folder, Q_NETWORK, run.get(EPISODES), step_reward(run)),
    finish=lambda learner: cast("ConservativeQ", learner).online,
    build=lambda run: ConservativeQ(models.build("q_network", model_sizes(run))))
Q_LITERAL: Stage[QNetwork] = Stage(
    "q_network_literal", settings=("cql_literal", "silence.hint"), schedule="cql_literal",
    needs=lambda config: (CORPUS, TOKENS, LABELS, REWARD, LITERAL_EPISODES),
    wanted=lambda config: min(config.schedules.cql.steps, config.schedules.cql_literal.steps) > 0,
    part="q_network_literal",
    train=lambda run, learner, folder: _train(run, learner, folder, Q_LITERAL, run.get(LITERAL_EPISODES),
                                              literal_reward(run)),
    finish=lambda learner: cast("ConservativeQ", learner).online,
    build=lambda run: ConservativeQ(models.build("q_network_literal", model_sizes(run))))
"""The Q-network as published, trained on `LITERAL_EPISODES`."""
