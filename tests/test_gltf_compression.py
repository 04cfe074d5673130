"""Characters in files as they are: compressed, quantised, several in one, nodes with matrices."""

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_reader import GlbFile, save
from numpy.typing import NDArray
from performances import perform, write
from small_characters import MIXAMO, write_character

from data_module.errors import InputError, install_line
from data_module.motion.skeletons import FINGERED
from gesticulator.characters import gltf_compression
from gesticulator.characters.gltf_compression import DRACO, MESHOPT
from gesticulator.characters.reading import choose, read_character
from gesticulator.characters.retarget import retarget
from gesticulator.characters.rig import note_of, skeletons_of


def view_of(file: GlbFile, accessor: int) -> tuple[dict[str, Any], dict[str, Any], NDArray[Any]]:
    """The view, the accessor and its values, as bytes [count, size]."""
    own = file.document["accessors"][accessor]
    values = file.numbers(accessor)
    return file.document["bufferViews"][own["bufferView"]], own, values.view(np.uint8).reshape(len(values), -1)


def with_meshopt(source: Path, target: Path) -> Path:
    """The file with inverse bind matrices and vertices compressed, their plain bytes in a buffer without data."""
    meshopt = pytest.importorskip("meshoptimizer")
    file = GlbFile.parse(source.read_bytes())
    document, binary, plain = copy.deepcopy(file.document), bytearray(file.binary), 0
    primitive = document["meshes"][0]["primitives"][0]["attributes"]
    for accessor in {document["skins"][0]["inverseBindMatrices"], *primitive.values()}:
        view, own, raw = view_of(file, accessor)
        stride = raw.shape[1]
        packed = meshopt.encode_vertex_buffer(np.ascontiguousarray(raw), len(raw), stride)
        place = document["bufferViews"][own["bufferView"]]
        binary += bytes(-len(binary) % 4)
        place |= {"buffer": 1, "byteOffset": plain, "byteLength": raw.size, "extensions": {MESHOPT: {
            "buffer": 0, "byteOffset": len(binary), "byteLength": len(packed), "byteStride": stride, "count": len(raw),
            "mode": "ATTRIBUTES", "filter": "NONE"}}}
        if "target" in view:
            place["byteStride"] = stride
        document["accessors"][accessor].pop("byteOffset", None)
        plain += raw.size + -raw.size % 4
        binary += bytes(packed)
    document["buffers"] = [{"byteLength": len(binary)},
                           {"byteLength": plain, "extensions": {MESHOPT: {"fallback": True}}}]
    document["extensionsUsed"] = document["extensionsRequired"] = [MESHOPT]
    return save(target, document, bytes(binary))


def with_draco(source: Path, target: Path) -> Path:
    """The file with its mesh compressed."""
    draco = pytest.importorskip("DracoPy")
    file = GlbFile.parse(source.read_bytes())
    document = copy.deepcopy(file.document)
    primitive = document["meshes"][0]["primitives"][0]
    numbers = {name: file.numbers(accessor) for name, accessor in primitive["attributes"].items()}
    packed = draco.encode(np.asarray(numbers["POSITION"]), np.arange(len(numbers["POSITION"]), dtype=np.uint32)
                          .reshape(-1, 3), quantization_bits=16, preserve_order=True, generic_attributes={
                              7: np.asarray(numbers["JOINTS_0"]).astype(np.uint16),
                              8: np.asarray(numbers["WEIGHTS_0"])})
    decoded = {attribute["attribute_type"]: attribute["unique_id"] for attribute in draco.decode(packed).attributes}
    for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"):
        own = document["accessors"][primitive["attributes"][name]]
        own.pop("bufferView")
        own.pop("byteOffset", None)
    primitive["attributes"] = {name: primitive["attributes"][name] for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")}
    binary = file.binary + bytes(-len(file.binary) % 4)
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(packed)})
    document["accessors"].append({"componentType": 5125, "type": "SCALAR", "count": len(numbers["POSITION"])})
    primitive["indices"] = len(document["accessors"]) - 1
    primitive["extensions"] = {DRACO: {"bufferView": len(document["bufferViews"]) - 1, "attributes": {
        "POSITION": decoded[0], "JOINTS_0": 7, "WEIGHTS_0": 8}}}
    document["buffers"][0]["byteLength"] = len(binary) + len(packed)
    document["extensionsUsed"] = document["extensionsRequired"] = [DRACO]
    return save(target, document, binary + bytes(packed))


