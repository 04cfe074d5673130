"""Characters in glTF 2.0: GLB, VRM 0.x and 1.0, and .gltf with its buffers beside it or inside.

Only what a rig needs is read: nodes, skins, inverse bind matrices, the VRM table, and where the skin lies. The numbers
of glTF are in metres, Y up; a VRM 0.x character faces -Z, others +Z.
"""

from __future__ import annotations

import base64
import binascii
import json
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_module.errors import InputError, shown
from data_module.types import Array
from gesticulator.characters.bvh_rig import turns_of
from gesticulator.characters.rig import Character

LARGEST = 1 << 31
"""Bytes (2 GiB) of a file that is read: characters of films have some hundreds of MB of textures."""
MOST_POINTS = 20_000
"""Points of the skin that are kept, evenly thinned: a trunk's width needs no more."""
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_AGAIN = "export it again as GLB"


def read_gltf_character(path: str | os.PathLike[str]) -> Character:
    """The rig of a .glb, .vrm or .gltf file. `InputError` where it is none, or has no skin."""
    document, binary = _parts(Path(path))
    try:
        return _character(_Document(Path(path), document, binary))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error) as error:
        # A file that breaks the format's own rules may do so anywhere.
        raise InputError(path, f"is a broken glTF file ({type(error).__name__}: {shown(str(error), 100)})",
                         _AGAIN) from None


