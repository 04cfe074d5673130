"""Files that the page asks for: those of the command line, with the character that is shown."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest
from performances import perform
from small_characters import write_character

from data_module.errors import InputError
from gesticulator.characters.retarget import Retargeter
from gesticulator.export.writers import WRITERS
from gesticulator.page.export import exported, formats

SECONDS = 1.0


def ask(request: dict[str, Any], retargeter: Retargeter | None = None) -> bytes:
    return exported({"plan": {}, **request}, lambda plan: perform(seconds=SECONDS), retargeter)


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".vrma", ".csv", ".json", ".npz"])
def test_a_file_is_that_of_the_command_line(suffix: str, tmp_path: Path) -> None:
    wanted = perform(seconds=SECONDS).save(tmp_path / f"talk{suffix}").read_bytes()
    assert ask({"format": suffix}) == wanted


def test_every_format_is_offered() -> None:
    assert [suffix for suffix, _ in formats()] == sorted(WRITERS)


def test_it_has_the_character_that_is_shown(tmp_path: Path) -> None:
    rig = write_character(tmp_path / "rig.glb")
    wanted = perform(seconds=SECONDS).on(rig).save(tmp_path / "talk.bvh").read_bytes()
    dropped = {"name": "rig.glb", "data": base64.b64encode(rig.read_bytes()).decode()}
    assert ask({"format": ".bvh", "character": dropped}) == wanted != ask({"format": ".bvh"})


@pytest.mark.parametrize(("request_", "said"), [
    ({"format": ".exe"}, "is unknown"), ({"format": "../x.bvh"}, "is unknown"), ({}, "is unknown"),
    ({"format": ".bvh", "plan": 3}, "is unknown"),
    ({"format": ".bvh", "character": 3}, "cannot be used"),
    ({"format": ".bvh", "character": {"name": "../../rig.fbx", "data": ""}}, "cannot be used"),
    ({"format": ".bvh", "character": {"name": "rig.glb", "data": "!"}}, "did not arrive whole"),
    ({"format": ".bvh", "character": {"name": "rig.glb", "data": "\u00e9"}}, "did not arrive whole"),
    ({"format": ".bvh", "character": {"name": "rig.glb", "data": "AAAA"}}, "character.glb"),
])
def test_what_cannot_be_made_is_told(request_: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        ask(request_)
