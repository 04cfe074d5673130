"""The files in the tools that they are made for: the Khronos validator, three.js with three-vrm, Blender.

Each part is skipped, with the reason, where its tool is not installed.
"""

import json
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import package_page
from gltf_reader import GlbFile
from performances import perform, write
from small_characters import write_character
from test_js_three import FRAMES, TIMES, VRMS, check_bones

from data_module.motion.skeletons import CHARACTERS, FINGERED, WHOLE_BODY
from gesticulator.characters.blender import SCRIPT, run_in_blender
from gesticulator.characters.retarget import retarget
from gesticulator.performance import Performance

HERE = Path(__file__).resolve().parent
JS = HERE / "js"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Path], dict[str, Performance]]:
    """One file of each kind, and the performance that it shows."""
    folder = tmp_path_factory.mktemp("files")
    made = {f"ours{size}": perform(1.0, skeleton=skeleton) for size, skeleton in CHARACTERS.items()}
    plain = made[f"ours{len(FINGERED)}"]
    rigs = {"mixamo": write_character(folder / "her.glb")}
    rigs |= {name: write_character(folder / f"{name}.vrm", vrm=vrm) for name, vrm in VRMS.items()}
    made |= {name: replace(plain, character=retarget(plain.motion, source)) for name, source in rigs.items()}
    paths = {f"{name}.glb": write(folder / f"{name}.glb", own) for name, own in made.items()}
    paths |= {f"{name}.vrma": write(folder / f"{name}.vrma", own) for name, own in made.items()}
    paths |= {source.name: source for source in rigs.values()}
    return paths, made


# ---------------------------------------------------------------------------------------------------- glTF

