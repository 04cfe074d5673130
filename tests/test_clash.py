"""Foreign modules with the names of the packages beside `gesticulator` are reported in one line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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
