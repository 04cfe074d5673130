"""Recordings done in pieces: the bytes of the whole, in bounded memory, and nothing left behind."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import soundfile
from gltf_reader import GlbFile as GlbData
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.motion.bvh import Unwrap
from data_module.motion.rotation import Continuous
from data_module.motion.rotation import continuous as whole_continuous
from data_module.motion.skeletons import CHARACTER, CHARACTERS, HIP_HEIGHT
from data_module.speech import sound_files
from data_module.speech.audio import LevelMeter, load_speech, speech_pieces
from data_module.speech.silence import FAINTEST_SPEECH, MARGIN, frame_levels, loudness
from data_module.types import Motion, Samples
from gesticulator import infer
from gesticulator.batch import jobs as one
from gesticulator.batch.long import WRITERS
from gesticulator.export.clip import EVERY_FRAME
from gesticulator.export.glb import skeleton_glb
from gesticulator.export.glb_pieces import GlbFile
from gesticulator.export.nodes import of_motion

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


def made(path: Path, tmp_path: Path, *asked: str, suffixes: tuple[str, ...] = (".bvh",)) -> list[bytes]:
    outputs = [tmp_path / f"out{suffix}" for suffix in suffixes]
    assert infer.main([str(path), *(word for out in outputs for word in ("-o", str(out))), "--quiet", *asked]) == 0
    return [out.read_bytes() for out in outputs]


@pytest.mark.parametrize("asked", [(), ("--legs", "--mirror", "--gain", "3", "--unit", "m", "--intensity", "1.3",
                                        "--hold-still", "1.0-2.5", "--variation", "2", "--fps", "30")])
def test_a_recording_in_pieces_makes_the_bytes_of_the_whole(asked: tuple[str, ...], tmp_path: Path,
                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    samples, _ = example(7.0)
    soundfile.write(tmp_path / "a.wav", np.stack([samples, samples / 3], 1), 22050, subtype="FLOAT")
    monkeypatch.setattr(sound_files, "PIECE", 30_000)
    assert set(one.STREAMED) == set(WRITERS)
    whole = made(tmp_path / "a.wav", tmp_path, *asked, suffixes=one.STREAMED)
    done = []
    was = one._perform_long
    monkeypatch.setattr(one, "_perform_long", lambda *given: done.append(was(*given)))
    monkeypatch.setattr(one, "_LONG", 1.0)
    for before, after in zip(whole, made(tmp_path / "a.wav", tmp_path, *asked, suffixes=one.STREAMED), strict=True):
        assert before == after
    assert len(done) == 1, "it went through the pieces"


def frames(count: int, seed: int = 0) -> Motion:
    """A motion of 16 joints whose quaternions have either sign."""
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(count, len(CHARACTER), 4))
    return Motion(CHARACTER, turns / np.linalg.norm(turns, axis=-1, keepdims=True), np.zeros((count, 3)), 60.0)


@given(st.lists(st.integers(0, 5), min_size=1, max_size=8), st.integers(0, 1000))
def test_signs_of_quaternions_in_pieces_are_those_of_all_of_them(sizes: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = rng.choice([-1.0, 0.0, 1.0], (max(1, sum(sizes)), 2, 4))  # many at right angles to those before
    continuous = Continuous()
    parts = [continuous(part) for part in np.split(turns, np.cumsum(sizes)[:-1])]
    assert np.array_equal(np.concatenate(parts), whole_continuous(turns))


@pytest.mark.parametrize("sizes", [(40,), (1, 7, 1, 31)])
def test_a_glb_in_pieces_holds_every_frame(sizes: tuple[int, ...], tmp_path: Path) -> None:
    motion, file = frames(40), GlbFile(tmp_path / "a.glb", CHARACTER, 60.0, EVERY_FRAME)
    begin = 0
    for size in sizes:
        file.add(motion.crop(begin, begin + size))
        begin += size
    file.finish()
    file.close()
    back = GlbData.parse((tmp_path / "a.glb").read_bytes())
    own = back.document["animations"][0]
    assert np.allclose(back.numbers(own["samplers"][0]["input"])[:, 0], np.arange(40) / 60)
    turned = {(c["target"]["node"], c["target"]["path"]): back.numbers(own["samplers"][c["sampler"]]["output"])
              for c in own["channels"]}
    for node in range(len(CHARACTER)):
        same = np.sum(turned[node, "rotation"][:, [3, 0, 1, 2]] * motion.rotations[:, node], axis=-1)
        assert np.allclose(np.abs(same), 1.0, atol=1e-6)
    assert np.allclose(turned[0, "translation"], [0, HIP_HEIGHT, 0])
    assert [path.name for path in tmp_path.iterdir()] == ["a.glb"]


def test_a_glb_in_pieces_takes_no_more_memory_when_it_is_longer(tmp_path: Path) -> None:
    def peak(pieces: int) -> tuple[int, int]:
        tracemalloc.start()
        file, piece = GlbFile(tmp_path / "a.glb", CHARACTER, 60.0, EVERY_FRAME), frames(500)
        for _ in range(pieces):
            file.add(piece)
        file.finish()
        file.close()
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most, (tmp_path / "a.glb").stat().st_size

    (short, small), (long, large) = peak(150), peak(450)
    assert large > 2.9 * small > 5e7 and long < short + 200_000


def test_a_glb_holds_26_hours_and_no_27(tmp_path: Path) -> None:
    """46 joints at 60 frames a second: 752 bytes a frame, and 2^32 bytes in all."""
    file = GlbFile(tmp_path / "a.glb", CHARACTERS[46], 60.0, EVERY_FRAME)
    file.expect(26 * 3600 * 60)
    with pytest.raises(InputError, match=r"would take 4\.4 GB, and a GLB file holds 4\.3 GB.*--fps"):
        file.expect(27 * 3600 * 60)
    file.close()


def test_what_a_glb_cannot_hold_is_refused_before_it_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                              capfd: pytest.CaptureFixture[str]) -> None:
    samples, rate = example(6.0)
    soundfile.write(tmp_path / "a.wav", samples, rate)
    monkeypatch.setattr("gesticulator.export.glb_pieces.LARGEST", 200_000)
    drawn = []
    monkeypatch.setattr(GlbFile, "add", lambda *given: drawn.append(given))
    monkeypatch.setattr(one, "_LONG", 1.0)
    with pytest.raises(SystemExit) as stop:
        made(tmp_path / "a.wav", tmp_path, suffixes=(".bvh", ".glb"))
    assert stop.value.code == 2 and "a GLB file holds" in capfd.readouterr().err
    assert not drawn and [path.name for path in tmp_path.iterdir()] == ["a.wav"]


def test_frames_beyond_what_a_glb_holds_are_refused_as_they_come(tmp_path: Path,
                                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a header does not say how long the sound is."""
    monkeypatch.setattr("gesticulator.export.glb_pieces.LARGEST", 200_000)
    file = GlbFile(tmp_path / "a.glb", CHARACTER, 60.0, EVERY_FRAME)
    file.add(frames(200))  # 272 bytes each
    with pytest.raises(InputError, match="a GLB file holds"):
        file.add(frames(100))
    file.close()
    assert not list(tmp_path.iterdir())


def test_a_motion_at_once_that_a_glb_cannot_hold_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gesticulator.export.gltf.LARGEST", 30_000)
    with pytest.raises(InputError, match="a GLB file holds"):
        skeleton_glb(of_motion(frames(20)), EVERY_FRAME)


def test_what_breaks_off_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                               capfd: pytest.CaptureFixture[str]) -> None:
    samples, rate = example(6.0)
    samples[-rate // 2:] = np.nan
    soundfile.write(tmp_path / "a.wav", samples, rate, subtype="FLOAT")
    monkeypatch.setattr(one, "_LONG", 1.0)
    monkeypatch.setattr(sound_files, "PIECE", 30_000)
    with pytest.raises(SystemExit) as stop:
        made(tmp_path / "a.wav", tmp_path)
    assert stop.value.code == 2 and "not numbers" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.wav"]


def test_an_error_of_whoever_takes_the_pieces_is_not_the_recordings(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="the disk is full"), speech_pieces(EXAMPLE):
        raise OSError(28, "the disk is full")
    with pytest.raises(InputError, match="does not exist"), speech_pieces(tmp_path / "none.wav"):
        pass
