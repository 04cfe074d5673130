"""Recorded speech as an environment for online learning (the ablations of RACER 5.5).

The speech does not react to gestures, so the dynamics are simple: the speech continues as recorded, the chosen lexeme
is appended to the history, and a reward model scores the trailing window. `Simulator` runs B recordings in parallel,
`collect` acts in it, `Replay` stores the episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from interpreters.episodes import BEHAVIOURS, Demonstration, draw_starts

Score = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Lexemes, block numbers and validity of trailing windows, each [B, W], to rewards [B]: `RewardTable.rewards`."""


@dataclass(frozen=True)
class Observation:
    """The observation before a decision in each of B recordings. All are [B]. block: number of the current block, from
    which its speech is looked up; previous: the previous lexeme; silent: the block is silent; speaker: index; live: the
    episode is not over."""

    block: Tensor
    previous: Tensor
    silent: Tensor
    speaker: Tensor
    live: Tensor


class Simulator:
    """B recordings in parallel. An episode begins anywhere in a recording, after recorded lexemes."""

    def __init__(self, takes: Sequence[Demonstration], score: Score, window: int) -> None:
        """takes: the recordings; score: the reward of a trailing window of `window` = W blocks. As in the offline data,
        the first windows of an episode contain recorded lexemes from before its start."""
        if window < 1 or max((len(take.blocks) for take in takes), default=0) < 2:
            raise ValueError("a simulator needs a window of one block and a recording of two at least")
        self.score, self.window = score, window
        self._lengths = np.array([len(take.blocks) for take in takes], dtype=np.int64)
        self._offsets = torch.as_tensor(np.cumsum(self._lengths) - self._lengths)
        self._blocks = torch.as_tensor(np.concatenate([take.blocks for take in takes]).astype(np.int64))
        self._lexemes = torch.as_tensor(np.concatenate([take.lexemes for take in takes]).astype(np.int64))
        self._silent = torch.as_tensor(np.concatenate([take.silent for take in takes]).astype(np.bool_))
        self._speakers = torch.tensor([take.speaker for take in takes], dtype=torch.int64)

    def reset(self, rng: np.random.Generator, count: int, horizon: int) -> Observation:
        """Begin `count` = B episodes of at most `horizon` decisions, at starts sampled like windows of the data."""
        if count < 1 or horizon < 1:
            raise ValueError("an episode needs a decision, and a batch an episode")
        return self.begin(*draw_starts(rng, self._lengths, count, horizon), horizon)

    def begin(self, take: NDArray[np.int64], start: NDArray[np.int64], horizon: int) -> Observation:
        """Begin at given starts: takes [B], and the position [B] in each of the block whose true lexeme is a_0."""
        which = torch.as_tensor(take)
        self._offset, self._speaker, self._at = self._offsets[which], self._speakers[which], torch.as_tensor(start) + 1
        self._last = torch.as_tensor(self._lengths)[which] - 1
        if bool((self._at > self._last).any()) or bool((self._at < 1).any()):
            raise ValueError("an episode must begin before the last block of its recording")
        self._horizon, self._done = horizon, 0
        self._live = torch.ones(len(which), dtype=torch.bool)
        # Recorded lexemes from before the start: the first rewards then look back as far as any.
        past = self._at[:, None] + torch.arange(-self.window, 0)
        self._valid = past >= 0
        rows = self._offset[:, None] + past.clamp_min(0)
        self._past_lexemes, self._past_blocks = self._lexemes[rows], self._blocks[rows]
        return self._observe()

    def step(self, actions: Tensor) -> tuple[Observation, Tensor, Tensor]:
        """Take actions [B]: the next observation, rewards [B] float32 and terminal [B]: it was the last block of the
        recording. Where the horizon was reached first, the next observation is for bootstrapping. An episode that is
        over does not change, has reward 0 and does not end again."""
        if not bool(self._live.any()):
            raise ValueError("every episode is over: reset first")
        live = self._live
        block = self._blocks[self._offset + self._at]
        self._past_lexemes = _shifted(self._past_lexemes, actions.to(torch.int64), live)
        self._past_blocks = _shifted(self._past_blocks, block, live)
        self._valid = _shifted(self._valid, torch.ones_like(live), live)
        reward = self.score(self._past_lexemes, self._past_blocks, self._valid).to(torch.float32) * live
        self._done += 1
        terminal = live & (self._at == self._last)
        # An episode that the horizon ends has a future, whose value is bootstrapped; the end of a recording has none.
        truncated = live & ~terminal & (self._done == self._horizon)
        self._at = torch.where(live & ~terminal, self._at + 1, self._at)
        self._live = live & ~terminal & ~truncated
        return self._observe(), reward, terminal

    def _observe(self) -> Observation:
        here = self._offset + self._at
        return Observation(self._blocks[here], self._past_lexemes[:, -1], self._silent[here], self._speaker, self._live)


