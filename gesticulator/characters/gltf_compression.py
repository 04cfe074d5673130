"""Compressed parts of glTF files, unpacked for reading: EXT_meshopt_compression and KHR_draco_mesh_compression.

The extra `compressed` installs the decoders. The file itself is not rewritten: new data are appended beside its
compressed parts.
"""

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, install_line, shown

MESHOPT, DRACO = "EXT_meshopt_compression", "KHR_draco_mesh_compression"
PACKAGES = {MESHOPT: "meshoptimizer", DRACO: "DracoPy"}
"""Extension -> the package that decodes it."""
_SIZES = {"ATTRIBUTES": range(4, 257, 4), "TRIANGLES": (2, 4), "INDICES": (2, 4)}
"""Mode of meshopt -> allowed sizes of an element, bytes."""
_FILTERS = {"NONE": "", "OCTAHEDRAL": "decode_filter_oct", "QUATERNION": "decode_filter_quat",
            "EXPONENTIAL": "decode_filter_exp"}
_LARGEST = 1 << 30
"""Largest size of an unpacked part, bytes (1 GiB)."""


def decoder(name: str, subject: object) -> Any:
    """The package that decodes an extension. `InputError` that names the extension if it is not installed."""
    try:
        return importlib.import_module(PACKAGES[name])
    except ImportError:
        raise InputError(
            subject, f"is compressed with {name}, for which {PACKAGES[name]} is not installed",
            f"{install_line('compressed')}, or unpack it: npx @gltf-transform/cli copy IN.glb OUT.glb"
        ) from None


def _extension(row: dict[str, Any], name: str) -> dict[str, Any] | None:
    extensions = row.get("extensions")
    extension = extensions.get(name) if isinstance(extensions, dict) else None
    return extension if isinstance(extension, dict) else None


def compressed_view(view: dict[str, Any]) -> dict[str, Any] | None:
    """The meshopt extension of a buffer view; None if it is not compressed."""
    return _extension(view, MESHOPT)


def is_fallback(buffer: dict[str, Any]) -> bool:
    """Whether a buffer has no data in the file, because all its views are compressed."""
    return _extension(buffer, MESHOPT) is not None and "uri" not in buffer


def unpacked_view(extension: dict[str, Any], data: bytes, size: int, subject: object) -> bytes:
    """The `size` bytes of a view that meshopt compressed. extension: of the view; data: the compressed bytes.
    `InputError` for contradictions and for data that cannot be decoded."""
    mode, stride, count = extension.get("mode"), extension.get("byteStride"), extension.get("count")
    name = extension.get("filter", "NONE")
    if (not isinstance(mode, str) or not isinstance(name, str) or not isinstance(stride, int)
            or not isinstance(count, int) or isinstance(count, bool) or stride not in _SIZES.get(mode, ())
            or name not in _FILTERS
            or not 0 <= count * stride <= min(size, _LARGEST)):
        raise InputError(subject, f"has a part compressed with {MESHOPT} as {shown(mode)} {shown(count)} x "
                         f"{shown(stride)}, {shown(name)}", "export it again, or uncompressed")
    package = decoder(MESHOPT, subject)
    try:
        if mode == "ATTRIBUTES":
            # A void type of `stride` bytes: the decoder needs the size alone, whatever the components.
            raw = package.decode_vertex_buffer(count, stride, data, dtype=np.dtype(f"V{stride}"))
            out = raw.view(np.uint8).copy()
            if _FILTERS[name]:
                out = getattr(package, _FILTERS[name])(out, count, stride)
        else:
            decode = package.decode_index_buffer if mode == "TRIANGLES" else package.decode_index_sequence
            # The package decodes indices of four bytes, whatever their size in the file.
            out = decode(count, 4, data).astype(f"<u{stride}").view(np.uint8)
    except (RuntimeError, ValueError) as error:
        raise InputError(subject, f"has a part that {MESHOPT} cannot decode ({shown(str(error), 80)})",
                         "copy or export it again") from None
    return out.tobytes().ljust(size, b"\0")


_FACES = -1
"""Stands for the indices of a Draco mesh, which have no number as its attributes have."""


def draco_attributes(document: dict[str, Any]) -> dict[int, tuple[int, int]]:
    """Accessor -> the buffer view of the Draco mesh that holds it, and its number there."""
    attributes_at: dict[int, tuple[int, int]] = {}
    for mesh in document.get("meshes", []):
        for primitive in mesh.get("primitives", []):
            extension = _extension(primitive, DRACO)
            if extension is None or not isinstance(extension.get("attributes"), dict):
                continue
            view = extension.get("bufferView")
            numbers = [(primitive.get("attributes", {}).get(name), number)
                       for name, number in extension["attributes"].items()]
            for accessor, number in [*numbers, (primitive.get("indices"), _FACES)]:
                # The identity: True is an int, too.
                if type(accessor) is type(view) is type(number) is int:
                    attributes_at[accessor] = view, number
    return attributes_at


def unpacked_mesh(data: bytes, subject: object) -> dict[int, NDArray[Any]]:
    """The attributes of a Draco mesh by number, [count, width] each, and its indices. `InputError` if it cannot be
    decoded."""
    package = decoder(DRACO, subject)
    try:
        mesh = package.decode(data)
    except Exception as error:  # noqa: BLE001 - the package raises whatever its decoder did
        raise InputError(subject, f"has a mesh that {DRACO} cannot decode ({shown(str(error), 80)})",
                         "copy or export it again") from None
    # A cloud of points has no faces.
    return {_FACES: np.reshape(getattr(mesh, "faces", ()), (-1, 1))} | {
        int(attribute["unique_id"]): np.asarray(attribute["data"]) for attribute in mesh.attributes}
