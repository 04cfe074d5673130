"""The losses of the generator (RG 5.3, Eq. 10 to 14), every norm a mean over elements."""

from collections.abc import Callable

import torch
from torch import Tensor

from data_module.layers import masked_mean

__all__ = ["lexeme", "perceptual", "reconstruction", "style_divergence"]

Encoder = Callable[[Tensor], Tensor]
"""The frozen encoder of the lexicon: blocks [B, K, D_m] to latents [B, D_s]."""


def reconstruction(generated: Tensor, motion: Tensor, mask: Tensor | None = None) -> Tensor:
    """L_rec = |M* - M|^2 over [..., K, D_m] (RG Eq. 10)."""
    return masked_mean((generated - motion).pow(2), mask)


def perceptual(generated: Tensor, motion: Tensor, encoder: Encoder) -> Tensor:
    """L_perc = |E(M*) - E(M)|^2 with the frozen encoder, before quantisation, over [B, K, D_m] (RG Eq. 11)."""
    with torch.no_grad():
        # The truth is a constant here: a gradient through it has nothing to train, as E is frozen.
        target = encoder(motion)
    return (encoder(generated) - target).pow(2).mean()


def lexeme(generated: Tensor, lexemes: Tensor, encoder: Encoder) -> Tensor:
    """L_lexeme = |E(M*_j) - s_i|^2: the lexeme s_i must be recognisable whatever past, audio and style (RG Eq. 13).
    generated: [B, K, D_m], from lexemes [B, D_s] and the other inputs of random blocks j."""
    return (encoder(generated) - lexemes.detach()).pow(2).mean()


def style_divergence(codes: Tensor, eps: float = 1e-6) -> Tensor:
    """L_z = KL(N(mu_z, sigma_z^2) || N(0, 1)) of the batch's style codes [B, 32], mean over dimensions (RG Eq. 14). mu
    and sigma are the moments of the mini-batch. Zero for exact N(0, 1) moments, finite for a batch of 1, zero without
    codes or for codes of width 0."""
    if codes.numel() == 0:
        return codes.new_zeros(())
    # eps keeps the logarithm finite for a single code, whose variance is 0.
    variance = codes.var(0, unbiased=False) + eps
    return 0.5 * (variance + codes.mean(0).pow(2) - 1.0 - variance.log()).mean()
