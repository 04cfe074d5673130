"""What is installed: tested versions of every requirement, and a marker for slow tests that names tests that exist."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
UNTRIED = {"fbx", "robot", "scale"}
"""Extras whose packages the tests do not install."""


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_constraints_hold_a_tested_version_of_every_requirement() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    tested = dict(line.split("==") for line in lines)
    assert list(tested) == sorted(tested)
    required = [*project["dependencies"], *(line for extra, lines in project["optional-dependencies"].items()
                                            if extra not in UNTRIED for line in lines)]
    for line in required:
        requirement = Requirement(line)
        name = canonical(requirement.name)
        if name == "gesticulator" or (requirement.marker is not None and not requirement.marker.evaluate()):
            continue
        assert name in tested, f"{name} is not in constraints.txt"
        assert requirement.specifier.contains(tested[name]), f"{name} {tested[name]} is not {requirement.specifier}"


def test_slow_tests_are_there() -> None:
    functions = {f"{file.name}::{node.name}" for file in (ROOT / "tests").glob("test_*.py")
                 for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)}
    slow = (ROOT / "tests" / "slow.txt").read_text().split()
    assert slow == sorted(set(slow))
    assert set(slow) <= functions, sorted(set(slow) - functions)
