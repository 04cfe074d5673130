"""Small characters for tests of what is written: a GLB with Mixamo's names, and VRMs.

All are a body of other proportions than ours, whose joints rest in axes drawn at random, with a skin, a picture on it
and data that no tool knows. VRM 0.x allows no rest rotations, and has its characters face -Z.
"""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from gltf_reader import save
from scipy.spatial.transform import Rotation

from data_module.motion.skeletons import NAME_TABLES, WHOLE_BODY
from gesticulator.export.vrma import BONES

_THUMB = ("Metacarpal", "Proximal", "Distal")

SIZE = 0.8
"""Of our own skeleton."""
LEGS = 1.15
"""Of the length that this size would give them."""


def _png() -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + bytes([200, 120, 90] * 2) for _ in range(2))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 2, 8, 2, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def offsets() -> np.ndarray:
    """[54, 3] metres in a T-pose, in our axes."""
    out = WHOLE_BODY.offsets * SIZE
    for joint, name in enumerate(WHOLE_BODY.names):
        if name.endswith(("Leg", "Foot")) and not name.endswith("UpLeg"):
            out[joint] *= LEGS
    out[0] = [0.0, 0.075 * SIZE - sum(out[WHOLE_BODY.index(f"Left{name}"), 1] for name in ("UpLeg", "Leg", "Foot")), 0]
    return out


MIXAMO = {joint: "mixamorig:" + name for joint, name in NAME_TABLES["mixamo"].items()}
VROID = NAME_TABLES["vrm"]
"""Bones as exporters of VRM name them."""
HUMANOID = {row[2]: bone for bone, row in BONES.items()}
"""Bones by the names of the VRM humanoid."""


def _auto_rig() -> dict[str, str]:
    limbs = {"Shoulder": "shoulder", "Arm": "arm_stretch", "ForeArm": "forearm_stretch", "Hand": "hand",
             "UpLeg": "thigh_stretch", "Leg": "leg_stretch", "Foot": "foot", "ToeBase": "toes_01"}
    out = {"Hips": "root.x", "Spine": "spine_01.x", "Spine1": "spine_02.x", "Spine2": "spine_03.x", "Neck": "neck.x",
           "Head": "head.x"}
    for side in ("Left", "Right"):
        out |= {side + part: f"{name}.{side[0].lower()}" for part, name in limbs.items()}
        out |= {f"{side}Hand{finger}{place}": f"{finger.lower()}{place}.{side[0].lower()}"
                for finger in ("Thumb", "Index", "Middle", "Ring", "Pinky") for place in (1, 2, 3)}
    return out


AUTO_RIG = _auto_rig()
"""The deforming bones of Auto-Rig Pro, which is not free: by their published names alone."""


