"""Characters of any origin: their files read into one type, `Character`, and their joints found."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from data_module.errors import InputError
from gesticulator.characters.rig import Character

__all__ = ["READERS", "Character", "read_character"]

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
