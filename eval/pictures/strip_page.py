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
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.motion import bvh
from data_module.motion.skeletons import FINGERED
from data_module.speech.audio import load_speech
from data_module.store import Recording, Store
from data_module.types import Array, Speech
from eval.clip.excerpts import real_take
from eval.clip.foreign import find_motions, named, read_motion
from eval.pictures.strips import PAGE, STRIP, Source, draw_page, frame_times, save_strip

BEAT_CREDIT = ("real take: BEAT, speaker Scott (Liu et al., ECCV 2022; pantomatrix.github.io/BEAT), CC BY-NC 4.0: "
               "not for commercial use")
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
    # A small number for stretches that poses divide evenly.
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


def sources_of(given: argparse.Namespace) -> tuple[list[Source], Speech | None]:
    """The motions of a page in their order, and the sound that those gesture to that need one."""
    speech = load_speech(given.sound) if given.sound else None
    sources = []
    if given.take:
        take = real_take(60.0, own_rig=True)
        if take is None:
            raise InputError("--take", "is not to be had", "set GESTICULATOR_DATA to the folder that holds takes/")
        sources.append(Source("real take", take[0], BEAT_CREDIT))
        speech = speech or take[1]
    if given.corpus:
        recording = _recording(given.corpus)
        sources.append(Source("corpus, to a voice of its own" if speech else "corpus", recording.motion))
        speech = speech or recording.speech
    if given.ours is not None:
        if speech is None:
            raise InputError("--ours", "has no sound to gesture to", "give --sound, --take or --corpus")
        # Opens torch, which a page without ours does not need.
        from gesticulator.gesticulator import Gesticulator

        performance = Gesticulator.from_pretrained(given.ours or None)(speech, seed=given.seed)
        sources.append(Source("ours", performance.motion))
    systems = named(given.system, "--system").items()
    return [*sources, *(Source(name, read_motion(_file(Path(place), given.sound), given.fps, fingers=True))
                        for name, place in systems)], speech


def _recording(choice: str) -> Recording:
    place, _, name = choice.partition(":")
    store = Store.open(place)
    if not name and not store.of_split("test"):
        raise InputError(place, "has no test split", "name a recording: --corpus STORE:NAME")
    return store.load(name or store.of_split("test")[0].name, len(FINGERED))


def _file(place: Path, sound: Path | None) -> Path:
    """The motion file itself, or that of a folder which is named like the sound."""
    if not place.is_dir():
        return place
    motions, _ = find_motions(place)
    # A folder with one motion leaves no doubt, whatever its name.
    if len(motions) == 1:
        return next(iter(motions.values()))
    if sound is None or sound.stem not in motions:
        raise InputError(place, f"holds {len(motions)} motions and none is named like --sound", "name the file itself")
    return motions[sound.stem]


def run(arguments: argparse.Namespace) -> list[Path]:
    """Draw it; the picture's path."""
    from data_module.speech.beats import BeatSettings, find_beats

    given, file = arguments, arguments.motion
    if file is not None:
        if given.take or given.corpus or given.ours is not None or given.system:
            raise InputError(file, "stands beside --take, --corpus, --ours or --system",
                             f"name it, too: --system NAME={file}")
        out, layout, dpi = given.out or file.with_suffix(".png"), STRIP, 150
        sources = [Source("", bvh.read_bvh(file, fps=given.fps))]
        speech = load_speech(given.sound) if given.sound else None
        times = frame_times(sources[0].motion, given.start, given.seconds, given.frames)
    else:
        if given.out is None:
            raise InputError("--out", "is missing", "name the picture: --out page.png")
        out, layout, dpi = given.out, PAGE, DPI
        sources, speech = sources_of(given)
        times = page_times(given.start, SECONDS if given.seconds is None else given.seconds,
                           max((source.motion.duration for source in sources), default=0.0))
    # At the default settings, which are those of the shipped bundles.
    beats = None if speech is None else find_beats(speech, BeatSettings())
    save_strip(draw_page(sources, times, speech, beats, layout), out, dpi)
    return [out]
