"""RACER's rows over our lexicon: what does conservative Q-learning buy? (RACER 5.5, Table 2)

Every row is a Q-network of the same size, trained for the same number of steps and begun alike at the same seed; a row
is the settings that it changes and how it learns. "offline" learns from the episodes of the training split
(`interpreters.episodes`); "online" acts in the recorded speech, epsilon-greedily, and learns from what it remembers
(DQN); "actor-critic" begins as the supervised network of its seed (so it has had twice the steps in all) and learns
from what it has just done. Beside them stand lexemes that are known beforehand, by which the reward is judged: the
performer's, random ones, and each speaker's most frequent one. The lexicon, the speech levels and both reward models
are those of the row `q-network` at the same seed, so a seed is lexicon, reward, network and roll-outs together.

What fools it: the training reward is what most rows were made to please and `racer-supervised` was not; believe what
the judging model says too. The paper's figures stand beside ours for their order alone: other data, another reward
model, another lexicon.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from data_module.errors import InputError
from data_module.layers import freeze
from data_module.store import Recording
from eval.ablate.actor_critic import ActorCritic
from eval.ablate.policy import Decisions, lexeme_values, walk
from eval.ablate.rows import RACER_SIZES, RACER_SUPERVISED, ROWS
from eval.ablate.run import RgRows, played
from eval.ablate.simulator import Choose, Replay, Simulator
from eval.baselines.interpreters import Majority
from eval.context import EvalContext, Lexemes
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Sizes
from gesticulator.bundle.models import JUDGES, runner_of
from gesticulator.bundle.models import build as build_model
from gesticulator.training import fit as fitting
from gesticulator.training.stages import STAGES, Corpus
from gesticulator.training.stages.caches import weights_hash
from gesticulator.training.stages.corpus import sizes
from gesticulator.training.stages.q_network import features_of, q_batch, takes_of
from gesticulator.training.stages.reward import reward_table, taught_reward
from interpreters.base import LexemeInterpreter
from interpreters.cql import ConservativeQ, QNetwork, without_dropout
from interpreters.episodes import BehaviourPolicies, Demonstration, Episodes, SilentLexemes, build, distance_rewards
from interpreters.reward_table import Centred, EnsembleReward
from lexicon.inventory import nearest_silent

VERSION = 5
"""Raised when the same settings would no longer give the same figures."""
ACT_EVERY = 2
"""Steps of the online row between two roll-outs of a batch of episodes."""
MEMORY = 4096
"""Windows that it remembers."""
GREEDY_AT, LEAST_EPSILON = 0.5, 0.1
"""epsilon falls from 1 to the least one by this share of the steps."""


# ------------------------------------------------------------------------------------------- what all rows stand on

@dataclass(frozen=True)
class RacerRows:
    """Shared by RACER's rows. context: a store and a bundle with both reward models; settings: those that the rows
    change; takes: the training split; decisions: on the test split; tables: of rewards, "" the one that policies are
    taught and "judge_" the other; rg: what scores motion; scale: by what rewards are multiplied offline."""

    context: EvalContext
    settings: Config
    takes: list[Demonstration]
    silent: SilentLexemes
    decisions: Decisions
    tables: dict[str, EnsembleReward]
    rg: RgRows
    scale: float = 1.0
    _episodes: dict[str, Episodes] = field(default_factory=dict)
    _trained: dict[tuple[str, int], QNetwork] = field(default_factory=dict, init=False)

    @classmethod
    def over(cls, rg: RgRows, seed: int) -> RacerRows:
        """On the store of the other rows and the bundle of the row "q-network", with the models of its training."""
        first, (bundle, run) = rg.first, rg.trained("q-network", seed)
        bundle = bundle.with_parts(**{name: run.get(STAGES[name]) for name in JUDGES})
        context = EvalContext.over(first.store, bundle, first.work, rg.context.limit, first.progress)
        return cls.of(context, rg, RACER_SIZES.get(first.config.name, ()))

    @classmethod
    def of(cls, context: EvalContext, rg: RgRows, preset: Sequence[str]) -> RacerRows:
        """From a bundle over a lexicon with both reward models; InputError without test speech."""
        bundle, corpus, labels = context.bundle, context.corpus, context.labels
        assert bundle.reward is not None and bundle.reward_judge is not None
        decisions = Decisions.of(bundle, corpus, labels, context.limit)
        if not decisions.takes:
            raise InputError(context.store.path, "has no test recording with a decision in it", "build the store again")
        # The data are relabelled as the hint wants it: in silence the nearest silent lexeme is what was done.
        silent = SilentLexemes(bundle.silent, nearest_silent(bundle.vectors.astype(np.float64), bundle.silent))
        takes = [replace(take, lexemes=silent.relabel(take)) for take in takes_of(corpus, labels, "train")]
        tables = {"": reward_table(bundle.reward, bundle.block_lexicon, corpus),
                  "judge_": reward_table(bundle.reward_judge, bundle.block_lexicon, corpus)}
        return cls(context, configs.with_settings(bundle.config, preset), takes, silent, decisions, tables, rg)

    @property
    def bundle(self) -> bundles.Bundle:
        """The bundle that the rows stand on."""
        return self.context.bundle

    @property
    def corpus(self) -> Corpus:
        """The store's blocks."""
        return self.context.corpus

    def taught(self, config: Config) -> EnsembleReward | Centred:
        """The training reward as policies are taught it under the settings."""
        return taught_reward(self.tables[""], self.corpus, config.episodes.baseline)

    def config(self, name: str) -> Config:
        """The settings of a row."""
        return configs.with_settings(self.settings, ROWS[name].set)

    @cached_property
    def shared(self) -> str:
        """Hash of what the rows share: all models, and what scores motion."""
        bundle = self.bundle
        # Generator and style play what is chosen, so figures of motion depend on them, too.
        models = (bundle.block_lexicon, bundle.interpreter, bundle.reward, bundle.reward_judge, bundle.encoder,
                  bundle.generator, bundle.style)
        return configs.digest(VERSION, [weights_hash(model) for model in models if model is not None],
                              bundle.silent.tolist(), bundle.config.silence.mask, self.context.limit, self.rg.shared)

    def cell_key(self, name: str, seed: int) -> str:
        """Hash of everything that shapes a row's cell."""
        names = [self.corpus.names[take.recording] for take in self.decisions.takes]
        # A change of the supervised row is one of the actor-critic that begins as it.
        begins_as = self.config(RACER_SUPERVISED) if ROWS[name].train == "actor-critic" else None
        row = ROWS[name]
        return configs.digest(self.shared, self.config(name), row.train, row.scale, begins_as, seed, names)

    def measured(self, name: str, seed: int) -> dict[str, Any]:
        """"clips" and "sets" of a row's cell: all test recordings judged and played."""
        takes, chosen = self.decisions.takes, self.chosen(name, seed)
        clips = [{"name": self.corpus.names[take.recording], "decisions": len(take.blocks) - 1,
                  **lexeme_values(take, lexemes, self.decisions.size, self.tables)}
                 for take, lexemes in zip(takes, chosen, strict=True)]
        # Without a lexicon: lexemes that were chosen are known, and need not be read from the motion.
        scored = self.rg.scored([recording.info.name for recording in self.recordings], lexicon=False)
        motions = [played(self.context.system, *pair) for pair in zip(self.recordings, chosen, strict=True)]
        for clip, motion in zip(clips, self.rg.summary(scored, motions)["clips"], strict=True):
            clip |= motion
        return {"clips": clips, "sets": {}}

    def chosen(self, name: str, seed: int) -> list[Lexemes]:
        """The lexemes [M] of a row on each test recording; the first of them is the performer's."""
        takes, train = self.decisions.takes, ROWS[name].train
        if train == "performer":
            return [self.silent.relabel(take) for take in takes]
        if train == "random":
            rng = np.random.default_rng(seed)
            # The greatest of random numbers over what may be chosen is any of that, all alike.
            return [np.append(take.lexemes[:1], np.where(allowed, rng.random(allowed.shape), -1).argmax(1)[1:])
                    for take in takes for allowed in [self.decisions.allowed(take)]]
        policy = Majority(self.bundle) if train == "majority" else self.policy(name, trained(self, name, seed))
        return [walk(policy, self.decisions, take) for take in takes]

    @cached_property
    def recordings(self) -> list[Recording]:
        """The test recordings, which every row is played on."""
        return [self.context.store.load(self.corpus.names[take.recording]) for take in self.decisions.takes]

    def policy(self, name: str, network: QNetwork) -> LexemeInterpreter:
        """A row's trained network as it chooses lexemes."""
        runner: LexemeInterpreter = runner_of("q_network", self._sizes(name), network)
        return runner

    def untrained(self, name: str, seed: int) -> QNetwork:
        """The network that a row begins with, the same for all rows of a seed."""
        # Rows of a seed differ by what they learn, not by where they begin.
        torch.manual_seed(seed)
        return cast("QNetwork", build_model("q_network", self._sizes(name)))

    def _sizes(self, name: str) -> Sizes:
        """The dimensions of a row's network."""
        return sizes(self.config(name), self.corpus, vectors=self.bundle.vectors,
                     silent=tuple(self.bundle.silent.tolist()))


