"""Modules of other people that bear the names of the packages beside `gesticulator` are named in one line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gesticulator import version

ROOT = Path(__file__).resolve().parent.parent


def run(*arguments: str, folder: Path, path: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Python in a folder, with the packages of `path`."""
    return subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(path)})


def test_nothing_hides_the_packages_here() -> None:
    assert version.clash() is None


@pytest.mark.parametrize("door", ["gesticulator", "gesticulator.infer"])
@pytest.mark.parametrize("name", ["lexicon", "eval", "data_module"])
def test_a_file_in_the_current_folder_is_named_with_the_cure(name: str, door: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.py").write_text("WORDS = 3\n")
    done = run("-m", door, "--version", folder=tmp_path)
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.count("\n") == 1
    assert str(tmp_path / f"{name}.py") in done.stderr and "rename it" in done.stderr


def test_a_file_of_another_name_is_no_matter(tmp_path: Path) -> None:
    (tmp_path / "lexicons.py").write_text("WORDS = 3\n")
    assert run("-m", "gesticulator", "--version", folder=tmp_path).returncode == 0


def installed(folder: Path) -> Path:
    """Packages as pip lays them, without what is not imported at once."""
    for name in (*version.NAMES, "gesticulator"):
        (folder / name).mkdir()
        shutil.copy(ROOT / name / "__init__.py", folder / name)
    for file in ("version.py", "version.py"):
        shutil.copy(ROOT / "gesticulator" / file, folder / "gesticulator")
    return folder


def test_a_package_that_was_overwritten_is_named_with_the_cure(tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    installed(site)
    assert run("-c", "import gesticulator", folder=tmp_path, path=site).returncode == 0
    (site / "lexicon" / "__init__.py").write_text("from .words import *\n")
    done = run("-c", "import gesticulator", folder=tmp_path, path=site)
    line = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1 and line.startswith("ImportError: ")
    assert str(site / "lexicon" / "__init__.py") in line and "overwritten" in line


def test_a_package_that_is_missing_is_named(tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    installed(site)
    shutil.rmtree(site / "lexicon")
    done = run("-S", "-c", "import gesticulator", folder=tmp_path, path=site)
    assert "'lexicon' is not installed" in done.stderr.strip().splitlines()[-1]
