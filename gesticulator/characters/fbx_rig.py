"""Characters in FBX files, read by Blender in a process of its own.

What comes back is the armature as Blender has it after its import: metres, Z up, each bone's rest matrix.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.errors import InputError, shown
from data_module.json_files import read_json
from gesticulator.characters.blender import run_in_blender
from gesticulator.characters.bvh_rig import turns_of
from gesticulator.characters.rig import Character

SCRIPT = Path(__file__).with_name("fbx_child.py")
_LARGEST = 1 << 28
"""Bytes (256 MiB) of what Blender tells of a rig: 100,000 bones take half of it."""


def read_fbx_character(path: str | os.PathLike[str]) -> Character:
    """The rig of an FBX file. `InputError` where there is no Blender, or it finds no armature in the file.

    Node 0 is the armature's object, with the scale and the turn that its import gave it; the others are its bones.
    """
    source = Path(path)
    if not source.is_file():
        raise InputError(path, "does not exist" if not source.exists() else "is no regular file", "check the path")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "rig.json"
        run_in_blender(source, SCRIPT, str(source.resolve()), str(target))
        told: list[dict[str, Any]] = read_json(target, "export it again", _LARGEST)
    if len(told) < 2:
        raise InputError(path, "holds no armature", "export the armature, too")
    return from_bones(source, told)


def from_bones(path: Path, told: list[dict[str, Any]]) -> Character:
    """The character that the script tells of: {"name", "parent", "matrix": 16 numbers by rows, to the parent, "length":
    metres along its own Y axis}, the armature's object first. `InputError` for matrices that turn nothing."""
    matrices = np.array([node["matrix"] for node in told], dtype=np.float64).reshape(-1, 4, 4)
    if not np.isfinite(matrices).all() or (np.abs(np.linalg.det(matrices[:, :3, :3])) < 1e-12).any():
        raise InputError(path, f"has bones of no size ({shown(told[0]['name'])})", "apply its scale and export again")
    n = len(told)
    skinned = np.ones(n, dtype=bool)
    skinned[0] = False
    return Character(
        tuple(node["name"] for node in told), tuple(node["parent"] for node in told), matrices[:, :3, 3],
        Rotation.from_matrix(turns_of(matrices)).as_quat(scalar_first=True),
        np.linalg.norm(matrices[:, :3, :3], axis=1), path, "fbx", skinned, unit=1.0,
        tips={index: np.array([0.0, float(node["length"]), 0.0]) for index, node in enumerate(told)
              if index and not any(other["parent"] == index for other in told)})
