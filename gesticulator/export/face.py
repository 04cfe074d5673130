"""The face in files: tracks of glTF and VRM animations."""

import warnings
from typing import Any

import numpy as np

from data_module.motion import rotation
from data_module.types import Array
from gesticulator.characters.rig import Character
from gesticulator.export.gltf import (
    ROTATION,
    TRANSLATION,
    WEIGHTS,
    FrameTrack,
    GltfDocument,
    as_gltf,
)
from gesticulator.face.motion import FaceMotion
from gesticulator.face.rig import find_face
from gesticulator.face.shapes import lacking, vrm


class FaceWarning(UserWarning):
    """A character that can show no face, or only some of it."""


def tracks_of(gltf: GltfDocument, character: Character, arms: tuple[int, int], face: FaceMotion, name: str
              ) -> list[FrameTrack]:
    """Tracks of the morph weights, eyes and jaw of a character (node of the file, property, values). A `FaceWarning`
    says if it has no mouth to move. arms: nodes of its left and right upper arm; name: of the file that was given."""
    # Characters without a mouth still show gaze and blinks, so this is a warning.
    rig = find_face(character)
    missing = lacking(rig.curves | ({"jawOpen"} if rig.jaw is not None else set()))
    for holds, what in (
            (missing, f"lacks {', '.join(missing)}, so its mouth shows less of what is said"),
            (not rig.can_speak, "has neither mouth shapes nor a jaw bone, so its mouth stays as it is"),
            (character.vrm and rig.morphs, "players of VRMs (three-vrm) set its shapes back; write .vrma for them")):
        if holds:
            warnings.warn(FaceWarning(f"{name}: {what}"), stacklevel=3)
    places = character.world_matrices()[:, :3, 3]
    left = places[arms[0]] - places[arms[1]]
    left[1] = 0.0
    out: list[FrameTrack] = [(node, WEIGHTS, weights.astype("<f4").reshape(-1))
                                           for node, weights in rig.weights(face).items()]
    for node, turns in rig.turns(face, character, left / np.linalg.norm(left)).items():
        gltf.split_matrix(character, node)
        out.append((character.node_ids[node], ROTATION, as_gltf(rotation.continuous(turns[:, None])[:, 0])))
    return out


def vrma_tracks(gltf: GltfDocument, extension: dict[str, Any], face: FaceMotion) -> list[FrameTrack]:
    """Nodes and tracks of the expressions and the gaze of a VRM animation, whose `extension` names them. The weight of
    an expression is the X translation of its node (VRMC_vrm_animation 1.0)."""
    document = gltf.document
    presets: dict[str, Any] = {}
    out: list[FrameTrack] = []

    def node(name: str) -> int:
        document["nodes"].append({"name": name})
        document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
        return len(document["nodes"]) - 1

    for name, curve in vrm(face).items():
        if name.startswith("look") or (face.lips_only and name in ("blink", "happy", "sad")):
            continue
        presets[name] = {"node": node(name)}
        shifts = np.zeros((len(face), 3), "<f4")
        shifts[:, 0] = curve
        out.append((presets[name]["node"], TRANSLATION, shifts))
    extension["expressions"] = {"preset": presets}
    if not face.lips_only:
        extension["lookAt"] = {"node": node("lookAt"), "offsetFromHeadBone": [0.0, 0.06, 0.0]}
        out.append((extension["lookAt"]["node"], ROTATION, as_gltf(eye_turns(face))))
    return out


def eye_turns(face: FaceMotion) -> Array:
    """[T, 4] turns of the eyes in a head that faces +Z, w first."""
    turns = rotation.multiply(rotation.from_exponential_map(face.gaze[:, :1] * np.array([0.0, 1.0, 0.0])),
                              rotation.from_exponential_map(face.gaze[:, 1:] * np.array([-1.0, 0.0, 0.0])))
    return rotation.continuous(turns[:, None])[:, 0]
