"""What is installed: tested versions of every requirement, and a marker for slow tests that names tests that exist."""

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

ROOT = Path(__file__).resolve().parent.parent
UNTRIED = {"fbx", "scale"}
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
    slow, full = ((ROOT / "tests" / name).read_text().split() for name in ("slow.txt", "full.txt"))
    for names in (slow, full):
        assert names == sorted(set(names))
        assert set(names) <= functions, sorted(set(names) - functions)
    assert set(full) <= set(slow)


def metadata(url: str) -> dict[str, Any]:
    """The project's metadata as the build makes it."""
    pytest.importorskip("hatchling", reason="the build's own program")
    done = subprocess.run([sys.executable, "-m", "hatchling", "metadata"], cwd=ROOT, capture_output=True, text=True,
                          env={**os.environ, "GESTICULATOR_URL": url}, check=False)
    if done.returncode:
        raise ValueError(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_with_an_address_the_page_has_urls_and_no_relative_link_or_picture() -> None:
    url = "https://example.org/group/gesticulator"
    made = metadata(f"{url}/")
    assert set(made["urls"]) >= {"Homepage", "Source", "Issues", "Changelog", "Documentation"}
    assert all(address.startswith(url) for address in made["urls"].values())
    text, readme = made["readme"]["text"], (ROOT / "README.md").read_text()
    assert made["readme"]["content-type"] == "text/markdown"
    addresses = re.findall(r"\]\(([^)\s]+)", text)
    assert len(addresses) == len(re.findall(r"\]\(([^)\s]+)", readme)) > 10
    assert all(address.startswith(("https://", "#")) for address in addresses), addresses
    assert not re.findall(r"(?:src|href)=[\"'](?!https:|#)", text), "HTML with a relative address"
    pictures = re.findall(r"!\[[^\]]*\]\(([^)\s]+)", text)
    assert pictures and all(address.startswith(f"{url}/raw/HEAD/docs/") for address in pictures)
    for address in addresses:
        if address.startswith(url):
            assert (ROOT / address.removeprefix(url).split("HEAD/")[1].partition("#")[0]).exists(), address


def test_without_an_address_nothing_is_invented() -> None:
    made = metadata("")
    assert "urls" not in made
    assert made["readme"]["text"] == (ROOT / "README.md").read_text()
    with pytest.raises(ValueError, match="give the address of the repository"):
        metadata("example")
