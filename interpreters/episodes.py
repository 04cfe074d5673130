"""Recordings as trajectories: the offline data set of the Q-network (RACER 4.3).

An episode is a recording as a sequence of decisions: on each block a behaviour policy pi_beta took an action (a lexeme)
with a reward. The paper's data set D = {s, a, r, s'} holds the actions of people; by default other policies contribute
a share, so that good and bad actions can be compared. A state (a_0 .. a_{i-1}, u_1 .. u_i) is not stored; it is
assembled from the previous lexemes and the speech of the block numbers.

The first block of a recording has the given a_0; decisions begin with the second.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from interpreters.base import BlockFeatures, LexemeInterpreter, select
from interpreters.settings import BEHAVIOURS, EpisodeConfig

Integers = NDArray[np.int64]
Reward = Callable[[Tensor, Tensor], Tensor]
"""Lexemes [M] and block numbers [M] of a stretch of a recording to the reward of each step [M], which depends on this
stretch only. Examples are `RewardTable.sequence` and `looked_up`."""

REPLACED, NEAREST = 0.2, 3
"""Of the perturbed share: probability that a lexeme is replaced, and number of its nearest lexemes."""
TEMPERATURE = 1.0
"""Of the roll-outs: lexemes are sampled from softmax(scores / temperature)."""
_AT_RANDOM = 0.5
"""Share of the perturbed lexemes that are replaced by any other; the rest are replaced by one of the nearest."""


@dataclass(frozen=True)
class Demonstration:
    """The recorded lexemes of a recording of M blocks. recording, speaker: indices; blocks: [M] block numbers in the
    corpus, in order; lexemes: [M]; silent: [M]."""

    recording: int
    speaker: int
    blocks: Integers
    lexemes: Integers
    silent: NDArray[np.bool_]

    def __post_init__(self) -> None:
        if not len(self.blocks) == len(self.lexemes) == len(self.silent) > 0:
            raise ValueError(f"{len(self.blocks)} blocks, {len(self.lexemes)} lexemes and {len(self.silent)} silences")


@dataclass(frozen=True)
class Episode:
    """One performance of a recording or of its beginning. actions: [M] lexemes, the first of them given. behaviour: [M]
    index in BEHAVIOURS of the policy. reward: [M].
    terminal: [M], True only on the last block of the whole recording: an episode that ends earlier is truncated."""

    recording: int
    speaker: int
    blocks: Integers
    actions: Integers
    behaviour: NDArray[np.int8]
    reward: NDArray[np.float32]
    silent: NDArray[np.bool_]
    terminal: NDArray[np.bool_]

    def __post_init__(self) -> None:
        lengths = {name: getattr(self, name).shape for name in _COLUMNS}
        if len(set(lengths.values())) != 1 or len(self.blocks) == 0:
            raise ValueError(f"the arrays of an episode differ in length or are empty: {lengths}")
        if self.terminal[:-1].any():
            raise ValueError("an episode goes on after its terminal step")


_COLUMNS = {"blocks": np.int64, "actions": np.int64, "behaviour": np.int8,
            "reward": np.float32, "silent": np.bool_, "terminal": np.bool_}


class Episodes:
    """A data set of episodes, from which windows of decisions are sampled."""

    def __init__(self, episodes: Sequence[Episode]) -> None:
        """InputError without any decision."""
        self.episodes = tuple(episodes)
        self.lengths = np.array([len(episode.blocks) for episode in self.episodes], dtype=np.int64)
        if len(self.lengths) == 0 or self.lengths.max() < 2:
            raise InputError("episodes", "hold no decision", "give recordings of two blocks at least")
        # Episodes lie end to end in one array of each kind, so that a batch is one indexing operation.
        self._offsets = np.cumsum(self.lengths) - self.lengths
        self._columns: dict[str, NDArray[Any]] = {
            name: np.concatenate([getattr(episode, name) for episode in self.episodes]).astype(kind)
            for name, kind in _COLUMNS.items()}
        self._speakers = np.array([episode.speaker for episode in self.episodes], dtype=np.int64)

    def __len__(self) -> int:
        return len(self.episodes)

    def windows(self, rng: np.random.Generator, count: int, decisions: int) -> dict[str, Tensor]:
        """A batch of `count` windows of T decisions and one more position to bootstrap from.

        block, previous, action, behaviour: [B, T + 1] int64; reward, valid, cloned: [B, T + 1] float32; terminal,
        silent: [B, T + 1] bool; speaker: [B] int64. previous[:, i] is the lexeme before block[:, i]; previous[:, 0] is
        the given a_0. A window cut from a longer take is truncated; position T is for bootstrapping. After the end of
        an episode the last block is repeated, with valid 0 and reward 0.
        """
        return self.cut(*draw_starts(rng, self.lengths, count, decisions), decisions)

    def cut(self, episode: Integers, start: Integers, decisions: int) -> dict[str, Tensor]:
        last = self.lengths[episode, None] - 1
        index = start[:, None] + 1 + np.arange(decisions + 1)
        valid = index <= last
        # Columns are the episodes end to end; indices past the end of an episode repeat its last block.
        at = self._offsets[episode, None] + np.minimum(index, last)
        before = self._offsets[episode, None] + np.minimum(index - 1, last)
        rows = {name: column[at] for name, column in self._columns.items()}
        # The data term imitates people; actions of other policies are there to compare values.
        batch = {
            "block": rows["blocks"], "previous": self._columns["actions"][before], "action": rows["actions"],
            "reward": rows["reward"] * valid, "terminal": rows["terminal"] & valid, "valid": valid.astype(np.float32),
            "silent": rows["silent"], "speaker": self._speakers[episode],
            "behaviour": rows["behaviour"].astype(np.int64),
            "cloned": ((rows["behaviour"] == 0) & valid).astype(np.float32),
        }
        return {key: torch.as_tensor(value) for key, value in batch.items()}


def draw_starts(rng: np.random.Generator, lengths: Integers, count: int, decisions: int) -> tuple[Integers, Integers]:
    """Random starts of windows of T decisions: sequence numbers [count] and the position of a_0 in each [count]. All
    starts in all sequences of `lengths` [E] are equally likely. T decisions follow a start if the sequence is long
    enough."""
    # A sequence of L blocks holds L - 1 decisions, so L - T windows of T; a shorter one is padded and has one start, or
    # none without a decision.
    choices = np.where(lengths > 1, np.maximum(lengths - decisions, 1), 0)
    until = np.cumsum(choices)
    sampled = rng.integers(until[-1], size=count)
    which = np.searchsorted(until, sampled, side="right")
    # The place of the sample among the starts of its sequence.
    return which, sampled - until[which] + choices[which]


@dataclass(frozen=True)
class SilentLexemes:
    """The lexemes allowed in silence: indices [n], and for every lexeme [S] the nearest of them (RG 6.4.1). Without
    any, all lexemes are allowed."""

    indices: Integers
    nearest: Integers

    def allowed(self, silent: bool) -> Integers | None:
        return self.indices if silent and len(self.indices) else None

    def relabel(self, take: Demonstration) -> Integers:
        if len(self.indices) == 0:
            return take.lexemes.astype(np.int64)
        return np.where(take.silent, self.nearest[take.lexemes], take.lexemes).astype(np.int64)


@dataclass(frozen=True)
class BehaviourPolicies:
    """The policies besides the person. interpreters: by behaviour ("sampled", "statistical"), those that have a share;
    features(block number): their input."""

    interpreters: Mapping[str, LexemeInterpreter]
    features: Callable[[int], BlockFeatures]


def build(takes: Sequence[Demonstration], config: EpisodeConfig, reward: Reward, *, silent: SilentLexemes,
          vectors: NDArray[np.floating[Any]], policies: BehaviourPolicies | None = None, seed: int = 0) -> Episodes:
    """The data set: every take as recorded, and the shares of the other behaviours.

    reward: the reward of each step of a recording, of the kind `config.reward`. RACER 4.3 rewards a sequence and does
    not define the reward of a step; here it is that of the trailing window, which is stationary. vectors: [S, D] the
    codebook. policies: needed for the shares of interpreters. The same seed gives the same bits; each behaviour has its
    own generator, so that changing one share does not affect the others.
    """
    order = _by_distance(np.asarray(vectors, dtype=np.float64))
    takes = [replace(take, lexemes=silent.relabel(take)) for take in takes]
    base = sum(len(take.blocks) - 1 for take in takes)
    # `truth` is the share of the recordings, each taken once, so it determines the size of the whole.
    total = base / config.truth if config.truth > 0 else base
    episodes = [_episode(take, take.lexemes, 0, config, reward) for take in takes] if config.truth > 0 else []
    for number, name in enumerate(BEHAVIOURS[1:], start=1):
        # One generator for each behaviour: a changed share leaves the others as they were.
        rng = np.random.default_rng([seed, number])
        for take, length in _budgeted(takes, round(config.shares[name] * total), config.prefix, rng):
            if name == "perturbed":
                acted = perturb(take, length, config, order, silent, rng)
            elif policies is None or name not in policies.interpreters:
                raise ValueError(f"the share of {name!r} needs its interpreter and features")
            else:
                acted = roll(policies, name, take, length, config, silent, rng)
            episodes.append(_episode(take, acted, number, config, reward))
    return Episodes(episodes)


def _budgeted(takes: Sequence[Demonstration], budget: int, prefix: int, rng: np.random.Generator
              ) -> Iterator[tuple[Demonstration, int]]:
    """Takes in random order, each with the length to act, until there are `budget` decisions after the prefixes."""
    # A take that is no longer than the prefix leaves nothing to act on.
    usable = [take for take in takes if len(take.blocks) > prefix]
    if budget > 0 and not usable:
        raise InputError("episodes.prefix", f"of {prefix} leaves nothing of any recording", "give a smaller one")
    while budget > 0:
        for index in rng.permutation(len(usable)):
            # The last take is cut so that the budget is met exactly.
            length = min(len(usable[index].blocks), prefix + budget)
            budget -= length - prefix
            yield usable[index], length
            if budget == 0:
                return


@torch.inference_mode()
def roll(policies: BehaviourPolicies, name: str, take: Demonstration, length: int, config: EpisodeConfig,
         silent: SilentLexemes, rng: np.random.Generator) -> Integers:
    """Actions [length] of an interpreter that takes over after the prefix of a take. The interpreter also processes the
    prefix, so that its state contains the person's past."""
    interpreter, features = policies.interpreters[name], policies.features
    actions = take.lexemes[:length].copy()
    state = interpreter.start(take.speaker, int(actions[0]))
    for i in range(1, length):
        scores, state = interpreter.step(state, features(int(take.blocks[i])), int(actions[i - 1]))
        if i >= config.prefix:
            allowed = silent.allowed(bool(take.silent[i]))
            actions[i] = select(scores, allowed=allowed, temperature=TEMPERATURE, rng=rng)
    return actions


