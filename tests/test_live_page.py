"""The page of `gesticulator live` in a real browser, with a microphone that plays a file."""

from __future__ import annotations

import hashlib
import os
import shutil
import wave
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_double import TURN, served

from data_module.motion.skeletons import CHARACTER
from gesticulator.serve import page as page_module
from gesticulator.serve.page import pages
from gesticulator.serve.settings import ServerLimits

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
         "--disable-background-networking", "--disable-component-update", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", "--autoplay-policy=no-user-gesture-required",
         "--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]


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
def opened(recording: Path) -> Iterator[tuple[Any, list[str], list[str]]]:
    """The page, what it complained about and what it asked for."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    if not program:
        pytest.skip("no chromium on this machine")
    complaints: list[str] = []
    requests: list[str] = []
    with served(ServerLimits(), pages()) as (_, port), playwright.sync_playwright() as driver:
        window = driver.chromium.launch(executable_path=program,
                                        args=[*FLAGS, f"--use-file-for-fake-audio-capture={recording}"])
        page = window.new_page(viewport={"width": 640, "height": 480})
        page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector("body[data-ready=true]", timeout=60_000)
        yield page, complaints, requests
        window.close()


def _yaw(page: Any) -> float:
    """How far the figure's hips are turned: it says which frame is shown."""
    turn = page.evaluate("() => live.stage.figure.bones[0].quaternion.toArray()")
    return float(2 * np.arctan2(turn[1], turn[3]))


def test_idle_then_microphone_then_recording(opened: tuple[Any, list[str], list[str]], recording: Path) -> None:
    page, complaints, requests = opened
    page.wait_for_function("() => live.stream.total > 20", timeout=20_000)
    assert page.evaluate("() => live.stage.figure.bones.map((bone) => bone.name)") == list(CHARACTER.names)
    assert page.inner_text("#state") == "idle"

    page.click("#microphone")
    page.wait_for_function("() => live.voice.constructor.name === 'Microphone' && live.stream.end > 120",
                           timeout=30_000)
    assert page.get_attribute("#microphone", "aria-pressed") == "true"
    assert page.inner_text("#state") == "speaking"
    # The stream looks half a second ahead: that, and some time on the way and for the browser's pieces.
    latency = float(page.inner_text("#latency").removesuffix(" ms"))
    assert 450 < latency < 2000
    shown, now = page.evaluate("() => [live.voice.time(), live.voice.now()]")
    assert shown == pytest.approx(now - latency / 1000, abs=0.4)
    assert _yaw(page) == pytest.approx(shown * 60 * TURN, abs=0.03), "the frame of that time is shown"

    page.click("#stop")
    page.wait_for_function("() => live.voice.constructor.name === 'Idle'")
    page.set_input_files("#file", recording)
    page.wait_for_function("() => live.voice.constructor.name === 'Recording' && live.voice.time() > 1",
                           timeout=30_000)
    assert page.evaluate("() => live.stream.end") > 60 * 2, "poses lie ready before their sound"
    assert page.inner_text("#latency") == "0 ms"
    shown = page.evaluate("() => live.voice.time()")
    assert _yaw(page) == pytest.approx(shown * 60 * TURN, abs=0.03)
    page.wait_for_function("() => live.voice.constructor.name === 'Idle'", timeout=20_000)

    assert complaints == []
    assert all(url.startswith(("http://127.0.0.1", "ws://127.0.0.1", "blob:", "data:")) for url in requests)
    if os.environ.get("SCREENSHOT"):
        page.screenshot(path=os.environ["SCREENSHOT"])


def test_three_is_unmodified() -> None:
    folder = Path(page_module.__file__).parents[1] / "assets" / "live"
    digest = hashlib.sha256((folder / "three.module.min.js").read_bytes()).hexdigest()
    assert digest in (folder / "README.md").read_text()
