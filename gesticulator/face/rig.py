"""The parts of a glTF character that show a face: morph targets, VRM expressions, eye bones, a jaw bone."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from data_module.errors import InputError, shown
from data_module.motion import rotation
from data_module.types import Array
from gesticulator.characters.gltf_file import AGAIN, GltfFile, read_gltf
from gesticulator.characters.rig import Character
from gesticulator.face.motion import FaceMotion
from gesticulator.face.shapes import VRM, VRM_0, curves, find_shapes, is_lips, jaw_angles, lacking

_EYES = {"Left": re.compile(r"(left[ _.]?eye|eye[ _.]?left|eye[_.]l|l[_.]eye|cc_base_l_eye|facial_l_eye)", re.I),
         "Right": re.compile(r"(right[ _.]?eye|eye[ _.]?right|eye[_.]r|r[_.]eye|cc_base_r_eye|facial_r_eye)", re.I)}
_JAW = re.compile(r"(cc_base_|facial_c_|mixamorig:?|def[-_.])?(jaw|jaw[ _.]?(root|bone|master)|lower[ _]?jaw)", re.I)
_RICH = 20
"""Lip shapes in ARKit's names from which on they are preferred to the five vowels of VRM."""


@dataclass(frozen=True)
class FaceRig:
    """morphs: node of the file -> (index of the target, curve of `shapes.curves`, share), several per target
    added up; base: node -> weights of its targets at rest. eyes: nodes of the character that
    turn with the gaze; jaw: the node that turns with the mouth where no shape opens it, or None."""

    morphs: Mapping[int, tuple[tuple[int, str, float], ...]] = field(default_factory=dict)
    base: Mapping[int, Array] = field(default_factory=dict)
    eyes: tuple[int, ...] = ()
    jaw: int | None = None

    @property
    def can_speak(self) -> bool:
        """True if a shape or a jaw moves the mouth."""
        return self.jaw is not None or any(map(is_lips, self.curves))

    @property
    def curves(self) -> set[str]:
        """The curves that drive its shapes."""
        return {curve for rows in self.morphs.values() for _, curve, _ in rows}

    def weights(self, face: FaceMotion) -> dict[int, Array]:
        """Node of the file -> [T, targets] weights over time."""
        # Shapes that nothing drives keep the weight that the file gives them at rest.
        known, out = curves(face), {}
        for node, rows in self.morphs.items():
            values = np.tile(self.base[node], (len(face), 1))
            driven = [row for row in rows if is_lips(row[1]) or not face.lips_only]
            values[:, [index for index, _, _ in driven]] = 0.0
            for index, curve, share in driven:
                values[:, index] += share * known[curve]
            out[node] = np.clip(values, 0.0, 1.0)
        return out

    def turns(self, face: FaceMotion, character: Character, left: Array) -> dict[int, Array]:
        """Node of the character -> [T, 4] local rotations, w first. left: [3] the character's left, a unit vector of
        its world at rest, Y up."""
        # In the world of the character at rest: eye and jaw bones of tools have axes of all kinds.
        up = np.array([0.0, 1.0, 0.0])
        world = {}
        if self.jaw is not None:
            world[self.jaw] = rotation.from_exponential_map(jaw_angles(face)[:, None] * left)
        if not face.lips_only:
            gaze = rotation.multiply(rotation.from_exponential_map(face.gaze[:, :1] * up),
                                     rotation.from_exponential_map(-face.gaze[:, 1:] * left))
            world |= dict.fromkeys(self.eyes, gaze)
        # Local to the parent: back out of the parent's rest, the turn, and into it again, then the rest of the bone.
        above = character.world_turns()
        out = {}
        for node, turn in world.items():
            parent = character.parents[node]
            matrix = above[parent] if parent >= 0 else np.eye(3)
            rest = rotation.from_matrix(matrix)
            out[node] = rotation.multiply(rotation.multiply(rotation.conjugate(rest), rotation.multiply(turn, rest)),
                                          character.rotations[node])
        return out


def find_face(character: Character) -> FaceRig:
    """The face of a character in a glTF file; an empty one for other formats. `InputError` for a broken file."""
    if character.kind != "glb":
        return FaceRig()
    file = read_gltf(character.path)
    try:
        return _found(file, character)
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise InputError(character.path, f"has broken morph targets or expressions ({type(error).__name__}: "
                         f"{shown(str(error), 80)})", AGAIN) from None


