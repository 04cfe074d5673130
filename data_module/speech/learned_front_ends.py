"""Learned front ends: levels of the speech encoder, or hidden layers of a model of transformers.

Networks normalise their input, so learned features do not contain loudness; both levels therefore get two columns of
the mel front end, onset strength and loudness. `front_end` builds every front end by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from data_module.errors import InputError
from data_module.speech.front_ends import AudioFeatures, Features, FrontEnd, MelFrontEnd, scaled_windows
from data_module.speech.speech_encoder import HIGH, LEVELS, LOW, SpeechEncoder, load_fairseq
from data_module.types import Array, Samples

_EARLY, _LATE = 1, 0.75  # hidden layers of a transformer: the first, and three quarters up
_LEVEL_COLUMNS = 2


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
    return LearnedFrontEnd(name, (encoder.width, encoder.width), mel, states)


def transformers_front_end(model_name: str, mel: MelFrontEnd, layers: Sequence[int] | None = None) -> LearnedFrontEnd:
    """Two hidden layers of a speech model that takes samples (wav2vec 2.0, HuBERT, WavLM and similar ones).

    model_name: a folder, or the name of a model in the cache of transformers; nothing is downloaded. layers: 0 is the
    input of the first layer; by default the first and one at three quarters of the depth. InputError if the model is
    missing or does not take samples.
    """
    subject = f"hf:{model_name}"
    model, normalise, rate = _open(model_name, subject)
    _same_rate(rate, mel)

    def hidden(samples: Tensor) -> Sequence[Tensor]:
        if normalise:
            # As transformers' feature extractor normalises a window, here in torch.
            spread, mean = torch.var_mean(samples, dim=-1, keepdim=True, correction=0)
            samples = (samples - mean) / torch.sqrt(spread + 1e-7)
        return model(samples, output_hidden_states=True).hidden_states

    try:
        with torch.inference_mode():
            # A trial run: some models accept their configuration and fail on samples.
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
