"""The lexicon of movements: a lexeme describes the movement relative to the current pose, not the pose itself.

Blocks are represented by `data_module.motion.movement`: coefficients y of the motion that a block adds to its past. A
latent is y with every part of the body scaled to the same variance (an arm moves ten times as far as a torso), and a
lexeme is the nearest of S codewords. Residual codebooks for each part (`LexiconConfig.levels`) encode the remainder.
All codebooks are fitted by k-means, or encoder, lexemes and decoder are learned together (`MovementVqVae`).
"""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from data_module.motion.movement import MovementBasis, Pasts
from data_module.motion.movement_run import PAST
from data_module.types import Array
from lexicon.settings import LexiconConfig

__all__ = ["MovementLexicon", "MovementVqVae", "basis_for", "code_width"]

_TOGETHER = 8192
"""Blocks that are compared with the codebook at a time, which bounds the memory."""


class MovementLexicon(nn.Module):
    """Basis and codebooks over blocks [B, K, D_m] with their pasts.

    vectors: [S, D_s] the lexemes, in the space of the latents; examples: [S, 3, D_m] the past of the training block
    nearest to each.
    """

    vectors: Tensor
    examples: Tensor

    def __init__(self, config: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]]) -> None:
        """frames: K; parts: name -> its columns of D_m (`data_module.motion.movement.body_parts`)."""
        super().__init__()
        self.config, self.frames = config, frames
        self.basis = basis_for(config, frames, parts)
        for part, width in enumerate(self.basis.widths):
            for level, size in enumerate(config.levels):
                self.register_buffer(f"level_{part}_{level}", torch.zeros(size, width))
        self.register_buffer("vectors", torch.zeros(config.size, code_width(config, self.basis.width)))
        self.register_buffer("examples", torch.zeros(config.size, PAST, self.basis.motion_width))

    @property
    def size(self) -> int:
        return len(self.vectors)

    def latents(self, coefficients: Tensor) -> Tensor:
        """[B, D_s] where coefficients [B, n] are compared with the lexemes."""
        return coefficients * self.basis.weight

    def distances(self, coefficients: Tensor) -> Tensor:
        """Squared distances [B, S] of the latents of coefficients [B, n] from the lexemes."""
        return self.code_distances(self.latents(coefficients))

    def code_distances(self, latents: Tensor) -> Tensor:
        """Squared distances [B, S] of latents [B, D_s] from the lexemes."""
        codes = self.vectors
        # |a|^2 - 2 a.b + |b|^2 is a matrix product and needs no [B, S, D_s] differences; rounding can make it negative.
        return (latents.pow(2).sum(-1, keepdim=True) - 2 * latents @ codes.T + codes.pow(2).sum(-1)).clamp_min(0)

    def nearest(self, coefficients: Tensor) -> Tensor:
        """[B] the lexeme nearest to coefficients [B, n]."""
        return torch.cat([self.distances(part).argmin(-1) for part in coefficients.split(_TOGETHER)])

    @torch.no_grad()
    def label(self, motion: Tensor, past: Pasts) -> Tensor:
        """[B] the lexeme of each block [B, K, D_m]."""
        return self.nearest(self.basis.coefficients(motion, past))

    @torch.no_grad()
    def ranks(self, motion: Tensor, past: Pasts, lexemes: Tensor) -> Tensor:
        """[B] number of lexemes nearer to each block than the requested one; 0 if the request was met."""
        away = self.distances(self.basis.coefficients(motion, past))
        # Strictly nearer, so that ties do not count against the request.
        return (away < away.gather(-1, lexemes[:, None])).sum(-1)

    @torch.no_grad()
    def quantised(self, coefficients: Tensor, levels: int | None = None) -> Tensor:
        """Reconstruct coefficients [B, n] from the lexeme and `levels` residual levels (all by default)."""
        out = self.added(self.nearest(coefficients))
        for part, at in enumerate(self.basis.slices()):
            for level in range(len(self.config.levels) if levels is None else levels):
                book = self.get_buffer(f"level_{part}_{level}")
                # Residual quantisation: each level encodes what the lexeme and the levels above it left over.
                out[:, at] += book[torch.cdist(coefficients[:, at] - out[:, at], book).argmin(-1)]
        return out

    def added(self, lexemes: Tensor) -> Tensor:
        """Coefficients [B, n] of lexemes [B]."""
        return self.vectors[lexemes] / self.basis.weight

    @torch.no_grad()
    def shown(self) -> Tensor:
        """[S, K, D_m] the motion of each lexeme after the past of the training block nearest to it."""
        every = torch.arange(self.size, device=self.vectors.device)
        return self.basis.compose(self.added(every), Pasts(self.examples, torch.ones_like(self.examples[:, 0, 0])))

    @torch.no_grad()
    def still_distances(self, pose: Tensor) -> Tensor:
        """[S] squared distances of the lexemes from a block of stillness in a pose [D_m]."""
        past = Pasts(pose.expand(1, PAST, -1), pose.new_ones(1))
        return self.distances(self.basis.coefficients(pose.expand(1, self.frames, -1), past))[0]

    @torch.no_grad()
    def fit(self, motion: Tensor, past: Pasts, mask: Tensor, seed: int) -> None:
        """Fit basis and codebooks to blocks [N, K, D_m] with their pasts; mask: [N, D_m] 1 for present dimensions."""
        coefficients = self.basis.fit(motion, past, mask)
        points = coefficients.double().numpy() * self.basis.weight.double().numpy()
        self.vectors.copy_(torch.as_tensor(_means(points, self.size, seed)))
        self.fit_levels(coefficients, past, seed)

    @torch.no_grad()
    def fit_levels(self, coefficients: Tensor, past: Pasts, seed: int) -> None:
        """Fit the residual codebooks to coefficients [N, n] and choose the examples, once there are lexemes."""
        # The rest after the lexeme of each block; every level below takes its share off in place.
        rest = coefficients - self.added(self.nearest(coefficients))
        for part, at in enumerate(self.basis.slices()):
            for level, size in enumerate(self.config.levels):
                book = torch.as_tensor(_means(rest[:, at].double().numpy(), size, seed + 1 + level)).float()
                self.get_buffer(f"level_{part}_{level}").copy_(book)
                rest[:, at] -= book[torch.cat([torch.cdist(rows, book).argmin(-1)
                                               for rows in rest[:, at].split(_TOGETHER)])]
        # Arg min over the blocks (dimension 0): the block that shows each lexeme best.
        nearest = torch.cat([self.distances(part) for part in coefficients.split(_TOGETHER)]).argmin(0)
        self.examples.copy_(past.frames[nearest])


