"""A short walk: how many of our files one gesture passes through."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RUN = 46
"""Files in which a function ran, while modules were imported or after.
Twenty-five are not reached without harm, since each has its own subject: eight turn sound into blocks and features,
five turn vectors into a BVH file, five are the models and what builds them, four settings, and eight the nouns,
errors, command line, its main verb, bundle, product, loop over blocks and result. Ten came with movements: their
coordinates, the lexicon over them, the flow head, who draws, rest, life, what an interpreter sees of the body,
guidance by ear, relaxed hands, and silence heard in steps. Three came with streams: onsets as sound arrives, the
cutter that makes blocks of it, and the path of blocks onto the clock; three with the choice among what was drawn,
with the files that a command names, and with the head as it draws, which is not the head as it learns. To join
further would make files of more than 450 lines (the loop and the product; rotations and their representation), put
two subjects under one name (silence and beats), or give up checks: settings, and what low, mid and high mean, are
held against their ranges when a bundle is opened and not halfway through a recording."""
IMPORTED = 53
"""Files that were imported, those of seven packages (`__init__`) included."""
PACKAGES = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval")
NEVER = ("sklearn", "transformers", "matplotlib", "av", "tqdm.notebook")
NOT_ASKED = ("interpreters.cql", "interpreters.reward", "interpreters.episodes", "interpreters.gate", "lexicon.racer",
             "lexicon.autoencoder", "gesticulator.training.fit", "gesticulator.training.stages",
             "gesticulator.bundle.upgrade", "data_module.store", "data_module.text.transcript", "eval")

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
    assert len(walk["imported"]) <= IMPORTED, walk["imported"]


@pytest.mark.parametrize("name", [*NEVER, *NOT_ASKED])
def test_what_is_not_asked_for_is_not_imported(name: str, walk: dict[str, list[str]]) -> None:
    assert name not in walk["modules"]
