"""What the models hear: sound turned into two levels of features per motion frame, behind one interface.

A front end sees one fixed window per block (previous, current, next), stretched to normalised time, so a stream and a
file give the same features.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.speech.silence import FRAME, frame_levels, silent_frames
from data_module.types import Array, Samples

Features = NDArray[np.float32]

TYPICAL_LEVEL = -26.0
"""dBFS: the mean level of the loud frames of speech recorded as it should be (active level about -23)."""
_PRIOR, _MEMORY = 5.0, 30.0
_BATCH = 256
_LEAST_SPREAD = 1e-4


@dataclass(frozen=True)
class Normaliser:
    """Zero mean and unit spread per dimension, fitted once and kept with the model.

    mean, spread: [D]. A dimension that never moves has spread 1, so it becomes 0 and comes back exactly.
    """

    mean: Array
    spread: Array

    @classmethod
    def fit(cls, values: NDArray[np.floating], mask: NDArray[np.bool_] | None = None) -> Normaliser:
        """From values [..., D]; `mask` [...] picks the rows that count."""
        rows = values[mask] if mask is not None else values.reshape(-1, values.shape[-1])
        if len(rows) == 0:
            raise ValueError("a normaliser needs a row at least")
        mean = rows.mean(axis=0, dtype=np.float64)
        spread = rows.std(axis=0, dtype=np.float64)
        return cls(mean, np.where(spread > _LEAST_SPREAD, spread, 1.0))

    def apply(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """(x - mean) / spread in the type of `values`, [..., D]."""
        return ((values - self.mean) / self.spread).astype(values.dtype)

    def invert(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """The inverse of `apply`."""
        return (values * self.spread + self.mean).astype(values.dtype)

    def to_dict(self) -> dict[str, Array]:
        """The arrays to store."""
        return {"mean": self.mean, "spread": self.spread}

    @classmethod
    def from_dict(cls, arrays: Mapping[str, Array]) -> Normaliser:
        """The inverse of `to_dict`; KeyError or ValueError where the arrays are not a normaliser's."""
        mean, spread = (np.asarray(arrays[name], dtype=np.float64) for name in ("mean", "spread"))
        if mean.ndim != 1 or mean.shape != spread.shape or not (spread > 0).all():
            raise ValueError("mean and spread must be [D], spread positive")
        return cls(mean, spread)


@dataclass(frozen=True)
class AudioFeatures:
    """Features per motion frame of each window. low: [N, 3K, d_low] the sound; high: [N, 3K, d_high] its content."""

    low: Features
    high: Features


class FrontEnd(Protocol):
    """Anything that turns windows of sound into `AudioFeatures`."""

    @property
    def name(self) -> str:
        """What bundles and commands call it."""

    @property
    def width_low(self) -> int:
        """d_low."""

    @property
    def width_high(self) -> int:
        """d_high."""

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        """Windows [N, 3 * K * samples_per_frame] to levels; reference: [N] dBFS from `reference_level`, or None."""