def _shifted(window: Tensor, newest: Tensor, live: Tensor) -> Tensor:
    return torch.where(live[:, None], torch.cat([window[:, 1:], newest[:, None]], dim=1), window)


Choose = Callable[[dict[str, Tensor]], Tensor]
"""The observations since the start of the episode (block, previous, silent: [B, t + 1]; speaker: [B]) to lexemes [B].
"""


@torch.no_grad()
def collect(simulator: Simulator, choose: Choose, rng: np.random.Generator, count: int, decisions: int
            ) -> dict[str, Tensor]:
    """Act in `count` episodes of T decisions: a batch with the layout of `Episodes.windows`. The last position, T, is
    the observation after the last decision, with lexeme 0 as its action. The behaviour is "sampled", and no action
    counts in CQL's data term, which is for those of people."""
    now = simulator.reset(rng, count, decisions)
    columns: dict[str, list[Tensor]] = {key: [] for key in ("block", "previous", "silent", "valid", "action", "reward",
                                                            "terminal")}
    over = torch.zeros(count, dtype=torch.bool)
    for position in range(decisions + 1):
        for key, value in (("block", now.block), ("previous", now.previous), ("silent", now.silent),
                           ("valid", ~over)):
            columns[key].append(value)
        action, reward = torch.zeros(count, dtype=torch.int64), torch.zeros(count)
        terminal = torch.zeros(count, dtype=torch.bool)
        if bool(now.live.any()) and position < decisions:
            so_far = {key: torch.stack(columns[key], 1) for key in ("block", "previous", "silent")}
            action = choose({**so_far, "speaker": now.speaker}).to(torch.int64)
            now, reward, terminal = simulator.step(action)
        over = over | terminal
        for key, value in (("action", action), ("reward", reward), ("terminal", terminal)):
            columns[key].append(value)
    batch = {key: torch.stack(values, 1) for key, values in columns.items()}
    valid = batch["valid"].to(torch.float32)
    return {**batch, "valid": valid, "speaker": now.speaker, "cloned": torch.zeros_like(valid),
            "behaviour": torch.full_like(batch["action"], BEHAVIOURS.index("sampled"))}


class Replay:
    """A ring buffer of windows."""

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError("a replay buffer needs room for at least one window")
        self.capacity, self._count, self._next = capacity, 0, 0
        self._store: dict[str, Tensor] = {}

    def __len__(self) -> int:
        return self._count

    def add(self, windows: dict[str, Tensor]) -> None:
        """Store a batch of windows, each array [B, ...], in the layout of `Episodes.windows`; ValueError for another
        layout than before."""
        if not self._store:
            self._store = {key: value.new_zeros(self.capacity, *value.shape[1:]) for key, value in windows.items()}
        layout = {key: (value.dtype, value.shape[1:]) for key, value in windows.items()}
        if layout != {key: (value.dtype, value.shape[1:]) for key, value in self._store.items()}:
            raise ValueError("these windows have another layout than those before")
        count = len(windows["block"])
        first = max(0, count - self.capacity)  # the newest, if there are too many
        rows = (self._next + torch.arange(first, count)) % self.capacity
        for key, value in windows.items():
            self._store[key][rows] = value[first:].to(self._store[key].device)
        self._next = (self._next + count) % self.capacity
        self._count = min(self._count + count, self.capacity)

    def windows(self, rng: np.random.Generator, count: int) -> dict[str, Tensor]:
        """A batch of `count` random windows, with repetition; ValueError while the buffer is empty."""
        if self._count == 0:
            raise ValueError("the replay buffer is empty")
        rows = torch.as_tensor(rng.integers(self._count, size=count))
        return {key: value[rows] for key, value in self._store.items()}
