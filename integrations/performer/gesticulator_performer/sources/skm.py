"""SmartBody's text formats: `.sk` (skeleton) and `.skm` (motion).

The world rotation of a joint is that of its parent, then the constant `prerot`, then the channel. The result is each
joint's world rotation relative to its bind pose (prerot alone), so that all rest rotations are the identity:

    W_j = W_parent(j) P_j C_j(t),   B_j = B_parent(j) P_j,   R_j = W_j B_j^-1

Twist joints are left out; their rotation is contained in W of the joint below them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_module.errors import InputError
from data_module.files import read_text
from data_module.motion import kinematics, rotation
from data_module.types import Array, Motion, Skeleton

FPS = 30.0
SYNC_TIMES = ("ready", "strokeStart", "emphasis", "stroke", "relax")
"""The author's marks in a motion file: end of preparation, start, peak and end of the stroke, start of retraction."""

_FINGERS = {"Thumb": "Thumb", "Index": "Index", "Middle": "Middle", "Ring": "Ring", "Pinky": "Little"}
_TRUNK = {"Hips": "JtRoot", "Spine": "JtSpineA", "Spine1": "JtSpineB", "Spine2": "JtSpineC", "Neck": "JtNeckA",
          "Neck1": "JtNeckB", "Head": "JtSkullA"}
_SIDES = {"Left": "Lf", "Right": "Rt"}
_ARM = {"Shoulder": "Clavicle", "Arm": "Shoulder", "ForeArm": "Elbow", "Hand": "Wrist"}
_LEG = {"UpLeg": "Hip", "Leg": "Knee", "Foot": "Ankle", "ToeBase": "Ball"}
# Longest plausible clip, seconds; the published clips last 20 s at most.
_LONGEST = 600.0
# Largest plausible number of metres, radians or seconds in a clip.
_LARGEST = 1e6
# Length of the bone beyond the last joint of a chain, as a share of the previous bone.
_TIP_SHARE = 0.8


def _joint_table() -> dict[str, str]:
    table = dict(_TRUNK)
    for side, short in _SIDES.items():
        table |= {side + ours: f"Jt{theirs}{short}" for ours, theirs in _ARM.items()}
        table |= {f"{side}Hand{ours}{place}": f"Jt{theirs}{letter}{short}"
                  for ours, theirs in _FINGERS.items() for place, letter in enumerate("ABC", start=1)}
    for side, short in _SIDES.items():
        table |= {side + ours: f"Jt{theirs}{short}" for ours, theirs in _LEG.items()}
    return table


JOINT_TABLE: Mapping[str, str] = _joint_table()
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


def read_sk(path: str | os.PathLike[str]) -> BindPose:
    """Read a `.sk` skeleton; InputError names a file that is not one."""
    where = str(path)
    words = _text(path).replace("{", " { ").replace("}", " } ").split()
    names: list[str] = []
    parents: list[int] = []
    offsets: dict[int, list[float]] = {}
    prerots: dict[int, Array] = {}
    stack: list[int] = []
    at = 0
    while at < len(words):
        word = words[at]
        if word in ("root", "joint") and words[at + 2:at + 3] == ["{"]:
            names.append(words[at + 1])
            parents.append(stack[-1] if stack else -1)
            stack.append(len(names) - 1)
            at += 2
        elif word == "}" and stack:
            stack.pop()
        elif word == "offset" and stack:
            offsets[stack[-1]] = _numbers(words[at + 1:at + 4], 3, where)
        elif word == "prerot" and stack and words[at + 1:at + 2] == ["axis"]:
            axis = np.array(_numbers(words[at + 2:at + 5], 3, where))
            angle = np.radians(_numbers(words[at + 6:at + 7], 1, where)[0])
            prerots[stack[-1]] = rotation.from_exponential_map(axis / max(float(np.linalg.norm(axis)), 1e-12) * angle)
        elif word in ("prerot", "postrot"):
            raise InputError(where, f"has an unsupported kind of rotation ({word})",
                             "give a skeleton whose prerot is axis and angle")
        at += 1
    if not names or stack or len(set(names)) != len(names) or parents.count(-1) != 1:
        raise InputError(where, "is not a SmartBody skeleton (no closed tree with one root)", "fetch it again")
    zero, identity = [0.0] * 3, np.array([1.0, 0.0, 0.0, 0.0])
    count = range(len(names))
    return BindPose(tuple(names), tuple(parents), np.array([offsets.get(j, zero) for j in count]),
                    np.array([prerots.get(j, identity) for j in count]))


