"""Writes GLB, the binary form of glTF 2.0: a JSON document and a binary buffer in one file.

Lengths are metres, Y is up, quaternions are w last (glTF 2.0, section 3.4). Unknown content of a document is preserved.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.types import Array
from gesticulator.characters.gltf_file import BINARY_CHUNK, JSON_CHUNK, MAGIC, read_gltf
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.number_file import NumberFile

VERSION = 2
_FLOAT, _UINT8, _UINT16 = 5126, 5121, 5123
_TYPES = {np.dtype("<f4"): _FLOAT, np.dtype("u1"): _UINT8, np.dtype("<u2"): _UINT16}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES = 34962
"""Target of a buffer view: vertex attributes."""
TRANSLATION, ROTATION, WEIGHTS = "translation", "rotation", "weights"
"""Animated properties of a node."""
LARGEST = (1 << 32) - 1
"""Largest size of a GLB file, bytes (4 GiB): its header has 32 bits for it."""
_PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


Numbers: TypeAlias = "NDArray[Any] | NumberFile"
"""Numbers [n, ...], in memory or on disk."""


class GltfDocument:
    """A glTF document and its binary buffer; accessors and animations can be added."""

    def __init__(self, document: dict[str, Any], binary: bytes = b"") -> None:
        self.document = document
        self._parts: list[bytes | NumberFile] = [binary]
        self._size = len(binary)

    def accessor(self, values: Numbers, target: int | None = None, bounds: bool = False) -> int:
        """Add numbers [n, ...] (float32, uint8 or uint16, little-endian); returns the accessor's index. bounds: store
        minimum and maximum, as required for times and positions."""
        if isinstance(values, NumberFile):
            entry: dict[str, Any] = {"bufferView": self.view(values, target), "componentType": _FLOAT,
                                     "count": len(values), "type": _KINDS[values.shape]}
            if bounds:
                entry["min"], entry["max"] = ([float(v) for v in edge] for edge in (values.lowest, values.highest))
            return self._added("accessors", entry)
        data = np.ascontiguousarray(values)
        # glTF's matrices are stored column by column.
        view = self.view((data.swapaxes(-1, -2) if data.shape[1:] == (4, 4) else data).tobytes(), target)
        accessor: dict[str, Any] = {"bufferView": view, "componentType": _TYPES[data.dtype], "count": len(data),
                                    "type": _KINDS[data.shape[1:]]}
        if bounds:
            accessor["min"], accessor["max"] = ([float(v) for v in np.atleast_1d(edge(data, axis=0))]
                                                for edge in (np.min, np.max))
        return self._added("accessors", accessor)

    def view(self, data: bytes | NumberFile, target: int | None = None) -> int:
        """Add bytes; returns the buffer view's index."""
        size = data.size if isinstance(data, NumberFile) else len(data)
        self._append(bytes(-self._size % 4), -self._size % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": size}
        if target is not None:
            view["target"] = target
        self._append(data, size)
        return self._added("bufferViews", view)

    def animate(self, name: str, motion: NodeMotion, nodes: dict[int, int],
                more: Iterable[tuple[int, str, Numbers]] = ()) -> None:
        """Add one animation. nodes: index in the motion -> index in the document, for moved nodes. more: further tracks
        at the same times."""
        def tracks() -> Iterable[tuple[int, str, Numbers]]:
            for source, node in nodes.items():
                if source in motion.shifts:
                    yield node, TRANSLATION, motion.shifts[source].astype("<f4")
                yield node, ROTATION, as_gltf(motion.turns[:, source])
            yield from more

        self.add_animation(name, motion.times.astype("<f4"), tracks())

    def add_animation(self, name: str, times: Numbers, tracks: Iterable[tuple[int, str, Numbers]]) -> None:
        """Add one animation. times: [T] seconds, rising; tracks: node, property (`TRANSLATION`, `ROTATION`, `WEIGHTS`),
        and values, [T, 3] or [T, 4] with w last, or for `WEIGHTS` [T * targets], frame by frame; all float32."""
        seconds = self.accessor(times, bounds=True)
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        for node, path, values in tracks:
            samplers.append({"input": seconds, "output": self.accessor(values)})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self._added("animations", {"name": name, "samplers": samplers, "channels": channels})

    def to_bytes(self) -> bytes:
        out = io.BytesIO()
        self.write(out)
        return out.getvalue()

    def write(self, out: BinaryIO) -> None:
        """Write the file. `InputError` if it exceeds the size limit of GLB."""
        self._append(bytes(-self._size % 4), -self._size % 4)
        self.document.setdefault("buffers", [{}])[0]["byteLength"] = self._size
        text = json.dumps(self.document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + self._size
        if size > LARGEST:
            raise too_large(size)
        out.write(struct.pack("<4sII", MAGIC, VERSION, size) + struct.pack("<II", len(text), JSON_CHUNK) + text)
        out.write(struct.pack("<II", self._size, BINARY_CHUNK))
        for part in self._parts:
            if isinstance(part, NumberFile):
                part.copy_to(out)
            else:
                out.write(part)

    def _append(self, data: bytes | NumberFile, size: int) -> None:
        self._parts.append(data)
        self._size += size

    def _added(self, what: str, entry: dict[str, Any]) -> int:
        entries: list[dict[str, Any]] = self.document.setdefault(what, [])
        entries.append(entry)
        return len(entries) - 1


def too_large(size: int) -> InputError:
    """The error for a GLB file of `size` bytes."""
    return InputError("the motion", f"would take {size / 1e9:.1f} GB, and a GLB file holds {LARGEST / 1e9:.1f} GB",
                      "ask for fewer frames per second (--fps), write .bvh, or cut the recording in parts")


def as_gltf(turns: Array) -> NDArray[np.float32]:
    """Convert quaternions [..., 4] from w first to glTF's w last, float32."""
    return np.asarray(turns[..., [1, 2, 3, 0]].astype("<f4"))


def transform(translation: Array, turn: Array, scale: Array) -> dict[str, Any]:
    """A node's local transform in glTF, without default values; turn: w first."""
    rows = (("translation", translation, [0, 0, 0]), ("rotation", turn[[1, 2, 3, 0]], [0, 0, 0, 1]),
            ("scale", scale, [1, 1, 1]))
    return {name: [float(v) for v in value] for name, value, default in rows if not np.array_equal(value, default)}


def open_gltf(path: Path) -> GltfDocument:
    """Read a .glb, .vrm or .gltf file with all buffers joined and all images embedded, each file once.

    `InputError` for an invalid file or a missing separate file.
    """
    file = read_gltf(path)
    gltf = GltfDocument(file.document, file.one_buffer())
    views: dict[Path, int] = {}
    for image in file.rows("images"):
        uri = image.get("uri", "")
        if uri and not uri.startswith("data:"):
            kind = _PICTURES.get(Path(uri).suffix.lower())
            if kind is None:
                raise InputError(path, f"has a picture of an unknown kind ({shown(uri)})", "use PNG or JPEG")
            place = file.beside(uri)
            if place not in views:
                views[place] = gltf.view(file.bytes_of(place))
            del image["uri"]
            image |= {"bufferView": views[place], "mimeType": kind}
    return gltf


def node_tree(motion: NodeMotion) -> list[dict[str, Any]]:
    """The nodes at rest in glTF, without default values."""
    nodes: list[dict[str, Any]] = []
    for index, name in enumerate(motion.names):
        node: dict[str, Any] = {"name": name}
        node |= transform(motion.translations[index], motion.rotations[index], motion.scales[index])
        children = [child for child, parent in enumerate(motion.parents) if parent == index]
        if children:
            node["children"] = children
        nodes.append(node)
    return nodes
