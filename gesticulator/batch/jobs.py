"""The recordings named on the command line and the files to write for each: `plan`.

Names, suffixes, folders and permissions are checked before any work. An error of the command is an `InputError`; an
error of one recording is stored in its `Job`.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_module.errors import InputError, printable
from gesticulator.export.writers import suffix_of

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


def plan(names: Sequence[str], outputs: Mapping[str, str], text: str | None = None) -> list[Job]:
    """The jobs of a command. names: files, folders, patterns, or "-". outputs: suffix (".bvh") -> the file or folder
    to write to. text: a transcript, or a folder of transcripts named like the recordings.

    A path that ends in a slash, or that is a folder, means a folder; anything else is a file. `InputError` for an
    output with the wrong suffix, one file for several recordings, two recordings of one name, or a place that cannot be
    written.
    """
    sources = _sources(names)
    if not outputs:
        raise InputError("output", "is missing", "name a file or a folder with -o")
    for suffix, given in outputs.items():
        _check_output(given, suffix, len(sources))
    if text is not None:
        _check_text(text, len(sources))
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
