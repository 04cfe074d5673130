"""Weights by name, against a hub on this machine that huggingface_hub's own client talks to."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hub_server import SECRET, Hub, hub_server

from gesticulator.bundle.files import CARD, INDEX, NAMED, read_index

pytest.importorskip("huggingface_hub", reason="the extra hub is not installed")
LISTED = [INDEX, *read_index(NAMED["default"])["files"]]
RUN = """
import os, shutil, sys
from data_module.errors import InputError
from gesticulator import Gesticulator
if "FREE" in os.environ:
    shutil.disk_usage = lambda path: type("Usage", (), {"free": int(os.environ["FREE"])})
try:
    system = Gesticulator.from_pretrained(*sys.argv[1:])
    for name in system.bundle.parts:
        system.bundle.runners[name]
    print("loaded", system.bundle.config.name)
except InputError as error:
    print(error)
"""
"""In a process of its own, as huggingface_hub reads its environment when it is imported."""


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[Hub]:
    """A hub whose repository org/talk has the shipped bundle."""
    with hub_server() as server:
        server.commit("org/talk", {name: (NAMED["default"] / name).read_bytes() for name in LISTED})
        yield server


def run(tmp_path: Path, hub: Hub, *words: str, **environment: str) -> str:
    """What is printed by `RUN` with words, or by a command line."""
    code = [sys.executable, "-m", *words] if words[0] == "gesticulator" else [sys.executable, "-c", RUN, *words]
    done = subprocess.run(code, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False, env={
        **os.environ, "HF_ENDPOINT": hub.address, "HF_HOME": str(tmp_path / "home"), "HF_TOKEN": "",
        "HF_HUB_DISABLE_PROGRESS_BARS": "1", "HF_HUB_DISABLE_XET": "1",
        "PYTHONPATH": os.pathsep.join(sys.path), **environment})
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout + (done.stderr if done.returncode else "")


def downloads(hub: Hub) -> list[str]:
    return [line.rpartition("/")[2] for line in hub.requests if line.startswith("GET org/talk/resolve")]


def test_an_id_is_downloaded_once_and_used_without_a_network(hub: Hub, tmp_path: Path) -> None:
    hub.commit("org/talk", {"setup.py": b"a program", "stray.safetensors": b"?"})
    assert run(tmp_path, hub, "org/talk") == "loaded default\n"
    assert sorted(downloads(hub)) == sorted(LISTED), "what the index lists, and nothing else"
    hub.requests.clear()
    assert run(tmp_path, hub, "org/talk") == "loaded default\n" and not downloads(hub)
    hub.requests.clear()
    assert run(tmp_path, hub, "org/talk", HF_HUB_OFFLINE="1") == "loaded default\n" and not hub.requests
    closed = Hub(address="http://127.0.0.1:9")
    assert run(tmp_path, closed, "org/talk") == "loaded default\n", "the hub is away"
    # A folder of that name goes before the hub, as it did before there was one.
    shutil.copytree(NAMED["paper"], tmp_path / "org" / "talk")
    assert run(tmp_path, hub, "org/talk") == "loaded paper\n" and not hub.requests


def test_a_revision_is_a_branch_or_a_commit(hub: Hub, tmp_path: Path) -> None:
    first = hub.branches["org/talk"]["main"]
    hub.branches["org/talk"]["small"] = hub.commit("org/talk", {
        name: (NAMED["paper"] / name).read_bytes() for name in [INDEX, *read_index(NAMED["paper"])["files"]]})
    for words in (("org/talk@small",), ("org/talk", "small")):
        assert run(tmp_path, hub, *words) == "loaded paper\n"
    assert run(tmp_path, hub, f"org/talk@{first}") == "loaded default\n"
    assert run(tmp_path, hub, "org/talk@gone") == "org/talk@gone: has no such revision; name a branch, a tag or a " \
        "commit of it\n"


def test_what_is_wrong_is_said_in_a_line(hub: Hub, tmp_path: Path) -> None:
    hub.commit("org/other", {"model.bin": b"pickled"})
    index = json.loads((NAMED["default"] / INDEX).read_text())
    hub.commit("org/later", {INDEX: json.dumps({**index, "format": 99}).encode()})
    hub.commit("org/lacking", {INDEX: (NAMED["default"] / INDEX).read_bytes()})
    hub.commit("org/secret", {})
    hub.private.add("org/secret")
    for words, environment, expected in (
            (("org/none",), {}, f"is neither a folder here nor a repository of {hub.address}"),
            (("org/secret",), {}, f"is neither a folder here nor a repository of {hub.address}"),
            (("org/other",), {}, "is not a bundle (no bundle.json)"),
            (("org/later",), {}, "has format 99, and this version reads format 7"),
            (("org/lacking",), {}, "is missing from the bundle"),
            (("org/talk",), {"FREE": "1000000"}, "needs 14 MB, and"),
            (("org/talk",), {"HF_HUB_OFFLINE": "1"}, "is neither a folder nor stored on this machine")):
        line = run(tmp_path, hub, *words, **environment)
        assert expected in line and line.count("\n") == 1 and "; " in line, line
    assert not any(name.endswith(".safetensors") for name in downloads(hub)), "nothing before it was known to be good"


def test_a_file_with_another_hash_is_refused_on_the_way_and_on_the_disk(hub: Hub, tmp_path: Path) -> None:
    whole = (NAMED["default"] / "gate.safetensors").read_bytes()
    hub.commit("org/talk", {"gate.safetensors": whole[:-1] + bytes([whole[-1] ^ 1])}, "broken")
    assert "gate.safetensors is not the file that the bundle was made with" in run(tmp_path, hub, "org/talk@broken")
    assert run(tmp_path, hub, "org/talk") == "loaded default\n"
    (stored,) = (path for path in (tmp_path / "home").rglob("gate.safetensors") if path.read_bytes() == whole)
    stored.resolve().write_bytes(whole[:-1] + b"?")
    line = run(tmp_path, hub, "org/talk")
    assert "wrong SHA-256" in line
    shutil.rmtree(line.split("; delete ")[1].split(" to download")[0])
    assert run(tmp_path, hub, "org/talk") == "loaded default\n", "the advice works"


def test_what_is_pushed_is_what_is_loaded(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    shutil.copytree(NAMED["paper"], folder)
    push = ("gesticulator", "bundle", "push", "mine", "org/new")
    assert "set HF_TOKEN" in run(tmp_path, hub, *push)
    printed = run(tmp_path, hub, *push, HF_TOKEN=SECRET)
    assert printed == f"org/new: {hub.address}/org/new/commit/{hub.branches['org/new']['main']}\n"
    stored = hub.repositories["org/new"][hub.branches["org/new"]["main"]]
    assert set(stored) == {"README.md", INDEX, *read_index(folder)["files"]}
    assert all(stored[path.name] == path.read_bytes() for path in folder.iterdir())
    assert run(tmp_path, hub, "org/new") == "loaded paper\n"
    run(tmp_path, hub, *push, "--revision", "next", HF_TOKEN=SECRET)
    assert run(tmp_path, hub, "org/new@next") == "loaded paper\n"
    (folder / CARD).write_text("changed")
    commits = len(hub.repositories["org/new"])
    assert "wrong SHA-256" in run(tmp_path, hub, *push, HF_TOKEN=SECRET)
    assert len(hub.repositories["org/new"]) == commits, "what is broken is not published"


def test_the_page_has_front_matter_that_the_hubs_client_reads(hub: Hub, tmp_path: Path) -> None:
    from huggingface_hub import ModelCard

    assert run(tmp_path, hub, "gesticulator", "bundle", "card", "default", "-o", "page.md") == "page.md\n"
    card = ModelCard.load(tmp_path / "page.md")
    assert card.data.library_name == "gesticulator" and card.data.license == "other" and card.data.language == ["en"]
    body = card.text
    assert (NAMED["default"] / CARD).read_text().split("## Figures")[0].strip() in body
    assert 'from_pretrained("org/bundle")' in body
    assert "name a file with -o" in run(tmp_path, hub, "gesticulator", "bundle", "card", "default")
