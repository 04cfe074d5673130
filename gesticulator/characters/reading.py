"""Reads characters and their joint mappings from files, with one reader per suffix."""

import os
from pathlib import Path
from typing import cast

from data_module.errors import InputError
from data_module.registry import Registry, RegistryEntry
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import RigMapping, load_mapping, save_mapping
from gesticulator.characters.rig import Character, chosen, split_name

__all__ = ["READERS", "read_character"]

READERS: Registry[RegistryEntry] = Registry("characters", "a format of characters that can be read", {
    ".bvh": RegistryEntry("a skeleton in its rest pose", "gesticulator.characters.bvh_rig:read_bvh_character"),
    ".glb": RegistryEntry("binary glTF", "gesticulator.characters.gltf_rig:read_gltf_character"),
    ".gltf": RegistryEntry("glTF", "gesticulator.characters.gltf_rig:read_gltf_character"),
    ".vrm": RegistryEntry("VRM 0.x and 1.0", "gesticulator.characters.gltf_rig:read_gltf_character"),
    ".fbx": RegistryEntry("FBX, through Blender", "gesticulator.characters.gltf_rig:read_gltf_character"),
}, RegistryEntry)
"""By suffix: reader(path) -> `Character`."""


def read_character(path: str | os.PathLike[str]) -> Character:
    """The character in a file, or with `file#name` one of several. `InputError` for an unknown or invalid file."""
    file, name = split_name(os.fspath(path))
    suffix = Path(file).suffix.lower()
    if suffix not in READERS:
        wrong = f"'{suffix}' is not a supported character format" if suffix else "has no suffix"
        raise InputError(file, wrong, f"give one of {', '.join(READERS)}")
    character = cast("Character", READERS.load(suffix)(file))
    return chosen(character, name) if name else character


def choose(file: str | os.PathLike[str], mapping: str | os.PathLike[str] | None = None,
           save: str | os.PathLike[str] | None = None) -> tuple[Character, RigMapping]:
    """The character in a file and its mapping, unchecked: from a file, else detected. save: where to write it."""
    character = read_character(file)
    joints = find_joints(character) if mapping is None else load_mapping(mapping, character)
    if save is not None:
        Path(save).parent.mkdir(parents=True, exist_ok=True)
        save_mapping(save, joints, character)
    return character, joints
