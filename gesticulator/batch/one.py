"""One recording of a command: read, perform, write, print its summary."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError, complain, printable
from gesticulator.arguments import options_from_args
from gesticulator.batch.jobs import Job
from gesticulator.cli import PROGRAM

if TYPE_CHECKING:
    from data_module.controls import Controls
    from data_module.speech.audio import SpeechPieces
    from data_module.types import Speech
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.performance import Performance
    from gesticulator.pipeline import Gesticulator

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


def retargeter_for(args: argparse.Namespace) -> Retargeter | None:
    """The retargeter for the requested character; None for the default skeleton.

    The mapping is saved before it is checked, so that an unusable one can be corrected.
    """
    if args.character is None:
        for name in ("mapping", "save_mapping"):
            if getattr(args, name) is not None:
                raise InputError(f"--{name.replace('_', '-')}", "is about a character", "name one with --character")
        return None
    from gesticulator.characters.reading import choose
    from gesticulator.characters.retarget import Retargeter

    character, mapping = choose(args.character, args.mapping, args.save_mapping)
    legs = False if args.seated else True if args.legs else None
    retargeter = Retargeter(character, mapping, contacts=not args.no_contacts, legs=legs)
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
    if retargeter is not None:
        performance = replace(performance, character=retargeter(performance.motion))
    spent = time.perf_counter() - begin
    written = [performance.save(target, unit=args.unit if target.suffix.lower() == ".bvh" else "cm")
               for target in job.targets]
    _print_summary(job, args, _Done(speech.duration, performance.lexemes.tolist(), len(system.bundle.vectors),
                                spent / speech.duration), written, performance.notes)
    return speech.duration


@dataclass(frozen=True)
class _Done:
    """The contents of a summary. seconds: of audio; lexemes: those played; lexicon: its size; factor: real-time
    factor."""

    seconds: float
    lexemes: Sequence[int]
    lexicon: int
    factor: float


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

    whole = args.character, args.plan, args.text, args.cues or None
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

        result = perform_long(system, sound, job.targets, options_from_args(args, controls, args.legs), args.unit,
                            on_sound)
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
