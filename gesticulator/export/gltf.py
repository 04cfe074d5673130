"""GLB, the binary form of glTF 2.0: a document in JSON and a block of numbers, in one file.

Lengths are metres, Y is up, quaternions are w last (glTF 2.0, section 3.4). The document is kept as it was read, so
that what is not known here stays untouched.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array
from gesticulator.export.nodes import NodeMotion

MAGIC = b"glTF"
VERSION = 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_FLOAT, _UINT8, _UINT16 = 5126, 5121, 5123
_TYPES = {np.dtype("<f4"): _FLOAT, np.dtype("u1"): _UINT8, np.dtype("<u2"): _UINT16}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES, INDICES = 34962, 34963
"""What a buffer view is for: the attributes of vertices, or the corners of triangles."""


class GltfDocument:
    """A glTF document and its binary buffer, to which accessors and animations can be added."""

    def __init__(self, document: dict[str, Any], binary: bytes = b"") -> None:
        self.document, self._binary = document, bytearray(binary)

    def accessor(self, values: NDArray[Any], target: int | None = None, bounds: bool = False) -> int:
        """Add numbers [n, ...] (float32, uint8 or uint16, little-endian); the accessor's index.

        bounds: tell the lowest and the highest values, as times and positions must.
        """
        data = np.ascontiguousarray(values)
        self._binary += bytes(-len(self._binary) % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": data.nbytes}
        if target is not None:
            view["target"] = target
        # glTF's matrices are stored column by column.
        self._binary += (data.swapaxes(-1, -2) if data.shape[1:] == (4, 4) else data).tobytes()
        accessor: dict[str, Any] = {"bufferView": self._added("bufferViews", view), "componentType": _TYPES[data.dtype],
                                    "count": len(data), "type": _KINDS[data.shape[1:]]}
        if bounds:
            accessor["min"], accessor["max"] = ([float(v) for v in np.atleast_1d(edge(data, axis=0))]
                                                for edge in (np.min, np.max))
        return self._added("accessors", accessor)

    def animate(self, name: str, motion: NodeMotion, nodes: dict[int, int]) -> None:
        """Add one animation. nodes: index in the motion -> index in the document, for the nodes that move."""
        times = self.accessor(motion.times.astype("<f4"), bounds=True)
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []

        def add(node: int, path: str, values: Array) -> None:
            samplers.append({"input": times, "output": self.accessor(values.astype("<f4"))})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})

        for own, node in nodes.items():
            if own in motion.shifts:
                add(node, "translation", motion.shifts[own])
            add(node, "rotation", motion.turns[:, own][:, [1, 2, 3, 0]])
        self._added("animations", {"name": name, "samplers": samplers, "channels": channels})

    def to_bytes(self) -> bytes:
        """The file."""
        binary = bytes(self._binary) + bytes(-len(self._binary) % 4)
        self.document.setdefault("buffers", [{}])[0]["byteLength"] = len(binary)
        text = json.dumps(self.document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + len(binary)
        return b"".join([struct.pack("<4sII", MAGIC, VERSION, size), struct.pack("<II", len(text), _JSON), text,
                         struct.pack("<II", len(binary), _BIN), binary])

    def _added(self, what: str, entry: dict[str, Any]) -> int:
        entries: list[dict[str, Any]] = self.document.setdefault(what, [])
        entries.append(entry)
        return len(entries) - 1


def node_tree(motion: NodeMotion) -> list[dict[str, Any]]:
    """The nodes at rest as glTF has them; what is the default (no turn, no shift, no scale) is left out."""
    nodes: list[dict[str, Any]] = []
    for index, name in enumerate(motion.names):
        node: dict[str, Any] = {"name": name}
        own = motion.translations[index], motion.rotations[index][[1, 2, 3, 0]], motion.scales[index]
        for key, value, default in zip(("translation", "rotation", "scale"), own,
                                       ([0, 0, 0], [0, 0, 0, 1], [1, 1, 1]), strict=True):
            if not np.array_equal(value, default):
                node[key] = [float(v) for v in value]
        children = [child for child, parent in enumerate(motion.parents) if parent == index]
        if children:
            node["children"] = children
        nodes.append(node)
    return nodes