def perturb(take: Demonstration, length: int, config: EpisodeConfig, order: Integers, silent: SilentLexemes,
            rng: np.random.Generator) -> Integers:
    """Actions [length]: the take's lexemes, some replaced after the prefix. order: [S, S]."""
    actions = take.lexemes[:length].copy()
    for i in range(config.prefix, length):
        chances = perturbed_chances(int(take.lexemes[i]), order, silent.allowed(bool(take.silent[i])))
        actions[i] = rng.choice(len(chances), p=chances)
    return actions


def perturbed_chances(truth: int, order: Integers, allowed: Integers | None) -> NDArray[np.float64]:
    """[S] probability of each lexeme if the true one may be replaced by one of the nearest or by any other. order: [S,
    S] for each lexeme all of them, the nearest first. The truth stays if nothing else is allowed."""
    # The truth is its own nearest lexeme, and no replacement.
    others = order[truth][order[truth] != truth]
    if allowed is not None:
        others = others[np.isin(others, allowed)]
    chances = np.zeros(len(order))
    if len(others) == 0:
        chances[truth] = 1.0
        return chances
    near = others[:NEAREST]
    chances[truth] = 1 - REPLACED
    chances[others] += REPLACED * _AT_RANDOM / len(others)
    chances[near] += REPLACED * (1 - _AT_RANDOM) / len(near)
    return chances


