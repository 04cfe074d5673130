"""The reward models E_m and E_u (RACER 4.2), and the rewards for training policies."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.motion.movement import Pasts
from gesticulator.bundle import models
from gesticulator.bundle.config import RewardConfig
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage, checked
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.lexicon import LABELS, TOKENS, Tokens, decoded_blocks, model_sizes, token_labels
from gesticulator.training.stages.speech import CORPUS
from interpreters.episodes import Reward, distance_rewards, looked_up
from interpreters.reward import RewardEnsemble, RewardModel
from interpreters.reward_table import Centred, EnsembleReward, RewardTable
from lexicon.movement import MovementLexicon
from lexicon.racer import RacerCodec

_TOGETHER = 8
"""Windows per recording in a batch of the reward model: negatives of the same voice, so that it must recognise the time
and not the speaker."""
_CHECKS, _WINDOWS = 4, 128
"""Validation batches, and windows in each."""
_AT_ONCE = 4096
"""Blocks decoded at a time, to bound memory."""
_SHORTEST = 2
"""Blocks of the shortest training window, for the first blocks of a recording."""
_DECODED = 0.5
"""Share of the motion blocks in training that are decoded from the lexicon instead of captured. The policy's motion is
always decoded; without decoded motion in training the reward would detect decoding artefacts."""
_LEAST_ODDS = 1e-3
"""Added to the odds of every lexeme, so that pairs absent from the training split remain possible."""


def block_audio(corpus: Corpus) -> Tensor:
    """[N, K, d] both audio levels of the block itself, with the log duration last."""
    frames = corpus.motion.shape[1]
    low = corpus.low[:, frames:2 * frames]
    if corpus.high is corpus.low:
        return low
    return torch.cat([low[..., :-1], corpus.high[:, frames:2 * frames]], dim=-1)


@torch.no_grad()
def added_by(lexicon: MovementLexicon) -> Tensor:
    """[S, K, D_m] the motion that each lexeme adds to the prediction from the past."""
    return lexicon.basis.expand(lexicon.added(torch.arange(lexicon.size)))


class MovementContext:
    """A lexicon of movements decoded in context, as played. Implements `Bases` of `interpreters.reward_table`.

    A block is the sum of the prediction from its past, its lexeme, and the residual of the performer's block, which is
    used for any lexeme on that block. So the performer's lexemes reproduce the captured motion, and a changed lexeme
    gives a movement with the same detail and affects all later blocks of the window.
    """

    def __init__(self, lexicon: MovementLexicon, corpus: Corpus, labels: NDArray[np.int64] | None) -> None:
        """labels: [N] the lexeme of every block; None leaves the residuals out, so that nothing in a window but its
        lexemes tells which the performer had."""
        self.basis, self.pasts = lexicon.basis, corpus.pasts
        self.added = added_by(lexicon)
        self.manner: Tensor | None = None
        if labels is None:
            return
        with torch.no_grad():
            parts = torch.arange(len(labels)).split(_AT_ONCE)
            self.manner = torch.cat([(corpus.motion[part] - lexicon.basis.base(self.pasts[part])
                                      - self.added[torch.as_tensor(labels)[part]]).half() for part in parts])
            """[N, K, D_m] the residuals, in half precision to save memory."""

    @torch.no_grad()
    def __call__(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B, W, K, D_m] each block of windows [B, W] without the contribution of its lexeme. The first block of a
        window continues from the performer's past."""
        out: list[Tensor] = []
        for i in range(blocks.shape[1]):
            frames = self.pasts.frames[blocks[:, i]]
            if out:
                before = (out[-1] + self.added[lexemes[:, i - 1]])[:, -frames.shape[1]:]
                frames = torch.where(valid[:, i - 1].bool()[:, None, None], before, frames)
            # Predicted from the motion shown so far, as in playback.
            base = self.basis.base(Pasts(frames, self.pasts.ratio[blocks[:, i]]))
            out.append(base if self.manner is None else base + self.manner[blocks[:, i]].float())
        return torch.stack(out, 1)

    def shown(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B, W, K, D_m] the motion of lexemes [B, W] on blocks [B, W]."""
        return self(lexemes, blocks, valid) + self.added[lexemes]


def context_of(tokens: Tokens, corpus: Corpus) -> MovementContext | None:
    """The decoding context of a lexicon of movements; None for another lexicon."""
    if not isinstance(tokens, MovementLexicon):
        return None
    return MovementContext(tokens, corpus, token_labels(tokens, corpus))


def reward_table(model: RewardModel | RewardEnsemble, tokens: Tokens, corpus: Corpus, *, literal: bool = False,
                 context: MovementContext | None = None) -> EnsembleReward:
    """A reward model prepared for this lexicon and corpus. Movements are decoded in context.

    literal: the paper's cosine, averaged over members, without caution. context: a precomputed `context_of`.
    """
    audio = block_audio(corpus).float()
    # The three kinds of lexicon differ in how lexemes become motion.
    how: dict[str, Any] = {"centred": model.config.centred and not literal}
    context = context or context_of(tokens, corpus)
    if isinstance(tokens, RacerCodec):
        how |= {"decode": (tokens.decode_tokens, len(tokens.vectors))}
    elif context is not None:
        how |= {"decoded": context.added, "bases": context}
    else:
        how |= {"decoded": tokens.shown()}
    return EnsembleReward([RewardTable(member, audio, **how) for member in model.models],
                          0.0 if literal else model.config.caution)


@dataclass(frozen=True)
class RewardWindows:
    """Windows of motion and audio, of any length, for the contrastive loss.

    A batch with a different speaker in each window would be easy, so it holds eight windows per recording.
    shown: [N, K, D_m] the blocks as decoded by the lexicon. labels: [N]. lexemes: [S, K, D_m] and after: [S, S]
    transition matrix, for generating rivals: windows whose last lexemes are replaced, half of them by frequent
    successors, so that audio is needed to tell them apart; None generates no rivals. added: [S, K, D_m] contribution of
    each lexeme of a lexicon of movements (`MovementContext`), for identifying the last one.
    """

    corpus: Corpus
    audio: Tensor
    shown: Tensor
    recordings: Sequence[int]
    config: RewardConfig
    labels: NDArray[np.int64]
    lexemes: Tensor | None = None
    after: NDArray[np.float64] | None = None
    added: Tensor | None = None

    def sample(self, rng: np.random.Generator, count: int, decoded: float = _DECODED) -> fitting.Batch:
        """A batch of `count` windows for `RewardModel.losses`, a share `decoded` of them decoded from lexemes."""
        config = self.config
        blocks, valid = drawn_windows(self.corpus, self.recordings, config, rng, count)
        batch = self.batch(blocks, valid, rng.random(count) < decoded)
        if self.lexemes is not None and config.rivals:
            batch["rival"] = self.lexemes[torch.as_tensor(self.rivals(blocks, valid, rng))]
        if config.choice:
            batch |= self.choice(blocks, batch["motion"])
        return batch

    def choice(self, blocks: NDArray[np.int64], motion: Tensor) -> fitting.Batch:
        """The last lexemes [B] of windows [B, W], the log odds [B, S] given the ones before, the contribution of every
        lexeme, and the last blocks of the windows' motion [B, W, K, D_m] without theirs."""
        assert self.after is not None and self.added is not None
        last = torch.as_tensor(self.labels[blocks[:, -1]])
        # Behaviour prior of the last lexeme: its transition from the one before.
        odds = self.after[self.labels[blocks[:, -2]]] + _LEAST_ODDS
        return {"last": last, "lexemes": self.added, "base": motion[:, -1] - self.added[last],
                "prior": torch.as_tensor(np.log(odds / odds.sum(1, keepdims=True))).float()}

    def batch(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], decoded: NDArray[np.bool_]) -> fitting.Batch:
        """The windows of blocks [B, W], right-aligned; those marked `decoded` [B] are decoded from lexemes."""
        at, shows = torch.as_tensor(blocks), torch.as_tensor(decoded)
        motion = torch.where(shows[:, None, None, None], self.shown[at], self.corpus.motion[at])
        return {"motion": motion, "audio": self.audio[at].float(), "valid": torch.as_tensor(valid),
                "group": torch.as_tensor(groups(blocks, valid, self.corpus.silent[blocks])), "rivalled": shows}

    def rivals(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], rng: np.random.Generator
               ) -> NDArray[np.int64]:
        """[B, H, W] lexemes of windows with one to half of the last ones replaced."""
        assert self.lexemes is not None and self.after is not None
        size, count = len(self.lexemes), self.config.rivals
        lexemes = np.repeat(self.labels[blocks][:, None], count, axis=1)
        cumulated = self.after.cumsum(axis=1)
        for row, length in enumerate(valid.sum(1).astype(int)):
            for rival in range(count):
                replaced = int(rng.integers(1, max(1, length // 2) + 1))
                likely = rng.random() < 0.5
                for at in range(-replaced, 0):
                    current, other = int(lexemes[row, rival, at]), int(rng.integers(size))
                    if likely and length > -at:
                        # Inverse transform sampling from the transition probabilities.
                        row_of = cumulated[lexemes[row, rival, at - 1]]
                        other = int(np.searchsorted(row_of, rng.random() * row_of[-1]))
                    if at == -1 and other == current:  # the last lexeme must differ
                        other = (current + 1 + int(rng.integers(size - 1))) % size
                    lexemes[row, rival, at] = other
        return lexemes


def drawn_windows(corpus: Corpus, recordings: Sequence[int], config: RewardConfig, rng: np.random.Generator, count: int
                  ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """`count` windows of blocks [count, W], right-aligned, and which of them are valid; eight of each recording, so
    that a batch cannot be told apart by voices. Recordings are drawn by their number of blocks."""
    first, last = (np.searchsorted(corpus.recording, recordings, side) for side in ("left", "right"))
    chosen = rng.choice(recordings, size=-(-count // _TOGETHER), p=(last - first) / (last - first).sum())
    owners = np.repeat(chosen, _TOGETHER)[:count]
    blocks, valid = np.zeros((count, config.longest), np.int64), np.zeros((count, config.longest), np.float32)
    for row, recording in enumerate(owners):
        blocks_of = corpus.blocks_of(int(recording))
        length = min(int(rng.integers(_SHORTEST, config.longest + 1)), len(blocks_of))
        start = int(rng.integers(len(blocks_of) - length + 1))
        blocks[row] = blocks_of[start]
        blocks[row, -length:] = blocks_of[start:start + length]
        valid[row, -length:] = 1
    return blocks, valid


def groups(blocks: NDArray[np.int64], valid: NDArray[np.float32], silent: NDArray[np.bool_]) -> NDArray[np.int64]:
    """[B] group numbers: equal for windows [B, W] connected by shared blocks, and for all silent ones. Such windows
    match each other's audio and must not be used as negatives of each other."""
    last = blocks[:, -1]
    first = last - valid.sum(1).astype(np.int64) + 1
    out = np.empty(len(blocks), dtype=np.int64)
    group, end = 0, -1
    # Sweep over the windows by their first block: one that starts within the group so far joins it.
    for row in np.argsort(first, kind="stable"):
        if first[row] > end:
            group += 1
        end = max(end, int(last[row]))
        out[row] = group
    # Silent windows all sound alike, whatever their place.
    out[(silent | (valid == 0)).all(axis=1)] = 0
    return out


def _task(run: Run, model: RewardEnsemble, fold: int) -> fitting.Task:
    config, corpus, labelled, tokens = model.config, run.get(CORPUS), run.get(LABELS), run.get(TOKENS)
    movements = isinstance(tokens, MovementLexicon)
    audio = block_audio(corpus)
    # Movements in context with their residuals are the captured motion itself.
    shown = corpus.motion if movements else decoded_blocks(tokens, labelled.labels, corpus)
    known, held = corpus.recordings("train"), corpus.recordings("val")
    # Every second recording; a single one serves both models.
    half = known[fold::2] or known
    lexemes = None if isinstance(tokens, RacerCodec) or movements else tokens.shown()
    added = added_by(tokens) if isinstance(tokens, MovementLexicon) else None

    def of(recordings: Sequence[int]) -> RewardWindows:
        return RewardWindows(corpus, audio, shown, recordings, config, labelled.labels, lexemes,
                             labelled.inventory.transitions, added)

    windows, check = of(half), of(held or half)
    checks = [check.sample(fitting.generator_for(2, i), _WINDOWS, 1.0) for i in range(_CHECKS)]

    def validate(batches: list[fitting.Batch]) -> Figures:
        figures = [model.figures(batch) for batch in batches]
        return {key: float(np.mean([f[key] for f in figures])) for key in figures[0]}

    return fitting.Task(windows.sample, validate=checked(run, checks, validate), before_step=model.before_step)


def _reward_stage(name: str, settings: str, fold: int) -> Stage[RewardEnsemble]:
    return Stage(name, settings=(settings, "silence.hint"), needs=lambda config: (CORPUS, TOKENS, LABELS),
                 schedule="reward", wanted=lambda config: config.schedules.cql.steps > 0,
                 build=lambda run: models.reward(model_sizes(run), getattr(run.config, settings)),
                 train=lambda run, model: _task(run, model, fold))


REWARD = _reward_stage("reward", "reward", 0)
REWARD_JUDGE = _reward_stage("reward_judge", "judge", 1)
"""A second model with another seed, trained on the other half of the recordings, so that policies are not evaluated by
the model they were trained with."""


def taught_reward(table: EnsembleReward, corpus: Corpus, draws: int) -> EnsembleReward | Centred:
    """The reward for training a policy: relative to random lexemes on the same audio (`draws` of them), or absolute
    (0)."""
    if not draws:
        return table
    recordings = [torch.as_tensor(corpus.blocks_of(r)) for r in range(len(corpus.names))]
    return Centred(table, recordings, draws)


TAUGHT_REWARD: Node[EnsembleReward | Centred] = Node(
    "taught_reward", settings=("episodes.baseline",), needs=lambda config: (CORPUS, TOKENS, REWARD),
    make=lambda run: taught_reward(reward_table(run.get(REWARD), run.get(TOKENS), run.get(CORPUS)), run.get(CORPUS),
                                   run.config.episodes.baseline))
"""The reward for training policies, computed once per run because its baseline takes minutes."""


def step_reward(run: Run) -> Reward:
    """The reward of a step: contrastive, or the distance to the recording (RACER 5.5), depending on the settings."""
    corpus, tokens, episodes = run.get(CORPUS), run.get(TOKENS), run.config.episodes
    if episodes.reward == "contrastive":
        return run.get(TAUGHT_REWARD).sequence
    if isinstance(tokens, RacerCodec):
        raise InputError("episodes.reward=distance", "needs lexemes that are decoded one by one",
                         "use it over a lexicon, not with system=racer")
    return looked_up(distance_rewards(tokens.shown(), corpus.motion))
