"""The head that draws a block's coefficients: v of conditional flow matching, and drawing by Heun's method.

`FlowHead` is what is trained. A stream draws few rows many times, where a layer costs less than calling it, and most of
a layer is bringing its weights to the processor. `SamplingHead` computes the same v with less of both: what contexts
share is computed once for all of them, what only the time tells is a bias that is kept, and weights lie as the product
reads them.
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
    """What `FlowHead` needs of times t. told: [..., 2 F] sines and cosines; deviation: [..., 1] sqrt(s); share:
    [..., 1] (2 t - 1) / s."""

    told: Tensor
    deviation: Tensor
    share: Tensor

    @classmethod
    def of(cls, time: Tensor) -> FlowTime:
        """Of times [..., 1] from 0 (noise) to 1."""
        angles, variance = time * _rates(time.device, time.dtype), time**2 + (1 - time) ** 2
        return cls(torch.cat([angles.sin(), angles.cos()], -1), variance.sqrt(), (2 * time - 1) / variance)


class FlowHead(nn.Module):
    """v(u_t, t, h): what unit Gaussian data would have, and an MLP of residual blocks for the rest, each scaled and
    shifted by the context:

        v = (2 t - 1) / s u_t + F(u_t / sqrt(s), t, h) / sqrt(s)        s = t^2 + (1 - t)^2

    s is the variance of u_t for data of variance 1, which u has, and F then has unit variance to tell at every t (as
    Karras et al. 2022 scale denoisers). An F that knows nothing draws every coefficient as widely as it was met, so
    what training does not reach is lively instead of still.
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
        """What every layer is scaled and shifted by for the context [..., C]: it does not change along the way of
        drawing."""
        both = (layer(context).chunk(2, -1) for layer in self.condition)
        return [(1 + gain, shift) for gain, shift in both]

    def sampling(self) -> SamplingHead:
        """The same head to draw with, as its weights are now; made anew only where they were changed."""
        own = tuple((weight.data_ptr(), 0 if weight.is_inference() else weight._version)
                    for weight in self.parameters())
        if self._sampling is None or self._sampling.made_of != own:
            with torch.inference_mode(False), torch.no_grad():
                self._sampling = SamplingHead(self, own)
        return self._sampling

    def forward(self, noisy: Tensor, time: FlowTime, conditions: list[tuple[Tensor, Tensor]]) -> Tensor:
        """noisy: [..., n] at a time; conditions: of `conditions`. Gives v [..., n]."""
        told = time.told.expand(*noisy.shape[:-1], -1)
        x = self.enter(torch.cat([noisy / time.deviation, told], -1))
        for (scale, shift), inner, outer in zip(conditions, self.inner, self.outer, strict=True):
            x = x + outer(functional.gelu(inner(functional.layer_norm(x, x.shape[-1:]) * scale + shift)))
        # No last normalisation: how large the noise is must reach the end, or large movements could not be drawn.
        v: Tensor = time.share * noisy + self.leave(x) / time.deviation
        return v


class SamplingHead:
    """v of a `FlowHead` for one noisy u and several contexts, which are mixed (guidance); no gradient goes through."""

    def __init__(self, head: FlowHead, made_of: tuple[tuple[int, int], ...]) -> None:
        """made_of: address and version of each of the head's weights."""
        def rows(layer: nn.Module) -> tuple[Tensor, Tensor]:
            assert isinstance(layer, nn.Linear)
            return layer.weight.detach().t().contiguous(), layer.bias.detach().clone()

        self.made_of, width = made_of, head.leave.out_features
        enter, self._bias = rows(head.enter)
        self._enter, self._told = enter[:width], enter[width:]
        self._layers = [(*rows(inner), *rows(outer)) for inner, outer in zip(head.inner, head.outer, strict=True)]
        self._leave = rows(head.leave)
        self._times: dict[float, tuple[Tensor, float, float]] = {}

    def __call__(self, noisy: Tensor, time: float, conditions: list[tuple[Tensor, Tensor]], mix: Tensor) -> Tensor:
        """[M, n] sum of mix v over the contexts, of u [M, n] at a time from 0 to 1; conditions: scale and shift of each
        layer, [B, 1, W]; mix: [B, 1, n], of sum 1 over B."""
        bias, inverse, share = self._times.get(time) or self._at(time)
        contexts, rows = len(mix), len(noisy)
        # Up to the first layer all contexts see the same.
        x = torch.addmm(bias, noisy, self._enter, alpha=inverse)
        for (scale, shift), (inner, inner_bias, outer, outer_bias) in zip(conditions, self._layers, strict=True):
            told = torch.addcmul(shift, functional.layer_norm(x, x.shape[-1:]), scale).view(contexts * rows, -1)
            added = torch.addmm(outer_bias, functional.gelu(torch.addmm(inner_bias, told, inner)), outer)
            x = added.view(contexts, rows, -1).add_(x)
        leave, leave_bias = self._leave
        end = torch.addmm(leave_bias, x.view(contexts * rows, -1), leave).view(contexts, rows, -1)
        # Of the share of u that every context takes the mix leaves one.
        return torch.add((end * mix).sum(0).mul_(inverse), noisy, alpha=share)

    def _at(self, time: float) -> tuple[Tensor, float, float]:
        """What is the same whenever v is asked at this time: the bias of the first layer [W], 1 / sqrt(s), and
        (2 t - 1) / s."""
        with torch.inference_mode(False), torch.no_grad():
            at = FlowTime.of(torch.full((1,), time, device=self._bias.device, dtype=self._bias.dtype))
            found = torch.addmv(self._bias, self._told.t(), at.told), 1.0 / float(at.deviation), float(at.share)
        self._times[time] = found
        return found


@lru_cache(maxsize=4)
def _rates(device: torch.device, dtype: torch.dtype) -> Tensor:
    """[F] radians by which the time of the flow is told."""
    with torch.inference_mode(False):
        return 1.5 * 2.0 ** (0.5 * torch.arange(_FREQUENCIES, device=device, dtype=dtype))
