"""The preview page: what is in it. How it behaves in a browser is in test_viewer.py."""

import base64
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from performances import perform, write
from small_characters import write_character

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER, FINGERED, standing
from gesticulator.export import html
from gesticulator.performance import Performance

ROOT = Path(__file__).parents[1]
ASSETS = ROOT / "gesticulator" / "assets"
BREAKS_OUT = "</script><img src=x onerror=broken=1>"


class _Elements(HTMLParser):
    """Every element's attributes, and the text of every script by its id."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=False)
        self.attributes: list[tuple[str, str, str]] = []
        self.scripts: dict[str, str] = {}
        self._script: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag == "script":
            self._script = dict(attrs).get("id") or "main"

    def handle_endtag(self, tag: str) -> None:
        if tag == "script":
            self._script = None

    def handle_data(self, data: str) -> None:
        if self._script is not None:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data


def _data(page: str) -> dict[str, Any]:
    return json.loads(_Elements(page).scripts["performance"])


def _page(performance: Performance, title: str = "talk") -> str:
    return html.page({"take": performance.scene()}, title)


def test_page_loads_nothing_from_outside() -> None:
    parsed = _Elements(_page(perform()))
    loads = [(tag, name, value) for tag, name, value in parsed.attributes if name in ("src", "href", "srcset", "data")]
    assert loads == [("link", "href", "data:,")]
    assert not [(tag, name) for tag, name, _ in parsed.attributes if name.startswith("on") or name == "style"]
    assert not re.search(r"@import|url\(", (ASSETS / "viewer.css").read_text())


def _policy(page: str) -> dict[str, list[str]]:
    told = next(value for tag, name, value in _Elements(page).attributes if tag == "meta" and "default-src" in value)
    return {words[0]: words[1:] for words in (part.split() for part in told.split(";"))}


def test_the_policy_allows_this_script_and_style_alone() -> None:
    page = _page(perform())
    policy = _policy(page)
    assert policy["default-src"] == policy["base-uri"] == policy["form-action"] == ["'none'"]
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL)
    assert style
    for text, rule in ((_Elements(page).scripts["main"], "script-src"), (style[1], "style-src")):
        assert policy[rule] == [f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"]
    assert policy["connect-src"] == ["blob:", "data:"], "what the page was given, and no host"
    live = _policy(html.page({"take": perform().scene()}, "talk", more={"live": {"token": "t"}}))
    assert live == {**policy, "connect-src": ["'self'", "blob:", "data:"]}


def test_the_notices_of_the_libraries_are_in_the_page() -> None:
    page = unescape(_page(perform()).split('<script type="application/json"')[0])
    lock = json.loads((ROOT / "viewer" / "package-lock.json").read_text())["packages"]
    for name, holder in (("three", "three.js authors"), ("@pixiv/three-vrm", "pixiv"),
                         ("@pixiv/three-vrm-animation", "pixiv")):
        assert f"{name} {lock[f'node_modules/{name}']['version']}" in page
        assert holder in page and holder in (ROOT / "NOTICE").read_text()
    assert page.count("Permission is hereby granted, free of charge") == page.count("THE SOFTWARE IS PROVIDED") >= 2


def test_motion_decodes_to_the_quaternions() -> None:
    performance = perform(fps=60.0)
    told = _data(_page(performance))["takes"][0]
    steps = np.frombuffer(base64.b64decode(told["rotations"]), "<i2").reshape(told["frames"], len(CHARACTER), 4)
    decoded = rotation.normalise(steps / told["steps"])
    assert rotation.angle_between(decoded, performance.motion.rotations).max() < 2e-4
    root = np.frombuffer(base64.b64decode(told["root"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(root, standing(performance.motion).root_positions[:1], atol=1e-6)
    blocks = told["plan"]["blocks"]
    np.testing.assert_allclose([block["start"] for block in blocks], performance.blocks.edges[:-1], atol=1e-5)
    assert [block["lexeme"] for block in blocks] == performance.lexemes.tolist()
    assert told["fps"] == 60.0


def test_words_and_names_cannot_break_out() -> None:
    page = html.page({BREAKS_OUT: perform().scene()}, 'a "<img src=x>" & {{script}}')
    told = _data(page)
    assert told["takes"][0]["plan"]["words"][0]["text"] == "</script><b>"
    assert told["takes"][0]["name"] == BREAKS_OUT
    assert "<title>a &quot;&lt;img src=x&gt;&quot; &amp; {{script}} " in page
    assert [tag for tag, _, _ in _Elements(page).attributes if tag in ("img", "b")] == []
    assert page.count("</script>") == 2


def test_a_long_recording_is_one_page_with_fewer_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    performance = perform(fps=60.0)
    whole = _data(_page(performance))
    monkeypatch.setattr(html, "LONG", 2.0)
    assert write(tmp_path / "talk.html", performance) == tmp_path / "talk.html"
    assert [path.name for path in tmp_path.iterdir()] == ["talk.html"]
    told = _data((tmp_path / "talk.html").read_text())
    assert told["takes"][0]["fps"] == 30.0 and told["duration"] == whole["duration"] and told["sound"] == whole["sound"]

    def poses(page: dict[str, Any]) -> np.ndarray:
        take = page["takes"][0]
        steps = np.frombuffer(base64.b64decode(take["rotations"]), "<i2").reshape(take["frames"], len(CHARACTER), 4)
        return rotation.normalise(steps / take["steps"])

    assert rotation.angle_between(poses(told), poses(whole)[::2]).max() < 2e-4, "every second frame, at its own time"


def test_a_name_of_bytes_that_are_no_text_is_written(tmp_path: Path) -> None:
    target = tmp_path / os.fsdecode(b"caf\xe9 \xc3\xa9.html")
    write(target, perform())
    assert "<title>caf\ufffd \u00e9 " in target.read_text(encoding="utf-8")


def test_two_takes_of_one_recording_make_one_page(tmp_path: Path) -> None:
    first, second = perform(), perform(skeleton=FINGERED, seed=4)
    one, other = first.scene(), second.scene()
    page = html.write_comparison(tmp_path / "two.html", {"lstm": one, "cql": other}).read_text()
    takes = _data(page)["takes"]
    assert [take["name"] for take in takes] == ["lstm", "cql"] and _data(page)["together"]
    assert [take["plan"]["blocks"][0]["lexeme"] for take in takes] == [int(first.lexemes[0]), int(second.lexemes[0])]
    for takes, wrong in (({"a": one}, "cannot be compared"),
                         ({"a": one, "b": perform(seconds=3.0).scene()}, "different length"),
                         ({"a": one, "b": other, "c": one}, "too many")):
        with pytest.raises(InputError, match=wrong):
            html.write_comparison(tmp_path / "none.html", takes)
    assert not (tmp_path / "none.html").exists()


def test_a_character_comes_along_in_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = tmp_path / "rig.glb"
    write_character(rig)
    told = _data(_page(perform().on(rig)))
    nodes = json.loads(rig.read_bytes()[20:20 + int.from_bytes(rig.read_bytes()[12:16], "little")])["nodes"]
    assert base64.b64decode(told["character"]["data"]) == rig.read_bytes()
    assert nodes[told["character"]["joints"]["LeftForeArm"]]["name"] == "mixamorig:LeftForeArm"
    monkeypatch.setattr(html, "LARGEST_CHARACTER", 1000)
    told = _data(_page(perform().on(rig)))
    assert "character" not in told and "rig.glb is too large" in told["notice"]


def test_the_committed_page_is_the_build_of_its_sources(tmp_path: Path) -> None:
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("npm is not installed")
    if not (ROOT / "viewer" / "node_modules").is_dir():
        pytest.skip("npm ci --prefix viewer has not been run")
    subprocess.run([npm, "run", "--silent", "build", "--prefix", str(ROOT / "viewer")], check=True,
                   env={**os.environ, "VIEWER_OUT": str(tmp_path)})
    made, committed = ({path.name: gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
                        for path in folder.glob("viewer.*")} for folder in (tmp_path, ASSETS))
    assert set(made) == set(committed) == {path.name for path in tmp_path.iterdir()}
    for name, content in made.items():
        assert content == committed[name], f"{name}: run npm run build --prefix viewer, and commit it"
    assert len(made["viewer.min.js.gz"]) < 1_200_000
