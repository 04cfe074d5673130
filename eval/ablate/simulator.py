"""Recorded speech as an environment for online learning (the ablations of RACER 5.5).

The speech does not react to gestures, so the dynamics are simple: the speech continues as recorded, the chosen lexeme
is appended to the history, and a reward model scores the trailing window. `Simulator.collect` acts in B episodes in
parallel, `Replay` stores them.
"""

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
        self.score, self.window = score, window
        self._lengths = np.array([len(take.blocks) for take in takes], dtype=np.int64)
        self._offsets = np.cumsum(self._lengths) - self._lengths
        self._blocks, self._lexemes, self._silent = (torch.as_tensor(np.concatenate(of)) for of in (
            [take.blocks.astype(np.int64) for take in takes], [take.lexemes.astype(np.int64) for take in takes],
            [take.silent.astype(np.bool_) for take in takes]))
        self._speakers = torch.tensor([take.speaker for take in takes], dtype=torch.int64)

    def collect(self, choose: Choose, rng: np.random.Generator, count: int, decisions: int) -> dict[str, Tensor]:
        """Act in `count` = B episodes of T decisions, at starts sampled like windows of the data."""
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
    """The newest `capacity` windows."""

    def __init__(self, capacity: int) -> None:
        self.capacity, self._store = capacity, dict[str, Tensor]()

    def add(self, windows: dict[str, Tensor]) -> None:
        """Store a batch of windows, each array [B, ...], in the layout of `Episodes.windows`."""
        # In order of time, so that what falls out is the oldest.
        self._store = {key: torch.cat([self._store.get(key, value[:0]), value])[-self.capacity:]
                       for key, value in windows.items()}

    def windows(self, rng: np.random.Generator, count: int) -> dict[str, Tensor]:
        """A batch of `count` random windows, with repetition."""
        rows = torch.as_tensor(rng.integers(len(self._store["block"]), size=count))
        return {key: value[rows] for key, value in self._store.items()}
