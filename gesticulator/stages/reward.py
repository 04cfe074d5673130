"""The reward models E_m and E_u (RACER 4.2), and the rewards that a policy is taught."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from gesticulator import fit as fitting
from gesticulator import models
from gesticulator.config import RewardConfig
from gesticulator.stages.base import Figures, Run, Stage
from gesticulator.stages.corpus import Corpus
from gesticulator.stages.features import CORPUS
from gesticulator.stages.labels import LABELS, model_sizes
from gesticulator.stages.lexicon import TOKENS, Tokens, decoded_blocks
from interpreters.episodes import Reward, distance_rewards, looked_up
from interpreters.reward import Centred, RewardModel, RewardTable
from lexicon.racer import RacerCodec

_TOGETHER = 8
"""Windows of one recording in a batch of the reward model: rivals of the same voice, so that the hour and not the
speaker has to be told."""
_CHECKS, _WINDOWS = 4, 128
"""Validation batches, and windows in each."""


def block_audio(corpus: Corpus) -> Tensor:
    """[N, K, d] both levels of audio on the block itself; the log duration comes last."""
    frames = corpus.motion.shape[1]
    low = corpus.low[:, frames:2 * frames]
    if corpus.high is corpus.low:
        return low
    return torch.cat([low[..., :-1], corpus.high[:, frames:2 * frames]], dim=-1)


def reward_table(model: RewardModel, tokens: Tokens, corpus: Corpus) -> RewardTable:
    """A reward model over this lexicon and this corpus, ready to be asked."""
    audio, durations = block_audio(corpus).float(), torch.as_tensor(np.log(corpus.durations)).float()
    if not isinstance(tokens, RacerCodec):
        return RewardTable(model, audio, durations, tokens.shown())
    return RewardTable(model, audio, durations, decode=tokens.decode_tokens, size=len(tokens.vectors))


@dataclass(frozen=True)
class RewardWindows:
    """Windows of motion and the audio that goes with them, of any length, for the contrastive loss.

    A batch would be easy if each window came from another speaker; so it holds eight windows of each of its recordings.
    shown: [N, K, D_m] the blocks as the lexicon shows them. labels: [N]. lexemes: [S, K, D_m] and after: [S, S] the
    transition matrix, from which rivals are made: windows whose last lexemes are replaced, half of them by lexemes that
    often follow, so that it takes ears to tell; None makes no rivals.
    """

    corpus: Corpus
    audio: Tensor
    shown: Tensor
    recordings: Sequence[int]
    config: RewardConfig
    labels: NDArray[np.int64]
    lexemes: Tensor | None = None
    after: NDArray[np.float64] | None = None

    def sample(self, rng: np.random.Generator, count: int, decoded: float | None = None) -> fitting.Batch:
        """A batch of `count` windows, as `RewardModel.losses` takes it; `decoded` of them show lexemes."""
        config = self.config
        chosen = rng.choice(self.recordings, size=-(-count // _TOGETHER))
        owners = np.repeat(chosen, _TOGETHER)[:count]
        blocks, valid = np.zeros((count, config.longest), np.int64), np.zeros((count, config.longest), np.float32)
        for row, recording in enumerate(owners):
            own = self.corpus.blocks_of(int(recording))
            length = min(int(rng.integers(config.shortest, config.longest + 1)), len(own))
            start = int(rng.integers(len(own) - length + 1))
            blocks[row] = own[start]
            blocks[row, -length:] = own[start:start + length]
            valid[row, -length:] = 1
        share = config.decoded if decoded is None else decoded
        batch = self.batch(blocks, valid, rng.random(count) < share)
        if self.lexemes is not None and config.rivals:
            batch["rival"] = self.rivals(blocks, valid, rng)
        return batch

    def batch(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], decoded: NDArray[np.bool_]) -> fitting.Batch:
        """The windows of blocks [B, W], right-aligned; those marked `decoded` [B] show lexemes instead of capture."""
        at, shows = torch.as_tensor(blocks), torch.as_tensor(decoded)
        motion = torch.where(shows[:, None, None, None], self.shown[at], self.corpus.motion[at])
        return {"motion": motion, "audio": self.audio[at].float(), "valid": torch.as_tensor(valid),
                "log_duration": torch.as_tensor(np.log(self.corpus.durations[blocks])).float(),
                "group": torch.as_tensor(groups(blocks, valid, self.corpus.silent[blocks])), "rivalled": shows}

    def rivals(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], rng: np.random.Generator) -> Tensor:
        """[B, H, W, K, D_m] the decoded windows with one to half of their last lexemes replaced by others."""
        assert self.lexemes is not None and self.after is not None
        size, count = len(self.lexemes), self.config.rivals
        lexemes = np.repeat(self.labels[blocks][:, None], count, axis=1)
        cumulated = self.after.cumsum(axis=1)
        for row, length in enumerate(valid.sum(1).astype(int)):
            for rival in range(count):
                replaced = int(rng.integers(1, max(1, length // 2) + 1))
                likely = rng.random() < 0.5
                for at in range(-replaced, 0):
                    own, other = int(lexemes[row, rival, at]), int(rng.integers(size))
                    if likely and length > -at:
                        row_of = cumulated[lexemes[row, rival, at - 1]]
                        other = int(np.searchsorted(row_of, rng.random() * row_of[-1]))
                    if at == -1 and other == own:  # nothing else may be wrong
                        other = (own + 1 + int(rng.integers(size - 1))) % size
                    lexemes[row, rival, at] = other
        return self.lexemes[torch.as_tensor(lexemes)]


def groups(blocks: NDArray[np.int64], valid: NDArray[np.float32], silent: NDArray[np.bool_]) -> NDArray[np.int64]:
    """[B] alike for windows [B, W] that share a block (or are joined by one that does), and for all that are silent.

    Such windows suit each other's audio and must not count as each other's negatives.
    """
    last = blocks[:, -1]
    first = last - valid.sum(1).astype(np.int64) + 1
    out = np.empty(len(blocks), dtype=np.int64)
    group, end = 0, -1
    for row in np.argsort(first, kind="stable"):
        if first[row] > end:
            group += 1
        end = max(end, int(last[row]))
        out[row] = group
    out[(silent | (valid == 0)).all(axis=1)] = 0
    return out


def _train(run: Run, model: RewardModel, folder: Path, stage: Stage[RewardModel], judge: bool) -> Figures:
    config, corpus, labelled, tokens = run.config, run.get(CORPUS), run.get(LABELS), run.get(TOKENS)
    audio, shown = block_audio(corpus), decoded_blocks(tokens, labelled.labels, corpus)
    known, held = corpus.recordings("train"), corpus.recordings("val")
    half = known[int(judge)::2] or known
    lexemes = None if isinstance(tokens, RacerCodec) else tokens.shown()

    def of(recordings: Sequence[int]) -> RewardWindows:
        return RewardWindows(corpus, audio, shown, recordings, config.reward, labelled.labels, lexemes,
                             labelled.inventory.transitions)

    windows, check = of(half), of(held or half)
    checks = [check.sample(fitting.generator_for(2, i), _WINDOWS, 1.0) for i in range(_CHECKS)]

    @torch.no_grad()
    def validate() -> Figures:
        batches = [{key: value.to(run.device) for key, value in b.items()} for b in checks]
        found = [{**model.retrieval(b), **({"right_one": model.right_one(b)} if "rival" in b else {})}
                 for b in batches]
        return {"contrast": sum(float(model.losses(b)["contrast"]) for b in batches) / len(batches),
                **{key: float(np.mean([f[key] for f in found])) for key in found[0]}}

    task = fitting.Task(lambda rng: windows.sample(rng, run.schedule(stage).batch), validate=validate)
    return run.fit(stage, model, task, folder)


def _reward_stage(name: str, judge: bool) -> Stage[RewardModel]:
    def train(run: Run, model: RewardModel, folder: Path) -> Figures:
        return _train(run, model, folder, REWARD_JUDGE if judge else REWARD, judge)

    return Stage(name, settings=("reward", "silence.hint"), needs=lambda config: (CORPUS, TOKENS, LABELS),
                 schedule="reward",
                 wanted=lambda config: config.schedules.cql.steps > 0, part=name, train=train,
                 build=lambda run: models.reward(model_sizes(run)))


REWARD = _reward_stage("reward", False)
REWARD_JUDGE = _reward_stage("reward_judge", True)
"""A second model of another seed that hears the other half of the recordings: what a policy learned to please must not
be what it is judged by."""


def taught_reward(table: RewardTable, corpus: Corpus, draws: int) -> RewardTable | Centred:
    """The reward as a policy is taught it: told from what random lexemes earn on the same audio, or as it is (0)."""
    if not draws:
        return table
    recordings = [torch.as_tensor(corpus.blocks_of(r)) for r in range(len(corpus.names))]
    return Centred(table, recordings, draws)


def step_reward(run: Run) -> Reward:
    """What a step earns, by the settings: the contrastive reward, or the distance to the recording (RACER 5.5)."""
    corpus, tokens, episodes = run.get(CORPUS), run.get(TOKENS), run.config.episodes
    if episodes.reward == "contrastive":
        return taught_reward(reward_table(run.get(REWARD), tokens, corpus), corpus, episodes.baseline).sequence
    if isinstance(tokens, RacerCodec):
        raise InputError("episodes.reward=distance", "is of lexemes that are decoded one by one",
                         "use it over a lexicon, not with tokens=racer")
    return looked_up(distance_rewards(tokens.shown(), corpus.motion))
