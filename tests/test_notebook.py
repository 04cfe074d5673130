"""The notebook of first steps: executed with the contents of the wheel, its stored outputs, and the page in it."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from browser import chromium

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_its_outputs_are_stored_and_small() -> None:
    cells = code_cells(json.loads(NOTEBOOK.read_text(encoding="utf-8")))
    assert NOTEBOOK.stat().st_size < 1_000_000
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1)), "run once, from the top"
    kinds = [output["output_type"] for cell in cells for output in cell["outputs"]]
    assert len(kinds) >= len(cells) - 1 and "error" not in kinds
    # The one address that is set, and no other, in whatever is published.
    hooks = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["metadata"]["hooks"]
    place = hooks["custom"]["repository"].removeprefix("https://github.com/")
    assert f"research.google.com/github/{place}/blob/HEAD/examples/{NOTEBOOK.name}" in NOTEBOOK.read_text()
    files = [NOTEBOOK, *ROOT.glob("*.*"), *ROOT.glob("docs/*.md"), *ROOT.glob("integrations/*/*.*")]
    texts = "".join(file.read_text(errors="ignore") for file in files if file.is_file())
    assert set(re.findall(r"github(?:\.com)?/([\w.-]+/gesticulator)\b(?!-)", texts)) == {place}


def test_the_page_in_it_plays() -> None:
    (frame,) = (output["data"]["text/html"] for cell in code_cells(json.loads(NOTEBOOK.read_text())) for output
                in cell["outputs"] if "text/html" in output.get("data", {}))
    with chromium() as browser:
        page = browser.new_page()
        page.set_content(f"<!doctype html><body>{''.join(frame)}</body>")
        inner = page.frame_locator("iframe")
        inner.locator("body[data-ready=true]").wait_for(state="attached", timeout=60_000)
        assert "8.0" in inner.locator("body").inner_text()


def test_it_runs_from_the_top_with_the_wheel(tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    nbformat = pytest.importorskip("nbformat")
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w",
                    str(tmp_path), str(ROOT)], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    shutil.copy(ROOT / "examples" / "speech.flac", tmp_path)
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell("import gesticulator as package; print(package.__file__)"))
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    client.execute(env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), *sys.path])})
    *cells, place = code_cells(notebook)
    assert place["outputs"][0]["text"].startswith(str(tmp_path / "site"))
    stored = code_cells(json.loads(NOTEBOOK.read_text()))
    for cell, before in zip(cells, stored, strict=True):
        texts = ["".join("".join(output["text"]) for output in each["outputs"] if output["output_type"] == "stream")
                 for each in (cell, before)]
        assert texts[0] == texts[1], "what it prints is what is stored"
    assert (tmp_path / "gesture.vrma").stat().st_size > 50_000
