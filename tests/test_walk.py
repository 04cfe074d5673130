"""One BVH file imports nothing that it does not need: no training, no evaluation, no library for other tasks."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
UNNEEDED = (
    "sklearn", "transformers", "matplotlib", "av", "tqdm.notebook", "interpreters.cql", "interpreters.reward",
    "interpreters.episodes", "interpreters.gate", "lexicon.racer", "lexicon.autoencoder", "gesticulator.training.fit",
    "gesticulator.training.stages", "data_module.store", "data_module.text.transcript",
    "data_module.speech.speech_encoder", "data_module.speech.learned_front_ends", "eval")
PACKAGES = ("data_module", "lexicon", "interpreters", "generator", "gesticulator")
MOST_FILES = 51
RUN = """
import json, runpy, sys
sys.argv = ["infer", "examples/speech.flac", "-o", sys.argv[1], "--quiet"]
try:
    runpy.run_module("gesticulator.infer", run_name="__main__")
except SystemExit as stopped:
    assert not stopped.code, stopped.code
print(json.dumps(sorted(sys.modules)))
"""


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The modules that are loaded after one BVH of the example was written."""
    out = tmp_path_factory.mktemp("walk") / "o.bvh"
    done = subprocess.run([sys.executable, "-c", RUN, str(out)], cwd=ROOT, check=True, capture_output=True, text=True)
    assert out.stat().st_size > 10_000
    return list(json.loads(done.stdout.splitlines()[-1]))


def test_a_plain_run_loads_few_files(imported: list[str]) -> None:
    """A reader of the run has this many files to open; packages' faces (`__init__.py`) are not counted."""
    files = [name for name in imported if name.split(".")[0] in PACKAGES
             and ROOT.joinpath(*name.split(".")).with_suffix(".py").is_file()]
    # Loaded only for a plan, a clip or a body that sits.
    assert not {"gesticulator.plan.gestures", "gesticulator.export.clip", "gesticulator.contacts.lap"} & set(files)
    assert 30 < len(files) <= MOST_FILES, files


@pytest.mark.parametrize("name", UNNEEDED)
def test_what_a_plain_run_does_not_need_is_not_imported(name: str, imported: list[str]) -> None:
    assert "gesticulator.gesticulator" in imported and name not in imported
