"""The options of a performance on the command line, and how they become `InferenceOptions`."""

from __future__ import annotations

import argparse
import difflib
import os
from collections.abc import Callable, Mapping
from dataclasses import Field, fields
from typing import TYPE_CHECKING, Any, cast

from data_module.errors import InputError, shown
from data_module.settings import whole_number
from gesticulator.cli import PROGRAM
from gesticulator.options import RANGES, InferenceOptions, OptionFlag
from gesticulator.version import __version__
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from data_module.controls import Controls
    from gesticulator.options import InferenceArguments
    from gesticulator.pipeline import Gesticulator
    from gesticulator.plan.plan import GestureCue, GesturePlan


def number(name: str) -> Callable[[str], float]:
    """A parser of the argument --NAME that checks its range in `gesticulator.options.RANGES`."""
    return lambda text: RANGES[name].parse(f"--{name}", text)


def _seconds(text: str) -> tuple[float, float]:
    """A range of seconds such as 3.2-5.0."""
    begin, mark, stop = text.partition("-")
    try:
        first, last = float(begin), float(stop)
    except ValueError:
        mark, first, last = "", 0.0, 0.0
    if not mark or not 0 <= first < last < float("inf"):
        raise InputError(f"--hold-still {text[:40]}", "is not a range of seconds", "write it as 3.2-5.0")
    return first, last


def _cue(text: str) -> GestureCue:
    """A cue such as hello=wave, hello:2=wave or 2.5=shrug."""
    from gesticulator.plan.plan import GestureCue

    at, mark, gesture = text.rpartition("=")
    if not mark or not at or not gesture:
        raise InputError(f"--cue {text[:40]}", "is not a cue", "write WORD=GESTURE (hello=wave) or SECONDS=GESTURE")
    try:
        return GestureCue(gesture, time=float(at))
    except ValueError:
        word, _, count = at.rpartition(":")
    occurrence = whole_number(count, 10**6)
    if word and occurrence:
        return GestureCue(gesture, word, occurrence)
    return GestureCue(gesture, at)


def _mood(text: str) -> object:
    """A number, or the curve in a CSV file."""
    if os.path.lexists(text.strip()):
        from data_module.controls import MOOD, read_curve

        return read_curve(text.strip(), MOOD)
    return RANGES["mood"].parse("--mood", text)


_PARSERS: Mapping[str, Callable[[str], object]] = {"hold_still": _seconds, "cues": _cue, "mood": _mood}
"""Field -> parser of its value, for values that are neither numbers nor words."""
_GROUPS = {
    "audio and transcript": "",
    "motion": "VALUE is low, mid or high, a number, or a CSV file with the columns time and value.",
}
"""Title of a group of options -> its description."""


def performance_arguments(p: argparse.ArgumentParser) -> None:
    """Add the options of a performance (the fields of `InferenceOptions` that have a flag), of the character and of
    the run."""
    groups = {name: p.add_argument_group(name, about or None) for name, about in _GROUPS.items()}
    audio = groups["audio and transcript"]
    audio.add_argument("--text", metavar="FILE", help="transcript, in which cue phrases choose gestures with a meaning "
                       "(--meaning): plain text, TextGrid, SRT, VTT, TSV or JSON with word times; or a folder of "
                       "transcripts named like the recordings")
    audio.add_argument("--any-length", action="store_true", help="accept recordings longer than an hour")
    for field in fields(InferenceOptions):
        if "flag" in field.metadata:
            _add_option(groups[field.metadata["flag"].group], field, field.metadata["flag"])
    body = p.add_argument_group("character", "Your own character, from Mixamo, VRM, Unreal, Blender or "
                                "elsewhere; see gesticulator character --help.")
    body.add_argument("--character", metavar="FILE",
                      help="animate this character: .bvh, .glb, .gltf, .vrm, or .fbx if Blender is installed "
                      "(FILE#NAME: one of several in the file); it stands unless it is seated in the file or --seated "
                      "is given")
    body.add_argument("--mapping", metavar="FILE.json",
                      help="which nodes are which joints, if they are not identified automatically")
    body.add_argument("--save-mapping", metavar="FILE.json", help="write the joint mapping, to check or correct it")
    body.add_argument("--no-contacts", action="store_true", help="do not keep the hands outside the trunk")
    p.add_argument("--bundle", metavar="NAME|DIR", help="trained weights: default, paper (both papers in their own "
                   "form), or a folder (default: default)")
    p.add_argument("--list", choices=("speakers", "interpreters"), help="list what the bundle contains and exit")
    p.add_argument("--threads", type=number("threads"), default=1, metavar="N",
                   help="number of torch threads; it affects the last bits of the output (default 1, usually the "
                   "fastest)")
    p.add_argument("--quiet", action="store_true", help="print no progress bar and no summary")
    p.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")


