"""The speech as a WAV file beside a motion file, for formats that cannot hold sound."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import soundfile

from data_module.files import write_bytes
from data_module.types import Speech
from gesticulator.export.clip import CLIPS
from gesticulator.export.writers import suffix_of


def sound_of(motion: Path) -> Path | None:
    """The sound file beside a motion file; None for formats that hold the sound or do not play."""
    return motion.with_suffix(".wav") if suffix_of(motion) in CLIPS else None


def write_sound(motion: Path, speech: Speech) -> None:
    """Write the speech, 16-bit PCM, atomically."""
    target = sound_of(motion)
    if target is None:
        return
    out = io.BytesIO()
    soundfile.write(out, np.clip(speech.samples, -1.0, 1.0), speech.sample_rate, format="WAV", subtype="PCM_16")
    write_bytes(target, out.getvalue())
