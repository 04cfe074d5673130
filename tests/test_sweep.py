"""Rows and seeds at once: the same cells as one after the other, by workers and by jobs; a cell that is there stays."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from data_module.errors import InputError
from data_module.store import Store
from eval.commands import ABLATE
from eval.context import EvalContext
from eval.metrics.gesture_features import RawFeatures
from eval.rows import rg
from eval.rows.cells import PARTS, Cell, CellStore
from eval.runner import ablate, sweep
from eval.runner import rg as rg_rows
from eval.runner.rg import RgRows
from eval.runner.row import Ablation
from gesticulator.batch import TaskOutcome, done_here
from gesticulator.bundle import config as configs
from gesticulator.training.stages import Run

SHORT = ("schedules.speech.steps=1", "schedules.contrast.steps=1", "schedules.lexicon.steps=4",
         "schedules.generator.steps=2", "schedules.interpreter.steps=2", "schedules.style.steps=2")
NAMES = ("ours", "no-lexemes")


def made(row: str, seed: int, key: str = "k", **more: Any) -> Cell:
    return {"row": row, "seed": seed, "key": key, "clips": [], **more}


def test_cells_of_several_writers_are_gathered_once(tmp_path: Path) -> None:
    CellStore(tmp_path).add(made("a", 1))
    for seed in (1, 2):
        CellStore(tmp_path, alone=False).add(made("a", seed, why="of a worker"))
    CellStore(tmp_path, alone=False).add(made("b=0.1", 1))
    every = CellStore(tmp_path)
    assert every.finished("a", 2, "k") is not None and every.finished("a", 2, "other") is None
    assert len(every.lines()) == 4
    every.gather()
    assert not (tmp_path / PARTS).exists()
    assert [(cell["row"], cell["seed"]) for cell in every.lines()] == [("a", 1), ("a", 2), ("b=0.1", 1)]
    assert "why" not in every.lines()[0], "it was there"


@pytest.fixture(scope="module")
def ablation(tiny_store: Path, tmp_path_factory: pytest.TempPathFactory) -> Ablation:
    """The tiny preset, shorter still, in a work folder of its own."""
    work = tmp_path_factory.mktemp("sweep")
    first = Run(configs.with_settings(rg.tiny(), SHORT), Store.open(tiny_store), work, progress=False)
    return ablation_over(first, work / "out")


def ablation_over(first: Run, out: Path) -> Ablation:
    context = EvalContext(first, networks={"raw": RawFeatures(34, count=1)}, limit=1)
    return Ablation(RgRows(context), CellStore(out))


@pytest.fixture(scope="module")
def plain(ablation: Ablation) -> dict[tuple[str, int], Any]:
    """What is measured of each row at each seed, one after the other."""
    ablate.run_rows(ablation, NAMES, 2)
    return figures(ablation)


def figures(ablation: Ablation) -> dict[tuple[str, int], Any]:
    """Of each cell what does not tell of time."""
    return cells_of(ablation.cells.folder)


def cells_of(folder: Path) -> dict[tuple[str, int], Any]:
    return {(cell["row"], cell["seed"]): json.dumps([cell["key"], cell["clips"], cell["sets"]])
            for cell in CellStore(folder).lines() if cell["kind"] == "row"}


def test_rows_at_once_are_those_one_after_the_other(ablation: Ablation, plain: dict[tuple[str, int], Any],
                                                    tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker of its own work folder trains everything anew, in another order."""
    work = tmp_path / "work"
    first = dataclasses.replace(ablation.rg.first, work=work, _values={}, _keys={}, figures={})
    own = ablation_over(first, tmp_path / "out")
    tasks = ablate.row_seeds(NAMES, 2)
    asked: list[list[int]] = []

    def backwards(make: Any, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
        asked.append(list(numbers))
        return done_here(make, numbers[::-1])

    assert sweep.rows_at_once(own, tasks, lambda: own, backwards) == {}
    assert figures(own) == plain and asked == [[0, 1, 2, 3]]
    own.cells.file.write_text("".join(line + "\n" for line in own.cells.file.read_text().splitlines()
                                      if '"row": "ours"' not in line or '"seed": 2' not in line))
    monkeypatch.setattr(rg_rows, "assemble", lambda *given: (_ for _ in ()).throw(InputError("disk", "is gone")))
    assert sweep.rows_at_once(own, tasks, lambda: own, backwards) == {"ours, seed 2": "disk: is gone"}
    assert asked[1:] == [[2]], "the one that is missing"
    facts = ablate.ablate(own, only=NAMES, seeds=2, at_once=partial(
        sweep.rows_at_once, make=lambda: own, outcomes=backwards))
    assert facts["refused"] == {"ours, seed 2": "disk: is gone"} and facts["rows"]["ours"]["seeds"] == [1]


@pytest.fixture
def command(ablation: Ablation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The command for "ours" at its first seed, whose generator and interpreter are not trained."""
    work, context = tmp_path / "work", ablation.context
    shutil.copytree(context.work, work, ignore=shutil.ignore_patterns("generator-*", "interpreter-*", "*.lock"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))  # of other processes
    return ["--data", str(context.store.path), "--work", str(work), "--out", str(tmp_path / "out"), "--preset", "tiny",
            "--only", "ours", "--seeds", "1", "--limit", "1", "--workers", "1", "--quiet",
            *(part for setting in SHORT for part in ("--set", setting))]


def test_jobs_that_are_processes_of_this_machine_make_the_cell(
        command: list[str], plain: dict[tuple[str, int], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("submitit", reason="submitit is not installed: pip install 'gesticulator[slurm]'")
    assert ABLATE.main("gesticulator ablate", [*command, "--slurm", "cluster=local", "timeout_min=10"]) == 0
    deadline = time.monotonic() + 600
    while not list((tmp_path / "work" / "slurm").glob("*/*_0_result.pkl"))[1:] and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not (tmp_path / "out" / "cells.jsonl").exists() and list((tmp_path / "out" / PARTS).iterdir())
    monkeypatch.setattr(rg_rows, "assemble", None)  # the cell is there: nothing is trained or played
    assert ABLATE.main("gesticulator ablate", command) == 0
    assert cells_of(tmp_path / "out") == {("ours", 1): plain["ours", 1]} and (tmp_path / "out" / "table.md").exists()


def test_the_command_on_ray_makes_the_cell(command: list[str], plain: dict[tuple[str, int], Any], tmp_path: Path
                                           ) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'gesticulator[scale]'")
    assert ABLATE.main("gesticulator ablate", [*command, "--ray", "local:1"]) == 0
    assert cells_of(tmp_path / "out") == {("ours", 1): plain["ours", 1]}


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A sbatch that keeps what it is given and numbers it, and a srun that runs it here."""
    pytest.importorskip("submitit", reason="submitit is not installed: pip install 'gesticulator[slurm]'")
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "sbatch").write_text(f"""#!{sys.executable}
import pathlib, shutil, sys
here = pathlib.Path({str(tmp_path)!r})
number = 71 + len(list(here.glob('*.sbatch')))
shutil.copy(sys.argv[-1], here / f'{{number}}.sbatch')
print('Submitted batch job', number)
""")
    (folder / "srun").write_text(f"""#!{sys.executable}
import os, subprocess, sys
command = [word.replace('%j', os.environ['SLURM_JOB_ID']) for word in sys.argv[6:]]
sys.exit(subprocess.run(command).returncode)
""")
    for file in folder.iterdir():
        file.chmod(file.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return tmp_path


def _count(folder: Path) -> Ablation:
    (folder / "made").touch()
    raise InputError(folder, "is not a store")


@pytest.mark.skipif(os.name == "nt", reason="Slurm is of Unix")
def test_jobs_of_slurm_are_written_for_each_row_and_seed_after_what_they_share(slurm: Path) -> None:
    options = sweep.slurm_options(["slurm_partition=cpu", "timeout_min=90", "mem_gb=8"])
    tasks = ablate.row_seeds(NAMES, 3)
    assert sweep.submit(partial(_count, slurm), tasks, slurm / "jobs", options) == [
        "71", *(f"72_{place}" for place in range(6))]
    first, array = ((slurm / f"{number}.sbatch").read_text() for number in (71, 72))
    for script in (first, array):
        assert "#SBATCH --partition=cpu\n" in script and "#SBATCH --time=90\n" in script
        assert "#SBATCH --mem=8GB\n" in script and "#SBATCH --job-name=gesticulator\n" in script
    assert "--array" not in first and "--dependency" not in first
    assert "#SBATCH --array=0-5" in array and "#SBATCH --dependency=afterok:71\n" in array
    here = {"SLURM_JOB_ID": "71", "SLURM_NTASKS": "1", "SLURM_PROCID": "0", "SLURM_LOCALID": "0", "SLURM_NODEID": "0",
            "SLURM_JOB_NUM_NODES": "1", "SLURM_JOB_NODELIST": "here",
            "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    subprocess.run(["sh", str(slurm / "71.sbatch")], env={**os.environ, **here}, check=False, capture_output=True)
    assert (slurm / "made").exists()


@pytest.mark.usefixtures("slurm")
@pytest.mark.parametrize(("given", "wrong"), [("partition", "is not an option"), ("slurm_colour=red", "slurm_colour")])
def test_options_of_slurm_that_are_none(given: str, wrong: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=wrong):
        sweep.submit(partial(_count, tmp_path), [("ours", 1)], tmp_path / "jobs", sweep.slurm_options([given]))


def test_without_slurm_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("submitit", reason="submitit is not installed: pip install 'gesticulator[slurm]'")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="finds no sbatch here"):
        sweep.slurm_options([])
    assert sweep.slurm_options(["cluster=local"])["cluster"] == "local"
