"""Videos: decoded again they show the motion, at its time, with its sound, and nothing else."""

from __future__ import annotations

import builtins
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from data_module.errors import InputError
from data_module.motion import bvh, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion, Speech
from eval.commands import DRAW
from eval.pictures import video
from eval.pictures.strips import Source
from gesticulator.export import film
from gesticulator.export.figure import figure_points

av = pytest.importorskip("av")
pytest.importorskip("PIL")

RATE = 16000
SMALL = (180, 240)
SUFFIXES = tuple(film.FORMATS)
SKIN = np.array([0xDC, 0xB9, 0x99])


def _motion(seconds: float, fps: float = 30.0, raised: dict[str, float] | None = None) -> Motion:
    """The rest pose, arms to the sides; from `raised`[side] seconds on, that arm points up."""
    count = round(seconds * fps)
    turns = np.zeros((count, len(CHARACTER), 3))
    for side, since in (raised or {}).items():
        turns[round(since * fps):, CHARACTER.index(f"{side}Arm"), 2] = np.pi / 2 * (1 if side == "Left" else -1)
    return Motion(CHARACTER, rotation.from_exponential_map(turns), np.zeros((count, 3)), fps)


def _speech(seconds: float, click: float | None = None) -> Speech:
    samples = np.zeros(round(seconds * RATE), np.float32)
    if click is None:
        samples += (0.2 * np.sin(2 * np.pi * 300 * np.arange(len(samples)) / RATE)).astype(np.float32)
    else:
        samples[round(click * RATE):][:16] = 0.9
    return Speech(samples, RATE)


def _decode(file: Path | bytes) -> tuple[Array, list[float], Array, float]:
    """Pictures [K, H, W, 3], their times, samples, and the first sample's time."""
    def opened() -> Any:
        return av.open(io.BytesIO(file) if isinstance(file, bytes) else str(file))

    with opened() as container:
        frames = list(container.decode(video=0))
    with opened() as container:
        sound = list(container.decode(audio=0))
    assert {part.sample_rate for part in sound} == {48_000}
    samples = np.concatenate([part.to_ndarray().reshape(-1) for part in sound])
    return (np.stack([frame.to_ndarray(format="rgb24") for frame in frames]).astype(int),
            [frame.time for frame in frames], samples, sound[0].time)


