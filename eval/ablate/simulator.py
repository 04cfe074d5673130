"""Recorded speech as an environment for online learning (the ablations of RACER 5.5).

The speech does not react to gestures, so the dynamics are simple: the speech continues as recorded, the chosen lexeme
is appended to the history, and a reward model scores the trailing window. `Simulator.collect` acts in B episodes in
parallel, `Replay` stores them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from interpreters.episodes import BEHAVIOURS, Demonstration, draw_starts

Score = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Lexemes, block numbers and validity of trailing windows, each [B, W], to rewards [B]: `RewardTable.rewards`."""
Choose = Callable[[dict[str, Tensor]], Tensor]
"""The observations since the start of the episode (block, previous, silent: [B, t + 1]; speaker: [B]) to lexemes [B].
"""


class Simulator:
    """Episodes that begin anywhere in a recording, after recorded lexemes."""

    def __init__(self, takes: Sequence[Demonstration], score: Score, window: int) -> None:
        """takes: the recordings; score: the reward of a trailing window of `window` = W blocks. As in the offline data,
        the first windows of an episode contain recorded lexemes from before its start."""
        if window < 1 or max((len(take.blocks) for take in takes), default=0) < 2:
            raise ValueError("a simulator needs a window of one block and a recording of two at least")
        self.score, self.window = score, window
        self._lengths = np.array([len(take.blocks) for take in takes], dtype=np.int64)
        self._offsets = np.cumsum(self._lengths) - self._lengths
        self._blocks, self._lexemes, self._silent = (torch.as_tensor(np.concatenate(of)) for of in (
            [take.blocks.astype(np.int64) for take in takes], [take.lexemes.astype(np.int64) for take in takes],
            [take.silent.astype(np.bool_) for take in takes]))
        self._speakers = torch.tensor([take.speaker for take in takes], dtype=torch.int64)

    def collect(self, choose: Choose, rng: np.random.Generator, count: int, decisions: int) -> dict[str, Tensor]:
        """Act in `count` = B episodes of T decisions, at starts sampled like windows of the data."""
        if count < 1 or decisions < 1:
            raise ValueError("an episode needs a decision, and a batch an episode")
        return self.act(choose, *draw_starts(rng, self._lengths, count, decisions), decisions)

    @torch.no_grad()
    def act(self, choose: Choose, take: np.ndarray, start: np.ndarray, decisions: int) -> dict[str, Tensor]:
        """Act from given starts: takes [B], and the position [B] in each of the block whose true lexeme is a_0.

        A batch with the layout of `Episodes.windows`, [B, T + 1]. The last position is the observation after the last
        decision, with lexeme 0 as its action: an episode that the horizon ends has a future, whose value is
        bootstrapped; the end of a recording is terminal, and has none. What follows it repeats its last observation.
        The behaviour is "sampled", and no action counts in CQL's data term, which is for those of people.
        """
        offset, last = (torch.as_tensor(values[take])[:, None] for values in (self._offsets, self._lengths - 1))
        # Speech goes on whatever is done, so all but lexemes and rewards is known beforehand. The history begins W
        # blocks before the first decision: the first rewards then look back as far as any.
        past = torch.as_tensor(start)[:, None] + torch.arange(1 - self.window, decisions + 2)
        if bool((past[:, self.window] > last[:, 0]).any()) or bool((past[:, self.window] < 1).any()):
            raise ValueError("an episode must begin before the last block of its recording")
        known, rows = past >= 0, offset + past.clamp_min(0).minimum(last)
        lexemes, blocks = self._lexemes[rows], self._blocks[rows]
        # Column W is the first decision; the columns before it are what was recorded.
        at = past[:, self.window:]
        valid = at <= last
        terminal = (at == last) & (torch.arange(decisions + 1) < decisions)
        block, silent, speaker = blocks[:, self.window:], self._silent[rows[:, self.window:]], self._speakers[take]
        previous, action = (torch.zeros(len(take), decisions + 1, dtype=torch.int64) for _ in range(2))
        reward = torch.zeros(len(take), decisions + 1)
        previous[:, 0] = lexemes[:, self.window - 1]
        for t in range(decisions):
            if not bool(valid[:, t].any()):
                previous[:, t + 1] = previous[:, t]
                continue
            action[:, t] = choose({"block": block[:, :t + 1], "previous": previous[:, :t + 1],
                                   "silent": silent[:, :t + 1], "speaker": speaker}).to(torch.int64)
            lexemes[:, self.window + t] = action[:, t]
            # The window that ends on the lexeme just chosen.
            there = slice(t + 1, t + 1 + self.window)
            reward[:, t] = self.score(lexemes[:, there], blocks[:, there], known[:, there]) * valid[:, t]
            previous[:, t + 1] = torch.where(valid[:, t], action[:, t], previous[:, t])
        counted = valid.to(torch.float32)
        return {"block": block, "previous": previous, "silent": silent, "valid": counted, "action": action,
                "reward": reward, "terminal": terminal, "speaker": speaker, "cloned": torch.zeros_like(counted),
                "behaviour": torch.full_like(action, BEHAVIOURS.index("sampled"))}


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
