"""Videos: decoded again they show the motion, at its time, with its sound, and nothing else."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion, Speech
from gesticulator.export import film
from gesticulator.export.figure import figure_points

av = pytest.importorskip("av")
pytest.importorskip("PIL")

RATE = 16000
SMALL = (180, 240)
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
    row = int(film.project(crown, SMALL)[0][0, 1])
    part = pictures[:, :row - 4]
    part = part[:, :, :SMALL[0] // 2] if left_half else part[:, :, SMALL[0] // 2:]
    return (np.abs(part - SKIN).max(-1) < 14).sum((1, 2)) > 10


def test_picture_and_sound_are_as_long_as_they_should_be() -> None:
    data = film.encode(figure_points(_motion(2.0, fps=20.0), np.arange(48) / 30), _speech(1.9), size=SMALL)
    pictures, times, samples, first = _decode(data)
    assert pictures.shape == (48, SMALL[1], SMALL[0], 3)
    np.testing.assert_allclose(times, np.arange(48) / 30, atol=1e-6)
    assert first == 0.0
    # AAC comes in whole packets of 1024, of which a player leaves out what lies behind the end.
    assert 0 <= len(samples) - 48 * 1600 < 1024
    with av.open(io.BytesIO(data)) as container:
        assert container.duration / 1e6 == pytest.approx(1.6, abs=0.01)
        assert float(container.streams.video[0].average_rate) == pytest.approx(30)
        assert container.streams.video[0].format.name == "yuv420p"
        kinds = [stream.codec_context.name for stream in container.streams]
        assert kinds == ["h264", "aac"]
        told = {**container.metadata, **container.streams.video[0].metadata, **container.streams.audio[0].metadata}
        assert not {"title", "creation_time", "comment"} & {name.lower() for name in told}
    assert data.index(b"moov") < data.index(b"mdat"), "the index comes first, so that a browser can start at once"


def test_a_raised_arm_is_seen_on_its_side_from_its_frame_on() -> None:
    points = figure_points(_motion(1.0, raised={"Right": 0.5}), np.arange(30) / 30)
    pictures = _decode(film.encode(points, _speech(1.0), size=SMALL))[0]
    # The viewer faces the figure: its right is the picture's left.
    np.testing.assert_array_equal(_raised(pictures, left_half=True), np.arange(30) >= 15)
    assert not _raised(pictures, left_half=False).any()
    other = figure_points(_motion(0.2, raised={"Left": 0.0}), np.arange(6) / 30)
    pictures = _decode(film.encode(other, _speech(0.2), size=SMALL))[0]
    assert _raised(pictures, left_half=False).all() and not _raised(pictures, left_half=True).any()
    # The colours come back as they were drawn, which a wrong matrix of the encoder would shift.
    drawn = np.array(next(film.pictures(other, SMALL))).astype(int)
    assert np.abs(pictures[0] - drawn).mean() < 2.5 and np.abs(pictures[0, :20, :20] - drawn[:20, :20]).max() <= 3


def test_a_click_is_heard_at_its_time() -> None:
    points = figure_points(_motion(2.0), np.arange(45) / 30)
    _, times, samples, first = _decode(film.encode(points, _speech(2.0, click=1.3), size=SMALL))
    assert first + np.abs(samples).argmax() / 48_000 == pytest.approx(1.3, abs=0.005)
    assert len(times) == 45


def test_the_same_input_is_the_same_video() -> None:
    points = figure_points(_motion(0.5, raised={"Right": 0.2}), np.arange(15) / 30)
    first = film.encode(points, _speech(0.5), size=SMALL)
    again = film.encode(points, _speech(0.5), size=SMALL)
    # x264 differs by a byte now and then, but not in what is seen.
    for own, other in zip(_decode(again), _decode(first), strict=True):
        np.testing.assert_array_equal(own, other)
