"""A motion and its sound as a video file, for user studies and talks (RG 7.3.3, RACER 5.4: raters watch videos).

    gesticulator draw video MOTION.bvh --sound speech.wav [--start 2] [--seconds 10] [--out clip.mp4]

The suffix picks the format: .mp4 (H.264 and AAC) or .webm (VP9 and Opus); see `gesticulator.export.film`, which draws.
Frame k shows the motion at start + k / fps.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.motion import bvh
from data_module.speech.audio import load_speech
from data_module.types import Motion, Speech
from gesticulator.export.figure import figure_points
from gesticulator.export.film import FPS, SIZE, encode, format_of


def write_video(path: str | Path, motion: Motion, speech: Speech, *, start: float = 0.0, seconds: float | None = None,
                size: tuple[int, int] = SIZE, legs: bool = False) -> None:
    """Write the stretch from `start`, `seconds` long (or as long as both last), whole or not at all, at `FPS`.

    size: pixels across and down, both even; legs: see `figure_points`. InputError for what `encode` refuses and for a
    stretch without a frame.
    """
    target = Path(path)
    format_of(target.suffix)
    # A microsecond: a length in seconds is seldom a whole number of frames to the last bit.
    end = min(motion.duration, speech.duration, math.inf if seconds is None else start + seconds) + 1e-6
    if not (math.isfinite(start) and start >= 0 and (end - start) * FPS >= 1):
        stretch = f"from {start:g} s" + ("" if seconds is None else f", {seconds:g} s long,")
        raise InputError("video", f"the stretch {stretch} holds no frame: the motion lasts {motion.duration:.2f} s and "
                         f"the sound {speech.duration:.2f} s", "give another start or length")
    points = figure_points(motion, start + np.arange(math.floor((end - start) * FPS)) / FPS, legs,
                           fingers=True)
    samples = speech.samples[round(start * speech.sample_rate):]
    write_bytes(target, encode(points, Speech(samples, speech.sample_rate), target.suffix, size=size))


def arguments(parser: argparse.ArgumentParser) -> None:
    """What `gesticulator draw video` takes."""
    parser.add_argument("motion", type=Path, help="a BVH file of an upper body")
    parser.add_argument("--sound", type=Path, required=True, help="its recording")
    parser.add_argument("--out", type=Path, help="the video, .mp4 or .webm (default: .mp4 beside the motion)")
    parser.add_argument("--start", type=float, default=0.0, help="start, seconds (default 0)")
    parser.add_argument("--seconds", type=float, help="duration, seconds (default: all)")
    parser.add_argument("--fps", type=float, help="frame rate of the motion, if the file's is wrong")
    parser.add_argument("--legs", action="store_true", help="draw the legs of the motion")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Write it; the video's path."""
    out = arguments.out or arguments.motion.with_suffix(".mp4")
    format_of(out.suffix)
    motion = bvh.read_bvh(arguments.motion, fps=arguments.fps)
    write_video(out, motion, load_speech(arguments.sound), start=arguments.start, seconds=arguments.seconds,
                legs=arguments.legs)
    return [out]
