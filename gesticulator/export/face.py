"""The face in files: tracks of glTF and VRM animations, and tables in ARKit's names."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from data_module.files import write_text
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
    transform,
)
from gesticulator.export.writers import Scene
from gesticulator.face.motion import FaceMotion, at_rest
from gesticulator.face.rig import find_face
from gesticulator.face.shapes import ARKIT, arkit, vrm

_EYES = tuple(f"{side}Eye{axis}" for side in ("Left", "Right") for axis in ("Yaw", "Pitch", "Roll"))
LIVE_LINK = ("Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in ARKIT),
             "HeadYaw", "HeadPitch", "HeadRoll", *_EYES)
"""Columns of Live Link Face: 61 values beside the time; rotations in radians."""


class FaceWarning(UserWarning):
    """A character that can show no face, or only some of it."""


# ------------------------------------------------------------------------------------------------------- characters

def tracks_of(gltf: GltfDocument, character: Character, arms: tuple[int, int], face: FaceMotion, name: str
              ) -> list[FrameTrack]:
    """Tracks of the morph weights, eyes and jaw of a character (node of the file, property, values). A `FaceWarning`
    says if it has no mouth to move. arms: nodes of its left and right upper arm; name: of the file that was given."""
    # Characters without a mouth still show gaze and blinks, so this is a warning.
    rig = find_face(character)
    if not rig.can_speak:
        warnings.warn(FaceWarning(f"{name}: has neither mouth shapes nor a jaw bone, so its mouth stays as it is"),
                      stacklevel=3)
    places = character.world_matrices()[:, :3, 3]
    left = places[arms[0]] - places[arms[1]]
    left[1] = 0.0
    out: list[FrameTrack] = [(node, WEIGHTS, weights.astype("<f4").reshape(-1))
                                           for node, weights in rig.weights(face).items()]
    for node, turns in rig.turns(face, character, left / np.linalg.norm(left)).items():
        entry = gltf.document["nodes"][character.node_ids[node]]
        if entry.pop("matrix", None) is not None:
            entry |= transform(character.translations[node], character.rotations[node], character.scales[node])
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


# ----------------------------------------------------------------------------------------------------------- tables

def write_live_link(path: Path, scene: Scene) -> Path:
    """Write the face as CSV with the columns of Live Link Face, atomically. Returns `path`."""
    face = _face_of(scene, path)
    out = io.StringIO()
    out.write(",".join(LIVE_LINK) + "\n")
    for time, row in zip(face.times.tolist(), (_values(face) + 0.0).tolist(), strict=True):
        out.write(f"{timecode(time, face.fps)},{len(row)}," + ",".join(f"{value:.7f}" for value in row) + "\n")
    write_text(path, out.getvalue())
    return path


def timecode(time: float, fps: float) -> str:
    """Hours, minutes, seconds, frame and thousandths of a frame ("00:00:01:30.000"), at whole frames per second."""
    rate = max(round(fps), 1)
    whole, thousandths = divmod(round(time * rate * 1000), 1000)
    seconds, frame = divmod(whole, rate)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}:{frame:02d}.{thousandths:03d}"


def _values(face: FaceMotion) -> Array:
    """[T, 61] the blend shapes, the head (which the body moves: zeros) and the eyes, yaw, pitch and roll of each."""
    shapes = arkit(face)
    eye = np.stack([face.gaze[:, 0], face.gaze[:, 1], np.zeros(len(face))], axis=1)
    head = np.zeros((len(face), 3))
    return np.concatenate([np.stack([shapes[name] for name in ARKIT], axis=1), head, eye, eye], axis=1)


def _face_of(scene: Scene, path: Path) -> FaceMotion:
    """The face of a scene; one at rest, with a `FaceWarning`, if none was asked for."""
    if scene.face is not None:
        return scene.face
    warnings.warn(FaceWarning(f"{path.name}: no face was asked for (--face full), so it is at rest"), stacklevel=3)
    return at_rest(len(scene.motion), scene.fps)
