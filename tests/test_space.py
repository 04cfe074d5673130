"""The page to try, `integrations/space`: a real voice in a real browser, its limits, and the memory that it takes."""

import os
import re
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
import yaml
from browser import chromium
from gltf_reader import GlbFile
from small_characters import write_character

from data_module.motion.bvh import read_bvh

ROOT = Path(__file__).resolve().parent.parent
SPACE = ROOT / "integrations" / "space"
MEGABYTES = 1000
"""What the page may take."""


def test_the_front_matter_is_that_of_a_space_and_agrees_with_the_requirements() -> None:
    front = yaml.safe_load((SPACE / "README.md").read_text().split("---")[1])
    assert front["sdk"] == "gradio" and (SPACE / front["app_file"]).is_file() and len(front["short_description"]) <= 60
    assert front["colorFrom"] in {"red", "yellow", "green", "blue", "indigo", "purple", "pink", "gray"}
    needed = re.search(r"gradio>=(\d+)", (SPACE / "requirements.txt").read_text())
    assert needed is not None and front["sdk_version"].split(".")[0] == needed[1]
    licence = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["license"]
    assert licence.lower().startswith(front["license"])
    assert len((SPACE / "app.py").read_text().splitlines()) < 150


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    """The page's address and its process, run by a Python that has Gradio."""
    python = os.environ.get("GRADIO_PYTHON") or (sys.executable if find_spec("gradio") else None)
    if python is None:
        pytest.skip("gradio is not installed, and GRADIO_PYTHON names no Python that has it")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([python, "-u", "app.py"], cwd=SPACE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                               text=True, env={**os.environ, "PYTHONPATH": str(ROOT), "GRADIO_SERVER_PORT": str(port),
                                               "GRADIO_ANALYTICS_ENABLED": "False", "OMP_NUM_THREADS": "1",
                                               "GRADIO_TEMP_DIR": str(tmp_path_factory.mktemp("uploads"))})
    assert process.stdout is not None
    lines: list[str] = []
    for line in process.stdout:
        lines.append(line)
        if found := re.search(r"http://\S+", line):
            break
    else:
        pytest.fail("".join(lines))
    yield found.group(), process.pid
    process.terminate()
    process.wait(30)


@pytest.fixture
def voice(tmp_path: Path) -> Path:
    """A person who reads: of LibriSpeech where the outside data are, else the example."""
    data = os.environ.get("GESTICULATOR_DATA")
    source = next(iter(sorted(Path(data or "nowhere").glob("voices/test_other/*.flac"))), ROOT / "examples/speech.flac")
    sound, rate = soundfile.read(source, stop=10 * soundfile.info(source).samplerate)
    soundfile.write(tmp_path / "voice.wav", sound, rate)
    return tmp_path / "voice.wav"


def opened(browser: Any, url: str, voice: Path) -> Any:
    """The page with a recording in it."""
    page = browser.new_page(viewport={"width": 1300, "height": 900}, accept_downloads=True)
    page.set_default_timeout(90_000)
    page.goto(url)
    page.locator("#recording input[type=file]").set_input_files(voice)
    page.locator("#recording button[aria-label=Clear]").wait_for()
    return page


def check_memory(process: int) -> None:
    """The most that the process has taken so far, where Linux tells it."""
    status = Path(f"/proc/{process}/status").read_text() if Path("/proc").is_dir() else "VmHWM: 0 kB"
    peak = int(status.split("VmHWM:")[1].split()[0]) / 1000
    print(f"peak memory {peak:.0f} MB")
    assert peak < MEGABYTES


def saved(page: Any, suffix: str, folder: Path) -> Path:
    """What the button of a format downloads."""
    with page.expect_download() as got:
        page.locator(f"#{suffix}").click()
    got.value.save_as(folder / f"got.{suffix}")
    return folder / f"got.{suffix}"


def test_a_voice_is_uploaded_watched_and_downloaded(address: tuple[str, int], voice: Path, tmp_path: Path) -> None:
    url, process = address
    vrm = write_character(tmp_path / "her.vrm", vrm="1.0")
    with chromium() as browser:
        page = opened(browser, url, voice)
        seconds = soundfile.info(voice).duration
        for character in (None, vrm):
            if character is not None:
                page.locator("#character input[type=file]").set_input_files(character)
                page.locator("#character .file-preview, #character table").first.wait_for()
                page.evaluate("() => document.querySelector('#page iframe').remove()")
            page.locator("#start").click()
            frame = page.frame_locator("#page iframe")
            frame.locator("body[data-ready=true]").wait_for(state="attached")
            frame.locator("canvas").first.wait_for()
            assert page.locator("#line").inner_text().startswith(f"{seconds:.1f} s of speech in")
            motion = read_bvh(saved(page, "bvh", tmp_path))
            assert motion.duration == pytest.approx(seconds, abs=0.05)
            assert np.abs(np.diff(motion.rotations, axis=0)).max() > 0.01
            assert saved(page, "vrma", tmp_path).read_bytes()[:4] == b"glTF"
            assert GlbFile.parse(saved(page, "glb", tmp_path).read_bytes()).document["animations"]
        long = tmp_path / "long.wav"
        soundfile.write(long, np.zeros(61 * 8000, np.float32), 8000)
        page.locator("#recording button[aria-label=Clear]").click()
        page.locator("#recording input[type=file]").set_input_files(long)
        page.wait_for_timeout(1500)
        page.locator("#start").click()
        page.get_by_text("The recording has 61 s; at most 60 s are taken.").wait_for()
    check_memory(process)


def test_of_two_visitors_at_once_the_second_waits_and_is_served(address: tuple[str, int], voice: Path) -> None:
    url, process = address
    sound, rate = soundfile.read(voice)
    # So much work that the first visitor is still served when the second one comes, on a slow machine as well.
    soundfile.write(voice, np.tile(sound, 5), rate)
    with chromium() as browser:
        pages = [opened(browser, url, voice) for _ in range(2)]
        for page in pages:
            page.locator("#start").click()
        pages[1].get_by_text(re.compile(r"queue: \d/\d")).first.wait_for()
        ends, work = [], []
        for page in pages:
            page.wait_for_function("() => /of speech in/.test(document.querySelector('#line')?.innerText ?? '')")
            ends.append(time.monotonic())
            work += map(float, re.findall(r"of speech in ([\d.]+) s", page.locator("#line").inner_text()))
            page.frame_locator("#page iframe").locator("body[data-ready=true]").wait_for(state="attached")
    # The work on the second begins when that on the first has ended, and both are in the same hurry.
    assert ends[1] - ends[0] > 0.7 * work[1], (ends, work)
    check_memory(process)
