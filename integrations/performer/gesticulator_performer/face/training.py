"""`gesticulator train-face`: the lips network, from speech that the command makes itself.

Speech is changed while it is learned from: its level, its spectrum and the noise under it, in the space of the
features, so that each pass hears other microphones and other rooms. `gesticulator.face.lips` runs the weights in numpy.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from safetensors.torch import save as to_bytes
from torch import Tensor, nn

from data_module.files import write_bytes, write_text
from data_module.types import Samples
from gesticulator.face.lips import AFTER, BANDS, BEFORE, HIDDEN, HOP, ROWS, STACKED, Rows, front_end
from gesticulator.face.visemes import SILENT, VISEMES
from gesticulator_performer.face.known_phones import FLITE, LANGUAGES, VARIANTS, synthetic

WEIGHTS, RECORD = "visemes.safetensors", "face.json"
# Frames of a training sequence: 4.8 s.
_LENGTH = 240
# Decibels per unit of natural logarithm of power.
_NATURAL = 4.342944819
_FLOOR = float(np.log(1e-8))


@dataclass(frozen=True)
class FaceTraining:
    """Settings of the training. minutes: synthetic speech; rate: peak learning rate; closed: weight of the frames of p,
    b and m in the loss, and of f and v."""

    minutes: float = 80.0
    epochs: int = 14
    batch: int = 16
    rate: float = 3e-3
    closed: float = 1.6
    seed: int = 1


@dataclass(frozen=True)
class LabelledRows:
    """A stretch of speech: rows [2 T, WIDTH] of `rows_of`, visemes [T] with -1 for unknown."""

    rows: Rows
    labels: NDArray[np.int64]


def rows_of(samples: Samples) -> Rows:
    """[2 T, WIDTH] rows of T whole frames of a recording at 16 kHz, all at once (for training)."""
    frames = len(samples) // (ROWS * HOP)
    rows = front_end(frames * ROWS).rows(samples[None, :frames * ROWS * HOP])[0]
    return np.ascontiguousarray(np.concatenate([rows[:, :BANDS], rows[:, -1:]], axis=1))


def stacked(rows: Rows) -> Rows:
    """[T, STACKED] the rows around each frame, from [2 T, WIDTH]; the first and the last row are repeated."""
    padded = np.pad(rows, ((BEFORE, AFTER), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, BEFORE + ROWS + AFTER, axis=0)[::ROWS]
    return np.ascontiguousarray(windows.transpose(0, 2, 1).reshape(len(windows), STACKED))


class VisemeNet(nn.Module):
    """Frames [B, T, STACKED] to logits [B, T, 15]."""

    mean: Tensor
    deviation: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(STACKED))
        self.register_buffer("deviation", torch.ones(STACKED))
        self.enter = nn.Linear(STACKED, HIDDEN)
        self.memory = nn.GRU(HIDDEN, HIDDEN, batch_first=True)
        self.leave = nn.Linear(2 * HIDDEN, len(VISEMES))

    def forward(self, frames: Tensor) -> Tensor:
        entered = F.relu(self.enter((frames - self.mean) / self.deviation))
        remembered, _ = self.memory(entered)
        out: Tensor = self.leave(torch.cat([entered, remembered], dim=-1))
        return out

    def loss(self, frames: Tensor, labels: Tensor, closed: float = 1.0) -> Tensor:
        """Cross-entropy of the labels [B, T], -1 for unknown ones. closed: weight of the shapes that must be seen to
        close, PP and FF."""
        weights = torch.ones(len(VISEMES))
        weights[[VISEMES.index("PP"), VISEMES.index("FF")]] = closed
        return F.cross_entropy(self(frames).flatten(0, 1), labels.flatten(), weights, ignore_index=-1,
                               label_smoothing=0.05)


def sequences(recordings: Sequence[LabelledRows]) -> list[LabelledRows]:
    """Pieces of `_LENGTH` frames; the last piece of a recording overlaps the one before, a short one is whole."""
    out = []
    for one in recordings:
        count = len(one.labels)
        for first in range(0, max(count - _LENGTH // 4, 1), _LENGTH):
            at = min(first, max(count - _LENGTH, 0))
            out.append(LabelledRows(one.rows[2 * at:2 * (at + _LENGTH)], one.labels[at:at + _LENGTH]))
    return out


def augmented(rows: Rows, rng: np.random.Generator) -> Rows:
    """The rows as another microphone, level and room noise would give them."""
    out = rows.astype(np.float64)
    bands = out.shape[1] - 1
    height = np.linspace(-1, 1, bands)
    gain = rng.uniform(-12, 12) / _NATURAL
    tilt = rng.normal(0, 1.2) * height + rng.normal(0, 0.6) * (2 * height**2 - 1)
    tilt += np.convolve(rng.normal(0, 0.8, bands + 4), np.ones(5) / 5, "valid")
    out[:, :bands] += tilt + gain
    out[:, bands] += gain
    loud = float(np.percentile(out[:, bands], 90))
    noise = loud - rng.uniform(12, 50) / _NATURAL
    spectrum = noise - 1.0 + rng.normal(0, 1.0) * height + rng.normal(0, 0.5, (len(out), bands))
    out[:, :bands] = np.logaddexp(out[:, :bands], spectrum)
    out[:, bands] = np.logaddexp(out[:, bands], noise)
    return np.maximum(out, _FLOOR).astype(np.float32)


def with_long_pause(piece: LabelledRows, rng: np.random.Generator) -> LabelledRows:
    """The piece, cut to its length, with one of its silences lasting 0.5 to 3 s longer, and in half of the cases a
    breath in it: a broad hump of noise 10 to 30 dB over the silence. The piece itself if it has no silence of 80 ms."""
    quiet = np.concatenate([[0], piece.labels == SILENT, [0]]).astype(int)
    edges = np.flatnonzero(np.diff(quiet)).reshape(-1, 2)
    edges = edges[edges[:, 1] - edges[:, 0] >= 4]
    if not len(edges):
        return piece
    start, end = rng.choice(edges)
    extra = int(rng.integers(25, 150))
    pick = start + rng.integers(0, end - start, extra)
    rows = piece.rows.reshape(-1, 2, piece.rows.shape[1])
    pause = rows[pick]
    if rng.random() < 0.5:
        size = min(int(rng.integers(8, 30)), extra)
        at = int(rng.integers(0, extra - size + 1))
        hump = rng.uniform(10, 30) / _NATURAL * np.hanning(size)
        shape = np.exp(-0.5 * ((np.linspace(0, 1, rows.shape[2] - 1) - rng.uniform(0.3, 0.9)) / 0.35) ** 2)
        pause[at:at + size, :, :-1] += (hump[:, None] * shape)[:, None]
        pause[at:at + size, :, -1] += 0.8 * hump[:, None]
    count = len(piece.labels)
    longer = np.concatenate([rows[:end], pause, rows[end:]])[:count]
    labels = np.concatenate([piece.labels[:end], np.full(extra, SILENT), piece.labels[end:]])[:count]
    return LabelledRows(longer.reshape(-1, rows.shape[2]).astype(np.float32), labels)


def fit(recordings: Sequence[LabelledRows], settings: FaceTraining, quiet: bool = True) -> VisemeNet:
    """The trained network. The same recordings and settings give the same weights on one machine."""
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    pieces = sequences(recordings)
    net = VisemeNet()
    seen = np.concatenate([stacked(augmented(piece.rows, rng)) for piece in pieces[::6]])
    net.mean.copy_(torch.from_numpy(seen.mean(0)))
    net.deviation.copy_(torch.from_numpy(seen.std(0) + 1e-3))
    steps = settings.epochs * max(len(pieces) // settings.batch, 1)
    optimiser = torch.optim.AdamW(net.parameters(), settings.rate, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.rate, total_steps=steps, pct_start=0.1)
    total = 0.0
    for step, (frames, labels) in enumerate(_batches(pieces, settings, steps, rng)):
        loss = net.loss(torch.from_numpy(frames), torch.from_numpy(labels), settings.closed)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        total += loss.item()
        if not quiet and (step + 1) % 100 == 0:
            print(f"step {step + 1} of {steps}: loss {total / 100:.3f}", flush=True)
            total = 0.0
    return net.eval()


def _batches(pieces: Sequence[LabelledRows], settings: FaceTraining, steps: int, rng: np.random.Generator
             ) -> Iterator[tuple[Rows, NDArray[np.int64]]]:
    order: list[int] = []
    for _ in range(steps):
        if len(order) < settings.batch:
            order = rng.permutation(len(pieces)).tolist()
        frames = np.zeros((settings.batch, _LENGTH, STACKED), np.float32)
        labels = np.full((settings.batch, _LENGTH), -1, np.int64)
        for place, number in enumerate(order[:settings.batch]):
            piece = pieces[number] if rng.random() < 0.6 else with_long_pause(pieces[number], rng)
            frames[place, :len(piece.labels)] = stacked(augmented(piece.rows, rng))
            labels[place, :len(piece.labels)] = piece.labels
        del order[:settings.batch]
        yield frames, labels


def recordings_of(settings: FaceTraining) -> list[LabelledRows]:
    """Synthetic speech with its visemes."""
    out = []
    for samples, labels in synthetic(np.random.default_rng(settings.seed), 60.0 * settings.minutes):
        rows = rows_of(samples)
        count = min(len(rows) // 2, len(labels))
        out.append(LabelledRows(rows[:2 * count], labels[:count]))
    return out


def save(net: VisemeNet, settings: FaceTraining, out: Path) -> None:
    """Write the weights and their record, each atomically."""
    weights = to_bytes({name: value.contiguous() for name, value in net.state_dict().items()})
    record = {
        "format": 1, "visemes": list(VISEMES), "settings": asdict(settings),
        "sha256": {WEIGHTS: hashlib.sha256(weights).hexdigest()},
        "data": {"espeak-ng": {language: list(voices) for language, voices in LANGUAGES.items()},
                 "espeak-ng timbres": list(VARIANTS), "flite": list(FLITE)},
        "licence": "GPL-3.0-or-later; trained on synthetic speech",
    }
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / WEIGHTS, weights)
    write_text(out / RECORD, json.dumps(record, indent=1) + "\n")
