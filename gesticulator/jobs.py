"""From the command line to jobs: the arguments, and the recordings to process with the files to write for each.

`jobs_of` makes the jobs, `run_settings_of` the rest; after them no argparse namespace is read. Names, suffixes, folders
and permissions are checked before any work. An error of the command is an `InputError`; an error of one recording is
stored in its `Job`.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError, printable
from data_module.files import file_hash
from data_module.settings import field_docs, whole_number
from gesticulator.cli import PROGRAM, __version__
from gesticulator.export.writers import WRITERS, check_output, suffix_of
from gesticulator.options import RANGES, InferenceOptions, OptionFlag
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from gesticulator.export.clip import ClipLayout
    from gesticulator.plan.plan import GestureCue

STDIN = "-"
"""The name of standard input on the command line."""
TRANSCRIPTS = (".TextGrid", ".json", ".jsonl", ".ctm", ".ttml", ".ass", ".lrc", ".srt", ".vtt", ".sbv", ".tsv", ".txt")
"""File suffixes that a folder of transcripts is searched for, in this order."""
FORMAT = "bvh"
"""The format written to a folder if --format is not given."""
_OUTPUTS = {"preview": ".html", "plan_out": ".json"}
"""Argument for an output file of one format -> its suffix; --output takes every format."""


@dataclass(frozen=True)
class CharacterRequest:
    """The character to animate.

    file: its path, or FILE#NAME for one of several in a file. mapping: a file that says which nodes are which joints;
    save_mapping: where to write it. contacts: whether the hands are kept outside the trunk. legs: whether its legs
    move.
    """

    file: str
    mapping: str | None = None
    save_mapping: str | None = None
    contacts: bool = True
    legs: bool = True


@dataclass(frozen=True)
class Job:
    """A recording and everything that decides what is written for it.

    source: its file; None is standard input. targets: the output files. text: its transcript, if any. options: of the
    performance. clip: how files for animation tools are laid out; None: by default. character: None for the default
    skeleton. fault: why it cannot be processed, if that is already known.
    """

    source: Path | None
    targets: tuple[Path, ...] = ()
    text: Path | None = None
    options: InferenceOptions = field(default_factory=InferenceOptions)
    clip: ClipLayout | None = None
    character: CharacterRequest | None = None
    fault: InputError | None = None

    @property
    def name(self) -> str:
        """The name of the recording in messages."""
        return "standard input" if self.source is None else printable(self.source.name)

    @property
    def digest(self) -> str:
        """SHA-256 of what decides the bytes of the output, but for the recording itself and the names of the files. A
        file that a setting names counts by its content, so that a moved folder changes nothing."""
        # A digest instead of the values: rows of a manifest stay short, and hold no paths.
        parts = [(entry.name, _content(getattr(self, entry.name))) for entry in fields(self)
                 if entry.name not in ("source", "targets", "fault")]
        return hashlib.sha256(repr(parts).encode()).hexdigest()


@dataclass(frozen=True)
class RunSettings:
    """How a command runs. bundle: its name or folder; None: the default. threads: of matrix products. quiet: print no
    progress bar and no summary. manifest: the file that records a batch; None: beside the outputs. shard: such as 2/8;
    None: all. ray: where a Ray cluster is; None: process in this process."""

    bundle: str | None = None
    threads: int = 1
    quiet: bool = False
    manifest: str | None = None
    shard: str | None = None
    ray: str | None = None

    @property
    def is_batch(self) -> bool:
        """Whether a manifest records what was done."""
        return bool(self.manifest or self.shard or self.ray)


def _content(value: Any) -> object:
    """A value of a setting; of the path of a file the SHA-256 of its bytes, also inside dataclasses."""
    if isinstance(value, InferenceOptions | CharacterRequest):
        return [(entry.name, _content(getattr(value, entry.name))) for entry in fields(value)]
    if isinstance(value, str | os.PathLike) and Path(value).is_file():
        return _cached_hash(Path(value))
    return value


_cached_hash = lru_cache(maxsize=64)(file_hash)
"""A character of many megabytes is read once for all recordings."""


def jobs_for(names: Sequence[str], outputs: Mapping[str, str], text: str | None = None) -> list[Job]:
    """The jobs of a command. names: files, folders, or "-". outputs: suffix (".bvh") -> the file or folder
    to write to. text: a transcript, or a folder of transcripts named like the recordings.

    A path that ends in a slash, or that is a folder, means a folder; anything else is a file. `InputError` for an
    output with the wrong suffix, one file for several recordings, two recordings of one name, or a place that cannot be
    written.
    """
    sources = _sources(names)
    if not outputs:
        raise InputError("output", "is missing", "name a file or a folder with -o")
    for suffix, given in outputs.items():
        if not is_folder(given) and len(sources) > 1:
            raise InputError(given, f"is one file for {len(sources)} recordings", f"name a folder: {given}/")
        if not is_folder(given) and suffix_of(given) != suffix:
            raise InputError(given, f"does not end in {suffix}", f"name it so, or {given}/ for a folder")
    if text is not None:
        _check_text(text, len(sources))
    # Two recordings of one name in different folders would overwrite each other's output.
    written_by: dict[Path, Path | None] = {}
    jobs = []
    for source in sources:
        stem = "stdin" if source is None else source.stem
        targets = tuple(Path(given) / f"{stem}{suffix}" if is_folder(given) else Path(given)
                        for suffix, given in outputs.items())
        for target in targets:
            if target in written_by:
                raise InputError(source or STDIN, f"would be written to {target}, like {written_by[target] or STDIN}",
                                 "rename one of them, or give them folders of their own")
            written_by[target] = source
        try:
            for target in targets:
                _check_place(target)
            jobs.append(Job(source, targets, _transcript(text, stem)))
        except InputError as fault:
            jobs.append(Job(source, targets, fault=fault))
    return jobs


def is_folder(given: str) -> bool:
    """Whether a path denotes a folder: it ends in a slash or is an existing folder."""
    return given.endswith(("/", os.sep)) or Path(given).is_dir()


def _sources(names: Sequence[str]) -> list[Path | None]:
    """All named recordings without repeats, in the order of the command; contents of folders are sorted."""
    from data_module.speech.audio import SOUNDS

    unique: dict[Path | None, Path | None] = {}
    for name in names:
        if name == STDIN:
            unique[None] = None
            continue
        # A folder is not searched for more folders: what lies deeper is often a copy or an export.
        path = Path(name)
        if path.is_dir():
            inside = sorted(file for file in path.iterdir()
                            if file.suffix.lower() in SOUNDS and not file.name.startswith(".") and file.is_file())
            if not inside:
                raise InputError(path, "is a folder without sound files", f"give one with {', '.join(SOUNDS)}")
        else:
            inside = [path]
        # The first name that a recording was given under stays, so messages show what was typed.
        unique.update({file.resolve(): file for file in inside if file.resolve() not in unique})
    return list(unique.values())


def _check_text(given: str, count: int) -> None:
    if not os.path.lexists(given):
        raise InputError(given, "does not exist", "check --text")
    if count > 1 and not Path(given).is_dir():
        raise InputError(given, "is one transcript for several recordings",
                         "name a folder of transcripts named like the recordings")


def _transcript(given: str | None, stem: str) -> Path | None:
    if given is None or not Path(given).is_dir():
        return None if given is None else Path(given)
    for suffix in TRANSCRIPTS:
        if (Path(given) / f"{stem}{suffix}").is_file():
            return Path(given) / f"{stem}{suffix}"
    raise InputError(given, f"holds no transcript of {stem}",
                     f"name it {stem}{' or '.join(TRANSCRIPTS)}, or leave --text out")


def _check_place(target: Path) -> None:
    """`InputError` if the target cannot be written; missing folders are created later, when it is written."""
    if target.is_dir():
        raise InputError(target, "is a folder", "choose another output")
    folder = target.parent
    # The nearest folder that exists decides, as missing ones are created below it.
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "choose another output")
    if not os.access(folder, os.W_OK) or (target.exists() and not os.access(target, os.W_OK)):
        raise InputError(target, "cannot be written", "choose another output or change its rights")


# --------------------------------------------------------------------------------------------------- the command line

def number(name: str) -> Callable[[str], float]:
    """A parser of the argument --NAME that checks its range in `gesticulator.options.RANGES`."""
    return lambda text: RANGES[name].parse(f"--{name}", text)


def _seconds(text: str) -> tuple[float, float]:
    """A range of seconds such as 3.2-5.0."""
    begin, _, stop = text.partition("-")
    try:
        return float(begin), float(stop)
    except ValueError:
        raise InputError(f"--hold-still {text[:40]}", "is not a range of seconds", "write it as 3.2-5.0") from None


def _cue(text: str) -> GestureCue:
    """A cue such as hello=wave, hello:2=wave or 2.5=shrug."""
    from gesticulator.plan.plan import GestureCue

    at, mark, gesture = text.rpartition("=")
    if not mark or not at or not gesture:
        raise InputError(f"--cue {text[:40]}", "is not a cue", "write WORD=GESTURE (hello=wave) or SECONDS=GESTURE")
    try:
        return GestureCue(gesture, time=float(at))
    except ValueError:
        # Not a number of seconds: a word, with its occurrence after a colon.
        word, _, count = at.rpartition(":")
    occurrence = whole_number(count, 10**6)
    if word and occurrence:
        return GestureCue(gesture, word, occurrence)
    return GestureCue(gesture, at)


def _keys(text: str) -> float:
    from gesticulator.export.clip import parse_keys

    return parse_keys(text)


_PARSERS: Mapping[str, Callable[[str], object]] = {"hold_still": _seconds, "cues": _cue}
"""Field -> parser of its value, for values that are neither numbers nor words."""


def performance_arguments(p: argparse.ArgumentParser) -> None:
    """Add the options of a performance (the fields of `InferenceOptions` that have a flag), of the character and of
    the run."""
    audio = p.add_argument_group("audio and transcript")
    motion = p.add_argument_group("motion", "VALUE is low, mid or high, or a number.")
    audio.add_argument("--text", metavar="FILE", help="transcript, in which cue phrases choose gestures with a meaning "
                       "(--meaning): plain text, TextGrid, SRT, VTT, TSV or JSON with word times; or a folder of "
                       "transcripts named like the recordings")
    # The help of an option is its docstring, so that both say the same.
    docs = field_docs(InferenceOptions)
    for option in fields(InferenceOptions):
        if "flag" in option.metadata:
            flag: OptionFlag = option.metadata["flag"]
            _add_option(audio if flag.of_sound else motion, option, flag, _help_of(docs[option.name], option, flag))
    body = p.add_argument_group("character", "Your own character, from Mixamo, VRM, Unreal, Blender or "
                                "elsewhere; see gesticulator character --help.")
    body.add_argument("--character", metavar="FILE",
                      help="animate this character: .bvh, .glb, .gltf, .vrm, or .fbx if Blender is installed "
                      "(FILE#NAME: one of several in the file); it stands unless --seated "
                      "is given")
    body.add_argument("--mapping", metavar="FILE.json",
                      help="which nodes are which joints, if they are not identified automatically")
    body.add_argument("--save-mapping", metavar="FILE.json", help="write the joint mapping, to check or correct it")
    body.add_argument("--no-contacts", action="store_true", help="do not keep the hands outside the trunk")
    p.add_argument("--bundle", metavar="NAME", help="trained weights: default, paper (both papers in their own form), "
                   "a folder, or ORG/NAME of a hub (default: default)")
    # One thread: blocks are small, and threads that wait for each other cost more than they gain.
    p.add_argument("--threads", type=number("threads"), default=1, metavar="N",
                   help="threads of matrix products; they affect the last bits of the output (default 1, usually the "
                   "fastest)")
    p.add_argument("--quiet", action="store_true", help="print no progress bar and no summary")
    p.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")


def _help_of(doc: str, field: Field[Any], flag: OptionFlag) -> str:
    """The help of an option: the first sentence of its docstring, with its default."""
    # References in backticks mean nothing on a command line.
    sentence = re.sub(r" \(`[^)]*`\)|`", "", re.split(r"\.(?: |$)", doc, maxsplit=1)[0])
    if flag.many:
        sentence += "; can be repeated"
    if flag.metavar is not None and field.default not in (None, ()):
        sentence += f" (default {field.default})" if isinstance(field.default, str) else f" (default {field.default:g})"
    return sentence[0].lower() + sentence[1:]


def _add_option(group: argparse._ArgumentGroup, field: Field[Any], flag: OptionFlag, text: str) -> None:
    name = f"--{(flag.name or field.name).replace('_', '-')}"
    # A list that can be appended to, not the tuple of the field's default.
    more = dict[str, Any](dest=field.name, default=[] if flag.many else field.default)
    if flag.metavar is None:
        group.add_argument(name, action="store_true", help=text, **more)
        return
    if field.name == "interpreter":
        more["choices"] = tuple(INTERPRETERS)
        text += ": " + ", ".join(f"{key} ({entry.about})" for key, entry in INTERPRETERS.items())
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


def infer_arguments(p: argparse.ArgumentParser) -> None:
    """Add the arguments of `gesticulator infer`."""
    p.usage = f"{p.prog} SPEECH [SPEECH ...] -o FILE [options]"
    p.add_argument("speech", nargs="*", metavar="SPEECH",
                   help="audio files (WAV, FLAC, OGG, MP3; M4A, MP4, WebM and other video with PyAV; 0.3 s or "
                   "longer), folders of them, or - for standard input")
    out = p.add_argument_group(
        "output (at least one is required)", "A path that ends in / or is a folder receives one file per recording, "
        "named\nafter it; any other path is the file itself. Missing folders are created.")
    out.add_argument("-o", "--output", metavar="FILE", action="append", help="motion, in the format given by the "
                     "suffix: " + ", ".join(sorted(WRITERS)) + "; can be repeated")
    out.add_argument("--format", metavar="SUFFIX", help=f"format of -o if it is a folder (default {FORMAT})")
    out.add_argument("--preview", metavar="FILE.html", help="a page that plays the motion in a browser")
    out.add_argument("--plan-out", "--explain", metavar="FILE.json",
                     help="the gesture plan: every decision, to read, edit and render again with --plan")
    _clip_arguments(p)
    many = p.add_argument_group("many recordings", "A manifest records what was done; a second run processes only "
                                                   "what is missing or changed.")
    many.add_argument("--manifest", metavar="FILE.jsonl",
                      help="the manifest, JSON lines; default with --shard and --ray: manifest.jsonl in the folder of "
                      "-o")
    many.add_argument("--shard", metavar="I/N", help="process shard I of N, of equal duration")
    many.add_argument("--ray", metavar="WHERE",
                      help="process on a Ray cluster: auto, its address, or local:N for N workers on this machine")
    performance_arguments(p)


def _clip_arguments(p: argparse.ArgumentParser) -> None:
    clip = p.add_argument_group("clips for animation tools", "How the animation is laid out.")
    clip.add_argument("--clip-name", metavar="NAME", help="name of the animation in the file (default gesture)")
    clip.add_argument("--keys", metavar="DEGREES", type=_keys, help="leave out keys that interpolation restores "
                      "within so many degrees in .glb, .vrma and .fbx, or all to write every frame (default 0.1)")
    clip.add_argument("--loop", action="store_true", help="the end passes into the beginning without a seam")
    clip.add_argument("--mask", choices=("upper",), help="upper: animate the upper body alone; hips and legs have no "
                      "tracks")
    clip.add_argument("--layer", choices=("additive",), help="additive: the upper body relative to its resting pose, "
                      "to be added to an idle clip of the file")


def run_settings_of(args: argparse.Namespace) -> RunSettings:
    """The settings of a run from its arguments; a command may lack those of a batch."""
    values: dict[str, Any] = {field.name: getattr(args, field.name, field.default) for field in fields(RunSettings)}
    return RunSettings(**values)


def settings_of(args: argparse.Namespace, upper: bool = False) -> Job:
    """A job without recording and files, with the settings of all jobs of a command: the arguments of
    `performance_arguments`. upper: only the upper body is written. `InputError` for options that exclude each other."""
    # Two sources of words could contradict each other.
    if args.transcribe is not None and args.text is not None:
        raise InputError("--transcribe", "hears words, and --text gives them", "leave one of them out")
    values = {field.name: getattr(args, field.name) for field in fields(InferenceOptions) if "flag" in field.metadata}
    # argparse collects repeated options in lists; options are frozen and hashed.
    values.update({name: tuple(value) for name, value in values.items() if isinstance(value, list)})
    if args.plan is not None:
        from gesticulator.plan.plan_file import read_plan

        values["plan"] = read_plan(args.plan)
    options = InferenceOptions(**values)
    if options.cues and options.face != "full":
        from gesticulator.plan.gestures import EXPRESSIONS

        # Without a face the cue would have no effect, which no message would tell.
        if any(cue.gesture in EXPRESSIONS for cue in options.cues):
            raise InputError("--cue", "names an expression of the face", "add --face full, or leave it out")
    character = None if args.character is None else CharacterRequest(
        args.character, args.mapping, args.save_mapping, not args.no_contacts, not (args.seated or upper))
    return Job(None, options=options, character=character)


def jobs_of(args: argparse.Namespace) -> list[Job]:
    """The jobs of `gesticulator infer`; `InputError` for what can be found wrong before any work."""
    if not args.speech:
        raise InputError("speech", "is missing", f"name a sound file; see {PROGRAM} infer --help")
    outputs = _output_files(args)
    clip = _clip_of(args)
    if clip is not None:
        from gesticulator.export.clip import check_clip_outputs

        check_clip_outputs(clip, outputs)
    jobs = jobs_for(args.speech, outputs, args.text)
    if args.plan is not None:
        if len(jobs) > 1:
            raise InputError("--plan", f"is for one recording, and {len(jobs)} are given", "give one")
        if args.text is not None and not args.retime:
            raise InputError("--text", "is already in the plan", "leave it out")
    like = settings_of(args, clip is not None and clip.bare)
    return [replace(job, options=like.options, clip=clip, character=like.character) for job in jobs]


def _clip_of(args: argparse.Namespace) -> ClipLayout | None:
    """The layout of clips; None if no option of clips is given."""
    # Without any of these options files are laid out as they always were, byte for byte.
    if not any((args.clip_name, args.loop, args.mask, args.layer, args.keys is not None)):
        return None
    from gesticulator.export.clip import NAME, ClipLayout

    keys = ClipLayout().keys if args.keys is None else args.keys
    return ClipLayout(args.clip_name or NAME, keys, args.loop, args.mask == "upper", args.layer == "additive")


def _output_files(args: argparse.Namespace) -> dict[str, str]:
    """Suffix -> the file or folder to write to. `InputError` if it cannot be written or a format is given twice."""
    given = [(_suffix_of(name, args.format), name) for name in args.output or ()]
    given += [(suffix, getattr(args, name)) for name, suffix in _OUTPUTS.items() if getattr(args, name) is not None]
    outputs: dict[str, str] = {}
    for suffix, name in given:
        if suffix in outputs:
            raise InputError(name, f"is a second {suffix} beside {outputs[suffix]}", "name one of them")
        check_output(Path(name) / f"gesture{suffix}" if is_folder(name) else name)
        outputs[suffix] = name
    return outputs


def _suffix_of(name: str, chosen: str | None) -> str:
    """The suffix of an output; chosen: the value of --format."""
    if is_folder(name):
        suffix = "." + (chosen or FORMAT).lower().lstrip(".")
        # g1 is short for .g1.csv, a suffix of two parts.
        return suffix if suffix in WRITERS else next((two for two in WRITERS if two.startswith(f"{suffix}.")), suffix)
    if chosen is not None:
        raise InputError("--format", f"is for folders, and {name} is a file", "leave it out")
    if not suffix_of(name):
        raise InputError(name, "has no suffix",
                         f"end it with one of {', '.join(sorted(WRITERS))}, or with / for a folder")
    return suffix_of(name)