def _by_distance(vectors: NDArray[np.float64]) -> Integers:
    distances = ((vectors[:, None] - vectors[None]) ** 2).sum(axis=-1)
    # Stable, because codewords can coincide and the same seed must give the same bits.
    return np.argsort(distances, axis=1, kind="stable")


def _episode(take: Demonstration, actions: Integers, behaviour: int, config: EpisodeConfig, reward: Reward) -> Episode:
    """The episode of actions [m] on the first m blocks of a take; actions within the prefix are the truth."""
    length = len(actions)
    terminal = np.zeros(length, dtype=np.bool_)
    # A prefix of a recording is cut off, not ended: its last state has a future value.
    terminal[-1] = length == len(take.blocks)
    blocks = take.blocks[:length].astype(np.int64)
    behaviours = np.where(np.arange(length) < config.prefix, 0, behaviour).astype(np.int8)
    rewards = np.asarray(reward(torch.as_tensor(actions), torch.as_tensor(blocks)), dtype=np.float32)
    return Episode(take.recording, take.speaker, blocks, actions, behaviours, rewards,
                   take.silent[:length].astype(np.bool_), terminal)


def distance_rewards(decoded: Tensor, true: Tensor) -> Tensor:
    """[M, S] the "distance reward" of the paper's ablation: minus the mean absolute difference of features.

    decoded: [S, K, D_m] the motion of each lexeme; true: [M, K, D_m] the recorded motion of each block; both
    normalised. The table has every lexeme on every block: for the recorded lexemes alone the distance is the nearly
    constant error of the lexicon.
    """
    return -torch.cdist(true.flatten(1).float(), decoded.flatten(1).float(), p=1.0) / true[0].numel()


def looked_up(table: Tensor) -> Reward:
    """A reward from a table [N, S] of every lexeme on every block of the corpus."""
    return lambda lexemes, blocks: table[blocks, lexemes]
