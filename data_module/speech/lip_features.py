"""The sound as the lips network takes it: log-mel energies and loudness, 100 rows a second, while the sound arrives.

The rows are those of `MelFrontEnd` at hops of 10 ms. A frame of 20 ms gets the rows around it, `BEFORE` before its
first and `AFTER` after its last, so that the network needs `LOOK_AHEAD` seconds of sound beyond the middle of a frame.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_module.speech.front_ends import MelFrontEnd
from data_module.types import Samples

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
