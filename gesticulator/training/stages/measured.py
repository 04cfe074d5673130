"""Statistics of the training split: means, deviations, bounds, resting poses, and normalisers of features."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module import controls
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Normaliser, Statistics, body_columns, representation_of

BOUNDS = (0.1, 99.9)
"""Percentiles: omits one frame in a thousand at either end, because captured motion contains jumps."""


def measured(config: Config, speakers: tuple[str, ...], speaker_of: NDArray[np.int64],
             loaded: list[dict[str, NDArray[Any]]], encoded: list[dict[str, NDArray[Any]]]) -> Statistics:
    """The statistics of training data, from the cached blocks and features of R recordings or parts of them.

    speaker_of: [R]; loaded, encoded: [R].
    """
    width = loaded[0]["motion"].shape[-1]
    mean, rest = np.zeros((len(speakers), width)), np.zeros((len(speakers), width))
    centred = []
    for speaker in range(len(speakers)):
        recordings = [arrays for arrays, one in zip(loaded, speaker_of, strict=True) if one == speaker]
        poses = np.concatenate([arrays["motion"] for arrays in recordings]).astype(np.float64)
        mean[speaker] = poses.mean(axis=(0, 1))
        if config.rests_by_phrase:
            rest[speaker] = hanging(poses[:, -1], config)
        else:
            still = settled(np.concatenate([arrays["silent"] for arrays in recordings]))
            rest[speaker] = poses[still, -1].mean(axis=0) if still.any() else mean[speaker]
        # One deviation for all speakers about their own means: larger gestures of a speaker stay larger.
        centred.append((poses - mean[speaker]).reshape(-1, width))
    deviation = np.concatenate(centred).std(axis=0)
    present = np.stack([arrays["mask"] for arrays in loaded]).any(axis=0)
    # A joint that hardly moves would be blown up by division: its deviation has a least value.
    deviation = np.where(present, np.maximum(deviation, config.motion.least_deviation), 1.0)
    bounds = np.percentile(np.concatenate(centred) / deviation, BOUNDS, axis=0)
    quiet = [settled(arrays["silent"], 1) for arrays in loaded]
    normalisers, silences = [], []
    for level in ("low", "high"):
        rows = [levels.get(level, levels["low"]) for levels in encoded]
        normaliser = Normaliser.fit(np.concatenate(rows).astype(np.float32))
        silence = np.concatenate([row[which] for row, which in zip(rows, quiet, strict=True)]).astype(np.float32)
        normalisers.append(normaliser)
        silences.append(normaliser.apply(silence).mean(axis=0, dtype=np.float64) if len(silence)
                        else np.zeros(rows[0].shape[1:]))
    control = controls.Levels.fit(np.concatenate([arrays["control"] for arrays in loaded]).reshape(
        -1, len(controls.FEATURES)).astype(np.float64))
    return Statistics(speakers, mean, rest, deviation, bounds, normalisers[0], normalisers[1], silences[0],
                      silences[1], control)


LOWEST = 0.03
"""Share of the poses, those with the lowest hands, that define the resting pose: some speakers keep their hands up in
every silence of theirs."""


def hanging(poses: Array, config: Config) -> Array:
    """[D_m] the pose of rest among poses [n, D_m]: the arms of the median pose among those with the lowest hands (a
    mean of lowered and raised hands would be half way up), and the mean of these poses for trunk and head (a single
    pose may look aside)."""
    places = positions_of(representation_of(config).motion(poses, config.rhythm.fps))
    height = places[:, [CHARACTER.index("LeftHand"), CHARACTER.index("RightHand")], 1].mean(axis=1) - places[:, 0, 1]
    low = poses[height <= np.quantile(height, LOWEST)]
    rest = low.mean(axis=0)
    arms = [column for part, columns in body_columns(config).items() if part not in ("torso", "head")
            for column in columns]
    rest[arms] = low[np.linalg.norm(low[:, arms] - rest[arms], axis=1).argmin()][arms]
    return np.asarray(rest)


def settled(silent: NDArray[np.bool_], wait: int = 3) -> NDArray[np.bool_]:
    """Silent blocks preceded by `wait` silent ones: the arms have come to rest."""
    settled = silent.copy()
    for back in range(1, wait + 1):
        settled[back:] &= silent[:-back]
        settled[:back] = False
    return settled
