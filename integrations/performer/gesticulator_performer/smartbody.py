"""SmartBody's published gesture clips as strokes for the performer, and its text formats `.sk` and `.skm`.

There is no speech, so no store is made but the folder `strokes/` (BVH in metres and `manifest.csv`) that
`gesticulator build performer` uses with `speech/`. DIR is SmartBody's `data/behaviorsets`; each folder in it with
`skeletons/` and `motions/` is one body:

    Gestures/skeletons/ChrBrad.sk             Gestures/motions/ChrBrad@Idle01_BeatLowBt01.skm
    Gestures2/skeletons/ChrBrad2.sk           Gestures2/motions/ChrBrad@Idle01_BeatLowBt01.skm
    FemaleGestures/skeletons/ChrConnor.sk     FemaleGestures/motions/ChrConnor@IdleStand01_ChopBt01.skm
    MaleGestures/skeletons/ChrGarza.sk        MaleGestures/motions/ChrGarza@IdleStand01_ChopBt01.skm

In a motion the world rotation of a joint is that of its parent, then the constant `prerot`, then the channel. The
result is each joint's world rotation relative to its bind pose (prerot alone), so that all rest rotations are the
identity:

    W_j = W_parent(j) P_j C_j(t),   B_j = B_parent(j) P_j,   R_j = W_j B_j^-1

Twist joints are left out; their rotation is contained in W of the joint below them.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_module.errors import InputError
from data_module.files import new_folder, read_text, write_bytes, write_text
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.bvh import CENTIMETRES, write_bvh
from data_module.types import Array, Motion, Skeleton

LICENCE = "LGPL 2.1 (SmartBody, University of Southern California)"
SYNC_TIMES = ("ready", "strokeStart", "emphasis", "stroke", "relax")
"""The author's marks in a motion file: end of preparation, start, peak and end of the stroke, start of retraction."""
COLUMNS = ("file", "speaker", "posture", "lexeme", "hand", "frames", *SYNC_TIMES)
_ADVICE = "name SmartBody's folder data/behaviorsets"
_FPS = 30.0
# The published folders of gestures and their bodies; SmartBody has more, of walking and reaching.
_FOLDERS = {"Gestures": "brad", "Gestures2": "brad2", "FemaleGestures": "connor", "MaleGestures": "garza"}
# A clip's name: CHARACTER@POSTURE_GESTURE, with the hand and a number.
_NAME = re.compile(r"\w+@(?P<posture>[A-Za-z]+\d*)(?:_(?P<lexeme>\w+?)(?P<hand>Both|Bt|Lf|Rt)?\d*)?")
_HANDS = {"Bt": "both", "Both": "both", "Lf": "left", "Rt": "right"}
# Clips that do not belong in a talk: a mime, an insult and two transitions out of the pose.
_NO_GESTURE = ("Guitar", "ScrewYou", "ToIdleFight", "ToWalk")
# Channels of a joint and their widths.
_WIDTHS = {"XPos": 1, "YPos": 1, "ZPos": 1, "Quat": 3}
# Largest plausible number of metres, radians or seconds in a clip; the published clips last 20 s at most.
_LARGEST = 600.0
# Length of the bone beyond the last joint of a chain, as a share of the previous bone.
_TIP_SHARE = 0.8

_TRUNK = {"Hips": "JtRoot", "Spine": "JtSpineA", "Spine1": "JtSpineB", "Spine2": "JtSpineC", "Neck": "JtNeckA",
          "Neck1": "JtNeckB", "Head": "JtSkullA"}