class MovementVqVae(MovementLexicon):
    """Basis, encoder, lexemes, decoder and residual codebooks over blocks [B, K, D_m] with their pasts, learned by
    `lexicon.movement_vqvae`."""

    def __init__(self, config: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]]) -> None:
        """As of `MovementLexicon`."""
        super().__init__(config, frames, parts)
        self.encoder = BentMap(self.basis.width, config.hidden, config.code_width)
        self.decoder = BentMap(config.code_width, config.hidden, self.basis.width)

    def latents(self, coefficients: Tensor) -> Tensor:
        """E: coefficients [B, n] to latents [B, D_s], before quantisation."""
        out: Tensor = self.encoder(coefficients * self.basis.weight)
        return out

    def decode(self, codes: Tensor) -> Tensor:
        """D: codes [B, D_s] to coefficients [B, n]."""
        out: Tensor = self.decoder(codes) / self.basis.weight
        return out

    @torch.no_grad()
    def added(self, lexemes: Tensor) -> Tensor:
        """Coefficients [B, n] of lexemes [B]."""
        return self.decode(self.vectors)[lexemes]


class BentMap(nn.Module):
    """x A + MLP(x) over [..., width], to [..., out]; the MLP is 0 at the start."""

    def __init__(self, width: int, hidden: int, out: int) -> None:
        """hidden: units of each of the two hidden layers."""
        super().__init__()
        self.straight = nn.Linear(width, out, bias=False)
        # An orthogonal map keeps distances as far as the widths allow, so that at the start near latents are near
        # movements.
        nn.init.orthogonal_(self.straight.weight)
        last = nn.Linear(hidden, out)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.bend = nn.Sequential(nn.Linear(width, hidden), nn.GELU(), nn.Linear(hidden, hidden), nn.GELU(), last)

    def forward(self, x: Tensor) -> Tensor:
        """[..., width] to [..., out]."""
        out: Tensor = self.straight(x) + self.bend(x)
        return out


def basis_for(config: LexiconConfig, frames: int, parts: Mapping[str, tuple[int, ...]]) -> MovementBasis:
    """The basis of a lexicon's settings. frames: K; parts: body part -> its dimensions."""
    return MovementBasis(frames, parts, {name: config.components_of(name) for name in parts})


def code_width(config: LexiconConfig, width: int) -> int:
    """D_s, width of a lexeme, of a lexicon over movements of `width` coefficients."""
    return config.code_width if config.quantizer == "vq-vae" else width


def _means(points: Array, size: int, seed: int) -> Array:
    from sklearn.cluster import MiniBatchKMeans  # takes a second to import; only training needs it

    count = min(size, len(points))
    fitted = MiniBatchKMeans(count, random_state=seed % 2**31, batch_size=4096, n_init=3, max_iter=100).fit(points)
    # With fewer blocks than codes, the surplus codes are placed far from every block.
    means = np.full((size, points.shape[1]), 1e3 * (1.0 + np.abs(points).max()))
    means[:count] = fitted.cluster_centers_
    return means
