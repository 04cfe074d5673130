"""The client's package: its licence, what it imports, and its own tests where Pipecat is installed."""

import ast
import json
import os
import shutil
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from gesticulator.plan.gestures import EXPRESSIONS, REPERTOIRE, mark_of

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "integrations" / "pipecat-gesticulator"
OURS = {"data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval"}


def test_it_imports_nothing_of_the_gpl_packages() -> None:
    """Neither by a statement nor when it is loaded: it may be used where the GPL may not."""
    files = sorted(FOLDER.rglob("*.py"))
    assert len(files) >= 5
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else \
                [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.partition(".")[0] for name in names} & OURS, file
    code = "import sys, pipecat_gesticulator; print([name for name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=FOLDER, env={**os.environ, "PYTHONPATH": str(FOLDER)},
                          capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stdout))
    assert "pipecat_gesticulator" in loaded and not loaded & OURS and "torch" not in loaded


def test_the_tools_name_gestures_and_moods_of_the_repertoire() -> None:
    from pipecat_gesticulator.tools import NAMES, STYLES

    assert set(NAMES) == {name for name, gesture in REPERTOIRE.items() if gesture.core}
    assert set(STYLES) <= set(EXPRESSIONS)
    prompt = (ROOT / "docs" / "marks.md").read_text()
    assert [name for name in NAMES if mark_of(name) not in prompt.replace("\n", " ")] == []


def test_the_schema_is_in_our_wheel() -> None:
    """An installed server has no checkout beside it: the wheel carries the file that the client's package publishes."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    ((source, target),) = wheel["force-include"].items()
    assert (ROOT / source).samefile(FOLDER / "pipecat_gesticulator" / "protocol.json")
    from gesticulator.live import protocol

    places = [place.relative_to(ROOT).as_posix() for place in protocol._PLACES]
    assert places == [source, target]
    assert json.loads((ROOT / source).read_text()) == protocol.published()


def test_its_own_tests_pass_in_a_real_pipeline() -> None:
    """Where Pipecat is installed beside us, or PIPECAT_PYTHON names a Python that has it."""
    python = os.environ.get("PIPECAT_PYTHON") or (sys.executable if find_spec("pipecat") else None)
    if python is None:
        pytest.skip("pipecat-ai is not installed, and PIPECAT_PYTHON names no Python that has it")
    if shutil.which("espeak-ng") is None:
        pytest.skip("espeak-ng is not installed")
    run = "import sys; from gesticulator.live.command import COMMAND as C; sys.exit(C.main(sys.argv[1], sys.argv[2:]))"
    server = f'{sys.executable} -c "{run}"'
    done = subprocess.run([python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"], cwd=FOLDER, text=True,
                          env={**os.environ, "PYTHONPATH": str(FOLDER), "GESTICULATOR_COMMAND": server,
                               "GESTICULATOR_ROOT": str(ROOT)}, capture_output=True, timeout=600)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "skipped" not in done.stdout.splitlines()[-1]
