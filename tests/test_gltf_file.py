"""The one reader of glTF: known answers of accessors, and everything that the rig's reader and the writer rely on."""

import base64
import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_reader import GlbFile, save
from rigs import as_glb, draw

from data_module.errors import InputError
from gesticulator.characters.gltf_file import read_gltf
from gesticulator.characters.gltf_rig import read_gltf_character
from gesticulator.export.gltf import open_gltf

Change = Callable[[dict[str, Any]], object]


def _gltf(folder: Path, numbers: bytes, accessors: list[dict[str, Any]], views: list[dict[str, Any]] | None = None,
          **more: Any) -> Path:
    """A document whose numbers lie within it."""
    uri = "data:application/octet-stream;base64," + base64.b64encode(numbers).decode()
    views = [{"buffer": 0, "byteLength": len(numbers)}] if views is None else views
    file = folder / "a.gltf"
    file.write_text(json.dumps({"nodes": [{}], "buffers": [{"uri": uri, "byteLength": len(numbers)}],
                                "bufferViews": views, "accessors": accessors, **more}))
    return file


def _changed_glb(folder: Path, change: Change) -> Path:
    """A character whose document was changed."""
    parsed = GlbFile.parse(as_glb(draw(3, "mixamo", "A")))
    change(parsed.document)
    return save(folder / "a.glb", parsed.document, parsed.binary)


@pytest.mark.parametrize("behind", [b"junk", b"\xff" * 20])
def test_what_stands_behind_a_whole_glb_does_not_matter(behind: bytes, tmp_path: Path) -> None:
    data = as_glb(draw(3, "mixamo", "A"))
    (tmp_path / "a.glb").write_bytes(data + behind)
    assert read_gltf(tmp_path / "a.glb").document == GlbFile.parse(data).document
    (tmp_path / "a.glb").write_bytes(data[:-4])
    with pytest.raises(InputError, match="is cut off"):
        read_gltf(tmp_path / "a.glb")


# ---------------------------------------------------------------------------------------------------- numbers

@pytest.mark.parametrize("with_view", [True, False])
def test_sparse_values_stand_in_their_places(with_view: bool, tmp_path: Path) -> None:
    base = np.arange(12, dtype="<f4").reshape(4, 3)
    places, values = np.array([1, 3], "<u2"), np.array([[10, 11, 12], [13, 14, 15]], "<f4")
    views = [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 4},
             {"buffer": 0, "byteOffset": 52, "byteLength": 24}]
    accessor = {"componentType": 5126, "type": "VEC3", "count": 4, "sparse": {
        "count": 2, "indices": {"bufferView": 1, "componentType": 5123}, "values": {"bufferView": 2}}}
    file = read_gltf(_gltf(tmp_path, base.tobytes() + places.tobytes() + values.tobytes(),
                           [accessor | ({"bufferView": 0} if with_view else {})], views))
    expected = (base if with_view else np.zeros((4, 3))).astype(np.float64)
    expected[[1, 3]] = values
    assert np.array_equal(file.array(0), expected)
    for rows in (slice(2), slice(1, None, 2), slice(3, None, 3)):
        assert np.array_equal(file.array(0, rows), expected[rows])


@pytest.mark.parametrize(("kind", "code", "value", "share"), [
    ("u1", 5121, 51, 0.2), ("<u2", 5123, 65535, 1.0), ("i1", 5120, -128, -1.0), ("<i2", 5122, 32767, 1.0)])
def test_normalised_integers_are_shares(kind: str, code: int, value: int, share: float, tmp_path: Path) -> None:
    data = np.array([value, 0], kind).tobytes()
    accessor = {"bufferView": 0, "componentType": code, "type": "SCALAR", "count": 2}
    assert read_gltf(_gltf(tmp_path, data, [accessor])).array(0)[0, 0] == value
    shares = read_gltf(_gltf(tmp_path, data, [accessor | {"normalized": True}])).array(0)
    assert shares[0, 0] == pytest.approx(share) and shares[1, 0] == 0


def test_values_between_others_are_read_by_their_stride(tmp_path: Path) -> None:
    rows = np.arange(20, dtype="<f4").reshape(4, 5)
    views = [{"buffer": 0, "byteLength": 80, "byteStride": 20}]
    accessor = {"bufferView": 0, "byteOffset": 8, "componentType": 5126, "type": "VEC3", "count": 4}
    assert np.array_equal(read_gltf(_gltf(tmp_path, rows.tobytes(), [accessor], views)).array(0), rows[:, 2:])


# ---------------------------------------------------------------------------------------------------- refusals

def _accessor(**change: Any) -> Change:
    return lambda document: document["accessors"][0].update(change)


def _row(name: str, **change: Any) -> Change:
    return lambda document: document[name][0].update(change)


