"""`gesticulator smartbody`: SmartBody's published gesture clips (`.skm` on `.sk`) as strokes for the performer.

There is no speech, so no store is made but the folder `strokes/` (BVH in metres and `manifest.csv`) that
`gesticulator build performer` uses with `speech/`. DIR is SmartBody's `data/behaviorsets`; each folder in it with
`skeletons/` and `motions/` is one body:

    Gestures/skeletons/ChrBrad.sk             Gestures/motions/ChrBrad@Idle01_BeatLowBt01.skm
    Gestures2/skeletons/ChrBrad2.sk           Gestures2/motions/ChrBrad@Idle01_BeatLowBt01.skm
    FemaleGestures/skeletons/ChrConnor.sk     FemaleGestures/motions/ChrConnor@IdleStand01_ChopBt01.skm
    MaleGestures/skeletons/ChrGarza.sk        MaleGestures/motions/ChrGarza@IdleStand01_ChopBt01.skm
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_module.errors import InputError
from data_module.files import new_folder, write_bytes, write_text
from data_module.motion import skeletons
from data_module.motion.bvh import CENTIMETRES, write_bvh
from gesticulator_performer.sources import skm

COLUMNS = ("file", "speaker", "posture", "lexeme", "hand", "frames", *skm.SYNC_TIMES)
# The published folders of gestures and their bodies; SmartBody has more, of walking and reaching.
_FOLDERS = {"Gestures": "brad", "Gestures2": "brad2", "FemaleGestures": "connor", "MaleGestures": "garza"}
_HANDS = {"Bt": "both", "Both": "both", "Lf": "left", "Rt": "right"}
# Clips that do not belong in a talk: a mime, an insult and two transitions out of the pose.
_NO_GESTURE = ("Guitar", "ScrewYou", "ToIdleFight", "ToWalk")


@dataclass(frozen=True)
class ClipName:
    """The parts of a clip's name: body, start pose, gesture, and hand ('' if not given)."""

    file: str
    speaker: str
    posture: str
    lexeme: str
    hand: str


def clip_name(stem: str, speaker: str) -> ClipName:
    """Parse a name such as "ChrBrad@Idle01_BeatLowBt01" on the body of `speaker`; ValueError for another form."""
    match = re.fullmatch(r"\w+@(?P<posture>[A-Za-z]+\d*)(?:_(?P<lexeme>\w+?)(?P<hand>Both|Bt|Lf|Rt)?\d*)?", stem)
    if match is None:
        raise ValueError(f"{stem} is not named CHARACTER@POSTURE_GESTURE")
    name = f"{speaker}_{stem.partition('@')[2]}"
    lexeme = match["lexeme"] or match["posture"].rstrip("0123456789")
    return ClipName(f"{speaker}/{name}.bvh", speaker, match["posture"], lexeme, _HANDS.get(match["hand"] or "", ""))


class SmartBody:
    """Makes strokes/ from what SmartBody publishes."""

    licence = "LGPL 2.1 (SmartBody, University of Southern California)"

    def __init__(self, source: Path) -> None:
        if not source.is_dir():
            raise InputError(source, "is not a folder" if source.exists() else "does not exist",
                             "name SmartBody's folder data/behaviorsets")
        self._source = source
        self._bodies = {folder: _skeleton_file(source / folder) for folder in _FOLDERS
                        if (source / folder / "motions").is_dir()}
        self._notes: list[str] = [f"{source / folder}: is not there, so {speaker} has no clips"
                                  for folder, speaker in _FOLDERS.items() if folder not in self._bodies]
        if not self._bodies:
            raise InputError(source, f"holds none of {', '.join(_FOLDERS)} with motions/ in it",
                             "name SmartBody's folder data/behaviorsets")

    def notes(self) -> Sequence[str]:
        return self._notes

    def write(self, out: Path) -> int:
        """Write OUT/SPEAKER/CLIP.bvh, OUT/manifest.csv and the licence, whole or not at all; the number of clips.
        InputError names the file that cannot be read, or OUT if it exists and is not empty."""
        with new_folder(out) as partial:
            rows = sorted(self._clips(partial), key=lambda row: str(row["file"]))
            if not rows:
                raise InputError(self._source, "holds no clip of a gesture",
                                 "name SmartBody's folder data/behaviorsets")
            table = io.StringIO()
            writer = csv.DictWriter(table, COLUMNS)
            writer.writeheader()
            writer.writerows(rows)
            write_text(partial / "manifest.csv", table.getvalue())
            if (self._source / "LICENSE").is_file():
                write_bytes(partial / "LICENSE", (self._source / "LICENSE").read_bytes())
        return len(rows)

    def _clips(self, out: Path) -> list[Mapping[str, object]]:
        rows: list[Mapping[str, object]] = []
        for folder, skeleton in self._bodies.items():
            bind = skm.read_sk(skeleton)
            (out / _FOLDERS[folder]).mkdir(parents=True, exist_ok=True)
            for file in sorted((self._source / folder / "motions").glob("*.skm")):
                row = self._clip(file, bind, _FOLDERS[folder], out)
                if row is not None:
                    rows.append(row)
        return rows

    def _clip(self, file: Path, bind: skm.BindPose, speaker: str, out: Path) -> Mapping[str, object] | None:
        try:
            name = clip_name(file.stem, speaker)
        except ValueError as reason:
            self._notes.append(f"left out {file}: {reason}")
            return None
        if any(kind in file.stem for kind in _NO_GESTURE):
            self._notes.append(f"left out {file}: no gesture of a talk")
            return None
        clip = skm.read_skm(file)
        lacking = [mark for mark in skm.SYNC_TIMES if mark not in clip.sync]
        if lacking:
            self._notes.append(f"left out {file}: has no time for {', '.join(lacking)}")
            return None
        motion = skm.motion_of(bind, clip, path=str(file))
        # The BVH writer converts to centimetres; strokes are in metres.
        write_bvh(out / name.file, skeletons.scaled(motion, CENTIMETRES))
        return {"file": name.file, "speaker": name.speaker, "posture": name.posture, "lexeme": name.lexeme,
                "hand": name.hand, "frames": len(motion), **{mark: clip.sync[mark] for mark in skm.SYNC_TIMES}}


def _skeleton_file(folder: Path) -> Path:
    files = sorted((folder / "skeletons").glob("*.sk"))
    if len(files) != 1:
        raise InputError(folder / "skeletons", f"holds {len(files)} .sk files" if files else "holds no .sk file",
                         "it should hold the one that motions/ was made on")
    return files[0]
