"""The runner of RACER's codec (`lexicon.racer`): codes to motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_module.layers_run import Floats, Tensors
from lexicon.settings import DILATIONS, FRAMES, HALVINGS, RacerConfig

__all__ = ["CodecRunner"]

Kernel = tuple[Floats, Floats]
"""Weight and bias of a convolution."""


class CodecRunner:
    """Codebook Z and decoder over codes; the encoder is of training alone."""

    def __init__(self, config: RacerConfig, present: Floats, tensors: Tensors) -> None:
        """present: [D_m] 1 for the dimensions in the data; the output of the others is 0."""
        width, motion = config.width, len(present)
        self._present, self._vectors = present, tensors.take("quantizer.vectors", config.size, width)
        tensors.take("quantizer.counts", config.size)
        tensors.take("quantizer.sums", config.size, width)
        encoder, decoder, each = tensors.within("encoder"), tensors.within("decoder"), len(DILATIONS) + 1
        self._enter = _kernel(decoder.within("0"), (width, width, 3), width)
        self._stages = list[tuple[list[tuple[Kernel, Kernel]], Kernel]]()
        for stage in range(HALVINGS):
            _kernel(encoder.within(f"{each * stage}"), (width, width if stage else motion, 4), width)
            for n in range(1, each):
                _residual(encoder.within(f"{each * stage + n}"), width)
            out = motion if stage == HALVINGS - 1 else width
            self._stages.append((
                [_residual(decoder.within(f"{each * stage + n}"), width) for n in range(1, each)],
                _kernel(decoder.within(f"{each * stage + each}"), (width, out, 4), out)))
        _kernel(encoder.within(f"{each * HALVINGS}"), (width, width, 3), width)

    def decode(self, codes: Sequence[int]) -> Floats:
        """[T', 8, D_m] motion of T' codes, 8 frames per code, decoded together."""
        rows = _convolved(self._vectors[list(codes)], self._enter)
        for residuals, (weight, bias) in self._stages:
            for (change, after), dilation in zip(residuals, reversed(DILATIONS), strict=True):
                rows = rows + _convolved(np.maximum(_convolved(np.maximum(rows, 0), change, dilation), 0), after)
            # A transposed convolution of stride 2: every frame gives two, each of two frames.
            around = np.pad(rows, ((1, 1), (0, 0)))
            two = np.stack([rows @ weight[..., 1] + around[:-2] @ weight[..., 3],
                            rows @ weight[..., 2] + around[2:] @ weight[..., 0]], axis=1)
            rows = two.reshape(2 * len(rows), -1) + bias
        return (rows * self._present).reshape(len(codes), FRAMES, -1)


def _kernel(tensors: Tensors, shape: tuple[int, ...], width: int) -> Kernel:
    return tensors.take("weight", *shape), tensors.take("bias", width)


def _residual(tensors: Tensors, width: int) -> tuple[Kernel, Kernel]:
    return (_kernel(tensors.within("change.1"), (width, width, 3), width),
            _kernel(tensors.within("change.3"), (width, width, 1), width))


def _convolved(rows: Floats, kernel: Kernel, dilation: int = 1) -> Floats:
    """[T, N] of rows [T, D] by a kernel [N, D, odd], with zeros around them."""
    weight, bias = kernel
    around = np.pad(rows, ((weight.shape[2] // 2 * dilation,) * 2, (0, 0)))
    taps = (around[n * dilation:n * dilation + len(rows)] @ weight[..., n].T for n in range(weight.shape[2]))
    return sum(taps, bias)
