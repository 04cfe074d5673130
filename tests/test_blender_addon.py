"""The Blender add-on, in Blender and without a screen, with the program and the weights that are shipped."""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from performances import write_example
from small_characters import AUTO_RIG, HUMANOID, MIXAMO, VROID, write_character

from data_module.types import Array
from gesticulator import Gesticulator
from gesticulator.characters.blender import run_in_blender
from gesticulator.cli import __version__
from gesticulator.performance import Performance

HERE = Path(__file__).resolve().parent
FPS, SECONDS = 24, 3.0
RIGS = {
    "mixamo": (MIXAMO, "mixamorig:{side}Arm", "mixamorig:{side}ForeArm", "mixamorig:{side}Hand", ""),
    "vroid": (VROID, "J_Bip_{side[0]}_UpperArm", "J_Bip_{side[0]}_LowerArm", "J_Bip_{side[0]}_Hand", ""),
    "vrm humanoid": (HUMANOID, "{small}UpperArm", "{small}LowerArm", "{small}Hand", ""),
    "auto-rig": (AUTO_RIG, "arm_stretch.{small[0]}", "forearm_stretch.{small[0]}", "hand.{small[0]}", ""),
    "metarig": (None, "upper_arm.{side[0]}", "forearm.{side[0]}", "hand.{side[0]}", "toe.{side[0]}"),
    "rigify": (None, "DEF-upper_arm.{side[0]}", "DEF-forearm.{side[0]}", "DEF-hand.{side[0]}", "DEF-toe.{side[0]}"),
}
"""Kind of armature -> the names of its bones where we write it, its bones of an arm, its toes."""


@pytest.fixture(scope="module")
def spoken(blender: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Performance]:
    """A recording, and the gesture that the program makes of it on our own skeleton."""
    sound = write_example(tmp_path_factory.mktemp("sound") / "speech.wav", SECONDS)
    return sound, Gesticulator.from_pretrained()(sound, fps=FPS, legs=True)


def test_the_extension_has_a_manifest_that_blenders_validator_accepts(tmp_path: Path) -> None:
    folder = HERE.parent / "integrations" / "blender" / "gesticulator_blender"
    manifest = tomllib.loads((folder / "blender_manifest.toml").read_text())
    assert manifest["version"] == __version__
    assert manifest["id"] == folder.name and manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    named = os.environ.get("GESTICULATOR_BLENDER", sys.executable)
    program = next((path for root in Path(named).parent.parent.glob("lib/python*/site-packages/bpy")
                    for path in root.rglob("blender_ext.py")), None)
    if program is None:
        pytest.skip("no Blender as a module, and so no validator")

    def blender(*words: str | Path) -> None:
        done = subprocess.run([named, program, *words], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    blender("validate", folder)
    # What is uploaded to the list of extensions, or installed from the disk.
    blender("build", "--source-dir", folder, "--output-dir", tmp_path)
    (package,) = tmp_path.iterdir()
    blender("validate", package)
    assert set(zipfile.ZipFile(package).namelist()) == {"__init__.py", "blender_manifest.toml"}


@pytest.mark.parametrize("kind", sorted(RIGS))
def test_an_armature_moves_as_our_own_skeleton_does(kind: str, spoken: tuple[Path, Performance], tmp_path: Path
                                                    ) -> None:
    sound, made = spoken
    program = tmp_path / "gesticulator"
    program.write_text(f'#!/bin/sh\nPYTHONPATH="{HERE.parent}" exec "{sys.executable}" -m gesticulator "$@"\n')
    program.chmod(0o755)
    table, *arm, toe = RIGS[kind]
    rig = kind if table is None else str(write_character(tmp_path / "her.glb", table=table))
    run_in_blender(tmp_path, HERE / "blender_addon.py", rig, str(sound), str(program), str(FPS),
                   str(tmp_path / "out.json"))
    told = json.loads((tmp_path / "out.json").read_text())
    if "lacking" in told:
        pytest.skip(told["lacking"])
    assert told["range"] == [10, 9 + len(made.motion)] and told["strips"] == [["SOUND", 10]]
    assert told["action"].startswith("gesture speech")

    def bone(start: str, end: str) -> Array:
        """[T, 3] its direction, Y up."""
        way = np.array([np.subtract(frame[end], frame[start]) for frame in told["frames"]])[:, [0, 2, 1]] * [1, 1, -1]
        return way / np.linalg.norm(way, axis=1, keepdims=True)

    places = made.positions()
    for side in ("Left", "Right"):
        names = [name.format(side=side, small=side.lower()) for name in arm]
        ours = [made.joints.index(side + name) for name in ("Arm", "ForeArm", "Hand")]
        for k in (0, 1):
            expected = places[:, ours[k + 1]] - places[:, ours[k]]
            expected /= np.linalg.norm(expected, axis=1, keepdims=True)
            apart = np.degrees(np.arccos(np.clip(np.sum(bone(names[k], names[k + 1]) * expected, axis=1), -1, 1)))
            # Hands that would enter her trunk are kept outside, which moves an arm for a while.
            assert np.median(apart) < 1.0, (side, k, apart.max())
        if toe:
            toes = np.array([frame[toe.format(side=side)] for frame in told["frames"]])
            assert np.ptp(toes, axis=0).max() < 0.02, "she stands"
    assert np.ptp(bone(names[1], names[2]), axis=0).max() > 0.1, "she moves"
    if kind == "rigify":  # what an animator goes on with
        assert {"torso", "chest", "upper_arm_fk.L", "hand_fk.R", "foot_fk.L", "f_index.02.R", "upper_arm_parent.L"
                } <= set(told["keyed"])
        assert not [name for name in told["keyed"] if name.startswith(("DEF-", "ORG-", "MCH-"))]
