"""The decoder of the paper's lexicon on arrays (RG 5.1): the motion of each lexeme. `lexicon.autoencoder` trains it."""

import numpy as np
from numpy.typing import NDArray

from data_module.layers_run import Convolutions, Tensors
from lexicon.settings import LexiconConfig

__all__ = ["LexiconRunner"]


class LexiconRunner:
    """Codebook S and decoder D over blocks [K, D_m]."""

    def __init__(self, config: LexiconConfig, frames: int, present: NDArray[np.float32], tensors: Tensors) -> None:
        """frames: K; present: [D_m] 1 for the dimensions in the data; the output of the others is 0."""
        widths, code, motion = config.widths, config.code_width, len(present)
        self._frames, self._present = frames, present
        self.vectors = tensors.take("quantizer.vectors", config.size, code)
        self._from_code = tensors.dense("from_code", code, widths[-1] * frames)
        self._deconvolve = Convolutions(tensors.within("deconvolve"), (*reversed(widths), motion), last_linear=True)
        # Only training encodes motion and moves the codebook.
        tensors.drop("convolve.", "to_code.", "quantizer.")

    def shown(self) -> NDArray[np.float32]:
        """[S, K, D_m] the decoded motion of each lexeme."""
        rows = self._from_code(self.vectors).reshape(len(self.vectors), -1, self._frames).transpose(0, 2, 1)
        return self._deconvolve(rows) * self._present