_SIDES = {"Left": "Lf", "Right": "Rt"}
_ARM = {"Shoulder": "Clavicle", "Arm": "Shoulder", "ForeArm": "Elbow", "Hand": "Wrist"} | {
    f"Hand{finger}{place}": f"{'Little' if finger == 'Pinky' else finger}{letter}"
    for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky") for place, letter in enumerate("ABC", start=1)}
_LEG = {"UpLeg": "Hip", "Leg": "Knee", "Foot": "Ankle", "ToeBase": "Ball"}
JOINT_TABLE: Mapping[str, str] = _TRUNK | {
    side + ours: f"Jt{theirs}{short}" for limb in (_ARM, _LEG) for side, short in _SIDES.items()
    for ours, theirs in limb.items()}
"""Our joints, parents first -> SmartBody's names for them: trunk, arms, fingers and legs."""


@dataclass(frozen=True)
class BindPose:
    """A skeleton file with all joints, including those for twist and face. parents: -1 for the root; offsets: [J, 3]
    metres in the parent's rotated frame; prerots: [J, 4]."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Array
    prerots: Array


@dataclass(frozen=True)
class SmartBodyMotion:
    """A motion file. times: [F] seconds; columns: (joint, kind) -> [F, 1] metres (XPos, YPos, ZPos) or [F, 3] axis
    times angle (Quat); sync: the author's marks in seconds."""

    times: Array
    columns: Mapping[tuple[str, str], Array]
    sync: Mapping[str, float]


class SmartBody:
    """Makes strokes/ from what SmartBody publishes. notes: what was left out, and why."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._bodies = {folder: speaker for folder, speaker in _FOLDERS.items()
                        if (source / folder / "motions").is_dir()}
        self.notes = [f"{source / folder}: is not there, so {speaker} has no clips"
                      for folder, speaker in _FOLDERS.items() if folder not in self._bodies]
        if not self._bodies:
            raise InputError(source, f"holds none of {', '.join(_FOLDERS)} with motions/ in it", _ADVICE)

    def write(self, out: Path) -> int:
        """Write OUT/SPEAKER/CLIP.bvh, OUT/manifest.csv and the licence, whole or not at all; the number of clips.
        InputError names the file that cannot be read, or OUT if it exists and is not empty."""
        with new_folder(out) as partial:
            rows = sorted(self._clips(partial), key=lambda row: str(row["file"]))
            if not rows:
                raise InputError(self._source, "holds no clip of a gesture", _ADVICE)
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
        for folder, speaker in self._bodies.items():
            files = sorted((self._source / folder / "skeletons").glob("*.sk"))
            if len(files) != 1:
                raise InputError(self._source / folder / "skeletons", f"holds {len(files)} .sk files",
                                 "it should hold the one that motions/ was made on")
            bind = read_sk(files[0])
            (out / speaker).mkdir(parents=True, exist_ok=True)
            for file in sorted((self._source / folder / "motions").glob("*.skm")):
                row = self._clip(file, bind, speaker, out)
                if isinstance(row, str):
                    self.notes.append(f"left out {file}: {row}")
                else:
                    rows.append(row)
        return rows

    def _clip(self, file: Path, bind: BindPose, speaker: str, out: Path) -> Mapping[str, object] | str:
        """The clip's row of the manifest, once it is written; the reason why it is left out."""
        name = _NAME.fullmatch(file.stem)
        if name is None:
            return "is not named CHARACTER@POSTURE_GESTURE"
        if any(kind in file.stem for kind in _NO_GESTURE):
            return "no gesture of a talk"
        clip = read_skm(file)
        lacking = [mark for mark in SYNC_TIMES if mark not in clip.sync]
        if lacking:
            return f"has no time for {', '.join(lacking)}"
        motion = motion_of(bind, clip, path=str(file))
        target = f"{speaker}/{speaker}_{file.stem.partition('@')[2]}.bvh"
        # The BVH writer converts to centimetres; strokes are in metres.
        write_bvh(out / target, skeletons.scaled(motion, CENTIMETRES))
        return {"file": target, "speaker": speaker, "posture": name["posture"],
                "lexeme": name["lexeme"] or name["posture"].rstrip("0123456789"),
                "hand": _HANDS.get(name["hand"] or "", ""), "frames": len(motion),
                **{mark: clip.sync[mark] for mark in SYNC_TIMES}}


def read_sk(path: Path) -> BindPose:
    """Read a `.sk` skeleton; InputError names a file that is not one."""
    words = iter(re.findall(r"[{}]|[^\s{}]+", _text(path)))
    names: list[str] = []
    parents: list[int] = []
    offsets: dict[int, list[float]] = {}
    prerots: dict[int, Array] = {}
    stack: list[int] = []
    for word in words:
        if word in ("root", "joint"):
            names.append(next(words, ""))
            parents.append(stack[-1] if stack else -1)
            stack.append(len(names) - 1)
        elif word == "}" and stack:
            stack.pop()
        elif word == "offset" and stack:
            offsets[stack[-1]] = _numbers([next(words, "") for _ in range(3)], 3, path)
        elif word == "prerot" and stack:
            # prerot axis X Y Z ang DEGREES
            axis, angle = ([next(words, "") for _ in range(count)][1:] for count in (4, 2))
            vector = np.array(_numbers(axis, 3, path))
            turn = vector / max(float(np.linalg.norm(vector)), 1e-12) * np.radians(_numbers(angle, 1, path)[0])
            prerots[stack[-1]] = rotation.from_exponential_map(turn)
    if not names or stack or len(set(names)) != len(names) or parents.count(-1) != 1:
        raise InputError(path, "is not a SmartBody skeleton (no closed tree with one root)", "fetch it again")
    zero, identity = [0.0] * 3, np.array([1.0, 0.0, 0.0, 0.0])
    count = range(len(names))
    return BindPose(tuple(names), tuple(parents), np.array([offsets.get(j, zero) for j in count]),
                    np.array([prerots.get(j, identity) for j in count]))


def read_skm(path: Path) -> SmartBodyMotion:
    """Read a `.skm` motion; InputError names a file that is not one or is truncated."""
    head, mark, body = _text(path).partition("\nkt ")
    count = re.search(r"^channels[ \t]+(\d{1,6})[ \t]*$", head, re.MULTILINE)
    channels = re.findall(r"^[ \t]*(\S+)[ \t]+([A-Z]\w+)[ \t]*$", head[count.end():] if count else "", re.MULTILINE)
    if count is None or not mark:
        raise InputError(path, "is not a SmartBody motion (no channels or no frames)", "fetch it again")
    if any(kind not in _WIDTHS for _, kind in channels) or len(channels) != int(count[1]):
        raise InputError(path, f"has channels that are not read, or not {count[1]} of them", "fetch it again")
    lines = [line.split() for line in (mark + body).splitlines() if line.startswith("kt ")]
    width = sum(_WIDTHS[kind] for _, kind in channels)
    values = np.array([_numbers([*line[1:2], *line[3:]], 1 + width, path) for line in lines])
    if (np.diff(values[:, 0]) <= 0).any():
        raise InputError(path, "has frames whose times do not rise", "fetch it again")
    ends = np.cumsum([1] + [_WIDTHS[kind] for _, kind in channels])
    columns = {channel: values[:, start:stop]
               for channel, start, stop in zip(channels, ends[:-1], ends[1:], strict=True)}
    sync = {name: _numbers([value], 1, path)[0]
            for name, value in re.findall(r"^[ \t]*+(\w++) time:[ \t]*+(\S++)", body, re.MULTILINE)}
    return SmartBodyMotion(values[:, 0], columns, sync)


def motion_of(bind: BindPose, clip: SmartBodyMotion, *, path: str) -> Motion:
    """The clip on its skeleton at 30 fps, with the joints of `JOINT_TABLE`; metres. A last partial frame is left out.
    InputError naming `path` if skeleton or motion lack a joint."""
    place = {name: joint for joint, name in enumerate(bind.names)}
    lacking = [name for name in (*JOINT_TABLE.values(), *(joint for joint, _ in clip.columns)) if name not in place]
    if lacking:
        raise InputError(path, f"goes with a skeleton that has no joint {', '.join(lacking)}",
                         "take the skeleton beside it")
    skeleton, chosen, rest = _skeleton(bind, place)
    local = np.tile(bind.prerots, (len(clip.times), 1, 1))
    root = np.tile(bind.offsets[0], (len(clip.times), 1))
    for (name, kind), values in clip.columns.items():
        joint = place[name]
        if kind == "Quat":
            local[:, joint] = rotation.multiply(bind.prerots[joint], rotation.from_exponential_map(values))
        elif joint == 0:
            root[:, "XYZ".index(kind[0])] += values[:, 0]
    world = kinematics.chained(bind.parents, local)[:, chosen]
    turned = kinematics.local_rotations(skeleton, rotation.multiply(world, rotation.conjugate(rest)))
    turned = rotation.continuous(rotation.normalise(turned))
    since = clip.times - clip.times[0]
    ticks = np.arange(int(since[-1] * _FPS) + 1) / _FPS
    where = np.interp(ticks, since, np.arange(len(since)))
    steps = np.stack([np.interp(ticks, since, column) for column in root.T], axis=-1)
    return Motion(skeleton, rotation.interpolate(turned, where), steps, _FPS)


def _skeleton(bind: BindPose, place: Mapping[str, int]) -> tuple[Skeleton, list[int], Array]:
    """The joints of `JOINT_TABLE` in the bind pose, their indices in the file, and their bind rotations [J, 4]."""
    turned = kinematics.chained(bind.parents, bind.prerots)
    spots = np.zeros((len(bind.names), 3))
    for joint, parent in enumerate(bind.parents):
        if parent >= 0:
            spots[joint] = spots[parent] + rotation.rotate(turned[parent], bind.offsets[joint])
    chosen = [place[theirs] for theirs in JOINT_TABLE.values()]
    parents = []
    for joint in chosen:
        above = bind.parents[joint]
        while above >= 0 and above not in chosen:
            above = bind.parents[above]
        parents.append(chosen.index(above) if above >= 0 else -1)
    offsets = np.array([spots[joint] - spots[chosen[parent]] if parent >= 0 else np.zeros(3)
                        for joint, parent in zip(chosen, parents, strict=True)])
    tips = {joint: offsets[joint] * _TIP_SHARE for joint in range(len(chosen)) if joint not in parents}
    return Skeleton(tuple(JOINT_TABLE), tuple(parents), offsets, tips), chosen, turned[chosen]


def _text(path: Path) -> str:
    text = read_text(path, "give SmartBody's text files, not its binary ones")
    return "\n".join(line.split("#", 1)[0] for line in text.split("\n"))


def _numbers(words: Sequence[str], count: int, path: Path) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise InputError(path, f"has '{' '.join(words[:4])}' where {count} numbers belong", "fetch it again") from None
    if len(values) != count or not (np.abs(values) < _LARGEST).all():
        raise InputError(path, f"lacks {count} usable numbers in one place", "fetch it again: it is cut short")
    return values