def _add_option(group: argparse._ArgumentGroup, field: Field[Any], flag: OptionFlag) -> None:
    name = f"--{(flag.name or field.name).replace('_', '-')}"
    text, more = flag.help, dict[str, Any](dest=field.name, default=[] if flag.many else field.default)
    if flag.metavar is None:
        group.add_argument(name, action="store_true", help=text, **more)
        return
    if field.name == "interpreter":
        more["choices"] = tuple(INTERPRETERS)
        text += ": " + ", ".join(f"{one} ({entry.about})" for one, entry in INTERPRETERS.items())
    elif flag.choices:
        more["choices"] = flag.choices
    else:
        more["metavar"] = flag.metavar
    if field.name in _PARSERS:
        more["type"] = _PARSERS[field.name]
    elif field.name in RANGES:
        more["type"] = number(field.name)
    if flag.many:
        more["action"] = "append"
    group.add_argument(name, help=text, **more)


def check_choices(args: argparse.Namespace) -> None:
    """`InputError` for a recogniser that is missing, a speaker that is not in the bundle or a --beta that would have no
    effect, before models load."""
    if args.transcribe is not None:
        if args.text is not None:
            raise InputError("--transcribe", "hears words, and --text gives them", "leave one of them out")
        from data_module.text.transcription import find_model

        find_model(args.transcribe)
    if args.beta is not None and (args.interpreter is None or not INTERPRETERS[args.interpreter].prior):
        steered = ", ".join(name for name, entry in INTERPRETERS.items() if entry.prior)
        raise InputError(f"--beta {args.beta:g}", f"is read by the interpreter {steered} alone",
                         f"add --interpreter {steered}, or leave it out")
    if args.speaker is not None:
        from gesticulator.bundle.files import bundle_folder, read_index

        speakers = read_index(bundle_folder(args.bundle))["speakers"]
        if args.speaker not in speakers:
            near = difflib.get_close_matches(args.speaker, speakers, 1)
            raise InputError(f"--speaker {shown(args.speaker)}", "is not in the bundle",
                             (f"did you mean {near[0]}? " if near else "") + f"choose among {', '.join(speakers)}")


def check_cues(system: Gesticulator, args: argparse.Namespace) -> None:
    """`InputError` for a cue that names an unknown gesture, before any recording is processed."""
    if not args.cues:
        return
    from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, near_gestures

    shown_by_face = [cue.gesture for cue in args.cues if cue.gesture in EXPRESSIONS]
    if shown_by_face and args.face != "full":
        raise InputError(f"--cue {shown_by_face[0]}", "is of the face", "add --face full, or leave it out")
    unknown = [cue.gesture for cue in args.cues if cue.gesture not in (*GESTURES, *EXPRESSIONS)]
    if unknown:
        from gesticulator.directing.lexeme_names import lexeme_names

        names = [one.name for one in lexeme_names(system.bundle)]
        for gesture in unknown:
            if gesture not in names:
                raise InputError(f"--cue {shown(gesture)}", "is the name of no gesture", near_gestures(gesture, names))


def print_list(system: Gesticulator, what: str) -> None:
    """Print the names of the "speakers" or "interpreters", with the default one marked."""
    names = system.speakers if what == "speakers" else system.interpreters
    default = system.speakers[system.speaker_index(None)] if what == "speakers" else names[0]
    for name in names:
        print(f"{name}  (default)" if name == default else name)


def controls_from_args(system: Gesticulator, args: argparse.Namespace) -> Controls | None:
    """The style controls given on the command line; None if there are none."""
    from data_module.controls import controls_from

    values = args.hand_height, args.hand_speed, args.hand_radius
    if values == (None, None, None):
        return None
    if system.bundle.levels is None:
        raise InputError("--hand-height, --hand-speed, --hand-radius", "are not supported by this bundle",
                         "use a bundle trained with style editing, or leave them out")
    return controls_from(*values, system.bundle.levels)


def options_from_args(args: argparse.Namespace, controls: Controls | None, legs: bool) -> InferenceArguments:
    """The options given on the command line, as keyword arguments. controls: from `controls_from_args`; legs: whether
    the character has legs."""
    values = {field.name: getattr(args, field.name) for field in fields(InferenceOptions) if "flag" in field.metadata}
    values.update({name: tuple(value) for name, value in values.items() if isinstance(value, list)})
    values.update(dict.fromkeys(("hand_height", "hand_speed", "hand_radius")), controls=controls, legs=legs,
                  plan=plan_from_args(args))
    return cast("InferenceArguments", values)


def plan_from_args(args: argparse.Namespace) -> GesturePlan | None:
    """The plan given by --plan; None without one."""
    if args.plan is None:
        return None
    from gesticulator.plan.plan_file import read_plan

    return read_plan(args.plan)