def write_character(path: Path, seed: int = 0, vrm: str = "", table: dict[str, str] = MIXAMO) -> Path:
    """Write the character as GLB, or as VRM "1.0" or "0.x"; table: our joint -> name of a bone, for those it has."""
    rng = np.random.default_rng(seed)
    names, parents = WHOLE_BODY.names, WHOLE_BODY.parents
    kept = [joint for joint, name in enumerate(names) if name in table]
    above = {}
    for joint in kept:
        parent = parents[joint]
        while parent >= 0 and parent not in kept:
            parent = parents[parent]
        above[joint] = parent
    own = offsets()
    places = np.zeros((len(names), 3))
    for joint, parent in enumerate(parents):
        places[joint] = own[joint] + (places[parent] if parent >= 0 else 0)
    axes = Rotation.random(len(names), random_state=int(rng.integers(1000)))
    if vrm == "0.x":
        places, axes = places * [-1.0, 1.0, -1.0], Rotation.identity(len(names))
    # As exporters do: a node above the joints that is scaled and turned, and lengths in centimetres.
    scale, stand = (1.0, Rotation.identity()) if vrm else (0.01, Rotation.from_euler("X", -90, degrees=True))
    nodes: list[dict[str, Any]] = [{"name": "Armature", "scale": [scale] * 3, "rotation": stand.as_quat().tolist()}]
    for joint in kept:
        parent = above[joint]
        back, origin = (axes[parent].inv(), places[parent]) if parent >= 0 else (stand.inv(), np.zeros(3))
        nodes.append({"name": table[names[joint]],
                      "translation": (back.apply(places[joint] - origin) / scale).tolist(),
                      "rotation": (back * axes[joint]).as_quat().tolist()})
        nodes[kept.index(parent) + 1 if parent >= 0 else 0].setdefault("children", []).append(len(nodes) - 1)
    binary = bytearray()
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "a test", "extras": {"kept": True}},
                                "bufferViews": [], "accessors": []}

    def add(values: np.ndarray, kind: str, target: int | None = None, **more: Any) -> int:
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes,
                                        **({"target": target} if target else {})})
        binary.extend(values.tobytes() + bytes(-values.nbytes % 4))
        component = {"f": 5126, "u": 5123}[values.dtype.kind]
        document["accessors"].append({"bufferView": len(document["bufferViews"]) - 1, "componentType": component,
                                      "count": len(values), "type": kind, **more})
        return len(document["accessors"]) - 1

    corners, joints = [], []
    for joint in kept:
        size = 0.03 if "Hand" in names[joint][1:] and names[joint][-1] in "123" else 0.09
        corners.append(places[joint] + size * (np.array([[0, 1, 0], [-1, -1, 0], [1, -1, 0]])))
        joints += [kept.index(joint)] * 3
    points = np.concatenate(corners).astype("<f4")
    bind = np.tile(np.eye(4), (len(kept), 1, 1))
    for index, joint in enumerate(kept):
        bind[index, :3, :3] = axes[joint].as_matrix() * scale
        bind[index, :3, 3] = places[joint]
    inverse = np.linalg.inv(bind)
    inverse[:, 3] = [0, 0, 0, 1]
    slots, weights = np.zeros((len(points), 4), "<u2"), np.zeros((len(points), 4), "<f4")
    slots[:, 0], weights[:, 0] = joints, 1
    attributes = {
        "POSITION": add(points, "VEC3", 34962, min=points.min(0).tolist(), max=points.max(0).tolist()),
        "TEXCOORD_0": add(rng.random((len(points), 2)).astype("<f4"), "VEC2", 34962),
        "JOINTS_0": add(slots, "VEC4", 34962), "WEIGHTS_0": add(weights, "VEC4", 34962),
    }
    document["skins"] = [{"joints": list(range(1, len(kept) + 1)), "inverseBindMatrices": add(
        inverse.swapaxes(1, 2).reshape(-1, 16).astype("<f4"), "MAT4")}]
    picture = _png()
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(picture)})
    binary.extend(picture + bytes(-len(picture) % 4))
    document |= {
        "images": [{"bufferView": len(document["bufferViews"]) - 1, "mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [{"name": "skin", "doubleSided": True, "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0}, "metallicFactor": 0.125}}],
        "meshes": [{"name": "body", "primitives": [{"attributes": attributes, "material": 0}]}],
        "nodes": [*nodes, {"name": "Body", "mesh": 0, "skin": 0}],
        "scene": 0, "scenes": [{"nodes": [0, len(nodes)]}],
        "buffers": [{"byteLength": len(binary)}],
    }
    mapped = {bone: {"node": kept.index(WHOLE_BODY.index(row[2])) + 1} for bone, row in BONES.items()
              if WHOLE_BODY.index(row[2]) in kept}
    if vrm == "1.0":
        document["extensionsUsed"] = ["VRMC_vrm"]
        document["extensions"] = {"VRMC_vrm": {
            "specVersion": "1.0", "humanoid": {"humanBones": mapped},
            "meta": {"name": "small", "authors": ["a test"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}}}
    elif vrm == "0.x":
        thumbs = dict(zip(_THUMB, ("Proximal", "Intermediate", "Distal"), strict=True))  # as that version calls them
        bones = [{"bone": bone[:-len(bone.split("Thumb")[-1])] + thumbs[bone.split("Thumb")[-1]]
                  if "Thumb" in bone else bone, **node, "useDefaultValues": True} for bone, node in mapped.items()]
        document["extensionsUsed"] = ["VRM"]
        document["extensions"] = {"VRM": {
            "exporterVersion": "a test", "specVersion": "0.0", "meta": {"title": "small", "author": "a test"},
            "humanoid": {"humanBones": bones}, "firstPerson": {}, "blendShapeMaster": {"blendShapeGroups": []},
            "secondaryAnimation": {"boneGroups": [], "colliderGroups": []}, "materialProperties": []}}
    return save(path, document, bytes(binary))
