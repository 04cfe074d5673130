"""Coordinates of movement: a block of motion relative to its past, in a few coefficients.

With l the last pose before a block X [K, D_m], v and a the last velocity and acceleration (differences of frames,
rescaled to the block's duration), a linear predictor W, fitted by ridge regression, extrapolates the past, and
principal components U encode the residual:

    base(past) = l + W [l, v, a, 1]        E = X - base        y = U^T E

Each part of the body (torso, head, each arm, the fingers of each hand) has a separate W and U. W includes the return to
the mean pose, so a long performance does not drift. Everything is fitted in closed form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from data_module.motion.movement_run import PAST, state_before
from data_module.types import Array

# Ridge of the predictor, on features of unit deviation: negligible for tens of thousands of blocks, but it keeps a fit
# to few blocks stable.
_RIDGE = 1.0
# Least deviation of a coefficient, by which others divide: a joint that never moves has 0.
_LEAST_SCALE = 1e-6
# Weights relative to an arm (1): fingers hardly define a gesture but have four times as many dimensions, and with the
# weight of an arm a third of the codes would only distinguish sways of the trunk with both hands at rest.
_SHARES = {"torso": 0.4, "head": 0.4, "left fingers": 0.3, "right fingers": 0.3}
LIMITS = (0.03, 99.97)
"""Percentiles of the training coefficients that are used as limits."""


@dataclass(frozen=True)
class Pasts:
    """The pasts of blocks. frames: [..., 3, D_m] the frames before a block; ratio: [...] the block's duration over that
    of the previous block, which rescales velocities to the block's normalised time."""

    frames: Tensor
    ratio: Tensor

    def state(self) -> tuple[Tensor, Tensor, Tensor]:
        """Last pose, velocity and acceleration [..., D_m], per frame of the block."""
        last, velocity, acceleration = state_before(self.frames, self.ratio)
        return last, velocity, acceleration

    def __getitem__(self, rows: Tensor | slice) -> Pasts:
        return Pasts(self.frames[rows], self.ratio[rows])


def pasts_of(motion: Tensor, durations: Tensor, first: Tensor) -> Pasts:
    """The pasts of the blocks of one recording: motion [N, K, D_m], durations [N] s, first: [D_m] its pose at time 0.
    Before the first block the body stands still in its first pose."""
    before = torch.cat([durations[:1], durations[:-1]])
    return Pasts(torch.cat([first.expand(1, PAST, -1), motion[:-1, -PAST:]]), (durations / before).to(motion.dtype))