def rescaled(table: Tensor, episodes: Episodes) -> Tensor:
    """A reward table [N, S] with the mean and spread, over the decisions of a data set, of the rewards there.

    That changes no order between lexemes, and by how much to trust the data's is then asked at one scale for both.
    """
    recorded = np.concatenate([episode.reward[1:] for episode in episodes.episodes]).astype(np.float64)
    new = np.concatenate([table.numpy()[episode.blocks, episode.actions][1:] for episode in episodes.episodes])
    # Both rewards at one mean and spread, or alpha would weigh the data's term differently in both rows.
    scale = recorded.std() / max(float(new.std()), 1e-6)
    return (table - float(new.mean())) * float(scale) + float(recorded.mean())


def rewarded(racer: RacerRows, config: Config) -> Episodes:
    """The offline data set with the reward of the settings, times the scale of the row; every row has the same."""
    plain = replace(config.episodes, reward="contrastive")
    key = configs.digest(plain)
    if key not in racer._episodes:
        # Behaviour beside the recorded one: without it no other lexeme than the person's was ever tried.
        interpreters: dict[str, LexemeInterpreter] = {
            "sampled": racer.bundle.runners["interpreter"],
            "statistical": racer.bundle.interpreter_named("statistical")}
        racer._episodes[key] = build(racer.takes, plain, racer.taught(config).sequence, silent=racer.silent,
                                     vectors=racer.bundle.vectors, seed=config.seed,
                                     policies=BehaviourPolicies(interpreters, features_of(racer.corpus)))
    episodes = racer._episodes[key]
    if config.episodes.reward == "contrastive" and racer.scale == 1:
        return episodes
    rewards = [episode.reward for episode in episodes.episodes]
    if config.episodes.reward == "distance":
        table = rescaled(distance_rewards(racer.bundle.block_lexicon.shown(), racer.corpus.motion), episodes).numpy()
        rewards = [table[episode.blocks, episode.actions] for episode in episodes.episodes]
    return Episodes([replace(episode, reward=(racer.scale * reward).astype(np.float32))
                     for episode, reward in zip(episodes.episodes, rewards, strict=True)])


