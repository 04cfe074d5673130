"""`.mp4`, `.webm` and `.gif`: a figure that moves, with its sound; also the films of user studies.

Raters of RG 7.3.3 and RACER 5.4 watch videos. The suffix picks the format: .mp4 (H.264 and AAC), .webm (VP9 and Opus),
or .gif, which has no sound. Every motion is drawn in one body, by one camera, without text, so that a picture tells
nothing but the movement. Picture and sound begin at 0 and are equally long. The same input gives the same pictures and
samples as long as the encoders stay the same: one thread, no date, no version of the muxer. WebM and GIF give the same
bytes too; an H.264 stream was seen to differ by a byte now and then, though not in what it shows.

What it cannot show: fingers, face, and a character of the user's; legs stand still where the motion has none. Outlines
lie on half pixels, and colours are stored at half the resolution (4:2:0), as in most videos.
"""

from __future__ import annotations

import io
import itertools
import math
import struct
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import soxr
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.motion import skeletons
from data_module.types import Array, Motion, Samples, Speech
from gesticulator.export.figure import FLOOR, FlatPart, body, figure_points, flattened, legs

if TYPE_CHECKING:
    from PIL.Image import Image

    from gesticulator.export.scene import Scene

PAPER = "#ece6db"
SHADOW = "#bfb5a4"
SIZE = (540, 720)
"""Pixels across and down."""
FPS = 30
SOUND_RATE = 48_000
"""Hz; what Opus knows, and AAC too."""


class Format(NamedTuple):
    """A file's container, its encoders, and their settings: good enough that no edge tells of the encoder."""

    container: str
    container_options: dict[str, str]
    video: str
    video_options: dict[str, str]
    audio: str
    bit_rate: int


# No picture is made from later ones (bf, lag-in-frames, auto-alt-ref): the first to be shown is the first in the file.
FORMATS = {
    ".mp4": Format("mp4", {"movflags": "+faststart"}, "libx264",
                   {"preset": "veryfast", "crf": "20", "bf": "0", "x264-params": "threads=1"}, "aac", 128_000),
    ".webm": Format("webm", {}, "libvpx-vp9",
                    {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "7", "lag-in-frames": "0",
                     "auto-alt-ref": "0"}, "libopus", 96_000),
}
"""Suffix -> how it is written."""

LEAST_FILLING = 9
"""Bytes that `filled` needs at least."""

GIF_FPS = 25
"""Frames per second: a GIF counts hundredths of a second, and browsers slow down what is faster than two of them."""
GIF_SIZE = (360, 480)
GIF_COLOURS = 64
"""The figure has a dozen flat colours; the rest are the edges between them."""

_OVER = 2
"""Drawn this many times as large and scaled down, which smooths the edges."""
# The numbers of ITU-T H.273 and of FFmpeg for BT.709 and the narrow range.
_BT709 = 1
_NARROW = 1

_Colour = tuple[int, int, int]
_Ink = Callable[[str], _Colour]


# ---------------------------------------------------------------- the picture

@dataclass(frozen=True)
class Camera:
    """A fixed look at the figure, from a little to its left and above, for the depth of a gesture (metres, radians).

    A metre at `middle` is `zoom` times the picture's shorter side.
    """

    yaw: float = 0.3
    pitch: float = 0.09
    distance: float = 4.6
    middle: tuple[float, float, float] = (0.0, 0.93, 0.0)
    zoom: float = 0.47

    def project(self, points: Array, size: tuple[int, int]) -> tuple[Array, Array, Array]:
        """Points [..., 3] in metres as places [..., 2] in pixels, pixels per metre [...] and depth [...] in metres.

        Depth grows towards the viewer; scale = zoom * side * distance / (distance - depth).
        """
        x, y, z = np.moveaxis(np.asarray(points, float) - self.middle, -1, 0)
        across = x * math.cos(self.yaw) - z * math.sin(self.yaw)
        ahead = x * math.sin(self.yaw) + z * math.cos(self.yaw)
        up = y * math.cos(self.pitch) - ahead * math.sin(self.pitch)
        depth = y * math.sin(self.pitch) + ahead * math.cos(self.pitch)
        scale = min(size) * self.zoom * self.distance / (self.distance - depth)
        return np.stack([size[0] / 2 + across * scale, size[1] / 2 - up * scale], axis=-1), scale, depth


def _polygons(part: FlatPart, ink: _Ink) -> list[tuple[NDArray[np.int64], _Colour]]:
    """Corners [T, K, 2] in whole pixels, of which Pillow would cut the fractions off, and colours."""
    return [(np.rint(corners).astype(np.int64), ink(colour)) for corners, colour in part.polygons(PAPER)]


