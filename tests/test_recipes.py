"""The recipes of CONTRIBUTING.md: each is installed as a third-party package and run as it says."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from performances import write_example

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
_RECIPE = re.compile(r"^### (?P<title>[^\n]+)\n(?P<body>.*?)(?=^### |\Z)", re.MULTILINE | re.DOTALL)
_PARTS = re.compile(r"`(?P<file>\w+\.py)`:\n\n```python\n(?P<code>.*?)```\n.*?```toml\n(?P<toml>.*?)```\n.*?"
                    r"Run:\n\n```\n(?P<run>[^\n]+)\n```", re.DOTALL)
RECIPES = {found["title"]: _PARTS.search(found["body"]) for found in _RECIPE.finditer(TEXT)}
KINDS = {"An interpreter": "interpreters", "A writer": "writers", "A data set": "corpora"}


def install(title: str, folder: Path) -> str:
    """Put the file of a recipe and the entry points of its pyproject.toml into a folder; the command to run."""
    recipe = RECIPES.get(title)
    assert recipe is not None, f"CONTRIBUTING.md has no whole recipe {title!r}"
    (folder / recipe["file"]).write_text(recipe["code"], encoding="utf-8")
    info = folder / f"{recipe['file'].removesuffix('.py')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {recipe['file'].removesuffix('.py')}\nVersion: 1.0\n")
    header, line = recipe["toml"].strip().splitlines()
    name, value = (part.strip().strip('"') for part in line.split(" = "))
    group = re.fullmatch(r'\[project\.entry-points\."(gesticulator\.\w+)"\]', header)
    assert group is not None and group[1] == f"gesticulator.{KINDS[title]}"
    (info / "entry_points.txt").write_text(f"[{group[1]}]\n{name} = {value}\n")
    return recipe["run"]


def run(line: str, packages: Path, folder: Path) -> str:
    """Run a recipe's command in a folder, with the packages installed there; what it prints."""
    program, *arguments = shlex.split(line)
    assert program == "gesticulator"
    path = os.pathsep.join((str(packages), str(ROOT)))
    done = subprocess.run([sys.executable, "-m", "gesticulator", *arguments], cwd=folder, capture_output=True,
                          text=True, timeout=500, check=False,
                          env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stdout + done.stderr
    assert "warning: " not in done.stderr or "cannot be loaded" not in done.stderr, done.stderr
    return done.stdout


def speech(folder: Path) -> None:
    """Two seconds of a voice."""
    write_example(folder / "speech.wav", 2.0)


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    """Where the outside packages are installed."""
    folder = tmp_path / "site"
    folder.mkdir()
    return folder


def test_an_interpreter(packages: Path, tmp_path: Path) -> None:
    speech(tmp_path)
    run(install("An interpreter", packages) + " -o plan.json", packages, tmp_path)
    assert (tmp_path / "gesture.bvh").stat().st_size > 1000
    assert '"interpreter": "uniform"' in (tmp_path / "plan.json").read_text()


def test_a_writer(packages: Path, tmp_path: Path) -> None:
    speech(tmp_path)
    run(install("A writer", packages), packages, tmp_path)
    rows = [line.split() for line in (tmp_path / "blocks.txt").read_text().splitlines()]
    assert float(rows[0][0]) == 0.0 and float(rows[-1][1]) == pytest.approx(2.0, abs=0.06)
    assert all(row[1] == following[0] for row, following in zip(rows, rows[1:], strict=False))
    assert all(int(row[2]) >= 0 for row in rows)


def test_a_data_set(packages: Path, tmp_path: Path) -> None:
    assert "wave" in run(install("A data set", packages), packages, tmp_path)
    assert (tmp_path / "store" / "dataset" / "wave0.bvh").is_file()
