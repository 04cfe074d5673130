"""Strokes of the clips that SmartBody publishes: real files, and broken ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer.commands import SMARTBODY
from gesticulator_performer.smartbody import SmartBody
from gesticulator_performer.strokes import load_strokes

from data_module.errors import InputError
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import read_bvh


def test_the_published_clips_give_the_motion_of_the_strokes(outside_data: Path, tmp_path: Path) -> None:
    out = tmp_path / "strokes"
    assert SMARTBODY.main("gesticulator smartbody", [str(outside_data / "smartbody_original"), "--out", str(out)]) == 0
    files = sorted(file.relative_to(out) for file in out.rglob("*.bvh"))
    assert len(files) == 8
    for file in files:
        ours, theirs = (read_bvh(folder / file, unit=1.0) for folder in (out, outside_data / "strokes"))
        assert ours.skeleton.same_joints(theirs.skeleton), file
        assert (len(ours), ours.fps) == (len(theirs), 30.0), file
        worlds = [kinematics.global_rotations(m.skeleton, m.rotations) for m in (ours, theirs)]
        assert rotation.angle_between(*worlds).max() < 1e-4, file
        np.testing.assert_allclose(ours.skeleton.offsets, theirs.skeleton.offsets, atol=2e-6)
        np.testing.assert_allclose(ours.root_positions, theirs.root_positions, atol=6e-5)  # theirs have four digits
    assert len(load_strokes(out).strokes) == 16, "with the mirror images"


@pytest.mark.parametrize(("part", "content", "message"), [
    ("motions/ChrBrad@Idle01_Shrug01.skm", b"hello\n", r"Shrug01\.skm: is not a SmartBody motion"),
    ("motions/ChrBrad@Idle01_Shrug01.skm", b"\xfa\xfe\x00\x81", r"Shrug01\.skm: line 1: is not text"),
    ("skeletons/ChrBrad.sk", b"root A { offset 0 0 x }", r"ChrBrad\.sk: has '0 0 x' where 3 numbers belong"),
    ("skeletons/ChrBrad.sk", b"root A { offset 0 0 0 }", r"no joint JtRoot"),
    ("skeletons/ChrBrad.sk", b"root A { offset 0 0 0", r"ChrBrad\.sk: is not a SmartBody skeleton"),
])
def test_a_broken_file_of_smartbody_is_named(tmp_path: Path, outside_data: Path, part: str, content: bytes,
                                             message: str) -> None:
    folder = tmp_path / "behaviorsets" / "Gestures"
    for name in ("skeletons/ChrBrad.sk", "motions/ChrBrad@Idle01_Shrug01.skm"):
        (folder / name).parent.mkdir(parents=True)
        shutil.copyfile(outside_data / "smartbody_original" / "Gestures" / name, folder / name)
    (folder / part).write_bytes(content)
    with pytest.raises(InputError, match=message):
        SmartBody(folder.parent).write(tmp_path / "out")
    assert not (tmp_path / "out").exists()
