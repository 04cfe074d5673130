"""The tools of `gesticulator mcp`, called by the official client over standard input and output."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import pytest
import soundfile

from data_module.motion.bvh import read_bvh
from data_module.motion.kinematics import positions_of
from gesticulator.plan.gestures import REPERTOIRE
from gesticulator.plan.plan_file import read_plan

pytest.importorskip("mcp", reason="the extra mcp is not installed")
anyio = pytest.importorskip("anyio")
ROOT = Path(__file__).resolve().parents[3]


def talk(folder: Path, *calls: tuple[str, dict[str, Any]] | Callable[[list[Any]], tuple[str, dict[str, Any]]]
         ) -> tuple[dict[str, Any], list[Any]]:
    """The tools by name, and what each call returns, in one session; a call may be made from the answers before it.
    An error is its text."""
    from mcp import ClientSession, StdioServerParameters
    from mcp.client.stdio import stdio_client

    async def session() -> tuple[dict[str, Any], list[Any]]:
        server = StdioServerParameters(command=sys.executable, cwd=folder, args=["-m", "gesticulator", "mcp"],
                                       env={"PYTHONPATH": ":".join(sys.path), "OMP_NUM_THREADS": "1",
                                            "PATH": "/usr/bin:/bin"})
        async with stdio_client(server) as streams, ClientSession(*streams) as client:
            await client.initialize()
            tools = {tool.name: tool for tool in (await client.list_tools()).tools}
            answers: list[Any] = []
            for call in calls:
                name, arguments = call(answers) if callable(call) else call
                done = await client.call_tool(name, arguments)
                text = "".join(getattr(part, "text", "") for part in done.content)
                answers.append(text if done.is_error else done.structured_content)
            return tools, answers

    return anyio.run(session)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """The first seconds of the example recording."""
    sound, rate = soundfile.read(ROOT / "examples" / "speech.flac", frames=4 * 48000)
    soundfile.write(tmp_path / "talk.wav", sound[:4 * rate], rate)
    return tmp_path / "talk.wav"


def test_a_recording_is_performed_edited_and_rendered(recording: Path, tmp_path: Path) -> None:
    tools, (first, edited, second) = talk(
        tmp_path,
        ("perform", {"speech": str(recording), "formats": ["bvh", "glb"], "seed": 3}),
        lambda answers: ("edit_plan", {"plan": answers[0]["plan"], "add": [{"gesture": "stop palm", "time": 2.0}],
                                       "hold_still": [[3.0, 4.0]]}),
        lambda answers: ("render", {"plan": answers[1]["plan"], "speech": str(recording)}))
    assert set(tools) == {"perform", "list_gestures", "edit_plan", "render"}
    assert all(tool.description and tool.input_schema["type"] == "object" for tool in tools.values())
    assert set(first["files"]) == {"bvh", "glb", "html"} and first["seconds"] == 4.0
    page = Path(urlparse(first["page"]).path)
    assert page.is_file() and page.parent == tmp_path / "gestures" and "<html" in page.read_text()[:200]
    assert Path(edited["plan"]).name == "talk-2.plan.json" and edited["gestures"] == [
        {"gesture": "stop palm", "word": None, "time": 2.0}]
    assert read_plan(edited["plan"]).knobs.hold_still == ((3.0, 4.0),)
    before, after = (read_bvh(Path(answer["files"]["bvh"])) for answer in (first, second))
    apart = abs(positions_of(before) - positions_of(after)).max(axis=(1, 2))
    assert len(apart) == 4 * before.fps
    assert apart[:int(0.6 * before.fps)].max() < 1e-3, "the rest stays the same"
    assert apart[int(1.8 * before.fps):int(2.2 * before.fps)].max() > 0.1, "a palm is raised at two seconds"


@pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="espeak-ng is not installed")
def test_a_text_is_spoken_and_its_marks_are_gestures(tmp_path: Path) -> None:
    _, (made, listed, edited) = talk(
        tmp_path, ("perform", {"text": "I have [shrug] really no idea where the train went this morning."}),
        ("list_gestures", {"search": "shrug"}),
        lambda answers: ("edit_plan", {"plan": answers[0]["plan"], "remove": ["shrug"]}))
    assert soundfile.info(made["speech"]).duration == pytest.approx(made["seconds"], abs=0.01) and made["seconds"] > 2
    assert {"gesture": "shrug", "word": "really", "time": None} in made["gestures"]
    assert "shrug" in [gesture["name"] for gesture in listed["result"]]
    assert all(gesture["name"] in REPERTOIRE for gesture in listed["result"])
    assert "shrug" not in [gesture["gesture"] for gesture in edited["gestures"]]


def test_mistakes_are_told_to_the_model_in_a_line(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(json.dumps({"format": "other"}))
    _, answers = talk(
        tmp_path, ("perform", {}), ("perform", {"speech": "nowhere.wav"}),
        ("perform", {"speech": str(recording), "formats": ["exe"]}), ("edit_plan", {"plan": "plan.json"}),
        ("perform", {"speech": str(recording)}),
        lambda got: ("edit_plan", {"plan": got[-1]["plan"], "add": [{"gesture": "fly", "time": 1.0}]}),
        lambda got: ("edit_plan", {"plan": got[-2]["plan"], "remove": ["wave"]}),
        lambda got: ("edit_plan", {"plan": got[-3]["plan"], "intensity": 9}))
    for answer, expected in zip([*answers[:4], *answers[5:]], (
            "give a sound file, a text, or both", "nowhere.wav: does not exist", "exe", "format is other",
            "fly", "has no gesture of or at 'wave'", "less than or equal to 2"), strict=True):
        assert isinstance(answer, str) and expected in answer and "Traceback" not in answer, answer
    assert [path.suffix for path in (tmp_path / "gestures").iterdir() if path.suffix == ".exe"] == []
