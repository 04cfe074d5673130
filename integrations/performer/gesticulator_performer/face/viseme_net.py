"""The lips network in torch, for training on whole recordings; `gesticulator.face.lips` runs its weights in numpy."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from data_module.types import Samples
from gesticulator.face.lips import AFTER, BANDS, BEFORE, HIDDEN, HOP, ROWS, STACKED, Rows, front_end
from gesticulator.face.visemes import VISEMES


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

    def __init__(self, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(STACKED))
        self.register_buffer("deviation", torch.ones(STACKED))
        self.enter = nn.Linear(STACKED, hidden)
        self.memory = nn.GRU(hidden, hidden, batch_first=True)
        self.leave = nn.Linear(2 * hidden, len(VISEMES))

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
