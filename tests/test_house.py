"""The rules of the house that no linter knows: doors, names, and how much a function asks for."""

from __future__ import annotations

import ast
import importlib
import re
from collections import defaultdict
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from gesticulator.cli import VERBS, Command

ROOT = Path(__file__).parents[1]
PACKAGES = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval")
MAINS = {"gesticulator/__main__.py", "gesticulator/infer.py", "data_module/build.py"}
"""The one door, and the old doors that stay."""
MAINS |= {"gesticulator/characters/blender_jobs.py", "gesticulator/characters/fbx_child.py",
          "gesticulator/export/fbx_child.py"}  # run by Blender's own Python
MOST_PARAMETERS = 7
VAGUE = {"utils", "util", "helpers", "helper", "common", "misc"}


def sources() -> list[Path]:
    """Every file of the packages."""
    return [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]


def trees() -> dict[str, ast.Module]:
    """File -> its syntax tree."""
    return {str(file.relative_to(ROOT)): ast.parse(file.read_text()) for file in sources()}


def test_there_are_no_other_doors() -> None:
    found = {str(file.relative_to(ROOT)) for file in sources() if "__main__" in file.read_text()
             and 'if __name__ == "__main__"' in file.read_text()}
    assert found == MAINS


def test_every_verb_is_a_command_that_says_what_it_is_for() -> None:
    points = {point.name: point for point in entry_points(group=VERBS.group)}
    assert set(points) >= {"infer", "build", "train", "bundle", "score", "ablate", "report", "study", "probe", "draw"}
    for name, point in points.items():
        module, _, attribute = point.value.partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, Command)
        assert command.summary
        assert command.examples, f"{name} shows no example in its help"
        assert name in command.parser(f"gesticulator {name}").format_help()


def test_a_class_name_stands_once() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for file, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(f"{file}:{node.lineno}")
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_a_function_asks_for_seven_things_at_most() -> None:
    long = {}
    for file, tree in trees().items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef):
                continue
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            count = len(names) - (names[:1] in (["self"], ["cls"]))
            if count > MOST_PARAMETERS:
                long[f"{file}:{node.lineno} {node.name}"] = count
    assert not long


@pytest.mark.parametrize("file", sources(), ids=lambda file: str(file.relative_to(ROOT)))
def test_no_file_has_a_vague_name_or_no_word_on_what_it_is(file: Path) -> None:
    assert file.stem not in VAGUE
    assert ast.get_docstring(ast.parse(file.read_text()))


def test_nothing_imports_a_probe() -> None:
    """Probes are leaves: what two of them need lies in a lower room."""
    found = {}
    for file, tree in trees().items():
        modules = [f"{node.module}.{name.name}" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
                   for name in node.names] + [name.name for node in ast.walk(tree) if isinstance(node, ast.Import)
                                              for name in node.names]
        probes = [module for module in modules if re.match(r"eval\.probes\.[a-z_]+", module)]
        if probes:
            found[file] = probes
    assert not found


_CLOCKS = {"perf_counter", "process_time", "thread_time", "clock_gettime", "timeit"}


def test_no_test_measures_how_long_work_takes() -> None:
    """Seconds differ between machines: tests bound counted work (`counted.counted_calls`)."""
    found = [f"{file.name}:{node.lineno} {node.attr}" for file in sorted((ROOT / "tests").glob("*.py"))
             for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Attribute)
             and node.attr.removesuffix("_ns") in _CLOCKS]
    assert found == []
