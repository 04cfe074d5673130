"""The user's own character in files: her file stays as it was, and every format shows the same places."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_reader import GlbFile, save
from performances import perform, write
from small_characters import write_character

from data_module.motion.bvh import read_bvh
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import FINGERED, WHOLE_BODY
from data_module.types import Array
from gesticulator.characters.retarget import retarget
from gesticulator.characters.rig import CharacterMotion
from gesticulator.performance import Performance


def on(character: Path) -> Performance:
    made = perform(1.0, skeleton=FINGERED)
    return replace(made, character=retarget(made.motion, character))


def played(made: Performance) -> CharacterMotion:
    assert made.character is not None
    return made.character


def places(made: Performance, names: tuple[str, ...]) -> Array:
    """[T, len(names), 3] metres, by the character's own matrices."""
    moved = played(made)
    nodes = [moved.character.names.index(name) for name in names]
    return moved.world_matrices()[:, nodes][..., :3, 3] * moved.unit


@pytest.mark.parametrize("vrm", ["", "0.x", "1.0"])
def test_her_file_gains_one_animation_and_keeps_everything_else(tmp_path: Path, vrm: str) -> None:
    source = write_character(tmp_path / f"her.{'vrm' if vrm else 'glb'}", vrm=vrm)
    made = on(source)
    before = GlbFile.parse(source.read_bytes())
    after = GlbFile.parse(write(tmp_path / "out.glb", made).read_bytes())
    kept = copy.deepcopy(after.document)
    assert [animation["name"] for animation in kept.pop("animations")] == ["gesture"]
    for name in ("accessors", "bufferViews"):
        kept[name] = kept[name][:len(before.document[name])]
    kept["buffers"][0]["byteLength"] = len(before.binary)
    assert kept == before.document
    assert after.binary.startswith(before.binary)
    world = after.worlds(animation=0)
    nodes = played(made).character
    got = world[:, list(nodes.node_ids)]
    np.testing.assert_allclose(got[..., :3, 3], played(made).world_matrices()[..., :3, 3], atol=1e-5)


def test_an_animation_of_hers_stays_and_ours_comes_last(tmp_path: Path) -> None:
    first = write(tmp_path / "one.glb", on(write_character(tmp_path / "her.glb")))
    second = GlbFile.parse(write(tmp_path / "two.glb", on(first)).read_bytes())
    assert len(second.document["animations"]) == 2
    np.testing.assert_array_equal(second.worlds(0), second.worlds(1))


def test_nodes_with_a_matrix_become_nodes_that_can_turn(tmp_path: Path) -> None:
    plain = write_character(tmp_path / "her.glb")
    glb = GlbFile.parse(plain.read_bytes())
    for node, local in zip(glb.document["nodes"], _locals(glb), strict=True):
        for name in ("translation", "rotation", "scale"):
            node.pop(name, None)
        node["matrix"] = local.T.ravel().tolist()
    other = save(tmp_path / "matrix.glb", glb.document, glb.binary)
    one, two = (GlbFile.parse(write(tmp_path / f"{path.stem}_out.glb", on(path)).read_bytes())
                for path in (plain, other))
    np.testing.assert_allclose(two.worlds(0), one.worlds(0), atol=1e-5)
    np.testing.assert_allclose(two.worlds()[0], one.worlds()[0], atol=1e-6)
    animated = {channel["target"]["node"] for channel in two.document["animations"][0]["channels"]}
    assert not [node for node in animated if "matrix" in two.document["nodes"][node]]


@pytest.mark.parametrize("vrm", ["", "0.x", "1.0"])
def test_every_format_shows_the_same_places(tmp_path: Path, vrm: str) -> None:
    made = on(write_character(tmp_path / f"her.{'vrm' if vrm else 'glb'}", seed=4, vrm=vrm))
    nodes = made.scene().nodes
    assert nodes.names[0].endswith("Hips") and "Body" not in nodes.names and "Armature" not in nodes.names
    expected = places(made, nodes.names)
    np.testing.assert_allclose(nodes.positions(), expected, atol=1e-9)
    back = read_bvh(write(tmp_path / "a.bvh", made))
    order = [back.skeleton.index(name) for name in nodes.names]
    np.testing.assert_allclose(positions_of(back)[:, order], expected, atol=2e-5)
    usd = pytest.importorskip("pxr.UsdSkel")
    from pxr import Usd

    stage = Usd.Stage.Open(str(write(tmp_path / "a.usdc", made)))
    skeleton = next(usd.Skeleton(prim) for prim in stage.Traverse() if prim.IsA(usd.Skeleton))
    query = usd.Cache().GetSkelQuery(skeleton)
    got = [matrix.ExtractTranslation() for matrix in query.ComputeJointSkelTransforms(11)]
    np.testing.assert_allclose(got, expected[11], atol=1e-5)


def test_a_character_from_bvh_becomes_a_glb_in_metres(tmp_path: Path) -> None:
    made = on(write(tmp_path / "her.bvh", perform(0.5, skeleton=WHOLE_BODY)))
    assert played(made).unit == pytest.approx(0.01)
    glb = GlbFile.parse(write(tmp_path / "a.glb", made).read_bytes())
    nodes = made.scene().nodes
    names = glb.names()
    got = glb.worlds(0)[:, [names.index(name) for name in nodes.names]][..., :3, 3]
    np.testing.assert_allclose(got, places(made, nodes.names), atol=1e-5)


def _locals(glb: GlbFile) -> list[np.ndarray]:
    world = glb.worlds()[0]
    parents = {child: index for index, node in enumerate(glb.document["nodes"]) for child in node.get("children", ())}
    return [np.linalg.inv(world[parents[index]]) @ own if index in parents else own for index, own in enumerate(world)]
