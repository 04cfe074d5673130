"""The runner of the basis of movement (`data_module.motion.movement`), and the parts of a body."""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from data_module.layers_run import Floats, Tensors

__all__ = ["PAST", "BasisRunner", "body_parts", "state_before"]

PAST = 3
"""Frames of the past of a block: enough for a pose, a velocity and an acceleration."""
_TORSO = ("Hips", "Spine")
_HEAD = ("Neck", "Head")
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky", "Little")


def body_parts(joints: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Part of the body -> its columns, three per joint: torso, head, and for each side arm and fingers. Joints of other
    names make one part, "body"."""
    parts: dict[str, list[int]] = {}
    for index, joint in enumerate(joints):
        side = next((s for s in ("Left", "Right") if joint.startswith(s)), "")
        if side:
            name = f"{side.lower()} {'fingers' if any(finger in joint for finger in _FINGERS) else 'arm'}"
        else:
            name = "torso" if joint.startswith(_TORSO) else "head" if joint.startswith(_HEAD) else "body"
        parts.setdefault(name, []).extend(range(3 * index, 3 * index + 3))
    return {name: tuple(columns) for name, columns in parts.items()}


def state_before(frames: Any, ratio: Any) -> tuple[Any, Any, Any]:
    """Last pose, velocity and acceleration [..., D_m], per frame of the block, from the frames [..., 3, D_m] before it
    and its duration over that of the previous block [...]; arrays or tensors."""
    # Every block has K frames, so a longer block has longer steps: velocities per frame scale with the ratio.
    ratio, last, before = ratio[..., None], frames[..., 2, :], frames[..., 1, :]
    velocity = (last - before) * ratio
    return last, velocity, velocity - (before - frames[..., 0, :]) * ratio


class BasisRunner:
    """W and U of every part, as of `data_module.motion.movement.MovementBasis`."""

    def __init__(self, frames: int, parts: Mapping[str, tuple[int, ...]], components: Mapping[str, int],
                 tensors: Tensors) -> None:
        """Arguments as of `MovementBasis`."""
        self.frames, self.parts = frames, dict(parts)
        counts = [len(columns) for columns in parts.values()]
        self.widths = tuple(min(components[name], frames * count) for name, count in zip(parts, counts, strict=True))
        self.width, self.motion_width = sum(self.widths), sum(counts)
        self._order = np.array([column for columns in parts.values() for column in columns])
        self._back, self._columns = np.argsort(self._order), _slices(counts)
        self._predictors = [tensors.take(f"predictor_{part}", 3 * count + 1, frames * count)
                            for part, count in enumerate(counts)]
        self._components = [tensors.take(f"components_{part}", frames * count, width)
                            for part, (count, width) in enumerate(zip(counts, self.widths, strict=True))]
        self.scale, self.weight = tensors.take("scale", self.width), tensors.take("weight", self.width)
        self.limits = tensors.take("limits", 2, self.width)

    def _by_part(self, values: Floats) -> list[Floats]:
        """Values [..., T, D_m] as [..., T * columns] of each part."""
        values = values[..., self._order]
        return [values[..., part].reshape(*values.shape[:-2], -1) for part in self._columns]

    def _joined(self, parts: Sequence[Floats]) -> Floats:
        """Blocks [..., K * columns] of each part to [..., K, D_m]."""
        return np.concatenate([part.reshape(*part.shape[:-1], self.frames, -1) for part in parts], -1)[..., self._back]

    def base(self, frames: Floats, ratio: Floats) -> Floats:
        """[..., K, D_m] the motion predicted from the past alone; arguments as of `state_before`."""
        state = np.stack(state_before(frames, ratio), -2)
        # W predicts the displacement from the last pose; its last row belongs to the constant.
        led = [values @ predictor[:-1] + predictor[-1]
               for values, predictor in zip(self._by_part(state), self._predictors, strict=True)]
        return state[..., :1, :] + self._joined(led)

    def project(self, error: Floats) -> Floats:
        """E [..., K, D_m], a block less its base, to coefficients y [..., n]."""
        return np.concatenate([values @ components for values, components
                               in zip(self._by_part(error), self._components, strict=True)], -1)

    def expand(self, coefficients: Floats) -> Floats:
        """Coefficients [..., n] to E [..., K, D_m]."""
        return self._joined([coefficients[..., part] @ components.T for part, components
                             in zip(_slices(self.widths), self._components, strict=True)])


def _slices(widths: Sequence[int]) -> list[slice]:
    """Of parts that lie side by side; `numpy.split` takes as long as the product that it is for."""
    return [slice(end - width, end) for end, width in zip(accumulate(widths), widths, strict=True)]
