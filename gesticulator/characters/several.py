"""Several characters in one file: which there are, and how one is chosen with `file.glb#name`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from data_module.errors import InputError, shown
from gesticulator.characters.rig import Character

_LEAST = 12
"""Joints of a skeleton that may be a character: hips, spine, head and two arms and legs take 15; a prop has fewer."""


def split_name(path: str) -> tuple[str, str]:
    """A path and the name of a character after #; "" without one. A file whose own name has a # is taken as it is."""
    if "#" not in path or Path(path).exists():
        return path, ""
    file, _, name = path.rpartition("#")
    return file, name


def skeletons_of(character: Character) -> dict[str, int]:
    """Name -> top node of every skeleton that may be a character, in the order of the file. The name is that of the
    node above the skeleton if it carries no other, else that of its top joint; repeated names get the node's index."""
    skinned = character.skinned
    top = list(range(len(character)))  # the highest joint of the unbroken line of joints above a node
    for node, parent in enumerate(character.parents):
        if parent >= 0:
            top[node] = top[parent] if skinned[top[parent]] else node
    sizes = np.bincount([top[node] for node in np.flatnonzero(skinned)], minlength=len(character))
    found: dict[str, int] = {}
    tops = [int(node) for node in np.flatnonzero(sizes >= _LEAST)]
    above = [character.parents[node] for node in tops]
    for node, parent in zip(tops, above, strict=True):
        name = character.names[parent] if parent >= 0 and above.count(parent) == 1 else character.names[node]
        name = name or f"node {character.node_ids[node]}"
        found[name if name not in found else f"{name}:{character.node_ids[node]}"] = node
    return found


def chosen(character: Character, name: str) -> Character:
    """The character with the joints and the mesh of one skeleton alone. `InputError` that lists the names, if there is
    none of that name."""
    found = skeletons_of(character)
    if name not in found:
        raise InputError(f"{character.path}#{shown(name)}", "is not a character of the file",
                         f"choose among {', '.join(map(shown, found))}" if found else "leave the name out")
    inside = np.zeros(len(character), dtype=bool)
    inside[found[name]] = True
    for node, parent in enumerate(character.parents):
        inside[node] |= parent >= 0 and inside[parent]
    near = inside[character.flesh_nodes]
    table = {bone: node for bone, node in character.humanoid.items() if inside[node]}
    # Joints are found by their names, too: those of the others must not be read.
    names = tuple(own if here else "" for own, here in zip(character.names, inside, strict=True))
    return replace(character, names=names, skinned=character.skinned & inside, humanoid=table,
                   flesh=character.flesh[near], flesh_nodes=character.flesh_nodes[near])


def note_of(character: Character, hips: int) -> str:
    """A line on a file with several characters, of which the one with the node `hips` is used; "" for one alone."""
    found = skeletons_of(character)
    if len(found) < 2:
        return ""
    line = {hips}
    while character.parents[hips] >= 0:
        hips = character.parents[hips]
        line.add(hips)
    used = next((name for name, node in found.items() if node in line), "")
    others = ", ".join(f"{character.path.name}#{name}" for name in found if name != used)
    return f"holds {len(found)} skeletons, of which {shown(used)} is used; for another give {others}"
