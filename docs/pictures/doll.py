"""A character of our own for the pictures of the tool pages: a doll of capsules, skinned, as GLB and as VRM 1.0."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data_module.files import write_bytes
from data_module.motion.skeletons import FINGERS, HIP_HEIGHT, WHOLE_BODY
from data_module.types import Array
from gesticulator.export.gltf import VERTICES, GltfDocument
from gesticulator.export.vrma import BONES

TRIANGLES = 34963
"""What a buffer view of glTF is for: the corners of triangles."""
COLOURS = {"shirt": (0.05, 0.19, 0.23), "trousers": (0.07, 0.08, 0.11), "skin": (0.72, 0.48, 0.32),
           "hair": (0.1, 0.07, 0.045), "shoes": (0.02, 0.022, 0.03)}
"""Linear red, green and blue."""
_AROUND, _ROUND = 16, 6
"""Corners around a capsule, and rings of each of its ends."""


class Capsule(NamedTuple):
    """Two balls and what is between them: places [3] and radii in metres; depth: how deep as a share of its width."""

    joint: str
    colour: str
    start: Array
    end: Array
    r0: float
    r1: float
    depth: float = 1.0


def places() -> dict[str, Array]:
    """Joint, or "HeadTip" -> [3] metres in a T-pose, feet on the floor."""
    out: dict[str, Array] = {}
    for joint, name in enumerate(WHOLE_BODY.names):
        parent = WHOLE_BODY.parents[joint]
        above = out[WHOLE_BODY.names[parent]] if parent >= 0 else np.array([0.0, HIP_HEIGHT, 0.0])
        out[name] = above + (WHOLE_BODY.offsets[joint] if parent >= 0 else 0.0)
    for joint, tip in WHOLE_BODY.end_sites.items():
        out[WHOLE_BODY.names[joint] + "Tip"] = out[WHOLE_BODY.names[joint]] + tip
    return out


def capsules() -> list[Capsule]:
    """The whole doll."""
    at = places()
    trunk = ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck")
    wide = (0.145, 0.135, 0.13, 0.145, 0.155, 0.075)
    out = [Capsule(above, "trousers" if above == "Hips" else "shirt", at[above], at[below], wide[k], wide[k + 1], 0.68)
           for k, (above, below) in enumerate(zip(trunk, trunk[1:], strict=False))]
    out.append(Capsule("Neck", "skin", at["Neck"], at["Head"], 0.052, 0.05))
    up = at["HeadTip"] - at["Head"]
    middle = at["Head"] + 0.5 * up
    for colour, start, end, r0, r1 in (
            ("hair", (0, 0.02, -0.015), (0, 0.02, -0.015), 0.108, 0.108),
            ("skin", (0, -0.05, 0.02), (0, 0.0, 0.024), 0.082, 0.095),
            ("skin", (0, -0.03, 0.115), (0, -0.012, 0.105), 0.016, 0.012)):  # a nose
        out.append(Capsule("Head", colour, middle + np.array(start), middle + np.array(end), r0, r1))
    for side in ("Left", "Right"):
        def bone(name: str, below: str, colour: str, r0: float, r1: float, side: str = side) -> Capsule:
            return Capsule(side + name, colour, at[side + name], at[side + below], r0, r1)

        out += [Capsule(side + "Shoulder", "shirt", at[side + "Shoulder"], at[side + "Arm"], 0.056, 0.06),
                bone("Arm", "ForeArm", "shirt", 0.06, 0.047), bone("ForeArm", "Hand", "skin", 0.042, 0.029),
                bone("UpLeg", "Leg", "trousers", 0.085, 0.06), bone("Leg", "Foot", "trousers", 0.058, 0.045),
                bone("Foot", "ToeBase", "shoes", 0.046, 0.036), bone("ToeBase", "ToeBaseTip", "shoes", 0.036, 0.026)]
        for finger in FINGERS:
            chain = [f"Hand{finger}{place}" for place in (1, 2, 3)] + [f"Hand{finger}3Tip"]
            if finger != "Thumb":
                out.append(bone("Hand", chain[0], "skin", 0.022, 0.013))
            out += [bone(a, b, "skin", 0.0115, 0.0095) for a, b in zip(chain, chain[1:], strict=False)]
    return out


def _mesh(one: Capsule) -> tuple[Array, Array, Array]:
    """Corners and normals [V, 3], and the corners of its triangles [F, 3]."""
    way = one.end - one.start
    length = float(np.linalg.norm(way))
    along = way / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(along, across), along])
    half = np.linspace(0.0, np.pi / 2, _ROUND)
    lean = np.concatenate([half - np.pi / 2, half])
    angle = np.arange(_AROUND) * 2 * np.pi / _AROUND
    normals = np.stack(np.broadcast_arrays(np.cos(lean)[:, None] * np.cos(angle), np.cos(lean)[:, None] * np.sin(angle),
                                           np.sin(lean)[:, None]), axis=-1)
    radius = np.repeat([one.r0, one.r1], _ROUND)[:, None, None]
    corners = normals * radius + np.repeat([[0, 0, 0.0], [0, 0, length]], _ROUND, axis=0)[:, None]
    points, out = ((part @ frame).reshape(-1, 3) for part in (corners, normals))
    points = points * [1, 1, one.depth] + one.start
    out = out / [1, 1, one.depth]
    ring, step = np.meshgrid(np.arange(2 * _ROUND - 1), np.arange(_AROUND), indexing="ij")
    a, b = ring * _AROUND + step, ring * _AROUND + (step + 1) % _AROUND
    faces = np.stack([a, b, a + _AROUND, b, b + _AROUND, a + _AROUND], axis=-1).reshape(-1, 3)
    return points, out / np.linalg.norm(out, axis=1, keepdims=True), faces


def write_doll(path: Path, vrm: bool = False) -> Path:
    """Write the doll as GLB, or as VRM 1.0. Returns `path`."""
    names, at = WHOLE_BODY.names, places()
    nodes: list[dict[str, Any]] = []
    for joint, name in enumerate(names):
        parent = WHOLE_BODY.parents[joint]
        origin = at[names[parent]] if parent >= 0 else np.zeros(3)
        children = [child for child, above in enumerate(WHOLE_BODY.parents) if above == joint]
        nodes.append({"name": name, "translation": (at[name] - origin).tolist(),
                      **({"children": children} if children else {})})
    gltf = GltfDocument({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, len(nodes)]}],
                         "nodes": [*nodes, {"name": "doll", "mesh": 0, "skin": 0}]})
    document = gltf.document
    inverse = np.tile(np.eye(4), (len(names), 1, 1))
    inverse[:, :3, 3] = -np.stack([at[name] for name in names])
    document["skins"] = [{"joints": list(range(len(names))),
                          "inverseBindMatrices": gltf.accessor(inverse.astype("<f4"))}]
    primitives = []
    for number, colour in enumerate(COLOURS):
        own = [one for one in capsules() if one.colour == colour]
        meshes = [_mesh(one) for one in own]
        starts = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
        joints, weights = np.zeros((starts[-1], 4), "<u2"), np.zeros((starts[-1], 4), "<f4")
        joints[:, 0] = np.repeat([names.index(one.joint) for one in own], [len(mesh[0]) for mesh in meshes])
        weights[:, 0] = 1.0
        faces = np.concatenate([mesh[2] + start for mesh, start in zip(meshes, starts, strict=False)])
        points, normals = (np.concatenate([mesh[part] for mesh in meshes]).astype("<f4") for part in (0, 1))
        primitives.append({"material": number, "indices": gltf.accessor(faces.ravel().astype("<u2"), TRIANGLES),
                           "attributes": {
            "POSITION": gltf.accessor(points, VERTICES, bounds=True), "NORMAL": gltf.accessor(normals, VERTICES),
            "JOINTS_0": gltf.accessor(joints, VERTICES), "WEIGHTS_0": gltf.accessor(weights, VERTICES)}})
    document["meshes"] = [{"name": "doll", "primitives": primitives}]
    document["materials"] = [{"name": name, "pbrMetallicRoughness": {
        "baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.7}}
        for name, colour in COLOURS.items()]
    if vrm:
        bones = {bone: {"node": names.index(row[2])} for bone, row in BONES.items()}
        document["extensionsUsed"] = ["VRMC_vrm"]
        document["extensions"] = {"VRMC_vrm": {
            "specVersion": "1.0", "humanoid": {"humanBones": bones},
            "meta": {"name": "doll", "authors": ["gesticulator"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}}}
    write_bytes(path, gltf.to_bytes())
    return path
