"""A character's motion relative to its resting pose, to be added to another clip of the same file."""

from __future__ import annotations

from dataclasses import replace

from data_module.motion import rotation
from gesticulator.characters.rig import CharacterMotion


def added_to_rest(moved: CharacterMotion, rest: CharacterMotion) -> CharacterMotion:
    """The motion with local rotations R D, where R is the node's rotation at rest in the file and pose = (resting pose)
    D. rest: the resting pose, one frame.

    Tools that make clips additive take D relative to the rest of the file, and multiply the local rotations of the
    clip below by it from the right: over arms that hang, the character gestures as it does without that clip.
    """
    delta = rotation.multiply(rotation.conjugate(rest.rotations), moved.rotations)
    rotations = rotation.multiply(moved.character.rotations, delta)
    return replace(moved, rotations=rotation.continuous(rotation.normalise(rotations)), translations=None)
