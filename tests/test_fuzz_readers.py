"""Every reader of files against broken files: only `InputError` comes out, within 500,000 calls and 500 MB.

A real file of each kind is written, damaged as disks, programs and people damage files (flipped bits, a cut end,
pieces that are missing or there twice, foreign bytes, numbers far too large), and read. A file that happens to be still
good may be read. A new reader is a new entry of `READERS`; a test below finds those that have none.
"""

from __future__ import annotations

import ast
import os
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from counted import counted_calls
from hypothesis import HealthCheck, Phase, given, settings
from reader_cases import READERS, damages

from data_module.corpora.base import DroppedError
from data_module.errors import InputError
from data_module.text.transcript import FORMATS
from gesticulator.serve.protocol import RefusedError

resource = pytest.importorskip("resource", reason="what a process has taken is POSIX's to tell")

CALLS, MEGABYTES = 500_000, 500.0
"""What one reading may take: calls of Python and C functions, not seconds, which differ between machines."""
EXAMPLES = int(os.environ.get("GESTICULATOR_FUZZ", "20"))
"""Damaged files per reader; the variable is for a longer search."""


# ---------------------------------------------------------------------------------------------------- the property

def _peak() -> float:
    """Megabytes that this process has held at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _held() -> float:
    """Megabytes that it holds now, where the system tells; else what it has held at most."""
    file = Path("/proc/self/statm")
    return int(file.read_text().split()[1]) * resource.getpagesize() / 1e6 if file.is_file() else _peak()


@pytest.mark.parametrize("name", READERS)
def test_only_input_errors_come_out_of_damaged_files(name: str, tmp_path: Path) -> None:
    case = READERS[name]
    file = case.sample(tmp_path)
    content = case.content(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case.read(file)
    beside = {other: other.read_bytes() for other in tmp_path.rglob("*") if other.is_file()}

    @settings(max_examples=max(5, round(case.examples * EXAMPLES)), deadline=None, database=None, derandomize=True,
              phases=(Phase.generate, Phase.shrink), suppress_health_check=list(HealthCheck))
    @given(damages())
    def survives(wanted: list[tuple[Callable[..., None], float, float, int]]) -> None:
        data = bytearray(content)
        for damage, a, b, choice in wanted:
            damage(data, a, b, choice)
        for other, old in beside.items():
            other.write_bytes(old)
        case.packed(file, bytes(data))
        said = ""
        before, peak = _held(), _peak()
        try:
            with warnings.catch_warnings(), counted_calls() as calls:
                warnings.simplefilter("ignore")
                warnings.filterwarnings("error", category=RuntimeWarning)
                case.read(file)
        except (InputError, DroppedError, RefusedError) as error:
            said = str(error)
        assert "\n" not in said and len(said) < 1000 + len(str(tmp_path))
        grown = _peak() - before if _peak() > peak else 0.0
        assert calls.count < CALLS and grown < MEGABYTES, f"{calls.count} calls, {grown:.0f} MB"

    survives()


_PACKAGES = ("data_module", "gesticulator", "eval", "lexicon", "interpreters", "generator")
_NAMED = re.compile("(read|load|loads|parse|open|deserialise)(_|$)")
_SAME_NAME = ("load", "open", "read", "parse", "loads")
"""Names that say too little: these count with their module or class."""
_NO_READERS = {
    "CellStore.read": "the work folder of an ablation; lines that are cut are skipped",
    "Weights.read": "through bundle.load", "read_json": "through every case of JSON", "cli.load": "an entry point",
    "one.load": "through load_speech", "Gesticulator.read": "a recording, through load_speech and read_transcript",
    "InterpreterEntry.load": "imports a module", "QNetwork.read": "tokens", "read_at": "sound in memory",
    "encode.read_motion": "motion in memory", "open_loop": "a drawing", "open_session": "a session of the server",
    "read_limits": "parsed arguments", "read_figures": "what workers of the same server wrote a moment ago",
    "Checkpoint.load": "the work folder of a training", "CounterfactualRewards.load": "the work folder of a training",
    "BestWeights.load_state_dict": "the work folder of a training", "Episodes.load": "the work folder of a training",
    "read_words": "caches of the work folder; of trinity it is in the table", "read_arrays": "the same caches",
    "PlayedStore.read": "the work folder of an ablation", "WordEncoder.open": "a model that another package reads",
    "read_fbx_character": "Blender reads it, in a process of its own", "parse_systems": "folders of a command line",
    "read_takes": "through read_bvh and load_speech", "read_folder": "through read_motion and load_speech",
    "read_all": "through read_folder", "open_strokes": "a table of makers",
    "controls.parse": "a flag, through read_curve",
    "read_take": "through read_bvh", "gesture_features.load": "checked by the hash in its .json", "table.loads": "text",
    "Registry.load": "imports a module", "RegistryEntry.load": "imports a module",
    "open_corpus": "a maker; each corpus is read by read_bvh, read_smplx, load_speech, read_table",
    "InterpreterEntry.load_model": "imports a module", "InterpreterEntry.load_stage": "imports a module",
    "AdvantageInterpreter.open": "models in memory", "InterpreterDefaults.open": "models in memory",
    "StatisticalInterpreter.open": "counts in memory",
    "base.load": "a recording, through its reader", "EvalContext.loaded": "memory",
}
"""Functions that are called like readers and need no case, with the reason."""


def _readers(tree: ast.Module, module: str) -> Iterator[str]:
    """The names of a module's readers; one of a class, or of a name that says little, with what holds it."""
    for node in tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        holder = node.name if isinstance(node, ast.ClassDef) else module
        for one in inside:
            if isinstance(one, ast.FunctionDef) and _NAMED.match(one.name):
                yield f"{holder}.{one.name}" if one.name in _SAME_NAME or isinstance(node, ast.ClassDef) else one.name


def test_every_reader_is_in_the_table() -> None:
    """Every function of the six packages that is called like a reader has a case, or a reason to have none."""
    root = Path(__file__).parents[1]
    covered = {function for case in READERS.values() for function in case.covers}
    lacking = {}
    for package in _PACKAGES:
        for file in (root / package).rglob("*.py"):
            names = set(_readers(ast.parse(file.read_text(encoding="utf-8")), file.stem))
            # Readers of corpora have one method each; a method read_... of a class goes with its class.
            names = {name for name in names if not (package == "data_module" and "corpora" in file.parts
                                                    and name.endswith(".read"))}
            bare = {name: name.rpartition(".")[2] for name in names}
            for name in names - covered - set(_NO_READERS):
                if bare[name] in _SAME_NAME or (bare[name] not in covered and bare[name] not in _NO_READERS):
                    lacking[f"{file.relative_to(root)}: {name}"] = name
    assert not lacking, f"these readers have no case in reader_cases.READERS: {sorted(lacking)}"
    assert {f"transcript {suffix}" for suffix in FORMATS} <= set(READERS)