def test_khronos_finds_no_fault(files: tuple[dict[str, Path], dict[str, Performance]]) -> None:
    node = shutil.which("node")
    if node is None or not (JS / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("the validator is not installed: npm ci --prefix tests/js")
    paths = files[0]
    broken = paths["ours16.glb"].with_name("broken.glb")
    data = paths["ours16.glb"].read_bytes()
    broken.write_bytes(data.replace(b'"SCALAR"', b'"SCALER"', 1))
    names = [*paths.values(), broken]
    done = subprocess.run([node, "validate.js", *map(str, names)], cwd=JS, capture_output=True, text=True, check=True)
    reports = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(reports) == len(names)
    for path, report in zip(names[:-1], reports[:-1], strict=True):
        if path.stem == "vrm0":  # VRM 0.x calls its extension "VRM", which has no prefix as glTF asks for
            told = [message for message in report["messages"] if message["code"] != "INVALID_EXTENSION_NAME_FORMAT"]
            assert not told and report["errors"] == 0 and report["warnings"] < 2, told
            continue
        assert (report["errors"], report["warnings"]) == (0, 0), (path.name, report["messages"][:3])
    assert reports[-1]["errors"] > 0, "the validator sees a fault where there is one"


# ---------------------------------------------------------------------------------------------------- three.js

@pytest.fixture(scope="module")
def page(browser: Any, files: tuple[dict[str, Path], dict[str, Performance]], three_js: Path) -> Iterator[Any]:
    """A page of three.js with three-vrm, without a network: what it loads comes from the disk."""
    with package_page(browser, "play.html", three_js, files[0]["ours16.glb"].parent, three_js) as window:
        yield window


@pytest.mark.parametrize("name", ["ours16", "ours54", "mixamo", *VRMS])
def test_three_js_plays_a_glb(page: Any, files: tuple[dict[str, Path], dict[str, Performance]], name: str) -> None:
    got = page.evaluate("([file, times]) => playGlb(file, times)", [f"/{name}.glb", TIMES])
    nodes = files[1][name].scene().nodes
    expected = nodes.positions()[list(FRAMES)]
    for index, joint in enumerate(nodes.names):
        # three.js leaves out the characters that its own paths need.
        np.testing.assert_allclose(got[joint.replace(":", "")], expected[:, index], atol=1e-4, err_msg=joint)


@pytest.mark.parametrize("model", VRMS)
@pytest.mark.parametrize("name", ["ours46", "ours54"])
def test_three_vrm_plays_a_vrma_on_a_vrm(page: Any, files: tuple[dict[str, Path], dict[str, Performance]], name: str,
                                         model: str) -> None:
    got = page.evaluate("([model, file, times]) => playVrma(model, file, times)",
                        [f"/{model}.vrm", f"/{name}.vrma", TIMES])
    check_bones(got, VRMS[model], files[1][name], path=True)


# ---------------------------------------------------------------------------------------------------- Blender

IN_CENTIMETRES = {"global_scale": 0.01, "update_scene_fps": True, "update_scene_duration": True}
"""What to set in Blender's importer of BVH: the rest are its defaults, as they are for all other files."""


def in_blender(path: Path, fps: float, settings: dict[str, Any]) -> dict[str, Any]:
    """What Blender makes of a file; places with Y up."""
    target = path.with_suffix(".json")
    run_in_blender(path, HERE / "blender_joints.py", str(path), f"{fps:g}", str(target), json.dumps(settings))
    told: dict[str, Any] = json.loads(target.read_text())
    for frame in told["frames"]:
        for joint, (x, y, z) in frame.items():
            frame[joint] = (x, z, -y)
    return told


@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize(("suffix", "settings"), [
    (".bvh", IN_CENTIMETRES), (".fbx", {}), (".glb", {}), (".usdc", {})])
def test_blender_puts_our_joints_where_we_do(tmp_path: Path, suffix: str, settings: dict[str, Any]) -> None:
    made = perform(0.6, 30.0, skeleton=WHOLE_BODY)
    scene = in_blender(write(tmp_path / f"a{suffix}", made), 30.0, settings)
    places = np.array([[frame[joint] for joint in made.joints] for frame in scene["frames"]])
    np.testing.assert_allclose(places, made.positions(), atol=1e-3)
    np.testing.assert_allclose(scene["scale"], 1.0, atol=1e-5)
    assert suffix != ".bvh" or 0.5 < scene["height"] < 0.8, "metres from the hips to the head"


@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize("suffix", [".fbx", ".glb"])
def test_blender_takes_a_character_with_her_skin(tmp_path: Path, suffix: str) -> None:
    plain = perform(0.4, 30.0, skeleton=FINGERED)
    made = replace(plain, character=retarget(plain.motion, write_character(tmp_path / "her.glb")))
    told = in_blender(write(tmp_path / f"a{suffix}", made), 30.0, {})
    nodes = made.scene().nodes
    got = np.array([[frame[joint] for joint in nodes.names] for frame in told["frames"]])
    np.testing.assert_allclose(got, nodes.positions(), atol=1e-3)
    assert sum(told["meshes"].values()) >= 3 * len(nodes.names)


@pytest.mark.usefixtures("blender")
def test_a_character_from_fbx_keeps_her_mesh(tmp_path: Path) -> None:
    before = GlbFile.parse(write_character(tmp_path / "her.glb").read_bytes())
    run_in_blender(tmp_path, SCRIPT, str(tmp_path / "her.glb"), str(tmp_path / "her.fbx"), "30")
    plain = perform(0.4, 25.0, skeleton=FINGERED)
    made = replace(plain, character=retarget(plain.motion, tmp_path / "her.fbx"))
    assert made.character is not None
    nodes = made.scene().nodes
    for suffix in (".fbx", ".glb"):
        told = in_blender(write(tmp_path / f"out{suffix}", made), 25.0, {})
        got = np.array([[frame[joint] for joint in nodes.names] for frame in told["frames"]])
        np.testing.assert_allclose(got, nodes.positions(), atol=1e-3)
        corners = before.numbers(before.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
        assert told["meshes"]["Body"] == len(corners)