def _parts(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of the file, and the binary chunk of a GLB."""
    try:
        if not path.is_file():
            raise InputError(path, "does not exist" if not path.exists() else "is no regular file", "check the path")
        if path.stat().st_size > LARGEST:
            raise InputError(path, f"is larger than {LARGEST >> 30} GiB", "leave out its textures")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})",
                         "check the path and its rights") from None
    binary = None
    if data[:4] == b"glTF":
        chunks: dict[int, bytes] = {}
        if len(data) < 12 or struct.unpack_from("<I", data, 4)[0] != 2:
            raise InputError(path, "is no GLB of version 2", _AGAIN)
        at = 12
        while at + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, at)
            if at + 8 + size > len(data):
                raise InputError(path, "is cut off", "copy or export it again")
            chunks.setdefault(kind, data[at + 8:at + 8 + size])
            at += 8 + size
        data, binary = chunks.get(_JSON, b""), chunks.get(_BINARY)
    try:
        document = json.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        raise InputError(path, "is no glTF file", "give a .glb, .vrm or .gltf file") from None
    if not isinstance(document, dict) or not isinstance(document.get("nodes"), list) or not document["nodes"]:
        raise InputError(path, "is a glTF file without nodes", "export the armature, too")
    return document, binary


class _Document:
    """A glTF document whose accessors can be read as arrays."""

    def __init__(self, path: Path, document: dict[str, Any], binary: bytes | None) -> None:
        self.path, self.json, self._binary = path, document, binary
        self._buffers: dict[int, bytes] = {}

    def all(self, name: str) -> list[Any]:
        """The entries of a top-level list; empty where the file has none."""
        found = self.json.get(name)
        return found if isinstance(found, list) else []

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self.json["buffers"][index].get("uri")
            if uri is None:
                if self._binary is None:
                    raise InputError(self.path, "lacks its binary part", _AGAIN)
                self._buffers[index] = self._binary
            elif uri.startswith("data:"):
                try:
                    self._buffers[index] = base64.b64decode(uri.partition(",")[2], validate=True)
                except binascii.Error:
                    raise InputError(self.path, "has a buffer that is not base64", _AGAIN) from None
            else:
                beside = (self.path.parent / unquote(uri)).resolve()
                # A document names files beside it, and nothing else on the disk.
                if not beside.is_relative_to(self.path.parent.resolve()) or not beside.is_file():
                    raise InputError(self.path, f"lacks its buffer {shown(uri)}", f"keep it beside, or {_AGAIN}")
                self._buffers[index] = beside.read_bytes()
        return self._buffers[index]

    def array(self, index: int) -> NDArray[Any]:
        """[count, width] the values of an accessor; integers that are normalised become shares of 1."""
        told = self.json["accessors"][index]
        kind, width, count = np.dtype(_TYPES[told["componentType"]]), _WIDTHS[told["type"]], int(told["count"])
        if "sparse" in told or "bufferView" not in told:
            return np.zeros((count, width))
        view = self.json["bufferViews"][told["bufferView"]]
        data = self._buffer(view["buffer"])
        start = int(view.get("byteOffset", 0)) + int(told.get("byteOffset", 0))
        step = int(view.get("byteStride", 0)) or kind.itemsize * width
        if count < 1 or start < 0 or start + step * (count - 1) + kind.itemsize * width > len(data):
            raise InputError(self.path, f"has an accessor ({index}) beyond its buffer", _AGAIN)
        values = np.ndarray((count, width), kind, data, start, (step, kind.itemsize)).astype(np.float64)
        if told.get("normalized") and kind.kind in "iu":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values


def _character(document: _Document) -> Character:
    nodes = document.all("nodes")
    parent_of = {child: node for node, told in enumerate(nodes) for child in told.get("children", [])}
    order = _parents_first(document, len(nodes), parent_of)
    place = {node: index for index, node in enumerate(order)}
    translations, rotations, scales = (np.array(column) for column in zip(
        *(_transform(nodes[node]) for node in order), strict=True))
    if not all(np.isfinite(column).all() for column in (translations, rotations, scales)):
        raise InputError(document.path, "has nodes whose places are no numbers", _AGAIN)
    skinned = np.zeros(len(order), dtype=bool)
    for skin in document.all("skins"):
        skinned[[place[node] for node in skin["joints"]]] = True
    version, humanoid = _vrm(document, place)
    if not skinned.any():
        if not humanoid:
            raise InputError(document.path, "has no skin, and so no joints", "export the armature, too")
        skinned[list(humanoid.values())] = True
    character = Character(
        tuple(str(nodes[node].get("name", "")) for node in order),
        tuple(place[parent_of[node]] if node in parent_of else -1 for node in order),
        translations, rotations, scales, document.path, "glb", skinned, humanoid=humanoid, vrm=version, unit=1.0,
        node_ids=tuple(order))
    inverse = _inverse_bind(document, place)
    if not inverse:
        return character
    bind, to_world = _bind(character, inverse)
    flesh, flesh_nodes = _flesh(document, place, to_world)
    return Character(**{**vars(character), "bind": bind, "flesh": flesh, "flesh_nodes": flesh_nodes})


def _parents_first(document: _Document, count: int, parent_of: Mapping[int, int]) -> list[int]:
    """The nodes, each after its parent, else in the order of the file."""
    children: dict[int, list[int]] = {}
    for child, parent in sorted(parent_of.items()):
        if not 0 <= child < count:
            raise InputError(document.path, "names a child that is not there", _AGAIN)
        children.setdefault(parent, []).append(child)
    order: list[int] = []
    todo = [node for node in reversed(range(count)) if node not in parent_of]
    while todo:
        node = todo.pop()
        order.append(node)
        todo += reversed(children.get(node, []))
    if len(order) != count:
        raise InputError(document.path, "has nodes that are their own ancestors", _AGAIN)
    return order


def _transform(told: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Translation, rotation (w first) and scale of a node."""
    if "matrix" in told:
        matrix = np.array(told["matrix"], dtype=np.float64).reshape(4, 4).T
        turn = Rotation.from_matrix(turns_of(matrix)).as_quat(scalar_first=True)
        return matrix[:3, 3], turn, np.linalg.norm(matrix[:3, :3], axis=0)
    x, y, z, w = map(float, told.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    turn = np.array([w, x, y, z])
    length = float(np.linalg.norm(turn))
    turn = turn / length if length > 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
    place = np.array(told.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64).reshape(3)
    return place, turn, np.array(told.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64).reshape(3)


def _vrm(document: _Document, place: Mapping[int, int]) -> tuple[str, dict[str, int]]:
    """Version and humanoid table (bone -> node) of the VRM extension; "" and none where there is none."""
    extensions = document.json.get("extensions") or {}
    if "VRMC_vrm" in extensions:
        bones = extensions["VRMC_vrm"]["humanoid"]["humanBones"]
        return "1.0", {bone: place[told["node"]] for bone, told in bones.items() if told.get("node") in place}
    if "VRM" in extensions:
        bones = extensions["VRM"]["humanoid"]["humanBones"]
        return "0.x", {told["bone"]: place[told["node"]] for told in bones if told.get("node") in place}
    return "", {}


def _inverse_bind(document: _Document, place: Mapping[int, int]) -> dict[int, Array]:
    """Node -> [4, 4] inverse bind matrix, of the skin with the most joints; others are brought to it by the joints
    that both have, and left out where they have none."""
    skins = sorted((skin for skin in document.all("skins") if "inverseBindMatrices" in skin),
                   key=lambda skin: -len(skin["joints"]))
    out: dict[int, Array] = {}
    for skin in skins:
        matrices = document.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        if not np.isfinite(matrices).all():
            raise InputError(document.path, "has inverse bind matrices that are no numbers", _AGAIN)
        own = {place[node]: matrix for node, matrix in zip(skin["joints"], matrices, strict=False)
               if abs(np.linalg.det(matrix)) > 1e-15}
        shared = next((node for node in own if node in out), None)
        if out and shared is None:
            continue
        # Both tell where the joint is; what differs is the space of the two meshes.
        change = np.eye(4) if shared is None else np.linalg.inv(own[shared]) @ out[shared]
        out |= {node: matrix @ change for node, matrix in own.items() if node not in out}
    return out


def _bind(character: Character, inverse: Mapping[int, Array]) -> tuple[Array, Array]:
    """[N, 4, 4] the world matrices of the bind pose, and [4, 4] from the mesh's space to the world.

    The inverse bind matrices tell each joint's place in the space of the mesh; that space is laid into the world where
    most joints then stand as they do at rest (all of them, when the file is at rest in its bind pose).
    """
    rest = character.world_matrices()
    joints = list(inverse)
    there = np.array([np.linalg.inv(inverse[node]) for node in joints])
    candidates = np.array([rest[node] @ inverse[node] for node in joints])
    size = max(float(np.ptp(rest[joints, :3, 3], axis=0).max()), 1e-9)
    step = max(1, len(joints) // 40)
    gaps = [float(np.median(np.linalg.norm((candidate @ there)[:, :3, 3] - rest[joints, :3, 3], axis=-1)))
            for candidate in candidates[::step]]
    # The first of equals, which is nearest to the root of the skin.
    best = next(place for place, gap in enumerate(gaps) if gap <= min(gaps) + 1e-4 * size)
    to_world = candidates[::step][best]
    bind = rest.copy()
    local = character.local_matrices()
    for node, parent in enumerate(character.parents):
        if node in inverse:
            bind[node] = to_world @ np.linalg.inv(inverse[node])
        elif parent >= 0:
            bind[node] = bind[parent] @ local[node]
    return bind, to_world


def _flesh(document: _Document, place: Mapping[int, int], to_world: Array) -> tuple[Array, NDArray[np.int64]]:
    """Points of the skinned meshes in the world of the bind pose, and the node that moves each most."""
    points: list[Array] = []
    movers: list[NDArray[np.int64]] = []
    for told in document.all("nodes"):
        if "mesh" not in told or "skin" not in told:
            continue
        joints = np.array([place[node] for node in document.json["skins"][told["skin"]]["joints"]])
        for primitive in document.json["meshes"][told["mesh"]]["primitives"]:
            has = primitive.get("attributes", {})
            if not {"POSITION", "JOINTS_0", "WEIGHTS_0"} <= set(has):
                continue
            where, which, weights = (document.array(has[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
            most = np.take_along_axis(which, weights.argmax(axis=1)[:, None], axis=1)[:, 0].astype(int)
            points.append(where)
            movers.append(joints[np.minimum(most, len(joints) - 1)])
    if not points:
        return np.zeros((0, 3)), np.zeros(0, np.int64)
    all_points, all_movers = np.concatenate(points), np.concatenate(movers)
    step = -(-len(all_points) // MOST_POINTS)
    kept, movers_kept = all_points[::step], all_movers[::step]
    good = np.isfinite(kept).all(axis=1)
    return kept[good] @ to_world[:3, :3].T + to_world[:3, 3], movers_kept[good]
