"""`gesticulator character`: identify the joints of a character."""

import argparse

from gesticulator.cli import Command


def arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("character", metavar="FILE", help="a character: .bvh, .glb, .gltf, .vrm or .fbx")
    p.add_argument("--mapping", metavar="FILE.json", help="check this mapping instead of identifying the joints")
    p.add_argument("--save-mapping", metavar="FILE.json", help="write the joint mapping, to correct it")


def run(args: argparse.Namespace) -> int:
    """Print the joint of each node, and measurements of the character in some poses; `InputError` if the mapping is
    unusable or the moved character is not sound."""
    from gesticulator.characters.mapping import described
    from gesticulator.characters.reading import choose
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.characters.rig import note_of

    character, mapping = choose(args.character, args.mapping, args.save_mapping)
    print(described(mapping, character), flush=True)
    if "Hips" in mapping.joints and (note := note_of(character, mapping.joints["Hips"])):
        print(note, flush=True)
    moved = Retargeter(character, mapping)
    odd = [doubt for doubt in moved.doubts if doubt not in mapping.doubts]
    for doubt in odd:
        print(f"  doubt: {doubt}")
    print(f"  moved to check it, {moved.confidence:.0%} sure: " + (
        "look at the result" if odd else "stands upright and gestures; its mesh follows"
        if len(character.skin.points) else "stands upright and gestures"))
    return 0


COMMAND = Command(
    "identify the joints of a character, with the confidence of each", arguments, run,
    examples=(
        "character rig.glb",
        "character rig.fbx --save-mapping rig.json",
        "character rig.fbx --mapping rig.json",
    ))
