"""`gesticulator view`: the command, the shipped models behind the page, and an edit that leaves the rest as it was."""

from __future__ import annotations

import base64
import http.client
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from small_characters import write_character

from gesticulator.serve.page_server import TOKEN_HEADER
from gesticulator.serve.view_command import COMMAND

ROOT = Path(__file__).resolve().parents[1]
# A shell that starts the tests in its background has its children ignore the interruption that ends the page.
CODE = ("import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from "
        "gesticulator.serve.view_command import COMMAND; sys.exit(COMMAND.main('gesticulator view', sys.argv[1:]))")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds of the example recording, under a name that could be an element."""
    samples, rate = soundfile.read(ROOT / "examples" / "speech.flac", frames=4 * 16000)
    path = tmp_path_factory.mktemp("view") / "<img src=x onerror=broken=1>.flac"
    soundfile.write(path, samples, rate)
    return path


@pytest.mark.parametrize(("words", "said"), [
    ([], "speech: is missing"), (["a.wav", "b.wav"], "names 2 recordings"), (["-"], "cannot be viewed"),
    (["none.wav"], "none.wav"), (["SOUND", "--character", "rig.fbx"], "cannot be shown by the page"),
    (["SOUND", "--port", "70000"], "--port 70000: cannot be used"), (["SOUND", "--port", "x"], "--port"),
    (["SOUND", "--plan", "a.json", "--beside", "lstm"], "leave one of them out"),
    (["SOUND", "--beside", "nobody"], "--beside"), (["SOUND", "-o", "out.bvh"], "-o"),
])
def test_what_cannot_be_viewed_is_told_in_a_line(words: list[str], said: str, recording: Path,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        COMMAND.main("gesticulator view", [str(recording) if word == "SOUND" else word for word in words])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and error.count("\n") == 1 and said in error


def test_it_lists_what_the_bundle_contains(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        sys.exit(COMMAND.main("gesticulator view", ["--list", "interpreters"]))
    assert not stop.value.code and "(default)" in capsys.readouterr().out


def _poses(take: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(take["rotations"]), "<i2").reshape(take["frames"], -1, 4)


def test_an_edit_comes_back_and_leaves_the_rest_as_it_was(recording: Path, tmp_path: Path) -> None:
    rig = write_character(tmp_path / "rig.glb")
    process = subprocess.Popen([sys.executable, "-c", CODE, str(recording), "--no-browser", "--character", str(rig),
                                "--fps", "25", "--beside", "lstm"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[0].removeprefix("http://").rstrip("/")
        connection = http.client.HTTPConnection(address, timeout=60)
        connection.request("GET", "/")
        page = connection.getresponse().read().decode()
        assert "<img" not in page
        told = json.loads(page.partition('id="performance">')[2].partition("</script>")[0])
        assert told["title"] == recording.stem and set(told["character"]["joints"]) > {"Hips", "LeftForeArm"}
        assert len(told["takes"]) == 2 and told["takes"][1]["name"].startswith("lstm")
        first = told["takes"][0]
        assert "LeftFoot" in first["skeleton"]["names"], "a character with legs stands on them"
        plan = json.loads(json.dumps(first["plan"]))
        block = plan["blocks"][len(plan["blocks"]) // 2]
        block["lexeme"] = next(one["lexeme"] for one in block["alternatives"] if one["lexeme"] != block["lexeme"])

        def ask(plan: dict[str, Any]) -> tuple[int, dict[str, Any]]:
            connection.request("POST", "/render", json.dumps({"plan": plan}), {
                "Content-Type": "application/json", "Origin": f"http://{address}",
                TOKEN_HEADER: told["live"]["token"]})
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read())

        status, made = ask(plan)
        assert status == 200 and made["plan"]["blocks"][len(plan["blocks"]) // 2]["lexeme"] == block["lexeme"]
        assert made["plan"]["drawn"] == first["plan"]["drawn"]
        moved = np.abs(_poses(made).astype(int) - _poses(first)).max(axis=(1, 2))
        times = np.arange(len(moved)) / made["fps"]
        arms = (times > block["start"] + 0.1) & (times < block["end"] - 0.1)
        assert moved[times < block["start"] - 0.5].max() <= 1, "before it nothing changes, but for the last bit"
        assert moved[arms].max() > 300, "the block is another one"
        assert ask(first["plan"])[1]["rotations"] == first["rotations"], "and the way back is the same motion"
        block["end"] += 3.0
        status, wrong = ask(plan)
        assert status == 400 and "line" in wrong["error"] and str(len(plan["blocks"]) // 2) in wrong["error"]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
