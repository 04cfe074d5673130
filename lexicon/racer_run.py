"""The runner of RACER's codec (`lexicon.racer`): codes to motion."""

from collections.abc import Sequence

import numpy as np

from data_module.layers_run import Conv, Floats, Tensors
from lexicon.settings import DILATIONS, FRAMES, HALVINGS, RacerConfig

__all__ = ["CodecRunner"]


Residual = tuple[Conv, Conv]


class CodecRunner:
    """Codebook Z and decoder over codes; the encoder is of training alone."""

    def __init__(self, config: RacerConfig, present: Floats, tensors: Tensors) -> None:
        """present: [D_m] 1 for the dimensions in the data; the output of the others is 0."""
        width, motion = config.width, len(present)
        self._present, self._vectors = present, tensors.take("quantizer.vectors", config.size, width)
        tensors.drop("quantizer.", "encoder.")
        decoder, each = tensors.within("decoder"), len(DILATIONS) + 1
        self._enter, self._stages = _conv(decoder.within("0"), width, 3), list[tuple[list[Residual], Floats, Floats]]()
        for stage in range(HALVINGS):
            last, out = decoder.within(f"{each * (stage + 1)}"), motion if stage == HALVINGS - 1 else width
            self._stages.append(([_residual(decoder.within(f"{each * stage + n + 1}"), width, dilation)
                                  for n, dilation in enumerate(reversed(DILATIONS))],
                                 last.take("weight", width, out, 4), last.take("bias", out)))

    def decode(self, codes: Sequence[int]) -> Floats:
        """[T', 8, D_m] motion of T' codes, 8 frames per code, decoded together."""
        rows = self._enter(self._vectors[list(codes)])
        for residuals, weight, bias in self._stages:
            for change, after in residuals:
                rows = rows + after(np.maximum(change(np.maximum(rows, 0)), 0))
            # A transposed convolution of stride 2: every frame gives two, each of two frames.
            around = np.pad(rows, ((1, 1), (0, 0)))
            two = np.stack([rows @ weight[..., 1] + around[:-2] @ weight[..., 3],
                            rows @ weight[..., 2] + around[2:] @ weight[..., 0]], axis=1)
            rows = two.reshape(2 * len(rows), -1) + bias
        return (rows * self._present).reshape(len(codes), FRAMES, -1)


def _conv(tensors: Tensors, width: int, kernel: int, dilation: int = 1) -> Conv:
    return Conv(tensors.take("weight", width, width, kernel), tensors.take("bias", width),
                padding=kernel // 2 * dilation, dilation=dilation)


def _residual(tensors: Tensors, width: int, dilation: int = 1) -> Residual:
    return _conv(tensors.within("change.1"), width, 3, dilation), _conv(tensors.within("change.3"), width, 1)
