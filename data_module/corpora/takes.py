"""Takes: the motion, the sound and the text of one recording, in files of the same name.

They may be side by side or in sibling folders (`Motion/NAME.bvh` and `Audio/NAME.wav`). A take without sound is left
out and reported; the words of a take without text are unknown.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

from data_module.corpora.base import DroppedError, Imported, Item, Options
from data_module.errors import InputError
from data_module.motion import skeletons
from data_module.motion.bvh import CENTIMETRES, FRAME_RATE_ADVICE, BvhWarning, read_bvh
from data_module.motion.smplx import read_smplx
from data_module.speech.audio import load_speech
from data_module.store import RecordingInfo
from data_module.types import Motion, Speech

TEXTS = (".textgrid", ".json", ".srt", ".vtt", ".txt")
"""Suffixes of transcripts, the most reliable times first."""


@dataclass(frozen=True)
class Take:
    """The files of one recording; text is None where there is none."""

    motion: Path
    sound: Path
    text: Path | None = None


def find_takes(source: Path, name: re.Pattern[str], shape: str, advice: str, *, texts: Sequence[str] = TEXTS
               ) -> tuple[dict[str, Take], list[str]]:
    """The takes below `source` whose file names fully match `name`, by name; and notes on missing files. texts:
    suffixes of transcripts, in lower case, best first. `InputError` for a duplicate file, or, with `advice`, if no take
    is complete; shape: how its message writes the names."""
    kinds = (".bvh", ".wav", *texts)
    files_of: dict[str, dict[str, Path]] = {}
    for file in sorted(source.rglob("*")):
        kind = file.suffix.lower()
        if kind not in kinds or not name.fullmatch(file.stem) or not file.is_file():
            continue
        files = files_of.setdefault(file.stem, {})
        # Copies in two folders could differ, and which one is read would depend on the order of the listing.
        if kind in files:
            raise InputError(file, f"is there twice (also {files[kind]})", "remove one of them")
        files[kind] = file
    takes: dict[str, Take] = {}
    notes: list[str] = []
    # A take without sound or motion is left out.
    for stem, files in sorted(files_of.items()):
        missing = [kind for kind in (".bvh", ".wav") if kind not in files]
        if missing:
            notes += [f"left out {stem}: {stem}{kind} is missing" for kind in missing]
            continue
        takes[stem] = Take(files[".bvh"], files[".wav"], next((files[kind] for kind in texts if kind in files), None))
        if takes[stem].text is None and texts:
            notes.append(f"{stem}: {stem}{texts[0]} is missing, so its words are unknown")
    if not takes:
        raise InputError(source, f"holds no {shape}.bvh with a .wav of the same name"
                         + (f" ({notes[0]})" if notes else ""), advice)
    return takes, notes


def read_take(info: RecordingInfo, take: Take, options: Options, unit: float | None) -> Imported:
    """Read a take. unit: as published, None if unknown. `DroppedError` names the file that cannot be used."""
    try:
        motion, unit_note = read_motion(take.motion, options, unit)
        speech, timing = replace(load_speech(take.sound), speaker=info.speaker), ""
        if take.text is not None:
            speech, timing = with_text(speech, take.text)
    except InputError as error:
        raise DroppedError(str(error)) from None
    return Imported(info, speech, motion, unit=unit_note, words=timing)


class TakeReader:
    """A reader of takes in BVH (or SMPL-X) and WAV files; a data set derives from it and says which takes there are."""

    licence: str
    unit: float | None = None
    """Metres per unit, as published; None: guessed."""

    def __init__(self, options: Options, takes: Mapping[str, Take], infos: Sequence[RecordingInfo],
                 notes: Sequence[str]) -> None:
        self._options, self._takes, self._infos, self._notes = options, takes, infos, notes

    def settings(self) -> Mapping[str, Any]:
        """See `Reader.settings`."""
        # The sizes of the files stand for their content: hashing hours of sound would take minutes.
        sizes = {name: [file.stat().st_size for file in astuple(take) if file] for name, take in self._takes.items()}
        return {"files": {info.name: [info.split, *sizes[info.name]] for info in self._infos},
                "motion_fps": self._options.fps, "unit": self._options.unit}

    def items(self) -> Sequence[Item]:
        """See `Reader.items`."""
        return [Item(info, index) for index, info in enumerate(self._infos)]

    def read(self, item: Item) -> Imported:
        """See `Reader.read`."""
        return read_take(item.info, self._takes[item.info.name], self._options, self.unit)

    def notes(self) -> Sequence[str]:
        """See `Reader.notes`."""
        return self._notes


def read_motion(path: Path, options: Options, published: float | None = None) -> tuple[Motion, str]:
    """A BVH file in metres, and a note on its unit: that of --unit, else the published one, else a guess by the length
    from hips to head; or an SMPL-X file, which is in metres."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BvhWarning)  # the user gave the rate, so the warning is answered
        try:
            if path.suffix == ".npz":
                return read_smplx(path, fps=options.fps), "1 m, as published"
            raw = read_bvh(path, fps=options.fps, unit=1.0)
        except InputError as error:
            # The advice of these readers names their argument; here that is an option.
            if error.advice == FRAME_RATE_ADVICE:
                raise InputError(error.subject, error.wrong, "give the frame rate with --fps") from None
            raise
    # The user knows best, then the publisher; a guess by the body is right only for people of usual size.
    if options.unit is not None:
        unit, how = options.unit, "given by --unit"
    elif published is not None:
        unit, how = published, "as published"
    else:
        try:
            unit = skeletons.guess_unit(raw.skeleton, skeletons.find_table(raw.skeleton.names, options.joints))
            how = "guessed by the length of the spine"
        except InputError:
            unit, how = CENTIMETRES, "assumed"
    return skeletons.scaled(raw, unit), f"{unit:g} m, {how}"


def with_text(speech: Speech, text: Path) -> tuple[Speech, str]:
    """The speech with the words of a transcript, and the source of their times: given, heard or guessed."""
    from data_module.text import transcript

    speech, timing = transcript.with_transcript(speech, transcript.read_transcript(text, speech))
    return speech, timing.how
