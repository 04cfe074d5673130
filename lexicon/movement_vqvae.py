"""The training of the lexicon of movements as a VQ-VAE: encoder and decoder are learned together with the lexemes.

With y the coefficients of what a block adds to its past and w the weights that give every part of the body the same
variance (`lexicon.movement`), x = w y:

    e = E(x)        s = the nearest of S lexemes        x' = D(e + sg(s - e))

    |x - x'|^2 + commitment |e - sg(s)|^2

as in RG Eq. 3, over movements instead of poses. E and D are each a linear map plus a network that starts at zero, so
training begins as a linear autoencoder. K-means places the lexemes after `warm_up`. D(s) is the movement of a lexeme:
whatever draws or rates movements takes it in place of a codeword.
"""

import torch
from torch import Tensor, nn

from data_module.motion.movement import Pasts
from lexicon.movement import MovementVqVae
from lexicon.quantizer import Quantizer

__all__ = ["MovementLearner", "fit"]

_PLACED_ON = 20_000
"""Blocks whose latents k-means starts the lexemes from."""


class MovementLearner(nn.Module):
    """The training of a `MovementVqVae`: its quantiser, with the moving averages, and the loss."""

    def __init__(self, lexicon: MovementVqVae) -> None:
        """lexicon: with a fitted basis."""
        super().__init__()
        c = lexicon.config
        self.lexicon = lexicon
        self.quantizer = Quantizer(c.size, c.code_width, c.revive_below)

    @property
    def weights(self) -> dict[str, float]:
        """Keyed like `losses`."""
        c = self.lexicon.config
        return {"reconstruction": 1.0, "commitment": c.commitment}

    def losses(self, batch: dict[str, Tensor], progress: float) -> dict[str, Tensor]:
        """Sums over the dimensions, means over the blocks. batch: coefficients [B, n], known [B, n] 1 for those of the
        parts that the source has. Before `warm_up` of the run (progress, 0 to 1) the decoder gets the latents
        unquantised."""
        lexicon, width = self.lexicon, self.lexicon.config.code_width
        latents = lexicon.latents(batch["coefficients"])
        codes, commitment = latents, latents.new_zeros(())
        if progress >= lexicon.config.warm_up:
            quantised = self.quantizer(latents)
            codes, commitment = quantised.codes, quantised.commitment
        # In the units of x = w y; the mask leaves out parts that the source does not have.
        error = (lexicon.decode(codes) - batch["coefficients"]) * lexicon.basis.weight * batch["known"]
        # The quantiser's terms are means over dimensions; times D_s they are sums, like the first one.
        return {"reconstruction": error.pow(2).sum(-1).mean(), "commitment": commitment * width}

    @torch.no_grad()
    def start_codebook(self, coefficients: Tensor, seed: int) -> None:
        """Place the lexemes by k-means on the latents of some of the coefficients [N, n]."""
        order = torch.randperm(len(coefficients), generator=torch.Generator().manual_seed(seed))[:_PLACED_ON]
        self.quantizer.fit(self.lexicon.latents(coefficients[order.to(coefficients.device)]), seed, restarts=1)

    @torch.no_grad()
    def finish(self, coefficients: Tensor, past: Pasts, seed: int) -> None:
        """Hand the lexemes to the lexicon, and fit the levels below them to coefficients [N, n]."""
        self.lexicon.vectors.copy_(self.quantizer.vectors)
        self.lexicon.fit_levels(coefficients, past, seed)


@torch.no_grad()
def fit(lexicon: MovementVqVae, blocks: tuple[Tensor, Pasts], mask: Tensor, seed: int) -> None:
    """Fit the basis to blocks, as of `MovementLexicon.fit`; place the lexemes by k-means on the latents of the encoder
    as it is, and fit the levels below them. Training goes on from there (`MovementLearner`)."""
    motion, past = blocks
    coefficients = lexicon.basis.fit(motion, past, mask)
    learner = MovementLearner(lexicon)
    learner.start_codebook(coefficients, seed)
    learner.finish(coefficients, past, seed)
