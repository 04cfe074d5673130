"""The lips network: from the sound around a frame of 20 ms to the weights of 15 visemes.

A linear layer over the stacked mel rows, a gated recurrent unit that remembers voice, level and noise, and a softmax.
`VisemeNet` is trained on whole recordings; `VisemeStepper` runs the same weights frame by frame in numpy, so that a
file and a stream give the same bits, and takes about a tenth of a millisecond per frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from data_module.speech.front_ends import MelFrontEnd
from data_module.types import Samples
from gesticulator.face.visemes import VISEMES

RATE = 50
"""Frames of the network per second; frame k is centred at (k + 0.5) / RATE."""
SAMPLE_RATE = 16000
BANDS = 32
WIDTH = BANDS + 1
"""Values of a row: the bands and the loudness, natural logarithms of power."""
_HOP, _ROWS, _CONTEXT = 160, 2, 3
"""Samples of a row, rows of a frame, and rows of sound on either side that the windows of 64 ms reach into."""
BEFORE, AFTER = 4, 4
STACKED = (BEFORE + _ROWS + AFTER) * WIDTH
"""Values of a frame."""
LOOK_AHEAD = (_ROWS / 2 + AFTER + _CONTEXT) * _HOP / SAMPLE_RATE
"""Seconds of sound after the middle of a frame that it depends on."""

Rows = NDArray[np.float32]


@lru_cache(maxsize=2)
def _front_end(rows: int) -> MelFrontEnd:
    return MelFrontEnd(BANDS, rows, _HOP, SAMPLE_RATE, hops=1)


def rows_of(samples: Samples) -> Rows:
    """[2 T, WIDTH] rows of T whole frames of a recording at 16 kHz, all at once (for training)."""
    frames = len(samples) // (_ROWS * _HOP)
    rows = _front_end(frames * _ROWS).rows(samples[None, :frames * _ROWS * _HOP])[0]
    return np.ascontiguousarray(np.concatenate([rows[:, :BANDS], rows[:, -1:]], axis=1))


def stacked(rows: Rows) -> Rows:
    """[T, STACKED] the rows around each frame, from [2 T, WIDTH]; the first and the last row are repeated."""
    padded = np.pad(rows, ((BEFORE, AFTER), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, BEFORE + _ROWS + AFTER, axis=0)[::_ROWS]
    return np.ascontiguousarray(windows.transpose(0, 2, 1).reshape(len(windows), STACKED))


class LipFeatures:
    """Streamed sound to frames [STACKED], one at a time and always by the same operations, so that the numbers do not
    depend on the sizes of the pieces. Before the first sample there is silence."""

    def __init__(self) -> None:
        self._sound = np.zeros(_CONTEXT * _HOP, np.float32)
        self._rows: list[Rows] = []

    def feed(self, samples: Samples) -> list[Rows]:
        """The frames that `samples` at 16 kHz complete."""
        self._sound = np.concatenate([self._sound, samples])
        out: list[Rows] = []
        step, size = _ROWS * _HOP, (_ROWS + 2 * _CONTEXT) * _HOP
        while len(self._sound) >= size:
            self._add(self._sound[:size])
            self._sound = self._sound[step:]
            if len(self._rows) == BEFORE + _ROWS + AFTER:
                out.append(np.concatenate(self._rows))
                del self._rows[:_ROWS]
        return out

    def flush(self) -> list[Rows]:
        """The remaining frames of the sound that was fed, as if silence followed."""
        return self.feed(np.zeros((_ROWS - 1 + AFTER + _CONTEXT) * _HOP, np.float32))

    def _add(self, sound: Samples) -> None:
        rows = _framed(sound)
        if not self._rows:
            self._rows = [rows[0]] * BEFORE
        self._rows += [rows[0], rows[1]]


def _framed(sound: Samples) -> Rows:
    """[2, WIDTH] rows of one frame, from its samples and `_CONTEXT` rows of sound on either side."""
    rows = _front_end(_ROWS + 2 * _CONTEXT).rows(sound[None])[0, _CONTEXT:_CONTEXT + _ROWS]
    return np.concatenate([rows[:, :BANDS], rows[:, -1:]], axis=1)


HIDDEN = 112
"""Width of both layers: 124,000 weights, 0.5 MB."""

Weights = Mapping[str, NDArray[np.float32]]


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


class VisemeStepper:
    """The weights of a `VisemeNet` applied to one frame after the other."""

    def __init__(self, weights: Weights) -> None:
        """weights: the state of a `VisemeNet`, as arrays."""
        scale = 1.0 / weights["deviation"]
        self._enter = weights["enter.weight"] * scale
        self._enter_bias = weights["enter.bias"] - self._enter @ weights["mean"]
        self._input, self._input_bias = weights["memory.weight_ih_l0"], weights["memory.bias_ih_l0"]
        self._recurrent, self._recurrent_bias = weights["memory.weight_hh_l0"], weights["memory.bias_hh_l0"]
        self._leave, self._leave_bias = weights["leave.weight"], weights["leave.bias"]
        self._state = np.zeros(self._recurrent.shape[1], np.float32)

    def reset(self) -> None:
        """Forget the sound so far."""
        self._state = np.zeros_like(self._state)

    def __call__(self, frame: NDArray[np.float32]) -> NDArray[np.float32]:
        """[15] weights of the visemes, summing to 1, of the next frame [STACKED]."""
        entered = np.maximum(self._enter @ frame + self._enter_bias, 0.0)
        size = len(self._state)
        # The gates of torch's GRU: reset and update, then the new state, whose memory part the reset gate weighs.
        inputs = self._input @ entered + self._input_bias
        memory = self._recurrent @ self._state + self._recurrent_bias
        gates = _sigmoid(inputs[:2 * size] + memory[:2 * size])
        new = np.tanh(inputs[2 * size:] + gates[:size] * memory[2 * size:])
        self._state = new + gates[size:] * (self._state - new)
        logits = self._leave @ np.concatenate([entered, self._state]) + self._leave_bias
        powers = np.exp(logits - logits.max())
        return np.asarray(powers / powers.sum(), dtype=np.float32)


def _sigmoid(x: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)), dtype=np.float32)
