"""The reader of glTF 2.0: GLB, VRM, .gltf with buffers and images embedded or in separate files, and of FBX through
Blender.

Everything that later code relies on is checked when a file is opened, before memory is allocated: lists are lists of
objects, every index is valid, every accessor lies in its view, every view in its buffer. Unknown content is preserved.
"""

from __future__ import annotations

import base64
import math
import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.files import parse_json, read_bytes
from gesticulator.characters.blender import glb_of
from gesticulator.characters.gltf_compression import (
    compressed_view,
    draco_attributes,
    is_fallback,
    unpacked_mesh,
    unpacked_view,
)

LARGEST = 1 << 31
"""Largest size of a file, and of all its separate files together, bytes (2 GiB): film characters have some hundreds of
MB of textures."""
AGAIN = "export it again as GLB"
MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
_VERSION = 2
_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_UNSIGNED = (5121, 5123, 5125)
_SHAPES = {"SCALAR": (1, 1), "VEC2": (2, 1), "VEC3": (3, 1), "VEC4": (4, 1), "MAT2": (2, 2), "MAT3": (3, 3),
           "MAT4": (4, 4)}
"""Type of an accessor -> rows and columns of a value; each column of a matrix starts at a multiple of 4 bytes."""
_LISTS = {"nodes": 1 << 14, "skins": 1 << 12, "meshes": 1 << 16, "accessors": 1 << 18, "bufferViews": 1 << 18,
          "buffers": 1 << 12, "images": 1 << 14, "animations": 1 << 14, "scenes": 1 << 12}
"""The top-level lists that are read or extended, and their largest numbers of entries: film characters have some
thousand nodes and a hundred skins and images."""
_MOST_JOINTS = 1 << 18
"""Most joints of all skins together."""
_MOST_ZEROS = 1 << 25
"""Most numbers (256 MiB) of an accessor without a view, whose count takes no space in the file."""
FARTHEST = 1e9
"""Largest accepted distance from a node to its parent in metres, and largest scale."""
_KNOWN = re.compile("(KHR_materials_|KHR_texture_|EXT_texture_|MSFT_texture_|KHR_lights_|EXT_lights_|KHR_xmp|VRM).*"
                    "|KHR_mesh_quantization|KHR_node_visibility|KHR_animation_pointer|EXT_meshopt_compression"
                    "|KHR_draco_mesh_compression")
"""Supported required extensions: the two compressions are unpacked where parts are read
(`gesticulator.characters.gltf_compression`), the others affect neither nodes, skins, nor the storage of accessors."""


def read_gltf(path: str | os.PathLike[str]) -> GltfFile:
    """Read a .glb, .vrm, .gltf or .fbx file. `InputError` for another format or an invalid file."""
    place = Path(path)
    fbx = place.suffix.lower() == ".fbx"
    data = glb_of(place) if fbx else read_bytes(path, "leave out its textures", LARGEST)
    binary = None
    if data[:4] == MAGIC:
        data, binary = _chunks(place, data)
    document = parse_json(data, path, "give a .glb, .vrm or .gltf file")
    if not isinstance(document, dict) or not isinstance(document.get("nodes"), list) or not document["nodes"]:
        raise InputError(path, "is a glTF file without nodes", "export the armature, too")
    return GltfFile(place, document, binary)


def _chunks(path: Path, data: bytes) -> tuple[bytes, memoryview | None]:
    """The JSON and the binary chunk of a GLB."""
    if len(data) < 12 or struct.unpack_from("<I", data, 4)[0] != _VERSION:
        raise InputError(path, "is not a GLB of version 2", AGAIN)
    chunks: dict[int, memoryview] = {}
    at = 12
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > len(data):
            if BINARY_CHUNK in chunks:
                break  # it is followed by something else
            raise InputError(path, "is cut off", "copy or export it again")
        # The first chunk of a kind counts; GLB allows one of each and unknown ones after them.
        chunks.setdefault(kind, memoryview(data)[at + 8:at + 8 + size])
        at += 8 + size
    return bytes(chunks.get(JSON_CHUNK, b"")), chunks.get(BINARY_CHUNK)


