"""The verb that shows which joints of a character are which. Nothing heavy is imported before it runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from gesticulator.cli import Command


def arguments(p: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    p.add_argument("character", metavar="FILE", help="a character: .bvh, .glb, .gltf, .vrm or .fbx")
    p.add_argument("--mapping", metavar="FILE.json", help="check this mapping instead of identifying the joints")
    p.add_argument("--save-mapping", metavar="FILE.json", help="write the joint mapping, to correct it")


def run(asked: argparse.Namespace) -> int:
    """Print which of a character's nodes was taken for which joint; exit code 2 where that could not be used."""
    from gesticulator.characters.joints import find_joints
    from gesticulator.characters.mapping import check, described, load_mapping, save_mapping
    from gesticulator.characters.reading import read_character

    character = read_character(asked.character)
    found = find_joints(character) if asked.mapping is None else load_mapping(asked.mapping, character)
    print(described(found, character), flush=True)
    if asked.save_mapping is not None:
        Path(asked.save_mapping).parent.mkdir(parents=True, exist_ok=True)
        save_mapping(asked.save_mapping, found, character)
    check(found, character)
    return 0


COMMAND = Command(
    "identify the joints of a character, with the confidence of each", arguments, run,
    examples=(
        "character rig.glb",
        "character rig.fbx --save-mapping rig.json",
        "character rig.fbx --mapping rig.json",
    ))
