"""The silent lexemes of a bundle can be seen and edited, and nothing else of it changes."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import silent
from gesticulator.bundle.command import BUNDLE

SIZE = 9
some = st.sets(st.integers(0, SIZE - 1))


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The shipped bundle, where it may be edited."""
    shutil.copytree(bundles.SHIPPED, tmp_path / "mine")
    return tmp_path / "mine"


def command(*arguments: str) -> int:
    return BUNDLE.main("gesticulator bundle", ["silent", *arguments])


def hashes(folder: Path) -> dict[str, str]:
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        command(*arguments)
    said = capsys.readouterr().err
    assert stopped.value.code == 2 and said.count("\n") == 1, said
    return said


def test_lists_what_the_bundle_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert command(*[]) == 0
    own = bundles.load(bundles.SHIPPED)
    assert f"silent: {','.join(map(str, own.silent))} ({len(own.silent)} of {own.config.lexicon.size}" in \
        capsys.readouterr().out


def test_edits_and_the_product_follows(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, files = json.loads((copy / "bundle.json").read_text()), hashes(copy)
    assert command(*[str(copy), "--set", "9, 3,7,3"]) == 0
    assert command(*[str(copy), "--add", "0", "--remove", "7"]) == 0
    assert "silent: 0,3,9 (3 of" in capsys.readouterr().out
    after = json.loads((copy / "bundle.json").read_text())
    assert after.pop("silent_lexemes") == [0, 3, 9]
    assert after["provenance"].pop(silent.FOUND) == before.pop("silent_lexemes")
    assert after == before
    assert {name for name, value in hashes(copy).items() if value != files[name]} == {"bundle.json"}
    loaded = bundles.load(copy)  # every hash is checked here
    assert loaded.silent.tolist() == [0, 3, 9]
    assert all(loaded.rest_lexeme(speaker) in (0, 3, 9) for speaker in range(len(loaded.speakers)))
    assert sorted(file.name for file in copy.parent.iterdir()) == ["mine"]


def test_copy_beside_the_shipped_bundle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files, out = hashes(bundles.SHIPPED), tmp_path / "deep" / "mine"
    assert "--out DIR" in refused(capsys, "--add", "1")
    link = tmp_path / "link"
    link.symlink_to(bundles.SHIPPED)
    assert "is shipped with the package" in refused(capsys, str(link), "--set", "1")
    assert command(*["--set", "1,2", "--out", str(out)]) == 0
    assert bundles.load(out).silent.tolist() == [1, 2]
    assert hashes(bundles.SHIPPED) == files
    assert "exists" in refused(capsys, "--set", "1", "--out", str(out))
    assert bundles.load(out).silent.tolist() == [1, 2]
    assert [file.name for file in out.parent.iterdir()] == ["mine"]


@pytest.mark.parametrize(("arguments", "says"), [
    (["--set", "1,SIZE"], "SIZE: is not in the lexicon; its lexemes are 0 to LAST"),
    (["--set=-1"], "-1: is not in the lexicon"),
    (["--remove", "7777"], "7777: is not in the lexicon"),
    (["--set", ""], "would be none"),
    (["--set", "one"], "is not a list of lexemes"),
    (["--set", "ALL"], "whole lexicon"),
    (["--set", "1", "--add", "2"], "cannot go with"),
    (["--add", "2", "--remove", "2"], "to be added and to be removed"),
    (["--out", "elsewhere"], "has nothing to write"),
])
def test_bad_input_is_one_line_and_changes_nothing(copy: Path, capsys: pytest.CaptureFixture[str],
                                                   arguments: list[str], says: str) -> None:
    files, size = hashes(copy), json.loads((copy / "bundle.json").read_text())["config"]["lexicon"]["size"]
    names = {"SIZE": str(size), "LAST": str(size - 1), "ALL": ",".join(map(str, range(size)))}
    for name, value in names.items():
        says, arguments = says.replace(name, value), [part.replace(name, value) for part in arguments]
    assert says in refused(capsys, str(copy), *arguments)
    assert hashes(copy) == files


@pytest.mark.parametrize("breakage", ["gone", "empty folder", "no json", "no list", "a word", "too many", "no config"])
def test_broken_bundle(copy: Path, capsys: pytest.CaptureFixture[str], breakage: str) -> None:
    file = copy / "bundle.json"
    index = json.loads(file.read_text())
    if breakage == "no list":
        del index["silent_lexemes"]
    elif breakage == "a word":
        index["silent_lexemes"] = ["still"]
    elif breakage == "too many":
        index["silent_lexemes"] = [index["config"]["lexicon"]["size"]]
    elif breakage == "no config":
        index["config"] = {}
    file.write_text("{" if breakage == "no json" else json.dumps(index))
    if breakage == "empty folder":
        file.unlink()
    said = refused(capsys, str(copy / "not there" if breakage == "gone" else copy), "--set", "1")
    assert str(copy) in said


@given(some, some, some)
def test_edit_is_set_arithmetic(silent_now: set[int], add: set[int], remove: set[int]) -> None:
    wanted = (silent_now | add) - remove
    if add & remove or not wanted or len(wanted) == SIZE:
        with pytest.raises(InputError):
            silent.edited(silent_now, SIZE, add=add, remove=remove)
    else:
        assert silent.edited(silent_now, SIZE, add=add, remove=remove) == tuple(sorted(wanted))
