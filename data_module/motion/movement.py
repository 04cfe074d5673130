"""What a block of motion adds to its past, in a few numbers: the coordinates of movement.

A block X [K, D_m] is told by how it leaves its past: with l the last pose before it, v and a the last velocity and
acceleration (differences of frames, rescaled to the block's own duration), a linear predictor W, fitted by ridge
regression, says what the body would do if nothing new came, and principal components U tell the rest:

    base(past) = l + W [l, v, a, 1]        E = X - base        y = U^T E

Each part of the body (torso, head, each arm, the fingers of each hand) has its own W and its own U. W has learned the
way back to the mean pose, so a long performance does not drift. Everything is fitted in closed form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from data_module.types import Array

PAST = 3
"""Frames before a block that it is told from: a pose, a velocity and an acceleration."""
_RIDGE = 1.0
"""Of the predictor, on features of unit deviation: nothing beside tens of thousands of blocks, but few stay calm."""
_TORSO = ("Hips", "Spine")
_HEAD = ("Neck", "Head")
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky", "Little")
_LEAST_SCALE = 1e-6
_SHARES = {"torso": 0.4, "head": 0.4, "left fingers": 0.3, "right fingers": 0.3}
"""Of what an arm weighs, 1: nobody names a gesture by its fingers, which have four times as many numbers, and at an
arm's weight a third of the codes would tell sways of the trunk apart with both hands at rest."""
LIMITS = (0.03, 99.97)
"""Percent: between these the coefficients of training blocks lie, but for the wildest six in ten thousand."""


