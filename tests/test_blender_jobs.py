"""Jobs that share one Blender: a plain Python takes the place of one, and scripts that need no bpy."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from gesticulator.characters.blender import VARIABLE, check_blender, job_in_blender, run_in_blender
from gesticulator.characters.fbx_rig import kept_scene, read_fbx_character
from gesticulator.export.fbx import SCRIPT as WRITE
from gesticulator.export.fbx_child import needed, played, reduce_keys, turned_by
from tests.rigs import as_glb, draw

SCRIPT = """import json, os, sys
given = sys.argv[sys.argv.index("--") + 1:]
if given[1] == "fails":
    raise ValueError("no armature here")
if given[1] == "dies":
    print("out of memory", flush=True)
    os._exit(3)
with open(given[0], "w") as file:
    json.dump([os.getpid(), given[1:], os.environ.get("PYTHONHASHSEED"), "kept" in globals()], file)
kept = True
"""


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A script for the stand-in."""
    monkeypatch.setenv(VARIABLE, sys.executable)
    path = tmp_path / "job.py"
    path.write_text(SCRIPT)
    return path


def done(script: Path, *arguments: str) -> list[object]:
    """What a job wrote."""
    target = script.with_name("out.json")
    job_in_blender(Path("rig.fbx"), script, str(target), *arguments)
    found: list[object] = json.loads(target.read_text())
    return found


def test_jobs_share_one_process_and_leave_nothing_to_each_other(script: Path) -> None:
    first, second = done(script, "a b", "ä"), done(script, 'quote "')
    assert first[0] == second[0] != os.getpid()
    assert (first[1], second[1]) == (["a b", "ä"], ['quote "'])
    assert first[2] == second[2] == "0", "the exporter numbers objects by hashes"
    assert first[3] is second[3] is False


def test_an_error_names_the_file_and_the_next_job_is_done(script: Path) -> None:
    before = done(script, "first")
    with pytest.raises(InputError, match=r"rig\.fbx.*rejected by Blender \(ValueError: no armature here\)"):
        done(script, "fails")
    assert done(script, "second")[0] == before[0]


def test_a_blender_that_dies_is_started_again(script: Path) -> None:
    before = done(script, "first")
    with pytest.raises(InputError, match=r"rejected by Blender \(out of memory\)"):
        done(script, "dies")
    assert done(script, "second")[0] != before[0]


def test_a_blender_that_is_not_there_is_one_line(script: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(script.with_name("python-of-nowhere")))
    with pytest.raises(InputError, match="cannot be run"):
        done(script, "first")


def test_the_scene_that_blender_keeps_gives_the_file_that_the_character_gives(tmp_path: Path) -> None:
    """And it is taken only while the file is the same."""
    try:
        check_blender(tmp_path)
    except InputError as error:
        pytest.skip(str(error))
    rig, other = tmp_path / "rig.fbx", tmp_path / "other.fbx"
    for seed, target in ((3, rig), (4, other)):
        glb = tmp_path / "rig.glb"
        glb.write_bytes(as_glb(draw(seed, "mixamo", "A")))
        run_in_blender(glb, WRITE, str(glb), str(target), "30")
    character, kept = read_fbx_character(rig), kept_scene(rig)
    np.savez(tmp_path / "motion.npz", names=np.array([character.names[4]]), shifts=np.zeros((0, 3)),
             hips=np.array([""]), turns=np.array([[[1.0, 0.0, 0.0, 0.0]], [[0.6, 0.8, 0.0, 0.0]]]))
    made = []
    for number, source in enumerate((kept, rig)):
        target = tmp_path / f"{number}.fbx"
        job_in_blender(rig, WRITE, str(source), str(target), "30.0", "0.1", "take", str(tmp_path / "motion.npz"))
        made.append(target.read_bytes())
    assert made[0] == made[1] != rig.read_bytes()
    rig.write_bytes(other.read_bytes())
    assert kept.exists() and kept_scene(rig) != kept
    assert read_fbx_character(rig).names != character.names


def test_the_turn_between_rotations_of_nearly_equal_angles_is_scipys() -> None:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-170.0, 170.0, (3, 500))
    others = angles + rng.normal(0.0, 0.05, (3, 500))
    a, b = (Rotation.from_euler("xyz", rows.T, degrees=True) for rows in (angles, others))
    truth = np.degrees((a.inv() * b).magnitude())
    measured = [turned_by(angles[:, k:k + 1], others[:, k:k + 1]) for k in range(500)]
    np.testing.assert_allclose(measured, truth, rtol=2e-3)


def test_reduced_keys_keep_a_rotation_within_the_bound_and_are_fewer_than_a_third_of_it_for_each_angle_needs() -> None:
    time = np.arange(721) / 60.0
    values = np.stack([20.0 * np.sin(2.0 * time), 35.0 + 10.0 * np.sin(3.1 * time + 1.0), 15.0 * np.cos(1.3 * time)])
    curves = SimpleNamespace(fbx_group=["Lcl Rotation"], default_values=(0.0, 0.0, 0.0), _frame_values_array=values,
                             _frame_write_mask_array=np.ones(values.shape, dtype=bool))
    reduce_keys(curves, 0.1)
    masks = curves._frame_write_mask_array
    a, b = (Rotation.from_euler("xyz", rows.T, degrees=True) for rows in (values, played(values, masks)))
    assert 0.05 < np.degrees((a.inv() * b).magnitude()).max() <= 0.1
    assert masks.sum() < 0.85 * sum(needed(row, 0.1 / 3.0).sum() for row in values)
    curves.default_values = tuple(values[:, 0])
    curves._frame_values_array = np.repeat(values[:, :1], 721, axis=1)
    reduce_keys(curves, 0.1)
    assert not curves._frame_write_mask_array.any(), "none where it stays at its default"
