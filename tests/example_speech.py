"""The example recording, which many tests gesture to: all of it, or its first seconds."""

from __future__ import annotations

from pathlib import Path

import soundfile

from data_module.types import Speech

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


def example_speech(seconds: float | None = None) -> Speech:
    """As many seconds of it, without words."""
    rate = soundfile.info(EXAMPLE).samplerate
    frames = -1 if seconds is None else round(seconds * rate)
    return Speech(soundfile.read(EXAMPLE, frames=frames, dtype="float32")[0], rate)


def write_example(path: Path, seconds: float, subtype: str | None = None) -> Path:
    """Write as many seconds of it into a file of this name; subtype: of the samples, by soundfile."""
    speech = example_speech(seconds)
    soundfile.write(path, speech.samples, speech.sample_rate, subtype=subtype)
    return path
