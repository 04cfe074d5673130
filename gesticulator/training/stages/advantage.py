"""The critics of the advantage interpreter, and their training data: each lexeme's reward and its effect on later
ones."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage, checked
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.interpreter import INTERPRETER, teacher_logits
from gesticulator.training.stages.lexicon import LABELS, TOKENS, model_sizes
from gesticulator.training.stages.q_network import EPISODES, recorded_episodes
from gesticulator.training.stages.reward import REWARD, TAUGHT_REWARD
from gesticulator.training.stages.speech import CORPUS
from interpreters.advantage import Critics
from interpreters.episodes import Episode
from interpreters.lstm import LstmInterpreter
from interpreters.reward_table import Centred, EnsembleReward
from interpreters.settings import CRITICS, GAMMA, CriticConfig

Array = NDArray[np.float32]
_CHECKED = 2_000
"""Most decisions of the validation split."""
_CHECKS, _WINDOWS = 4, 64
"""Validation batches, and windows in each."""
_TOGETHER = 2_048
"""Windows of swapped lexemes scored at a time, to bound memory."""

LEARNED_FROM = 0.7
"""Probability that a critic learns from a recording; on the same data the critics would agree in their errors."""
TRIED = 0.12
"""Share of the decisions in which other lexemes are substituted for the chosen one, to measure the effect on later
rewards."""


@dataclass(frozen=True)
class CounterfactualRewards:
    """Decisions of E concatenated episodes, n in all, with the reward of every lexeme.

    lengths, speaker: [E] number of decisions, and speaker; block, action, previous: [n]; silent: [n]; every: [n, S]
    rewards; log_prior: [n, S] log pi_b; swap: [n, k] lexemes substituted for the action, and gained: [n, k] the
    resulting change of later rewards, the first undiscounted, NaN if not tried; total: [n] the discounted sum of
    rewards from here on.
    """

    lengths: NDArray[np.int64]
    speaker: NDArray[np.int64]
    block: NDArray[np.int64]
    action: NDArray[np.int64]
    previous: NDArray[np.int64]
    silent: NDArray[np.bool_]
    every: Array
    log_prior: Array
    swap: NDArray[np.int64]
    gained: Array
    total: Array

    @property
    def unit(self) -> float:
        """The unit of values: standard deviation of rewards over lexemes, root mean square over states."""
        return max(float(np.sqrt(self.every.var(1).mean())), 1e-6)

    def windows(self, rng: np.random.Generator, count: int, decisions: int) -> dict[str, Tensor]:
        """`count` random windows of T decisions for `Critics.losses`, without audio. episode: [B]."""
        ends = np.cumsum(self.lengths)
        places = np.searchsorted(ends, rng.integers(ends[-1], size=count), side="right")
        # Windows start anywhere in an episode that leaves room; a shorter episode is padded.
        room = np.maximum(self.lengths[places] - decisions, 0)
        start = (ends[places] - self.lengths[places] + rng.integers(room + 1))
        at = start[:, None] + np.arange(decisions)
        valid = at < ends[places][:, None]
        at = np.minimum(at, ends[places][:, None] - 1)
        out = {name: torch.as_tensor(getattr(self, name)[at]) for name in (
            "block", "action", "previous", "silent", "every", "log_prior", "swap", "gained")}
        return {**out, "return": torch.as_tensor(self.total[at]), "valid": torch.as_tensor(valid.astype(np.float32)),
                "speaker": torch.as_tensor(self.speaker[places]), "episode": torch.as_tensor(places)}


def discounted(rewards: Array, gamma: float) -> Array:
    """[n] G_i = r_i + gamma G_{i+1}, zero after the last (RACER Eq. 1)."""
    out, after = np.empty(len(rewards), np.float32), 0.0
    for i in range(len(rewards) - 1, -1, -1):
        out[i] = after = float(rewards[i]) + gamma * after
    return out


@torch.no_grad()
def gains(table: EnsembleReward | Centred, actions: Tensor, blocks: Tensor, at: NDArray[np.int64],
          swap: NDArray[np.int64], gamma: float) -> Array:
    """[m, k] change of later rewards when decision `at` [m] takes lexeme `swap` [m, k], with all other actions [M] on
    blocks [M] unchanged: sum_j gamma^(j-1) (r'_{at+j} - r_{at+j}) for j up to the reward's window."""
    window, count = table.window, swap.shape[1]
    base = table.sequence(actions, blocks)
    out = np.zeros(swap.shape, np.float32)
    places = [(row, column, after) for row in range(len(at)) for column in range(count)
              for after in range(1, window) if at[row] + after < len(actions)]
    for begin in range(0, len(places), _TOGETHER):
        rows, columns, after = (torch.as_tensor(part) for part in np.array(places[begin:begin + _TOGETHER]).T)
        changed = torch.as_tensor(at)[rows]
        # A reward depends on a window of lexemes, so a swap changes those of the next `window` - 1 blocks.
        end = changed + after
        index = end[:, None] + torch.arange(1 - window, 1)
        lexemes = actions[index.clamp_min(0)]
        lexemes = torch.where(index == changed[:, None], torch.as_tensor(swap)[rows, columns][:, None], lexemes)
        more = table.rewards(lexemes, blocks[index.clamp_min(0)], index >= 0) - base[end]
        np.add.at(out, (rows.numpy(), columns.numpy()), (more * gamma ** (after - 1)).numpy())
    return out


def counterfactual(episodes: Sequence[Episode], table: EnsembleReward | Centred, prior: LstmInterpreter, corpus: Corpus,
                   config: CriticConfig, seed: int) -> CounterfactualRewards:
    """Counterfactual rewards of episodes in random order, up to `config.states` decisions. The prior sees the episode's
    own lexemes and the performer's motion."""
    columns: dict[str, list[NDArray]] = {field.name: [] for field in fields(CounterfactualRewards)}
    rng, left = np.random.default_rng(seed), config.states
    for number in rng.permutation(len(episodes)):
        episode = episodes[number]
        if left <= 0:
            break
        if len(episode.blocks) < 2:
            continue
        left -= len(episode.blocks) - 1
        actions, blocks = torch.as_tensor(episode.actions), torch.as_tensor(episode.blocks)
        log_prior = teacher_logits(prior, corpus, episode.blocks, episode.actions).log_softmax(-1).float().numpy()
        size = log_prior.shape[1]
        swap = rng.integers(size, size=(len(episode.blocks) - 1, config.swaps))
        half = config.swaps // 2
        noise = rng.gumbel(size=(len(swap), half, size))
        # Gumbel-max: half of the swaps are samples of the behaviour policy, the others uniform.
        swap[:, :half] = (log_prior[:, None] + noise).argmax(-1)
        gained = np.full(swap.shape, np.nan, np.float32)
        tried = np.flatnonzero(rng.random(len(swap)) < TRIED)
        gained[tried] = gains(table, actions, blocks, tried + 1, swap[tried], GAMMA)
        every = table.sequence_every(actions, blocks)[1:].float().numpy()
        # Rewards of the lexemes that were performed.
        earned = every[np.arange(len(every)), episode.actions[1:]]
        for name, value in (("lengths", np.array([len(every)])), ("speaker", np.array([episode.speaker])),
                            ("block", episode.blocks[1:]), ("action", episode.actions[1:]),
                            ("previous", episode.actions[:-1]), ("silent", episode.silent[1:]), ("every", every),
                            ("log_prior", log_prior), ("swap", swap), ("gained", gained),
                            ("total", discounted(earned, GAMMA))):
            columns[name].append(value)
    return CounterfactualRewards(**{name: np.concatenate(values) for name, values in columns.items()})


def _make(run: Run) -> CounterfactualRewards:
    return counterfactual(run.get(EPISODES).episodes, run.get(TAUGHT_REWARD), run.get(INTERPRETER), run.get(CORPUS),
                          run.config.advantage, run.seed(COUNTERFACTUALS))


def _needs(config: Config) -> Sequence[Node[Any]]:
    return CORPUS, TOKENS, LABELS, REWARD, EPISODES, INTERPRETER


COUNTERFACTUALS: Node[CounterfactualRewards] = Node(
    "counterfactuals", settings=("episodes.baseline", "reward", "advantage.states", "advantage.swaps"), needs=_needs,
    make=_make)
"""The rewards of all lexemes on the training split."""


def critic_batch(corpus: Corpus, windows: dict[str, Tensor], unit: float, trained_on: NDArray[np.float32]
                 ) -> dict[str, Tensor]:
    """Windows with the critics' inputs and rewards in units. trained_on: [E, J] 1 where critic j
    learns from episode e."""
    scaled = {key: windows[key] / unit for key in ("every", "gained", "return")}
    return {**windows, **scaled, "audio": corpus.high[windows["block"]].float(),
            "speaker": functional.one_hot(windows["speaker"], len(corpus.statistics.speakers)).float(),
            "heard": torch.as_tensor(trained_on)[windows["episode"]]}


def _task(run: Run, model: Critics) -> fitting.Task:
    config, corpus, data = run.config.advantage, run.get(CORPUS), run.get(COUNTERFACTUALS)
    unit = data.unit
    rng = np.random.default_rng(run.seed(ADVANTAGE))
    trained_on = (rng.random((len(data.lengths), CRITICS)) < LEARNED_FROM).astype(np.float32)
    # No episode is left to no critic.
    trained_on[trained_on.sum(1) == 0] = 1.0
    literal = recorded_episodes(run, "val", lambda lexemes, blocks: torch.zeros(len(lexemes)))
    held = counterfactual(literal.episodes, run.get(TAUGHT_REWARD), run.get(INTERPRETER), corpus,
                          CriticConfig(states=min(_CHECKED, config.states), swaps=config.swaps), 1)
    everything = np.ones((len(held.lengths), CRITICS), np.float32)
    checks = [critic_batch(corpus, held.windows(fitting.generator_for(4, i), _WINDOWS, config.decisions), unit,
                           everything) for i in range(_CHECKS)]
    model.scale_to(unit, torch.as_tensor(data.gained) / unit, torch.as_tensor(data.total) / unit)

    def validate(batches: list[fitting.Batch]) -> Figures:
        rows = [model.losses(batch) for batch in batches]
        return {key: float(torch.stack([row[key] for row in rows]).mean()) for key in rows[0]}

    return fitting.Task(lambda rng, size: critic_batch(corpus, data.windows(rng, size, config.decisions), unit,
                                                       trained_on), validate=checked(run, checks, validate))


ADVANTAGE: Stage[Critics] = Stage(
    "advantage", settings=("advantage", "silence.hint"), schedule="advantage", part="advantage",
    wanted=lambda config: config.schedules.cql.steps > 0 and config.schedules.advantage.steps > 0,
    needs=lambda config: (*_needs(config), COUNTERFACTUALS),
    build=lambda run: models.build("advantage", model_sizes(run)),
    train=_task)
