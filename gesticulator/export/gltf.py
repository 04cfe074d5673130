"""GLB, the binary form of glTF 2.0: a document in JSON and a block of numbers, in one file.

Lengths are metres, Y is up, quaternions are w last (glTF 2.0, section 3.4). The document is kept as it was read, so
that what is not known here stays untouched.
"""

from __future__ import annotations

import base64
import binascii
import io
import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.types import Array
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.number_file import NumberFile

MAGIC = b"glTF"
VERSION = 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_FLOAT, _UINT8, _UINT16 = 5126, 5121, 5123
_TYPES = {np.dtype("<f4"): _FLOAT, np.dtype("u1"): _UINT8, np.dtype("<u2"): _UINT16}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES = 34962
"""What a buffer view is for: the attributes of vertices."""
TRANSLATION, ROTATION = "translation", "rotation"
"""What of a node an animation moves."""
LARGEST = (1 << 32) - 1
"""Bytes of a GLB file: its header tells how many in 32 bits (4 GiB)."""
_PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


Numbers: TypeAlias = "NDArray[Any] | NumberFile"
"""Numbers [n, ...], in memory or on the disk."""


class GltfDocument:
    """A glTF document and its binary buffer, to which accessors and animations can be added."""

    def __init__(self, document: dict[str, Any], binary: bytes = b"") -> None:
        self.document = document
        self._parts: list[bytes | NumberFile] = [binary]
        self._size = len(binary)

    def accessor(self, values: Numbers, target: int | None = None, bounds: bool = False) -> int:
        """Add numbers [n, ...] (float32, uint8 or uint16, little-endian); the accessor's index.

        bounds: tell the lowest and the highest values, as times and positions must.
        """
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
        """Add bytes; the buffer view's index."""
        size = data.size if isinstance(data, NumberFile) else len(data)
        self._append(bytes(-self._size % 4), -self._size % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": size}
        if target is not None:
            view["target"] = target
        self._append(data, size)
        return self._added("bufferViews", view)

    def animate(self, name: str, motion: NodeMotion, nodes: dict[int, int]) -> None:
        """Add one animation. nodes: index in the motion -> index in the document, for the nodes that move."""
        def tracks() -> Iterable[tuple[int, str, Numbers]]:
            for own, node in nodes.items():
                if own in motion.shifts:
                    yield node, TRANSLATION, motion.shifts[own].astype("<f4")
                yield node, ROTATION, as_gltf(motion.turns[:, own])

        self.add_animation(name, motion.times.astype("<f4"), tracks())

    def add_animation(self, name: str, times: Numbers, tracks: Iterable[tuple[int, str, Numbers]]) -> None:
        """Add one animation. times: [T] seconds, rising; tracks: node, what of it moves (`TRANSLATION`, `ROTATION`),
        and its values, [T, 3] or [T, 4] with w last; all float32."""
        seconds = self.accessor(times, bounds=True)
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        for node, path, values in tracks:
            samplers.append({"input": seconds, "output": self.accessor(values)})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self._added("animations", {"name": name, "samplers": samplers, "channels": channels})

    def to_bytes(self) -> bytes:
        """The file."""
        out = io.BytesIO()
        self.write(out)
        return out.getvalue()

    def write(self, out: BinaryIO) -> None:
        """Write the file. `InputError` where it is larger than a GLB can be."""
        self._append(bytes(-self._size % 4), -self._size % 4)
        self.document.setdefault("buffers", [{}])[0]["byteLength"] = self._size
        text = json.dumps(self.document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + self._size
        if size > LARGEST:
            raise too_large(size)
        out.write(struct.pack("<4sII", MAGIC, VERSION, size) + struct.pack("<II", len(text), _JSON) + text)
        out.write(struct.pack("<II", self._size, _BIN))
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
    """What to say of a GLB file of so many bytes, more than it can have."""
    return InputError("the motion", f"would take {size / 1e9:.1f} GB, and a GLB file holds {LARGEST / 1e9:.1f} GB",
                      "ask for fewer frames per second (--fps), write .bvh, or cut the recording in parts")


def as_gltf(turns: Array) -> NDArray[np.float32]:
    """Quaternions [..., 4], w first, as glTF has them: w last, float32."""
    moved: NDArray[np.float32] = turns[..., [1, 2, 3, 0]].astype("<f4")
    return moved


def transform(translation: Array, turn: Array, scale: Array) -> dict[str, Any]:
    """A node's local transform as glTF tells it; turn: w first. What is the default is left out."""
    rows = (("translation", translation, [0, 0, 0]), ("rotation", turn[[1, 2, 3, 0]], [0, 0, 0, 1]),
            ("scale", scale, [1, 1, 1]))
    return {name: [float(v) for v in value] for name, value, default in rows if not np.array_equal(value, default)}


def open_gltf(path: Path) -> GltfDocument:
    """A .glb, .vrm or .gltf file, with all its buffers in one and all its pictures inside.

    `InputError` where it is none, or lacks a file beside it.
    """
    document, binary = read_parts(path)
    if any("uri" in buffer for buffer in document.get("buffers", ())):
        binary = _one_buffer(path, document, binary or b"")
    gltf = GltfDocument(document, binary or b"")
    for image in document.get("images", ()):
        uri = image.get("uri", "")
        if uri and not uri.startswith("data:"):
            kind = _PICTURES.get(Path(uri).suffix.lower())
            if kind is None:
                raise InputError(path, f"has a picture of an unknown kind ({shown(uri)})", "use PNG or JPEG")
            del image["uri"]
            image |= {"bufferView": gltf.view(bytes_beside(path, uri)), "mimeType": kind}
    return gltf


def _one_buffer(path: Path, document: dict[str, Any], binary: bytes) -> bytes:
    """All buffers one after the other, and the views told where they now lie."""
    joined, starts = bytearray(), []
    for buffer in document["buffers"]:
        joined += bytes(-len(joined) % 4)
        starts.append(len(joined))
        joined += bytes_beside(path, buffer["uri"]) if "uri" in buffer else binary
    for view in document.get("bufferViews", ()):
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
        view["buffer"] = 0
    document["buffers"] = [{}]
    return bytes(joined)


def bytes_beside(path: Path, uri: str) -> bytes:
    """What a URI of a glTF file names: data within it, or a file beside it and nothing else on the disk."""
    try:
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2], validate=True)
        beside = (path.parent / unquote(uri)).resolve()
        if not beside.is_relative_to(path.parent.resolve()):
            raise InputError(path, f"names a file elsewhere ({shown(uri)})", "keep it beside, or export as GLB")
        return beside.read_bytes()
    except (OSError, binascii.Error):
        raise InputError(path, f"lacks {shown(uri)}", "keep it beside, or export as GLB") from None


def read_parts(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a glTF file, and the binary chunk of a GLB. `InputError` where it is none."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})", "check the path") from None
    binary = None
    try:
        if data[:4] == MAGIC:
            chunks: dict[int, bytes] = {}
            at = 12
            while at + 8 <= len(data):
                size, kind = struct.unpack_from("<II", data, at)
                chunks.setdefault(kind, data[at + 8:at + 8 + size])
                at += 8 + size
            data, binary = chunks.get(_JSON, b""), chunks.get(_BIN)
        document = json.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        document = None
    if not isinstance(document, dict) or not document.get("nodes"):
        raise InputError(path, "is no glTF file with nodes", "give a .glb, .vrm or .gltf file")
    return document, binary


def node_tree(motion: NodeMotion) -> list[dict[str, Any]]:
    """The nodes at rest as glTF has them; what is the default (no turn, no shift, no scale) is left out."""
    nodes: list[dict[str, Any]] = []
    for index, name in enumerate(motion.names):
        node: dict[str, Any] = {"name": name}
        node |= transform(motion.translations[index], motion.rotations[index], motion.scales[index])
        children = [child for child, parent in enumerate(motion.parents) if parent == index]
        if children:
            node["children"] = children
        nodes.append(node)
    return nodes
