"""Spaces that see a stretch of gesture as a few numbers: what the Frechet gesture distance is measured in.

Theory: an autoencoder (Yoon et al. 2020) reads a window of bone directions and must say it again from 32 numbers; what
those keep is taken for what matters in a gesture. The network of both papers (RG 7.3.2, RACER 5.3) was trained by its
authors on Human3.6M, on windows of 34 frames at 15 fps. It is read from a folder that the user names: it is theirs, and
not for commercial use. Without it, and for windows of another length, the directions of a window's first and last frame
stand for themselves: nothing is learned, so nothing is hidden, but all is weighed alike.

Both see the directions of nine bones between ten joints, seen from the facing hips. So both are blind to the wrists,
to the turn of a limb about its own length and to where the speaker stands.

    >>> RawFeatures(frames=34).features(np.zeros((5, 34, DIRECTIONS))).shape       # two frames of 27 directions
    (5, 54)
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from data_module.errors import InputError
from data_module.layers import SLOPE, freeze
from data_module.motion.representation import POSITIONS, TED_BONES, TED_JOINTS, bone_directions
from data_module.types import Array, Motion

DIRECTIONS = 3 * len(TED_BONES)
"""27 numbers a frame."""
FPS = 15.0
"""Frames a second of the papers' network, and of raw directions."""
PUBLISHED = "h36m_gesture_encoder.safetensors"
PUBLISHED_AXES = (-1.0, -1.0, 1.0)
"""Our directions times these are those that the published network learned: Y down, joints 4 to 6 at -X, facing +Z. Its
ten joints are those of `data_module.motion.representation.ted_positions`, the joints 4 to 6 our left arm."""
SHORT, LONG = 34, 60
"""Frames of a window of the papers, and of one of 4 s: a distance depends on the length, so none stands alone."""
BATCH = 512
"""Windows that go through the network at a time."""


def directions(motion: Motion, fps: float) -> Array:
    """[T, 27] unit vectors along the nine bones of the ten joints, at `fps`, of a motion of the 16-joint character."""
    # The last sample must not lie behind the last frame; the small number is for rates that divide evenly.
    count = int(np.floor((len(motion) - 1) * fps / motion.fps + 1e-9)) + 1
    # Sampled at the network's rate: its kernels learned what 15 frames a second look like.
    points = POSITIONS.vectors(motion, np.arange(count) / fps)
    return bone_directions(points.reshape(count, len(TED_JOINTS), 3)).reshape(count, DIRECTIONS)


def windows(motion: Motion, frames: int, fps: float = FPS) -> Array:
    """[N, frames, 27] the windows of a motion, half a window apart; none if it is short."""
    vectors = directions(motion, fps)
    if len(vectors) < frames:
        return np.zeros((0, frames, DIRECTIONS))
    return np.lib.stride_tricks.sliding_window_view(vectors, frames, axis=0)[::frames // 2].transpose(0, 2, 1).copy()


@dataclass(frozen=True)
class Features:
    """A feature space of FGD. frames: of a window; sha256: of the file of weights, "none" without one; features: of
    windows [N, frames, 27] in our axes, [N, E]."""

    name: str
    frames: int
    fps: float
    sha256: str
    features: Callable[[Array], Array]


class RawFeatures(Features):
    """No network: the directions of the first and the last frame of a window, themselves."""

    def __init__(self, frames: int) -> None:
        super().__init__("raw directions of 2 frames", frames, FPS, "none",
                         lambda directions: directions[:, [0, -1]].reshape(len(directions), 2 * DIRECTIONS))


def pooled(motions: Sequence[Motion], by: Features) -> list[Array]:
    """For each motion the features [n, E] of its windows."""
    return [by.features(windows(motion, by.frames, by.fps)) for motion in motions]


def at_hand() -> Path | None:
    """The folder of the papers' network in GESTICULATOR_DATA; None where it is not there."""
    folder = Path(os.environ.get("GESTICULATOR_DATA", "")) / "fgd"
    return folder if (folder / PUBLISHED).is_file() else None


def spaces(folder: Path | None) -> dict[str, Features]:
    """Two spaces, of windows of two lengths, by name: the papers' network, of its folder, or raw directions; and raw
    directions of `LONG` windows."""
    # Never one length alone: a distance at another may order systems otherwise.
    chosen = (RawFeatures(SHORT) if folder is None else published(folder), RawFeatures(LONG))
    return {f"{features.name}, {features.frames} frames": features for features in chosen}


# ------------------------------------------------------------------------------------------- the network of the papers

class Encoder(nn.Module):
    """Windows [N, 34, 27] to features [N, 32]: four convolutions, then three layers and one more. The parts have the
    names that its authors gave them, so that their weights fit."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(_convolution(DIRECTIONS, 32, 3), _convolution(32, 64, 3),
                                 _convolution(64, 64, 4, stride=2), nn.Conv1d(64, 32, 3))
        # Kernels of 3, 3, 4 with stride 2, and 3 leave so many of the frames, with 32 channels each.
        left = (SHORT - 8) // 2 + 1 - 2
        # Between these layers stands a LeakyReLU of slope 1, the identity, by a slip of its authors (a True where a
        # number belongs); it must be kept to get their features.
        self.out_net = nn.Sequential(nn.Linear(32 * left, 256), nn.BatchNorm1d(256), nn.Identity(),
                                     nn.Linear(256, 128), nn.BatchNorm1d(128), nn.Identity(), nn.Linear(128, 32))
        self.fc_mu = nn.Linear(32, 32)

    def forward(self, windows: Tensor) -> Tensor:
        """[N, 34, 27] to [N, 32]."""
        return self.fc_mu(self.out_net(self.net(windows.transpose(1, 2)).flatten(1)))


def _convolution(wide: int, out: int, kernel: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(nn.Conv1d(wide, out, kernel, stride), nn.BatchNorm1d(out), nn.LeakyReLU(SLOPE))


def published(folder: str | Path) -> Features:
    """The papers' own Human3.6M network, of a folder with `PUBLISHED`; InputError where that is missing or is something
    else."""
    weights, network = Path(folder) / PUBLISHED, Encoder()
    try:
        # strict: weights of another network would leave layers as they were drawn.
        network.load_state_dict({key.removeprefix("pose_encoder."): value
                                 for key, value in safetensors.torch.load_file(weights).items()})
    except (OSError, SafetensorError, RuntimeError, ValueError) as error:
        raise InputError(weights, f"is not the Human3.6M gesture encoder ({str(error).splitlines()[0]})",
                         "name the folder that holds it, or fetch it again") from None
    freeze(network)

    def encode(windows: Array) -> Array:
        # In parts: the windows of a whole split would fill the memory.
        batch = torch.as_tensor(windows * np.tile(PUBLISHED_AXES, len(TED_BONES)), dtype=torch.float32)
        with torch.no_grad():
            return torch.cat([network(part) for part in batch.split(BATCH)]).double().numpy()

    return Features("Human3.6M (Yoon et al. 2020)", SHORT, FPS, hashlib.sha256(weights.read_bytes()).hexdigest(),
                    encode)
