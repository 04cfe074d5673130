"""The reader of glTF 2.0: GLB, VRM, and .gltf with buffers and images embedded or in separate files.

Everything that later code relies on is checked when a file is opened, before memory is allocated: lists are lists of
objects, every index is valid, every accessor lies in its view, every view in its buffer. Unknown content is preserved.
"""

from __future__ import annotations

import base64
import binascii
import math
import os
import re
import struct
from pathlib import Path
from typing import Any, cast
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.files import parse_json, read_bytes
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
    """Read a .glb, .vrm or .gltf file. `InputError` for another format or an invalid file."""
    place = Path(path)
    data = read_bytes(path, "leave out its textures", LARGEST)
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
        self._beside: dict[Path, bytes] = {}
        self._embedded: dict[int, bytes] = {}
        self._unpacked: dict[int, bytes] = {}
        self._meshes: dict[int, dict[int, NDArray[Any]]] = {}
        for name in _LISTS:
            self._check_list(name)
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

    def _check_list(self, name: str) -> None:
        rows = self.document.get(name, [])
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise self.error(f"{name} is not a list of objects")
        if len(rows) > _LISTS[name]:
            raise self.error(f"has {len(rows):,} {name}, and {_LISTS[name]:,} are read at most", "leave some out")

    def _check_extensions(self) -> None:
        required = self.document.get("extensionsRequired", [])
        if not isinstance(required, list):
            raise self.error("extensionsRequired is not a list")
        unknown = [shown(name) for name in required if not (isinstance(name, str) and _KNOWN.fullmatch(name))]
        if unknown:
            raise self.error(f"needs {', '.join(unknown[:3])}", "export it without")
        if not isinstance(self.document.get("extensions", {}), dict):
            raise self.error("extensions is not an object")

    def _index(self, row: dict[str, Any], key: str, count: int, where: str) -> int:
        """The index under `key`, which must be below `count`."""
        value = row.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < count:
            raise self.error(f"{where}.{key} is {shown(value)}, and there are {count}")
        return value

    def _size(self, row: dict[str, Any], key: str, where: str, default: int | None = 0) -> int:
        """The size under `key`; without `default` it is required."""
        value = row.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= 1 << 40:
            raise self.error(f"{where}.{key} is {shown(value)}")
        return value

    def _check_buffers(self) -> None:
        for number, buffer in enumerate(self.rows("buffers")):
            self._size(buffer, "byteLength", f"buffers[{number}]", None)
            if not isinstance(buffer.get("uri", ""), str):
                raise self.error(f"buffers[{number}].uri is {shown(buffer['uri'])}")
        for number, view in enumerate(self.rows("bufferViews")):
            where = f"bufferViews[{number}]"
            buffer = self.rows("buffers")[self._index(view, "buffer", len(self.rows("buffers")), where)]
            end = self._size(view, "byteOffset", where) + self._size(view, "byteLength", where, None)
            if end > buffer["byteLength"]:
                raise self.error(f"{where} lies beyond its buffer")
            self._size(view, "byteStride", where)
            packed = compressed_view(view)
            if packed is not None:
                buffer = self.rows("buffers")[self._index(packed, "buffer", len(self.rows("buffers")), where)]
                end = self._size(packed, "byteOffset", where) + self._size(packed, "byteLength", where, None)
                if end > buffer["byteLength"]:
                    raise self.error(f"{where} lies beyond its buffer")
        for number, accessor in enumerate(self.rows("accessors")):
            self._check_accessor(accessor, f"accessors[{number}]")
        for number, image in enumerate(self.rows("images")):
            if not isinstance(image.get("uri", ""), str):
                raise self.error(f"images[{number}].uri is {shown(image['uri'])}")
            if "bufferView" in image:
                self._index(image, "bufferView", len(self.rows("bufferViews")), f"images[{number}]")

    def _check_accessor(self, accessor: dict[str, Any], where: str) -> None:
        kind: Any = accessor.get("componentType")
        shape: Any = accessor.get("type")
        if kind not in tuple(_TYPES) or shape not in tuple(_SHAPES):  # tuples, because the values may be unhashable
            raise self.error(f"{where} holds numbers of kind {shown(kind)} and {shown(shape)}")
        count = self._size(accessor, "count", where, None)
        if "bufferView" in accessor:
            self._check_part(accessor, where, count, _value_bytes(kind, shape))
        sparse = accessor.get("sparse")
        if sparse is None:
            return
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise self.error(f"{where}.sparse is {shown(sparse)}")
        few, places = self._size(sparse, "count", f"{where}.sparse", None), sparse["indices"]
        if few > count or places.get("componentType") not in _UNSIGNED:
            raise self.error(f"{where}.sparse has {few} of {count} values, by numbers of kind "
                             f"{shown(places.get('componentType'))}")
        self._check_part(places, f"{where}.sparse.indices", few, np.dtype(_TYPES[places["componentType"]]).itemsize)
        self._check_part(sparse["values"], f"{where}.sparse.values", few, _value_bytes(kind, shape))

    def _check_part(self, part: dict[str, Any], where: str, count: int, size: int) -> None:
        """`InputError` if `count` values of `size` bytes do not fit into the view of a part."""
        views = self.rows("bufferViews")
        view = views[self._index(part, "bufferView", len(views), where)]
        # Stride 0 or none means tightly packed.
        step = view.get("byteStride", 0) or size
        # The last value need not be padded to the full stride.
        need = self._size(part, "byteOffset", where) + (step * (count - 1) + size if count else 0)
        if need > view["byteLength"]:
            raise self.error(f"{where} asks for {need:,} bytes of a view that has {view['byteLength']:,}: it lies "
                             "beyond its buffer")

    def _check_nodes(self) -> None:
        nodes = self.rows("nodes")
        for number, node in enumerate(nodes):
            where = f"nodes[{number}]"
            self._check_indices(node.get("children", []), len(nodes), f"{where}.children")
            for key, rows in (("mesh", "meshes"), ("skin", "skins")):
                if key in node:
                    self._index(node, key, len(self.rows(rows)), where)
            for key, count in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
                self._check_numbers(node.get(key, [0.0] * count), count, f"{where}.{key}")
        joints = 0
        for number, skin in enumerate(self.rows("skins")):
            where = f"skins[{number}]"
            joints += self._check_indices(skin.get("joints"), len(nodes), f"{where}.joints")
            if joints > _MOST_JOINTS:
                raise self.error(f"has more than {_MOST_JOINTS:,} joints in its skins", "leave some out")
            if "inverseBindMatrices" in skin:
                accessors = self.rows("accessors")
                accessor = accessors[self._index(skin, "inverseBindMatrices", len(accessors), where)]
                if (accessor["type"], accessor["componentType"]) != ("MAT4", 5126):
                    raise self.error(f"{where}.inverseBindMatrices are not matrices")
        for number, mesh in enumerate(self.rows("meshes")):
            self._check_mesh(mesh, f"meshes[{number}]")

    def _check_mesh(self, mesh: dict[str, Any], where: str) -> None:
        primitives = mesh.get("primitives")
        if not isinstance(primitives, list) or not all(isinstance(entry, dict) for entry in primitives):
            raise self.error(f"{where}.primitives is not a list of objects")
        for number, primitive in enumerate(primitives):
            attributes = primitive.get("attributes", {})
            if not isinstance(attributes, dict):
                raise self.error(f"{where}.primitives[{number}].attributes is not an object")
            self._check_indices(list(attributes.values()), len(self.rows("accessors")),
                                f"{where}.primitives[{number}].attributes")

    def _check_indices(self, values: Any, count: int, where: str) -> int:
        """The length of a list of indices, which must all be below `count`."""
        if not isinstance(values, list) or not all(
                isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count for value in values):
            raise self.error(f"{where} names what is not there ({shown(values)})")
        return len(values)

    def _check_numbers(self, values: Any, count: int, where: str) -> None:
        if not isinstance(values, list) or len(values) != count or not all(
                isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= FARTHEST
                for value in values):
            raise self.error(f"{where} is {shown(values)}: not {count} numbers up to {FARTHEST:g}")

    # ---------------------------------------------------------------------------------------------- numbers

    def count(self, accessor: int) -> int:
        """The number of values of an accessor."""
        return cast("int", self.rows("accessors")[accessor]["count"])

    def array(self, accessor: int, first: int = 0, step: int = 1, most: int | None = None) -> NDArray[np.float64]:
        """[n, width] every `step`-th value of an accessor from `first` on, at most `most`, with sparse values applied;
        normalised integers become fractions of 1."""
        source = self.rows("accessors")[accessor]
        kind, width = np.dtype(_TYPES[source["componentType"]]), math.prod(_SHAPES[source["type"]])
        chosen = range(first, source["count"], step)[:most]
        if accessor in self._draco:
            values = self._draco_values(accessor, width)[first::step][:most].astype(np.float64)
        elif "bufferView" in source:
            with np.errstate(invalid="ignore"):  # a signalling NaN; what takes the values checks that they are finite
                values = self._numbers(source, source["count"], kind, width)[first::step][:most].astype(np.float64)
        else:
            if len(chosen) * width > _MOST_ZEROS:
                raise self.error(f"accessors[{accessor}] has {source['count']:,} values and no view")
            values = np.zeros((len(chosen), width))
        if "sparse" in source:
            few, places = source["sparse"]["count"], source["sparse"]["indices"]
            at = self._numbers(places, few, np.dtype(_TYPES[places["componentType"]]), 1)[:, 0].astype(np.int64)
            # The format requires rising indices; repeated ones would make the result depend on the order.
            if few and (at.max() >= source["count"] or (np.diff(at) <= 0).any()):
                raise self.error(f"accessors[{accessor}].sparse.indices do not rise below {source['count']}")
            # Only those sparse values whose rows were requested.
            here = np.isin(at, np.array(chosen, dtype=np.int64)) if step > 1 or most is not None else at >= first
            values[(at[here] - first) // step] = self._numbers(source["sparse"]["values"], few, kind, width)[here]
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
        if values is None or values.reshape(len(values), -1).shape != (self.count(accessor), width):
            raise self.error(f"accessors[{accessor}] is not what its Draco mesh holds")
        return values.reshape(len(values), -1)

    def _view_bytes(self, view: dict[str, Any]) -> bytes:
        """The bytes of a buffer view, or of its compressed form."""
        start = view.get("byteOffset", 0)
        return bytes(self._buffer(view["buffer"])[start:start + view["byteLength"]])

    def _numbers(self, part: dict[str, Any], count: int, kind: np.dtype[Any], width: int) -> NDArray[Any]:
        """[count, width] the data in the view of an accessor or of a sparse part, without copying."""
        view = self.rows("bufferViews")[part["bufferView"]]
        step = view.get("byteStride", 0) or kind.itemsize * width
        packed = compressed_view(view)
        if packed is not None:
            number = part["bufferView"]
            if number not in self._unpacked:
                self._unpacked[number] = unpacked_view(packed, self._view_bytes(packed), view["byteLength"], self.path)
            return np.ndarray((count, width), kind, self._unpacked[number], part.get("byteOffset", 0),
                              (step, kind.itemsize))
        start = view.get("byteOffset", 0) + part.get("byteOffset", 0)
        return np.ndarray((count, width), kind, self._buffer(view["buffer"]), start, (step, kind.itemsize))

    def _buffer(self, index: int) -> bytes | memoryview:
        buffer = self.rows("buffers")[index]
        uri = buffer.get("uri")
        data: bytes | memoryview | None = self._binary
        if uri is not None:
            data = self._embedded_data(index, uri) if uri.startswith("data:") else self.bytes_of(self.beside(uri))
        if data is None:
            raise self.error("lacks its binary part")
        if len(data) < buffer["byteLength"]:
            raise self.error(f"buffers[{index}] has {len(data):,} bytes of {buffer['byteLength']:,}",
                             "copy or export it again")
        return data

    def _embedded_data(self, index: int, uri: str) -> bytes:
        if index not in self._embedded:
            try:
                self._embedded[index] = base64.b64decode(uri.partition(",")[2], validate=True)
            except (binascii.Error, ValueError):
                raise self.error(f"buffers[{index}] is not base64") from None
        return self._embedded[index]

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
        if place not in self._beside:
            # The limit is for all separate files together.
            left = LARGEST - sum(map(len, self._beside.values()))
            self._beside[place] = read_bytes(place, "leave out its textures", left)
        return self._beside[place]

    def one_buffer(self) -> bytes:
        """Joins all buffers into one, each file once, and updates the views and `buffers` accordingly."""
        buffers = self.rows("buffers")
        if not buffers:
            self.document.pop("buffers", None)
            return bytes(self._binary or b"")
        if len(buffers) == 1 and "uri" not in buffers[0]:
            return bytes(self._buffer(0))
        joined, starts = bytearray(), list[int]()
        places: dict[str, int] = {}
        # Buffers without data stand for views that are compressed; they keep a row of their own.
        empty = [index for index, buffer in enumerate(buffers) if is_fallback(buffer) and index]
        rows = {index: empty.index(index) + 1 if index in empty else 0 for index in range(len(buffers))}
        for index, buffer in enumerate(buffers):
            if index in empty:
                starts.append(0)
                continue
            uri = buffer.get("uri", "")
            source = uri if not uri or uri.startswith("data:") else str(self.beside(uri))
            if source not in places:
                # Accessors must stay aligned to 4 bytes.
                joined += bytes(-len(joined) % 4)
                places[source] = len(joined)
                joined += self._buffer(index)
            self._buffer(index)
            starts.append(places[source])
        for view in self.rows("bufferViews"):
            for part in (view, compressed_view(view)):
                if part is not None:
                    part["byteOffset"] = part.get("byteOffset", 0) + starts[part["buffer"]]
                    part["buffer"] = rows[part["buffer"]]
        self.document["buffers"] = [{}, *(buffers[index] for index in empty)]
        return bytes(joined)


def _value_bytes(kind: int, shape: str) -> int:
    """Bytes of one value of an accessor."""
    rows, columns = _SHAPES[shape]
    column = np.dtype(_TYPES[kind]).itemsize * rows
    return column if columns == 1 else columns * (column + -column % 4)
