"""What a caller may give as speech and as text: a path, samples, a `Speech`; a transcript's file or the words."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.speech.audio import SHORTEST, load_speech
from data_module.types import Samples, Speech

if TYPE_CHECKING:
    from data_module.text.transcript import Transcript

Recording: TypeAlias = "Speech | str | os.PathLike[str] | BinaryIO | NDArray[Any]"
"""A recording: a `Speech`, a sound file by its path or as a binary stream, or samples [n] or [n, channels]."""
Text: TypeAlias = "str | os.PathLike[str]"
"""What is said: a `str` is the words themselves, a path (`pathlib.Path`) names a transcript's file."""

LOWEST_RATE, HIGHEST_RATE = 1000, 768_000
"""Hertz: below there is no speech, above no converter."""
MOST_CHANNELS = 1024
"""More are samples and channels taken for each other."""
FULL_SCALE = 16.0
"""Floating-point samples up to here are a recording that is too loud, and are clipped at 1; beyond, they have another
scale."""


def as_speech(given: Recording, sample_rate: float | None = None) -> Speech:
    """A `Speech` of what was given. sample_rate: hertz, for samples alone.

    Samples are [n] or [n, channels], which are averaged; floating-point ones lie in [-1, 1], whole numbers are divided
    by their type's full scale. `InputError` for anything else, and for less than `SHORTEST` seconds of samples.
    """
    if isinstance(given, Speech | str | os.PathLike) or hasattr(given, "read"):
        if sample_rate is not None:
            raise InputError("sample_rate", "is given beside a recording that knows its own", "leave it out")
        return given if isinstance(given, Speech) else load_speech(cast("str | BinaryIO", given))
    if sample_rate is None:
        raise InputError("sample_rate", "is lacking", "give it with the samples: g(samples, 16000)")
    if not LOWEST_RATE <= sample_rate <= HIGHEST_RATE or sample_rate != round(sample_rate):
        raise InputError(f"sample_rate {sample_rate:g}", "is out of range",
                         f"give {LOWEST_RATE} to {HIGHEST_RATE} samples per second")
    samples = _mono(np.asarray(given))
    if len(samples) < SHORTEST * sample_rate:
        raise InputError("speech", f"lasts {len(samples) / sample_rate:.2f} s, too short for a gesture",
                         f"give {SHORTEST} s or more")
    return Speech(samples, round(sample_rate))


def _mono(samples: NDArray[Any]) -> Samples:
    """[n] or [n, channels] of any type of number to [n] in [-1, 1]."""
    if samples.ndim not in (1, 2) or samples.dtype.kind not in "fiu":
        raise InputError("speech", f"is an array of {samples.dtype} shaped {list(samples.shape)}",
                         "give samples [n] or [n, channels] as numbers")
    if samples.ndim == 2 and not 1 <= samples.shape[1] <= MOST_CHANNELS:
        raise InputError("speech", f"is shaped {list(samples.shape)}, which is {samples.shape[1]} channels",
                         "give [n, channels]: samples first")
    if samples.dtype.kind in "iu":
        half = 2.0 ** (8 * samples.dtype.itemsize - 1)
        samples = (samples.astype(np.float64) - (half if samples.dtype.kind == "u" else 0.0)) / half
    if samples.ndim == 2:
        samples = samples.mean(axis=1, dtype=np.float64)
    if len(samples) and not np.abs(samples).max() <= FULL_SCALE:  # also NaN
        raise InputError("speech", f"holds samples up to {np.abs(samples).max():.3g}, where full scale is 1",
                         "scale them to [-1, 1]")
    return np.clip(samples, -1.0, 1.0).astype(np.float32)


def amplified(speech: Speech, decibels: float) -> Speech:
    """The speech louder by some decibels, clipped at full scale; itself for 0."""
    if decibels == 0:
        return speech
    samples = np.clip(speech.samples * 10.0 ** (decibels / 20), -1.0, 1.0).astype(np.float32)
    return replace(speech, samples=samples)


def as_transcript(text: Text, speech: Speech) -> Transcript:
    """The transcript of a recording: of the words themselves (`str`), or of a file (a path).

    `InputError` for words that are none, and for a `str` that is the name of a file.
    """
    from data_module.text.transcript import FORMATS, Transcript, read_transcript

    if not isinstance(text, str):
        return read_transcript(Path(text), speech)
    names_file = Path(text[-80:]).suffix.lower() in FORMATS and (len(text.split()) < 2 or os.path.isfile(text))  # noqa: PTH113
    if names_file:
        raise InputError(f"text {text!r}", "is the name of a file, where a str is what is said",
                         "give pathlib.Path(...) for a file")
    if not any(letter.isalnum() for letter in text):
        raise InputError("text", "has no words", "give what is said, or leave it out")
    return Transcript(None, text, "none", "text")


def texts_for(count: int, text: Text | Sequence[Text | None] | None) -> Sequence[Text | None]:
    """A text for each of several recordings; `InputError` where there is one for all, or another number of them."""
    if text is None:
        return [None] * count
    if isinstance(text, str | os.PathLike):
        raise InputError("text", f"is one for {count} recordings", "give a list with a text (or None) for each")
    if len(text) != count:
        raise InputError("text", f"has {len(text)} entries for {count} recordings", "give one (or None) for each")
    return text
