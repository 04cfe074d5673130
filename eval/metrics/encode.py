"""A clip as a bundle sees it: the blocks of its speech, the lexemes that its motion is nearest to.

Any motion can be encoded, not only the bundle's own. A performer whom the bundle does not know is centred on the
clip's mean pose, and joints that the source lacks are at rest.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import blocks as block_module
from data_module.motion.movement import Pasts, pasts_of
from data_module.types import Array, Blocks, Motion
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Statistics, representation_of
from gesticulator.training.stages.lexicon import BlockLexicon
from lexicon.movement import MovementLexicon


@dataclass(frozen=True)
class EncodedMotion:
    """A motion in N blocks. latents: [N, code width]; labels: [N] nearest lexemes."""

    latents: Tensor
    labels: NDArray[np.int64]


def normalised_blocks(config: Config, statistics: Statistics, motion: Motion, blocks: Blocks, speaker: str = ""
                      ) -> tuple[Tensor, Pasts]:
    """[N, K, D_m] a motion in given blocks, in the features of a lexicon, and what came before each block; see the
    module for unknown performers.

    Joints of the lexicon that the motion has not at all (fingers) are where they are on average.
    """
    representation = representation_of(config)
    poses = block_module.normalise_motion(motion, blocks, representation)
    # The mean pose is what a performer is centred on; of a stranger only the clip itself tells it.
    known = speaker in statistics.speakers
    mean = statistics.mean_pose[statistics.speakers.index(speaker)] if known else poses.mean(axis=(0, 1))

    def features(values: Array) -> Tensor:
        scaled = (values - mean) / statistics.deviation
        if config.motion.representation == "rotations":
            scaled = scaled * (np.arange(scaled.shape[-1]) < 3 * len(motion.skeleton))
        return torch.as_tensor(scaled, dtype=torch.float32)

    # The first block has no block before it: the pose at the clip's begin stands for it.
    block_features = features(poses)
    seconds = torch.as_tensor(blocks.durations, dtype=torch.float32)
    return block_features, pasts_of(block_features, seconds, features(block_module.first_pose(motion, representation)))


@torch.no_grad()
def latents_of(lexicon: BlockLexicon, motion: Tensor, past: Pasts) -> Tensor:
    """[N, D_s] blocks [N, K, D_m] where the lexicon compares them with its codebook: E(M) of the paper's lexicon (RG
    Eq. 4), the weighted coefficients of movements."""
    if isinstance(lexicon, MovementLexicon):
        return lexicon.latents(lexicon.basis.coefficients(motion, past))
    return lexicon.latents(motion)


@torch.no_grad()
def labels_of(lexicon: BlockLexicon, latents: Tensor) -> NDArray[np.int64]:
    """[N] the lexeme nearest to each of the latents [N, D_s]."""
    if isinstance(lexicon, MovementLexicon):
        return np.asarray(lexicon.code_distances(latents).argmin(-1).numpy())
    return np.asarray(lexicon.quantizer.labels(latents).numpy())


def encode_motion(bundle: Bundle, motion: Motion, blocks: Blocks, speaker: str = "") -> EncodedMotion:
    """A motion in given blocks as the bundle's lexicon reads it: its latents and nearest lexemes."""
    lexicon = bundle.block_lexicon
    normalised, past = normalised_blocks(bundle.config, bundle.statistics, motion, blocks, speaker)
    latents = latents_of(lexicon, normalised, past)
    return EncodedMotion(latents, labels_of(lexicon, latents))