def joined(pasts: Iterable[Pasts]) -> Pasts:
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
        """frames: K; parts: name -> its columns of D_m; components: name -> number of principal components."""
        super().__init__()
        self.frames, self.parts = frames, dict(parts)
        self.motion_width = sum(len(columns) for columns in parts.values())
        self.widths = tuple(min(components[name], frames * len(columns)) for name, columns in parts.items())
        for index, (columns, width) in enumerate(zip(parts.values(), self.widths, strict=True)):
            self.register_buffer(f"columns_{index}", torch.tensor(columns, dtype=torch.long), persistent=False)
            self.register_buffer(f"predictor_{index}", torch.zeros(3 * len(columns) + 1, frames * len(columns)))
            self.register_buffer(f"components_{index}", torch.zeros(frames * len(columns), width))
        # One permutation of all columns is cheaper than one look-up for each part.
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
        ends = np.cumsum((0, *self.widths))
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def _buffer(self, name: str, part: int) -> Tensor:
        buffer: Tensor = getattr(self, f"{name}_{part}")
        return buffer

    def _by_part(self, values: Tensor) -> Sequence[Tensor]:
        return values[..., self._order].split([len(columns) for columns in self.parts.values()], -1)

    def _joined(self, parts: Sequence[Tensor]) -> Tensor:
        """Blocks [..., K * columns] of each part to [..., K, D_m]."""
        return torch.cat([part.unflatten(-1, (self.frames, -1)) for part in parts], -1)[..., self._back]

    def base(self, past: Pasts) -> Tensor:
        """[..., K, D_m] the motion predicted from the past alone."""
        state = torch.stack(past.state(), -2)
        constant = torch.ones_like(state[..., 0, :1])
        led = [torch.cat([values.flatten(-2), constant], -1) @ self._buffer("predictor", part)
               for part, values in enumerate(self._by_part(state))]
        # W predicts the displacement from the last pose.
        return state[..., :1, :] + self._joined(led)

    def project(self, error: Tensor) -> Tensor:
        """E [..., K, D_m], a block less its base, to coefficients y [..., n]."""
        return torch.cat([values.flatten(-2) @ self._buffer("components", part)
                          for part, values in enumerate(self._by_part(error))], -1)

    def expand(self, coefficients: Tensor) -> Tensor:
        """Coefficients [..., n] to E [..., K, D_m]."""
        return self._joined([values @ self._buffer("components", part).T
                             for part, values in enumerate(coefficients.split(self.widths, -1))])

    def coefficients(self, motion: Tensor, past: Pasts) -> Tensor:
        """Blocks [..., K, D_m] and their pasts to y [..., n]."""
        return self.project(motion - self.base(past))

    def compose(self, coefficients: Tensor, past: Pasts) -> Tensor:
        """The inverse of `coefficients`, up to the residual of the components: [..., K, D_m]."""
        return self.base(past) + self.expand(coefficients)

    def known(self, mask: Tensor) -> Tensor:
        """[..., n] 1 for the coefficients of the parts that a source has, from its mask [..., D_m]: those with most of
        their joints (Spine3 alone is often missing)."""
        shares = [mask[..., self._buffer("columns", part)].mean(-1, keepdim=True) > 0.5
                  for part in range(len(self.parts))]
        return torch.cat([share.expand(*mask.shape[:-1], width) for share, width in
                          zip(shares, self.widths, strict=True)], -1).to(mask.dtype)

    @torch.no_grad()
    def fit(self, motion: Tensor, past: Pasts, mask: Tensor) -> Tensor:
        """Fit W, U, scale, weight and limits to blocks [N, K, D_m] with their pasts. mask: [N, D_m] 1 for present
        dimensions; a part is fitted on the blocks that have it. Returns the coefficients [N, n], 0 for missing
        parts."""
        known = self.known(mask) > 0
        coefficients = torch.zeros(len(motion), self.width, dtype=torch.float64)
        for part, (name, at) in enumerate(zip(self.parts, self.slices(), strict=True)):
            rows = known[:, at.start].nonzero()[:, 0]
            if not len(rows):
                continue
            fitted = self._fit_part(part, motion[rows], past[rows])
            coefficients[rows, at] = fitted
            self.scale[at] = fitted.std(0, correction=0).clamp_min(_LEAST_SCALE).float()
            # The total variance of each part is then its squared share.
            self.weight[at] = _SHARES.get(name, 1.0) / self.scale[at].pow(2).sum().sqrt()
            self.limits[:, at] = torch.as_tensor(np.percentile(fitted.numpy(), LIMITS, axis=0)).float()
        return coefficients.float()

    def _fit_part(self, part: int, motion: Tensor, past: Pasts) -> Tensor:
        columns = self._buffer("columns", part)
        last, velocity, acceleration = (value[:, columns].double().numpy() for value in past.state())
        features = np.concatenate([last, velocity, acceleration, np.ones((len(last), 1))], 1)
        moved = (motion[..., columns].double().numpy() - last[:, None]).reshape(len(motion), -1)
        # Normal equations in double precision: the features of a part are few (3 D + 1), its blocks many.
        predictor = np.linalg.solve(features.T @ features + _RIDGE * np.eye(features.shape[1]), features.T @ moved)
        error = moved - features @ predictor
        components = _principal(error, self.widths[part])
        self._buffer("predictor", part).copy_(torch.as_tensor(predictor))
        self._buffer("components", part).copy_(torch.as_tensor(components))
        return torch.as_tensor(error @ components)


def _principal(error: Array, count: int) -> Array:
    """[D, count] the principal directions, each with its largest entry positive so that a fit is reproducible."""
    # eigh returns rising eigenvalues. The residual is not centred: the constant feature of W has taken its mean.
    _, directions = np.linalg.eigh(error.T @ error / len(error))
    first: NDArray[np.float64] = directions[:, ::-1][:, :count]
    return first * np.where(first[np.abs(first).argmax(0), np.arange(count)] < 0, -1.0, 1.0)
