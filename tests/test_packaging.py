"""Installation: a tested version of every requirement, marked tests that exist, and the metadata of the build."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
UNTRIED = {"fbx", "scale"}
"""Extras whose packages the tests do not install."""


def test_the_constraints_hold_a_tested_version_of_every_requirement() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    tested = dict(line.split("==") for line in lines)
    required = [*project["dependencies"], *(line for extra, lines in project["optional-dependencies"].items()
                                            if extra not in UNTRIED for line in lines)]
    for requirement in map(Requirement, required):
        name = canonicalize_name(requirement.name)
        if name != "gesticulator" and (requirement.marker is None or requirement.marker.evaluate()):
            assert name in tested, f"{name} is not in constraints.txt"
            assert requirement.specifier.contains(tested[name]), f"{name} {tested[name]} is not {requirement.specifier}"


@pytest.mark.parametrize("name", ["slow.txt", "full.txt"])
def test_tests_that_are_marked_exist(name: str) -> None:
    functions = {f"{file.name}::{node.name}" for file in (ROOT / "tests").glob("test_*.py")
                 for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)}
    marked = set((ROOT / "tests" / name).read_text().split())
    assert marked <= functions, sorted(marked - functions)


def metadata(url: str) -> dict[str, Any]:
    """The project's metadata as the build writes it."""
    pytest.importorskip("hatchling", reason="the build's own program")
    done = subprocess.run([sys.executable, "-m", "hatchling", "metadata"], cwd=ROOT, capture_output=True, text=True,
                          env={**os.environ, "GESTICULATOR_URL": url}, check=False)
    if done.returncode:
        raise ValueError(done.stderr)
    return dict(json.loads(done.stdout))


def test_with_an_address_the_page_has_no_relative_link() -> None:
    url = "https://example.org/group/gesticulator"
    built = metadata(f"{url}/")
    assert all(address.startswith(url) for address in built["urls"].values())
    addresses = re.findall(r"\]\(([^)\s]+)", built["readme"]["text"])
    assert addresses and all(address.startswith(("https://", "#")) for address in addresses), addresses
    for address in addresses:
        if address.startswith(url):
            assert (ROOT / address.removeprefix(url).split("HEAD/")[1].partition("#")[0]).exists(), address


def test_without_an_address_nothing_is_invented() -> None:
    built = metadata("")
    assert "urls" not in built and built["readme"]["text"] == (ROOT / "README.md").read_text()
    with pytest.raises(ValueError, match="give the address of the repository"):
        metadata("example")
