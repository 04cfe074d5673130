"""Networks that see a stretch of gesture as a few numbers: what the Frechet gesture distance is measured in.

Theory: an autoencoder (Yoon et al. 2020) reads a window of bone directions and must say it again from 32 numbers; what
those keep is taken for what matters in a gesture. Two of that family stand here.

- The network of both papers (RG 7.3.2, RACER 5.3), trained by its authors on Human3.6M, read from a folder that the
  user names: it is theirs, and not for commercial use. Windows of 34 frames at 15 fps, nothing else.
- Our own, trained on windows of a store, of any length: pinned by the SHA-256 of its file.

Both see the directions of nine bones between ten joints, seen from the facing hips. So both are blind to the wrists,
to the turn of a limb about its own length and to where the speaker stands.

    >>> RawFeatures(frames=34).features(np.zeros((5, 34, DIRECTIONS))).shape       # two frames of 27 directions
    (5, 54)
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import safetensors
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from data_module.errors import InputError
from data_module.files import read_object, write_bytes
from data_module.layers import SLOPE, freeze
from data_module.motion.representation import POSITIONS, TED_BONES, TED_JOINTS, bone_directions
from data_module.store import Store
from data_module.types import Array, Motion
from gesticulator.training.fit import FitOptions, FitSettings, Task, fit

DIRECTIONS = 3 * len(TED_BONES)
"""27 numbers a frame."""
FPS = 15.0
"""Frames a second of the papers' network, and of ours unless told."""
PUBLISHED = "h36m_gesture_encoder"
PUBLISHED_AXES = (-1.0, -1.0, 1.0)
"""Our directions times these are those that the published network learned: Y down, joints 4 to 6 at -X, facing +Z. Its
ten joints are those of `data_module.motion.representation.ted_positions`, the joints 4 to 6 our left arm."""
NAME = "gesture_features"
"""Of the files of our own network."""
NETWORK_FRAMES = (34, 60)
"""Windows of our own networks, at 15 fps: that of the papers' network, and one of 4 s."""
PUBLISHED_FOLDER = "fgd"
"""In GESTICULATOR_DATA: where the papers' network lies, if it is there."""
_LEAST_FRAMES = 12


def directions(motion: Motion, fps: float) -> Array:
    """[T, 27] unit vectors along the nine bones of the ten joints, at `fps`, of a motion of the 16-joint character."""
    # The last sample must not lie behind the last frame; the small number is for rates that divide evenly.
    count = int(np.floor((len(motion) - 1) * fps / motion.fps + 1e-9)) + 1
    # Sampled at the network's rate: its kernels learned what 15 frames a second look like.
    points = POSITIONS.vectors(motion, np.arange(count) / fps)
    return bone_directions(points.reshape(count, len(TED_JOINTS), 3)).reshape(count, DIRECTIONS)


