"""`.mp4`, `.webm` and `.gif`: an animated figure with audio.

The suffix selects the format: .mp4 (H.264 and AAC), .webm
(VP9 and Opus), or .gif without audio. All motions use the same figure and camera, without text, so that the picture
shows only the movement. Video and audio start at 0 and are equally long. The same input gives the same pictures and
samples for the same encoder versions: one thread, no date, no muxer version. WebM and GIF are byte-identical too; an
H.264 stream occasionally differs by a byte without visible effect.

Not shown: custom characters; legs stand still if the motion has none. Outlines are snapped to half pixels, and
chroma is stored at half resolution (4:2:0), as in most videos.
"""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import soxr

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.motion import skeletons
from data_module.types import Array, Samples, Speech
from gesticulator.export.figure import FLOOR, FlatPart, body, face_points, figure_points, flattened, legs
from gesticulator.export.writers import Scene

if TYPE_CHECKING:
    from PIL.Image import Image

PAPER = "#ece6db"
SHADOW = "#bfb5a4"
SIZE = (540, 720)
"""Pixels across and down."""
FPS = 30
SOUND_RATE = 48_000
"""Sampling rate in Hz, supported by Opus and AAC."""


class Format(NamedTuple):
    """A container and its encoders, with settings of sufficient quality to hide compression artefacts."""

    container: str
    container_options: dict[str, str]
    video: str
    video_options: dict[str, str]
    audio: str
    bit_rate: int


# No frame depends on later ones (bf, lag-in-frames, auto-alt-ref), so the first frame shown is the first in the file.
FORMATS = {
    ".mp4": Format("mp4", {"movflags": "+faststart"}, "libx264",
                   {"preset": "veryfast", "crf": "20", "bf": "0", "x264-params": "threads=1"}, "aac", 128_000),
    ".webm": Format("webm", {}, "libvpx-vp9",
                    {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "7", "lag-in-frames": "0",
                     "auto-alt-ref": "0"}, "libopus", 96_000),
}
"""Suffix -> format."""

GIF_FPS = 25
"""Frames per second: GIF delays are in hundredths of a second, and browsers slow down delays below two."""
GIF_SIZE = (360, 480)
GIF_COLOURS = 64
"""Palette size: a dozen flat colours, and blends at their edges."""

_OVER = 2
"""Supersampling factor for smooth edges."""
# Codes of ITU-T H.273 and FFmpeg for BT.709 and the narrow range.
_BT709 = 1
_NARROW = 1

_YAW, _PITCH, _DISTANCE, _ZOOM = 0.3, 0.09, 4.6, 0.47
"""A fixed camera a little to the figure's left and above it, which shows the depth of gestures: radians, metres, and
the share of the picture's shorter side that a metre at `_MIDDLE` takes."""
_MIDDLE = (0.0, 0.93, 0.0)
"""The point that the camera looks at, metres."""

_Colour = tuple[int, int, int]
_Ink = Callable[[str], _Colour]


# ---------------------------------------------------------------- the picture

