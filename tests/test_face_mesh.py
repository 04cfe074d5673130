"""Blend shapes of a face in GLB, USD and FBX, as the libraries of these formats read them."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from performances import perform, write
from small_characters import write_character
from test_face_files import JAW, add_bones, add_shapes, still, with_face

from data_module.errors import InputError
from data_module.types import Array
from gesticulator.characters.blender import check_blender, run_in_blender
from gesticulator.characters.gltf_file import read_gltf
from gesticulator.characters.retarget import retarget
from gesticulator.export.own_fbx import SCRIPT
from gesticulator.face.mesh import INSIDE, face_mesh, weights
from gesticulator.face.motion import FaceMotion, at_rest
from gesticulator.face.shapes import ARKIT, arkit, jaw_angles
from gesticulator.face.visemes import VISEMES
from gesticulator.performance import Performance

HERE = Path(__file__).resolve().parent


def shown(face: FaceMotion) -> Array:
    """[V, 3] the head of the first frame of a face."""
    mesh = face_mesh()
    shares = dict(zip(ARKIT, weights(face)[0], strict=True))
    return mesh.positions + sum(shares[name] * moved for name, moved in mesh.shapes.items())


def test_the_mouth_of_the_mesh_opens_and_its_lids_shut() -> None:
    mesh = face_mesh()
    assert {"jawOpen", "mouthPucker", "eyeBlinkLeft", "browInnerUp"} <= set(mesh.shapes) < set(ARKIT)
    inside = np.flatnonzero((mesh.colours == INSIDE).all(axis=1))
    wide, rest = at_rest(1, 30.0), at_rest(1, 30.0)
    wide.visemes[0] = np.eye(15)[VISEMES.index("aa")]

    def gap(points: Array) -> float:
        return float(np.ptp(points[inside, 1]))

    assert gap(shown(wide)) > gap(shown(rest)) + 0.02 and gap(shown(rest)) < 0.003
    shut = shown(replace(rest, blink=np.ones(1)))
    lids = np.flatnonzero(np.abs(mesh.shapes["eyeBlinkLeft"]).max(axis=1) > 0)
    assert shut[lids, 1].min() < 0.094 and mesh.positions[lids, 0].min() > 0, "the left eye is at +X"
    left = shown(replace(rest, gaze=np.array([[0.3, 0.0]])))
    iris = np.flatnonzero(np.abs(mesh.shapes["eyeLookOutLeft"]).max(axis=1) > 0)
    assert left[iris, 0].mean() > mesh.positions[iris, 0].mean() + 0.002


def test_faces_look_ahead() -> None:
    """Triangles turn their front to where their normals point."""
    mesh = face_mesh()
    a, b, c = (mesh.positions[mesh.triangles[:, corner]] for corner in range(3))
    front = np.cross(b - a, c - a)
    size = np.linalg.norm(front, axis=1)
    agree = np.einsum("fk,fk->f", front, mesh.normals[mesh.triangles[:, 0]]) > 0
    assert agree[size > 1e-9].mean() > 0.99


def test_a_glb_of_our_figure_has_a_head_with_shapes(tmp_path: Path) -> None:
    made = with_face(perform(1.0))
    file = read_gltf(write(tmp_path / "a.glb", made))
    names = [entry.get("name") for entry in file.rows("nodes")]
    head, node = names.index("Head"), names.index("Face")
    assert node in file.rows("nodes")[head]["children"]
    targets = file.rows("meshes")[file.rows("nodes")[node]["mesh"]]["extras"]["targetNames"]
    animation = file.rows("animations")[0]
    channel = next(one for one in animation["channels"] if one["target"] == {"node": node, "path": "weights"})
    values = file.array(animation["samplers"][channel["sampler"]]["output"]).reshape(-1, len(targets))
    assert made.face is not None
    for name, curve in arkit(made.face).items():
        if name in targets:
            np.testing.assert_allclose(values[:, targets.index(name)], curve, atol=1e-6)
    plain = read_gltf(write(tmp_path / "plain.glb", perform(1.0)))
    assert "Face" not in [entry.get("name") for entry in plain.rows("nodes")]


def test_khronos_finds_no_fault_in_it(tmp_path: Path) -> None:
    node, js = shutil.which("node"), HERE / "js"
    if node is None or not (js / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("the validator is not installed: npm ci --prefix tests/js")
    path = write(tmp_path / "a.glb", with_face(perform(1.0)))
    done = subprocess.run([node, "validate.js", str(path)], cwd=js, capture_output=True, text=True, check=True)
    report = json.loads(done.stdout)
    assert (report["errors"], report["warnings"]) == (0, 0), report["messages"][:3]


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_usd_has_blend_shapes_as_pixars_own_library_reads_them(tmp_path: Path, suffix: str) -> None:
    skel = pytest.importorskip("pxr.UsdSkel")
    from pxr import Usd, UsdGeom, Vt

    made = with_face(perform(1.0))
    assert made.face is not None
    stage = Usd.Stage.Open(str(write(tmp_path / f"a{suffix}", made)))
    cache, root = skel.Cache(), skel.Root(stage.GetDefaultPrim())
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkelQuery(next(skel.Skeleton(prim) for prim in stage.Traverse() if prim.IsA(skel.Skeleton)))
    animation = query.GetAnimQuery()
    assert list(animation.GetBlendShapeOrder()) == list(ARKIT)
    for frame in (0, 12, 24):
        wanted = [arkit(made.face)[name][frame] for name in ARKIT]
        np.testing.assert_allclose(animation.ComputeBlendShapeWeights(frame), wanted, atol=1e-6)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Character/Face"))
    skin = cache.GetSkinningQuery(mesh.GetPrim())
    blend = skel.BlendShapeQuery(skel.BindingAPI(mesh.GetPrim()))
    frame = 12  # in a
    ours = Vt.FloatArray(animation.ComputeBlendShapeWeights(frame))
    mapped = skin.GetBlendShapeMapper().Remap(ours)
    weights_, shapes, subs = blend.ComputeSubShapeWeights(mapped)
    points = Vt.Vec3fArray(mesh.GetPointsAttr().Get())
    assert blend.ComputeDeformedPoints(weights_, shapes, subs, blend.ComputeBlendShapePointIndices(),
                                       blend.ComputeSubShapePointOffsets(), points)
    np.testing.assert_allclose(points, shown(made.face[frame:frame + 1]), atol=1e-6)
    # The head moves with its joint.
    assert skin.IsRigidlyDeformed()
    place = skin.ComputeSkinnedTransform(query.ComputeSkinningTransforms(frame), frame)
    assert place.ExtractTranslation() == pytest.approx(made.positions()[frame, made.joints.index("Head")], abs=1e-5)
    plain = Usd.Stage.Open(str(write(tmp_path / f"plain{suffix}", perform(1.0))))
    assert not plain.GetPrimAtPath("/Character/Face")
    assert b"blendShape" not in (tmp_path / f"plain{suffix}").read_bytes()


@pytest.fixture
def blender(tmp_path: Path) -> None:
    """Skips the test, with the reason, where there is no Blender."""
    try:
        check_blender(tmp_path)
    except InputError as lacking:
        pytest.skip(str(lacking))


def in_blender(path: Path, made: Performance) -> dict[str, dict[str, Array]]:
    """Mesh -> shape key -> its values in Blender at the frames of the face."""
    target = path.with_suffix(".json")
    run_in_blender(path, HERE / "blender_shapes.py", str(path), f"{made.fps:g}", str(target))
    told = json.loads(target.read_text())
    assert made.face is not None
    # Blender counts the frames of an FBX file from 1.
    return {mesh: {name: np.array(entry["values"][1:len(made.face) + 1]) for name, entry in keys.items()
                   if entry["moves"] > 0} for mesh, keys in told.items()}


@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize("own", [True, False], ids=["our figure", "a character"])
def test_shape_keys_of_fbx_as_blender_reads_them(tmp_path: Path, own: bool) -> None:
    made = with_face(perform(1.0))
    assert made.face is not None
    if not own:
        path = add_shapes(write_character(tmp_path / "a.glb"), ["Fat", *ARKIT])
        made = replace(made, character=still(path, made))
    (keys,) = in_blender(write(tmp_path / "talk.fbx", made), made).values()
    wanted = arkit(made.face)
    assert {"jawOpen", "mouthPressLeft", "eyeBlinkLeft"} <= set(keys)
    for name, curve in wanted.items():
        if name in keys:
            np.testing.assert_allclose(keys[name], curve, atol=2e-3, err_msg=name)


@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize("suffix", [".glb", ".fbx"])
def test_a_character_from_fbx_shows_the_face_with_its_shape_keys(tmp_path: Path, suffix: str) -> None:
    add_shapes(write_character(tmp_path / "a.glb"), ["Empty", "Fat", *ARKIT])
    run_in_blender(tmp_path, SCRIPT, str(tmp_path / "a.glb"), str(tmp_path / "a.fbx"), "30")
    made = with_face(perform(1.0))
    made = replace(made, character=retarget(made.motion, tmp_path / "a.fbx"))
    assert made.face is not None
    path = write(tmp_path / f"talk{suffix}", made)
    (keys,) = (in_blender(path, made) if suffix == ".fbx" else in_glb(path)).values()
    assert {"jawOpen", "mouthPressLeft", "eyeBlinkLeft"} <= set(keys)
    for name, curve in arkit(made.face).items():
        if name in keys:
            np.testing.assert_allclose(keys[name], curve, atol=2e-3, err_msg=name)
    assert not keys["Fat"].any()
    plain = write(tmp_path / f"plain{suffix}", replace(made, face=None))
    still_keys = in_blender(plain, made) if suffix == ".fbx" else in_glb(plain)
    assert not any(values.any() for keys in still_keys.values() for values in keys.values())


def in_glb(path: Path) -> dict[str, dict[str, Array]]:
    """As `in_blender`, of a GLB file as we read it: only meshes whose weights are animated."""
    file, out = read_gltf(path), {}
    animation = file.rows("animations")[0]
    for channel in animation["channels"]:
        if channel["target"]["path"] == "weights":
            node = file.rows("nodes")[channel["target"]["node"]]
            names = file.rows("meshes")[node["mesh"]]["extras"]["targetNames"]
            values = file.array(animation["samplers"][channel["sampler"]]["output"]).reshape(-1, len(names))
            out[node["name"]] = dict(zip(names, values.T, strict=True))
    return out


@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize("suffix", [".glb", ".fbx"])
def test_the_jaw_bone_of_a_character_from_fbx_opens_downwards(tmp_path: Path, suffix: str) -> None:
    add_bones(write_character(tmp_path / "a.glb"), JAW)
    run_in_blender(tmp_path, SCRIPT, str(tmp_path / "a.glb"), str(tmp_path / "a.fbx"), "30")
    made = with_face(perform(1.0))
    made = replace(made, character=still(tmp_path / "a.fbx", made))
    assert made.face is not None
    path, target = write(tmp_path / f"talk{suffix}", made), tmp_path / "told.json"
    run_in_blender(path, HERE / "blender_joints.py", str(path), f"{made.fps:g}", str(target))
    frames = json.loads(target.read_text())["frames"]
    chin = np.array([np.subtract(frame["Chin"], frame["Jaw"]) for frame in frames])[:len(made.face)]
    chin /= np.linalg.norm(chin, axis=1, keepdims=True)
    down = np.arcsin(chin[0, 2]) - np.arcsin(chin[:, 2])  # Z is up, and the first mouth is shut
    np.testing.assert_allclose(down, jaw_angles(made.face), atol=np.radians(0.2))
    assert down.max() > np.radians(10.0)
