"""Windows of motion as policies are taught on it: a corpus' lexemes decoded by the lexicon, and other lexemes beside.

A policy is rewarded for lexemes that the lexicon decodes (`gesticulator.training.stages.reward`), since a generator
would cost an hour for every thousand decisions. A reward that never saw such motion may prefer any lexemes to the
performer's in it. Here the performer's lexemes are decoded without the residuals of the performer's blocks, and so are
the others, so that only lexemes tell them apart; captured motion has captured blocks of other moments beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from gesticulator.bundle.bundle import Bundle
from gesticulator.training import fit as fitting
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.interpreter import teacher_logits
from gesticulator.training.stages.reward import MovementContext, block_audio, drawn_windows, groups
from interpreters.settings import RewardConfig
from lexicon.inventory import count
from lexicon.movement import MovementLexicon

_DRAWS = 2
"""Sequences of lexemes that the LSTM draws for each recording."""
_CAPTURED = 0.5
"""Share of the batches that are captured motion."""
WRONG = ("random", "one lexeme", "statistical", "lstm", "some of the last")
"""How the lexemes of a negative are made."""


@dataclass(frozen=True)
class Decoder:
    """A corpus and everything that decodes lexemes on it, shared by the ensembles.

    context: without residuals; labels: [N] the performers' lexemes; drawn: [draws, N] those that the LSTM draws after
    the performer's past; transitions: [S, S] how often one follows another.
    """

    corpus: Corpus
    audio: Tensor
    context: MovementContext
    labels: NDArray[np.int64]
    drawn: NDArray[np.int64]
    transitions: NDArray[np.float64]

    @classmethod
    def of(cls, bundle: Bundle, corpus: Corpus, labels: NDArray[np.int64], seed: int = 0) -> Decoder:
        """labels: [N] the lexemes of a corpus by the bundle; InputError where its lexicon is not one of movements."""
        lexicon = bundle.block_models.lexicon
        if not isinstance(lexicon, MovementLexicon):
            raise InputError(f"bundle {bundle.config.name}", "has no lexicon of movements, decoded in context",
                             "choose a bundle that has one, such as default")
        known = corpus.recordings("train")
        follow = count((("all", labels[corpus.blocks_of(r)]) for r in known), len(bundle.vectors)).transitions
        return cls(corpus, block_audio(corpus).float(), MovementContext(lexicon, corpus, None), labels,
                   _drawn(bundle, corpus, labels, known, seed), follow)

    @property
    def size(self) -> int:
        """S, the number of lexemes."""
        return len(self.transitions)


def _drawn(bundle: Bundle, corpus: Corpus, labels: NDArray[np.int64], recordings: Sequence[int], seed: int
           ) -> NDArray[np.int64]:
    out = np.repeat(labels[None], _DRAWS, axis=0)
    generator = torch.Generator().manual_seed(seed)
    for recording in recordings:
        blocks = corpus.blocks_of(recording)
        if len(blocks) < 2:
            continue
        scores = teacher_logits(bundle.block_models.interpreter, corpus, blocks, labels[blocks])
        chances = (scores / (bundle.config.selection.temperature or 1.0)).softmax(-1)
        out[:, blocks[1:]] = torch.multinomial(chances, _DRAWS, replacement=True, generator=generator).T.numpy()
    return out


@dataclass(frozen=True)
class DecodedWindows:
    """Windows of some recordings as batches for `RewardModel.losses`, each batch captured or decoded throughout."""

    decoder: Decoder
    recordings: Sequence[int]
    config: RewardConfig

    def sample(self, rng: np.random.Generator, count: int) -> fitting.Batch:
        """A batch of `count` windows, each with `config.rivals` negatives on its own sound."""
        decoder, corpus = self.decoder, self.decoder.corpus
        blocks, valid = drawn_windows(corpus, self.recordings, self.config, rng, count)
        at, real = torch.as_tensor(blocks), torch.as_tensor(valid)
        if rng.random() < _CAPTURED:
            anything = np.concatenate([corpus.blocks_of(r) for r in self.recordings])
            wrong = rng.choice(anything, (count, self.config.rivals, self.config.longest))
            motion, rival = corpus.motion[at].float(), corpus.motion[torch.as_tensor(wrong)].float()
        else:
            motion = decoder.context.shown(torch.as_tensor(decoder.labels[blocks]), at, real)
            wrong = self.wrong(blocks, valid, rng)
            many = self.config.rivals
            rival = decoder.context.shown(torch.as_tensor(wrong).flatten(0, 1), at.repeat_interleave(many, 0),
                                          real.repeat_interleave(many, 0)).unflatten(0, (-1, many))
        return {"motion": motion, "audio": decoder.audio[at], "valid": real, "rival": rival,
                "rivalled": torch.ones(count),
                "log_duration": torch.as_tensor(np.log(corpus.durations[blocks])).float(),
                "group": torch.as_tensor(groups(blocks, valid, corpus.silent[blocks]))}

    def wrong(self, blocks: NDArray[np.int64], valid: NDArray[np.float32], rng: np.random.Generator
              ) -> NDArray[np.int64]:
        """[B, H, W] lexemes that are not the performer's on windows [B, W], each in one of the ways of `WRONG`."""
        decoder, shape = self.decoder, (len(blocks), self.config.rivals, blocks.shape[1])
        own = np.broadcast_to(decoder.labels[blocks][:, None], shape)
        random = rng.integers(decoder.size, size=shape)
        drawn = decoder.drawn[rng.integers(len(decoder.drawn), size=shape[:2])[..., None], blocks[:, None]]
        likely = rng.random(shape) < 0.5
        length = valid.sum(1).astype(int)[:, None, None]
        last = rng.integers(1, np.maximum(1, length // 2) + 1, size=(*shape[:2], 1))
        replaced = np.arange(shape[2]) >= shape[2] - last
        ways = (random, np.broadcast_to(random[..., :1], shape), self._chain(own[..., 0], shape[2], rng), drawn,
                np.where(replaced, np.where(likely, drawn, random), own))
        way = rng.integers(len(WRONG), size=(*shape[:2], 1))
        out: NDArray[np.int64] = np.select([way == number for number in range(len(ways))], ways)
        same = ((out == own) | (valid == 0)[:, None]).all(-1)
        out[same, -1] = (out[same, -1] + 1 + rng.integers(decoder.size - 1, size=int(same.sum()))) % decoder.size
        return out

    def _chain(self, first: NDArray[np.int64], length: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """[B, H, W] lexemes by how often each follows the one before; first: [B, H]."""
        cumulated, out = self.decoder.transitions.cumsum(1), [first]
        for _ in range(length - 1):
            row = cumulated[out[-1]]
            draw = rng.random(first.shape) * row[..., -1]
            out.append(np.minimum((row < draw[..., None]).sum(-1), self.decoder.size - 1))
        return np.stack(out, -1)
