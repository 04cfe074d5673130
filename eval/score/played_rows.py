"""What `gesticulator score` makes itself: a bundle or unit selection, played for the truth's sounds or by group.

`score --group` compares synchrony on groups of recordings, such as languages (RG Fig. 13). A group is the part of a
file's name before its first "_", such as LANGUAGE in LANGUAGE_VOICE.flac. Bundles are played for every sound of a
folder, and each one's synchrony is a mean over the recordings of a group; no speaker's motion is needed. Beside each
system stands its chance: the same motion with the sounds of the group exchanged, each with the next one's.

What fools it: recordings of one voice are alike, so the intervals of a group with few voices are too narrow; a language
that is spoken faster has more onsets, so only figures above chance compare across groups.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from data_module.corpora.folder import SOUNDS
from data_module.errors import InputError
from data_module.motion.skeletons import to_character
from data_module.speech.audio import load_speech
from data_module.store import Store
from data_module.types import Motion, Speech
from eval import stats
from eval.baselines.unit_selection import UnitDatabase, UnitSelection
from eval.clip.foreign import Clip
from eval.metrics import METRICS
from eval.metrics.evaluate import MotionBeats, OnsetTrack, clip_values
from eval.table import Cell, Column, Table
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.gesticulator import Gesticulator
from interpreters import INTERPRETERS

SHOWN = ("above_A", "above_B", "beats_per_second", "speed_hands")
EXCHANGED = "sounds exchanged"


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

    def opened(self) -> Gesticulator:
        """The pipeline that plays it."""
        return Gesticulator(bundles.load(self.folder))

    def motion(self, system: Gesticulator, speech: Speech, seed: int) -> Motion:
        """Its motion for a sound, in the manner of the speaker where the bundle knows that name; on the 16-joint
        character, without fingers, as files are read. InputError where the bundle lacks the interpreter."""
        speaker = speech.speaker if speech.speaker in system.bundle.speakers else None
        return to_character(system(speech, speaker=speaker, interpreter=self.interpreter, seed=seed).motion)

    def row(self, truth: Mapping[str, Clip], seed: int) -> dict[str, Clip]:
        """Its motion for the truth's sounds; InputError for a clip without speech, and as `motion`."""
        system = self.opened()
        return {name: replace(clip, motion=self.motion(system, speech_of(
            name, clip, "to gesture to", "give --speech, or motion files for --system"), seed))
            for name, clip in truth.items()}


def unit_selection_row(truth: Mapping[str, Clip], store: Store, work: Path | None, seed: int) -> dict[str, Clip]:
    """Motion by unit selection for the truth's speech; InputError for a clip without speech."""
    units = UnitSelection(UnitDatabase.of(store, work=work))
    return {name: replace(clip, motion=units(
        speech_of(name, clip, "to select units by", "give --speech, or leave --units out"), seed=seed).motion)
        for name, clip in truth.items()}


def speech_of(name: str, clip: Clip, what: str, to_do: str) -> Speech:
    """The sound of a clip; InputError where it has none."""
    if clip.speech is None:
        raise InputError(name, f"has no sound {what}", to_do)
    return clip.speech


# ----------------------------------------------------------------------------------------------------------- by group

def sounds_of(folder: Path) -> dict[str, dict[str, Speech]]:
    """Group -> name -> sound, by the names of the files; InputError where a folder holds none, or a group only one."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "give --speech a folder of sound files GROUP_NAME.flac")
    groups: dict[str, dict[str, Speech]] = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() in SOUNDS:
            groups.setdefault(file.stem.partition("_")[0], {})[file.stem] = load_speech(file)
    if not groups:
        raise InputError(folder, "holds no sound", f"put {' or '.join(SOUNDS)} files there, named GROUP_NAME")
    for group, sounds in groups.items():
        if len(sounds) < 2:
            raise InputError(folder, f"holds one recording of the group {group!r}", "an interval needs 2 or more")
    return groups


def group_table(groups: Mapping[str, Mapping[str, Speech]], systems: Mapping[str, PlayedBundle], seed: int = 0
                ) -> Table:
    """Rows: each system on each group, and with the sounds of the group exchanged; columns: `SHOWN`."""
    rows: dict[str, dict[str, Cell]] = {}
    for name, bundle in systems.items():
        player = bundle.opened()
        for group, sounds in groups.items():
            motions = [bundle.motion(player, speech, seed) for speech in sounds.values()]
            tracks = [OnsetTrack.of(speech) for speech in sounds.values()]
            rows[f"{group}, {name}"] = synchrony_means(motions, tracks, seed)
            # The next sound of the same group: another language would differ in rate, and not in fit alone.
            rows[f"{group}, {name}, {EXCHANGED}"] = synchrony_means(motions, [*tracks[1:], tracks[0]], seed)
    counts = ", ".join(f"{group} {len(sounds)}" for group, sounds in groups.items())
    columns = {name: Column(METRICS[name].title, METRICS[name].unit, METRICS[name].digits) for name in SHOWN}
    return Table("Synchrony by group", columns, rows, "recordings, system",
                 [f"Recordings: {counts}. Means over recordings with bootstrap 95 % intervals."])


def synchrony_means(motions: Sequence[Motion], tracks: Sequence[OnsetTrack], seed: int) -> dict[str, Cell]:
    """The figures of `SHOWN`, means over the motions with the onsets of each."""
    values = [clip_values(motion, motion, MotionBeats.of(motion), track, seed + k).numbers
              for k, (motion, track) in enumerate(zip(motions, tracks, strict=True))]
    return {name: stats.mean_interval([numbers[name] for numbers in values], seed=seed) for name in SHOWN}