def _raised(pictures: Array, left_half: bool) -> Array:
    """[K] whether there is skin above the crown in that half of the picture."""
    crown = figure_points(_motion(1.0), np.zeros(1))["HeadTip"]
    row = int(film.Camera().project(crown, SMALL)[0][0, 1])
    part = pictures[:, :row - 4]
    part = part[:, :, :SMALL[0] // 2] if left_half else part[:, :, SMALL[0] // 2:]
    return (np.abs(part - SKIN).max(-1) < 14).sum((1, 2)) > 10


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_picture_and_sound_are_as_long_as_they_should_be(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"clip{suffix}"
    video.write_video(path, _motion(2.0, fps=20.0), _speech(1.9), start=0.3, size=SMALL)
    assert [file.name for file in tmp_path.iterdir()] == [path.name], "nothing temporary is left"
    pictures, times, samples, first = _decode(path)
    assert pictures.shape == (48, SMALL[1], SMALL[0], 3), "from 0.3 s to the sound's end at 30 frames a second"
    # WebM counts milliseconds.
    assert np.abs(np.array(times) - np.arange(48) / 30).max() < 1e-3 and first == 0.0
    # AAC comes in whole packets of 1024, of which a player leaves out what lies behind the end.
    assert 0 <= len(samples) - 48 * 1600 < (1024 if suffix == ".mp4" else 1)
    with av.open(str(path)) as container:
        assert container.duration / 1e6 == pytest.approx(1.6, abs=0.01)
        assert float(container.streams.video[0].average_rate) == pytest.approx(30)
        assert container.streams.video[0].format.name == "yuv420p"
        kinds = [stream.codec_context.name for stream in container.streams]
        assert kinds == {".mp4": ["h264", "aac"], ".webm": ["vp9", "opus"]}[suffix]
        told = {**container.metadata, **container.streams.video[0].metadata, **container.streams.audio[0].metadata}
        assert not {"title", "creation_time", "comment"} & {name.lower() for name in told}
    if suffix == ".mp4":
        data = path.read_bytes()
        assert data.index(b"moov") < data.index(b"mdat"), "the index comes first, so that a browser can start at once"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_raised_arm_is_seen_on_its_side_from_its_frame_on(suffix: str) -> None:
    points = figure_points(_motion(1.0, raised={"Right": 0.5}), np.arange(30) / 30)
    pictures = _decode(film.encode(points, _speech(1.0), suffix, size=SMALL))[0]
    # The viewer faces the figure: its right is the picture's left.
    np.testing.assert_array_equal(_raised(pictures, left_half=True), np.arange(30) >= 15)
    assert not _raised(pictures, left_half=False).any()
    other = figure_points(_motion(0.2, raised={"Left": 0.0}), np.arange(6) / 30)
    pictures = _decode(film.encode(other, _speech(0.2), suffix, size=SMALL))[0]
    assert _raised(pictures, left_half=False).all() and not _raised(pictures, left_half=True).any()
    # The colours come back as they were drawn, which a wrong matrix of the encoder would shift.
    drawn = np.array(next(film.pictures(other, SMALL))).astype(int)
    assert np.abs(pictures[0] - drawn).mean() < 2.5 and np.abs(pictures[0, :20, :20] - drawn[:20, :20]).max() <= 3


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("start", [0.0, 0.4])
def test_a_click_is_heard_at_its_time(suffix: str, start: float, tmp_path: Path) -> None:
    path = tmp_path / f"clip{suffix}"
    video.write_video(path, _motion(2.0), _speech(2.0, click=1.3), start=start, seconds=1.5, size=SMALL)
    _, times, samples, first = _decode(path)
    assert first + np.abs(samples).argmax() / 48_000 == pytest.approx(1.3 - start, abs=0.005)
    assert len(times) == 45


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_same_input_same_video_and_filling_changes_nothing(suffix: str) -> None:
    points = figure_points(_motion(0.5, raised={"Right": 0.2}), np.arange(15) / 30)
    first = film.encode(points, _speech(0.5), suffix, size=SMALL)
    again = film.encode(points, _speech(0.5), suffix, size=SMALL)
    # x264 differs by a byte now and then, but not in what is seen.
    assert suffix == ".mp4" or first == again
    for own, other in zip(_decode(again), _decode(first), strict=True):
        np.testing.assert_array_equal(own, other)
    for more in (0, film.LEAST_FILLING, 70_000):
        filled = film.filled(first, len(first) + more, suffix)
        assert len(filled) == len(first) + more
        for own, other in zip(_decode(filled), _decode(first), strict=True):
            np.testing.assert_array_equal(own, other)
    with pytest.raises(ValueError, match="too few"):
        film.filled(first, len(first) + 3, suffix)


def test_what_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    motion, speech = _motion(1.0), _speech(1.0)
    for told, says in [({"start": 1.0}, "holds no frame"), ({"start": -0.1}, "holds no frame"),
                       ({"start": float("nan")}, "holds no frame"), ({"seconds": 0.01}, "holds no frame"),
                       ({"size": (181, 240)}, "even"), ({"size": (0, 0)}, "even")]:
        with pytest.raises(InputError, match=says):
            video.write_video(tmp_path / "clip.mp4", motion, speech, **told)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="fps"):
        video.encode(figure_points(motion, np.zeros(1)), speech, ".mp4", size=SMALL, fps=0)
    for name in ("clip.avi", "clip"):
        with pytest.raises(InputError, match=r"is not a supported video format|without a suffix"):
            video.write_video(tmp_path / name, motion, speech)
    for package, says in (("av", "PyAV"), ("PIL", "Pillow")):
        with monkeypatch.context() as patch:
            _without(package, patch)
            with pytest.raises(InputError, match=rf"{says}.*pip install 'gesticulator\[video\]'"):
                video.write_video(tmp_path / "clip.mp4", motion, speech)
    assert list(tmp_path.iterdir()) == []


def _without(package: str, patch: pytest.MonkeyPatch) -> None:
    """As if `package` were not installed."""
    real = builtins.__import__

    def found(name: str, *others: Any, **named: Any) -> Any:
        if name.split(".")[0] == package:
            raise ImportError(name)
        return real(name, *others, **named)

    patch.setattr(builtins, "__import__", found)
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        patch.delitem(sys.modules, name)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bvh.write_bvh(tmp_path / "take.bvh", _motion(1.0))
    soundfile.write(tmp_path / "take.wav", _speech(1.0).samples, RATE)
    take = [str(tmp_path / "take.bvh"), "--sound", str(tmp_path / "take.wav")]
    DRAW.main("gesticulator draw", ["video", *take, "--start", "0.2", "--seconds", "0.5"])
    assert capsys.readouterr().out.strip() == str(tmp_path / "take.mp4")
    assert len(_decode(tmp_path / "take.mp4")[1]) == 15
    for told, says in ((["--out", "clip.gif"], "not a supported video format"), (["--start", "7"], "holds no frame")):
        with pytest.raises(SystemExit) as left:
            DRAW.main("gesticulator draw", ["video", *take, *told])
        line = capsys.readouterr().err
        assert left.value.code == 2 and line.count("\n") == 1 and says in line


# ---------------------------------------------------------------- several side by side

def _pane(pictures: Array, number: int) -> Array:
    """[K, H, W, 3] one motion of a page, without the name above and the credits below."""
    return pictures[:, video._NAME:video._NAME + SMALL[1], number * SMALL[0]:(number + 1) * SMALL[0]]


def test_several_motions_stand_side_by_side_at_the_same_time(tmp_path: Path) -> None:
    path = tmp_path / "page.mp4"
    shown = [Source("still", _motion(2.0)), Source("raised", _motion(1.6, fps=15.0, raised={"Right": 0.9}), "by X")]
    video.write_page(path, shown, _speech(3.0, click=1.1), start=0.4, pane=SMALL)
    pictures, times, samples, _ = _decode(path)
    # As long as the shortest lasts: from 0.4 to 1.6 s.
    assert len(times) == 36 and pictures.shape[1:3] == (SMALL[1] + video._NAME + video._CREDIT, 2 * SMALL[0])
    raised = _raised(_pane(pictures, 1), left_half=True)
    assert raised[16:].all() and not raised[:13].any(), "from 0.9 s on, half a second into the film"
    assert not _raised(_pane(pictures, 0), left_half=True).any()
    assert np.abs(samples).argmax() / 48_000 == pytest.approx(1.1 - 0.4, abs=0.005)
    # Each pane is what the motion alone would show; names and the credit are written beside them.
    alone = next(film.pictures(figure_points(shown[0].motion, np.array([0.4]), fingers=True), SMALL))
    assert np.abs(_pane(pictures, 0)[0] - np.array(alone).astype(int)).mean() < 2.5
    paper = np.array(film.rgb(film.PAPER))
    for band in (pictures[0, :video._NAME, :SMALL[0]], pictures[0, :video._NAME, SMALL[0]:],
                 pictures[0, -video._CREDIT:]):
        assert (np.abs(band - paper).max(-1) > 60).sum() > 20
    with pytest.raises(InputError, match="holds no frame"):
        video.write_page(path, shown, _speech(3.0), start=1.6)


def test_the_command_films_several_systems(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "two"):
        bvh.write_bvh(tmp_path / f"{name}.bvh", _motion(1.0))
    soundfile.write(tmp_path / "talk.wav", _speech(1.0).samples, RATE)
    sound, out = ["--sound", str(tmp_path / "talk.wav")], ["--out", str(tmp_path / "film.webm")]
    systems = [f"--system={name}={tmp_path / f'{name}.bvh'}" for name in ("one", "two")]
    DRAW.main("gesticulator draw", ["video", *systems, *sound, *out, "--seconds", "0.2"])
    assert capsys.readouterr().out.strip() == out[1]
    assert _decode(tmp_path / "film.webm")[0].shape[1:3] == (video.PANE[1] + video._NAME, 2 * video.PANE[0])
    for told, says in (([*systems, *sound], "--out: is missing"), ([*out, *sound], "has no motion"),
                       ([*systems, *out], "has no sound"), ([str(tmp_path / "one.bvh")], "--sound: is missing"),
                       ([str(tmp_path / "one.bvh"), *systems, *sound], "name it, too")):
        with pytest.raises(SystemExit) as left:
            DRAW.main("gesticulator draw", ["video", *told])
        line = capsys.readouterr().err
        assert left.value.code == 2 and line.count("\n") == 1 and says in line
