"""The VQ-VAE over motion blocks: one latent vector, one lexeme per block (RG 5.1, Eq. 3 and 4)."""

import torch
from torch import Tensor, nn

from data_module.layers import convolutions, masked_mean
from lexicon.quantizer import Quantizer
from lexicon.settings import LexiconConfig

__all__ = ["Lexicon"]

KERNEL = 3
"""Kernel size of a convolution, frames."""


class Lexicon(nn.Module):
    """Encoder E, codebook S and decoder D over blocks [B, K, D_m]."""

    present: Tensor

    def __init__(self, config: LexiconConfig, frames: int, motion_width: int, present: Tensor | None = None) -> None:
        """present: [D_m] 1 for the dimensions in the data; the others have no loss, so the output there is 0."""
        super().__init__()
        self.register_buffer("present", torch.ones(motion_width) if present is None else present, persistent=False)
        self.config, self.frames, self.motion_width = config, frames, motion_width
        widths, code = config.widths, config.code_width
        self.convolve = convolutions((motion_width, *widths), KERNEL)
        self.to_code = nn.Linear(widths[-1] * frames, code)
        self.quantizer = Quantizer(config.size, code, config.revive_below)
        self.from_code = nn.Linear(code, widths[-1] * frames)
        self.deconvolve = convolutions((*reversed(widths), motion_width), KERNEL, last_linear=True)

    @property
    def weights(self) -> dict[str, float]:
        return {"reconstruction": 1.0, "commitment": self.config.commitment}

    @property
    def vectors(self) -> Tensor:
        return self.quantizer.vectors

    def encode(self, motion: Tensor) -> Tensor:
        """E: blocks [B, K, D_m] to latents [B, code width], before quantisation."""
        return self.to_code(self.convolve(motion.transpose(1, 2)).flatten(1))

    def decode(self, codes: Tensor) -> Tensor:
        """D: [B, code width] to blocks [B, K, D_m]."""
        rows = self.from_code(codes).unflatten(1, (-1, self.frames))
        return self.deconvolve(rows).transpose(1, 2) * self.present

    @torch.no_grad()
    def shown(self) -> Tensor:
        """[S, K, D_m] the decoded motion of each lexeme."""
        return self.decode(self.vectors)

    @torch.no_grad()
    def still_distances(self, pose: Tensor) -> Tensor:
        """[S] squared distances of the lexemes from a block of stillness in a pose [D_m]."""
        return self.quantizer.distances(self.encode(pose.expand(1, self.frames, -1)))[0]

    @torch.no_grad()
    def label(self, motion: Tensor, batch: int = 4096) -> Tensor:
        """Lexeme of each block [B], by arg min in evaluation mode whatever the training mode (RG Eq. 4)."""
        return torch.cat([self.quantizer.labels(part) for part in self.latents(motion, batch).split(batch)])

    @torch.no_grad()
    def latents(self, motion: Tensor, batch: int = 4096) -> Tensor:
        """E in evaluation mode, `batch` blocks at a time: [B, code width]."""
        # Labels are needed in the midst of training, with the running moments of the batch normalisation.
        before = self.training
        self.eval()
        out = torch.cat([self.encode(part) for part in motion.split(batch)])
        self.train(before)
        return out

    @torch.no_grad()
    def start_codebook(self, motion: Tensor, seed: int) -> None:
        """Place the lexemes by k-means on the latents of up to 10,000 blocks."""
        generator = torch.Generator().manual_seed(seed)
        chosen = motion[torch.randperm(len(motion), generator=generator)[:10_000]]
        self.quantizer.fit(self.latents(chosen), seed, restarts=3)

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """RG Eq. 3, all terms as means over elements. batch: motion [B, K, D_m], mask [B, D_m] of present joints.
        Before `warm_up` of the run (progress, 0 to 1) the decoder gets the latents unquantised."""
        motion, mask = batch["motion"], batch["mask"][:, None]
        latents = self.encode(motion)
        if progress < self.config.warm_up:
            # A plain autoencoder, until k-means places the codes on latents that mean something (`start_codebook`).
            codes, commitment = latents, latents.new_zeros(())
        else:
            quantised = self.quantizer(latents)
            codes, commitment = quantised.codes, quantised.commitment
        # Differences are linear, so the error of a velocity is the difference of the errors.
        error = self.decode(codes) - motion
        return {"reconstruction": masked_mean(error.pow(2), mask), "commitment": commitment}
