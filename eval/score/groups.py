"""`gesticulator score --group`: synchrony on groups of recordings, such as languages (RG Fig. 13).

A group is the part of a file's name before its first "_", such as LANGUAGE in LANGUAGE_VOICE.flac. Bundles are played
for every sound of a folder, and each one's synchrony is a mean over the recordings of a group; no speaker's motion is
needed. Beside each system stands its chance: the same motion with the sounds of the group exchanged, each with the next
one's.

What fools it: recordings of one voice are alike, so the intervals of a group with few voices are too narrow; a language
that is spoken faster has more onsets, so only figures above chance compare across groups.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from data_module.corpora.folder import SOUNDS
from data_module.errors import InputError
from data_module.speech.audio import load_speech
from data_module.types import Motion, Speech
from eval import stats
from eval.metrics import METRICS
from eval.metrics.evaluate import MotionBeats, OnsetTrack, clip_values
from eval.score.played_rows import PlayedBundle
from eval.table import Cell, Column, Table

SHOWN = ("above_A", "above_B", "consistency_above", "beats_per_second", "speed_hands")
EXCHANGED = "sounds exchanged"


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
    columns = {name: Column(METRICS[name].about, METRICS[name].unit, METRICS[name].digits) for name in SHOWN}
    return Table("Synchrony by group", columns, rows, "recordings, system",
                 [f"Recordings: {counts}. Means over recordings with bootstrap 95 % intervals."])


def synchrony_means(motions: Sequence[Motion], tracks: Sequence[OnsetTrack], seed: int) -> dict[str, Cell]:
    """The figures of `SHOWN`, means over the motions with the onsets of each."""
    values = [clip_values(motion, motion, MotionBeats.of(motion), track, seed + k).numbers
              for k, (motion, track) in enumerate(zip(motions, tracks, strict=True))]
    return {name: stats.mean_interval([numbers[name] for numbers in values], seed=seed) for name in SHOWN}
