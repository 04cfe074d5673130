"""`gesticulator plot strip`: one motion as a strip, or several systems on one page, at the same seconds.

    gesticulator plot strip MOTION.bvh [--out strip.png] [--start 2] [--seconds 4] [--frames 8] [--sound speech.wav]
    gesticulator plot strip --take --corpus STORE --ours --system units=FILE [--start 2] [--seconds 15] --out page.png

No figure says what a picture says, so a page belongs to every judgement of motion: the real take, the corpus, ours and
others, front and side, four poses a second. Time runs from left to right and goes on in the next line; the coloured
trails are the paths of the hands since the pose before (the character's right hand red, the left green).

`--take` is the real take in GESTICULATOR_DATA; its licence asks for credit, so the credit line is drawn with it.
Without it the sound is `--sound`, or that of the corpus recording, and then corpus and ours gesture to the same voice.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.types import Array
from eval.pictures import sources
from eval.pictures.strips import PAGE, STRIP, draw_page, frame_times, save_strip

POSES = 4.0
"""Figures a second on a page."""
SECONDS = 4.0
"""Of a page, when not told."""
DPI = 105
"""Dots an inch of a page, which is then 1450 wide, as a screen is."""


def page_times(start: float, seconds: float, longest: float) -> Array:
    """[n] seconds, `POSES` a second, as far as the longest motion goes; InputError where there is none."""
    if not (math.isfinite(start) and math.isfinite(seconds) and 0 <= start < longest and seconds > 0):
        raise InputError("plot strip", f"{start:g} s and {seconds:g} s more are outside the motion, which lasts "
                         f"{longest:.2f} s", "give another --start or --seconds")
    end = min(start + seconds, longest)
    return start + np.arange(max(1, math.floor((end - start) * POSES + 1e-9))) / POSES


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator plot strip`."""
    parser.add_argument("motion", type=Path, nargs="?",
                        help="a BVH file of an upper body; omit it for a page of several motions")
    parser.add_argument("--out", type=Path, help="the picture, .png, .svg or .pdf (default: beside the motion)")
    parser.add_argument("--start", type=float, default=0.0, help="start, seconds (default 0)")
    parser.add_argument("--seconds", type=float, help="duration, seconds (default: all; 4 on a page)")
    parser.add_argument("--frames", type=int, default=8, help="number of figures (default 8; four a second on a page)")
    parser.add_argument("--fps", type=float, help="frame rate, if the file's is wrong")
    parser.add_argument("--sound", type=Path, help="the recording, drawn below with its beats")
    parser.add_argument("--legs", action="store_true", help="draw the legs of the motions")
    parser.add_argument("--title", default="")
    sources.arguments(parser, "several motions on one page")
    parser.add_argument("--credit", action="append", default=[], metavar="TEXT",
                        help="add a line at the foot; can be repeated")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Draw it; the picture's path."""
    from data_module.speech.beats import BeatSettings, find_beats

    given, layout, dpi = arguments, PAGE, DPI
    if given.motion is not None:
        sources.alone(given)
        layout, dpi = STRIP, 150
    if given.legs:
        layout = replace(layout, legs=True, low=STRIP.low)
    out: Path | None = given.out or (given.motion and given.motion.with_suffix(".png"))
    if out is None:
        raise InputError("--out", "is missing", "name the picture: --out page.png")
    drawn, speech = sources.opened(given)
    times = (frame_times(drawn[0].motion, given.start, given.seconds, given.frames) if given.motion is not None else
             page_times(given.start, SECONDS if given.seconds is None else given.seconds,
                        max((source.motion.duration for source in drawn), default=0.0)))
    beats = None if speech is None else find_beats(speech, BeatSettings())
    save_strip(draw_page(drawn, times, speech, beats, given.title, given.credit, layout), out, dpi)
    return [out]