class GltfFile:
    """A checked glTF document and its binary data. path: the file; document: its JSON, as read."""

    def __init__(self, path: Path, document: dict[str, Any], binary: memoryview | None) -> None:
        """`InputError` for an invalid document. binary: the binary chunk of a GLB."""
        self.path, self.document, self._binary = path, document, binary
        self._loaded: dict[str | Path, bytes] = {}
        self._unpacked: dict[int, bytes] = {}
        self._meshes: dict[int, dict[int, NDArray[Any]]] = {}
        for name, most in _LISTS.items():
            rows = document.get(name, [])
            self._require(_is_objects(rows), name, rows)
            if len(rows) > most:
                raise self.error(f"has {len(rows):,} {name}, and {most:,} are read at most", "leave some out")
        self._check_extensions()
        self._check_buffers()
        self._check_nodes()
        # After the checks: it relies on valid lists.
        self._draco = draco_attributes(document)

    def rows(self, name: str) -> list[dict[str, Any]]:
        """The entries of a top-level list; empty if the file has none."""
        return cast("list[dict[str, Any]]", self.document.get(name, []))

    # ---------------------------------------------------------------------------------------------- checks

    def error(self, wrong: str, advice: str = AGAIN) -> InputError:
        """An error that names the file."""
        return InputError(self.path, wrong, advice)

    def _require(self, good: bool, where: str, value: object) -> None:
        if not good:
            raise self.error(f"{where} is {shown(value)}")

    def _named(self, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """The entries of a list with their places in the document."""
        return ((f"{name}[{number}]", row) for number, row in enumerate(self.rows(name)))

    def _number(self, row: dict[str, Any], key: str, where: str, below: int = 1 << 40, default: int | None = None
                ) -> int:
        """The index or the size under `key`."""
        value = row.get(key, default)
        self._require(_is_index(value, below), f"{where}.{key}", value)
        return cast("int", value)

    def _indices(self, values: Any, count: int, where: str) -> int:
        """The length of a list of indices, which must all be below `count`."""
        self._require(isinstance(values, list) and all(_is_index(value, count) for value in values), where, values)
        return len(values)

    def _check_extensions(self) -> None:
        required = self.document.get("extensionsRequired", [])
        if not isinstance(required, list):
            raise self.error("extensionsRequired is not a list")
        unknown = [shown(name) for name in required if not (isinstance(name, str) and _KNOWN.fullmatch(name))]
        if unknown:
            raise self.error(f"needs {', '.join(unknown[:3])}", "export it without")
        if not isinstance(self.document.get("extensions", {}), dict):
            raise self.error("extensions is not an object")

    def _check_buffers(self) -> None:
        buffers = self.rows("buffers")
        for where, row in (*self._named("buffers"), *self._named("images")):
            self._require(isinstance(row.get("uri", ""), str), f"{where}.uri", row.get("uri"))
        for where, buffer in self._named("buffers"):
            self._number(buffer, "byteLength", where)
        for where, view in self._named("bufferViews"):
            self._number(view, "byteStride", where, default=0)
            for part in filter(None, (view, compressed_view(view))):
                buffer = buffers[self._number(part, "buffer", where, len(buffers))]
                end = self._number(part, "byteOffset", where, default=0) + self._number(part, "byteLength", where)
                if end > buffer["byteLength"]:
                    raise self.error(f"{where} lies beyond its buffer")
        for where, image in self._named("images"):
            if "bufferView" in image:
                self._number(image, "bufferView", where, len(self.rows("bufferViews")))
        for where, accessor in self._named("accessors"):
            self._check_accessor(accessor, where)

    def _check_accessor(self, accessor: dict[str, Any], where: str) -> None:
        kind: Any = accessor.get("componentType")
        shape: Any = accessor.get("type")
        # Tuples, because the values may be unhashable.
        self._require(kind in tuple(_TYPES), f"{where}.componentType", kind)
        self._require(shape in tuple(_SHAPES), f"{where}.type", shape)
        count = self._number(accessor, "count", where)
        if "bufferView" in accessor:
            self._check_part(accessor, where, count, _value_bytes(kind, shape))
        sparse = accessor.get("sparse")
        if sparse is None:
            return
        parts = [sparse.get(key) for key in ("indices", "values")] if isinstance(sparse, dict) else None
        self._require(_is_objects(parts), f"{where}.sparse", sparse)
        few, places = self._number(sparse, "count", f"{where}.sparse", count + 1), sparse["indices"]
        self._require(places.get("componentType") in _UNSIGNED, f"{where}.sparse.indices", places)
        self._check_part(places, f"{where}.sparse.indices", few, np.dtype(_TYPES[places["componentType"]]).itemsize)
        self._check_part(sparse["values"], f"{where}.sparse.values", few, _value_bytes(kind, shape))

    def _check_part(self, part: dict[str, Any], where: str, count: int, size: int) -> None:
        """`InputError` if `count` values of `size` bytes do not fit into the view of a part."""
        views = self.rows("bufferViews")
        view = views[self._number(part, "bufferView", where, len(views))]
        # Stride 0 or none means tightly packed.
        step = view.get("byteStride", 0) or size
        # The last value need not be padded to the full stride.
        need = self._number(part, "byteOffset", where, default=0) + (step * (count - 1) + size if count else 0)
        if need > view["byteLength"]:
            raise self.error(f"{where} asks for {need:,} bytes of a view that has {view['byteLength']:,}: it lies "
                             "beyond its buffer")

    def _check_nodes(self) -> None:
        nodes, accessors = self.rows("nodes"), self.rows("accessors")
        for where, node in self._named("nodes"):
            self._indices(node.get("children", []), len(nodes), f"{where}.children")
            for key, rows in (("mesh", "meshes"), ("skin", "skins")):
                if key in node:
                    self._number(node, key, where, len(self.rows(rows)))
            for key, count in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
                values = node.get(key, [0.0] * count)
                self._require(isinstance(values, list) and len(values) == count and all(map(_is_near, values)),
                              f"{where}.{key}", values)
        joints = 0
        for where, skin in self._named("skins"):
            joints += self._indices(skin.get("joints"), len(nodes), f"{where}.joints")
            if "inverseBindMatrices" in skin:
                accessor = accessors[self._number(skin, "inverseBindMatrices", where, len(accessors))]
                self._require((accessor["type"], accessor["componentType"]) == ("MAT4", 5126),
                              f"{where}.inverseBindMatrices", accessor)
        if joints > _MOST_JOINTS:
            raise self.error(f"has more than {_MOST_JOINTS:,} joints in its skins", "leave some out")
        for where, mesh in self._named("meshes"):
            primitives = mesh.get("primitives")
            self._require(_is_objects(primitives), f"{where}.primitives", primitives)
            for primitive in cast("list[dict[str, Any]]", primitives):
                attributes = primitive.get("attributes", {})
                self._require(isinstance(attributes, dict), f"{where}.attributes", attributes)
                self._indices(list(attributes.values()), len(accessors), f"{where}.attributes")

    # ---------------------------------------------------------------------------------------------- numbers

    def count(self, accessor: int) -> int:
        """The number of values of an accessor."""
        return cast("int", self.rows("accessors")[accessor]["count"])

    def array(self, accessor: int, rows: slice = slice(None)) -> NDArray[np.float64]:
        """[n, width] the values of an accessor, or some of its rows; normalised integers become fractions of 1."""
        source = self.rows("accessors")[accessor]
        kind, width = np.dtype(_TYPES[source["componentType"]]), math.prod(_SHAPES[source["type"]])
        if accessor in self._draco:
            raw = self._draco_values(accessor, width)
        elif "bufferView" in source:
            raw = self._numbers(source, source["count"], kind, width)
        elif source["count"] * width > _MOST_ZEROS:
            raise self.error(f"accessors[{accessor}] has {source['count']:,} values and no view")
        else:
            raw = np.zeros((source["count"], width))
        with np.errstate(invalid="ignore"):  # a signalling NaN; what takes the values checks that they are finite
            values = (raw if "sparse" in source else raw[rows]).astype(np.float64)
        if "sparse" in source:
            few, places = source["sparse"]["count"], source["sparse"]["indices"]
            at = self._numbers(places, few, np.dtype(_TYPES[places["componentType"]]), 1)[:, 0].astype(np.int64)
            # The format requires rising indices; repeated ones would make the result depend on the order.
            if few and (at.max() >= source["count"] or (np.diff(at) <= 0).any()):
                raise self.error(f"accessors[{accessor}].sparse.indices do not rise below {source['count']}")
            values[at] = self._numbers(source["sparse"]["values"], few, kind, width)
            values = values[rows]
        if source.get("normalized") is True and kind.kind in "iu":
            # glTF 2.0, section 3.11: the smallest signed integer is clamped to -1.
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _draco_values(self, accessor: int, width: int) -> NDArray[Any]:
        """[count, width] the values of an accessor in a Draco mesh."""
        view, number = self._draco[accessor]
        if view not in self._meshes:
            if not 0 <= view < len(self.rows("bufferViews")):
                raise self.error(f"accessors[{accessor}] is in a Draco mesh that is not there")
            self._meshes[view] = unpacked_mesh(self._view_bytes(self.rows("bufferViews")[view]), self.path)
        values = self._meshes[view].get(number)
        # A decoder may leave out triangles without area, so there may be fewer indices.
        if values is None or (number >= 0 and values.reshape(len(values), -1).shape != (self.count(accessor), width)):
            raise self.error(f"accessors[{accessor}] is not what its Draco mesh holds")
        return values.reshape(len(values), -1)

    def _view_bytes(self, view: dict[str, Any]) -> bytes:
        """The bytes of a buffer view, or of its compressed form."""
        start = view.get("byteOffset", 0)
        return bytes(self._buffer(view["buffer"])[start:start + view["byteLength"]])

    def _numbers(self, part: dict[str, Any], count: int, kind: np.dtype[Any], width: int) -> NDArray[Any]:
        """[count, width] the data in the view of an accessor or of a sparse part, without copying."""
        number, start = part["bufferView"], part.get("byteOffset", 0)
        view = self.rows("bufferViews")[number]
        step = view.get("byteStride", 0) or kind.itemsize * width
        packed = compressed_view(view)
        if packed is None:
            data: bytes | memoryview = self._buffer(view["buffer"])
            start += view.get("byteOffset", 0)
        else:
            if number not in self._unpacked:
                self._unpacked[number] = unpacked_view(packed, self._view_bytes(packed), view["byteLength"], self.path)
            data = self._unpacked[number]
        return np.ndarray((count, width), kind, data, start, (step, kind.itemsize))

    def _buffer(self, index: int) -> bytes | memoryview:
        buffer = self.rows("buffers")[index]
        uri = buffer.get("uri")
        data: bytes | memoryview | None = self._binary
        if uri is not None:
            data = self._embedded(index, uri) if uri.startswith("data:") else self.bytes_of(self.beside(uri))
        if data is None:
            raise self.error("lacks its binary part")
        if len(data) < buffer["byteLength"]:
            raise self.error(f"buffers[{index}] has {len(data):,} bytes of {buffer['byteLength']:,}",
                             "copy or export it again")
        return data

    def _embedded(self, index: int, uri: str) -> bytes:
        if uri not in self._loaded:
            try:
                self._loaded[uri] = base64.b64decode(uri.partition(",")[2], validate=True)
            except ValueError:
                raise self.error(f"buffers[{index}] is not base64") from None
        return self._loaded[uri]

    # ---------------------------------------------------------------------------------------------- files

    def beside(self, uri: str) -> Path:
        """The file of a URI; only files in the folder of the document or below are allowed."""
        folder = self.path.parent.resolve()
        try:
            # Resolved before the check, so that ".." and links cannot lead out of the folder.
            place = (folder / unquote(uri)).resolve()
            if not place.is_relative_to(folder):
                raise self.error(f"names a file elsewhere ({shown(uri)})", f"keep it beside, or {AGAIN}")
            if place.is_file():
                return place
        except (OSError, ValueError):  # a name that is too long or contains NUL
            pass
        raise self.error(f"lacks {shown(uri)}", f"keep it beside, or {AGAIN}")

    def bytes_of(self, place: Path) -> bytes:
        """A separate file of the document, read only once."""
        if place not in self._loaded:
            # The limit is for all separate files together.
            left = LARGEST - sum(map(len, self._loaded.values()))
            self._loaded[place] = read_bytes(place, "leave out its textures", left)
        return self._loaded[place]

    def one_buffer(self) -> bytes:
        """Joins all buffers into one, each file once, and updates the views and `buffers` accordingly."""
        buffers = self.rows("buffers")
        if not buffers:
            self.document.pop("buffers", None)
            return bytes(self._binary or b"")
        if len(buffers) == 1 and "uri" not in buffers[0]:
            return bytes(self._buffer(0))
        joined, rows, starts = bytearray(), list[int](), list[int]()
        places: dict[str, int] = {}
        # Buffers without data stand for views that are compressed; they keep a row of their own.
        left: list[dict[str, Any]] = [{}]
        for index, buffer in enumerate(buffers):
            if index and is_fallback(buffer):
                rows.append(len(left))
                starts.append(0)
                left.append(buffer)
                continue
            uri, data = buffer.get("uri", ""), self._buffer(index)
            source = uri if not uri or uri.startswith("data:") else str(self.beside(uri))
            if source not in places:
                # Accessors must stay aligned to 4 bytes.
                joined += bytes(-len(joined) % 4)
                places[source] = len(joined)
                joined += data
            rows.append(0)
            starts.append(places[source])
        for view in self.rows("bufferViews"):
            for part in filter(None, (view, compressed_view(view))):
                part["byteOffset"] = part.get("byteOffset", 0) + starts[part["buffer"]]
                part["buffer"] = rows[part["buffer"]]
        self.document["buffers"] = left
        return bytes(joined)


def _is_objects(rows: Any) -> bool:
    return isinstance(rows, list) and all(isinstance(row, dict) for row in rows)


def _is_index(value: Any, below: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < below


def _is_near(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= FARTHEST


def _value_bytes(kind: int, shape: str) -> int:
    """Bytes of one value of an accessor."""
    rows, columns = _SHAPES[shape]
    column = np.dtype(_TYPES[kind]).itemsize * rows
    return column if columns == 1 else columns * (column + -column % 4)
