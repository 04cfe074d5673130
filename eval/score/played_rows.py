"""Rows of `gesticulator score` that are made here for the truth's own sounds: a bundle, played, and unit selection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from data_module.errors import InputError
from data_module.motion.skeletons import to_character
from data_module.store import Store
from data_module.types import Motion, Speech
from eval.clip.foreign import Clip
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.gesticulator import Gesticulator
from interpreters import INTERPRETERS


@dataclass(frozen=True)
class PlayedBundle:
    """A bundle and the interpreter that chooses its lexemes (None: its first one)."""

    folder: Path
    interpreter: str | None = None

    @classmethod
    def named(cls, place: str) -> PlayedBundle | None:
        """BUNDLE or BUNDLE:INTERPRETER, where BUNDLE is a folder, "default" or "paper"; None for a place that holds no
        bundle, such as a folder of motion files, by whatever name."""
        before, colon, after = place.rpartition(":")
        bundle, chooser = (before, after) if colon and after in INTERPRETERS else (place, None)
        folder = Path(bundle)
        if (folder / INDEX).is_file() or not folder.is_dir():
            folder = bundle_folder(bundle)
        return cls(folder, chooser) if (folder / INDEX).is_file() else None

    def opened(self) -> Gesticulator:
        """The pipeline that plays it."""
        return Gesticulator(bundles.load(self.folder))

    def motion(self, system: Gesticulator, speech: Speech, seed: int) -> Motion:
        """Its motion for a sound, in the manner of the speaker where the bundle knows that name; on the 16-joint
        character, without fingers, as files are read. InputError where the bundle lacks the interpreter."""
        speaker = speech.speaker if speech.speaker in system.speakers else None
        return to_character(system(speech, speaker=speaker, interpreter=self.interpreter, seed=seed).motion)

    def row(self, truth: Mapping[str, Clip], seed: int) -> dict[str, Clip]:
        """Its motion for the truth's sounds; InputError for a clip without speech, and as `motion`."""
        system = self.opened()
        return {name: replace(clip, motion=self.motion(system, speech_of(
            name, clip, "to gesture to", "give --speech, or motion files for --system"), seed))
            for name, clip in truth.items()}


def unit_selection_row(truth: Mapping[str, Clip], store: Store, work: Path | None, seed: int) -> dict[str, Clip]:
    """Motion by unit selection for the truth's speech; InputError for a clip without speech."""
    from eval.baselines.unit_selection import UnitDatabase, UnitSelection

    units = UnitSelection(UnitDatabase.of(store, work=work))
    return {name: replace(clip, motion=units(
        speech_of(name, clip, "to select units by", "give --speech, or leave --units out"), seed=seed).motion)
        for name, clip in truth.items()}


def speech_of(name: str, clip: Clip, what: str, to_do: str) -> Speech:
    """The sound of a clip; InputError where it has none."""
    if clip.speech is None:
        raise InputError(name, f"has no sound {what}", to_do)
    return clip.speech
