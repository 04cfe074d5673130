"""Installation: a tested version of every requirement, marked tests that exist, and the metadata of the build."""

import ast
import importlib.metadata
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

from data_module.errors import EXTRAS, install_line

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


SOURCES = ("data_module", "gesticulator", "eval", "lexicon", "generator", "interpreters", "integrations/hub",
           "integrations/mcp")
IMPORTED = {"usd_core": "pxr", "pillow": "pil", "python_osc": "pythonosc", "praat_parselmouth": "parselmouth",
            "scikit_learn": "sklearn"}


def _extras() -> dict[str, set[str]]:
    """Extra -> what its packages are imported as."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    return {extra: {IMPORTED.get(name := canonicalize_name(Requirement(line).name).replace("-", "_"), name)
                    for line in lines} for extra, lines in listed.items()}


def test_whatever_is_optional_has_its_extra_in_the_message() -> None:
    """Each import of a package of an extra is checked by a `Requirement` of that extra, or is in `errors.EXTRAS`."""
    extras, found = _extras(), {(module.lower(), extra) for module, extra in EXTRAS.items()}
    source = "\n".join(file.read_text() for folder in SOURCES for file in (ROOT / folder).rglob("*.py"))
    found |= {(module.lower(), extra) for module, extra in re.findall(r'Requirement\("(\w+)", .+?, "(\w+)"\)', source)}
    # Loops over the packages of one extra, and lines that are written by hand.
    for extra in re.findall(r"""Requirement\([a-z]\w+, \w+, "(\w+)"\)|install_line\(['"](\w+)['"]\)""", source):
        found |= {(module, "".join(extra)) for module in extras["".join(extra)]}
    assert all(module in extras[extra] for module, extra in found)
    imported = {name.lower() for name in re.findall(r"^ *(?:import|from) (\w+)", source, re.MULTILINE)}
    optional = {module for extra, modules in extras.items() if extra not in ("test", "docs") for module in modules}
    assert optional & imported <= {module for module, _ in found}, "no message names the extra"


def test_the_install_page_lists_every_extra() -> None:
    page = (ROOT / "docs" / "install.md").read_text()
    listed = {name for row in re.findall(r"^\| (`.+?) \|", page, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    assert listed == set(_extras())


@pytest.mark.parametrize(("note", "line"), [
    (None, 'pip install "gesticulator[live]"'),
    ({"url": "file:///a/b", "dir_info": {"editable": True}}, 'pip install -e "/a/b[live]"'),
    ({"url": "file:///a/g.whl", "archive_info": {}}, 'pip install "gesticulator[live] @ file:///a/g.whl"'),
    ({"url": "https://host/g", "vcs_info": {"vcs": "git"}}, 'pip install "gesticulator[live] @ git+https://host/g"'),
])
def test_an_extra_is_installed_from_where_the_program_came_from(note: dict[str, Any] | None, line: str,
                                                                monkeypatch: pytest.MonkeyPatch) -> None:
    class Installed:
        def read_text(self, name: str) -> str | None:
            return None if note is None or name != "direct_url.json" else json.dumps(note)

    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Installed())
    assert install_line("live") == line
