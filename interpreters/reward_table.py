"""Trained reward models over a lexicon and a corpus: lexemes and block numbers in, rewards out (RACER Eq. 8).

A lexeme is scored as it is seen. Where a lexeme names a movement, what it looks like depends on where the body stands:
each block of a window is then decoded in context, from the last frames of the block before it as that was decoded, and
the first from the performer's own past. What the past alone leads to (`Bases`) and what the lexeme adds to it are
summed, so that the reward of every lexeme at a block still costs little more than that of one.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from data_module.layers import freeze
from interpreters.reward import RewardModel

Decode = Callable[[Tensor], Tensor]
"""Lexemes [B, W] to motion [B, W, K, D_m], each block decoded with the window around it."""
Bases = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Lexemes [B, W], blocks [B, W] and valid [B, W] to motion [B, W, K, D_m]: what each block would show if its own lexeme
added nothing, after the lexemes before it. The last lexeme is not looked at."""

_AT_ONCE = 25_000
"""Candidate windows that are scored in one go: bounds the memory of `RewardTable.sequence_every`."""


class RewardTable:
    """A trained reward model over a lexicon and a corpus: lexemes and block numbers in, rewards out (RACER Eq. 8).

    Windows are right-aligned: the decision at hand is their last block, and padding (valid 0) stands on the left. All
    tensors live on the device of the model, which is copied: what happens to it later changes no reward.
    """

    def __init__(self, model: RewardModel, audio: Tensor, log_duration: Tensor, decoded: Tensor | None = None, *,
                 decode: tuple[Decode, int] | None = None, bases: Bases | None = None, centred: bool = False) -> None:
        """audio: [N, K, d] and log_duration: [N] of the corpus' blocks. The lexicon is one of
        decoded: [S, K, D_m], every lexeme decoded by itself (the cheap way), or, with bases, what it adds to them; or
        decode: windows of lexemes [B, n] to motion [B, n, K, D_m], and S. It is given no padding.
        centred: the reward is m . (u - mean u) instead of m . u: what a motion earns under any audio is taken off.
        """
        if (decoded is None) == (decode is None):
            raise ValueError("give either the decoded lexemes, or a way to decode them and their number")
        self.model = copy.deepcopy(model)
        freeze(self.model)
        self._decode = None if decode is None else decode[0]
        size = 0 if decode is None else decode[1]
        self.window, self.bases = model.config.window, bases
        with torch.no_grad():
            self._log_duration, self._audio = log_duration, self.model.block_audio(audio)
            self._tempo = self.model.tempo(log_duration)
            self._lexemes: Tensor | None = None
            if decoded is not None:
                size = len(decoded)
                self._lexemes = self.model.block_motion(decoded, log_duration.new_zeros(size))
                if bases is not None:  # the bias comes with the base
                    self._lexemes = self._lexemes - self.model.read_motion.bias
            self._centre = self._mean_audio() if centred else None
        self.size = size
        """S, how many lexemes there are."""

    def _mean_audio(self) -> Tensor:
        """[P] the mean vector of the corpus' audio, of windows of full length wherever they begin."""
        ends = torch.arange(self.window - 1, len(self._audio), device=self._audio.device)
        at = ends[:, None] + torch.arange(1 - self.window, 1, device=ends.device)
        parts = [self.model.embed_audio(self._audio[part], torch.ones(part.shape, device=ends.device)).sum(0)
                 for part in at.split(4096)]
        return torch.stack(parts).sum(0) / max(1, len(ends))

    @torch.no_grad()
    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor, shown: Tensor | None = None) -> Tensor:
        """Cosines [B] in [-1, 1] of lexemes [B, W] on the corpus' blocks [B, W]; valid: [B, W]. Centred ones lie in
        [-2, 2]. shown: what `bases` gives of these, where it is known."""
        motion = self.model.embed_motion(self._motion_tokens(lexemes, blocks, valid, shown), valid)
        return self._cosine(motion, self._embed_audio(blocks, valid))

    @torch.no_grad()
    def every(self, history: Tensor, blocks: Tensor, valid: Tensor, shown: Tensor | None = None) -> Tensor:
        """The reward of each lexeme as the last of the window, [B, S].

        history: [B, W - 1] the lexemes before; blocks, valid: [B, W]. With lexemes decoded by themselves only the last
        token differs between candidates; with `decode` every candidate may change the whole window.
        """
        if self._lexemes is None:
            motion = self._every_whole(history, blocks, valid)
        else:
            anything = torch.cat([history, torch.zeros_like(blocks[:, :1])], 1)
            tokens = self._tempo[blocks] + self._base_tokens(anything, blocks, valid, shown)
            before = tokens[:, :-1] + self._lexemes[history]
            candidates = self._lexemes + tokens[:, -1:]
            motion = self.model.encode_motion.every_last(before, valid, candidates)
        return self._cosine(motion, self._embed_audio(blocks, valid)[:, None])

    def sequence(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """Rewards [M] of the trailing windows along one recording, lexemes [M] on blocks [M].

        The reward of block i looks back on `window` blocks, on i + 1 of them where there are no more.
        """
        at, valid = self.trailing(len(blocks), blocks.device)
        return self.rewards(lexemes[at], blocks[at], valid)

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """Rewards [M, S] of each lexeme at each block of one recording, after the lexemes [M] before that block."""
        at, valid = self.trailing(len(blocks), blocks.device)
        rows = max(1, _AT_ONCE // self.size)
        return torch.cat([self.every(lexemes[part[:, :-1]], blocks[part], kept)
                          for part, kept in zip(at.split(rows), valid.split(rows), strict=True)])

    def trailing(self, count: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Positions [M, W] of the trailing windows and whether they lie in the recording, [M, W]."""
        at = torch.arange(count, device=device)[:, None] + torch.arange(1 - self.window, 1, device=device)
        return at.clamp_min(0), at >= 0

    def _embed_audio(self, blocks: Tensor, valid: Tensor) -> Tensor:
        heard = self.model.embed_audio(self._audio[blocks], valid)
        return heard if self._centre is None else heard - self._centre

    def _cosine(self, motion: Tensor, audio: Tensor) -> Tensor:
        """The inner product of vectors [..., P] (RACER Eq. 8); rounding must not take it past what is possible."""
        most = 1.0 if self._centre is None else 2.0
        return (motion * audio).sum(-1).clamp(-most, most)

    def _base_tokens(self, lexemes: Tensor, blocks: Tensor, valid: Tensor, shown: Tensor | None) -> Tensor:
        """[B, W, C] the tokens of what the blocks show before their lexemes; 0 where lexemes stand alone."""
        if self.bases is None:
            return self._tempo.new_zeros(())
        shown = self.bases(lexemes, blocks, valid) if shown is None else shown
        return self.model.block_motion(shown, shown.new_zeros(shown.shape[:2]))

    def _motion_tokens(self, lexemes: Tensor, blocks: Tensor, valid: Tensor, shown: Tensor | None = None) -> Tensor:
        """Tokens [B, W, C] of lexemes [B, W] on blocks [B, W]; at padding they mean nothing."""
        if self._lexemes is not None:
            return self._lexemes[lexemes] + self._tempo[blocks] + self._base_tokens(lexemes, blocks, valid, shown)
        assert self._decode is not None
        tokens = self._tempo[blocks]
        lengths = valid.to(torch.int64).sum(1)
        for length in lengths.unique().tolist():  # windows of one length together: a decoder must not hear padding
            rows, kept = lengths == length, slice(lexemes.shape[1] - length, None)
            if length:
                motion = self._decode(lexemes[rows, kept])
                tokens[rows, kept] = self.model.block_motion(motion, self._log_duration[blocks[rows, kept]])
        return tokens

    def _every_whole(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """`every` the long way, all B * S windows: vectors [B, S, P]."""
        last = torch.arange(self.size, device=history.device).repeat(len(history))[:, None]
        lexemes = torch.cat([history.repeat_interleave(self.size, 0), last], 1)
        valid = valid.repeat_interleave(self.size, 0)
        tokens = self._motion_tokens(lexemes, blocks.repeat_interleave(self.size, 0), valid)
        return self.model.embed_motion(tokens, valid).unflatten(0, (-1, self.size))


class EnsembleReward:
    """The mean reward of several models less their disagreement: what a policy is taught (`RewardTable`'s interface).

    r = mean_k r_k - c std_k r_k, over centred rewards: models differ most of all in what they give any window, which
    says nothing of a choice.
    """

    def __init__(self, tables: Sequence[RewardTable], caution: float) -> None:
        """tables: of the members, alike but for the model; caution: c. ValueError without one."""
        if not tables:
            raise ValueError("an ensemble needs a member")
        self.tables, self.caution = tuple(tables), caution
        self.window, self.size, self._bases = tables[0].window, tables[0].size, tables[0].bases

    def of(self, members: Sequence[int], caution: float | None = None) -> EnsembleReward:
        """The ensemble of some members alone."""
        return EnsembleReward([self.tables[member] for member in members],
                              self.caution if caution is None else caution)

    def _together(self, each: Sequence[Tensor]) -> Tensor:
        rows = torch.stack(list(each))
        if len(rows) == 1 or not self.caution:
            return rows.mean(0)
        return rows.mean(0) - self.caution * rows.std(0)

    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B], of windows as `RewardTable.rewards` takes them."""
        shown = None if self._bases is None else self._bases(lexemes, blocks, valid)
        return self._together([table.rewards(lexemes, blocks, valid, shown) for table in self.tables])

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """[B, S] the reward of each lexeme as the last of the window (`RewardTable.every`)."""
        shown = None
        if self._bases is not None:
            shown = self._bases(torch.cat([history, torch.zeros_like(blocks[:, :1])], 1), blocks, valid)
        return self._together([table.every(history, blocks, valid, shown) for table in self.tables])

    def sequence(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """[M] along one recording (`RewardTable.sequence`)."""
        at, valid = self.tables[0].trailing(len(blocks), blocks.device)
        return self.rewards(lexemes[at], blocks[at], valid)

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """[M, S] along one recording (`RewardTable.sequence_every`)."""
        at, valid = self.tables[0].trailing(len(blocks), blocks.device)
        rows = max(1, _AT_ONCE // self.size)
        return torch.cat([self.every(lexemes[part[:, :-1]], blocks[part], kept)
                          for part, kept in zip(at.split(rows), valid.split(rows), strict=True)])


class Centred:
    """A `RewardTable` (or `EnsembleReward`) whose rewards are told from what random lexemes earn on the same audio.

    Any two windows agree to some degree (random ones at 0.6 to 0.7), and agree better on some audio than on other. What
    the audio alone earns is the same whatever is done, so it changes no choice; but summed over a recording it is many
    times what a choice can add, and a Q-network would spend itself on learning it.
    """

    def __init__(self, table: RewardTable | EnsembleReward, recordings: Sequence[Tensor], draws: int, seed: int = 0
                 ) -> None:
        """recordings: the block numbers [M] of each recording, in order; draws: random sequences for each."""
        self.table, self.window, self.size = table, table.window, table.size
        generator = torch.Generator().manual_seed(seed)
        last = max(int(blocks.max()) for blocks in recordings)
        self.baseline = torch.zeros(last + 1, device=recordings[0].device)
        """[N] the mean reward of random lexemes in the window that ends with a block."""
        for blocks in recordings:
            for _ in range(draws):
                lexemes = torch.randint(self.size, (len(blocks),), generator=generator).to(blocks.device)
                self.baseline[blocks] += table.sequence(lexemes, blocks) / draws

    def rewards(self, lexemes: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """As of the table, [B]."""
        return self.table.rewards(lexemes, blocks, valid) - self.baseline[blocks[:, -1]]

    def every(self, history: Tensor, blocks: Tensor, valid: Tensor) -> Tensor:
        """As of the table, [B, S]."""
        return self.table.every(history, blocks, valid) - self.baseline[blocks[:, -1:]]

    def sequence(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """As of the table, [M]."""
        return self.table.sequence(lexemes, blocks) - self.baseline[blocks]

    def sequence_every(self, lexemes: Tensor, blocks: Tensor) -> Tensor:
        """As of the table, [M, S]."""
        return self.table.sequence_every(lexemes, blocks) - self.baseline[blocks][:, None]
