"""The codec of RACER: a convolutional VQ-VAE that turns motion into one code per 8 frames (RACER 4.1, Eq. 3 to 5).

Layers are written (channels in, channels out, kernel, stride, padding, dilation), C is the width:

    RB(d)     x + [ReLU, Conv(C, C, 3, 1, d, d), ReLU, Conv(C, C, 1, 1, 0, 1)]
    encoder   3 times { Conv(D_m or C, C, 4, 2, 1, 1), RB(1), RB(3), RB(9) }, then Conv(C, C, 3, 1, 1, 1)
    decoder   Conv(C, C, 3, 1, 1, 1), then 3 times { RB(9), RB(3), RB(1), TransConv(C, C or D_m, 4, 2, 1, 1) }

This is the table that RACER's authors published (the paper has none), at C = 512. Where the table is ambiguous:

- It calls the decoder's stride-2 layers "Conv", although its legend explains "TransConv", which occurs nowhere else.
  A convolution of stride 2 would shorten the sequence again, so they are transposed here.
- Its input has J x 3 channels where the paper's motion is [T, J]: J joints of three numbers there, D_m numbers here.
- There is no activation between a stride-2 layer and the block after it, before the codebook or at the end, and no
  normalisation; none was added. The decoder ends in its last TransConv.
- The update of the codebook is not described beyond Eq. 4. Its second term is replaced by the moving average of the
  latents, where that term would lead, with revival of dead codes.

The receptive field of a code is much larger than 8 frames: code i depends on frames 8i - 197 to 8i + 204, and affects
as many decoded ones. Recordings should therefore be encoded whole; a code decoded alone only approximates its motion.
"""

import torch
from torch import Tensor, nn

from data_module.layers import masked_mean
from lexicon.quantizer import Quantizer
from lexicon.settings import DILATIONS, FRAMES, HALVINGS, RacerConfig

__all__ = ["RacerCodec"]

_LONG = 65
"""Codes of stillness, enough that the receptive field of the middle one does not reach the ends."""

COMMITMENT = 0.1
"""beta of RACER Eq. 4."""


class ResidualBlock(nn.Module):
    """RB(d) over [B, C, T]: x + [ReLU, Conv(C, C, 3, 1, d, d), ReLU, Conv(C, C, 1, 1, 0, 1)]."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.change = nn.Sequential(nn.ReLU(), nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation),
                                    nn.ReLU(), nn.Conv1d(width, width, 1))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.change(x)


def encoder_layers(motion_width: int, width: int) -> nn.Sequential:
    """The encoder's column of the table: [B, D_m, T] to [B, C, T / 8]."""
    layers: list[nn.Module] = []
    for stage in range(HALVINGS):
        # Kernel 4, stride 2, padding 1 halves the frames exactly.
        layers.append(nn.Conv1d(width if stage else motion_width, width, 4, stride=2, padding=1))
        layers += [ResidualBlock(width, dilation) for dilation in DILATIONS]
    return nn.Sequential(*layers, nn.Conv1d(width, width, 3, padding=1))


def decoder_layers(motion_width: int, width: int) -> nn.Sequential:
    """The decoder's column of the table: [B, C, T / 8] to [B, D_m, T]."""
    layers: list[nn.Module] = [nn.Conv1d(width, width, 3, padding=1)]
    for stage in range(HALVINGS):
        layers += [ResidualBlock(width, dilation) for dilation in reversed(DILATIONS)]
        # Only the last layer leaves the width C.
        out = motion_width if stage == HALVINGS - 1 else width
        layers.append(nn.ConvTranspose1d(width, out, 4, stride=2, padding=1))
    return nn.Sequential(*layers)