PACKED: dict[str, Callable[[Path, Path], Path]] = {MESHOPT: with_meshopt, DRACO: with_draco}


@pytest.mark.parametrize("name", sorted(PACKED))
def test_a_compressed_character_is_read_and_written_as_the_plain_one(name: str, tmp_path: Path) -> None:
    source = write_character(tmp_path / "plain.glb", seed=3)
    packed = PACKED[name](source, tmp_path / "packed.glb")
    plain, same = read_character(source), read_character(packed)
    assert plain.bind is not None and same.bind is not None
    np.testing.assert_allclose(same.bind, plain.bind, atol=1e-6)
    np.testing.assert_array_equal(same.flesh_nodes, plain.flesh_nodes)
    np.testing.assert_allclose(same.flesh, plain.flesh, atol=1e-4)
    np.testing.assert_allclose(same.skin.points[same.skin.triangles], plain.skin.points[plain.skin.triangles],
                               atol=1e-4)
    made = perform(0.5, skeleton=FINGERED)
    moved = [replace(made, character=retarget(made.motion, path)) for path in (source, packed)]
    out = GlbFile.parse(write(tmp_path / "out.glb", moved[1]).read_bytes())
    before = GlbFile.parse(packed.read_bytes())
    count = len(before.document["bufferViews"])
    assert out.document["bufferViews"][:count] == before.document["bufferViews"], "compressed as it was"
    assert out.document["buffers"][1:] == before.document["buffers"][1:] and out.binary.startswith(before.binary[:-4])
    assert out.document["extensionsRequired"] == [name]
    expected = GlbFile.parse(write(tmp_path / "same.glb", moved[0]).read_bytes())
    np.testing.assert_allclose(out.worlds(0), expected.worlds(0), atol=1e-5)


