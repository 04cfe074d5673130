"""The corpus labelled by the lexicon: lexemes, silent lexemes, and their frequencies (RG 6.4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.motion.kinematics import positions_of
from data_module.motion.representation import Representation
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Sizes, representation_of
from gesticulator.systems import system_of
from gesticulator.training.stages.base import Node, Run
from gesticulator.training.stages.corpus import BLOCKS, Corpus, sizes
from gesticulator.training.stages.features import CORPUS
from gesticulator.training.stages.lexicon import TOKENS, Tokens, token_labels
from lexicon import inventory as inventories


@dataclass(frozen=True)
class Labelled:
    """The labels of a corpus.

    labels: [N] lexemes; hinted: [N] the same, with a silent lexeme on every silent block; silent: the silent lexemes;
    nearest: [S] the nearest silent lexeme to each lexeme; active: [N] whether the block is a gesture; style_numbers:
    [N] 1 and up for training blocks, 0 for others; inventory: counts over the training split.
    """

    labels: NDArray[np.int64]
    hinted: NDArray[np.int64]
    silent: NDArray[np.int64]
    nearest: NDArray[np.int64]
    active: NDArray[np.bool_]
    style_numbers: NDArray[np.int64]
    inventory: inventories.Inventory


def lexeme_speeds(corpus: Corpus, labels: NDArray[np.int64], size: int, config: Config, most: int = 100
                  ) -> NDArray[np.float64]:
    """[S] mean speed of all joints in the training blocks of each lexeme, metres per second of normalised time.

    Measured on the blocks themselves (up to `most` per lexeme): a decoded lexeme is a mean, and its small errors from
    frame to frame would look like movement. A lexeme without blocks counts as infinitely fast.
    """
    train = corpus.select("train")
    speeds = np.full(size, np.inf)
    for lexeme in range(size):
        blocks = train[labels[train] == lexeme]
        blocks = blocks[:: max(1, len(blocks) // most)][:most]
        if len(blocks):
            speeds[lexeme] = _speed(corpus, blocks, representation_of(config), config.rhythm.fps)
    return speeds


def _speed(corpus: Corpus, blocks: NDArray[np.int64], representation: Representation, fps: float) -> float:
    """Mean speed over blocks [B]."""
    speakers = corpus.speaker_of[corpus.recording[blocks]]
    poses = np.stack([corpus.statistics.denormalise(corpus.motion[int(block)].double().numpy(), int(speaker))
                      for block, speaker in zip(blocks, speakers, strict=True)])
    places = positions_of(representation.motion(poses.reshape(-1, poses.shape[-1]), fps))
    moved = np.diff(places.reshape(*poses.shape[:2], *places.shape[1:]), axis=1)
    return float(np.linalg.norm(moved, axis=-1).mean() * fps)


def silent_lexemes(config: Config, corpus: Corpus, labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """The silent lexemes from the settings, or detected: slow, and frequent in silence (RG 6.4.1)."""
    named, size = config.silence.lexemes, config.lexicon.size
    if not system_of(config).SILENCE:
        return np.zeros(0, dtype=np.int64)
    if named:
        if max(named) >= size:
            raise InputError("silence.lexemes", f"names {list(named)}", f"there are 0 to {size - 1}")
        return np.array(sorted(set(named)), dtype=np.int64)
    train = corpus.select("train")
    return inventories.silent_lexemes(lexeme_speeds(corpus, labels, size, config), labels[train], corpus.silent[train])


def label(config: Config, corpus: Corpus, tokens: Tokens) -> Labelled:
    """Label a corpus: lexemes, silent lexemes, the hint on silent blocks, and counts (RG 6.4.1, Eq. 24)."""
    labels = token_labels(tokens, corpus)
    train = corpus.select("train")
    silent = silent_lexemes(config, corpus, labels)
    nearest = inventories.nearest_silent(tokens.vectors.detach().double().numpy(), silent)
    hinted = np.where(corpus.silent & (config.silence.hint and len(silent) > 0), nearest[labels], labels)
    numbers = np.zeros(len(labels), dtype=np.int64)
    numbers[train] = np.arange(1, len(train) + 1)
    names = corpus.statistics.speakers
    counts = inventories.count(((names[corpus.speaker_of[r]], hinted[corpus.blocks_of(r)])
                                for r in corpus.recordings("train")), len(tokens.vectors))
    return Labelled(labels, hinted, silent, nearest, ~np.isin(labels, silent), numbers, counts)


LABELS: Node[Labelled] = Node(
    "labels", settings=("silence.lexemes",), needs=lambda config: (BLOCKS, TOKENS),
    make=lambda run: label(run.config, run.get(BLOCKS), run.get(TOKENS)))


def model_sizes(run: Run, training: bool = False) -> Sizes:
    """The model dimensions of the corpus and its lexicon; training: include a style code for every training block."""
    labelled = run.get(LABELS)
    return sizes(run.config, run.get(CORPUS), vectors=run.get(TOKENS).vectors, silent=tuple(labelled.silent.tolist()),
                 training_blocks=int(labelled.style_numbers.max()) if training else 0)
