"""Motion and its sound as a video file, for user studies and talks (RG 7.3.3, RACER 5.4: raters watch videos).

    gesticulator draw video MOTION.bvh --sound speech.wav [--start 2] [--seconds 10] [--out clip.mp4]
    gesticulator draw video --take --ours --corpus STORE [--system NAME=FILE ...] [--seconds 15] --out film.mp4

The suffix picks the format: .mp4 (H.264 and AAC) or .webm (VP9 and Opus); see `gesticulator.export.film`, which draws.
Frame k shows the motion at start + k / fps. One motion fills the picture and has no name, as raters must not know what
they see; several stand side by side under their names, with the same camera and one sound.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.types import Array, Motion, Speech
from eval.pictures import sources
from eval.pictures.strips import Source
from gesticulator.export.figure import INK, SOFT, figure_points
from gesticulator.export.film import FPS, PAPER, SIZE, bt709, encode, encode_pictures, format_of, pictures

if TYPE_CHECKING:
    from PIL.Image import Image

PANE = (360, 480)
"""Pixels across and down of one of several motions."""
_NAME, _CREDIT = 32, 20
"""Pixels of height: of the names above, and of each line of credit below."""


def write_video(path: str | Path, motion: Motion, speech: Speech, *, start: float = 0.0, seconds: float | None = None,
                size: tuple[int, int] = SIZE, legs: bool = False) -> None:
    """Write the stretch from `start`, `seconds` long (or as long as both last), whole or not at all, at `FPS`.

    size: pixels across and down, both even; legs: see `figure_points`. InputError for what `encode` refuses and for a
    stretch without a frame.
    """
    target = Path(path)
    format_of(target.suffix)
    times = _times([motion], speech, start, seconds)
    points = figure_points(motion, times, legs, fingers=True)
    write_bytes(target, encode(points, _from(speech, start), target.suffix, size=size))


def write_page(path: str | Path, shown: Sequence[Source], speech: Speech, *, start: float = 0.0,
               seconds: float | None = None, pane: tuple[int, int] = PANE, legs: bool = False) -> None:
    """Write several motions side by side under their names, with one sound and their credits at the foot; otherwise as
    `write_video`. The stretch ends where the first of them does."""
    target = Path(path)
    format_of(target.suffix)
    times = _times([source.motion for source in shown], speech, start, seconds)
    credits = [source.credit for source in shown if source.credit]
    size = (pane[0] * len(shown), pane[1] + _NAME + _CREDIT * len(credits))
    each = [pictures(figure_points(source.motion, times, legs, fingers=True), pane, bt709) for source in shown]
    drawn = _pages(each, [source.name for source in shown], credits, size)
    write_bytes(target, encode_pictures(drawn, len(times), _from(speech, start), target.suffix, size=size))


def _pages(each: Sequence[Iterator[Image]], names: Sequence[str], credits: Sequence[str], size: tuple[int, int]
           ) -> Iterator[Image]:
    """The pictures of each motion, pasted beside each other under their names."""
    from PIL import Image, ImageDraw, ImageFont

    page = Image.new("RGB", size, bt709(PAPER))
    pen, wide = ImageDraw.Draw(page), size[0] // len(names)
    for place, name in enumerate(names):
        pen.text(((place + 0.5) * wide, _NAME / 2), name, bt709(INK), ImageFont.load_default(18), "mm")
    for line, credit in enumerate(credits):
        pen.text((8, size[1] - _CREDIT * (len(credits) - line) + 3), credit, bt709(SOFT), ImageFont.load_default(11))
    for panes in zip(*each, strict=True):
        for place, picture in enumerate(panes):
            page.paste(picture, (place * wide, _NAME))
        yield page.copy()


def _times(motions: Sequence[Motion], speech: Speech, start: float, seconds: float | None) -> Array:
    """[T] seconds of the frames; InputError where there is none."""
    shortest = min(motion.duration for motion in motions)
    # A microsecond: a length in seconds is seldom a whole number of frames to the last bit.
    end = min(shortest, speech.duration, math.inf if seconds is None else start + seconds) + 1e-6
    if not (math.isfinite(start) and start >= 0 and (end - start) * FPS >= 1):
        stretch = f"from {start:g} s" + ("" if seconds is None else f", {seconds:g} s long,")
        raise InputError("video", f"the stretch {stretch} holds no frame: the motion lasts {shortest:.2f} s and "
                         f"the sound {speech.duration:.2f} s", "give another start or length")
    return start + np.arange(math.floor((end - start) * FPS)) / FPS


def _from(speech: Speech, start: float) -> Speech:
    """What is heard from then on."""
    return Speech(speech.samples[round(start * speech.sample_rate):], speech.sample_rate)


def arguments(parser: argparse.ArgumentParser) -> None:
    """What `gesticulator draw video` takes."""
    parser.add_argument("motion", type=Path, nargs="?",
                        help="a BVH file of an upper body; omit it for several motions side by side")
    parser.add_argument("--sound", type=Path, help="the recording; needed with a motion file")
    parser.add_argument("--out", type=Path, help="the video, .mp4 or .webm (default: .mp4 beside the motion)")
    parser.add_argument("--start", type=float, default=0.0, help="start, seconds (default 0)")
    parser.add_argument("--seconds", type=float, help="duration, seconds (default: all)")
    parser.add_argument("--fps", type=float, help="frame rate of the motion, if the file's is wrong")
    parser.add_argument("--legs", action="store_true", help="draw the legs of the motion")
    sources.arguments(parser, "several motions side by side")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Write it; the video's path."""
    told, several = arguments, arguments.motion is None
    if not several:
        sources.alone(told)
    out: Path | None = told.out or (None if several else told.motion.with_suffix(".mp4"))
    if out is None:
        raise InputError("--out", "is missing", "name the film: --out film.mp4")
    format_of(out.suffix)
    if not several and told.sound is None:
        raise InputError("--sound", "is missing", "name the recording of the motion")
    shown, speech = sources.opened(told)
    if not shown or speech is None:
        raise InputError("draw video", "has no motion" if not shown else "has no sound",
                         "give --take, --corpus, --ours or --system" if not shown else "give --sound")
    if several:
        write_page(out, shown, speech, start=told.start, seconds=told.seconds, legs=told.legs)
    else:
        write_video(out, shown[0].motion, speech, start=told.start, seconds=told.seconds, legs=told.legs)
    return [out]
