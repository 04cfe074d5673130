"""The motions of a picture: one file, or the real take, the corpus, ours and other systems beside each other.

The same options for every picture. What gestures to a sound gestures to one and the same: `--sound`, else that
of the real take, else that of the corpus recording.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError
from data_module.motion import bvh
from data_module.motion.skeletons import FINGERED
from data_module.types import Speech
from eval.pictures.strips import Source

if TYPE_CHECKING:
    from data_module.store import Recording

BEAT_CREDIT = ("real take: BEAT, speaker Scott (Liu et al., ECCV 2022; pantomatrix.github.io/BEAT), CC BY-NC 4.0: "
               "not for commercial use")


def arguments(parser: argparse.ArgumentParser, title: str) -> None:
    """The options that name several motions, as a group of that title."""
    page = parser.add_argument_group(title)
    page.add_argument("--take", action="store_true",
                      help="add the real recording in GESTICULATOR_DATA, with its credit")
    page.add_argument("--corpus", metavar="STORE[:NAME]",
                      help="add a recording of a store (default: the first test recording)")
    page.add_argument("--ours", nargs="?", const="", metavar="BUNDLE",
                      help="add the motion of a bundle for this audio (default: the shipped one)")
    page.add_argument("--seed", type=int, default=0, help="seed of --ours (default 0)")
    page.add_argument("--system", action="append", default=[], metavar="NAME=FILE",
                      help="add another motion: a file, or a folder with a file named like the audio; can be repeated")


def alone(arguments: argparse.Namespace) -> None:
    """InputError where a motion file is given beside other sources."""
    if arguments.take or arguments.corpus or arguments.ours is not None or arguments.system:
        raise InputError(arguments.motion, "stands beside --take, --corpus, --ours or --system",
                         f"name it, too: --system NAME={arguments.motion}")


def opened(arguments: argparse.Namespace) -> tuple[list[Source], Speech | None]:
    """The motions in their order, and the sound that those gesture to that need one."""
    from data_module.speech.audio import load_speech
    from eval.clip.foreign import named
    from eval.clip.measure import real_take

    speech = load_speech(arguments.sound) if arguments.sound else None
    sources = []
    if arguments.motion is not None:
        sources.append(Source("", bvh.read_bvh(arguments.motion, fps=arguments.fps)))
    if arguments.take:
        take = real_take(60.0, own_rig=True)
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
        from gesticulator.gesticulator import Gesticulator

        performance = Gesticulator.from_pretrained(arguments.ours or None)(speech, seed=arguments.seed)
        sources.append(Source("ours", performance.motion))
    sources += [_system(name, value, arguments) for name, value in named(arguments.system, "--system").items()]
    return sources, speech


def _recording(choice: str) -> Recording:
    from data_module.store import Store

    place, _, name = choice.partition(":")
    store = Store.open(place)
    if not name and not store.of_split("test"):
        raise InputError(place, "has no test split", "name a recording: --corpus STORE:NAME")
    return store.load(name or store.of_split("test")[0].name, len(FINGERED))


def _system(name: str, value: str, arguments: argparse.Namespace) -> Source:
    from eval.clip.foreign import find_motions, read_motion

    place = Path(value)
    if place.is_dir():
        held, _ = find_motions(place)
        wanted = arguments.sound.stem if arguments.sound else ""
        # A folder with one motion leaves no doubt, whatever its name.
        if wanted not in held and len(held) > 1:
            raise InputError(place, f"holds {len(held)} motions" + (f" and none is named {wanted}" if wanted else ""),
                             "name the file itself")
        place = held.get(wanted, next(iter(held.values())))
    return Source(name, read_motion(place, arguments.fps, fingers=True))
