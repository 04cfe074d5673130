"""Read a character from a file, with the mapping of its joints; one reader a suffix."""

from __future__ import annotations

import os
from pathlib import Path
from typing import cast

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import RigMapping, check, load_mapping, save_mapping
from gesticulator.characters.rig import Character

__all__ = ["READERS", "read_character"]

READERS: Registry[RegistryEntry] = Registry("characters", "a format of characters that can be read", {
    ".bvh": RegistryEntry("a skeleton in its rest pose", "gesticulator.characters.bvh_rig:read_bvh_character"),
    ".glb": RegistryEntry("binary glTF", "gesticulator.characters.gltf_rig:read_gltf_character"),
    ".gltf": RegistryEntry("glTF", "gesticulator.characters.gltf_rig:read_gltf_character"),
    ".vrm": RegistryEntry("VRM 0.x and 1.0", "gesticulator.characters.gltf_rig:read_gltf_character"),
    ".fbx": RegistryEntry("FBX, through Blender", "gesticulator.characters.fbx_rig:read_fbx_character"),
}, RegistryEntry)
"""By suffix: reader(path) -> `Character`."""


def read_character(path: str | os.PathLike[str]) -> Character:
    """The character in a file, by its suffix. `InputError` for an unknown suffix and what is wrong with a file."""
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        wrong = f"'{suffix}' is no format of characters that is read" if suffix else "has no suffix"
        raise InputError(path, wrong, f"give one of {', '.join(READERS)}")
    return cast("Character", READERS.load(suffix)(path))


def choose(file: str | os.PathLike[str], mapping: str | os.PathLike[str] | None = None,
           save: str | os.PathLike[str] | None = None) -> tuple[Character, RigMapping]:
    """The character in a file, and her mapping: from a file, else found by itself.

    save: where the mapping is written, before it is judged. `InputError` where it cannot be used.
    """
    character = read_character(file)
    found = find_joints(character) if mapping is None else load_mapping(mapping, character)
    if save is not None:
        Path(save).parent.mkdir(parents=True, exist_ok=True)
        save_mapping(save, found, character)
    check(found, character)
    return character, found
