"""Real characters from packages: their joints are those that a human sees, and what comes out is sound, or refused.

The repository keeps this list, not the files: package, version, the hash of the archive, the licence, and the names of
the nodes that a human takes for hips, head, arms and legs (`joints`), or the reason why nothing must be written.
GESTICULATOR_ZOO names the folder in which the packages are unpacked; one that is missing is skipped with the reason.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from data_module.errors import InputError
from gesticulator.characters.joints import find_joints
from gesticulator.characters.reading import read_character
from gesticulator.characters.retarget import Retargeter

CACHE = "GESTICULATOR_ZOO"
"""Environment variable: the folder in which the packages and characters are kept."""
_SIDES = {"Left": 0, "Right": 1}


@dataclass(frozen=True)
class Package:
    """An archive. source: "pypi", "debian" or "npm"; sha256: of the file to unpack; licence: of the models."""

    name: str
    version: str
    source: str
    sha256: str
    licence: str


PACKAGES = {package.name: package for package in (
    Package("gradio", "6.31.0", "pypi", "7b50b9b6a2d23cd02851ad4c8b1c8312c88d8b911d1f29c93f9761c98348a64a",
            "CC0 mesh, CC-BY 4.0 rig (Khronos' Fox)"),
    Package("assimp-testmodels", "5.2.5~ds0-1", "debian",
            "526f326186000cd6f631ea806128548a7d3d391abd8149fddc5c4c8513e80b8a", "BSD-3-Clause and free test models"),
    Package("qt3d5-examples", "5.15.8+dfsg-2", "debian",
            "ebc1e303e638e05d4b12b5b2f237fe7709d4a502c248fc6a6d3414a0fd820d84", "BSD-3-Clause; CC-BY 4.0 (Khronos)"),
    Package("threed-garden", "0.15.0", "npm", "dcc334d30892b2ba78626b11fc9c34d6c02f9b048c19a46fe88445a1b242db01",
            "MIT (the package)"),
)}


@dataclass(frozen=True)
class Animal:
    """A character. package: a key of `PACKAGES`; file: in it.

    joints: our joint -> name of the node, as a human reads it; refused: a part of the reason, if nothing is to be
    written. "" for both: nothing is known of its joints (nodes without names).
    """

    name: str
    package: str
    file: str
    joints: Mapping[str, str] = field(default_factory=dict)
    refused: str = ""


def _both(hips: str, head: str, limbs: str, sides: tuple[str, str]) -> dict[str, str]:
    """limbs: patterns of upper arm, forearm, hand, thigh, shin and foot, in this order, with {} for the side."""
    names = zip(("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"), limbs.split(), strict=True)
    return {"Hips": hips, "Head": head, **{side + part: pattern.format(sides[place])
                                           for part, pattern in names for side, place in _SIDES.items()}}


_FOUR = "four legs"
_CMU = _both("Hips", "Head", "{}Arm {}ForeArm {}Hand {}UpLeg {}Leg {}Foot", ("Left", "Right"))

ANIMALS: tuple[Animal, ...] = (
    Animal("BCN Epileptic", "assimp-testmodels", "X/BCN_Epileptic.X", _both(
        "B_Root_Pelvis_L", "B_Neck", "B_UpperArm_{} B_ForeArm_{} B_Hand_{} B_Hip_{} B_Knee_{} B_Ankle_{}",
        ("Left", "Right"))),
    Animal("CMU 01_01", "assimp-testmodels", "BVH/01_01.bvh", _CMU),
    Animal("CMU 01_03", "assimp-testmodels", "BVH/01_03.bvh", _CMU),
    Animal("Boxing", "assimp-testmodels", "BVH/Boxing_Toes.bvh", _both(
        "Hips", "Head", "{}Shoulder {}Elbow {}Wrist {}Hip {}Knee {}Ankle", ("Left", "Right"))),
    Animal("Rigged Figure", "qt3d5-examples", "RiggedFigure/RiggedFigure.gltf"),
    Animal("Young korrigan", "threed-garden", "examples/young-korrigan/model.gltf", {
        "Hips": "root", "Head": "head", **{side + part: f"{name} {side.lower()}" for side in _SIDES
                                           for part, name in (("Arm", "arm"), ("ForeArm", "forearm"),
                                                              ("Hand", "hand"))}}),
    # What must be refused.
    Animal("Fox", "gradio", "gradio/media_assets/models3d/Fox.gltf", refused=_FOUR),
    Animal("Wuson", "assimp-testmodels", "X/Testwuson.X", refused=_FOUR),
    Animal("Ankou's horse and cart", "threed-garden", "examples/ankou-with-cart/model.gltf", refused=_FOUR),
    Animal("Huesitos", "assimp-testmodels", "FBX/huesitos.fbx", refused="no joint that could be"),
)


class Unavailable(Exception):
    """A package or a tool that this machine cannot get, with the reason."""


def character_file(animal: Animal) -> Path:
    """The file of a character, made if it is not there. `Unavailable` with the reason if it cannot be had."""
    opened = unpacked(PACKAGES[animal.package])
    source = next((file for file in opened.rglob(Path(animal.file).name) if str(file).endswith(animal.file)), None)
    if source is None:
        raise Unavailable(f"{animal.file} is not in {animal.package}")
    return _converted(animal, source) if source.suffix.lower() in (".x", ".fbx") else source


def unpacked(package: Package) -> Path:
    """The folder of an archive's files."""
    place = Path(os.environ[CACHE]) / f"{package.name}-{package.version}"
    if not place.is_dir():
        raise Unavailable(f"{package.name} {package.version} is not unpacked in {place}")
    return place


def _converted(animal: Animal, source: Path) -> Path:
    """A GLB of an old format, by the program of the library that the model tests."""
    out = Path(os.environ[CACHE]) / "converted" / (animal.name.lower().replace(" ", "_") + ".glb")
    out.parent.mkdir(exist_ok=True)
    if not out.exists():
        if shutil.which("assimp") is None:
            raise Unavailable("assimp is not installed")
        subprocess.run(["assimp", "export", str(source), str(out), "-f", "glb2"], check=True, timeout=600)
    return out


full = pytest.mark.skipif(CACHE not in os.environ, reason=f"{CACHE} does not name a folder for the packages")


@full
@pytest.mark.parametrize("animal", ANIMALS, ids=lambda animal: animal.name)
def test_a_real_character_is_as_a_human_sees_it(animal: Animal) -> None:
    try:
        file = character_file(animal)
    except Unavailable as reason:
        pytest.skip(str(reason))
    character = read_character(file)
    found = find_joints(character)
    if animal.refused:
        with pytest.raises(InputError, match=animal.refused):
            Retargeter(character, found)
        return
    names = {joint: character.names[found.joints[joint]] for joint in animal.joints}
    assert names == dict(animal.joints)
    moved = Retargeter(character, found)
    assert moved.legs
    assert [doubt for doubt in moved.doubts if "distinguish left" not in doubt] == []
