"""Recordings done in pieces: the bytes of the whole, in bounded memory, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.motion.bvh import Unwrap
from data_module.speech import sound_files
from data_module.speech.audio import LevelMeter, load_speech, speech_pieces
from data_module.speech.silence import FAINTEST_SPEECH, MARGIN, frame_levels, loudness
from data_module.types import Samples
from gesticulator import infer
from gesticulator.export.gltf import GltfDocument

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


def example(seconds: float) -> tuple[Samples, int]:
    """The beginning of the example, and its rate."""
    rate = soundfile.info(EXAMPLE).samplerate
    return soundfile.read(EXAMPLE, frames=round(seconds * rate), dtype="float32")[0], rate


@given(st.lists(st.integers(0, 7), min_size=1, max_size=8), st.integers(0, 1000))
def test_angles_in_pieces_are_unwrapped_as_numpy_does_all_of_them(sizes: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-10, 10, (sum(sizes), 2, 3))
    angles[::3] = np.round(angles[::3] / np.pi) * np.pi  # half turns, which may go either way
    unwrap = Unwrap()
    parts = [unwrap(part) for part in np.split(angles, np.cumsum(sizes)[:-1])]
    assert np.array_equal(np.concatenate(parts), np.unwrap(angles, axis=0))


def loud_level(sound: Samples) -> float:
    """The mean level, dBFS, of the frames that stand out of the noise under them, of all of them at once."""
    levels = frame_levels(sound, 16000)
    return float(levels[levels > np.maximum(loudness(levels).floor + MARGIN, FAINTEST_SPEECH)].mean())


@pytest.mark.parametrize("gain", [1.0, 0.01])
@pytest.mark.parametrize("size", [37, 7919, 160_000])
def test_the_level_of_pieces_is_that_of_the_whole(gain: float, size: int) -> None:
    sound = (load_speech(EXAMPLE).samples[:48_000] * gain).astype(np.float32)
    meter = LevelMeter()
    for start in range(0, len(sound), size):
        meter.add(sound[start:start + size])
    note, level = meter.finish(), loud_level(sound)
    assert note is None if gain == 1.0 else note is not None and f"at {level:.0f} dBFS" in note


def test_sound_is_read_in_pieces_and_is_the_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    samples, _ = example(2.0)
    soundfile.write(tmp_path / "a.wav", np.stack([samples, samples / 2], 1), 44100)
    whole = load_speech(tmp_path / "a.wav").samples
    monkeypatch.setattr(sound_files, "PIECE", 6000)
    with speech_pieces(tmp_path / "a.wav") as sound:
        parts = list(sound.pieces)
    assert sound.seconds == pytest.approx(len(samples) / 44100) and len(parts) > 10
    assert np.array_equal(np.concatenate(parts), whole)


def test_a_motion_at_once_that_a_glb_cannot_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gesticulator.export.gltf.LARGEST", 30_000)
    with pytest.raises(InputError, match="a GLB file holds"):
        GltfDocument({}, bytes(40_000)).to_bytes()


def test_what_breaks_off_leaves_nothing_behind(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    samples, rate = example(6.0)
    samples[-rate // 2:] = np.nan
    soundfile.write(tmp_path / "a.wav", samples, rate, subtype="FLOAT")
    with pytest.raises(SystemExit) as stop:
        infer.main([str(tmp_path / "a.wav"), "-o", str(tmp_path / "out.bvh"), "-o", str(tmp_path / "out.glb")])
    assert stop.value.code == 2 and "not numbers" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.wav"]


def test_an_error_of_whoever_takes_the_pieces_is_not_the_recordings(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="the disk is full"), speech_pieces(EXAMPLE):
        raise OSError(28, "the disk is full")
    with pytest.raises(InputError, match="does not exist"), speech_pieces(tmp_path / "none.wav"):
        pass