def _background(camera: Camera, size: tuple[int, int], ink: _Ink, still_legs: bool) -> Image:
    """Paper, a soft shadow on the floor, and legs that stand still: what no frame changes."""
    from PIL import Image, ImageDraw, ImageFilter

    picture = Image.new("RGB", size, ink(PAPER))
    pen = ImageDraw.Draw(picture)
    place, scale, _ = camera.project(np.zeros(3), size)
    for across, deep, colour in ((0.5, 0.07, FLOOR), (0.26, 0.036, SHADOW)):
        reach = np.array([across, deep]) * scale
        pen.ellipse([*(place - reach), *(place + reach)], fill=ink(colour))
    picture = picture.filter(ImageFilter.GaussianBlur(0.012 * float(scale)))
    pen = ImageDraw.Draw(picture)
    for part in legs() if still_legs else ():
        for polygon, code in _polygons(flattened(part, partial(camera.project, size=size)), ink):
            pen.polygon(polygon[0].ravel().tolist(), fill=code)
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
    """One picture of `size` pixels for each of the T moments of `points`: name -> [T, 3], of `figure_points`.

    ink: what stands in the three channels for a colour. Edges are means, which any linear code of colours allows.
    """
    try:
        from PIL import ImageDraw
    except ImportError:
        raise _missing("Pillow") from None
    moving = legs(points) if "LeftUpLeg" in points else []
    camera, large = Camera(), (size[0] * _OVER, size[1] * _OVER)
    look, background = partial(camera.project, size=large), _background(camera, large, ink, not moving)
    parts = [flattened(part, look) for part in (*moving, *body(points, look))]
    drawn = [_polygons(part, ink) for part in parts]
    # Only the box that the figure ever touches is drawn anew: the rest, most of the picture, stays.
    every = np.concatenate([corners.reshape(-1, 2) for polygons in drawn for corners, _ in polygons])
    low, high = (np.clip([every.min(0) // _OVER, every.max(0) // _OVER + 1], 0, size)).tolist()
    stage = background.crop((low[0] * _OVER, low[1] * _OVER, high[0] * _OVER, high[1] * _OVER))
    rest = background.reduce(_OVER)
    corner = np.multiply(low, _OVER)
    flat = [[((corners - corner).reshape(len(corners), -1).tolist(), colour) for corners, colour in polygons]
            for polygons in drawn]
    order = np.argsort(np.stack([part.near for part in parts]), axis=0, kind="stable")
    for frame, numbers in enumerate(order.T.tolist()):
        picture = stage.copy()
        pen = ImageDraw.Draw(picture)
        for number in numbers:
            shown = parts[number].shown
            if shown is None or shown[frame]:
                for corners, colour in flat[number]:
                    pen.polygon(corners[frame], fill=colour)
        rest.paste(picture.reduce(_OVER), (low[0], low[1]))
        yield rest.copy()


# ---------------------------------------------------------------- the file

def encode(points: dict[str, Array], speech: Speech, suffix: str, *, size: tuple[int, int] = SIZE,
           fps: int = FPS) -> bytes:
    """A video's bytes: frame k shows moment k of `points` (name -> [T, 3]); its sound is `speech` from its start.

    The sound is cut, or filled with silence, to T / fps seconds. suffix: ".mp4" or ".webm". InputError for another one,
    for an impossible size or rate, and where PyAV or Pillow is not installed.
    """
    kind = format_of(suffix)
    if min(size) < 16 or size[0] % 2 or size[1] % 2:
        raise InputError("size", f"must be even and 16 or more, not {size[0]} x {size[1]}")
    if fps < 1:
        raise InputError("fps", f"must be 1 or more, not {fps}")
    frames = len(next(iter(points.values())))
    if frames < 1:
        raise InputError("video", "would hold no frame", "give a longer stretch")
    sound = _resampled(speech, frames, fps)
    with tempfile.TemporaryDirectory() as folder:
        # A file, not memory: moving the index to the front needs to read back what was written.
        target = Path(folder) / f"clip{suffix.lower()}"
        _write(target, kind, pictures(points, size, bt709), sound, size, fps)
        return target.read_bytes()


def format_of(suffix: str) -> Format:
    """How a suffix is written; InputError for an unknown one, and where PyAV is not installed."""
    try:
        import av  # noqa: F401 - asked for early, before minutes of drawing
    except ImportError:
        raise _missing("PyAV") from None
    if suffix.lower() not in FORMATS:
        raise InputError(suffix or "a name without a suffix", "is no video format that is written here",
                         f"use {' or '.join(FORMATS)}")
    return FORMATS[suffix.lower()]


def filled(data: bytes, size: int, suffix: str) -> bytes:
    """The file made `size` bytes long by an element at its end that players skip ("free" or Void, full of zeros).

    Lengths tell how much a figure moves, and so which of two is the still one. `size` must be `LEAST_FILLING` more
    than the file, or equal to it.
    """
    gap = size - len(data)
    if gap == 0:
        return data
    if gap < LEAST_FILLING:
        raise ValueError(f"{gap} bytes are too few to fill")
    if FORMATS[suffix.lower()].container == "mp4":
        return data + struct.pack(">I", gap) + b"free" + bytes(gap - 8)
    # EBML: Void's id, and its length as a number of eight bytes, whose first bit says that it has eight.
    return data + b"\xec" + struct.pack(">Q", (gap - 9) | 1 << 56) + bytes(gap - 9)


def _missing(what: str) -> InputError:
    return InputError("videos", f"need {what}, which is not installed", "pip install 'gesticulator[video]'")


def _resampled(speech: Speech, frames: int, fps: int) -> Samples:
    """The first frames / fps seconds at `SOUND_RATE`."""
    wanted = round(frames * SOUND_RATE / fps)
    # A little more than that goes in, so that the filter does not hear an end.
    enough = speech.samples[:math.ceil((frames / fps + 0.1) * speech.sample_rate)]
    samples = enough if speech.sample_rate == SOUND_RATE else soxr.resample(enough, speech.sample_rate, SOUND_RATE)
    samples = np.clip(samples[:wanted], -1.0, 1.0).astype(np.float32)
    return np.pad(samples, (0, wanted - len(samples)))


def _write(target: Path, kind: Format, drawn: Iterator[Image], sound: Samples, size: tuple[int, int], fps: int) -> None:
    """Picture and sound in turn, so that a player finds what belongs together in one place."""
    import av

    options = kind.container_options | {"fflags": "+bitexact"}
    with av.open(str(target), "w", format=kind.container, options=options) as container:
        video: Any = container.add_stream(kind.video, rate=fps, options=kind.video_options)
        video.width, video.height, video.pix_fmt = *size, "yuv420p"
        # Said in the file, lest a player guess from the height and show other colours.
        own = video.codec_context
        own.colorspace, own.color_primaries, own.color_trc, own.color_range = _BT709, _BT709, _BT709, _NARROW
        own.gop_size = 2 * fps
        voice: Any = container.add_stream(kind.audio, rate=SOUND_RATE, layout="mono")
        voice.bit_rate = kind.bit_rate
        for stream in (video, voice):
            stream.codec_context.thread_count = 1
            stream.codec_context.flags |= av.codec.context.Flags.bitexact
        for number, picture in enumerate(drawn):
            container.mux(video.encode(_frame(picture, number, fps)))
            first, last = (round(k * SOUND_RATE / fps) for k in (number, number + 1))
            container.mux(voice.encode(_sound_frame(sound[first:last], first)))
        for stream in (video, voice):
            container.mux(stream.encode(None))


def _frame(picture: Image, number: int, fps: int) -> Any:
    """A picture in the colours of `bt709` as frame `number`.

    Drawn in these colours from the start, which saves a slow conversion of every frame.
    """
    import av

    light, blue, red = picture.split()
    frame = av.VideoFrame(*picture.size, "yuv420p")
    for plane, channel in zip(frame.planes, (light, blue.reduce(2), red.reduce(2)), strict=True):
        rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
        rows[:, :channel.width] = np.asarray(channel)
        # A row has room behind its end, which an encoder may read.
        rows[:, channel.width:] = rows[:, channel.width - 1:channel.width]
    frame.pts, frame.time_base = number, Fraction(1, fps)
    frame.colorspace, frame.color_range = _BT709, _NARROW
    return frame


def _sound_frame(samples: Samples, first: int) -> Any:
    """Samples as a frame of sound that begins at sample `first`."""
    import av

    frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples[None]), format="fltp", layout="mono")
    frame.sample_rate, frame.pts, frame.time_base = SOUND_RATE, first, Fraction(1, SOUND_RATE)
    return frame


# ---------------------------------------------------------------- a scene

def write_film(path: Path, scene: Scene) -> Path:
    """Write the scene as a video with its sound, whole or not at all. Returns `path`."""
    points = _moments(scene.motion, scene.duration, FPS)
    write_bytes(path, encode(points, scene.speech, path.suffix))
    return path


def write_gif(path: Path, scene: Scene) -> Path:
    """Write the scene as a GIF that repeats, without sound, whole or not at all. Returns `path`."""
    write_bytes(path, gif(_moments(scene.motion, scene.duration, GIF_FPS)))
    return path


def _moments(motion: Motion, duration: float, fps: int) -> dict[str, Array]:
    """What is drawn at each frame of a film; on her own legs and with her own fingers where she has them."""
    times = np.arange(max(1, math.floor(duration * fps + 1e-9))) / fps
    return figure_points(motion, times, skeletons.has_legs(motion), fingers=True)


def gif(points: dict[str, Array]) -> bytes:
    """A GIF's bytes: frame k shows moment k of `points` (name -> [T, 3]) at `GIF_FPS`; one palette for all frames."""
    from PIL import Image

    frames = len(next(iter(points.values())))
    few = np.linspace(0, frames - 1, min(frames, 8)).astype(int)
    samples = list(pictures({name: places[few] for name, places in points.items()}, GIF_SIZE))
    sheet = Image.new("RGB", (GIF_SIZE[0], GIF_SIZE[1] * len(samples)))
    for row, picture in enumerate(samples):
        sheet.paste(picture, (0, GIF_SIZE[1] * row))
    palette = sheet.quantize(GIF_COLOURS, dither=Image.Dither.NONE)
    drawn = (picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures(points, GIF_SIZE))
    first = next(drawn)
    out = io.BytesIO()
    first.save(out, "GIF", save_all=True, append_images=itertools.chain(drawn), duration=1000 // GIF_FPS, loop=0,
               optimize=False, disposal=1)
    return out.getvalue()
