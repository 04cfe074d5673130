"""Modules of JavaScript run by Node.js, for the tests that hold them against Python."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest


def printed_by(script: str, folder: Path, *words: str) -> Any:
    """What a module prints as JSON, run in a folder; `words` are the end of its `process.argv`. Skips the test where
    there is no Node.js."""
    program = shutil.which("node")
    if program is None:
        pytest.skip("node, which runs JavaScript, is not installed: apt-get install nodejs")
    done = subprocess.run([program, "--input-type=module", "-e", script, "--", *words], cwd=folder, capture_output=True,
                          text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
