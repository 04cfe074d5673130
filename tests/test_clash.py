"""Foreign modules with the names of the packages beside `gesticulator` are reported in one line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from gesticulator import version

ROOT = Path(__file__).resolve().parent.parent


def run(*arguments: str, folder: Path, path: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Python in a folder, with the packages of `path`."""
    return subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(path)})


def test_a_file_in_the_current_folder_is_named_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "lexicon.py").write_text("WORDS = 3\n")
    done = run("-m", "gesticulator", "--version", folder=tmp_path)
    assert done.returncode == 2 and not done.stdout and done.stderr.count("\n") == 1
    assert str(tmp_path / "lexicon.py") in done.stderr and "rename it" in done.stderr
    (tmp_path / "lexicon.py").rename(tmp_path / "lexicons.py")
    assert run("-m", "gesticulator", "--version", folder=tmp_path).returncode == 0


def test_a_package_that_was_overwritten_is_named_with_the_remedy(tmp_path: Path) -> None:
    site = tmp_path / "site"
    for name in (*version.NAMES, "gesticulator"):
        (site / name).mkdir(parents=True)
        shutil.copy(ROOT / name / "__init__.py", site / name)
    shutil.copy(ROOT / "gesticulator" / "version.py", site / "gesticulator")
    assert run("-c", "import gesticulator", folder=tmp_path, path=site).returncode == 0
    (site / "lexicon" / "__init__.py").write_text("from .words import *\n")
    done = run("-c", "import gesticulator", folder=tmp_path, path=site)
    line = done.stderr.strip().splitlines()[-1]
    assert line.startswith("ImportError: ") and "overwritten" in line and str(site / "lexicon" / "__init__.py") in line
