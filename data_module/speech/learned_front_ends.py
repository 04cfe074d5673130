"""Learned front ends: two levels of the speech encoder.

Networks normalise their input, so learned features do not contain loudness; both levels therefore get two columns of
the mel front end, onset strength and loudness. `front_end` builds every front end by name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from data_module.errors import InputError
from data_module.speech.front_ends import AudioFeatures, FrontEnd, MelFrontEnd, scaled_windows
from data_module.speech.speech_encoder_run import HIGH, LEVELS, LOW, SpeechEncoderRunner
from data_module.types import Array, Samples

_LEVEL_COLUMNS = 2
# Windows at a time: few, so that they stay in the cache.
_BATCH = 4
# Hertz of the sound that the speech encoder takes.
_RATE = 16000


@dataclass(frozen=True)
class LearnedFrontEnd:
    """Two levels of a speech encoder per motion frame, each followed by onset strength and loudness. mel: gives the two
    further columns, and the size of a window. layers: the low and the high level, 1 to 8."""

    name: str
    encoder: SpeechEncoderRunner = field(repr=False)
    mel: MelFrontEnd = field(repr=False)
    layers: tuple[int, int]

    @property
    def width(self) -> int:
        return self.encoder.width + _LEVEL_COLUMNS

    def encode(self, windows: Samples, reference: Array | None = None) -> AudioFeatures:
        mel = self.mel
        low, high = (np.empty((len(windows), mel.frames, self.width), np.float32) for _ in range(2))
        for part, scaled in scaled_windows(windows, reference, _BATCH):
            levels = self.encoder.levels(scaled, mel.frames, self.layers)
            columns = mel.rows(scaled)[..., -_LEVEL_COLUMNS:]
            for out, level in zip((low, high), levels, strict=True):
                out[part] = np.concatenate([level, columns], axis=-1)
        return AudioFeatures(low, high)


FRONT_ENDS = ("mel", "vqwav2vec")
"""Front ends by name."""


def front_end(name: str, mel: MelFrontEnd, *, encoder: SpeechEncoderRunner | None = None,
              layers: Sequence[int] | None = None) -> FrontEnd:
    """A front end by name, one of `FRONT_ENDS`.

    mel: the mel front end, of which a learned one uses the sizes, the onsets and the loudness. encoder: for
    "vqwav2vec". layers: those of the low and the high level; None for the paper's. InputError for an unknown name or a
    missing model.
    """
    if name == "mel":
        return mel
    if name not in FRONT_ENDS:
        raise InputError("front end", f"there is no {name!r}", f"choose from {', '.join(FRONT_ENDS)}")
    if encoder is None:
        raise InputError("front end 'vqwav2vec'", "needs a trained speech encoder", "use a bundle that has one")
    chosen = layers or (LOW, HIGH)
    if len(chosen) != 2 or not all(1 <= layer <= LEVELS for layer in chosen):
        raise InputError("front_end.layers", f"is {list(chosen)}", f"give two numbers from 1 to {LEVELS}")
    if mel.sample_rate != _RATE:
        raise InputError("front end", f"wants sound at {_RATE} Hz, not {mel.sample_rate}", "choose another")
    return LearnedFrontEnd(name, encoder, mel, (chosen[0], chosen[1]))
