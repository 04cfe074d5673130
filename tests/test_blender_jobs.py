"""Jobs in Blender, for which a plain Python stands in, with scripts that need no bpy; keys that its exporter keeps."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from gesticulator.characters.blender import VARIABLE, run_in_blender
from gesticulator.export.blender_child import needed, reduce_keys

SCRIPT = """import json, os, sys
if sys.argv[2] == "fails":
    print("Location: /ops.py:109", file=sys.stderr) if len(sys.argv) > 3 else None
    raise ValueError("no armature here")
with open(sys.argv[1], "w") as file:
    json.dump([sys.argv[2:], os.environ.get("PYTHONHASHSEED"), "PYTHONPATH" in os.environ], file)
"""


@pytest.mark.parametrize(("blender", "argument", "wrong"), [
    (sys.executable, 'a b "ä', ""),
    (sys.executable, "fails", r"rig\.fbx.*rejected by Blender \(ValueError: no armature here\)"),
    ("/no/where/python", "", "cannot be run"),
])
def test_a_job_runs_in_the_blender_of_the_environment(blender: str, argument: str, wrong: str, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, blender)
    monkeypatch.setenv("PYTHONPATH", "/of/this/process")
    script, target = tmp_path / "job.py", tmp_path / "out.json"
    script.write_text(SCRIPT)
    if wrong:
        with pytest.raises(InputError, match=wrong):
            run_in_blender(Path("rig.fbx"), script, str(target), argument)
    else:
        run_in_blender(Path("rig.fbx"), script, str(target), argument)
        assert json.loads(target.read_text()) == [[argument], "0", False], "the exporter numbers objects by hashes"


def test_reduced_keys_keep_a_rotation_within_the_bound_and_are_fewer_than_a_third_of_it_for_each_angle_needs() -> None:
    time = np.arange(721) / 60.0
    values = np.stack([20.0 * np.sin(2.0 * time), 35.0 + 10.0 * np.sin(3.1 * time + 1.0), 15.0 * np.cos(1.3 * time)])
    curves = SimpleNamespace(fbx_group=["Lcl Rotation"], default_values=(0.0, 0.0, 0.0), _frame_values_array=values,
                             _frame_write_mask_array=np.ones(values.shape, dtype=bool))
    reduce_keys(curves, 0.1)
    masks = curves._frame_write_mask_array
    frames = np.arange(721)
    played = np.stack([np.interp(frames, frames[mask], row[mask]) for row, mask in zip(values, masks, strict=True)])
    a, b = (Rotation.from_euler("xyz", rows.T, degrees=True) for rows in (values, played))
    assert 0.05 < np.degrees((a.inv() * b).magnitude()).max() <= 0.1
    assert masks.sum() < 0.95 * sum(needed(row, 0.1 / 3.0).sum() for row in values)
    curves.default_values = tuple(values[:, 0])
    curves._frame_values_array = np.repeat(values[:, :1], 721, axis=1)
    reduce_keys(curves, 0.1)
    assert not curves._frame_write_mask_array.any(), "none where it stays at its default"
