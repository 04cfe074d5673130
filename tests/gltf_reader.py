"""A reader of GLB files for tests, written from the specification and not with the code that writes them."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

_DTYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def _between(times: NDArray[Any], keys: NDArray[Any], values: NDArray[Any], path: str) -> NDArray[Any]:
    """[T, width] values at times [T] between keys [K], held before the first and after the last one."""
    at = np.clip(times, keys[0], keys[-1])
    if len(keys) == len(times):
        return values
    if path == "rotation" and len(keys) > 1:
        return np.asarray(Slerp(keys.astype(np.float64), Rotation.from_quat(values))(at.astype(np.float64)).as_quat())
    return np.stack([np.interp(at, keys, column) for column in values.T.astype(np.float64)], axis=1)


@dataclass(frozen=True)
class GlbFile:
    """The document and the binary chunk of a GLB."""

    document: dict[str, Any]
    binary: bytes

    @classmethod
    def parse(cls, data: bytes) -> GlbFile:
        magic, version, size = struct.unpack_from("<4sII", data)
        assert (magic, version, size) == (b"glTF", 2, len(data))
        chunks, at = {}, 12
        while at < len(data):
            length, kind = struct.unpack_from("<II", data, at)
            assert length % 4 == 0
            chunks[kind] = data[at + 8:at + 8 + length]
            at += 8 + length
        return cls(json.loads(chunks[0x4E4F534A]), chunks.get(0x004E4942, b""))

    def numbers(self, accessor: int) -> NDArray[Any]:
        """[count, width] what an accessor holds."""
        own = self.document["accessors"][accessor]
        view = self.document["bufferViews"][own["bufferView"]]
        width = _WIDTHS[own["type"]]
        start = view.get("byteOffset", 0) + own.get("byteOffset", 0)
        return np.frombuffer(self.binary, _DTYPES[own["componentType"]], own["count"] * width, start).reshape(-1, width)

    def names(self) -> list[str]:
        return [node.get("name", "") for node in self.document["nodes"]]

    def worlds(self, animation: int | None = None) -> NDArray[np.float64]:
        """[T, N, 4, 4] world matrices of all nodes at every time that the animation has a key, or [1, N, 4, 4] at
        rest."""
        nodes = self.document["nodes"]
        tracks: dict[tuple[int, str], NDArray[Any]] = {}
        frames = 1
        if animation is not None:
            own = self.document["animations"][animation]
            keys = [self.numbers(sampler["input"])[:, 0] for sampler in own["samplers"]]
            every = np.unique(np.concatenate(keys))
            frames = len(every)
            for channel in own["channels"]:
                sampler, path = own["samplers"][channel["sampler"]], channel["target"]["path"]
                assert sampler.get("interpolation", "LINEAR") == "LINEAR"
                values = self.numbers(sampler["output"])
                if path != "weights":
                    tracks[channel["target"]["node"], path] = _between(every, keys[channel["sampler"]], values, path)
        local = np.zeros((frames, len(nodes), 4, 4))
        for index, node in enumerate(nodes):
            if "matrix" in node:
                local[:, index] = np.array(node["matrix"]).reshape(4, 4).T
                continue
            place, turn, scale = (
                np.broadcast_to(tracks.get((index, key), np.array([node.get(key, default)])), (frames, len(default)))
                for key, default in (("translation", [0, 0, 0]), ("rotation", [0, 0, 0, 1]), ("scale", [1, 1, 1])))
            local[:, index, :3, :3] = Rotation.from_quat(turn).as_matrix() * scale[:, None, :]
            local[:, index, :3, 3], local[:, index, 3, 3] = place, 1
        world = np.full_like(local, np.nan)
        waiting = [(root, np.eye(4)[None]) for scene in self.document["scenes"] for root in scene["nodes"]]
        while waiting:
            index, above = waiting.pop()
            world[:, index] = above @ local[:, index]
            waiting += [(child, world[:, index]) for child in nodes[index].get("children", ())]
        return world


def with_arrays(document: dict[str, Any], arrays: Sequence[tuple[NDArray[Any], str]]) -> tuple[dict[str, Any], bytes]:
    """The document with an accessor of each array [n, width] of a type ("VEC3"), one after the other, and their
    bytes."""
    blobs = [array.tobytes() for array, _ in arrays]
    starts = np.cumsum([0, *map(len, blobs)]).tolist()
    components = {np.dtype(name): code for code, name in _DTYPES.items()}
    return {**document, "buffers": [{"byteLength": starts[-1]}],
            "bufferViews": [{"buffer": 0, "byteOffset": start, "byteLength": len(blob)}
                            for start, blob in zip(starts, blobs, strict=False)],
            "accessors": [{"bufferView": view, "componentType": components[array.dtype], "type": kind,
                           "count": len(array)} for view, (array, kind) in enumerate(arrays)]}, b"".join(blobs)


def glb(document: dict[str, Any], binary: bytes) -> bytes:
    """A document and its binary chunk as GLB."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(binary)) + chunks + binary


def save(path: Path, document: dict[str, Any], binary: bytes) -> Path:
    """Write a document and its binary chunk as GLB. Returns `path`."""
    path.write_bytes(glb(document, binary))
    return path
