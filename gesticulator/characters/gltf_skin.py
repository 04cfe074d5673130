"""Reads a sample of the skinned triangles of a glTF file, with the weights of their corners."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.characters.gltf_file import FARTHEST, GltfFile
from gesticulator.characters.rig import Skin

MOST_TRIANGLES = 6000
"""Most triangles kept, evenly over each mesh: enough to see a tear of a hundredth of the surface."""
_MOST_VERTICES = 1 << 22
"""Largest mesh that is sampled, vertices: film characters have some hundred thousand."""
_TRIANGLES = 4
"""glTF's mode of separate triangles."""


def read_skin(file: GltfFile, place: Mapping[int, int], moves: Mapping[int, Array]) -> Skin:
    """A sample of the skinned triangles. place: node of the file -> node; moves: skin -> [J, 4, 4] from the space of
    its mesh into the world of the bind pose, by joint."""
    parts = list(_parts(file))
    sizes = [file.count(primitive["indices"] if "indices" in primitive else primitive["attributes"]["POSITION"]) // 3
             for _, primitive in parts]
    step = max(1, -(-sum(sizes) // MOST_TRIANGLES))
    points, joints, weights, triangles = [], [], [], []
    before = 0
    for (skin, primitive), size in zip(parts, sizes, strict=True):
        attributes = primitive["attributes"]
        vertices = file.count(attributes["POSITION"])
        if not size or vertices > _MOST_VERTICES or 3 * size > 4 * _MOST_VERTICES:
            continue
        corners = np.arange(3 * size) if "indices" not in primitive else np.nan_to_num(
            file.array(primitive["indices"])[:, 0]).astype(np.int64)
        chosen = corners[:3 * size].reshape(-1, 3)[::step]
        chosen = chosen[(chosen < vertices).all(axis=1)]
        used, back = np.unique(chosen, return_inverse=True)
        nodes = np.array([place[node] for node in file.rows("skins")[skin]["joints"]])
        which, shares = _influences(file, attributes, used, len(nodes))
        points.append(_placed(file.array(attributes["POSITION"])[used], moves[skin], which, shares))
        joints.append(nodes[which])
        weights.append(shares)
        triangles.append(back.reshape(-1, 3) + before)
        before += len(used)
    if not points:
        return Skin()
    return _clean(np.concatenate(points), np.concatenate(joints), np.concatenate(weights), np.concatenate(triangles))


def _placed(points: Array, moves: Array, which: NDArray[np.int64], shares: Array) -> Array:
    """[V, 3] vertices in the world of the bind pose, each moved by [J, 4, 4] of its joints [V, 4], by their shares."""
    shares = shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-9)
    with np.errstate(invalid="ignore", over="ignore"):  # those far away or not finite are left out afterwards
        if (moves == moves[:1]).all():
            return np.asarray(points @ moves[0, :3, :3].T + moves[0, :3, 3])
        move = np.einsum("vk,vkij->vij", shares, moves[which])
        return np.asarray(np.einsum("vij,vj->vi", move[:, :3, :3], points) + move[:, :3, 3])


def _parts(file: GltfFile) -> Iterator[tuple[int, dict[str, Any]]]:
    """The skin and the primitive of every part of a skinned mesh made of triangles."""
    for node in file.rows("nodes"):
        if "mesh" not in node or "skin" not in node or not file.rows("skins")[node["skin"]]["joints"]:
            continue
        for primitive in file.rows("meshes")[node["mesh"]]["primitives"]:
            if primitive.get("mode", _TRIANGLES) == _TRIANGLES and {"POSITION", "JOINTS_0", "WEIGHTS_0"} <= set(
                    primitive.get("attributes", {})):
                yield node["skin"], primitive


def _influences(file: GltfFile, attributes: Mapping[str, int], used: NDArray[np.int64], count: int
                ) -> tuple[NDArray[np.int64], Array]:
    """[V, 4] joints of a skin and their weights, of the vertices in use."""
    which, weights = (file.array(attributes[name])[used] for name in ("JOINTS_0", "WEIGHTS_0"))
    weights = np.where(np.isfinite(weights) & (weights > 0.0), weights, 0.0)
    return np.clip(np.nan_to_num(which), 0, count - 1).astype(np.int64), weights


def _clean(points: Array, joints: NDArray[np.int64], weights: Array, triangles: NDArray[np.int64]) -> Skin:
    """The skin without the triangles that have a corner at no finite place or without weight."""
    whole = weights.sum(axis=1)
    good = (np.abs(points) <= FARTHEST).all(axis=1) & (whole > 0.0)
    return Skin(np.where(good[:, None], points, 0.0), joints, weights / np.where(good, whole, 1.0)[:, None],
                triangles[good[triangles].all(axis=1)])
