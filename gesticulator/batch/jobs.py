"""The recordings named on the command line and the files to write for each (`plan`), and how one is processed: read,
perform, write, print its summary (`perform`).

Names, suffixes, folders and permissions are checked before any work. An error of the command is an `InputError`; an
error of one recording is stored in its `Job`.
"""

from __future__ import annotations

import argparse
import glob
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError, complain, printable
from data_module.files import write_text
from gesticulator.arguments import options_from_args
from gesticulator.cli import PROGRAM
from gesticulator.export.writers import suffix_of

if TYPE_CHECKING:
    from data_module.controls import Controls
    from data_module.speech.audio import SpeechPieces
    from data_module.types import Speech
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.performance import Performance
    from gesticulator.pipeline import Gesticulator

STDIN = "-"
"""The name of standard input on the command line."""
TRANSCRIPTS = (".TextGrid", ".json", ".srt", ".vtt", ".txt")
"""File suffixes that a folder of transcripts is searched for, in this order."""


@dataclass(frozen=True)
class Job:
    """A recording and the files to write for it.

    source: None is standard input. targets: the output files. text: its transcript, if any. fault: why it cannot be
    processed, if that is already known.
    """

    source: Path | None
    targets: tuple[Path, ...] = ()
    text: Path | None = None
    fault: InputError | None = None

    @property
    def name(self) -> str:
        """The name of the recording in messages."""
        return "standard input" if self.source is None else printable(self.source.name)


def plan(names: Sequence[str], outputs: Mapping[str, str], text: str | None = None, together: bool = False
         ) -> list[Job]:
    """The jobs of a command. names: files, folders, patterns, or "-". outputs: suffix (".bvh") -> the file or folder
    to write to. text: a transcript, or a folder of transcripts named like the recordings. together: one file holds all
    recordings.

    A path that ends in a slash, or that is a folder, means a folder; anything else is a file. `InputError` for an
    output with the wrong suffix, one file for several recordings, two recordings of one name, or a place that cannot be
    written.
    """
    sources = _sources(names)
    if not outputs:
        raise InputError("output", "is missing", "name a file or a folder with -o")
    for suffix, given in outputs.items():
        if together and is_folder(given):
            raise InputError(given, "is a folder, and --one-file writes one file", f"name a file that ends in {suffix}")
        _check_output(given, suffix, 1 if together else len(sources))
    if text is not None:
        _check_text(text, len(sources))
    written_by: dict[Path, Path | None] = {}
    jobs = []
    for source in sources:
        stem = "stdin" if source is None else source.stem
        targets = tuple(Path(given) / f"{stem}{suffix}" if is_folder(given) else Path(given)
                        for suffix, given in outputs.items())
        for target in targets:
            if target in written_by and not together:
                raise InputError(source or STDIN, f"would be written to {target}, like {written_by[target] or STDIN}",
                                 "rename one of them, or give them folders of their own")
            written_by[target] = source
        try:
            for target in targets:
                _check_place(target)
            jobs.append(Job(source, targets, _transcript(text, stem), None))
        except InputError as fault:
            jobs.append(Job(source, targets, None, fault))
    return jobs


def is_folder(given: str) -> bool:
    """Whether a path denotes a folder: it ends in a slash or is an existing folder."""
    return given.endswith(("/", os.sep)) or Path(given).is_dir()


def _sources(names: Sequence[str]) -> list[Path | None]:
    """All named recordings without repeats, in the order of the command; contents of folders and patterns are
    sorted."""
    from data_module.speech.audio import SOUNDS

    unique: dict[Path | None, Path | None] = {}
    for name in names:
        if name == STDIN:
            unique[None] = None
            continue
        path = Path(name)
        if path.is_dir():
            inside = sorted(file for file in path.iterdir()
                            if file.suffix.lower() in SOUNDS and not file.name.startswith(".") and file.is_file())
            if not inside:
                raise InputError(path, "is a folder without sound files", f"give one with {', '.join(SOUNDS)}")
        elif set(name) & set("*?[") and not os.path.lexists(name):
            # A shell passes a quoted pattern on unexpanded, and Windows never expands patterns.
            matches = glob.glob(name, recursive=True)  # noqa: PTH207 - Path.glob refuses absolute patterns
            inside = sorted(Path(match) for match in matches if Path(match).is_file())
            if not inside:
                raise InputError(name, "matches no file", "check the pattern")
        else:
            inside = [path]
        unique.update({file.resolve(): file for file in inside if file.resolve() not in unique})
    return list(unique.values())


