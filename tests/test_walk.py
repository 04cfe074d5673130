"""A short walk: how many of our files one gesture passes through."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RUN = 56
"""Files in which a function ran, while modules were imported or after: sound into blocks and features, features into
lexemes and motion, motion into a BVH file, and the command around them. To join further would make files of more than
450 lines, put two subjects under one name, or give up checks that come before the work."""
IMPORTED = 55
"""Files with code that were imported; a package's `__init__` that holds a sentence alone is not counted."""
PACKAGES = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval")
NEVER = ("sklearn", "transformers", "matplotlib", "av", "tqdm.notebook")
NOT_ASKED = ("interpreters.cql", "interpreters.reward", "interpreters.episodes", "interpreters.gate", "lexicon.racer",
             "lexicon.autoencoder", "gesticulator.training.fit", "gesticulator.training.stages",
             "data_module.store", "data_module.text.transcript",
             "data_module.speech.speech_encoder", "data_module.speech.learned_front_ends", "eval")

WALK = """
import json, os, runpy, sys, threading
root, ran = os.getcwd() + os.sep, set()
ours = tuple(root + name + os.sep for name in sys.argv[3:])
FUNCTION = 1  # CO_OPTIMIZED: a function's own frame, and no class body or module

def profile(frame, event, _):
    code = frame.f_code
    if event == "call" and code.co_flags & FUNCTION and code.co_filename.startswith(ours) \\
            and not code.co_name.startswith("<"):
        ran.add(code.co_filename[len(root):])

threading.setprofile(profile)
sys.setprofile(profile)
sys.argv = ["infer", sys.argv[1], "-o", sys.argv[2], "--quiet"]
try:
    runpy.run_module("gesticulator.infer", run_name="__main__")
except SystemExit as stopped:
    assert not stopped.code, stopped.code
sys.setprofile(None)
files = {getattr(module, "__file__", None) or "" for module in list(sys.modules.values())}
imported = {file[len(root):] for file in files if file.startswith(ours)} | {"gesticulator/infer.py"}
print(json.dumps({"ran": sorted(ran), "imported": sorted(imported), "modules": sorted(sys.modules)}))
"""


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """What one BVH of the example took, without what has nothing to do with our code."""
    out = tmp_path_factory.mktemp("walk") / "o.bvh"
    done = subprocess.run([sys.executable, "-c", WALK, "examples/speech.flac", str(out), *PACKAGES], cwd=ROOT,
                          check=True, capture_output=True, text=True)
    assert out.stat().st_size > 10_000
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_one_gesture_runs_few_files(walk: dict[str, list[str]]) -> None:
    assert len(walk["ran"]) <= RUN, walk["ran"]


def test_one_gesture_imports_few_files(walk: dict[str, list[str]]) -> None:
    files = [file for file in walk["imported"] if not file.endswith("/__init__.py")]
    assert len(files) <= IMPORTED, files


@pytest.mark.parametrize("name", [*NEVER, *NOT_ASKED])
def test_what_is_not_asked_for_is_not_imported(name: str, walk: dict[str, list[str]]) -> None:
    assert name not in walk["modules"]
