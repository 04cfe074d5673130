"""Movement features at each frame: distance between the hands, nearness to the chest, reach ahead and to the sides."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from data_module.types import Array
from gesticulator_performer.takes import WRISTS
from gesticulator_performer.torso import FPS

# Point near the chest that a hand moves to for "me", metres from the hips.
_HEART = np.array([0.0, 0.38, 0.12])
# Least height over the hips, metres, of a hand that counts as raised.
_LIFTED = 0.05


def features_of(places: Array) -> Array:
    """[T, 7] z-scores, clipped to [-2, 2.5], of the features in `meaning.MOVEMENTS`, from facing positions [T, 16, 3].
    """
    left, right = (places[:, wrist] for wrist in WRISTS)
    apart = np.linalg.norm(right - left, axis=1)
    up = np.maximum(left[:, 1], right[:, 1]) > _LIFTED
    near = -np.minimum(np.linalg.norm(left - _HEART, axis=1), np.linalg.norm(right - _HEART, axis=1))
    ahead = np.maximum(left[:, 2], right[:, 2])
    side = 0.5 * (left[:, 0] + right[:, 0])
    across = sum(np.abs(np.gradient(gaussian_filter1d(hand[:, 0], 0.05 * FPS))) for hand in (left, right))
    sideways = gaussian_filter1d(across, 0.17 * FPS)
    raw = np.stack([apart * up, -apart * up, near, ahead, side, -side, sideways], axis=1)
    return np.clip((raw - raw.mean(axis=0)) / (raw.std(axis=0) + 1e-6), -2.0, 2.5)
