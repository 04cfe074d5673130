"""Jobs that share one Blender: a plain Python takes the place of one, and scripts that need no bpy."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from data_module.errors import InputError
from gesticulator.characters.blender import VARIABLE, job_in_blender

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
