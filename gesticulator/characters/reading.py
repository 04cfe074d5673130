"""Read a character from a file, with the mapping of its joints; one reader a suffix."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from data_module.errors import InputError
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import RigMapping, check, load_mapping, save_mapping
from gesticulator.characters.rig import Character

__all__ = ["READERS", "read_character"]

READERS = {
    ".bvh": "gesticulator.characters.bvh_rig:read_bvh_character",
    ".glb": "gesticulator.characters.gltf_rig:read_gltf_character",
    ".gltf": "gesticulator.characters.gltf_rig:read_gltf_character",
    ".vrm": "gesticulator.characters.gltf_rig:read_gltf_character",
    ".fbx": "gesticulator.characters.fbx_rig:read_fbx_character",
}
"""Suffix -> module and name of reader(path) -> `Character`, imported when a file of that kind is read."""


def read_character(path: str | os.PathLike[str]) -> Character:
    """The character in a file, by its suffix. `InputError` for an unknown suffix and what is wrong with a file."""
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        said = f"'{suffix}' is no format of characters that is read" if suffix else "has no suffix"
        raise InputError(path, said, f"give one of {', '.join(READERS)}")
    module, name = READERS[suffix].split(":")
    reader: Callable[[str | os.PathLike[str]], Character] = getattr(import_module(module), name)
    return reader(path)


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
