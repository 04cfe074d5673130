"""Labels of a character's nodes with what its whole set of names says: known conventions, and which nodes move a mesh.

A single name can mislead: Rigify numbers neck and head as joints of the spine, and an exported control rig has every
part three times. A convention is recognised by several names together.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from gesticulator.characters.mapping import ARM_PARTS, LEG_PARTS, SIDES, ancestors
from gesticulator.characters.names import Label, labels
from gesticulator.characters.rig import Character

_RIGIFY = re.compile(r"(DEF[-_]|ORG[-_]|)spine(?:[._]?(\d{3}))?", re.IGNORECASE)
"""Rigify's spine: its joints 0 to 3 are hips and trunk, the last one is the head, and those before it are the neck."""
_TRUNK = 4
_FAMILY = {"upper_arm", "forearm", "thigh", "shin"}
"""Names that show, beside such a spine, that it is Rigify's."""


def conventional(character: Character) -> tuple[Label, ...]:
    """[N] the labels of a character's nodes."""
    found = list(labels(character.names))
    for node, entry in {**_rigify_spine(character, found), **_numbered_limbs(character, found)}.items():
        found[node] = entry
    return tuple(_of_the_mesh(character, found))


def _rigify_spine(character: Character, found: list[Label]) -> dict[int, Label]:
    """Node -> label of the spine of a Rigify character; empty for others, and if other nodes are named as the head."""
    stems = {re.sub(r"^(DEF|ORG)[-_]", "", name, flags=re.IGNORECASE).lower().split(".")[0].rstrip("_lr")
             for name in character.names}
    if not stems >= _FAMILY:
        return {}
    chains: dict[str, dict[int, int]] = {}
    for node, name in enumerate(character.names):
        match = _RIGIFY.fullmatch(name)
        if match:
            chains.setdefault(match[1].upper()[:3], {})[int(match[2] or 0)] = node
    chain = next((chains[prefix] for prefix in ("DEF", "", "ORG")
                  if len(chains.get(prefix, ())) > _TRUNK and 0 in chains[prefix]), None)
    if chain is None:
        return {}
    heads = [node for node, entry in enumerate(found)
             if entry.parts[:1] == ("Head",) and not entry.tip and not entry.aid]
    if any(set(chain.values()) & set(ancestors(character.parents, node)) for node in heads) or (
            len(character.flesh) and np.isin(heads, character.flesh_nodes).any()):
        return {}  # the spine carries a head of that name
    out = {node: Label((("Hips",) if number == 0 else ("Spine",) if number < _TRUNK else ("Neck",)), "", str(number))
           for number, node in chain.items()}
    out[chain[max(chain)]] = Label(("Head",))
    return out | {node: Label() for node in heads}


def _numbered_limbs(character: Character, found: list[Label]) -> dict[int, Label]:
    """Node -> label of limbs whose bones are all called arm or leg, one below the other, as those that Blender names
    after the one that they were extruded from (Arm.L, Arm.L.001, Arm.L.002), or arm_l_1 to arm_l_3."""
    out: dict[int, Label] = {}
    for side in SIDES:
        for word, ends, parts in ((("Arm", "ForeArm"), {"ForeArm", "Hand"}, ARM_PARTS),
                                  (("Leg", "UpLeg"), {"UpLeg", "Foot"}, LEG_PARTS)):
            sided = {node: entry for node, entry in enumerate(found)
                     if entry.side == side and entry.parts and not entry.aid and not entry.tip}
            line = [node for node, entry in sided.items() if entry.parts == word]
            line.sort(key=lambda node: len(ancestors(character.parents, node)))
            if len(line) not in (3, 4) or any(entry.parts[0] in ends for entry in sided.values()) or any(
                    above not in ancestors(character.parents, node)
                    for above, node in zip(line, line[1:], strict=False)):
                continue
            named = parts[-len(line):] if word[0] == "Arm" else parts[:len(line)]
            out |= {node: replace(found[node], parts=(part,)) for node, part in zip(line, named, strict=True)}
    return out


def _of_the_mesh(character: Character, found: list[Label]) -> list[Label]:
    """The labels, without those of controls: nodes that move no vertex although another of the same name does."""
    if not len(character.flesh):
        return found
    moves = np.zeros(len(character), dtype=bool)
    moves[np.unique(character.flesh_nodes)] = True
    moving = {(entry.parts[0], entry.side, entry.number) for node, entry in enumerate(found)
              if entry.parts and moves[node] and not entry.aid and not entry.tip}
    return [replace(entry, parts=()) if entry.parts and not moves[node] and not character.skinned[node]
            and (entry.parts[0], entry.side, entry.number) in moving else entry for node, entry in enumerate(found)]