# --------------------------------------------------------------------------------------------------------- learning

Learner = tuple[ConservativeQ | ActorCritic, fitting.MakeBatch]
"""A model for `fit`, with its `before_step`, and the maker of its batches."""


def simulator(racer: RacerRows, config: Config) -> Simulator:
    """The recorded speech as an environment that pays by the training reward."""
    return Simulator(racer.takes, racer.taught(config).rewards, racer.tables[""].window)


def latest(policy: QNetwork, corpus: Corpus, observed: dict[str, Tensor]) -> Tensor:
    """Scores [B, S] of the lexeme to be chosen now, after what was seen (see `eval.ablate.simulator.Choose`)."""
    batch = q_batch(corpus, observed)
    return policy.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])[:, -1]


def epsilon_greedy(network: QNetwork, corpus: Corpus, epsilon: float, rng: np.random.Generator) -> Choose:
    """The best allowed lexeme, or with probability epsilon any allowed one."""
    def choose(observed: dict[str, Tensor]) -> Tensor:
        values, silent = latest(network, corpus, observed), observed["silent"][:, -1]
        anything = network.choose(torch.as_tensor(rng.random(values.shape)), silent)
        explores = torch.as_tensor(rng.random(len(values)) < epsilon)
        return torch.where(explores, anything, network.choose(values, silent))

    return choose


