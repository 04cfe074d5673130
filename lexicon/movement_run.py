"""The runner of the lexicon of movements (`lexicon.movement`)."""

from collections.abc import Mapping

import numpy as np

from data_module.layers_run import Floats, Tensors, gelu
from data_module.motion.movement_run import PAST, BasisRunner
from lexicon.settings import LexiconConfig

__all__ = ["MovementLexiconRunner"]


class MovementLexiconRunner:
    """The basis and the lexemes, as of `MovementLexicon`, or of `MovementVqVae` if the settings say so. vectors: [S,
    D_s] the lexemes; examples: [S, 3, D_m] the past of the training block nearest to each."""

    def __init__(self, config: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]], tensors: Tensors
                 ) -> None:
        """Arguments as of `MovementLexicon`."""
        self.basis = BasisRunner(frames, parts, {name: config.components_of(name) for name in parts},
                                 tensors.within("basis"))
        width, learned = self.basis.width, config.quantizer == "vq-vae"
        code = config.code_width if learned else width
        self.vectors = tensors.take("vectors", config.size, code)
        self.examples = tensors.take("examples", config.size, PAST, self.basis.motion_width)
        self._squares = np.square(self.vectors).sum(-1)
        self._encoder = _BentMap(tensors.within("encoder"), width, config.hidden, code) if learned else None
        self._decoder = _BentMap(tensors.within("decoder"), code, config.hidden, width) if learned else None
        # The residual codebooks below the lexeme are for measuring the lexicon, not for playing it.
        for part, count in enumerate(self.basis.widths):
            for level, size in enumerate(config.levels):
                tensors.take(f"level_{part}_{level}", size, count)

    def distances(self, coefficients: Floats) -> Floats:
        """Squared distances [B, S] of the latents of coefficients [B, n] from the lexemes."""
        latents = coefficients * self.basis.weight
        if self._encoder is not None:
            latents = self._encoder(latents)
        return np.maximum(np.square(latents).sum(-1, keepdims=True) - 2 * latents @ self.vectors.T + self._squares, 0)

    def shown(self) -> Floats:
        """[S, K, D_m] the motion of each lexeme after the past of the training block nearest to it."""
        codes = self.vectors if self._decoder is None else self._decoder(self.vectors)
        base = self.basis.base(self.examples, np.ones(len(codes), np.float32))
        return base + self.basis.expand(codes / self.basis.weight)


class _BentMap:
    """x A + MLP(x) (`lexicon.movement.BentMap`)."""

    def __init__(self, tensors: Tensors, width: int, hidden: int, out: int) -> None:
        self._straight = tensors.dense("straight", width, out, bias=False)
        self._bend = [tensors.dense(f"bend.{number}", *sizes)
                      for number, sizes in ((0, (width, hidden)), (2, (hidden, hidden)), (4, (hidden, out)))]

    def __call__(self, x: Floats) -> Floats:
        first, second, last = self._bend
        return self._straight(x) + last(gelu(second(gelu(first(x)))))
