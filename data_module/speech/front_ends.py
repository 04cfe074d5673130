"""Front ends: two levels of audio features per motion frame, behind one interface.

The input is a fixed window per block (previous, current, next), stretched to normalised time, so a stream and a file
give the same features. Mel energies and the settings of the speech encoder are here, the networks in
`data_module.speech.learned_front_ends`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_module.settings import Width
from data_module.speech.mel import mel_bands
from data_module.speech.silence import TYPICAL_LEVEL
from data_module.types import Array, Samples

Features = NDArray[np.float32]

_BATCH = 256
# Least power under a logarithm.
_FLOOR = 1e-8
# Hertz at which the bands of a robust front end end, and the power that it adds under a logarithm: 30 dB under the
# typical level.
_ROBUST_TOP, _ROBUST_FLOOR = 7000.0, 1e-5


@dataclass(frozen=True)
class AudioFeatures:
    """Features per motion frame of each window. low: [N, 3K, d_low] the sound; high: [N, 3K, d_high] its content."""

    low: Features
    high: Features


class FrontEnd(Protocol):
    """Converts windows of sound to `AudioFeatures`."""

    @property
    def name(self) -> str:
        """Name in bundles and commands."""

    @property
    def width(self) -> int:
        """d_low, which is d_high, too."""

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        """Windows [N, 3 * K * samples_per_frame] to levels; reference: [N] dBFS from `reference_level`, or None."""


@dataclass(frozen=True)
class MelFrontEnd:
    """Log-mel energies, onset strength and loudness per motion frame; the low and the high level are the same.

    bands: mel bands up to half the sample rate. frames: rows per window (3K). samples_per_frame: as the blocks have
    it. Each row is pooled from `hops` spectra of 64 ms. Width: bands + 2; values are natural logarithms of power, the
    onset strength their mean rise since the previous spectrum. Windows are not normalised, because loudness carries
    style; `reference` removes the gain of the microphone.

    Resampling and compression change what lies near half the sample rate, and faint noise what lies between the words.
    With `robust` the bands end at 7 kHz, and a power p counts as log(p + floor), so that what is well below the floor
    is not heard and nothing changes suddenly where the sound crosses it. In ten recordings the features of a resampled
    sound are then .001 of their deviation from those of the original instead of .038, and with noise at -60 dB .05
    instead of .41.
    """

    bands: int = 32
    frames: int = 30
    samples_per_frame: int = 800
    sample_rate: int = 16000
    hops: int = 2
    robust: bool = False

    @property
    def name(self) -> str:
        return "mel"

    @property
    def width(self) -> int:
        return self.bands + 2

    @cached_property
    def _filters(self) -> Features:
        """[window / 2 + 1, bands]: power of a spectrum to mean power per band; white noise of RMS r gives r^2."""
        bank = mel_bands(self.sample_rate, self._window, self.bands, _ROBUST_TOP if self.robust else None,
                         equal_area=False)
        scale = np.maximum(bank.sum(axis=1, keepdims=True), 1e-6) * np.sum(self._taper.astype(np.float64) ** 2)
        return np.ascontiguousarray((bank / scale).T, dtype=np.float32)

    @cached_property
    def _window(self) -> int:
        return 2 * round(0.032 * self.sample_rate)

    @cached_property
    def _taper(self) -> Features:
        return np.hanning(self._window + 1)[:-1].astype(np.float32)

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        """See `FrontEnd.encode`. Without a reference the recording is not scaled."""
        out = np.empty((len(windows), self.frames, self.width), np.float32)
        for part, scaled in scaled_windows(windows, reference, _BATCH):
            out[part] = self.rows(scaled)
        return AudioFeatures(out, out)

    def rows(self, windows: Samples) -> Features:
        """[n, frames, bands + 2] of windows [n, samples]; the last two columns are onset strength and loudness."""
        count, length = windows.shape
        padded = np.zeros((count, length + self._window), np.float32)
        padded[:, self._window // 2:self._window // 2 + length] = windows
        # A spectrum is centred on its hop, so that the rows of a block cover the block.
        starts = [round((k + 0.5) * self.samples_per_frame / self.hops) for k in range(self.frames * self.hops)]
        at = np.lib.stride_tricks.sliding_window_view(padded, self._window, axis=1)[:, starts]
        spectrum = np.fft.rfft(at * self._taper, axis=-1)
        power = (spectrum.real ** 2 + spectrum.imag ** 2) @ self._filters
        logs = self._log(power.astype(np.float32, copy=False))  # it is, and NumPy does not say so
        # Only rises count, as in `onsets`; the first spectrum has nothing before it and rises by 0.
        rise = np.maximum(np.diff(logs, axis=1, prepend=logs[:, :1]), 0.0).mean(axis=-1)
        energy = windows.reshape(count, self.frames, -1)
        energy = np.einsum("nfs,nfs->nf", energy, energy) / self.samples_per_frame
        return np.concatenate([
            logs.reshape(count, self.frames, self.hops, self.bands).mean(axis=2),
            rise.reshape(count, self.frames, self.hops).max(axis=2)[..., None],
            self._log(energy)[..., None]], axis=-1)

    def _log(self, power: Features) -> Features:
        return np.log(power + np.float32(_ROBUST_FLOOR) if self.robust else np.maximum(power, np.float32(_FLOOR)))


def scaled_windows(windows: Samples, reference: Array | None, batch: int) -> Iterator[tuple[slice, Samples]]:
    """Windows [N, samples] in parts of `batch`, brought from their reference level [N] to the typical one."""
    gain = np.zeros(len(windows)) if reference is None else np.asarray(reference) - TYPICAL_LEVEL
    for start in range(0, len(windows), batch):
        part = slice(start, start + batch)
        yield part, windows[part] * (10.0 ** (-gain[part, None] / 20.0)).astype(np.float32)


@dataclass(frozen=True)
class EncoderConfig:
    """Size of the speech encoder."""

    width: Width = 512
    """Channels of every convolution, d_a = d_A."""