def sampled(policy: QNetwork, corpus: Corpus, rng: np.random.Generator) -> Choose:
    """A lexeme sampled from pi(. | s) over those allowed: the best after Gumbel noise on the logits."""
    def choose(observed: dict[str, Tensor]) -> Tensor:
        values = latest(policy, corpus, observed)
        # The greatest of logits with Gumbel noise is a draw from their softmax.
        noise = torch.as_tensor(rng.gumbel(size=values.shape))
        return policy.choose(values + noise, observed["silent"][:, -1])

    return choose


def offline(racer: RacerRows, config: Config, network: QNetwork, seed: int) -> Learner:
    """Conservative Q-learning, or what the settings leave of it, on the recorded episodes (RACER Eq. 11)."""
    episodes = rewarded(racer, config)
    return ConservativeQ(network), lambda rng, size: q_batch(racer.corpus, episodes.windows(
        rng, size, config.cql.decisions))


class Acting(ConservativeQ):
    """A Q-network that acts in the recorded speech every `ACT_EVERY` steps and remembers a batch of episodes (DQN)."""

    def __init__(self, racer: RacerRows, config: Config, network: QNetwork, seed: int) -> None:
        super().__init__(network)
        self._racer, self._config, self._seed, self._memory = racer, config, seed, Replay(MEMORY)
        self._simulator = simulator(racer, config)

    def before_step(self, step: int) -> None:
        """The target network, and what it does now and then."""
        super().before_step(step)
        if step % ACT_EVERY == 0:
            # Exploration falls with the steps, so late episodes are nearly what the policy itself would do.
            rng = np.random.default_rng([self._seed, step, 1])  # not the numbers that the step's batch is drawn with
            share = step / max(1.0, GREEDY_AT * self._config.schedules.cql.steps)
            epsilon = max(LEAST_EPSILON, 1 - (1 - LEAST_EPSILON) * share)
            with without_dropout(self.online):
                self._memory.add(self._simulator.collect(
                    epsilon_greedy(self.online, self._racer.corpus, epsilon, rng), rng,
                    self._config.schedules.cql.batch, self._config.cql.decisions))

    def batch(self, rng: np.random.Generator, size: int) -> fitting.Batch:
        """Windows of what it remembers."""
        return q_batch(self._racer.corpus, self._memory.windows(rng, size))


def online(racer: RacerRows, config: Config, network: QNetwork, seed: int) -> Learner:
    """DQN."""
    model = Acting(racer, config, network, seed)
    return model, model.batch


def actor_critic(racer: RacerRows, config: Config, network: QNetwork, seed: int) -> Learner:
    """Policy gradients on what the policy has just done, beginning as the supervised network of the seed."""
    # First its own weights, which are drawn: a supervised network that is trained now would move the numbers.
    model = ActorCritic(network, config.cql.gamma)
    # Of the same seed: the pair differs by what came after, as the paper's rows do.
    model.begin_as(trained(racer, RACER_SUPERVISED, seed))
    speech = simulator(racer, config)
    return model, lambda rng, size: q_batch(racer.corpus, speech.collect(
        sampled(model.actor, racer.corpus, rng), rng, size, config.cql.decisions))


TRAININGS = {"offline": offline, "online": online, "actor-critic": actor_critic}


def trained(racer: RacerRows, name: str, seed: int) -> QNetwork:
    """The network of a row, trained at its first use; of the actor-critic the actor."""
    if (name, seed) not in racer._trained:
        # Kept for the actor-critic, which begins as the supervised network of its seed.
        config = racer.config(name)
        model, make_batch = TRAININGS[ROWS[name].train](
            replace(racer, scale=ROWS[name].scale), config, racer.untrained(name, seed), seed)
        # No checkpoint is kept: what roll-outs remembered would be lost, so a resumed training would be another one.
        with tempfile.TemporaryDirectory() as scratch:
            fitting.fit(f"{name}, seed {seed}", model, fitting.Task(
                make_batch, before_step=model.before_step), config.schedules.cql, Path(scratch),
                fitting.FitOptions(seed=seed, checkpoint_seconds=float("inf"), progress=racer.context.progress))
        policy = model.online if isinstance(model, ConservativeQ) else model.actor
        freeze(policy)
        racer._trained[name, seed] = policy
    return racer._trained[name, seed]
