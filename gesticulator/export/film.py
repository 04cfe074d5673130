"""`.mp4`: an animated figure with audio.

All motions use the same figure and camera, without text, so that the picture shows only the movement. Video (H.264) and
audio (AAC) start at 0 and are equally long. The same input gives the same pictures and samples for the same encoder
versions: one thread, no date, no muxer version; the stream occasionally differs by a byte without visible effect.

Not shown: custom characters and faces; legs stand still if the motion has none. Outlines are snapped to half pixels,
and chroma is stored at half resolution (4:2:0), as in most videos.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import soxr

from data_module.files import write_bytes
from data_module.motion import skeletons
from data_module.types import Array, Samples, Speech
from gesticulator.export.figure import FLOOR, FlatPart, body, figure_points, flattened, legs
from gesticulator.export.writers import Scene

if TYPE_CHECKING:
    from PIL.Image import Image

PAPER = "#ece6db"
SHADOW = "#bfb5a4"
SIZE = (540, 720)
"""Pixels across and down."""
FPS = 30
SOUND_RATE = 48_000
"""Sampling rate in Hz, supported by AAC."""

# No frame depends on later ones (bf), so the first frame shown is the first in the file.
_VIDEO_OPTIONS = {"preset": "veryfast", "crf": "20", "bf": "0", "x264-params": "threads=1"}

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


def _polygons(part: FlatPart) -> list[tuple[list[list[int]], str]]:
    """For each polygon of a part its corners in T frames, rounded to whole pixels (Pillow would truncate), and its
    colour."""
    return [(np.rint(corners).astype(np.int64).reshape(len(corners), -1).tolist(), colour)
            for corners, colour in part.polygons]


def _background(size: tuple[int, int], still_legs: bool) -> Image:
    """The static background: paper, a soft shadow on the floor, and still legs."""
    from PIL import Image, ImageDraw, ImageFilter

    picture = Image.new("RGB", size, PAPER)
    pen = ImageDraw.Draw(picture)
    place, scale, _ = project(np.zeros(3), size)
    for across, deep, colour in ((0.5, 0.07, FLOOR), (0.26, 0.036, SHADOW)):
        reach = np.array([across, deep]) * scale
        pen.ellipse([*(place - reach), *(place + reach)], fill=colour)
    picture = picture.filter(ImageFilter.GaussianBlur(0.012 * float(scale)))
    pen = ImageDraw.Draw(picture)
    for part in legs() if still_legs else ():
        for polygon, colour in _polygons(flattened(part, partial(project, size=size), PAPER)):
            pen.polygon(polygon[0], fill=colour)
    return picture


def pictures(points: dict[str, Array], size: tuple[int, int] = SIZE) -> Iterator[Image]:
    """One picture of `size` pixels for each of the T times of `points`: name -> [T, 3], of `figure_points`."""
    from PIL import ImageDraw

    moving = legs(points) if "LeftUpLeg" in points else []
    # Draw at twice the size and average 2 x 2 pixels: Pillow itself does not smooth edges.
    large = (size[0] * _OVER, size[1] * _OVER)
    look, background = partial(project, size=large), _background(large, not moving)
    parts = [flattened(part, look, PAPER) for part in (*moving, *body(points, look))]
    polygons = [_polygons(part) for part in parts]
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

def encode(points: dict[str, Array], speech: Speech, size: tuple[int, int] = SIZE) -> bytes:
    """The bytes of a video: frame k shows the time k / `FPS` of `points` (name -> [T, 3]), with `speech` as audio from
    its start, truncated or padded with silence to T / `FPS` seconds. size: even numbers of pixels."""
    # Exactly as long as the picture, so that players do not stretch either.
    sound = sound_track(speech, len(next(iter(points.values()))))
    with tempfile.TemporaryDirectory() as folder:
        # A file, not memory: moving the index to the front reads back the written data.
        target = Path(folder) / "clip.mp4"
        write_pictures(target, pictures(points, size), sound, size)
        return target.read_bytes()


def sound_track(speech: Speech, frames: int) -> Samples:
    """The first frames / `FPS` seconds, resampled to `SOUND_RATE`."""
    wanted = round(frames * SOUND_RATE / FPS)
    # Include a little more, so that the resampling filter does not see an edge.
    enough = speech.samples[:math.ceil((frames / FPS + 0.1) * speech.sample_rate)]
    samples = enough if speech.sample_rate == SOUND_RATE else soxr.resample(enough, speech.sample_rate, SOUND_RATE)
    samples = np.clip(samples[:wanted], -1.0, 1.0).astype(np.float32)
    return np.pad(samples, (0, wanted - len(samples)))


def write_pictures(target: Path, drawn: Iterator[Image], sound: Samples, size: tuple[int, int]) -> None:
    """Interleave video and audio, so that players find matching data together."""
    import av

    options = {"movflags": "+faststart", "fflags": "+bitexact"}
    with av.open(str(target), "w", format="mp4", options=options) as container:
        video: Any = container.add_stream("libx264", rate=FPS, options=_VIDEO_OPTIONS)
        video.width, video.height, video.pix_fmt = *size, "yuv420p"
        # Stored in the file, so that players do not guess the colour space from the height.
        codec = video.codec_context
        codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range = _BT709, _BT709, _BT709, _NARROW
        codec.gop_size = 2 * FPS
        voice: Any = container.add_stream("aac", rate=SOUND_RATE, layout="mono")
        voice.bit_rate = 128_000
        for stream in (video, voice):
            stream.codec_context.thread_count = 1
            stream.codec_context.flags |= av.codec.context.Flags.bitexact
        for number, picture in enumerate(drawn):
            container.mux(video.encode(_frame(picture, number)))
            first, last = (round(k * SOUND_RATE / FPS) for k in (number, number + 1))
            spoken = av.AudioFrame.from_ndarray(np.ascontiguousarray(sound[None, first:last]), "fltp", "mono")
            spoken.sample_rate, spoken.pts, spoken.time_base = SOUND_RATE, first, Fraction(1, SOUND_RATE)
            container.mux(voice.encode(spoken))
        for stream in (video, voice):
            container.mux(stream.encode(None))


def _frame(picture: Image, number: int) -> Any:
    """A picture as frame `number`, in the colours of BT.709 and its narrow range."""
    import av

    frame = av.VideoFrame.from_image(picture).reformat(
        format="yuv420p", dst_colorspace="ITU709", dst_color_range=_NARROW)
    frame.pts, frame.time_base = number, Fraction(1, FPS)
    frame.colorspace, frame.color_range = _BT709, _NARROW
    return frame


def write_film(path: Path, scene: Scene) -> Path:
    """Write the scene as a video with audio, with legs and fingers if the motion has them, atomically. Returns
    `path`."""
    motion, times = scene.motion, np.arange(max(1, math.floor(scene.speech.duration * FPS + 1e-9))) / FPS
    points = figure_points(motion, times, skeletons.has_legs(motion), fingers=True)
    write_bytes(path, encode(points, scene.speech))
    return path