def _check_output(given: str, suffix: str, count: int) -> None:
    if is_folder(given):
        return
    ending = suffix_of(given)
    stem = given[:-len(ending)] if ending else given
    if count > 1:
        raise InputError(given, f"is one file for {count} recordings", f"name a folder: {stem}/")
    if ending != suffix:
        raise InputError(given, f"does not end in {suffix}", f"name it {stem or 'gesture'}{suffix}, or {given}/ for a "
                         "folder")


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
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "choose another output")
    if not os.access(folder, os.W_OK) or (target.exists() and not os.access(target, os.W_OK)):
        raise InputError(target, "cannot be written", "choose another output or change its rights")


CLIP_OPTIONS = ("clip_name", "loop", "mask", "layer", "sound", "one_file")
"""Options of clips that are given if they are true (`gesticulator.batch.clips`)."""
STREAMED = (".bvh", ".glb")
"""Suffixes of formats that can be written in pieces (`gesticulator.batch.long`), in bounded memory."""

_LONG = 300.0
"""Duration in seconds from which a recording is processed in pieces; a shorter one takes less memory than the
models."""


def check_job(job: Job, args: argparse.Namespace) -> None:
    """`InputError` if the recording cannot be processed, as far as can be known without reading it."""
    from data_module.speech.audio import check_file

    if job.fault is not None:
        raise job.fault
    if job.source is not None:
        check_file(job.source, args.any_length)
    elif sys.stdin is None or sys.stdin.isatty():
        raise InputError("standard input", "is closed" if sys.stdin is None else "is a terminal",
                         f"pipe a recording into {PROGRAM}, or name a file")


def prepare_blender(jobs: Sequence[Job], args: argparse.Namespace) -> None:
    """If the command needs Blender, start it, and let it read the character, while this process loads its libraries."""
    if args.character is not None and args.character.lower().endswith(".fbx"):
        from gesticulator.characters.fbx_rig import read_ahead

        read_ahead(args.character)
    elif any(target.suffix.lower() == ".fbx" for job in jobs for target in job.targets):
        from gesticulator.characters.blender import start_blender

        with suppress(InputError):  # said when it is needed
            start_blender(jobs[0].targets[0])
    else:
        return
    import gesticulator.pipeline  # noqa: F401 - torch takes as long to load as Blender


def retargeter_for(args: argparse.Namespace, upper: bool = False) -> Retargeter | None:
    """The retargeter for the requested character; None for the default skeleton. upper: of the upper body alone.

    The mapping is saved before it is checked, so that an unusable one can be corrected.
    """
    if args.character is None:
        for name in ("mapping", "save_mapping"):
            if getattr(args, name) is not None:
                raise InputError(f"--{name.replace('_', '-')}", "is about a character", "name one with --character")
        return None
    from gesticulator.characters.reading import choose
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.characters.several import note_of

    character, mapping = choose(args.character, args.mapping, args.save_mapping)
    legs = False if args.seated or upper else True if args.legs else None
    note = note_of(character, mapping.joints["Hips"])
    if note and not args.quiet:
        complain(f"{PROGRAM}: {args.character}: {note}")
    retargeter = Retargeter(character, mapping, contacts=not args.no_contacts, legs=legs)
    for doubt in () if args.quiet else retargeter.doubts:
        complain(f"{PROGRAM}: {args.character}: {doubt}; look at the result")
    if legs is None and not retargeter.legs and not args.quiet:
        complain(f"{PROGRAM}: {args.character}: is seated, so hips and legs stay as they are; --legs makes it stand")
    return retargeter


def perform(job: Job, system: Gesticulator, args: argparse.Namespace, controls: Controls | None = None,
            retargeter: Retargeter | None = None) -> float:
    """Process one recording and print its summary; returns its duration in seconds."""
    with _opened(job, args) as sound:
        if not 0 < sound.seconds < _LONG and _in_pieces(job, args, system):
            return _perform_long(job, sound, system, args, controls)
        speech = _loaded(job, args, sound)
    begin = time.perf_counter()
    stands = retargeter is not None and retargeter.mapping.legs and retargeter.legs
    performance = performed(job, speech, system, args, controls, args.legs or stands)
    performance = performance.labelled(job.name, performance.notes)
    if clip_is_asked(args):
        from gesticulator.batch.clip_options import clip_from_args

        clip = clip_from_args(args)
        performance = performance.as_clip(replace(clip, sound=clip.sound and not _is_beside(job)))
    if retargeter is not None:
        performance = performance.moved_by(retargeter)
    spent = time.perf_counter() - begin
    written = [performance.save(target, unit=args.unit if target.suffix.lower() == ".bvh" else "cm")
               for target in job.targets]
    notes, retiming = performance.notes, performance.retiming
    if retiming is not None:
        notes += retiming.lines()[1:]
        if args.retime_report is not None:
            write_text(Path(args.retime_report), json.dumps(retiming.to_dict(), indent=1) + "\n")
    _print_summary(job, args, _Done(speech.duration, performance.lexemes.tolist(), len(system.bundle.vectors),
                                spent / speech.duration), written, notes)
    return speech.duration


