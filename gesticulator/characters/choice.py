"""A character and her mapping as a user names them, for commands."""

from __future__ import annotations

import os
from pathlib import Path

from gesticulator.characters import read_character
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import RigMapping, check, load_mapping, save_mapping
from gesticulator.characters.rig import Character


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
