"""`gesticulator draw strip`: one motion as a strip, or several systems on one page, at the same seconds.

    gesticulator draw strip MOTION.bvh [--out strip.png] [--start 2] [--seconds 4] [--frames 8] [--sound speech.wav]
    gesticulator draw strip --take --corpus STORE --ours --system units=FILE [--start 2] [--seconds 15] --out page.png

No figure says what a picture says, so a page belongs to every judgement of motion: the real take, the corpus, ours and
others, front and side, four poses a second. Time runs from left to right and goes on in the next line; the coloured
trails are the paths of the hands since the pose before (the character's right hand red, her left hand green).

`--take` is the real take in GESTICULATOR_DATA; its licence asks for credit, so the credit line is drawn with it.
Without it the sound is `--sound`, or that of the corpus recording, and then corpus and ours gesture to the same voice.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_module.errors import InputError
from data_module.motion import bvh
from data_module.types import Array, Speech
from eval.pictures.strips import PAGE, STRIP, Source, draw_page, frame_times, save_strip

if TYPE_CHECKING:
    from data_module.store import Recording

POSES = 4.0
"""Figures a second on a page."""
SECONDS = 4.0
"""Of a page, when not told."""
BEAT_CREDIT = ("real take: BEAT, speaker Scott (Liu et al., ECCV 2022; pantomatrix.github.io/BEAT), CC BY-NC 4.0: "
               "not for commercial use")
DPI = 105
"""Dots an inch of a page, which is then 1450 wide, as a screen is."""


def page_times(start: float, seconds: float, longest: float) -> Array:
    """[n] seconds, `POSES` a second, as far as the longest motion goes; InputError where there is none."""
    if not (math.isfinite(start) and math.isfinite(seconds) and 0 <= start < longest and seconds > 0):
        raise InputError("draw strip", f"{start:g} s and {seconds:g} s more are outside the motion, which lasts "
                         f"{longest:.2f} s", "give another --start or --seconds")
    end = min(start + seconds, longest)
    return start + np.arange(max(1, math.floor((end - start) * POSES + 1e-9))) / POSES


def arguments(parser: argparse.ArgumentParser) -> None:
    """What `gesticulator draw strip` takes."""
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
    page = parser.add_argument_group("several motions on one page")
    page.add_argument("--take", action="store_true",
                      help="add the real recording in GESTICULATOR_DATA, with its credit")
    page.add_argument("--corpus", metavar="STORE[:NAME]",
                      help="add a recording of a store (default: the first test recording)")
    page.add_argument("--ours", nargs="?", const="", metavar="BUNDLE",
                      help="add the motion of a bundle for this audio (default: the shipped one)")
    page.add_argument("--seed", type=int, default=0, help="seed of --ours (default 0)")
    page.add_argument("--system", action="append", default=[], metavar="NAME=FILE",
                      help="add another motion: a file, or a folder with a file named like the audio; can be repeated")
    page.add_argument("--credit", action="append", default=[], metavar="TEXT",
                      help="add a line at the foot; can be repeated")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Draw it; the picture's path."""
    from data_module.speech.beats import BeatSettings, find_beats

    told, layout, dpi = arguments, PAGE, DPI
    if told.motion is not None:
        if told.take or told.corpus or told.ours is not None or told.system:
            raise InputError(told.motion, "stands beside --take, --corpus, --ours or --system",
                             f"name it, too: --system NAME={told.motion}")
        layout, dpi = STRIP, 150
    if told.legs:
        layout = replace(layout, legs=True, low=STRIP.low)
    out: Path | None = told.out or (told.motion and told.motion.with_suffix(".png"))
    if out is None:
        raise InputError("--out", "is missing", "name the picture: --out page.png")
    sources, speech = _sources(told)
    times = (frame_times(sources[0].motion, told.start, told.seconds, told.frames) if told.motion is not None else
             page_times(told.start, SECONDS if told.seconds is None else told.seconds,
                        max((source.motion.duration for source in sources), default=0.0)))
    beats = None if speech is None else find_beats(speech, BeatSettings())
    save_strip(draw_page(sources, times, speech, beats, told.title, told.credit, layout), out, dpi)
    return [out]


def _sources(arguments: argparse.Namespace) -> tuple[list[Source], Speech | None]:
    """The motions in the order of the page, and the sound that those gesture to that need one."""
    from data_module.speech.audio import load_speech
    from eval.clip.foreign import named
    from eval.clip.measure import real_take

    speech = load_speech(arguments.sound) if arguments.sound else None
    sources = []
    if arguments.motion is not None:
        sources.append(Source("", bvh.read_bvh(arguments.motion, fps=arguments.fps)))
    if arguments.take:
        take = real_take(60.0)
        if take is None:
            raise InputError("--take", "is not to be had", "set GESTICULATOR_DATA to the folder that holds takes/")
        sources.append(Source("real take", take[0], BEAT_CREDIT))
        speech = speech or take[1]
    if arguments.corpus:
        recording = _recording(arguments.corpus)
        sources.append(Source("corpus, to a voice of its own" if speech else "corpus", recording.motion))
        speech = speech or recording.speech
    if arguments.ours is not None:
        if speech is None:
            raise InputError("--ours", "has no sound to gesture to", "give --sound, --take or --corpus")
        # Opens torch, which a page without ours does not need.
        from gesticulator.pipeline import Gesticulator

        made = Gesticulator.from_pretrained(arguments.ours or None)(speech, seed=arguments.seed)
        sources.append(Source("ours", made.motion))
    sources += [_system(name, value, arguments) for name, value in named(arguments.system, "--system").items()]
    return sources, speech


def _recording(told: str) -> Recording:
    from data_module.store import Store

    place, _, name = told.partition(":")
    store = Store.open(place)
    if not name and not store.of_split("test"):
        raise InputError(place, "has no test split", "name a recording: --corpus STORE:NAME")
    return store.load(name or store.of_split("test")[0].name)


def _system(name: str, value: str, arguments: argparse.Namespace) -> Source:
    from eval.clip.foreign import find_motions, read_motion

    place = Path(value)
    if place.is_dir():
        held, _ = find_motions(place)
        wanted = arguments.sound.stem if arguments.sound else ""
        if wanted not in held and len(held) > 1:
            raise InputError(place, f"holds {len(held)} motions" + (f" and none is named {wanted}" if wanted else ""),
                             "name the file itself")
        place = held.get(wanted, next(iter(held.values())))
    return Source(name, read_motion(place, arguments.fps))
