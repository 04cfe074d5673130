"""`gesticulator view`: the command, the shipped models behind the page, and edits that are gone on with."""

from __future__ import annotations

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
from performances import example, write_example
from small_characters import write_character

from gesticulator import Gesticulator
from gesticulator.options import InferenceOptions
from gesticulator.page.command import COMMAND, _job, _way_in, _with_saved_edits, place_of, save
from gesticulator.page.server import TOKEN_HEADER
from gesticulator.plan.plan_file import read_plan

ROOT = Path(__file__).resolve().parents[1]
# A shell that starts the tests in its background has its children ignore the interruption that ends the page.
CODE = ("import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from "
        "gesticulator.page.command import COMMAND; sys.exit(COMMAND.main('gesticulator view', sys.argv[1:]))")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds of the example recording, under a name that could be an element."""
    return write_example(tmp_path_factory.mktemp("view") / "<img src=x onerror=broken=1>.flac", 4.0)


@pytest.mark.parametrize(("words", "said"), [
    ([], "SPEECH"), (["a.wav", "b.wav"], "b.wav"), (["-"], "-: "), (["none.wav"], "none.wav"),
    (["SOUND", "--character", "rig.fbx"], "cannot be shown by the page"),
    (["SOUND", "--port", "70000"], "--port 70000: cannot be used"), (["SOUND", "--port", "x"], "--port"),
    (["SOUND", "-o", "out.bvh"], "-o"),
])
def test_what_cannot_be_viewed_is_told_in_a_line(words: list[str], said: str, recording: Path,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        COMMAND.main("gesticulator view", [str(recording) if word == "SOUND" else word for word in words])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and error.count("\n") == 1 and said in error


def test_saved_edits_are_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sound = write_example(tmp_path / "talk.wav", 4.0, "FLOAT")
    system = Gesticulator.from_pretrained()
    plan = system(sound, seed=1).plan()
    place = place_of(sound)
    save(sound, plan)
    assert read_plan(place) == plan

    def gone_on(*words: str) -> InferenceOptions:
        args = COMMAND.parser("gesticulator view").parse_args([str(sound), *words])
        return _with_saved_edits(system, _job(args)).options

    options = gone_on()
    assert (options.plan, options.retime) == (plan, False) and "are opened" in capsys.readouterr().out
    # The sound was exported again, with a pause at the start.
    soundfile.write(sound, np.concatenate([np.zeros(16000, np.float32), example(4.0).samples]), 16000,
                    subtype="FLOAT")
    assert gone_on().retime and "moved onto the new sound" in capsys.readouterr().out
    # What does not fit is put aside, and stays.
    assert gone_on("--speaker", system.bundle.speakers[0]).plan is None
    assert not place.exists() and read_plan(place.with_name(place.name + ".old")) == plan
    assert "determined by the plan" in capsys.readouterr().err
    place.write_text("{")
    assert gone_on().plan is None and place.with_name(place.name + ".old.2").read_text() == "{"


def test_a_browser_is_led_in_by_a_private_file(tmp_path: Path) -> None:
    address = _way_in(tmp_path, "http://127.0.0.1:1/secret/")
    assert address.startswith("file:") and "secret" not in address
    assert "url=http://127.0.0.1:1/secret/" in Path(address.removeprefix("file://")).read_text()


def test_the_command_shows_a_character_and_answers_edits(recording: Path, tmp_path: Path) -> None:
    rig = write_character(tmp_path / "rig.glb")
    process = subprocess.Popen([sys.executable, "-c", CODE, str(recording), "--no-browser", "--character", str(rig),
                                "--fps", "25"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address, _, secret = process.stdout.readline().split()[0].removeprefix("http://").rstrip("/").partition("/")
        connection = http.client.HTTPConnection(address, timeout=60)
        connection.request("GET", f"/{secret}/")
        page = connection.getresponse().read().decode()
        assert "<img" not in page
        told = json.loads(page.partition('id="performance">')[2].partition("</script>")[0])
        assert told["title"] == recording.stem and set(told["character"]["joints"]) > {"Hips", "LeftForeArm"}
        (first,) = told["takes"]
        assert "face" in first, "lips and blinks are on"
        assert "LeftFoot" in first["skeleton"]["names"], "a character with legs stands on them"

        def ask(plan: dict[str, Any]) -> tuple[int, bytes]:
            """The status and the answer to a plan; what answers hold is tested in test_editing.py."""
            connection.request("POST", f"/{secret}/render", json.dumps({"plan": plan, "have": 1}), {
                "Content-Type": "application/json", "Origin": f"http://{address}",
                TOKEN_HEADER: told["live"]["token"]})
            answer = connection.getresponse()
            return answer.status, answer.read()

        plan = json.loads(json.dumps(first["plan"]))
        block = plan["blocks"][len(plan["blocks"]) // 2]
        block["lexeme"] = next(other["lexeme"] for other in block["alternatives"] if other["lexeme"] != block["lexeme"])
        (same, before), (status, edited) = ask(first["plan"]), ask(plan)
        assert same == status == 200 and len(edited) > len(before) + 10_000, "bytes: frames come for the edit alone"
        block["end"] += 3.0
        status, wrong = ask(plan)
        assert status == 400 and f'blocks[{len(plan["blocks"]) // 2}].end' in json.loads(wrong)["error"]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
