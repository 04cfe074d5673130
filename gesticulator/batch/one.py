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
from gesticulator.arguments import asked_options
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
"""Endings of what can be written in pieces (`gesticulator.batch.long`), in bounded memory."""

_LONG = 300.0
"""Seconds from which on a recording is done in pieces; below, all of it takes less memory than the models do."""


def check_job(job: Job, asked: argparse.Namespace) -> None:
    """`InputError` where the recording cannot be done, as far as is known without reading it."""
    from data_module.speech.audio import check_file

    if job.fault is not None:
        raise job.fault
    if job.source is not None:
        check_file(job.source, asked.any_length)
    elif sys.stdin is None or sys.stdin.isatty():
        raise InputError("standard input", "is closed" if sys.stdin is None else "is a terminal",
                         f"pipe a recording into {PROGRAM}, or name a file")


def retargeter_for(asked: argparse.Namespace) -> Retargeter | None:
    """What brings motions onto the character that is asked for; None for our own skeleton.

    The mapping is saved before it is judged: what cannot be used as it is can then be corrected.
    """
    if asked.character is None:
        for name in ("mapping", "save_mapping"):
            if getattr(asked, name) is not None:
                raise InputError(f"--{name.replace('_', '-')}", "is about a character", "name one with --character")
        return None
    from gesticulator.characters.reading import choose
    from gesticulator.characters.retarget import Retargeter

    character, mapping = choose(asked.character, asked.mapping, asked.save_mapping)
    legs = False if asked.seated else True if asked.legs else None
    made = Retargeter(character, mapping, contacts=not asked.no_contacts, legs=legs)
    if legs is None and not made.legs and not asked.quiet:
        complain(f"{PROGRAM}: {asked.character}: is seated, so hips and legs stay as they are; --legs makes it stand")
    return made


def perform(job: Job, system: Gesticulator, asked: argparse.Namespace, controls: Controls | None = None,
            retargeter: Retargeter | None = None) -> float:
    """Do one recording and print its summary; its seconds."""
    with _opened(job, asked) as sound:
        if not 0 < sound.seconds < _LONG and _in_pieces(job, asked, system):
            return _perform_long(job, sound, system, asked, controls)
        speech = _heard(job, asked, sound)
    begin = time.perf_counter()
    stands = retargeter is not None and retargeter.mapping.legs and retargeter.legs
    made = performed(job, speech, system, asked, controls, asked.legs or stands)
    made = made.labelled(job.name, made.notes)
    if retargeter is not None:
        made = replace(made, character=retargeter(made.motion))
    spent = time.perf_counter() - begin
    written = [made.save(target, unit=asked.unit if target.suffix.lower() == ".bvh" else "cm")
               for target in job.targets]
    _say_done(job, asked, _Done(speech.duration, made.lexemes.tolist(), len(system.bundle.vectors),
                                spent / speech.duration), written, made.notes)
    return speech.duration


@dataclass(frozen=True)
class _Done:
    """What a summary tells: seconds of sound, the lexemes played, how many there are, and seconds per second."""

    seconds: float
    lexemes: Sequence[int]
    lexicon: int
    factor: float


def _say_done(job: Job, asked: argparse.Namespace, done: _Done, written: Sequence[Path], notes: Sequence[str] = ()
              ) -> None:
    if not asked.quiet:
        print(f"{job.name}: {done.seconds:.1f} s, {len(done.lexemes) - 1} beats, "
              f"{len(set(done.lexemes))} of {done.lexicon} lexemes, "
              f"real-time factor {done.factor:.3f} -> {printable(', '.join(map(str, written)))}"
              + "".join(f"\n  {note}" for note in notes), flush=True)
        for page in written:
            if page.suffix.lower() == ".html":
                print(f"  open {page} in a browser to watch it", flush=True)


def _in_pieces(job: Job, asked: argparse.Namespace, system: Gesticulator) -> bool:
    """Whether so little is asked that a recording may be done in pieces: no character, words or plan, which need the
    whole, and files that can be written so."""
    from gesticulator.batch.long import can_be_done

    whole = asked.character, asked.plan, asked.text, asked.cues or None
    return (whole == (None,) * len(whole) and all(target.suffix.lower() in STREAMED for target in job.targets)
            and can_be_done(system.bundle))


def _perform_long(job: Job, sound: SpeechPieces, system: Gesticulator, asked: argparse.Namespace,
                  controls: Controls | None) -> float:
    """Do a recording of some minutes or more in pieces, in bounded memory; its seconds."""
    from tqdm import tqdm

    from gesticulator.batch.long import perform_long

    begin = time.perf_counter()
    with closing(tqdm(desc=job.name, unit=" s", leave=False, total=round(sound.seconds) or None,
                      disable=asked.quiet or not sys.stderr.isatty())) as bar:
        def on_sound(seconds: float) -> None:
            bar.update(round(seconds) - bar.n)

        made = perform_long(system, sound, job.targets, asked_options(asked, controls, asked.legs), asked.unit,
                            on_sound)
    if made.note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {made.note}")
    spent = time.perf_counter() - begin
    _say_done(job, asked, _Done(made.seconds, made.lexemes, len(system.bundle.vectors), spent / made.seconds),
              job.targets)
    return made.seconds


def _opened(job: Job, asked: argparse.Namespace) -> AbstractContextManager[SpeechPieces]:
    """The recording, to be read."""
    from data_module.speech.audio import speech_pieces

    return speech_pieces(job.source or sys.stdin.buffer, asked.any_length)


def load(job: Job, asked: argparse.Namespace) -> Speech:
    """The recording as it is; a warning where little of it will be heard, even amplified as was asked."""
    with _opened(job, asked) as sound:
        return _heard(job, asked, sound)


def _heard(job: Job, asked: argparse.Namespace, sound: SpeechPieces) -> Speech:
    from data_module.speech.audio import amplified, level_note

    speech = sound.whole()
    note = level_note(amplified(speech, asked.gain))
    if note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {note}")
    return speech


def performed(job: Job, speech: Speech, system: Gesticulator, asked: argparse.Namespace, controls: Controls | None,
              legs: bool) -> Performance:
    """What the command asks of a recording, with a bar on the terminal while it is drawn."""
    from tqdm import tqdm

    with closing(tqdm(desc=job.name, unit=" blocks", leave=False,
                      disable=asked.quiet or not sys.stderr.isatty())) as bar:
        def on_block(done: int, total: int) -> None:
            bar.total = total
            bar.update()

        return system(speech, text=job.text, on_block=on_block, **asked_options(asked, controls, legs))
