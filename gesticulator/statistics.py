"""What inference needs to know of the training data: how poses and audio became numbers, and back.

The models see normalised numbers only. `Statistics` is measured once, on the training split, and travels in the bundle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import controls
from data_module.errors import InputError
from data_module.motion.representation import REPRESENTATIONS, Representation
from data_module.speech.features import Normaliser
from data_module.types import Array
from gesticulator.config import Config

CONTROL_WIDTH = 2 * len(controls.FEATURES)
"""2 F: what is asked of each feature, and whether it is asked."""


def representation_of(config: Config) -> Representation:
    """How motion becomes numbers under these settings; InputError for a name that is unknown."""
    name = config.motion.representation
    if name not in REPRESENTATIONS:
        raise InputError("motion.representation", f"is {name!r}", f"choose among {', '.join(REPRESENTATIONS)}")
    return REPRESENTATIONS[name]

LEAST_MOVEMENT = 1e-6
"""Normalised units between the bounds of a dimension that moves. One that does not has bounds a rounding error apart
(1e-27 to 1e-15 were met), one that does has more than 0.1."""


@dataclass(frozen=True)
class Statistics:
    """What turns poses and features into numbers near 1, measured on the training split.

    speakers: names in order. mean_pose: [speakers, D_m] vectors of the representation; rest_pose: [speakers, D_m] the
    same in silence. deviation: [D_m]. bounds: [2, D_m] the least and the most of the normalised training data, but for
    one frame in a thousand at either end. low, high: normalisers of the audio features. quiet_low, quiet_high:
    [3K, d] the normalised features of a settled silence. levels: the features of style that can be asked for.
    A pose becomes (pose - mean_pose[speaker]) / deviation: without the speaker's own mean every lexeme would be a
    speaker.
    """

    speakers: tuple[str, ...]
    mean_pose: Array
    rest_pose: Array
    deviation: Array
    bounds: Array
    low: Normaliser
    high: Normaliser
    quiet_low: Array | None = None
    quiet_high: Array | None = None
    levels: controls.Levels | None = None

    @property
    def present(self) -> Tensor:
        """[D_m] 1 where any training motion ever moved, 0 for joints that no source has."""
        return torch.as_tensor(self.bounds[1] - self.bounds[0] > LEAST_MOVEMENT, dtype=torch.float32)

    def normalise(self, poses: Array, speaker: int) -> Array:
        """Vectors [..., D_m] to normalised features."""
        return (poses - self.mean_pose[speaker]) / self.deviation

    def denormalise(self, features: Array, speaker: int) -> Array:
        """The inverse of `normalise`."""
        return features * self.deviation + self.mean_pose[speaker]


def control_rows(levels: controls.Levels, values: Array, given: NDArray[np.bool_]) -> NDArray[np.float32]:
    """[..., 2 F] of features in their units [..., F] and which are asked for [..., F]: standardised, 0 where free."""
    scaled = (values - levels.mean) / levels.spread * given
    return np.concatenate([scaled, np.broadcast_to(given, scaled.shape)], axis=-1).astype(np.float32)
