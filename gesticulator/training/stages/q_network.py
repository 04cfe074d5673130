"""The Q-network, trained by conservative Q-learning on the offline episodes (RACER 4.3, Eq. 11)."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.bundle.models import system_of
from gesticulator.training import fit as fitting
from gesticulator.training.presets import LITERAL
from gesticulator.training.stages.base import Node, Run, Stage, checked
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.interpreter import INTERPRETER
from gesticulator.training.stages.lexicon import LABELS, TOKENS, model_sizes
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
        low, high = (level[block].float().numpy() for level in (corpus.low, corpus.high))
        return BlockFeatures(low, high, bool(corpus.silent[block]), past=past[0].numpy(),
                             durations=(float(seconds[0, 0]), float(seconds[0, 1])))

    return features


def recorded_episodes(run: Run, split: str, reward: Reward) -> Episodes:
    """RACER's own data set: the lexemes of the performers and nothing else, of a split (of the training split if it is
    empty)."""
    corpus, labelled = run.get(CORPUS), run.get(LABELS)
    takes = takes_of(corpus, labelled.hinted, split if corpus.recordings(split) else "train")
    return build(takes, LITERAL, reward, silent=SilentLexemes(labelled.silent, labelled.nearest),
                 vectors=run.get(TOKENS).vectors.numpy())


def _make_episodes(run: Run) -> Episodes:
    corpus, config, labelled = run.get(CORPUS), run.config, run.get(LABELS)
    frequencies = np.stack([labelled.inventory.frequencies[name] for name in corpus.statistics.speakers])
    others: dict[str, Any] = {"statistical": StatisticalInterpreter(frequencies, labelled.inventory.transitions)}
    if INTERPRETER.name in system_of(config).STAGES:
        others["sampled"] = models.runner_of("interpreter", model_sizes(run), run.get(INTERPRETER))
    return build(takes_of(corpus, labelled.hinted, "train"), config.episodes, step_reward(run),
                 silent=SilentLexemes(labelled.silent, labelled.nearest), vectors=run.get(TOKENS).vectors.numpy(),
                 policies=BehaviourPolicies(others, features_of(corpus)), seed=run.seed(EPISODES))


def _episode_needs(config: Config) -> Sequence[Node[Any]]:
    return CORPUS, TOKENS, LABELS, REWARD, *((INTERPRETER,) if INTERPRETER.name in system_of(config).STAGES else ())


EPISODES: Node[Episodes] = Node("episodes", settings=("episodes", "silence.hint"), needs=_episode_needs,
                                make=_make_episodes)
"""The offline data set of the training split (RACER 4.3)."""


def literal_reward(run: Run) -> Reward:
    """The reward of a step as published: the cosine of motion and audio (RACER Eq. 8), relative to nothing."""
    return reward_table(run.get(REWARD), run.get(TOKENS), run.get(CORPUS), literal=True).sequence


LITERAL_EPISODES: Node[Episodes] = Node(
    "episodes_literal", settings=("silence.hint",), needs=lambda config: (CORPUS, TOKENS, LABELS, REWARD),
    make=lambda run: recorded_episodes(run, "train", literal_reward(run)))


def q_batch(corpus: Corpus, windows: dict[str, Tensor]) -> dict[str, Tensor]:
    """Windows of episodes with the Q-network's inputs: audio [B, T + 1, 3K, d] and speaker one-hot [B, P]."""
    return {**windows, "audio": corpus.high[windows["block"]].float(),
            "speaker": functional.one_hot(windows["speaker"], len(corpus.statistics.speakers)).float()}


def _task(run: Run, learner: ConservativeQ, episodes: Episodes, reward: Reward) -> fitting.Task:
    """Fit a Q-network to episodes; `reward` is that of a step of the validation recordings."""
    corpus, config, held = run.get(CORPUS), learner.config, recorded_episodes(run, "val", reward)
    checks = [q_batch(corpus, held.windows(fitting.generator_for(3, i), _WINDOWS, config.decisions))
              for i in range(_CHECKS)]

    return fitting.Task(lambda rng, size: q_batch(corpus, episodes.windows(rng, size, config.decisions)),
                        validate=checked(run, checks, partial(q_figures, learner)), before_step=learner.before_step)


@torch.no_grad()
def q_figures(learner: ConservativeQ, batches: Sequence[dict[str, Tensor]]) -> dict[str, float]:
    """On the performers' own decisions: NLL of softmax(Q), accuracy of arg max, squared Bellman error."""
    totals = np.zeros(3)
    for batch in batches:
        q = learner.online.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
        allowed = learner.online.allowed(batch["silent"])
        masked = q.masked_fill(~allowed, -torch.inf)
        valid, action = batch["valid"], batch["action"][..., None]
        nll = data_nll(q, batch["action"], allowed)
        right = (masked.argmax(-1, keepdim=True) == action)[..., 0].float()
        count = valid.sum()
        error = learner.losses({**batch, "cloned": valid}).get("temporal_difference", torch.nan)
        totals += [float((nll * valid).sum() / count), float((right * valid).sum() / count), float(error)]
    names = ("nll", "accuracy", "temporal_difference")
    return {name: float(value) for name, value in zip(names, totals / len(batches), strict=True)}


def _q_stage(name: str, settings: str, episodes: Node[Episodes], reward: Callable[[Run], Reward]) -> Stage[QNetwork]:
    """A Q-network trained on `episodes`; settings: the names of its settings and of its schedule."""
    return Stage(
        name, settings=(settings, "silence.hint"), schedule=settings, part=name,
        train=lambda run, learner: _task(run, learner, run.get(episodes), reward(run)),
        needs=lambda config: (CORPUS, TOKENS, LABELS, REWARD, episodes),
        wanted=lambda config: min(config.schedules.cql.steps, getattr(config.schedules, settings).steps) > 0,
        build=lambda run: ConservativeQ(models.build(name, model_sizes(run))),
        finish=lambda learner: cast("ConservativeQ", learner).online)


Q_NETWORK = _q_stage("q_network", "cql", EPISODES, step_reward)
Q_LITERAL = _q_stage("q_network_literal", "cql_literal", LITERAL_EPISODES, literal_reward)
"""The Q-network as published, trained on recorded lexemes only."""