def body_parts(joints: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Part of the body -> its columns among three numbers a joint: torso, head, and for each side arm and fingers.

    Joints of other names (places in space, say) make one part, "body".
    """
    parts: dict[str, list[int]] = {}
    for index, joint in enumerate(joints):
        side = next((s for s in ("Left", "Right") if joint.startswith(s)), "")
        if side:
            name = f"{side.lower()} {'fingers' if any(finger in joint for finger in _FINGERS) else 'arm'}"
        else:
            name = "torso" if joint.startswith(_TORSO) else "head" if joint.startswith(_HEAD) else "body"
        parts.setdefault(name, []).extend(range(3 * index, 3 * index + 3))
    return {name: tuple(columns) for name, columns in parts.items()}


@dataclass(frozen=True)
class Pasts:
    """What blocks are told from. frames: [..., 3, D_m] the frames before a block; ratio: [...] the block's duration
    over that of the block before, which brings velocities to the block's own clock."""

    frames: Tensor
    ratio: Tensor

    def state(self) -> tuple[Tensor, Tensor, Tensor]:
        """Last pose, velocity and acceleration [..., D_m], in the block's own frames."""
        ratio = self.ratio[..., None]
        last, before = self.frames[..., 2, :], self.frames[..., 1, :]
        velocity = (last - before) * ratio
        return last, velocity, velocity - (before - self.frames[..., 0, :]) * ratio

    def __getitem__(self, rows: Tensor | slice) -> Pasts:
        return Pasts(self.frames[rows], self.ratio[rows])


def pasts_of(motion: Tensor, durations: Tensor, first: Tensor) -> Pasts:
    """The pasts of the blocks of one recording: motion [N, K, D_m], durations [N] s, first: [D_m] its pose at time 0.

    Before the first block the body stands still in its first pose.
    """
    before = torch.cat([durations[:1], durations[:-1]])
    return Pasts(torch.cat([first.expand(1, PAST, -1), motion[:-1, -PAST:]]), (durations / before).to(motion.dtype))


def joined(pasts: Iterable[Pasts]) -> Pasts:
    """Several recordings' pasts in a row."""
    each = list(pasts)
    return Pasts(torch.cat([past.frames for past in each]), torch.cat([past.ratio for past in each]))


class MovementBasis(nn.Module):
    """W and U of every part, over blocks [..., K, D_m] and their pasts."""

    scale: Tensor
    weight: Tensor
    limits: Tensor
    _order: Tensor
    _back: Tensor

    def __init__(self, frames: int, parts: Mapping[str, tuple[int, ...]], components: Mapping[str, int]) -> None:
        """frames: K; parts: name -> its columns of D_m; components: name -> how many principal components it has."""
        super().__init__()
        self.frames, self.parts = frames, dict(parts)
        self.motion_width = sum(len(columns) for columns in parts.values())
        self.widths = tuple(min(components[name], frames * len(columns)) for name, columns in parts.items())
        for index, (columns, width) in enumerate(zip(parts.values(), self.widths, strict=True)):
            self.register_buffer(f"columns_{index}", torch.tensor(columns, dtype=torch.long), persistent=False)
            self.register_buffer(f"predictor_{index}", torch.zeros(3 * len(columns) + 1, frames * len(columns)))
            self.register_buffer(f"components_{index}", torch.zeros(frames * len(columns), width))
        # All columns part after part, and back: one look-up for all is cheaper than one for each part.
        order = torch.tensor([column for columns in parts.values() for column in columns], dtype=torch.long)
        self.register_buffer("_order", order, persistent=False)
        self.register_buffer("_back", order.argsort(), persistent=False)
        self.register_buffer("scale", torch.ones(self.width))  # deviation of each coefficient
        self.register_buffer("weight", torch.ones(self.width))  # of a coefficient where parts are compared
        self.register_buffer("limits", torch.zeros(2, self.width))

    @property
    def width(self) -> int:
        """n, coefficients of a block."""
        return sum(self.widths)

    def slices(self) -> list[slice]:
        """Where each part's coefficients stand."""
        ends = np.cumsum((0, *self.widths))
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def _buffer(self, name: str, part: int) -> Tensor:
        found: Tensor = getattr(self, f"{name}_{part}")
        return found

    def _by_part(self, values: Tensor) -> Sequence[Tensor]:
        """[..., D_m] to each part's columns."""
        return values[..., self._order].split([len(columns) for columns in self.parts.values()], -1)

    def _joined(self, parts: Sequence[Tensor]) -> Tensor:
        """Blocks [..., K * columns] of each part to [..., K, D_m]."""
        return torch.cat([part.unflatten(-1, (self.frames, -1)) for part in parts], -1)[..., self._back]

    def base(self, past: Pasts) -> Tensor:
        """[..., K, D_m] what the body would do if nothing new came."""
        state = torch.stack(past.state(), -2)
        one = torch.ones_like(state[..., 0, :1])
        led = [torch.cat([own.flatten(-2), one], -1) @ self._buffer("predictor", part)
               for part, own in enumerate(self._by_part(state))]
        return state[..., :1, :] + self._joined(led)

    def project(self, error: Tensor) -> Tensor:
        """E [..., K, D_m], a block less its base, to coefficients y [..., n]."""
        return torch.cat([own.flatten(-2) @ self._buffer("components", part)
                          for part, own in enumerate(self._by_part(error))], -1)

    def expand(self, coefficients: Tensor) -> Tensor:
        """Coefficients [..., n] to E [..., K, D_m]."""
        return self._joined([own @ self._buffer("components", part).T
                             for part, own in enumerate(coefficients.split(self.widths, -1))])

    def coefficients(self, motion: Tensor, past: Pasts) -> Tensor:
        """Blocks [..., K, D_m] and their pasts to y [..., n]."""
        return self.project(motion - self.base(past))

    def compose(self, coefficients: Tensor, past: Pasts) -> Tensor:
        """The inverse of `coefficients`, but for what the components leave out: [..., K, D_m]."""
        return self.base(past) + self.expand(coefficients)

    def known(self, mask: Tensor) -> Tensor:
        """[..., n] 1 for the coefficients of parts that a source has, of its numbers' mask [..., D_m].

        A part is there when most of its joints are (Spine3 alone is often lacking).
        """
        shares = [mask[..., self._buffer("columns", part)].mean(-1, keepdim=True) > 0.5
                  for part in range(len(self.parts))]
        return torch.cat([share.expand(*mask.shape[:-1], width) for share, width in
                          zip(shares, self.widths, strict=True)], -1).to(mask.dtype)

    @torch.no_grad()
    def fit(self, motion: Tensor, past: Pasts, mask: Tensor) -> Tensor:
        """W, U, scale, weight and limits from blocks [N, K, D_m] with their pasts.

        mask: [N, D_m] 1 where the source has it; a part is fitted on the blocks of sources that have it. Gives the
        coefficients [N, n], 0 where it is lacking.
        """
        known = self.known(mask) > 0
        coefficients = torch.zeros(len(motion), self.width, dtype=torch.float64)
        for part, (name, at) in enumerate(zip(self.parts, self.slices(), strict=True)):
            rows = known[:, at.start].nonzero()[:, 0]
            if not len(rows):
                continue
            own = self._fit_part(part, motion[rows], past[rows])
            coefficients[rows, at] = own
            self.scale[at] = own.std(0, correction=0).clamp_min(_LEAST_SCALE).float()
            # Each part's variance is then its share's.
            self.weight[at] = _SHARES.get(name, 1.0) / self.scale[at].pow(2).sum().sqrt()
            self.limits[:, at] = torch.as_tensor(np.percentile(own.numpy(), LIMITS, axis=0)).float()
        return coefficients.float()

    def _fit_part(self, part: int, motion: Tensor, past: Pasts) -> Tensor:
        columns = self._buffer("columns", part)
        last, velocity, acceleration = (value[:, columns].double().numpy() for value in past.state())
        told = np.concatenate([last, velocity, acceleration, np.ones((len(last), 1))], 1)
        moved = (motion[..., columns].double().numpy() - last[:, None]).reshape(len(motion), -1)
        predictor = np.linalg.solve(told.T @ told + _RIDGE * np.eye(told.shape[1]), told.T @ moved)
        error = moved - told @ predictor
        components = _principal(error, self.widths[part])
        self._buffer("predictor", part).copy_(torch.as_tensor(predictor))
        self._buffer("components", part).copy_(torch.as_tensor(components))
        return torch.as_tensor(error @ components)


def _principal(error: Array, count: int) -> Array:
    """[D, count] the directions of most energy, each with its largest entry positive, so that a fit is repeatable."""
    _, directions = np.linalg.eigh(error.T @ error / len(error))
    first: NDArray[np.float64] = directions[:, ::-1][:, :count]
    return first * np.where(first[np.abs(first).argmax(0), np.arange(count)] < 0, -1.0, 1.0)
