"""Writes GLB, the binary form of glTF 2.0: a JSON document and a binary buffer in one file.

Lengths are metres, Y is up, quaternions are w last (glTF 2.0, section 3.4). Unknown content of a document is preserved.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.types import Array
from gesticulator.characters.gltf_file import BINARY_CHUNK, JSON_CHUNK, MAGIC, read_gltf
from gesticulator.characters.rig import Character
from gesticulator.export.clip import ClipLayout
from gesticulator.export.key_reduction import STEADY_SHARE, kept_frames, kept_places, rotation_errors
from gesticulator.export.nodes import NodeMotion

VERSION = 2
_TYPES = {np.dtype("<f4"): 5126, np.dtype("u1"): 5121, np.dtype("<u2"): 5123}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES = 34962
"""Target of a buffer view with vertex attributes."""
TRANSLATION, ROTATION, WEIGHTS = "translation", "rotation", "weights"
"""Animated properties of a node."""
_PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


Track: TypeAlias = "tuple[int, str, NDArray[Any], NDArray[Any]]"
"""Node, property, times and values of an animated property."""
FrameTrack: TypeAlias = "tuple[int, str, NDArray[Any]]"
"""Node, property and its values at every frame."""


class GltfDocument:
    """A glTF document and its binary buffer; accessors and animations can be added."""

    def __init__(self, document: dict[str, Any], binary: bytes = b"") -> None:
        self.document = document
        self._parts: list[bytes] = [binary]
        self._size = len(binary)

    def accessor(self, values: NDArray[Any], target: int | None = None, bounds: bool = False) -> int:
        """Add numbers [n, ...] (float32, uint8 or uint16, little-endian); returns the accessor's index. bounds: store
        minimum and maximum, as required for times and positions."""
        data = np.ascontiguousarray(values)
        # glTF's matrices are stored column by column.
        view = self.view((data.swapaxes(-1, -2) if data.shape[1:] == (4, 4) else data).tobytes(), target)
        return self._accessor({"bufferView": view}, data, bounds)

    def view(self, data: bytes, target: int | None = None) -> int:
        """Add bytes; returns the buffer view's index."""
        size = len(data)
        self._append(bytes(-self._size % 4))
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": size}
        if target is not None:
            view["target"] = target
        self._append(data)
        return self._added("bufferViews", view)

    def split_matrix(self, character: Character, node: int) -> None:
        """Give a node its translation, rotation and scale, as glTF forbids a matrix on an animated one."""
        entry = self.document["nodes"][character.node_ids[node]]
        if entry.pop("matrix", None) is not None:
            entry |= transform(character.translations[node], character.rotations[node], character.scales[node])

    def animate(self, clip: ClipLayout, motion: NodeMotion, nodes: Mapping[int, int],
                steady: frozenset[int] = frozenset(), more: Sequence[FrameTrack] = ()) -> None:
        """Add one animation, with keys reduced within `clip.keys`. nodes: index in the motion -> index in the document,
        for moved nodes; steady: nodes of the motion whose errors are held tighter (hips and legs). more:
        further tracks with a value at every frame (node, property, values)."""
        tracks: list[Track] = []
        rows, times = list(nodes), motion.times.astype("<f4")
        # Errors of hips and legs add up at the feet, so they are held tighter.
        bounds = np.radians([clip.keys * (STEADY_SHARE if node in steady else 1.0) for node in rows])
        turned = kept_frames(motion.turns[:, rows], bounds, rotation_errors) if clip.keys else None
        for column, (source, node) in enumerate(nodes.items()):
            if source in motion.shifts:
                places = motion.shifts[source]
                moved = None if turned is None else kept_places(places, clip.keys)
                tracks.append((node, TRANSLATION, _at(moved, times), _at(moved, places).astype("<f4")))
            key_frames = None if turned is None else turned[:, column]
            tracks.append((node, ROTATION, _at(key_frames, times), as_gltf(_at(key_frames, motion.turns[:, source]))))
        self._add_animation(clip.name, tracks + [(node, path, times, values) for node, path, values in more])

    def _add_animation(self, name: str, tracks: Sequence[Track]) -> None:
        """Add one animation. tracks: node, property (`TRANSLATION`, `ROTATION`, `WEIGHTS`), times [T] in seconds,
        rising, and values, [T, 3], [T, 4] with w last, or [T * targets] weights; all float32. Tracks may share one
        object of times."""
        # The order of first use: times before the values that need them.
        numbers: dict[int, tuple[NDArray[Any], bool]] = {}
        for _, _, times, values in tracks:
            # By identity: tracks that share an array of times share its accessor.
            numbers.setdefault(id(times), (times, True))
            numbers[id(values)] = values, False
        accessors = dict(zip(numbers, self._packed(list(numbers.values())), strict=True))
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        for node, path, times, values in tracks:
            samplers.append({"input": accessors[id(times)], "output": accessors[id(values)]})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self._added("animations", {"name": name, "samplers": samplers, "channels": channels})

    def _packed(self, parts: Sequence[tuple[NDArray[Any], bool]]) -> list[int]:
        """Accessors of numbers (float32) that share one view; each with whether its bounds are stored."""
        self._append(bytes(-self._size % 4))
        start, accessors = self._size, []
        view: dict[str, Any] = {"buffer": 0, "byteOffset": start, "byteLength": 0}
        index = self._added("bufferViews", view)
        for numbers, bounds in parts:
            data = np.ascontiguousarray(numbers)
            accessors.append(self._accessor({"bufferView": index, "byteOffset": self._size - start}, data, bounds))
            self._append(data.tobytes())
        view["byteLength"] = self._size - start
        return accessors

    def _accessor(self, place: dict[str, Any], data: NDArray[Any], bounds: bool) -> int:
        entry = {**place, "componentType": _TYPES[data.dtype], "count": len(data), "type": _KINDS[data.shape[1:]]}
        if bounds:
            entry["min"], entry["max"] = ([float(v) for v in np.atleast_1d(edge(data, axis=0))]
                                          for edge in (np.min, np.max))
        return self._added("accessors", entry)

    def to_bytes(self) -> bytes:
        """The bytes of a GLB file."""
        self._append(bytes(-self._size % 4))
        self.document.setdefault("buffers", [{}])[0]["byteLength"] = self._size
        text = json.dumps(self.document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        # Chunks of a GLB are padded to 4 bytes: JSON with spaces, binary with zeros.
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + 8 + self._size
        return b"".join([struct.pack("<4sII", MAGIC, VERSION, size), struct.pack("<II", len(text), JSON_CHUNK), text,
                         struct.pack("<II", self._size, BINARY_CHUNK), *self._parts])

    def _append(self, data: bytes) -> None:
        self._parts.append(data)
        self._size += len(data)

    def _added(self, what: str, entry: dict[str, Any]) -> int:
        entries: list[dict[str, Any]] = self.document.setdefault(what, [])
        entries.append(entry)
        return len(entries) - 1


def _at(key_frames: NDArray[np.bool_] | None, values: NDArray[Any]) -> NDArray[Any]:
    """The values at key frames; None for all, as the same object: tracks that share their times share an accessor."""
    return values if key_frames is None else values[key_frames]


def as_gltf(turns: Array) -> NDArray[np.float32]:
    """Convert quaternions [..., 4] from w first to glTF's w last, float32."""
    return np.asarray(turns[..., [1, 2, 3, 0]].astype("<f4"))


def transform(translation: Array, turn: Array, scale: Array) -> dict[str, Any]:
    """A node's local transform in glTF, without default values; turn: w first."""
    rows = (("translation", translation, [0, 0, 0]), ("rotation", turn[[1, 2, 3, 0]], [0, 0, 0, 1]),
            ("scale", scale, [1, 1, 1]))
    return {name: [float(v) for v in value] for name, value, default in rows if not np.array_equal(value, default)}


def open_gltf(path: Path) -> GltfDocument:
    """Read a .glb, .vrm, .gltf or .fbx file with all buffers joined and all images embedded, each file once.

    `InputError` for an invalid file or a missing separate file.
    """
    # One buffer, as a GLB has: new data is appended behind it, and no offset of the file changes.
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
        node |= transform(motion.translations[index], motion.rotations[index], np.ones(3))
        children = [child for child, parent in enumerate(motion.parents) if parent == index]
        if children:
            node["children"] = children
        nodes.append(node)
    return nodes