@pytest.mark.parametrize("name", sorted(PACKED))
def test_without_its_package_a_compression_is_named_with_what_unpacks_it(
        name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = PACKED[name](write_character(tmp_path / "plain.glb"), tmp_path / "packed.glb")
    monkeypatch.setitem(gltf_compression.PACKAGES, name, "no_such_package")
    with pytest.raises(InputError) as refused:
        read_character(packed)
    assert name in str(refused.value) and install_line("compressed") in str(refused.value)
    assert "npx @gltf-transform/cli copy" in str(refused.value)


@pytest.mark.parametrize("change", [
    {"count": -1}, {"count": 10**12}, {"byteStride": 3}, {"mode": "ODD"}, {"filter": []}, {"byteOffset": 1 << 40},
    {"buffer": 9}, {"byteLength": 8}])
def test_a_compression_that_contradicts_itself_is_refused_in_one_line(change: dict[str, Any], tmp_path: Path) -> None:
    packed = with_meshopt(write_character(tmp_path / "plain.glb"), tmp_path / "packed.glb")
    file = GlbFile.parse(packed.read_bytes())
    matrices = file.document["accessors"][file.document["skins"][0]["inverseBindMatrices"]]["bufferView"]
    file.document["bufferViews"][matrices]["extensions"][MESHOPT] |= change
    with pytest.raises(InputError) as refused:
        read_character(save(tmp_path / "bad.glb", file.document, file.binary))
    assert "\n" not in str(refused.value) and "bad.glb" in str(refused.value)


@pytest.mark.parametrize("name", sorted(PACKED))
def test_garbage_in_a_compressed_part_is_refused(name: str, tmp_path: Path) -> None:
    packed = PACKED[name](write_character(tmp_path / "plain.glb"), tmp_path / "packed.glb")
    file = GlbFile.parse(packed.read_bytes())
    views = file.document["bufferViews"]
    part = (views[-1] if name == DRACO else next(view for view in views if "extensions" in view)["extensions"][MESHOPT])
    start = part["byteOffset"]
    garbage = file.binary[:start] + b"\xff" * part["byteLength"] + file.binary[start + part["byteLength"]:]
    with pytest.raises(InputError, match=name):
        read_character(save(tmp_path / "bad.glb", file.document, garbage))


# ---------------------------------------------------------------------------------------------------- several

def two_in_one(tmp_path: Path) -> Path:
    """Two characters of other rest axes side by side, the second with joints of its own names."""
    table = {joint: "b_" + name.removeprefix("mixamorig:") for joint, name in MIXAMO.items()}
    one, two = (GlbFile.parse(write_character(tmp_path / f"{name}.glb", seed=seed, table=rows).read_bytes())
                for name, seed, rows in (("one", 1, MIXAMO), ("two", 2, table)))
    document, binary = copy.deepcopy(one.document), one.binary + bytes(-len(one.binary) % 4)
    first = {name: len(document.get(name, [])) for name in ("nodes", "accessors", "bufferViews", "meshes", "skins")}
    other = copy.deepcopy(two.document)
    for view in other["bufferViews"]:
        view["byteOffset"] = view.get("byteOffset", 0) + len(binary)
    for accessor in other["accessors"]:
        accessor["bufferView"] += first["bufferViews"]
    for node in other["nodes"]:
        node["children"] = [child + first["nodes"] for child in node.get("children", [])]
        if not node["children"]:
            del node["children"]
        for key, rows in (("mesh", "meshes"), ("skin", "skins")):
            if key in node:
                node[key] += first[rows]
    for skin in other["skins"]:
        skin["joints"] = [node + first["nodes"] for node in skin["joints"]]
        skin["inverseBindMatrices"] += first["accessors"]
        if "skeleton" in skin:
            skin["skeleton"] += first["nodes"]
    for mesh in other["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["attributes"] = {
                key: value + first["accessors"] for key, value in primitive["attributes"].items()}
            primitive.pop("material", None)
    for name in first:
        document[name] += other[name]
    document["scenes"][0]["nodes"] += [node + first["nodes"] for node in other["scenes"][0]["nodes"]]
    tops = [node for node in document["nodes"] if node.get("name") == "Armature"]
    for node, name in zip(tops, ("Ann", "Bob"), strict=True):
        node["name"] = name
    document["buffers"][0]["byteLength"] = len(binary) + len(two.binary)
    return save(tmp_path / "both.glb", document, binary + two.binary)


def test_of_several_characters_the_named_one_moves(tmp_path: Path) -> None:
    both = two_in_one(tmp_path)
    whole = read_character(both)
    assert list(skeletons_of(whole)) == ["Ann", "Bob"]
    for name, prefix in (("Ann", "mixamorig:"), ("Bob", "b_")):
        character, mapping = choose(f"{both}#{name}")
        assert all(character.names[node].startswith(prefix) for node in mapping.joints.values()
                   if node is not None), name
        note = note_of(character if name == "Bob" else whole, mapping.joints["Hips"])
        assert name == "Bob" or ("holds 2 skeletons, of which Ann is used" in note and "both.glb#Bob" in note)
        made = perform(0.5, skeleton=FINGERED)
        alone = "one" if name == "Ann" else "two"
        moved = retarget(made.motion, f"{both}#{name}")
        expected = retarget(made.motion, tmp_path / f"{alone}.glb")
        places = expected.world_matrices()[:, expected.joints["LeftHand"], :3, 3]
        np.testing.assert_allclose(moved.world_matrices()[:, moved.joints["LeftHand"], :3, 3], places, atol=1e-6)
        out = GlbFile.parse(write(tmp_path / "out.glb", replace(made, character=moved)).read_bytes())
        names = out.names()
        assert all(names[channel["target"]["node"]].startswith(prefix)
                   for channel in out.document["animations"][0]["channels"])
    with pytest.raises(InputError, match="choose among Ann, Bob"):
        read_character(f"{both}#Eve")


def test_a_matrix_that_is_not_animated_stays_a_matrix(tmp_path: Path) -> None:
    file = GlbFile.parse(write_character(tmp_path / "plain.glb").read_bytes())
    sheared = [1.0, 0.0, 0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 1.0]
    file.document["nodes"].append({"name": "prop", "matrix": sheared})
    file.document["scenes"][0]["nodes"].append(len(file.document["nodes"]) - 1)
    path = save(tmp_path / "matrix.glb", file.document, file.binary)
    made = perform(0.5, skeleton=FINGERED)
    out = GlbFile.parse(write(tmp_path / "o.glb", replace(made, character=retarget(made.motion, path))).read_bytes())
    assert out.document["nodes"] == file.document["nodes"]