@dataclass(frozen=True)
class _Done:
    """The contents of a summary. seconds: of audio; lexemes: those played; lexicon: its size; factor: real-time
    factor."""

    seconds: float
    lexemes: Sequence[int]
    lexicon: int
    factor: float


def clip_is_asked(args: argparse.Namespace) -> bool:
    """Whether any option of clips is given."""
    return any(getattr(args, name) for name in CLIP_OPTIONS) or args.keys is not None or args.root != "hips"


def _is_beside(job: Job) -> bool:
    """Whether the sound beside an output is the recording itself, which must not be replaced."""
    return job.source is not None and any(target.with_suffix(".wav").resolve() == job.source.resolve()
                                          for target in job.targets)


def _print_summary(job: Job, args: argparse.Namespace, done: _Done, written: Sequence[Path], notes: Sequence[str] = ()
              ) -> None:
    if not args.quiet:
        print(f"{job.name}: {done.seconds:.1f} s, {len(done.lexemes) - 1} beats, "
              f"{len(set(done.lexemes))} of {done.lexicon} lexemes, "
              f"real-time factor {done.factor:.3f} -> {printable(', '.join(map(str, written)))}"
              + "".join(f"\n  {note}" for note in notes), flush=True)
        for page in written:
            if page.suffix.lower() == ".html":
                print(f"  open {page} in a browser to watch it", flush=True)


def _in_pieces(job: Job, args: argparse.Namespace, system: Gesticulator) -> bool:
    """Whether the recording can be processed in pieces: character, words and plan need all of it, and not every format
    can be written in pieces."""
    from gesticulator.batch.long import can_be_done

    whole = (args.character, args.plan, args.text, args.cues or None, args.loop or None, args.mask, args.layer,
             args.sound or None, None if args.root == "hips" else args.root, args.transcribe,
             None if args.face == "off" else args.face)
    return (whole == (None,) * len(whole) and all(target.suffix.lower() in STREAMED for target in job.targets)
            and can_be_done(system.bundle))


def _perform_long(job: Job, sound: SpeechPieces, system: Gesticulator, args: argparse.Namespace,
                  controls: Controls | None) -> float:
    """Process a long recording in pieces, in bounded memory; returns its duration in seconds."""
    from tqdm import tqdm

    from gesticulator.batch.long import perform_long

    begin = time.perf_counter()
    with closing(tqdm(desc=job.name, unit=" s", leave=False, total=round(sound.seconds) or None,
                      disable=args.quiet or not sys.stderr.isatty())) as bar:
        def on_sound(seconds: float) -> None:
            bar.update(round(seconds) - bar.n)

        clip = None
        if clip_is_asked(args):
            from gesticulator.batch.clip_options import clip_from_args

            clip = clip_from_args(args)
        result = perform_long(system, sound, job.targets, options_from_args(args, controls, args.legs), args.unit,
                              on_sound, clip)
    if result.note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {result.note}")
    spent = time.perf_counter() - begin
    _print_summary(job, args, _Done(result.seconds, result.lexemes, len(system.bundle.vectors), spent / result.seconds),
              job.targets)
    return result.seconds


def _opened(job: Job, args: argparse.Namespace) -> AbstractContextManager[SpeechPieces]:
    from data_module.speech.audio import speech_pieces

    return speech_pieces(job.source or sys.stdin.buffer, args.any_length)


def load(job: Job, args: argparse.Namespace) -> Speech:
    """The recording; warns if it is too quiet even after the requested gain."""
    with _opened(job, args) as sound:
        return _loaded(job, args, sound)


def _loaded(job: Job, args: argparse.Namespace, sound: SpeechPieces) -> Speech:
    from data_module.speech.audio import amplified, level_note

    speech = sound.whole()
    note = level_note(amplified(speech, args.gain))
    if note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {note}")
    return speech


def performed(job: Job, speech: Speech, system: Gesticulator, args: argparse.Namespace, controls: Controls | None,
              legs: bool) -> Performance:
    """The performance of a recording, with a progress bar on the terminal."""
    from tqdm import tqdm

    with closing(tqdm(desc=job.name, unit=" blocks", leave=False,
                      disable=args.quiet or not sys.stderr.isatty())) as bar:
        def on_block(done: int, total: int) -> None:
            bar.total = total
            bar.update()

        return system(speech, text=job.text, on_block=on_block, **options_from_args(args, controls, legs))