@dataclass(frozen=True)
class MelFrontEnd:
    """Log-mel energies, onset strength and loudness per motion frame; the low and the high level are the same.

    bands: mel bands up to half the sample rate. frames: rows per window (3K). samples_per_frame: as the blocks have
    it. Each row is pooled from `hops` spectra of 64 ms. Width: bands + 2; values are natural logarithms of power, the
    onset strength their mean rise since the spectrum before. Levels are kept, not normalised per window: how loud a
    phrase is carries its style. `reference` takes off what the microphone did.
    """

    bands: int = 32
    frames: int = 30
    samples_per_frame: int = 800
    sample_rate: int = 16000
    hops: int = 2
    floor: float = 1e-8

    @property
    def name(self) -> str:
        return "mel"

    @property
    def width_low(self) -> int:
        return self.bands + 2

    @property
    def width_high(self) -> int:
        return self.width_low

    @cached_property
    def _filters(self) -> Features:
        """[window / 2 + 1, bands]: power of a spectrum to mean power per band; white noise of RMS r gives r^2."""
        import librosa

        bank = librosa.filters.mel(sr=self.sample_rate, n_fft=self._window, n_mels=self.bands, norm=None)
        scale = np.maximum(bank.sum(axis=1, keepdims=True), 1e-6) * np.sum(self._taper.astype(np.float64) ** 2)
        return np.ascontiguousarray((bank / scale).T, dtype=np.float32)

    @property
    def _window(self) -> int:
        return 2 * round(0.032 * self.sample_rate)

    @cached_property
    def _taper(self) -> Features:
        return np.hanning(self._window + 1)[:-1].astype(np.float32)

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        """See `FrontEnd.encode`. Without a reference the recording is taken as it is."""
        out = np.empty((len(windows), self.frames, self.width_low), np.float32)
        for part, scaled in scaled_windows(windows, reference, self.frames * self.samples_per_frame, _BATCH):
            out[part] = self.rows(scaled)
        return AudioFeatures(out, out)

    def rows(self, windows: Samples) -> Features:
        """[n, frames, bands + 2] of windows [n, samples]; the last two columns are onset strength and loudness."""
        from scipy.fft import rfft

        count, length = windows.shape
        padded = np.zeros((count, length + self._window), np.float32)
        padded[:, self._window // 2:self._window // 2 + length] = windows
        spectra = self.frames * self.hops
        # A spectrum belongs to the middle of its hop, so that the rows of a block hold the block.
        at = np.lib.stride_tricks.sliding_window_view(padded, self._window, axis=1)
        at = at[:, [round((k + 0.5) * self.samples_per_frame / self.hops) for k in range(spectra)]]
        spectrum = rfft(at * self._taper, axis=-1)
        power = (spectrum.real ** 2 + spectrum.imag ** 2) @ self._filters
        logs = np.log(np.maximum(power, self.floor))
        rise = np.maximum(np.diff(logs, axis=1, prepend=logs[:, :1]), 0.0).mean(axis=-1)
        energy = windows.reshape(count, self.frames, -1)
        energy = np.einsum("nfs,nfs->nf", energy, energy) / self.samples_per_frame
        return np.concatenate([
            logs.reshape(count, self.frames, self.hops, self.bands).mean(axis=2),
            rise.reshape(count, self.frames, self.hops).max(axis=2)[..., None],
            np.log(np.maximum(energy, self.floor))[..., None]], axis=-1)


def scaled_windows(windows: Samples, reference: Array | None, length: int, batch: int
                   ) -> Iterator[tuple[slice, Samples]]:
    """Windows [N, length] in parts of `batch`, brought from their reference level [N] to the typical one."""
    if windows.ndim != 2 or windows.shape[1] != length:
        raise ValueError(f"windows {windows.shape} are not [N, {length}]")
    gain = np.zeros(len(windows)) if reference is None else np.asarray(reference) - TYPICAL_LEVEL
    for start in range(0, len(windows), batch):
        part = slice(start, start + batch)
        yield part, windows[part] * (10.0 ** (-gain[part, None] / 20.0)).astype(np.float32)


def reference_level(samples: Samples, sample_rate: int, edges: Array) -> Array:
    """How loud this voice in this recording generally is, in dBFS, for each block [N], as known at the block's end.

    The mean level of the frames louder than the noise, with a slow memory of 30 s of speech that starts at
    `TYPICAL_LEVEL` with the weight of 5 s. It takes off the gain of a microphone, while the effort of a phrase, which
    changes every few seconds, stays in the features.
    """
    levels = frame_levels(samples, sample_rate)
    loud = ~silent_frames(samples, sample_rate)
    total = np.concatenate([[0.0], np.cumsum(np.where(loud, levels, 0.0))])
    count = np.concatenate([[0], np.cumsum(loud)])
    last = np.clip(np.round(np.asarray(edges) / FRAME).astype(int), 0, len(levels))
    sums, seconds = np.diff(total[last]), np.diff(count[last]) * FRAME
    out = np.empty(len(last) - 1)
    level, weight = TYPICAL_LEVEL, _PRIOR
    for block, (summed, heard) in enumerate(zip(sums, seconds, strict=True)):
        level = (level * weight + summed * FRAME) / (weight + heard)
        weight = min(weight + heard, _MEMORY)
        out[block] = level
    return out
