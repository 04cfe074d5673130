"""Recordings read in pieces are read as the whole, and nothing is left behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_module.errors import InputError
from data_module.motion.skeletons import CHARACTER
from data_module.speech import sound_files
from data_module.speech.audio import load_speech
from data_module.types import Motion, Samples
from gesticulator import infer
from gesticulator.export.clip import EVERY_FRAME
from gesticulator.export.glb import skeleton_glb
from gesticulator.export.nodes import of_motion

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


def frames(count: int, seed: int = 0) -> Motion:
    """A motion of 16 joints whose quaternions have either sign."""
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(count, len(CHARACTER), 4))
    return Motion(CHARACTER, turns / np.linalg.norm(turns, axis=-1, keepdims=True), np.zeros((count, 3)), 60.0)


def test_a_motion_at_once_that_a_glb_cannot_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gesticulator.export.gltf.LARGEST", 30_000)
    with pytest.raises(InputError, match="a GLB file holds"):
        skeleton_glb(of_motion(frames(20)), EVERY_FRAME)


def test_what_breaks_off_leaves_nothing_behind(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    samples, rate = example(6.0)
    samples[-rate // 2:] = np.nan
    soundfile.write(tmp_path / "a.wav", samples, rate, subtype="FLOAT")
    with pytest.raises(SystemExit) as stop:
        infer.main([str(tmp_path / "a.wav"), "-o", str(tmp_path / "out.bvh"), "-o", str(tmp_path / "out.glb")])
    assert stop.value.code == 2 and "not numbers" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.wav"]
