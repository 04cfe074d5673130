"""The page of `gesticulator live` in a real browser, with a microphone that plays a file."""

import gzip
import os
import shutil
import subprocess
import wave
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import chromium
from live_double import TURN, served

from data_module.motion.skeletons import CHARACTER
from gesticulator.live.limits import ServerLimits
from gesticulator.live.server import live_pages

ROOT = Path(__file__).resolve().parents[1]
_PATIENCE = 240_000
"""Milliseconds for what the page does: a browser draws in software, on a core that many share."""
MICROPHONE = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of a tone that comes and goes."""
    path = tmp_path_factory.mktemp("sound") / "tone.wav"
    samples = 12000 * np.sin(np.arange(32000) * 0.1) * np.sin(np.arange(32000) * 0.0004) ** 2
    with wave.open(str(path), "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(16000)
        sound.writeframes(samples.astype("<i2").tobytes())
    return path


@pytest.fixture(scope="module")
def window(recording: Path) -> Iterator[Any]:
    """A browser whose microphone hears the recording."""
    with chromium(*MICROPHONE, f"--use-file-for-fake-audio-capture={recording}") as browser:
        yield browser


@pytest.fixture(scope="module")
def opened(window: Any) -> Iterator[tuple[Any, list[str], list[str]]]:
    """The page, what it complained about and what it asked for."""
    complaints: list[str] = []
    requests: list[str] = []
    with served(ServerLimits(), live_pages()) as (_, port):
        page = window.new_page(viewport={"width": 640, "height": 480})
        page.set_default_timeout(_PATIENCE)
        page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector("body[data-ready=true]", timeout=_PATIENCE)
        yield page, complaints, requests


def _shown(page: Any, when: str = "true") -> tuple[float, float, float, str]:
    """How far the figure's hips are turned, which says what frame is shown; the media time that was drawn, the sound's
    at that moment, and how late the page says that it is. All of one picture, because a slow machine draws few, and
    much may lie between two. when: in the first one for which this is true; one with no voice is none, and gives a
    media time of -1."""
    turn, time, now, late = page.evaluate("""() => new Promise((told) => {
        const { stream, voice } = live;
        let drawn = null, heard = 0;
        stream.at = (time) => {
            drawn = time;
            heard = voice.now?.() ?? 0;
            return Object.getPrototypeOf(stream).at.call(stream, time);
        };
        const tell = (time) => {
            delete stream.at;
            told([live.performer.figure.bones[0].quaternion.toArray(), time, heard,
                document.querySelector("#latency").textContent]);
        };
        const look = () => {
            if (live.voice !== voice || live.stream !== stream) tell(-1);
            else if (drawn !== null && (WHEN)) tell(drawn);
            else requestAnimationFrame(look);
        };
        requestAnimationFrame(look);
    })""".replace("WHEN", when))
    return float(2 * np.arctan2(turn[1], turn[3])), time, now, late


def test_idle_then_microphone_then_recording(opened: tuple[Any, list[str], list[str]], recording: Path) -> None:
    page, complaints, requests = opened
    page.wait_for_function("() => live.stream.total > 20", timeout=_PATIENCE)
    assert page.evaluate("() => live.performer.figure.bones.map((bone) => bone.name)") == list(CHARACTER.names)
    assert page.inner_text("#state") == "idle"

    page.click("#microphone")
    page.wait_for_function("() => live.voice.kind === 'microphone' && live.stream.end > 120",
                           timeout=_PATIENCE)
    assert page.get_attribute("#microphone", "aria-pressed") == "true"
    assert page.inner_text("#state") == "speaking"
    assert 0 <= float(page.inner_text("#first").removesuffix(" ms")) < _PATIENCE
    # The stream looks half a second ahead: that, some time on the way and for the browser's pieces, and on a machine
    # that does much else seconds more. A picture that is drawn lies in what was received.
    yaw, shown, now, late = _shown(page, "drawn > 0.2 && drawn * 60 < live.stream.end")
    latency = float(late.removesuffix(" ms"))
    assert latency > 450
    assert shown == pytest.approx(now - latency / 1000, abs=0.4)
    assert yaw == pytest.approx(shown * 60 * TURN, abs=0.03), "the frame of that time is shown"

    page.click("#stop")
    page.wait_for_function("() => live.voice.kind === 'idle'")
    # Poses lie ready before their sound. A machine that gives the page no time for that is asked again.
    for _ in range(20):
        page.set_input_files("#file", recording)
        page.wait_for_function("() => live.voice.kind === 'recording'")
        yaw, shown, _, late = _shown(page, "drawn > 0.3 && drawn * 60 < live.stream.end")
        if shown >= 0 and late == "0 ms":
            break
    assert shown >= 0 and late == "0 ms"
    assert yaw == pytest.approx(shown * 60 * TURN, abs=0.03)
    page.wait_for_function("() => live.voice.kind === 'idle'", timeout=_PATIENCE)

    assert complaints == []
    assert all(url.startswith(("http://127.0.0.1", "ws://127.0.0.1", "blob:", "data:")) for url in requests)


def test_the_committed_script_is_the_build_of_its_sources(tmp_path: Path) -> None:
    viewer = ROOT / "viewer"
    node = shutil.which("node")
    if node is None or not (viewer / "node_modules").exists() or not (viewer / "src" / "figure.js").exists():
        pytest.skip("install Node.js (apt-get install nodejs npm), and run npm ci --prefix viewer")
    subprocess.run([node, str(viewer / "build_live.mjs")], check=True, env={**os.environ, "LIVE_OUT": str(tmp_path)})
    pages = live_pages()
    assert gzip.decompress((tmp_path / "live.min.js.gz").read_bytes()) == pages["/live.min.js"], "npm run build:live"
    assert (tmp_path / "licences.txt").read_bytes() == pages["/licences.txt"], "npm run build:live"
