"""The mapping from our joints to the nodes of a character, and its file format."""

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from data_module.errors import InputError, shown
from data_module.files import write_text
from data_module.motion.joint_map import ADVICE, NEEDED, SINGLE, read_joint_map, with_chains
from data_module.motion.skeletons import FINGER_JOINTS
from data_module.motion.skeletons import SIDES as SIDES
from gesticulator.characters.rig import Character

__all__ = ["RigMapping", "load_mapping", "save_mapping"]

ARM_PARTS = ("Shoulder", "Arm", "ForeArm", "Hand")
LEG_PARTS = ("UpLeg", "Leg", "Foot", "ToeBase")
SURE = 0.6
"""Confidence below which a detected mapping is rejected unless the user provides it. Known names throughout give 1, a
body-shaped tree without known names 0.7; each doubt subtracts a fifth or more."""
_FLAT = 1e-6
"""Smallest scale of a node, as a share of its largest, with which there is a way back from the world to its axes."""
LACKS = "it lacks "
"""How the doubt begins that lists the missing joints of `NEEDED`."""


@dataclass(frozen=True)
class RigMapping:
    """Our joints among a character's nodes.

    joints: our joint (of `SINGLE`) -> node. spine: nodes from above the hips to the chest; neck: nodes from above the
    chest to below the head; both may be empty.
    confidence: 0 to 1; 1 if written by the user. doubts: reasons against it, in words.
    given: whether it was read from a file that the user has checked.
    """

    joints: Mapping[str, int]
    spine: tuple[int, ...] = ()
    neck: tuple[int, ...] = ()
    confidence: float = 1.0
    doubts: tuple[str, ...] = field(default=())
    given: bool = False

    @property
    def legs(self) -> bool:
        """Whether both legs are mapped, down to the feet."""
        return all(side + part in self.joints for side in SIDES for part in LEG_PARTS[:3])

    def named(self) -> dict[str, int]:
        """Our joint -> node, with the chains of spine and neck under our names (Spine, Spine1, ...; Neck, Neck1)."""
        return with_chains(self.joints, self.spine, self.neck)


def check(mapping: RigMapping, character: Character) -> None:
    """`InputError` if the mapping lacks required joints, uses a node twice, or has too low a confidence."""
    missing = [name for name in NEEDED if name not in mapping.joints]
    joints = [node for node, joint in enumerate(character.skinned) if joint] if missing else mapping.joints.values()
    # Only nodes that carry joints: a prop without extent is one that is hidden.
    for node in sorted({above for joint in joints for above in ancestors(character.parents, joint)}):
        if abs(character.scales[node]).min() <= _FLAT * abs(character.scales[node]).max():
            scale = ", ".join(f"{value:g}" for value in character.scales[node])
            raise InputError(character.path, f"has joints below {shown(character.names[node])}, whose scale is "
                             f"({scale}): all of them are flat", "give that node another scale, and export it again")
    if missing:
        doubts = "; ".join(doubt for doubt in mapping.doubts if not doubt.startswith(LACKS))
        raise InputError(character.path, f"has no joint that could be {', '.join(missing)}"
                         + (f" ({doubts})" if doubts else ""), "name its joints in a mapping (--save-mapping writes "
                         "one to fill in, --mapping reads it); gestures need both arms, and bones need no mesh")
    used: dict[int, str] = {}
    for name, node in [*mapping.joints.items(), *(("Spine", node) for node in mapping.spine),
                       *(("Neck", node) for node in mapping.neck)]:
        if node in used:
            raise InputError(character.path, f"has one node, {shown(character.names[node])}, for {used[node]} and "
                             f"{name}", ADVICE)
        used[node] = name
    chains = [(side + above, side + below) for parts in (ARM_PARTS[1:], LEG_PARTS[:3]) for side in SIDES
              for above, below in pairwise(parts)]
    for above, below in (*chains, *(("Hips", name) for name in ("Head", "LeftHand", "RightHand"))):
        top, low = mapping.joints.get(above), mapping.joints.get(below)
        # A joint that is not below the one before would not move with it.
        if top is not None and low is not None and top not in ancestors(character.parents, low):
            raise InputError(character.path, f"does not have {shown(character.names[low])} under "
                             f"{shown(character.names[top])}", ADVICE)
    if mapping.confidence < SURE:
        raise InputError(character.path, f"has joints that can only be guessed, {mapping.confidence:.0%} sure: "
                         f"{'; '.join(mapping.doubts) or 'its names are unknown'}",
                         "check and correct the guess: --save-mapping FILE.json, then --mapping "
                         "FILE.json")


def ancestors(parents: Sequence[int], node: int) -> list[int]:
    """The ancestors of a node, its parent first; none of -1, which is no node."""
    line: list[int] = []
    if node < 0:
        return line
    while (node := parents[node]) >= 0:
        line.append(node)
    return line


# ---------------------------------------------------------------------------------------------------- its file

def node_keys(character: Character) -> tuple[str, ...]:
    """A unique key for each node: its name, or "NAME#NUMBER" (its number in the file) if the name repeats."""
    counts = Counter(character.names)
    return tuple(name if name and counts[name] == 1 else f"{name}#{number}"
                 for name, number in zip(character.names, character.node_ids, strict=True))


def to_json(mapping: RigMapping, character: Character) -> dict[str, Any]:
    """The mapping in plain values; joints that were not found are null, for the user to fill in."""
    keys = node_keys(character)
    joints: dict[str, Any] = {name: keys[mapping.joints[name]] if name in mapping.joints else None for name in SINGLE}
    return {"format": 1, "character": character.path.name, "confidence": round(mapping.confidence, 3),
            "doubts": list(mapping.doubts),
            "spine": [keys[node] for node in mapping.spine], "neck": [keys[node] for node in mapping.neck],
            "joints": joints}


def save_mapping(path: str | os.PathLike[str], mapping: RigMapping, character: Character) -> None:
    """Write the mapping as JSON, atomically; `load_mapping` reads it."""
    write_text(path, json.dumps(to_json(mapping, character), indent=1, ensure_ascii=False) + "\n")


def load_mapping(path: str | os.PathLike[str], character: Character) -> RigMapping:
    """Read a mapping for this character. `InputError` for an invalid one."""
    stored = read_joint_map(path)
    nodes = {key: node for node, key in enumerate(node_keys(character))}

    def find(key: str) -> int:
        if key not in nodes:
            raise InputError(path, f"names {shown(key)}, which {character.path.name} does not have", ADVICE)
        return nodes[key]

    joints = {name: find(key) for name, key in stored.joints.items() if key is not None}
    return RigMapping(joints, tuple(map(find, stored.spine)), tuple(map(find, stored.neck)), given=True)


def described(mapping: RigMapping, character: Character) -> str:
    """The mapping as text: our joints with the character's names."""
    rows: dict[str, tuple[int, ...]] = {"Hips": (), "Spine": mapping.spine, "Neck": mapping.neck}
    rows |= {name: (mapping.joints[name],) if name in mapping.joints else () for name in SINGLE
             if name in mapping.joints or name not in FINGER_JOINTS}
    return "\n".join([
        f"{character.path.name}: {len(character)} nodes, {len(mapping.joints)} joints found",
        *(f"  doubt: {doubt}" for doubt in mapping.doubts),
        *(f"  {name:<18} {', '.join(character.names[node] for node in some) or '-'}" for name, some in rows.items())])