def project(points: Array, size: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Project points [..., 3] in metres to pixels [..., 2], pixels per metre [...] and depth [...] in metres.

    Depth grows towards the viewer; scale = zoom * side * distance / (distance - depth).
    """
    x, y, z = np.moveaxis(np.asarray(points, float) - _MIDDLE, -1, 0)
    # Turn about the vertical, then tilt: the usual order of a camera on a tripod.
    across = x * math.cos(_YAW) - z * math.sin(_YAW)
    ahead = x * math.sin(_YAW) + z * math.cos(_YAW)
    up = y * math.cos(_PITCH) - ahead * math.sin(_PITCH)
    depth = y * math.sin(_PITCH) + ahead * math.cos(_PITCH)
    # Perspective: a point nearer to the camera appears larger.
    scale = min(size) * _ZOOM * _DISTANCE / (_DISTANCE - depth)
    return np.stack([size[0] / 2 + across * scale, size[1] / 2 - up * scale], axis=-1), scale, depth


def _polygons(part: FlatPart, ink: _Ink) -> list[tuple[list[list[int]], _Colour]]:
    """For each polygon of a part its corners in T frames, rounded to whole pixels (Pillow would truncate), and its
    colour."""
    return [(np.rint(corners).astype(np.int64).reshape(len(corners), -1).tolist(), ink(colour))
            for corners, colour in part.polygons(PAPER)]


def _background(size: tuple[int, int], ink: _Ink, still_legs: bool) -> Image:
    """The static background: paper, a soft shadow on the floor, and still legs."""
    from PIL import Image, ImageDraw, ImageFilter

    picture = Image.new("RGB", size, ink(PAPER))
    pen = ImageDraw.Draw(picture)
    place, scale, _ = project(np.zeros(3), size)
    for across, deep, colour in ((0.5, 0.07, FLOOR), (0.26, 0.036, SHADOW)):
        reach = np.array([across, deep]) * scale
        pen.ellipse([*(place - reach), *(place + reach)], fill=ink(colour))
    picture = picture.filter(ImageFilter.GaussianBlur(0.012 * float(scale)))
    pen = ImageDraw.Draw(picture)
    for part in legs() if still_legs else ():
        for polygon, code in _polygons(flattened(part, partial(project, size=size)), ink):
            pen.polygon(polygon[0], fill=code)
    return picture


def rgb(colour: str) -> _Colour:
    """"#rrggbb" as three numbers from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def bt709(colour: str) -> _Colour:
    """"#rrggbb" as Y', Cb, Cr of eight bits in the narrow range (ITU-R BT.709): Y' in 16..235, Cb and Cr in 16..240."""
    r, g, b = (value / 255 for value in rgb(colour))
    y = 0.2126 * r + 0.7152 * g + 0.0722 * b
    return round(16 + 219 * y), round(128 + 224 * (b - y) / 1.8556), round(128 + 224 * (r - y) / 1.5748)


def pictures(points: dict[str, Array], size: tuple[int, int] = SIZE, ink: _Ink = rgb) -> Iterator[Image]:
    """One picture of `size` pixels for each of the T times of `points`: name -> [T, 3], of `figure_points`.

    ink: converts a colour to the three channels. Edges are averages, valid in any linear colour code.
    """
    try:
        from PIL import ImageDraw
    except ImportError:
        raise _missing("Pillow") from None
    moving = legs(points) if "LeftUpLeg" in points else []
    # Draw at twice the size and average 2 x 2 pixels: Pillow itself does not smooth edges.
    large = (size[0] * _OVER, size[1] * _OVER)
    look, background = partial(project, size=large), _background(large, ink, not moving)
    parts = [flattened(part, look) for part in (*moving, *body(points, look))]
    polygons = [_polygons(part, ink) for part in parts]
    # Painter's algorithm: parts are drawn from back to front.
    order = np.argsort(np.stack([part.near for part in parts]), axis=0, kind="stable")
    for frame, numbers in enumerate(order.T.tolist()):
        picture = background.copy()
        pen = ImageDraw.Draw(picture)
        for number in numbers:
            shown = parts[number].shown
            if shown is None or shown[frame]:
                for corners, colour in polygons[number]:
                    pen.polygon(corners[frame], fill=colour)
        yield picture.reduce(_OVER)


# ---------------------------------------------------------------- the file

def encode(points: dict[str, Array], speech: Speech, suffix: str, *, size: tuple[int, int] = SIZE,
           fps: int = FPS) -> bytes:
    """The bytes of a video: frame k shows time k of `points` (name -> [T, 3]), with `speech` as audio from its start.

    The audio is truncated, or padded with silence, to T / fps seconds. suffix: ".mp4" or ".webm". InputError for
    another suffix, an invalid size or rate, or if PyAV or Pillow is not installed.
    """
    frames, kind = len(next(iter(points.values()))), format_of(suffix)
    if min(size) < 16 or size[0] % 2 or size[1] % 2:
        raise InputError("size", f"must be even and 16 or more, not {size[0]} x {size[1]}")
    if fps < 1:
        raise InputError("fps", f"must be 1 or more, not {fps}")
    if frames < 1:
        raise InputError("video", "would hold no frame", "give a longer stretch")
    # Exactly as long as the picture, so that players do not stretch either.
    sound = _resampled(speech, frames, fps)
    with tempfile.TemporaryDirectory() as folder:
        # A file, not memory: moving the index to the front reads back the written data.
        target = Path(folder) / f"clip{suffix.lower()}"
        _write(target, kind, pictures(points, size, bt709), sound, size, fps)
        return target.read_bytes()


def format_of(suffix: str) -> Format:
    """The format of a suffix; InputError for an unknown one, or if PyAV is not installed."""
    try:
        import av  # noqa: F401 - fail before minutes of drawing
    except ImportError:
        raise _missing("PyAV") from None
    if suffix.lower() not in FORMATS:
        raise InputError(suffix or "a name without a suffix", "is not a supported video format",
                         f"use {' or '.join(FORMATS)}")
    return FORMATS[suffix.lower()]


def _missing(what: str) -> InputError:
    return InputError("videos", f"need {what}, which is not installed", "pip install 'gesticulator[video]'")


def _resampled(speech: Speech, frames: int, fps: int) -> Samples:
    """The first frames / fps seconds, resampled to `SOUND_RATE`."""
    wanted = round(frames * SOUND_RATE / fps)
    # Include a little more, so that the resampling filter does not see an edge.
    enough = speech.samples[:math.ceil((frames / fps + 0.1) * speech.sample_rate)]
    samples = enough if speech.sample_rate == SOUND_RATE else soxr.resample(enough, speech.sample_rate, SOUND_RATE)
    samples = np.clip(samples[:wanted], -1.0, 1.0).astype(np.float32)
    return np.pad(samples, (0, wanted - len(samples)))


def _write(target: Path, kind: Format, drawn: Iterator[Image], sound: Samples, size: tuple[int, int], fps: int) -> None:
    """Interleave video and audio, so that players find matching data together."""
    import av

    options = kind.container_options | {"fflags": "+bitexact"}
    with av.open(str(target), "w", format=kind.container, options=options) as container:
        video: Any = container.add_stream(kind.video, rate=fps, options=kind.video_options)
        video.width, video.height, video.pix_fmt = *size, "yuv420p"
        # Stored in the file, so that players do not guess the colour space from the height.
        codec = video.codec_context
        codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range = _BT709, _BT709, _BT709, _NARROW
        codec.gop_size = 2 * fps
        voice: Any = container.add_stream(kind.audio, rate=SOUND_RATE, layout="mono")
        voice.bit_rate = kind.bit_rate
        for stream in (video, voice):
            stream.codec_context.thread_count = 1
            stream.codec_context.flags |= av.codec.context.Flags.bitexact
        for number, picture in enumerate(drawn):
            container.mux(video.encode(_frame(picture, number, fps)))
            first, last = (round(k * SOUND_RATE / fps) for k in (number, number + 1))
            spoken = av.AudioFrame.from_ndarray(np.ascontiguousarray(sound[None, first:last]), "fltp", "mono")
            spoken.sample_rate, spoken.pts, spoken.time_base = SOUND_RATE, first, Fraction(1, SOUND_RATE)
            container.mux(voice.encode(spoken))
        for stream in (video, voice):
            container.mux(stream.encode(None))


def _frame(picture: Image, number: int, fps: int) -> Any:
    """A picture in the colours of `bt709` as frame `number`; drawn in these colours to avoid a slow conversion."""
    import av

    light, blue, red = picture.split()
    frame = av.VideoFrame(*picture.size, "yuv420p")
    for plane, channel in zip(frame.planes, (light, blue.reduce(2), red.reduce(2)), strict=True):
        rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
        rows[:, :channel.width] = np.asarray(channel)
        # Rows are padded, and an encoder may read the padding.
        rows[:, channel.width:] = rows[:, channel.width - 1:channel.width]
    frame.pts, frame.time_base = number, Fraction(1, fps)
    frame.colorspace, frame.color_range = _BT709, _NARROW
    return frame


# ---------------------------------------------------------------- a scene

def write_film(path: Path, scene: Scene) -> Path:
    """Write the scene as a video with audio, atomically. Returns `path`."""
    write_bytes(path, encode(_moments(scene, FPS), scene.speech, path.suffix))
    return path


def write_gif(path: Path, scene: Scene) -> Path:
    """Write the scene as a looping GIF without audio, with one palette for all frames, atomically. Returns `path`."""
    from PIL import Image

    points = _moments(scene, GIF_FPS)
    frames = len(next(iter(points.values())))
    # The palette is made from a few pictures below each other: their colours are those of all.
    few = np.linspace(0, frames - 1, min(frames, 8)).astype(int)
    samples = list(pictures({name: places[few] for name, places in points.items()}, GIF_SIZE))
    sheet = Image.new("RGB", (GIF_SIZE[0], GIF_SIZE[1] * len(samples)))
    for row, picture in enumerate(samples):
        sheet.paste(picture, (0, GIF_SIZE[1] * row))
    palette = sheet.quantize(GIF_COLOURS, dither=Image.Dither.NONE)
    # A generator, as Pillow takes one picture at a time: those of ten minutes would fill the memory.
    drawn = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures(points, GIF_SIZE))
    out = io.BytesIO()
    next(drawn).save(out, "GIF", save_all=True, append_images=drawn, duration=1000 // GIF_FPS, loop=0, optimize=False,
                     disposal=1)
    write_bytes(path, out.getvalue())
    return path


def _moments(scene: Scene, fps: int) -> dict[str, Array]:
    """The points to draw at each frame of a film, with legs, fingers and face if the scene has them."""
    motion, times = scene.motion, np.arange(max(1, math.floor(scene.duration * fps + 1e-9))) / fps
    points = figure_points(motion, times, skeletons.has_legs(motion), fingers=True)
    if scene.face is not None:
        points |= face_points(scene.face, motion, times)
    return points