def windows(motion: Motion, frames: int, fps: float = FPS, stride: int | None = None) -> Array:
    """[N, frames, 27] every window of a motion, `stride` frames apart (half a window when not told); none if short."""
    step = max(1, frames // 2) if stride is None else stride
    vectors = directions(motion, fps)
    if len(vectors) < frames:
        return np.zeros((0, frames, DIRECTIONS))
    return np.lib.stride_tricks.sliding_window_view(vectors, frames, axis=0)[::step].transpose(0, 2, 1).copy()


@dataclass(frozen=True)
class Features:
    """A feature space of FGD. frames: of a window; sha256: of the file of weights, "none" without one.

    encode: [N, frames, 27] to [N, E].
    """

    name: str
    frames: int
    fps: float
    sha256: str
    encode: Callable[[Array], Array]

    def features(self, windows: Array) -> Array:
        """[N, E] of windows [N, frames, 27] in our axes; ValueError for another shape or numbers not finite."""
        checked = np.asarray(windows, dtype=np.float64)
        if checked.ndim != 3 or checked.shape[1:] != (self.frames, DIRECTIONS):
            raise ValueError(f"windows must be [N, {self.frames}, {DIRECTIONS}], not {checked.shape}")
        if not np.isfinite(checked).all():
            raise ValueError("windows must be finite")
        return self.encode(checked)


class RawFeatures(Features):
    """No network: the directions of `count` frames, evenly chosen of the window, themselves.

    Nothing is learned, so nothing is hidden; but all is weighed alike, and there are many numbers: 27 each.
    """

    def __init__(self, frames: int, count: int = 2) -> None:
        # The first frame and the last of a window are in, so that its whole span is seen.
        at = np.linspace(0, frames - 1, count).round().astype(int)
        super().__init__(f"raw directions of {count} frames", frames, FPS, "none",
                         lambda directions: directions[:, at].reshape(len(directions), count * DIRECTIONS))


def _batched(encode: Callable[[Tensor], Tensor], axes: Sequence[float] = (1.0, 1.0, 1.0)) -> Callable[[Array], Array]:
    """A network in evaluation mode as what `Features` takes. axes: of our directions to the network's."""
    def of(windows: Array) -> Array:
        batch = torch.as_tensor(windows * np.tile(axes, len(TED_BONES)), dtype=torch.float32)
        with torch.no_grad():
            return torch.cat([encode(part) for part in batch.split(512)]).double().numpy()

    return of


def pooled(motions: Sequence[Motion], by: Features, stride: int | None = None) -> list[Array]:
    """For each motion the features [n, E] of its windows."""
    return [by.features(windows(motion, by.frames, by.fps, stride)) for motion in motions]


class Encoder(nn.Module):
    """Windows [N, frames, 27] to features [N, E]: four convolutions, then three layers and one more.

    slope: of the LeakyReLU between the linear layers. The published network has 1, the identity, by a slip of its
    authors (a True where a number belongs); it must be kept to get their features.
    """

    def __init__(self, frames: int, features: int = 32, slope: float = SLOPE) -> None:
        super().__init__()
        if frames < _LEAST_FRAMES:
            raise ValueError(f"a window must have {_LEAST_FRAMES} frames or more, not {frames}")
        self.convolutions = nn.Sequential(
            _convolution(nn.Conv1d(DIRECTIONS, 32, 3)), _convolution(nn.Conv1d(32, 64, 3)),
            _convolution(nn.Conv1d(64, 64, 4, stride=2)), nn.Conv1d(64, 32, 3))
        self.linear = nn.Sequential(
            nn.Linear(32 * _length(frames), 256), nn.BatchNorm1d(256), nn.LeakyReLU(slope),
            nn.Linear(256, 128), nn.BatchNorm1d(128), nn.LeakyReLU(slope), nn.Linear(128, features))
        self.feature = nn.Linear(features, features)

    def forward(self, windows: Tensor) -> Tensor:
        """[N, frames, 27] to [N, E]."""
        return self.feature(self.linear(self.convolutions(windows.transpose(1, 2)).flatten(1)))


def _convolution(layer: nn.Conv1d | nn.ConvTranspose1d) -> nn.Sequential:
    return nn.Sequential(layer, nn.BatchNorm1d(layer.out_channels), nn.LeakyReLU(SLOPE))


def _length(frames: int) -> int:
    """Frames left after the four convolutions of `Encoder`: kernels 3, 3, 4 with stride 2, and 3."""
    return (frames - 8) // 2 + 1 - 2


# --- the network of the papers

_THEIR_NAMES = {"net": "convolutions", "out_net": "linear", "fc_mu": "feature"}


def published(folder: str | Path) -> Features:
    """The papers' own Human3.6M network, of a folder with `h36m_gesture_encoder.safetensors` and .json.

    InputError for a file that is missing or is something else.
    """
    weights = Path(folder) / f"{PUBLISHED}.safetensors"
    if not weights.is_file():
        raise InputError(weights, "does not exist", "name the folder of the Human3.6M gesture encoder")
    try:
        settings = read_object(weights.with_suffix(".json"), "fetch it again")
        frames, fps, width = int(settings["frames"]), float(settings["fps"]), int(settings["dim"])
        if width != DIRECTIONS:
            raise ValueError(f"it reads {width} numbers a frame, not {DIRECTIONS}")
        network = Encoder(frames, slope=1.0)
        # strict: weights of another network would leave layers as they were drawn.
        network.load_state_dict({_our_name(key): value for key, value in safetensors.torch.load_file(weights).items()})
    except (OSError, SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise InputError(weights, f"is not the Human3.6M gesture encoder ({str(error).splitlines()[0]})",
                         "name the folder that holds it with its .json, or fetch both again") from None
    return Features("Human3.6M (Yoon et al. 2020)", frames, fps, _sha256(weights.read_bytes()),
                    _batched(freeze(network), PUBLISHED_AXES))


def _our_name(theirs: str) -> str:
    part, _, rest = theirs.removeprefix("pose_encoder.").partition(".")
    return f"{_THEIR_NAMES.get(part, part)}.{rest}"


# --- our own

@dataclass(frozen=True)
class AutoencoderConfig:
    """Settings of our network; the widths are those of its family."""

    frames: int = 34
    """Frames of a window."""
    fps: float = FPS
    features: int = 32
    velocity: float = 1.0
    """Weight of the error between neighbouring frames' differences."""


SETTINGS = FitSettings(steps=3000, batch=128, rate=5e-4, betas=(0.5, 0.999))
"""Rate and betas are those of Yoon et al. 2020."""


class Autoencoder(nn.Module):
    """Our own network: windows are standardised, encoded, and said again; only the encoder is kept for the distance."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, config: AutoencoderConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("mean", torch.zeros(DIRECTIONS))
        self.register_buffer("deviation", torch.ones(()))
        self.encoder = Encoder(config.frames, config.features)
        self.widen = nn.Sequential(nn.Linear(config.features, 64), nn.BatchNorm1d(64), nn.LeakyReLU(SLOPE),
                                   nn.Linear(64, 4 * config.frames))
        self.decode = nn.Sequential(_convolution(nn.ConvTranspose1d(4, 32, 3)),
                                    _convolution(nn.ConvTranspose1d(32, 32, 3)),
                                    nn.Conv1d(32, 32, 3), nn.Conv1d(32, DIRECTIONS, 3))

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return {"reconstruction": 1.0, "velocity": self.config.velocity}

    def standardise(self, data: Array) -> None:
        """Take mean and deviation from training windows [N, frames, 27]; one deviation for all, or still bones would
        be blown up."""
        frames = data.reshape(-1, DIRECTIONS)
        self.mean.copy_(torch.as_tensor(frames.mean(axis=0)))
        # The floor keeps a store of one pose from dividing by zero.
        self.deviation.copy_(torch.as_tensor(max(float(np.sqrt(frames.var(axis=0).mean())), 1e-6)))

    def encode(self, windows: Tensor) -> Tensor:
        """[N, frames, 27] to [N, E]."""
        return self.encoder((windows - self.mean) / self.deviation)

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """L1 of the standardised windows and of their differences in time. batch: windows [N, frames, 27]."""
        standardised = (batch["windows"] - self.mean) / self.deviation
        again = self.decode(self.widen(self.encoder(standardised)).unflatten(1, (4, -1))).transpose(1, 2)
        error = again - standardised
        return {"reconstruction": error.abs().mean(), "velocity": torch.diff(error, dim=1).abs().mean()}


def train(store: Store, folder: str | Path, config: AutoencoderConfig | None = None,
          settings: FitSettings | None = None, *, seed: int = 0, progress: bool = True) -> Autoencoder:
    """Our own network on the windows of a store's training split; `folder` holds the run's checkpoint and log, and the
    default of `settings` is `SETTINGS`.

    InputError when no recording is as long as two windows.
    """
    chosen, schedule = config or AutoencoderConfig(), settings or SETTINGS
    # A quarter of a window apart: training sees more phases of a movement than the distance does.
    data = np.concatenate([np.zeros((0, chosen.frames, DIRECTIONS)), *(
        windows(store.load(info.name).motion, chosen.frames, chosen.fps, max(1, chosen.frames // 4))
        for info in store.of_split("train"))])
    if len(data) < 2:
        raise InputError(store.path, f"has no training motion of {chosen.frames} frames at {chosen.fps:g} fps",
                         "use shorter windows or a larger store")
    # Before the network: its first weights are drawn, too.
    torch.manual_seed(seed)
    network = Autoencoder(chosen)
    network.standardise(data)
    pool = torch.as_tensor(data, dtype=torch.float32)

    def batch(rng: np.random.Generator, size: int) -> dict[str, Tensor]:
        return {"windows": pool[torch.as_tensor(rng.integers(len(pool), size=size))]}

    Path(folder).mkdir(parents=True, exist_ok=True)
    fit(f"{NAME}_{chosen.frames}", network, Task(batch), schedule, Path(folder),
        FitOptions(seed=seed, progress=progress))
    freeze(network)
    return network


def as_features(network: Autoencoder) -> Features:
    """Our own network, pinned by the hash of the file that `save` writes of it."""
    freeze(network)
    config = network.config
    return Features(f"own {config.frames} frames", config.frames, config.fps, _sha256(_bytes(network)),
                    _batched(network.encode))


def save(network: Autoencoder, folder: str | Path) -> str:
    """Write NAME.safetensors into `folder`; its SHA-256."""
    place, data = Path(folder), _bytes(network)
    place.mkdir(parents=True, exist_ok=True)
    write_bytes(place / f"{NAME}.safetensors", data)
    return _sha256(data)


def load(folder: str | Path) -> Autoencoder:
    """The inverse of `save`; InputError when the file is missing or is something else."""
    weights = Path(folder) / f"{NAME}.safetensors"
    try:
        with safetensors.safe_open(weights, "pt") as file:
            config = AutoencoderConfig(**json.loads(file.metadata()["config"]))
            network = Autoencoder(config)
            network.load_state_dict({key: file.get_tensor(key) for key in file.keys()})  # noqa: SIM118 - no mapping
    except (OSError, SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise InputError(weights, f"is not a network of gesture features ({str(error).splitlines()[0]})",
                         "train it again") from None
    freeze(network)
    return network


def _bytes(network: Autoencoder) -> bytes:
    """The file of weights, and of what they are the weights of: so the hash pins both. One entry of metadata only: the
    order of several is not fixed."""
    state = {key: value.detach().cpu().contiguous() for key, value in network.state_dict().items()}
    return safetensors.torch.save(state, metadata={"config": json.dumps(asdict(network.config), sort_keys=True)})


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def by_name(features: Sequence[Features]) -> dict[str, Features]:
    """Networks by a name that tells them apart: with the length of their windows."""
    table: dict[str, Features] = {}
    for network in features:
        length = f"{network.frames} frames"
        name = network.name if network.name.endswith(length) else f"{network.name}, {length}"
        # Two networks of our own may differ only in what they were trained on.
        table[name if name not in table else f"{name} ({network.sha256[:8]})"] = network
    return table


def networks(store: Store, work: Path, progress: bool = True) -> list[Features]:
    """Our own networks, trained on the store's training split once and kept in `work`; the papers' where it is."""
    every: list[Features] = []
    # The key holds the store: a network that was trained on other motion is another space.
    for frames in NETWORK_FRAMES:
        folder = work / f"fgd-{store.fingerprint[:12]}-{frames}"
        if not (folder / f"{NAME}.safetensors").is_file():
            save(train(store, folder, AutoencoderConfig(frames=frames), progress=progress), folder)
        every.append(as_features(load(folder)))
    place = os.environ.get("GESTICULATOR_DATA")
    if place and (Path(place) / PUBLISHED_FOLDER).is_dir():
        every.append(published(Path(place) / PUBLISHED_FOLDER))
    return every
