"""The options of a performance on the command line, and how they become `InferenceOptions`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from data_module.errors import InputError
from gesticulator.cli import PROGRAM
from gesticulator.options import FPS, RANGES
from gesticulator.plan.plan import ENERGIES, HANDS
from gesticulator.version import __version__
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from data_module.controls import Controls
    from gesticulator.options import InferenceArguments
    from gesticulator.pipeline import Gesticulator
    from gesticulator.plan.plan import GestureCue, GesturePlan


def number(name: str) -> Callable[[str], float]:
    """Reads the argument --NAME, in its range of `gesticulator.performance.RANGES`."""
    return lambda text: RANGES[name].parse(f"--{name}", text)


def _seconds(text: str) -> tuple[float, float]:
    """A range of seconds such as 3.2-5.0."""
    begin, mark, stop = text.partition("-")
    try:
        first, last = float(begin), float(stop)
    except ValueError:
        mark, first, last = "", 0.0, 0.0
    if not mark or not 0 <= first < last < float("inf"):
        raise InputError(f"--hold-still {text[:40]}", "is no range of seconds", "write it as 3.2-5.0")
    return first, last


def _cue(text: str) -> GestureCue:
    """A cue such as hello=wave, hello:2=wave or 2.5=shrug."""
    from gesticulator.plan.plan import GestureCue

    at, mark, gesture = text.rpartition("=")
    if not mark or not at or not gesture:
        raise InputError(f"--cue {text[:40]}", "is no cue", "write WORD=GESTURE (hello=wave) or SECONDS=GESTURE")
    try:
        return GestureCue(gesture, time=float(at))
    except ValueError:
        word, _, count = at.rpartition(":")
    if word and count.isdecimal() and int(count):
        return GestureCue(gesture, word, int(count))
    return GestureCue(gesture, at)


def performance_arguments(p: argparse.ArgumentParser) -> None:
    """Add what tells how a recording is performed, whatever is made of it."""
    heard = p.add_argument_group("audio and transcript")
    heard.add_argument("--text", metavar="FILE",
                       help="transcript: plain text, TextGrid, SRT, VTT or JSON with word times; or a folder of "
                       "transcripts named like the recordings")
    heard.add_argument("--gain", type=number("gain"), default=0.0, metavar="DB",
                       help="gain applied to the recording, decibels (default 0)")
    heard.add_argument("--any-length", action="store_true", help="accept recordings longer than an hour")
    style = p.add_argument_group("motion", "VALUE is low, mid or high, a number, or a CSV file with the columns "
                                 "time and value.")
    style.add_argument("--speaker", metavar="NAME",
                       help="style of movement: a speaker of the bundle (see --list speakers)")
    style.add_argument("--hand-height", metavar="VALUE", help="height of the right hand above the hips, metres")
    style.add_argument("--hand-speed", metavar="VALUE", help="mean speed of the hands, metres per second")
    style.add_argument("--hand-radius", metavar="VALUE",
                       help="mean distance of the hands from the body's vertical axis, metres")
    style.add_argument("--activity", type=number("activity"), metavar="0..1",
                       help="share of the speaking time that is gestured; 0 rests throughout, 1 is unrestricted "
                       "(default 1)")
    style.add_argument("--interpreter", choices=INTERPRETERS, help="the model that chooses the lexemes: " + ", ".join(
        f"{name} ({entry.about})" for name, entry in INTERPRETERS.items()))
    style.add_argument("--temperature", type=number("temperature"), metavar="T",
                       help="randomness of the choice of lexemes; 0 always takes the most likely")
    style.add_argument("--beta", type=number("beta"), metavar="B",
                       help="with --interpreter advantage: how strongly the learned reward biases the choice; 0 is "
                       "the same as lstm")
    style.add_argument("--seed", type=number("seed"), default=0, metavar="N",
                       help="random seed; the same seed gives the same bytes (default 0)")
    style.add_argument("--variation", type=number("variation"), default=0, metavar="N",
                       help="another rendering of the same beats and lexemes (default 0)")
    style.add_argument("--legs", action="store_true",
                       help="add standing legs (54 joints): weight shifts, planted feet")
    style.add_argument("--seated", action="store_true", help="seat the character, with still legs and hips (54 joints)")
    style.add_argument("--intensity", type=number("intensity"), default=1.0, metavar="0..2",
                       help="size of the gestures; at 0 the hands hang (default 1)")
    style.add_argument("--energy", choices=tuple(ENERGIES), default="neutral",
                       help="scales intensity and activity: calm is 0.6 of both, lively 1.5 of intensity")
    style.add_argument("--handedness", choices=HANDS,
                       help="preferred hand; with both, each hand takes part in the strokes of the other")
    style.add_argument("--mirror", action="store_true", help="exchange left and right")
    style.add_argument("--hold-still", type=_seconds, action="append", default=[], metavar="FROM-TO",
                       help="rest the hands during these seconds, such as 3.2-5.0; can be repeated")
    style.add_argument("--cue", type=_cue, action="append", default=[], metavar="WORD=GESTURE",
                       help='a gesture at a word or a time: hello=wave, hello:2=wave at the second "hello", 2.5=shrug '
                       "(gesticulator plan names lists the gestures)")
    style.add_argument("--plan", metavar="FILE",
                       help="render a gesture plan (.json, .bml): unchanged blocks are replayed, edited ones sampled "
                       "again; --seed is ignored")
    style.add_argument("--fps", type=number("fps"), default=FPS, metavar="N",
                       help=f"frames per second of the motion (default {FPS:g})")
    body = p.add_argument_group("character", "Your own character, from Mixamo, VRM, Unreal, Blender or "
                                "elsewhere; see gesticulator character --help.")
    body.add_argument("--character", metavar="FILE",
                      help="animate this character: .bvh, .glb, .gltf, .vrm, or .fbx if Blender is installed; it "
                      "stands unless it is seated in the file or --seated is given")
    body.add_argument("--mapping", metavar="FILE.json",
                      help="which nodes are which joints, if they are not identified automatically")
    body.add_argument("--save-mapping", metavar="FILE.json", help="write the joint mapping, to check or correct it")
    body.add_argument("--no-contacts", action="store_true", help="do not keep the hands outside the trunk")
    p.add_argument("--bundle", metavar="DIR", help="folder of trained weights (default: the shipped ones)")
    p.add_argument("--list", choices=("speakers", "interpreters"), help="list what the bundle contains and exit")
    p.add_argument("--threads", type=number("threads"), default=1, metavar="N",
                   help="number of torch threads; it affects the last bits of the output (default 1, usually the "
                   "fastest)")
    p.add_argument("--quiet", action="store_true", help="print no progress bar and no summary")
    p.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")


def asked_controls(system: Gesticulator, asked: argparse.Namespace) -> Controls | None:
    """What the command asks of the style; None when it asks nothing."""
    from data_module.controls import controls_from

    asked_for = asked.hand_height, asked.hand_speed, asked.hand_radius
    if asked_for == (None, None, None):
        return None
    if system.bundle.levels is None:
        raise InputError("--hand-height, --hand-speed, --hand-radius", "are not heard by this bundle",
                         "use a bundle trained with style editing, or leave them out")
    return controls_from(*asked_for, system.bundle.levels)


def asked_options(asked: argparse.Namespace, controls: Controls | None, legs: bool) -> InferenceArguments:
    """What the command asks of a performance."""
    return {"speaker": asked.speaker, "interpreter": asked.interpreter, "seed": int(asked.seed),
            "variation": int(asked.variation), "temperature": asked.temperature, "beta": asked.beta,
            "activity": asked.activity, "fps": asked.fps, "gain": asked.gain, "controls": controls,
            "intensity": asked.intensity, "mirror": asked.mirror, "energy": asked.energy,
            "handedness": asked.handedness, "hold_still": tuple(asked.hold_still), "cues": tuple(asked.cue),
            "plan": asked_plan(asked), "legs": legs, "seated": asked.seated}


def asked_plan(asked: argparse.Namespace) -> GesturePlan | None:
    """The plan to render, if any."""
    if asked.plan is None:
        return None
    from gesticulator.plan.bml import read_any_plan

    return read_any_plan(asked.plan)
