"""How one recording is processed (`Worker`): read, generate, lay out as a clip or on a character, write."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError, complain, printable
from gesticulator.cli import PROGRAM
from gesticulator.jobs import CharacterRequest, Job

if TYPE_CHECKING:
    from data_module.types import Speech
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.performance import Performance


def check_job(job: Job) -> None:
    """`InputError` if the recording cannot be processed, as far as can be known without reading it."""
    from data_module.speech.audio import check_file

    if job.fault is not None:
        raise job.fault
    if job.source is not None:
        check_file(job.source, any_length=True)
    elif sys.stdin is None or sys.stdin.isatty():
        raise InputError("standard input", "holds no recording", f"pipe one into {PROGRAM}, or name a file")


def retargeter_for(character: CharacterRequest | None, quiet: bool = False) -> Retargeter | None:
    """The retargeter for the requested character; None for the default skeleton. quiet: print no remarks about it.

    The mapping is saved before it is checked, so that an unusable one can be corrected.
    """
    if character is None:
        return None
    from gesticulator.characters.reading import choose
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.characters.rig import note_of

    # An unclear rig is an error here, before any sound is read.
    rig, mapping = choose(character.file, character.mapping, character.save_mapping)
    retargeter = Retargeter(rig, mapping, contacts=character.contacts, legs=character.legs)
    note = note_of(rig, mapping.joints["Hips"])
    remarks = [note] if note else []
    remarks += [f"{doubt}; look at the result" for doubt in retargeter.doubts]
    for remark in () if quiet else remarks:
        complain(f"{PROGRAM}: {character.file}: {remark}")
    return retargeter


@dataclass(frozen=True)
class Worker:
    """What the jobs of a command are processed with. retargeter: None for the default skeleton."""

    gesticulator: Gesticulator
    retargeter: Retargeter | None = None

    def perform(self, job: Job) -> tuple[float, str]:
        """Process one recording: read it, generate its gestures and write the files. Returns seconds of sound, and the
        summary for the user."""
        check_job(job)
        speech = load(job)
        # Without reading: the factor compares computing with the duration.
        begin = time.perf_counter()
        performance = self._laid_out(job, self.performed(job, speech))
        factor = (time.perf_counter() - begin) / speech.duration
        # Files appear whole, so what is there after an error can be used.
        written = [performance.save(target) for target in job.targets]
        pages = [f"open {page} in a browser to watch it" for page in written if page.suffix.lower() == ".html"]
        lexemes = performance.lexemes.tolist()
        line = (f"{job.name}: {speech.duration:.1f} s, {len(lexemes) - 1} beats, {len(set(lexemes))} of "
                f"{len(self.gesticulator.bundle.vectors)} lexemes, real-time factor {factor:.3f} -> "
                f"{printable(', '.join(map(str, written)))}")
        return speech.duration, "\n  ".join([line, *performance.decided.notes, *pages])

    def performed(self, job: Job, speech: Speech) -> Performance:
        """The performance of a recording, on the default skeleton; with legs, too, where the character stands."""
        # Legs cost time, so they are generated only where something shows them.
        stands = self.retargeter is not None and self.retargeter.mapping.legs and self.retargeter.legs
        options: dict[str, Any] = {**vars(job.options), "legs": job.options.legs or stands}
        performance = self.gesticulator(speech, text=job.text, **options)
        return performance.labelled(job.name, performance.decided.notes)

    def _laid_out(self, job: Job, performance: Performance) -> Performance:
        """The performance as the clip of the job, on the character."""
        if job.clip is not None:
            performance = performance.as_clip(job.clip)
        return performance if self.retargeter is None else performance.moved_by(self.retargeter)


def load(job: Job) -> Speech:
    """The recording; warns if it is too quiet even after the requested gain."""
    from data_module.speech.audio import amplified, level_note, load_speech

    speech = load_speech(job.source or sys.stdin.buffer, any_length=True)
    note = level_note(amplified(speech, job.options.gain))
    if note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {note}")
    return speech
