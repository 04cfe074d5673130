"""`gesticulator view`: the command, the shipped models behind the page, and edits that are gone on with."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
import soundfile
from performances import example, write_example
from small_characters import write_character

from gesticulator import Gesticulator
from gesticulator.page.command import COMMAND, _job, _performed, _way_in
from gesticulator.page.edits import Edits, StaleError, held, place_of
from gesticulator.performance import Performance
from gesticulator.plan.plan import GesturePlan
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
                                                 refused: Callable[..., str]) -> None:
    assert said in refused("view", *(recording if word == "SOUND" else word for word in words))


def _silenced(plan: GesturePlan, *places: int) -> GesturePlan:
    return replace(plan, blocks=tuple(replace(block, silent=True) if at in places else block
                                      for at, block in enumerate(plan.blocks)))


def test_saved_edits_are_gone_on_with_and_nothing_is_overwritten(system: Gesticulator, tmp_path: Path,
                                                                 capsys: pytest.CaptureFixture[str]) -> None:
    sound = write_example(tmp_path / "talk.wav", 4.0, "FLOAT")

    def gone_on(*words: str, of: Path = sound) -> tuple[Performance, Edits]:
        return _performed(system, _job(COMMAND.parser("gesticulator view").parse_args([str(of), *words])))

    def texts() -> dict[str, str]:
        return {path.name.partition(".json")[2]: path.read_text() for path in tmp_path.glob("talk.wav.*.json*")}

    performance, edits = gone_on("--seed", "1")
    assert not edits.place.exists(), "nothing is edited"  # type: ignore[union-attr]
    plan = _silenced(performance.labelled(sound.name).plan(), 2, 3)
    edits.take(plan, "page")
    place = place_of(sound)
    assert read_plan(place) == plan and set(texts()) == {""}
    (performance, edits), said = gone_on(), capsys.readouterr().out
    assert [block.silent for block in performance.plan().blocks] == [block.silent for block in plan.blocks]
    assert "are opened" in said and performance.retiming is None
    # Another recording of that stem has edits of its own; those of the former name are of the sound that they name.
    other = tmp_path / "talk.flac"
    soundfile.write(other, example(3.0).samples, 16000)
    former = tmp_path / "talk.edits.plan.json"
    place.rename(former)
    assert gone_on(of=other)[1].revision == 0 and "are opened" not in capsys.readouterr().out
    edits = gone_on()[1]
    assert "are opened" in capsys.readouterr().out
    edits.take(_silenced(plan, 4), "page")
    assert read_plan(former) == plan and read_plan(place) == _silenced(plan, 4)
    # The sound was exported again, with a pause at the start: what is moved replaces the plan, which is copied first.
    saved = place.read_text()
    soundfile.write(sound, np.concatenate([np.zeros(16000, np.float32), example(4.0).samples]), 16000,
                    subtype="FLOAT")
    performance, edits = gone_on()
    assert performance.retiming is not None and "moved onto the new sound" in capsys.readouterr().out
    assert texts() == {"": saved}
    edits.take(performance.plan(), "page")
    assert texts()[".old"] == saved and texts()[""] != saved
    # Two plans in a row that do not fit, and one that is begun anew by another plan: all are there afterwards.
    saved = place.read_text()
    assert gone_on("--speaker", system.bundle.speakers[0])[1].notice and not place.exists()
    assert "determined by the plan" in capsys.readouterr().err
    place.write_text("{")
    assert gone_on()[1].revision == 0 and "is not opened" in capsys.readouterr().err
    place.write_text("a plan of somebody")
    edits = gone_on("--plan", str(tmp_path / "talk.wav.edits.plan.json.old.2"))[1]
    edits.take(performance.plan(), "page")
    edits.take(plan, "page")
    assert [texts()[end] for end in (".old.2", ".old.3", ".old.4")] == [saved, "{", "a plan of somebody"]
    # Another program writes the file while the page is open.
    place.write_text("mine")
    edits.take(performance.plan(), "page")
    assert texts()[".old.5"] == "mine" and read_plan(place) == performance.plan()


def test_an_edit_that_does_not_know_of_others_is_refused(system: Gesticulator) -> None:
    plan, edits = system(example(3.0), seed=1).plan(), Edits()
    edits.plan = plan
    edits.check(0, "a")
    edits.take(_silenced(plan, 1), "a")
    edits.check(0, "a")  # it may send an edit before it has the answer to the last one
    for base, page in ((0, "b"), (2, "a"), (-1, "b")):
        with pytest.raises(StaleError):
            edits.check(base, page)
    edits.check(1, "b")
    edits.take(edits.plan, "b")
    assert edits.revision == 1, "the same plan is no edit"
    assert "plan" not in json.loads(edits.state(1))
    assert json.loads(edits.state(0))["plan"]["blocks"][1]["silent"]


def test_a_second_page_of_a_file_is_refused_in_a_line(recording: Path, refused: Callable[..., str]) -> None:
    with held(place_of(recording)):
        assert "is in use by gesticulator view (process" in refused("view", recording, "--no-browser")


def test_a_browser_is_led_in_by_a_private_file(tmp_path: Path) -> None:
    address = _way_in(tmp_path, "http://127.0.0.1:1/secret/")
    assert address.startswith("file:") and "secret" not in address
    assert "url=http://127.0.0.1:1/secret/" in Path(address.removeprefix("file://")).read_text()


@contextmanager
def viewing(sound: Path, *words: str, stderr: int | None = None) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`gesticulator view` as a program, and its address."""
    process = subprocess.Popen([sys.executable, "-c", CODE, str(sound), "--no-browser", *words], stdout=subprocess.PIPE,
                               stderr=stderr, text=True)
    assert process.stdout is not None
    try:
        yield process, next(line for line in process.stdout if line.startswith("http://")).split()[0]
    finally:
        process.kill()
        process.wait(30)


def test_page_and_terminal_say_the_same_of_what_cannot_be_shown(tmp_path: Path) -> None:
    (sound := tmp_path / "talk.wav").write_text("no sound at all")
    with viewing(sound, stderr=subprocess.PIPE) as (process, url):
        while "failed" not in (told := json.load(urlopen(url + "progress"))):
            time.sleep(0.02)
        said = process.communicate(timeout=60)[1]
        assert process.returncode == 2 and said == f"gesticulator: {told['failed']}\n" and "talk.wav" in said


def test_the_command_shows_a_character(recording: Path, tmp_path: Path) -> None:
    rig = write_character(tmp_path / "rig.glb")
    with viewing(recording, "--character", str(rig), "--fps", "25") as (process, url):
        assert b'id="performance"' not in urlopen(url).read(), "the page opens before the talk is there"
        shares = [0.0]
        while not (told := json.load(urlopen(url + "progress")))["ready"]:
            shares.append(told.get("share", 0.0))
            time.sleep(0.02)
        assert shares == sorted(shares) and shares[-1] > 0.5 and told["name"] == recording.name
        page = urlopen(url).read().decode()
        assert "<img" not in page
        told = json.loads(page.partition('id="performance">')[2].partition("</script>")[0])
        assert told["title"] == recording.stem and set(told["character"]["joints"]) > {"Hips", "LeftForeArm"}
        (first,) = told["takes"]
        assert "face" in first, "lips and blinks are on"
        assert "LeftFoot" in first["skeleton"]["names"], "a character with legs stands on them"
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
