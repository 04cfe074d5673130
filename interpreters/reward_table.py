"""Rewards of lexemes on a corpus from trained reward models: lexemes and block numbers in, rewards out (RACER Eq. 8).

A lexeme is scored by its decoded motion. If a lexeme is a movement, its motion depends on the pose: each block of a
window is then decoded after the last frames of the previous decoded block, and the first after the recorded past. The
motion that follows from the past alone (`Bases`) and the contribution of the lexeme are added, so that the rewards of
all lexemes at a block cost little more than that of one.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from data_module.layers import freeze
from interpreters.reward import RewardModel

Decode = Callable[[Tensor], Tensor]
"""Lexemes [B, W] to motion [B, W, K, D_m], each block decoded with the window around it."""
Bases = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Lexemes [B, W], blocks [B, W] and valid [B, W] to motion [B, W, K, D_m]: the motion of each block after the previous
lexemes, without the contribution of its lexeme. The last lexeme is not used."""

_AT_ONCE = 25_000
"""Candidate windows that are scored at a time, which bounds the memory of `sequence_every`."""


class CorpusRewards(ABC):
    """Rewards along a recording, from those of single windows. Windows are right-aligned: the current decision is the
    last block, and padding (valid 0) is on the left."""

    window: int
    """W, the blocks of a window."""
    size: int
    """S, the number of lexemes."""

    @abstractmethod
    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """The rewards [B] of lexemes [B, W] on the corpus' blocks [B, W]; valid: [B, W]."""

    @abstractmethod
    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """The reward [B, S] of each lexeme at the end of the window. history: [B, W - 1] the lexemes before; blocks,
        valid: [B, W]."""

    def sequence(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """Rewards [M] of the trailing windows along one recording, lexemes [M] on blocks [M]. The reward of block i
        covers the last `window` blocks, or i + 1 if there are fewer."""
        at, valid = self.trailing(len(blocks), blocks.device)
        return self.rewards(lexemes[at], blocks[at], valid)

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """Rewards [M, S] of each lexeme at each block of one recording, after the lexemes [M] before that block."""
        at, valid = self.trailing(len(blocks), blocks.device)
        # Every row becomes S candidate windows.
        rows = max(1, _AT_ONCE // self.size)
        return torch.cat([self.every(lexemes[part[:, :-1]], blocks[part], real)
                          for part, real in zip(at.split(rows), valid.split(rows), strict=True)])

    def trailing(self, count: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Positions [M, W] of the trailing windows and whether they lie in the recording, [M, W]."""
        # Positions before the recording are clamped to its first block and marked as padding.
        at = torch.arange(count, device=device)[:, None] + torch.arange(1 - self.window, 1, device=device)
        return at.clamp_min(0), at >= 0


class RewardTable(CorpusRewards):
    """The rewards of one model (RACER Eq. 8). The model is copied, so later changes to it have no effect; all tensors
    are on its device."""

    def __init__(self, model: RewardModel, audio: Tensor, decoded: Tensor | None = None, *,
                 decode: tuple[Decode, int] | None = None, bases: Bases | None = None, centred: bool = False) -> None:
        """audio: [N, K, d] of the corpus' blocks. The lexicon is either
        decoded: [S, K, D_m], every lexeme decoded by itself (cheap), or, with bases, its contribution to them; or
        decode: windows of lexemes [B, n] to motion [B, n, K, D_m], without padding, and S.
        centred: the reward is m . (u - mean u) instead of m . u, which removes the part common to all audio.
        """
        if (decoded is None) == (decode is None):
            raise ValueError("give either the decoded lexemes, or a decoder and their number")
        self.model = copy.deepcopy(model)
        freeze(self.model)
        self._decode = None if decode is None else decode[0]
        size = 0 if decode is None else decode[1]
        self.window, self.bases = model.config.window, bases
        with torch.no_grad():
            # Everything that depends on a block or a lexeme alone is computed once: queries only add and encode.
            self._audio = self.model.block_audio(audio)
            self._lexemes: Tensor | None = None
            if decoded is not None:
                size, self._lexemes = len(decoded), self.model.block_motion(decoded)
                if bases is not None:  # the bias comes with the base
                    self._lexemes = self._lexemes - self.model.read_motion.bias
            self._centre = self._mean_audio() if centred else None
        self.size = size

    def _mean_audio(self) -> Tensor:
        """[P] the mean vector of the corpus' audio over all windows of full length."""
        ends = torch.arange(self.window - 1, len(self._audio), device=self._audio.device)
        at = ends[:, None] + torch.arange(1 - self.window, 1, device=ends.device)
        parts = [self.model.embed_audio(self._audio[part], torch.ones(part.shape, device=ends.device)).sum(0)
                 for part in at.split(4096)]
        return torch.stack(parts).sum(0) / max(1, len(ends))

    @torch.no_grad()
    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor, base: Tensor | None = None) -> Tensor:
        """Cosines [B] in [-1, 1], or in [-2, 2] if centred. shown: the result of `bases`, if it is known."""
        motion = self.model.embed_motion(self._motion_tokens(lexemes, blocks, valid, base), valid)
        return self._cosine(motion, self._embed_audio(blocks, valid))

    @torch.no_grad()
    def every(self, history: Tensor, blocks: Tensor, valid: Tensor, base: Tensor | None = None) -> Tensor:
        """See `CorpusRewards.every`. With lexemes decoded by themselves only the last token differs between candidates;
        with `decode` a candidate may change the whole window."""
        if self._lexemes is None:
            motion = self._every_whole(history, blocks, valid)
        else:
            lexemes = torch.cat([history, torch.zeros_like(blocks[:, :1])], 1)  # the last one is not used
            tokens = self._base_tokens(lexemes, blocks, valid, base)
            before = tokens[:, :-1] + self._lexemes[history]
            candidates = self._lexemes + tokens[:, -1:]
            motion = self.model.encode_motion.every_last(before, valid, candidates)
        return self._cosine(motion, self._embed_audio(blocks, valid)[:, None])

    def _embed_audio(self, blocks: Tensor, valid: Tensor) -> Tensor:
        vectors = self.model.embed_audio(self._audio[blocks], valid)
        return vectors if self._centre is None else vectors - self._centre

    def _cosine(self, motion: Tensor, audio: Tensor) -> Tensor:
        """The inner product of vectors [..., P] (RACER Eq. 8), clamped against rounding errors."""
        most = 1.0 if self._centre is None else 2.0
        return (motion * audio).sum(-1).clamp(-most, most)

    def _base_tokens(self, lexemes: Tensor, blocks: Tensor, valid: Tensor, base: Tensor | None) -> Tensor:
        """[B, W, C] the tokens of the blocks without their lexemes; 0 without `bases`."""
        if self.bases is None:
            return self._audio.new_zeros(*blocks.shape, self._audio.shape[-1])
        return self.model.block_motion(self.bases(lexemes, blocks, valid) if base is None else base)

    def _motion_tokens(self, lexemes: Tensor, blocks: Tensor, valid: Tensor, base: Tensor | None = None) -> Tensor:
        """Tokens [B, W, C] of lexemes [B, W] on blocks [B, W], undefined at padding."""
        if self._lexemes is not None:
            return self._lexemes[lexemes] + self._base_tokens(lexemes, blocks, valid, base)
        assert self._decode is not None
        tokens = self._audio.new_zeros(*blocks.shape, self._audio.shape[-1])
        lengths = valid.to(torch.int64).sum(1)
        for length in lengths.unique().tolist():  # windows of one length together, without padding
            rows, real = lengths == length, slice(lexemes.shape[1] - length, None)
            if length:
                tokens[rows, real] = self.model.block_motion(self._decode(lexemes[rows, real]))
        return tokens

    def _every_whole(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """Motion vectors [B, S, P] of `every`, from all B * S windows."""
        # Every window as many times as there are lexemes, each with another one at its end.
        last = torch.arange(self.size, device=history.device).repeat(len(history))[:, None]
        lexemes = torch.cat([history.repeat_interleave(self.size, 0), last], 1)
        valid = valid.repeat_interleave(self.size, 0)
        tokens = self._motion_tokens(lexemes, blocks.repeat_interleave(self.size, 0), valid)
        return self.model.embed_motion(tokens, valid).unflatten(0, (-1, self.size))


class EnsembleReward(CorpusRewards):
    """The mean reward of several models less their disagreement, r = mean_k r_k - c std_k r_k, to train a policy. The
    rewards should be centred, because models differ most in their mean over all windows, which is irrelevant to a
    choice."""

    def __init__(self, tables: Sequence[RewardTable], caution: float) -> None:
        """tables: of the members, which differ in the model only; caution: c. ValueError without a table."""
        if not tables:
            raise ValueError("an ensemble needs a member")
        self.tables, self.caution = tuple(tables), caution
        self.window, self.size, self._bases = tables[0].window, tables[0].size, tables[0].bases

    def of(self, members: Sequence[int], caution: float | None = None) -> EnsembleReward:
        return EnsembleReward([self.tables[member] for member in members],
                              self.caution if caution is None else caution)

    def _together(self, each: Sequence[Tensor]) -> Tensor:
        rows = torch.stack(list(each))
        if len(rows) == 1 or not self.caution:
            return rows.mean(0)
        return rows.mean(0) - self.caution * rows.std(0)

    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        # Decoding is the same for all members, so it is done once.
        base = None if self._bases is None else self._bases(lexemes, blocks, valid)
        return self._together([table.rewards(lexemes, blocks, valid, base) for table in self.tables])

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        base = None
        if self._bases is not None:
            base = self._bases(torch.cat([history, torch.zeros_like(blocks[:, :1])], 1), blocks, valid)
        return self._together([table.every(history, blocks, valid, base) for table in self.tables])


class Centred(CorpusRewards):
    """Rewards relative to those of random lexemes on the same audio. Any two windows agree to some degree (random ones
    at 0.6 to 0.7), which depends on the audio. This part does not depend on the action and changes no choice; but
    summed over a recording it is many times the effect of a choice, and a Q-network would spend its capacity on it."""

    def __init__(self, table: CorpusRewards, recordings: Sequence[Tensor], draws: int, seed: int = 0) -> None:
        """recordings: the block numbers [M] of each recording, in order; draws: random sequences for each."""
        self.table, self.window, self.size = table, table.window, table.size
        generator = torch.Generator().manual_seed(seed)
        last = max(int(blocks.max()) for blocks in recordings)
        self.baseline = torch.zeros(last + 1, device=recordings[0].device)
        """[N] the mean reward of random lexemes in the window that ends with a block."""
        for blocks in recordings:
            for _ in range(draws):
                lexemes = torch.randint(self.size, (len(blocks),), generator=generator).to(blocks.device)
                # A baseline of the block, not of the lexeme: it cancels in every comparison of lexemes.
                self.baseline[blocks] += table.sequence(lexemes, blocks) / draws

    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        return self.table.rewards(lexemes, blocks, valid) - self.baseline[blocks[:, -1]]

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        return self.table.every(history, blocks, valid) - self.baseline[blocks[:, -1:]]