@pytest.mark.parametrize(("change", "wrong"), [
    (_accessor(count=32_000_000_000), "accessors[0] asks for"), (_accessor(count=-1), "accessors[0].count is -1"),
    (_accessor(count=True), "count is True"), (_accessor(count=1e9), "count is 1000000000.0"),
    (_accessor(bufferView=99), "accessors[0].bufferView is 99"), (_accessor(componentType=[1]), "componentType is [1]"),
    (_accessor(type="MAT9"), "type is MAT9"), (_accessor(byteOffset=1 << 50), "byteOffset is 1125899906842624"),
    (_accessor(sparse=7), "sparse is 7"),
    (_accessor(sparse={"count": 10**6, "indices": {}, "values": {}}), "sparse.count is 1000000"),
    (_row("bufferViews", byteLength=1 << 35), "bufferViews[0] lies beyond its buffer"),
    (_row("bufferViews", buffer=3), "bufferViews[0].buffer is 3"),
    (_row("bufferViews", byteStride=-4), "byteStride is -4"),
    (_row("buffers", byteLength=1 << 30), "buffers[0] has"), (_row("buffers", byteLength=None), "byteLength is None"),
    (_row("buffers", uri="a\0b"), "lacks a"), (_row("buffers", uri="../../etc/passwd"), "a file elsewhere"),
    (_row("buffers", uri="data:;base64,=="), "is not base64"), (_row("buffers", uri="x" * 5000), "lacks x"),
    (_row("nodes", children=[12345]), "nodes[0].children is [12345]"),
    (_row("nodes", skin="0"), "nodes[0].skin"), (_row("nodes", rotation=[0, 0, 1]), "nodes[0].rotation"),
    (_row("nodes", translation=[1e300, 0, 0]), "translation is [1e+300"), (_row("nodes", scale=["1", 1, 1]), "scale"),
    (_row("skins", joints=[0, 99999]), "joints is [0, 99999]"), (_row("skins", joints=None), "skins[0].joints"),
    (_row("skins", inverseBindMatrices=1), "skins[0].inverseBindMatrices is {"),
    (_row("meshes", primitives=[3]), "meshes[0].primitives is [3]"),
    (_row("meshes", primitives=[{"attributes": {"POSITION": 400}}]), "meshes[0].attributes is [400]"),
    (lambda document: document.update(images=[7]), "images is [7]"),
    (lambda document: document.update(images=[{"uri": 7}]), "images[0].uri is 7"),
    (lambda document: document.update(images=[{"bufferView": -1}]), "images[0].bufferView is -1"),
    (lambda document: document.update(animations={}), "animations is {}"),
    (lambda document: document.update(nodes=[{}] * 20_000), "are read at most"),
    (lambda document: document.update(extensionsRequired=["KHR_texture_transform", "EXT_no_such"]),
     "needs EXT_no_such; export it without"),
])
def test_what_cannot_be_relied_on_is_named(change: Change, wrong: str, tmp_path: Path) -> None:
    file = _changed_glb(tmp_path, change)
    tracemalloc.start()
    try:
        _refused(file, wrong)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def _refused(file: Path, wrong: str) -> None:
    for read in (read_gltf_character, open_gltf):
        with pytest.raises(InputError) as error:
            read(file)
        assert wrong in str(error.value) and "\n" not in str(error.value) and len(str(error.value)) < 800


@pytest.mark.parametrize(("old", "new", "wrong"), [
    (b'"translation": [', b'"translation": [NaN, ', "is not valid JSON"),
    (b'"count": ', b'"count": ' + b"9" * 5000, "a number of 50"),
    (b'"nodes": [', b'"extras": ' + b"[" * 50_000 + b"]" * 50_000 + b', "nodes": [', "nested more than"),
    (b'"nodes": [', b'"extras": 1e999, "nodes": [', "out of range"),
])
def test_numbers_that_are_none_are_refused(old: bytes, new: bytes, wrong: str, tmp_path: Path) -> None:
    document = json.dumps(GlbFile.parse(as_glb(draw(3, "mixamo", "A"))).document).encode()
    assert old in document
    file = tmp_path / "a.gltf"
    file.write_bytes(document.replace(old, new, 1))
    with pytest.raises(InputError, match=wrong):
        read_gltf_character(file)


@pytest.mark.parametrize("extension", ["KHR_materials_unlit", "KHR_mesh_quantization"])
def test_extensions_of_materials_and_quantised_meshes_may_be_required(extension: str, tmp_path: Path) -> None:
    file = _changed_glb(tmp_path, lambda document: document.update(extensionsRequired=[extension]))
    assert len(read_gltf_character(file))


# ---------------------------------------------------------------------------------------------------- memory

def test_a_file_beside_is_read_and_written_once_however_often_it_is_named(tmp_path: Path) -> None:
    (tmp_path / "skin.png").write_bytes(bytes(2_000_000))
    (tmp_path / "b.bin").write_bytes(bytes(1_000_000))
    document = {"nodes": [{}], "buffers": [{"uri": "b.bin", "byteLength": 1_000_000}] * 100,
                "bufferViews": [{"buffer": at, "byteLength": 4} for at in range(100)],
                "images": [{"uri": uri} for uri in ("skin.png", "./skin.png", "%73kin.png")] * 100}
    file = tmp_path / "a.gltf"
    file.write_text(json.dumps(document))
    data = open_gltf(file).to_bytes()
    assert len(data) < 3_200_000
    written = GlbFile.parse(data).document
    assert {image["bufferView"] for image in written["images"]} == {100}
    assert {view["byteOffset"] for view in written["bufferViews"][:100]} == {0}


def test_many_meshes_over_one_view_cost_what_is_kept(tmp_path: Path) -> None:
    """One view of points, named by 300 parts: 20,000 points are kept, and no more are taken into memory at a time."""
    def change(document: dict[str, Any]) -> None:
        document["meshes"][0]["primitives"] = document["meshes"][0]["primitives"] * 300

    before = len(read_gltf_character(_changed_glb(tmp_path, lambda document: None)).flesh)
    flesh = read_gltf_character(_changed_glb(tmp_path, change)).flesh
    assert before <= len(flesh) <= 20_000
