"""`gesticulator plot strip`: one motion as a strip, or several systems on one page, at the same seconds.

    gesticulator plot strip [MOTION.bvh ...] [--sound speech.wav] [--start 2] [--seconds 4] [--out page.png]
    gesticulator plot strip --corpus STORE --ours [MOTION.bvh ...] [--start 2] [--seconds 15] [--out page.png]

No figure says what a picture says, so a page belongs to every judgement of motion: the corpus, ours and others, front
and side, four poses a second. Time runs from left to right and goes on in the next line; the coloured trails are the
paths of the hands since the pose before (the character's right hand red, the left green). The sound is `--sound`, or
that of the corpus recording, and then corpus and ours gesture to the same voice.
"""

import argparse
import math
from pathlib import Path

from data_module.errors import InputError
from data_module.motion.skeletons import FINGERED
from data_module.speech.audio import load_speech
from data_module.store import Recording, Store
from data_module.types import Speech
from eval.clip.foreign import read_motion
from eval.pictures.strips import Source, draw_page, page_times, save_strip

DPI = 105
"""Dots an inch of a page, which is then 1450 wide, as a screen is."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator plot strip`."""
    add = parser.add_argument
    add("motions", type=Path, nargs="*", metavar="MOTION", help="motion files of an upper body; each is a row")
    add("--out", type=Path, default=Path("strip.png"), help="the picture, .png, .svg or .pdf (default: strip.png)")
    add("--start", type=float, default=0.0, help="start, seconds (default 0)")
    add("--seconds", type=float, default=4.0, help="duration, seconds (default 4)")
    add("--sound", type=Path, help="the recording, drawn below with its beats")
    add("--corpus", metavar="STORE[:NAME]", help="add a recording of a store (default: the first test recording)")
    add("--ours", nargs="?", const="", metavar="BUNDLE",
        help="add the motion of a bundle for this audio (default: the shipped one)")


def sources_of(given: argparse.Namespace) -> tuple[list[Source], Speech | None]:
    """The motions of a page in their order, and the sound that those gesture to that need one."""
    speech = load_speech(given.sound) if given.sound else None
    sources = []
    if given.corpus:
        recording = _recording(given.corpus)
        sources.append(Source("corpus, to a voice of its own" if speech else "corpus", recording.motion))
        speech = speech or recording.speech
    if given.ours is not None:
        if speech is None:
            raise InputError("--ours", "has no sound to gesture to", "give --sound or --corpus")
        # Opens torch, which a page without ours does not need.
        from gesticulator.gesticulator import Gesticulator

        performance = Gesticulator.from_pretrained(given.ours or None)(speech)
        sources.append(Source("ours", performance.motion))
    return [*sources, *(Source(file.stem, read_motion(file, fingers=True)) for file in given.motions)], speech


def _recording(choice: str) -> Recording:
    place, _, name = choice.partition(":")
    store = Store.open(place)
    if not name and not store.of_split("test"):
        raise InputError(place, "has no test split", "name a recording: --corpus STORE:NAME")
    return store.load(name or store.of_split("test")[0].name, len(FINGERED))


def run(arguments: argparse.Namespace) -> list[Path]:
    """Draw it; the picture's path."""
    from data_module.speech.beats import BeatSettings, find_beats

    sources, speech = sources_of(arguments)
    times = page_times(arguments.start, arguments.seconds,
                       max((source.motion.duration for source in sources), default=math.inf))
    # At the default settings, which are those of the shipped bundles.
    beats = None if speech is None else find_beats(speech, BeatSettings())
    save_strip(draw_page(sources, times, speech, beats), arguments.out, DPI)
    return [arguments.out]
