"""Characters in FBX files, read by Blender in a separate process.

The armature is used as Blender imports it: metres, Z up, a rest matrix for each bone.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError, shown
from data_module.files import read_json
from gesticulator.characters.blender import run_in_blender
from gesticulator.characters.bvh_rig import turns_of
from gesticulator.characters.rig import Character, Skin, decomposed

SCRIPT = Path(__file__).with_name("fbx_child.py")
_LARGEST = 1 << 28
"""Largest JSON description of a rig, bytes (256 MiB): 100,000 bones take half of it."""


def read_fbx_character(path: str | os.PathLike[str]) -> Character:
    """The rig of an FBX file. `InputError` without Blender, or without an armature in the file.

    Node 0 is the armature object with the scale and rotation of its import; the others are its bones.
    """
    source = Path(path)
    if not source.is_file():
        raise InputError(path, "does not exist" if not source.exists() else "is not a regular file", "check the path")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "rig.json"
        run_in_blender(source, SCRIPT, str(source.resolve()), str(target))
        document: dict[str, Any] = read_json(target, "export it again", _LARGEST)
    bones = document["bones"]
    if len(bones) < 2:
        raise InputError(path, "holds no armature", "export the armature, too")
    character = from_bones(source, bones)
    if not document["triangles"]:
        return character
    joints, weights = np.array(document["joints"], dtype=np.int64), np.array(document["weights"])
    skin = Skin(np.array(document["points"]), joints, weights, np.array(document["triangles"], dtype=np.int64))
    return replace(character, skin=skin, flesh=skin.points, flesh_nodes=joints[:, 0])


def from_bones(path: Path, bones: list[dict[str, Any]]) -> Character:
    """The character of a list of bones {"name", "parent", "matrix": 16 numbers by rows, relative to the parent,
    "length": metres along the bone's Y axis}, the armature object first. `InputError` for singular matrices."""
    matrices = np.array([node["matrix"] for node in bones], dtype=np.float64).reshape(-1, 4, 4)
    if not np.isfinite(matrices).all() or (np.abs(np.linalg.det(matrices[:, :3, :3])) < 1e-12).any():
        raise InputError(path, f"has bones of no size ({shown(bones[0]['name'])})", "apply its scale and export again")
    n = len(bones)
    skinned = np.ones(n, dtype=bool)
    skinned[0] = False
    return Character(
        tuple(node["name"] for node in bones), tuple(node["parent"] for node in bones), *decomposed(matrices), path,
        "fbx", skinned, space=turns_of(matrices[0]), unit=1.0,
        tips={index: np.array([0.0, float(node["length"]), 0.0]) for index, node in enumerate(bones)
              if index and not any(other["parent"] == index for other in bones)})
