"""A bundle as a system of `gesticulator score`: played for the sounds of the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from data_module.errors import InputError
from data_module.motion.skeletons import to_character
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
        # A folder of motion files may be called "default": it is no bundle then.
        folder = Path(bundle)
        if (folder / INDEX).is_file() or not folder.is_dir():
            folder = bundle_folder(bundle)
        return cls(folder, chooser) if (folder / INDEX).is_file() else None

    def row(self, truth: Mapping[str, Clip], seed: int) -> dict[str, Clip]:
        """Its motion for the truth's sounds, in the manner of the speaker where the bundle knows that name, on the
        16-joint character; InputError for a clip without speech, and where the bundle lacks the interpreter."""
        system, out = Gesticulator(bundles.load(self.folder)), {}
        for name, clip in truth.items():
            if clip.speech is None:
                raise InputError(name, "has no sound to gesture to", "give --speech, or motion files for --system")
            speaker = clip.speech.speaker if clip.speech.speaker in system.bundle.speakers else None
            performance = system(clip.speech, speaker=speaker, interpreter=self.interpreter, seed=seed)
            out[name] = replace(clip, motion=to_character(performance.motion))
        return out
