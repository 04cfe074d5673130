"""A clip as a bundle sees it: the blocks of its speech, the lexemes that its motion is nearest to, and its reward.

Any motion can be encoded, not only the bundle's own. A performer whom the bundle does not know is centred on the
clip's mean pose, and joints that the source lacks are at rest.

The reward of the judging model is the mean cosine of the embeddings of speech and motion (RACER Eq. 8), from -1 to 1,
of a model that trained no policy. What fools it: a still pose, whose embedding suits many sounds a little, reaches the
reward of a real motion.

The reward model takes each block's own audio, the middle third of the windows that the generator takes:

    >>> _middle(np.arange(6.0).reshape(1, 6, 1), 2)[..., 0].tolist()
    [[2.0, 3.0]]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import blocks as block_module
from data_module.motion.movement import Pasts, pasts_of
from data_module.types import Array, Blocks, Motion, Speech
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Statistics, front_end_for, representation_of
from gesticulator.sampling.cutter import encode_speech
from gesticulator.training.stages.lexicon import BlockLexicon
from lexicon.movement import MovementLexicon


@dataclass(frozen=True)
class SpeechBlocks:
    """A clip's speech in N blocks. audio: [N, K, d] normalised, for the reward model; None without one."""

    blocks: Blocks
    audio: Tensor | None
    speaker: str

    @classmethod
    def of(cls, bundle: Bundle, speech: Speech) -> SpeechBlocks:
        """Cut and, where there is a model that judges, encoded as its training data was."""
        speaker = speech.speaker or ""
        if bundle.reward_judge is None:
            return cls(block_module.cut(speech, bundle.config.rhythm), None, speaker)
        encoded = encode_speech(speech, bundle.config, front_end_for(bundle.config, bundle.encoder))
        frames, statistics = bundle.config.rhythm.frames, bundle.statistics
        audio = _middle(statistics.low.apply(encoded.low), frames)
        # Both levels in one, and the tempo of the grid, their last column, once.
        if encoded.high is not encoded.low:
            audio = torch.cat([audio[..., :-1], _middle(statistics.high.apply(encoded.high), frames)], dim=-1)
        return cls(encoded.blocks, audio, speaker)


def _middle(windows: NDArray[np.floating], frames: int) -> Tensor:
    """[N, K, d] the block itself of windows of three, in the half precision that corpora are stored in."""
    return torch.as_tensor(windows[:, frames:2 * frames].astype(np.float16)).float()


@dataclass(frozen=True)
class EncodedMotion:
    """A motion in N blocks. poses: [N, K, D] normalised; latents: [N, code width]; labels: [N] nearest lexemes."""

    blocks: Blocks
    poses: Tensor
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
    return EncodedMotion(blocks, normalised, latents, labels_of(lexicon, latents))


@torch.no_grad()
def judged_reward(bundle: Bundle, encoded: EncodedMotion, speech: SpeechBlocks) -> float:
    """The mean reward, by the model that judges, of the windows that end with each block (RACER Eq. 8).

    A cosine from -1 to 1. Windows that are silent throughout are left out; NaN where all are, or without a model.
    """
    model = bundle.reward_judge
    if model is None or speech.audio is None:
        return float("nan")
    # Windows that begin before the clip are padded and marked as not valid.
    at = torch.arange(len(encoded.poses))[:, None] + torch.arange(1 - model.config.window, 1)
    valid, at = (at >= 0).float(), at.clamp_min(0)
    cosines = model.window_rewards(encoded.poses[at], speech.audio[at], valid)
    audible = ((valid > 0) & ~torch.as_tensor(speech.blocks.silent)[at]).any(dim=1)
    return float(cosines[audible].double().mean()) if audible.any() else float("nan")
