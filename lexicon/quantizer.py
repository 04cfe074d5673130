"""The codebook: nearest-neighbour quantisation with a straight-through gradient (RG Eq. 3 and 4)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

__all__ = ["Quantised", "Quantizer"]

DECAY = 0.99
"""Of the moving averages, per step: they cover about a hundred batches."""
_SMOOTHING = 1e-5
"""Added to the count of each vector, relative to the mean of all."""


@dataclass(frozen=True)
class Quantised:
    """The quantisation of latents [B, D]. codes: [B, D] codebook vectors whose gradient is passed to the latents
    unaltered. labels: [B]. commitment: mean |E(M) - sg(s)|^2."""

    codes: Tensor
    labels: Tensor
    commitment: Tensor


class Quantizer(nn.Module):
    """A codebook of `size` vectors of `width`.

    In training the vectors follow the moving average of the latents assigned to them, where the third term of RG Eq. 3
    would lead them, and a vector whose moving count falls below `revive_below` is replaced by a random latent of the
    batch. Labels are arg min of the Euclidean distance (RG Eq. 4).
    """

    vectors: Tensor
    counts: Tensor
    sums: Tensor

    def __init__(self, size: int, width: int, revive_below: float = 1.0) -> None:
        super().__init__()
        self.revive_below = revive_below
        # Vectors of length 1 on average, whatever the width.
        start = torch.randn(size, width) / width**0.5
        self.register_buffer("vectors", start)
        self.register_buffer("counts", torch.ones(size))
        self.register_buffer("sums", start.clone())

    @torch.no_grad()
    def fit(self, latents: Tensor, seed: int, restarts: int) -> None:
        """Place the vectors by k-means on latents [B, D]."""
        from sklearn.cluster import KMeans  # takes a second to import; only training needs it

        points = latents.cpu().double().numpy()
        means = KMeans(min(len(self.vectors), len(points)), n_init=restarts, random_state=seed % 2**31).fit(points)
        vectors = self.vectors.clone()
        vectors[:len(means.cluster_centers_)] = torch.as_tensor(means.cluster_centers_).to(vectors)
        self.set_vectors(vectors)

    @torch.no_grad()
    def set_vectors(self, vectors: Tensor) -> None:
        """Replace the vectors [S, D] and reset the counts."""
        self.vectors.copy_(vectors)
        self.sums.copy_(vectors)
        self.counts.fill_(1.0)

    def distances(self, latents: Tensor) -> Tensor:
        """Squared Euclidean distances [B, S] from latents [B, D]."""
        # |a|^2 - 2 a.b + |b|^2 needs no [B, S, D] differences; rounding can make it negative.
        return (latents.pow(2).sum(1, keepdim=True) - 2 * latents @ self.vectors.t()
                + self.vectors.pow(2).sum(1)).clamp_min(0)

    @torch.no_grad()
    def labels(self, latents: Tensor) -> Tensor:
        """Arg min labels [B] of latents [B, D]."""
        return self.distances(latents).argmin(1)

    def forward(self, latents: Tensor) -> Quantised:
        """Quantise latents [B, D]; in training mode an EMA codebook also follows them."""
        labels = self.labels(latents)
        chosen = self.vectors[labels]
        commitment = (latents - chosen.detach()).pow(2).mean()
        # Straight-through: the value is the chosen vector, the gradient that of the latents.
        codes = latents + (chosen - latents).detach()
        if self.training:
            self._follow(latents.detach(), labels)
        return Quantised(codes, labels, commitment)

    @torch.no_grad()
    def _follow(self, latents: Tensor, labels: Tensor) -> None:
        one_hot = nn.functional.one_hot(labels, len(self.vectors)).to(latents.dtype)
        counts, sums = one_hot.sum(0), one_hot.t() @ latents
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            # The codebook is not moved by gradients, so DistributedDataParallel does not add up the processes' rows.
            for part in (counts, sums):
                torch.distributed.all_reduce(part)
        self.counts.mul_(DECAY).add_(counts, alpha=1 - DECAY)
        self.sums.mul_(DECAY).add_(sums, alpha=1 - DECAY)
        # Laplace smoothing keeps a rarely used vector from dividing by nearly zero.
        total = self.counts.sum()
        smoothed = (self.counts + _SMOOTHING) / (total + len(self.vectors) * _SMOOTHING) * total
        self.vectors.copy_(self.sums / smoothed[:, None])
        dead = torch.nonzero(self.counts < self.revive_below).flatten()
        if len(dead):
            # Counts scale with the batch: a vector is dead when it gets less than its `revive_below` per batch.
            fresh = latents[torch.randint(len(latents), (len(dead),), device=latents.device)]
            self.vectors[dead] = fresh
            self.sums[dead] = fresh
            self.counts[dead] = 1.0


def perplexity(labels: Tensor, size: int) -> float:
    """exp of the entropy of label use, between 1 and `size`."""
    share = torch.bincount(labels.flatten(), minlength=size).double() / max(labels.numel(), 1)
    return float(torch.exp(-(share * share.clamp_min(1e-12).log()).sum()))