_WIDTHS = {"XPos": 1, "YPos": 1, "ZPos": 1, "Quat": 3}


def read_skm(path: str | os.PathLike[str]) -> SmartBodyMotion:
    """Read a `.skm` motion; InputError names a file that is not one or is truncated."""
    where = str(path)
    text = _text(path)
    head, mark, body = text.partition("\nkt ")
    count = re.search(r"^channels[ \t]+(\d{1,6})[ \t]*$", head, re.MULTILINE)
    channels = re.findall(r"^[ \t]*(\S+)[ \t]+([A-Z]\w+)[ \t]*$", head[count.end():] if count else "", re.MULTILINE)
    if count is None or not mark:
        raise InputError(where, "is not a SmartBody motion (no channels or no frames)", "fetch it again")
    unknown = sorted({kind for _, kind in channels} - set(_WIDTHS))
    if unknown or len(channels) != int(count[1]):
        raise InputError(where, f"has channels that are not read ({', '.join(unknown)})" if unknown else
                         f"says {count[1]} channels and lists {len(channels)}", "fetch it again")
    lines = [line.split() for line in (mark + body).splitlines() if line.startswith("kt ")]
    width = sum(_WIDTHS[kind] for _, kind in channels)
    if any(line[2:3] != ["fr"] or len(line) != 3 + width for line in lines):
        raise InputError(where, f"has a frame that is not a time and {width} values", "fetch it again: it is cut short")
    values = np.array([_numbers([line[1], *line[3:]], 1 + width, where) for line in lines])
    if (np.diff(values[:, 0]) <= 0).any():
        raise InputError(where, "has frames whose times do not rise", "fetch it again")
    if values[-1, 0] - values[0, 0] > _LONGEST:
        raise InputError(where, f"lasts {values[-1, 0] - values[0, 0]:g} s, more than a gesture", "fetch it again")
    ends = np.cumsum([1] + [_WIDTHS[kind] for _, kind in channels])
    columns = {channel: values[:, start:stop]
               for channel, start, stop in zip(channels, ends[:-1], ends[1:], strict=True)}
    sync = {name: _numbers([value], 1, where)[0]
            for name, value in re.findall(r"^[ \t]*+(\w++) time:[ \t]*+(\S++)", body, re.MULTILINE)}
    return SmartBodyMotion(values[:, 0], columns, sync)


def motion_of(bind: BindPose, clip: SmartBodyMotion, *, path: str = "motion") -> Motion:
    """The clip on its skeleton at 30 fps, with the joints of `JOINT_TABLE`; metres. A last partial frame is left out.
    InputError naming `path` if skeleton or motion lack a joint."""
    place = {name: joint for joint, name in enumerate(bind.names)}
    lacking = [theirs for theirs in JOINT_TABLE.values() if theirs not in place]
    if lacking:
        raise InputError(path, f"goes with a skeleton that has no joint {', '.join(lacking)}",
                         "take the skeleton beside it")
    strange = sorted({joint for joint, _ in clip.columns if joint not in place})
    if strange or (JOINT_TABLE["Hips"], "Quat") not in clip.columns:
        raise InputError(path, "does not move its skeleton (" + (f"unknown {', '.join(strange)}" if strange else
                         "no channel for the root") + ")", "take the skeleton beside it")
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
    ticks = np.arange(int(since[-1] * FPS) + 1) / FPS
    where = np.interp(ticks, since, np.arange(len(since)))
    steps = np.stack([np.interp(ticks, since, column) for column in root.T], axis=-1)
    return Motion(skeleton, rotation.interpolate(turned, where), steps, FPS)


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



def _text(path: str | os.PathLike[str]) -> str:
    text = read_text(path, "give SmartBody's text files, not its binary ones")
    return "\n".join(line.split("#", 1)[0] for line in text.split("\n"))


def _numbers(words: list[str], count: int, path: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise InputError(path, f"has '{' '.join(words[:4])}' where {count} numbers belong", "fetch it again") from None
    if len(values) != count or not (np.abs(values) < _LARGEST).all():
        raise InputError(path, f"lacks {count} usable numbers in one place", "fetch it again: it is cut short")
    return values