class RacerCodec(nn.Module):
    """Encoder, codebook Z and decoder over motion [B, T, D_m]; T is any multiple of 8 frames."""

    present: Tensor

    def __init__(self, config: RacerConfig, motion_width: int, present: Tensor | None = None) -> None:
        """present: [D_m] 1 for the dimensions in the data; the others have no loss, so the output there is 0."""
        super().__init__()
        self.register_buffer("present", torch.ones(motion_width) if present is None else present, persistent=False)
        self.config, self.frames, self.motion_width = config, FRAMES, motion_width
        self.encoder = encoder_layers(motion_width, config.width)
        self.quantizer = Quantizer(config.size, config.width, config.revive_below)
        self.decoder = decoder_layers(motion_width, config.width)

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights of RACER Eq. 4 and 5, keyed like `losses`."""
        return {"reconstruction": 1.0, "velocity": 1.0, "acceleration": 1.0, "commitment": COMMITMENT}

    @property
    def vectors(self) -> Tensor:
        return self.quantizer.vectors

    def encode(self, motion: Tensor) -> Tensor:
        """Motion [B, T, D_m] to latents e [B, T / 8, C], before quantisation. ValueError unless 8 divides T."""
        if motion.shape[1] == 0 or motion.shape[1] % FRAMES:
            raise ValueError(f"{motion.shape[1]} frames cannot be coded: {FRAMES} must divide their number")
        return self.encoder(motion.transpose(1, 2)).transpose(1, 2)

    def decode(self, codes: Tensor) -> Tensor:
        """Codes or latents [B, T', C] to motion [B, 8 T', D_m]."""
        return self.decoder(codes.transpose(1, 2)).transpose(1, 2) * self.present

    @torch.no_grad()
    def label(self, motion: Tensor, batch: int = 64) -> Tensor:
        """Code numbers [B, T / 8] of motion [B, T, D_m]: arg min of the Euclidean distance (RACER Eq. 3). batch:
        sequences that are encoded at a time, which bounds the memory."""
        parts = [self.encode(part) for part in motion.split(batch)]
        return torch.cat([self.quantizer.labels(part.flatten(0, 1)).unflatten(0, part.shape[:2]) for part in parts])

    @torch.no_grad()
    def still_distances(self, pose: Tensor) -> Tensor:
        """[N] squared distances of the codes from the middle code of a long stillness in a pose [D_m]."""
        # A single code would see the zero padding on both sides, which is no stillness.
        latents = self.encode(pose.expand(1, _LONG * FRAMES, -1))
        return self.quantizer.distances(latents[:, _LONG // 2])[0]

    @torch.no_grad()
    def decode_tokens(self, tokens: Tensor) -> Tensor:
        """Tokens [B, T'] to motion [B, T', 8, D_m], 8 frames per token, decoded together."""
        return self.decode(self.vectors[tokens]).unflatten(1, (-1, FRAMES))

    @torch.no_grad()
    def start_codebook(self, motion: Tensor, seed: int, batch: int = 64) -> None:
        """Place the codes by k-means on up to 10,000 latents of motion [B, T, D_m]."""
        latents = torch.cat([self.encode(part).flatten(0, 1) for part in motion.split(batch)])
        generator = torch.Generator().manual_seed(seed)
        # A generator on the CPU gives the same choice whatever the device.
        chosen = torch.randperm(len(latents), generator=generator)[:10_000].to(latents.device)
        # One start is enough: the moving averages move the codes from there.
        self.quantizer.fit(latents[chosen], seed, restarts=1)

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """RACER Eq. 4 and 5, all terms as means over elements; each crop is T = 120 frames in the paper. batch: motion
        [B, T, D_m], mask [B, D_m] of present joints. Eq. 5 prints the L1 norm of a pair, which must be the norm of its
        difference. Velocity and acceleration are differences of adjacent frames. `progress` is unused."""
        motion, mask = batch["motion"], batch["mask"][:, None]
        latents = self.encode(motion)
        quantised = self.quantizer(latents.flatten(0, 1))
        # Differences are linear, so the error of a velocity is the difference of the errors.
        error = self.decode(quantised.codes.unflatten(0, latents.shape[:2])) - motion
        velocity = torch.diff(error, dim=1)
        return {
            "reconstruction": masked_mean(error.abs(), mask),
            "velocity": masked_mean(velocity.abs(), mask),
            "acceleration": masked_mean(torch.diff(velocity, dim=1).abs(), mask),
            "commitment": quantised.commitment,
        }
