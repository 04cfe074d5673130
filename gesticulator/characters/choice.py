"""A character and her mapping as a user names them, for commands; and the verb that shows what was found."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from gesticulator.characters import READERS, read_character
from gesticulator.characters.joints import find_joints
from gesticulator.characters.mapping import RigMapping, check, described, load_mapping, save_mapping
from gesticulator.characters.rig import Character
from gesticulator.cli import Command


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


def arguments(p: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    p.add_argument("character", metavar="FILE", help=f"a character: {', '.join(READERS)}")
    p.add_argument("--mapping", metavar="FILE.json", help="check this mapping instead of searching")
    p.add_argument("--save-mapping", metavar="FILE.json", help="write what was found, to correct it")


def run(asked: argparse.Namespace) -> int:
    """Print which of a character's nodes was taken for which joint; exit code 2 where that could not be used."""
    character = read_character(asked.character)
    found = find_joints(character) if asked.mapping is None else load_mapping(asked.mapping, character)
    print(described(found, character), flush=True)
    if asked.save_mapping is not None:
        Path(asked.save_mapping).parent.mkdir(parents=True, exist_ok=True)
        save_mapping(asked.save_mapping, found, character)
    check(found, character)
    return 0


COMMAND = Command(
    "which joints of a character are which, and how sure that is", arguments, run,
    examples=(
        "character rig.glb",
        "character rig.fbx --save-mapping rig.json",
        "character rig.fbx --mapping rig.json",
    ))
