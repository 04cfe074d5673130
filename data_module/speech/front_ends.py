"""Front ends: two levels of audio features per motion frame, behind one interface.

The input is a fixed window per block (previous, current, next), stretched to normalised time, so a stream and a file
give the same features. There are mel energies, and learned front ends: levels of the speech encoder, or hidden layers
of a model of transformers. Networks normalise their input, so learned features do not contain loudness; both levels
therefore get two columns of the mel front end, onset strength and loudness. `front_end` builds them by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.speech.silence import TYPICAL_LEVEL
from data_module.speech.speech_encoder import HIGH, LEVELS, LOW, SpeechEncoder, load_fairseq
from data_module.types import Array, Samples

Features = NDArray[np.float32]

_BATCH = 256
_EARLY, _LATE = 1, 0.75  # hidden layers of a transformer: the first, and three quarters up
_LEVEL_COLUMNS = 2
_FLOOR = 1e-8
"""Least power under a logarithm."""
_ROBUST_TOP, _ROBUST_FLOOR = 7000.0, 1e-5
"""Hertz at which the bands of a robust front end end, and the power that it adds under a logarithm: 30 dB under the
typical level."""


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
    def width_low(self) -> int:
        return self.bands + 2

    @property
    def width_high(self) -> int:
        return self.width_low

    @cached_property
    def _filters(self) -> Features:
        """[window / 2 + 1, bands]: power of a spectrum to mean power per band; white noise of RMS r gives r^2."""
        import librosa

        bank = librosa.filters.mel(sr=self.sample_rate, n_fft=self._window, n_mels=self.bands, norm=None,
                                   fmax=_ROBUST_TOP if self.robust else None)
        scale = np.maximum(bank.sum(axis=1, keepdims=True), 1e-6) * np.sum(self._taper.astype(np.float64) ** 2)
        return np.ascontiguousarray((bank / scale).T, dtype=np.float32)

    @property
    def _window(self) -> int:
        return 2 * round(0.032 * self.sample_rate)

    @cached_property
    def _taper(self) -> Features:
        return np.hanning(self._window + 1)[:-1].astype(np.float32)

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        """See `FrontEnd.encode`. Without a reference the recording is not scaled."""
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
        # A spectrum is centred on its hop, so that the rows of a block cover the block.
        at = np.lib.stride_tricks.sliding_window_view(padded, self._window, axis=1)
        at = at[:, [round((k + 0.5) * self.samples_per_frame / self.hops) for k in range(spectra)]]
        spectrum = rfft(at * self._taper, axis=-1)
        power = (spectrum.real ** 2 + spectrum.imag ** 2) @ self._filters
        logs = self._log(power)
        rise = np.maximum(np.diff(logs, axis=1, prepend=logs[:, :1]), 0.0).mean(axis=-1)
        energy = windows.reshape(count, self.frames, -1)
        energy = np.einsum("nfs,nfs->nf", energy, energy) / self.samples_per_frame
        return np.concatenate([
            logs.reshape(count, self.frames, self.hops, self.bands).mean(axis=2),
            rise.reshape(count, self.frames, self.hops).max(axis=2)[..., None],
            self._log(energy)[..., None]], axis=-1)

    def _log(self, power: Features) -> Features:
        return np.log(power + np.float32(_ROBUST_FLOOR) if self.robust else np.maximum(power, np.float32(_FLOOR)))


def scaled_windows(windows: Samples, reference: Array | None, length: int, batch: int
                   ) -> Iterator[tuple[slice, Samples]]:
    """Windows [N, length] in parts of `batch`, brought from their reference level [N] to the typical one."""
    if windows.ndim != 2 or windows.shape[1] != length:
        raise ValueError(f"windows {windows.shape} are not [N, {length}]")
    gain = np.zeros(len(windows)) if reference is None else np.asarray(reference) - TYPICAL_LEVEL
    for start in range(0, len(windows), batch):
        part = slice(start, start + batch)
        yield part, windows[part] * (10.0 ** (-gain[part, None] / 20.0)).astype(np.float32)


# ---------------------------------------------------------------------------------------------------- learned

@dataclass(frozen=True)
class LearnedFrontEnd:
    """A network's two levels per motion frame, each followed by onset strength and loudness. states: scaled windows [n,
    T] to the low and the high level, [n, frames, d]. widths: the two d. mel: gives the two further columns, and the
    size of a window. batch: windows at a time (few, so that they stay in the cache)."""

    name: str
    widths: tuple[int, int]
    mel: MelFrontEnd = field(repr=False)
    states: Callable[[Tensor], tuple[Tensor, Tensor]] = field(repr=False)
    batch: int = 4

    @property
    def width_low(self) -> int:
        return self.widths[0] + _LEVEL_COLUMNS

    @property
    def width_high(self) -> int:
        return self.widths[1] + _LEVEL_COLUMNS

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        mel, count = self.mel, len(windows)
        low, high = (np.empty((count, mel.frames, width), np.float32) for width in (self.width_low, self.width_high))
        for part, scaled in scaled_windows(windows, reference, mel.frames * mel.samples_per_frame, self.batch):
            with torch.inference_mode():
                states = self.states(torch.from_numpy(scaled))
            columns: Features = mel.rows(scaled)[..., -_LEVEL_COLUMNS:]
            for out, state in zip((low, high), states, strict=True):
                out[part] = np.concatenate([state.cpu().numpy(), columns], axis=-1)
        return AudioFeatures(low, high)


def encoder_front_end(encoder: SpeechEncoder, mel: MelFrontEnd, layers: Sequence[int] | None = None, *,
                      name: str = "vqwav2vec") -> LearnedFrontEnd:
    low, high = _two(layers or (LOW, HIGH), 1, LEVELS)
    _same_rate(16000, mel)

    def states(samples: Tensor) -> tuple[Tensor, Tensor]:
        weights = next(encoder.parameters())
        first, second = encoder.levels(samples.to(weights.device), mel.frames, (low, high))
        return first, second

    encoder.eval()
    return LearnedFrontEnd(name, (encoder.config.width, encoder.config.width), mel, states)


def transformers_front_end(model_name: str, mel: MelFrontEnd, layers: Sequence[int] | None = None) -> LearnedFrontEnd:
    """Two hidden layers of a speech model that takes samples (wav2vec 2.0, HuBERT, WavLM and their kin).

    model_name: a folder, or the name of a model in the cache of transformers; nothing is downloaded. layers: 0 is the
    input of the first layer; by default the first and one at three quarters of the depth. InputError if the model is
    missing or does not take samples.
    """
    subject = f"hf:{model_name}"
    model, normalise, rate = _open(model_name, subject)
    _same_rate(rate, mel)

    def hidden(samples: Tensor) -> Sequence[Tensor]:
        if normalise:
            spread, mean = torch.var_mean(samples, dim=-1, keepdim=True, correction=0)
            samples = (samples - mean) / torch.sqrt(spread + 1e-7)
        return model(samples, output_hidden_states=True).hidden_states

    try:
        with torch.inference_mode():
            layers_found = hidden(torch.zeros(1, mel.frames * mel.samples_per_frame))
        widths = [state.shape[2] for state in layers_found]
    except (RuntimeError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise InputError(subject, f"gives no hidden layers for samples ({type(error).__name__})",
                         "name a model like wav2vec 2.0, HuBERT or WavLM") from None
    low, high = _two(layers or (_EARLY, max(_EARLY, round(_LATE * (len(layers_found) - 1)))), 0, len(layers_found) - 1)

    def states(samples: Tensor) -> tuple[Tensor, Tensor]:
        every = hidden(samples)
        first, second = (F.adaptive_avg_pool1d(every[layer].transpose(1, 2), mel.frames).transpose(1, 2)
                         for layer in (low, high))
        return first, second

    return LearnedFrontEnd(subject, (widths[low], widths[high]), mel, states)


def _two(layers: Sequence[int], least: int, most: int) -> tuple[int, int]:
    if len(layers) != 2 or not all(least <= layer <= most for layer in layers):
        raise InputError("front_end.layers", f"is {list(layers)}", f"give two numbers from {least} to {most}")
    return layers[0], layers[1]


def _same_rate(rate: int, mel: MelFrontEnd) -> None:
    if rate != mel.sample_rate:
        raise InputError("front end", f"wants sound at {rate} Hz, not {mel.sample_rate}", "choose another")


def _open(name: str, subject: str) -> tuple[Any, bool, int]:
    """The model in evaluation mode, whether it wants each window at mean 0 and spread 1, and its sample rate."""
    from transformers import AutoFeatureExtractor, AutoModel

    from data_module.text.word_vectors import quiet_transformers

    advice = "give a folder that holds it, or fetch it first (hf download NAME)"
    with quiet_transformers():
        try:
            model = AutoModel.from_pretrained(name, local_files_only=True)
        except (OSError, ValueError, KeyError, RuntimeError, ImportError) as error:
            there = Path(name).is_dir()
            wrong = f"is not a model that transformers can load ({type(error).__name__})" if there else \
                "is not on this machine"
            raise InputError(subject, wrong, advice) from error
        if getattr(model, "main_input_name", "") != "input_values" or model.config.is_encoder_decoder:
            raise InputError(subject, "does not take samples", "name a model like wav2vec 2.0, HuBERT or WavLM")
        try:
            extractor = AutoFeatureExtractor.from_pretrained(name, local_files_only=True)
        except (OSError, ValueError, KeyError):  # a model saved without its preprocessing takes samples as they are
            return model.eval().float(), False, 16000
    return model.eval().float(), bool(getattr(extractor, "do_normalize", False)), int(extractor.sampling_rate)



# ---------------------------------------------------------------------------------------------------- by name

def _vqwav2vec(mel: MelFrontEnd, encoder: SpeechEncoder | None, layers: Sequence[int] | None) -> FrontEnd:
    if encoder is None:
        raise InputError("front end 'vqwav2vec'", "needs a trained speech encoder", "use a bundle that has one")
    return encoder_front_end(encoder, mel, layers)


FRONT_ENDS: dict[str, Callable[[MelFrontEnd, SpeechEncoder | None, Sequence[int] | None], FrontEnd]] = {
    "mel": lambda mel, encoder, layers: mel, "vqwav2vec": _vqwav2vec}
"""Front ends by name."""


def front_end(name: str, mel: MelFrontEnd, *, encoder: SpeechEncoder | None = None,
              layers: Sequence[int] | None = None) -> FrontEnd:
    """A front end by name: one of `FRONT_ENDS`, "fairseq:PATH" or "hf:NAME" (a folder or a cached model).

    mel: the mel front end, of which a learned one uses the sizes, the onsets and the loudness. encoder: for
    "vqwav2vec". layers: those of the low and the high level; None for the default. InputError for an unknown name or a
    missing model.
    """
    if name in FRONT_ENDS:
        return FRONT_ENDS[name](mel, encoder, layers)
    kind, _, where = name.partition(":")
    if not where or kind not in ("fairseq", "hf"):
        raise InputError("front end", f"there is no {name!r}",
                         f"choose from {', '.join(FRONT_ENDS)}, fairseq:PATH, hf:NAME_OR_FOLDER")
    if kind == "hf":
        return transformers_front_end(where, mel, layers)
    return encoder_front_end(load_fairseq(where), mel, layers, name=name)
