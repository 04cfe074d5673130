"""Front ends that were learned: the levels of the speech encoder, or hidden layers of a model of transformers.

Both are blind to loudness, because networks normalise what they hear; so both levels get the two columns of the mel
front end that carry it, onset strength and loudness.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from data_module.errors import InputError
from data_module.speech.features import AudioFeatures, Features, MelFrontEnd, scaled_windows
from data_module.speech.speech_encoder import HIGH, LEVELS, LOW, SpeechEncoder
from data_module.types import Array, Samples

_EARLY, _LATE = 1, 0.75  # hidden layers of a transformer: the first, and three quarters up
_LEVEL_COLUMNS = 2


@dataclass(frozen=True)
class LearnedFrontEnd:
    """A network's two levels per motion frame, each followed by onset strength and loudness.

    states: scaled windows [n, T] to the low and the high level, [n, frames, d]. widths: the two d. mel: gives the two
    further columns, and the size of a window. batch: windows at a time (few, so that they stay in the cache).
    """

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
        """See `data_module.speech.features.FrontEnd.encode`."""
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
    """Levels 2 and 8 of a speech encoder, or the two that `layers` names (1 to 8)."""
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

    model_name: a folder, or a name whose files transformers has on this machine; nothing is fetched. layers: 0 is what
    enters the first layer; by default the first and one three quarters up. InputError when the model is not there or
    does not take samples.
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
            found = hidden(torch.zeros(1, mel.frames * mel.samples_per_frame))
        widths = [state.shape[2] for state in found]
    except (RuntimeError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise InputError(subject, f"gives no hidden layers for samples ({type(error).__name__})",
                         "name a model like wav2vec 2.0, HuBERT or WavLM") from None
    low, high = _two(layers or (_EARLY, max(_EARLY, round(_LATE * (len(found) - 1)))), 0, len(found) - 1)

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

    advice = "give a folder that holds it, or fetch it first (hf download NAME)"
    with _quiet():
        try:
            model = AutoModel.from_pretrained(name, local_files_only=True)
        except (OSError, ValueError, KeyError, RuntimeError, ImportError) as error:
            there = Path(name).is_dir()
            raise InputError(subject, f"is no model that transformers can load ({type(error).__name__})" if there else
                             "is not on this machine", advice) from error
        if getattr(model, "main_input_name", "") != "input_values" or model.config.is_encoder_decoder:
            raise InputError(subject, "does not take samples", "name a model like wav2vec 2.0, HuBERT or WavLM")
        try:
            extractor = AutoFeatureExtractor.from_pretrained(name, local_files_only=True)
        except (OSError, ValueError, KeyError):  # a model saved without its preprocessing takes samples as they are
            return model.eval().float(), False, 16000
    return model.eval().float(), bool(getattr(extractor, "do_normalize", False)), int(extractor.sampling_rate)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """No bars and no advice of transformers' on the terminal."""
    from transformers.utils import logging

    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()
