"""The file that says which joints of a skeleton are which of ours, for skeletons with names of their own.

`gesticulator character FILE --save-mapping` writes it, with null where a joint was not found:

    {"format": 1, "joints": {"Hips": "root", "Head": "skull", "LeftArm": "arm_l", "LeftHandThumb1": null, ...},
     "spine": ["back1", "back2"], "neck": ["throat"]}

Spine and neck are chains of any length, from the hips up.
"""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Literal, TypeVar

import msgspec

from data_module.errors import InputError, shown
from data_module.files import read_json
from data_module.motion.skeletons import FINGER_JOINTS, LEG_JOINTS, REQUIRED, SIDES

__all__ = ["NEEDED", "SINGLE", "JointMap", "read_joint_map", "read_joint_table", "with_chains"]

_Node = TypeVar("_Node")
_CHAINS = (("Spine", 4), ("Neck", 2))
"""Joints of ours that are chains, and the length of ours."""
SINGLE = ("Hips", "Head", *(side + part for side in SIDES for part in ("Shoulder", "Arm", "ForeArm", "Hand")),
          *LEG_JOINTS, *FINGER_JOINTS)
"""Our joints that map to one node each; spine and neck are chains of any length."""
NEEDED = tuple(name for name in REQUIRED if name in SINGLE)
"""Joints required for gesturing."""
ADVICE = "correct the mapping, or save a new one with --save-mapping"


class JointMap(msgspec.Struct):
    """What is read of a mapping file: our joint (of `SINGLE`) -> name in the skeleton, None where it has none; names of
    spine and neck, from the hips up."""

    format: Literal[1]
    joints: dict[str, str | None]
    spine: list[str] = []
    neck: list[str] = []


def read_joint_map(path: str | os.PathLike[str]) -> JointMap:
    """The content of a mapping file; `InputError` for another file or unknown joints."""
    document = read_json(path, "give a mapping as --save-mapping writes it")
    try:
        stored = msgspec.convert(document, JointMap)
    except msgspec.ValidationError as error:
        raise InputError(path, f"is not a mapping: {shown(str(error), 200)}", ADVICE) from None
    unknown = [name for name in stored.joints if name not in SINGLE]
    if unknown:
        raise InputError(path, f"has unknown joints {shown(', '.join(unknown), 100)}", ADVICE)
    return stored


def read_joint_table(path: str | os.PathLike[str]) -> dict[str, str]:
    """Joint of `WHOLE_BODY` -> name in the skeleton, from a mapping file. `InputError` also for a mapping that lacks
    one of `NEEDED`, or names a joint for two of ours."""
    stored = read_joint_map(path)
    table = with_chains({joint: theirs for joint, theirs in stored.joints.items() if theirs is not None},
                        stored.spine, stored.neck)
    lacking = [name for name in NEEDED if name not in table]
    twice = [name for name, count in Counter(table.values()).items() if count > 1]
    if lacking or twice:
        wrong = f"names no joint for {', '.join(lacking)}" if lacking else f"names {shown(twice[0])} for two joints"
        raise InputError(path, wrong, ADVICE)
    return table


def with_chains(joints: Mapping[str, _Node], spine: Sequence[_Node], neck: Sequence[_Node]) -> dict[str, _Node]:
    """Our joint -> node, with the chains of spine and neck under our names (Spine, Spine1, ...; Neck, Neck1). Of a
    chain longer than ours the last node is kept."""
    out = dict(joints)
    for (stem, most), chain in zip(_CHAINS, (spine, neck), strict=True):
        chosen = chain if len(chain) <= most else (*chain[:most - 1], chain[-1])
        out |= {stem + (str(place) if place else ""): node for place, node in enumerate(chosen)}
    return out
