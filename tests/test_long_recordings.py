"""Recordings done in pieces: the bytes of the whole, in bounded memory, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_module.speech import sound_files
from data_module.speech.audio import load_speech
from data_module.types import Samples

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


def example(seconds: float) -> tuple[Samples, int]:
    """The beginning of the example, and its rate."""
    rate = soundfile.info(EXAMPLE).samplerate
    return soundfile.read(EXAMPLE, frames=round(seconds * rate), dtype="float32")[0], rate


def test_sound_is_read_in_pieces_and_is_the_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    samples, _ = example(2.0)
    soundfile.write(tmp_path / "a.wav", np.stack([samples, samples / 2], 1), 44100)
    whole = load_speech(tmp_path / "a.wav").samples
    monkeypatch.setattr(sound_files, "PIECE", 6000)
    assert np.array_equal(load_speech(tmp_path / "a.wav").samples, whole)
