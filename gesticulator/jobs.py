"""The recordings to process and the files to write for each (`jobs_for`), and how one is processed (`Worker`): read,
generate, write.

Names, suffixes, folders and permissions are checked before any work. An error of the command is an `InputError`; an
error of one recording is stored in its `Job`.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError, complain, printable
from gesticulator.cli import PROGRAM
from gesticulator.export.clip import ClipLayout
from gesticulator.export.writers import suffix_of
from gesticulator.options import InferenceOptions

if TYPE_CHECKING:
    from data_module.types import Speech
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.performance import Performance

STDIN = "-"
"""The name of standard input on the command line."""
TRANSCRIPTS = (".TextGrid", ".json", ".srt", ".vtt", ".txt")
"""File suffixes that a folder of transcripts is searched for, in this order."""


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
    """How a command runs. bundle: its name or folder; None: the default. threads: of torch. quiet: print no progress
    bar and no summary. manifest: the file that records a batch; None: beside the outputs. shard: such as 2/8; None:
    all. ray: where a Ray cluster is; None: process in this process."""

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


@lru_cache(maxsize=64)
def _cached_hash(path: Path) -> str:
    """A character of many megabytes is read once for all recordings."""
    return file_hash(path)


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