def _found(file: GltfFile, character: Character) -> FaceRig:
    base: dict[int, Array] = {}
    names: dict[int, list[str]] = {}
    for number, node in enumerate(file.rows("nodes")):
        mesh = file.rows("meshes")[node["mesh"]] if "mesh" in node else {}
        count = max((len(part.get("targets", [])) for part in mesh.get("primitives", [])), default=0)
        if not count:
            continue
        # A node overrides its mesh, and both may give fewer weights than there are targets.
        given = node.get("weights", mesh.get("weights", []))
        base[number] = np.array([float(weight) for weight in given][:count] + [0.0] * (count - len(given)))
        names[number] = [str(name) for name in _target_names(mesh)][:count]
    eyes = _eyes(character)
    shapes = find_shapes(name for listed in names.values() for name in listed)
    morphs: dict[int, list[tuple[int, str, float]]] = {
        node: [(index, *shapes[name]) for index, name in enumerate(listed) if name in shapes]
        for node, listed in names.items()}
    if sum(is_lips(curve) for rows in morphs.values() for _, curve, _ in rows) < _RICH:
        expressions = _expressions(file, base)
        if any(is_lips(curve) for rows in expressions.values() for _, curve, _ in rows):
            morphs = expressions
    if eyes:
        morphs = {node: [row for row in rows if not re.match("eyeLook|vrm_look", row[1])]
                  for node, rows in morphs.items()}
    rig = FaceRig({node: tuple(rows) for node, rows in morphs.items() if rows}, base, eyes)
    opens = rig.can_speak and "jawOpen" not in lacking(rig.curves)
    return rig if opens else replace(rig, jaw=_jaw(character))


def _target_names(mesh: Mapping[str, Any]) -> list[Any]:
    """Names of the morph targets, where exporters put them."""
    for extras in (mesh.get("extras"), *(part.get("extras") for part in mesh.get("primitives", []))):
        if isinstance(extras, dict) and isinstance(extras.get("targetNames"), list):
            return list(extras["targetNames"])
    return []


def _expressions(file: GltfFile, base: Mapping[int, Array]) -> dict[int, list[tuple[int, str, float]]]:
    """Node -> (target, curve, share) of the expressions of a VRM."""
    extensions = file.document.get("extensions", {})
    out: dict[int, list[tuple[int, str, float]]] = {node: [] for node in base}

    def add(node: int, index: int, name: str, share: float) -> None:
        if node in base and 0 <= index < len(base[node]):
            out[node].append((index, f"vrm_{name}", share))

    if "VRMC_vrm" in extensions:
        presets = extensions["VRMC_vrm"].get("expressions", {}).get("preset", {})
        for name in VRM:
            for bind in presets.get(name, {}).get("morphTargetBinds", []):
                add(int(bind["node"]), int(bind["index"]), name, float(bind["weight"]))
    elif "VRM" in extensions:
        presets_0 = {old: name for name, old in VRM_0.items()}
        for group in extensions["VRM"].get("blendShapeMaster", {}).get("blendShapeGroups", []):
            preset = presets_0.get(str(group.get("presetName", "")).lower())
            for bind in group.get("binds") or () if preset else ():
                for number, node in enumerate(file.rows("nodes")):
                    if node.get("mesh") == bind["mesh"]:
                        add(number, int(bind["index"]), str(preset), float(bind["weight"]) / 100.0)
    return out


def _eyes(character: Character) -> tuple[int, ...]:
    if {"leftEye", "rightEye"} <= set(character.humanoid):
        return character.humanoid["leftEye"], character.humanoid["rightEye"]
    eyes = [next((node for node, name in enumerate(character.names)
                  if character.skinned[node] and pattern.fullmatch(name.rpartition(":")[2])), -1)
            for pattern in _EYES.values()]
    return tuple(eyes) if min(eyes) >= 0 else ()


def _jaw(character: Character) -> int | None:
    if "jaw" in character.humanoid:
        return character.humanoid["jaw"]
    return next((node for node, name in enumerate(character.names) if _JAW.fullmatch(name)), None)
