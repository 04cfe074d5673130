"""The head that samples a block's coefficients: v of conditional flow matching.

`FlowHead` is trained. A stream samples few rows many times, so that call overhead and the transfer of weights dominate.
`SamplingHead` computes the same v with less of both: work shared by the contexts is done once, the part that depends on
time alone is a cached bias, and weights are stored in the layout of the product.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor, nn
from torch.nn import functional

__all__ = ["FlowHead"]

_FREQUENCIES = 8


@dataclass(frozen=True)
class FlowTime:
    """The inputs of `FlowHead` from times t. waves: [..., 2 F] sines and cosines; deviation: [..., 1] sqrt(s); share:
    [..., 1] (2 t - 1) / s."""

    waves: Tensor
    deviation: Tensor
    share: Tensor

    @classmethod
    def of(cls, time: Tensor) -> FlowTime:
        angles, variance = time * _rates(time.device, time.dtype), time**2 + (1 - time) ** 2
        return cls(torch.cat([angles.sin(), angles.cos()], -1), variance.sqrt(), (2 * time - 1) / variance)


class FlowHead(nn.Module):
    """v(u_t, t, h): the velocity for unit Gaussian data plus an MLP of residual blocks, each scaled and shifted by the
    context:

        v = (2 t - 1) / s u_t + F(u_t / sqrt(s), t, h) / sqrt(s)        s = t^2 + (1 - t)^2

    s is the variance of u_t for data of variance 1, as u is, and F then has unit variance at every t (the scaling of
    Karras et al. 2022). With F = 0 every coefficient is sampled with its variance in the data, so that untrained inputs
    give lively motion instead of none.
    """

    def __init__(self, width: int, context: int, hidden: int, layers: int) -> None:
        """width: n; context: C; hidden: units of each of the layers."""
        super().__init__()
        self.enter = nn.Linear(width + 2 * _FREQUENCIES, hidden)
        self.condition = nn.ModuleList([nn.Linear(context, 2 * hidden) for _ in range(layers)])
        self.inner = nn.ModuleList([nn.Linear(hidden, hidden) for _ in range(layers)])
        self.outer = nn.ModuleList([nn.Linear(hidden, hidden) for _ in range(layers)])
        self.leave = nn.Linear(hidden, width)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)
        self._sampling: SamplingHead | None = None

    def conditions(self, context: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Scale and shift of every layer for the context [..., C]; they are constant during sampling."""
        both = (layer(context).chunk(2, -1) for layer in self.condition)
        return [(1 + gain, shift) for gain, shift in both]

    def sampling(self) -> SamplingHead:
        """The `SamplingHead` of the current weights, cached until they change."""
        version = tuple((weight.data_ptr(), 0 if weight.is_inference() else weight._version)
                        for weight in self.parameters())
        if self._sampling is None or self._sampling.version != version:
            with torch.inference_mode(False), torch.no_grad():
                self._sampling = SamplingHead(self, version)
        return self._sampling

    def forward(self, noisy: Tensor, time: FlowTime, conditions: list[tuple[Tensor, Tensor]]) -> Tensor:
        """v [..., n] of noisy u_t [..., n]; conditions: as of `conditions`."""
        x = self.enter(torch.cat([noisy / time.deviation, time.waves.expand(*noisy.shape[:-1], -1)], -1))
        for (scale, shift), inner, outer in zip(conditions, self.inner, self.outer, strict=True):
            x = x + outer(functional.gelu(inner(functional.layer_norm(x, x.shape[-1:]) * scale + shift)))
        # No final normalisation: the output must see the size of the noise, or large movements could not be sampled.
        v: Tensor = time.share * noisy + self.leave(x) / time.deviation
        return v


class SamplingHead:
    """v of a `FlowHead` for one noisy u and a mix of several contexts (guidance), without gradient."""

    def __init__(self, head: FlowHead, version: tuple[tuple[int, int], ...]) -> None:
        def rows(layer: nn.Module) -> tuple[Tensor, Tensor]:
            assert isinstance(layer, nn.Linear)
            return layer.weight.detach().t().contiguous(), layer.bias.detach().clone()

        self.version, width = version, head.leave.out_features
        enter, self._bias = rows(head.enter)
        self._enter, self._waves = enter[:width], enter[width:]
        self._layers = [(*rows(inner), *rows(outer)) for inner, outer in zip(head.inner, head.outer, strict=True)]
        self._leave = rows(head.leave)
        self._times: dict[float, tuple[Tensor, float, float]] = {}

    def __call__(self, noisy: Tensor, time: float, conditions: list[tuple[Tensor, Tensor]], mix: Tensor) -> Tensor:
        """[M, n] sum of mix * v over the contexts, for u [M, n] at a time between 0 and 1; conditions: scale and shift
        of each layer, [B, 1, W]; mix: [B, 1, n], summing to 1 over B."""
        bias, inverse, share = self._times.get(time) or self._at(time)
        contexts, rows = len(mix), len(noisy)
        # The input of the first layer is the same for all contexts.
        x = torch.addmm(bias, noisy, self._enter, alpha=inverse)
        for (scale, shift), (inner, inner_bias, outer, outer_bias) in zip(conditions, self._layers, strict=True):
            scaled = torch.addcmul(shift, functional.layer_norm(x, x.shape[-1:]), scale).view(contexts * rows, -1)
            added = torch.addmm(outer_bias, functional.gelu(torch.addmm(inner_bias, scaled, inner)), outer)
            x = added.view(contexts, rows, -1).add_(x)
        leave, leave_bias = self._leave
        end = torch.addmm(leave_bias, x.view(contexts * rows, -1), leave).view(contexts, rows, -1)
        # The share of u is the same for all contexts, and the mix sums to 1.
        return torch.add((end * mix).sum(0).mul_(inverse), noisy, alpha=share)

    def _at(self, time: float) -> tuple[Tensor, float, float]:
        """The constants of this time: bias of the first layer [W], 1 / sqrt(s), and (2 t - 1) / s."""
        with torch.inference_mode(False), torch.no_grad():
            at = FlowTime.of(torch.full((1,), time, device=self._bias.device, dtype=self._bias.dtype))
            constants = torch.addmv(self._bias, self._waves.t(), at.waves), 1.0 / float(at.deviation), float(at.share)
        self._times[time] = constants
        return constants


@lru_cache(maxsize=4)
def _rates(device: torch.device, dtype: torch.dtype) -> Tensor:
    with torch.inference_mode(False):
        return 1.5 * 2.0 ** (0.5 * torch.arange(_FREQUENCIES, device=device, dtype=dtype))
