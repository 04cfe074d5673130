"""Pictures per second of the page's canvas: `python benchmarks/page_speed.py [--page FILE.html] [--seconds 10]`.

The page plays in headless Chromium with software rendering (SwiftShader), in a canvas of 960 x 540 by default. One
picture is one call of `requestAnimationFrame` while it plays; each draws the figure and the timeline. Meanwhile keys
are pressed (zoom in, zoom out): the desk is quick if what they change is drawn soon. A busy machine draws fewer
pictures, so its load is printed. Needs playwright and a Chromium (`CHROMIUM` names another one).
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--autoplay-policy=no-user-gesture-required")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
LEAST = 10.0
"""Pictures per second that are wanted with software rendering on a quiet machine."""
SOON = 0.2
"""Seconds within which a key should be seen, of nine keys in ten."""
KEYS = 10
"""Keys that are pressed while it plays."""
_COLLECT = """() => {
    window.pictures = [];
    window.waits = [];
    const note = (now) => { window.pictures.push(now); requestAnimationFrame(note); };
    requestAnimationFrame(note);
    addEventListener("keydown", (event) => {
        const pressed = event.timeStamp;
        // Drawn in the next picture, and shown before the one after it.
        requestAnimationFrame(() => requestAnimationFrame((now) => window.waits.push(now - pressed)));
    }, true);
}"""


@dataclass(frozen=True)
class Speed:
    """rate: pictures per second; median, slowest: seconds between two pictures, in the middle and of the slowest
    twentieth; wait: seconds from a key to the picture, of nine keys in ten, NaN without keys."""

    rate: float
    median: float
    slowest: float
    wait: float

    @property
    def suffices(self) -> bool:
        """Whether the canvas and the desk are quick enough."""
        return self.rate >= LEAST and not self.wait > SOON


def speed(times: Sequence[float], waits: Sequence[float] = ()) -> Speed:
    """The speed of a page. times: of its pictures, rising; waits: from keys to pictures; milliseconds. `ValueError` for
    fewer than two pictures, and for times that do not rise."""
    steps = np.diff(np.asarray(times, dtype=np.float64)) / 1000.0
    if not len(steps) or (steps <= 0.0).any():
        raise ValueError("two or more pictures at rising times are needed")
    wait = float(np.quantile(np.asarray(waits) / 1000.0, 0.9)) if len(waits) else float("nan")
    return Speed(len(steps) / float(steps.sum()), float(np.median(steps)), float(np.quantile(steps, 0.95)), wait)


def row(what: str, size: tuple[int, int], made: Speed) -> str:
    """A row of the table."""
    return (f"| {what} | {size[0]} x {size[1]} | {made.rate:.1f} | {made.median:.3f} | {made.slowest:.3f} | "
            f"{made.wait:.3f} |")


HEAD = ("| page | canvas | pictures a second | median step, s | slowest twentieth, s | key to picture, s |\n"
        "|---|---|---|---|---|---|")


def measured(page: Any, size: tuple[int, int], seconds: float) -> Speed:
    """The speed of an opened page that plays for some seconds in a canvas of a size."""
    wide, high = page.viewport_size["width"], page.viewport_size["height"]
    for _ in range(3):  # the canvas takes what the panels leave
        box = page.evaluate("() => [document.getElementById('figure').clientWidth, "
                            "document.getElementById('figure').clientHeight]")
        wide, high = wide + size[0] - box[0], high + size[1] - box[1]
        page.set_viewport_size({"width": wide, "height": high})
    page.wait_for_function("() => preview.clock.audible")
    page.evaluate("() => { preview.clock.seek(0); preview.clock.loop = true; preview.clock.play(); }")
    page.wait_for_function("() => preview.clock.playing")
    page.wait_for_timeout(1000)
    page.evaluate(_COLLECT)
    for number in range(KEYS):
        page.wait_for_timeout(1000.0 * seconds / KEYS)
        page.keyboard.press("+" if number % 2 == 0 else "-")
    page.wait_for_timeout(500)
    return speed(*page.evaluate("() => [window.pictures, window.waits]"))


def default_page(folder: Path) -> Path:
    """A page of the first ten seconds of the example's voice."""
    import soundfile

    from gesticulator import Gesticulator

    samples, rate = soundfile.read(ROOT / "examples" / "speech.flac", frames=10 * 16000, dtype="float32")
    return Gesticulator.from_pretrained()(samples, rate, seed=1).save(folder / "talk.html")


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    p.add_argument("--page", type=Path, help="a page that gesticulator infer wrote; by default one is made")
    p.add_argument("--seconds", type=float, default=10.0, help="for which it plays")
    p.add_argument("--size", type=int, nargs=2, default=(960, 540), metavar=("WIDTH", "HEIGHT"), help="of the canvas")
    asked = p.parse_args()
    program = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        p.error("no Chromium was found: install one, or name it in the variable CHROMIUM")
    from playwright.sync_api import sync_playwright

    size = (asked.size[0], asked.size[1])
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        file = asked.page or default_page(Path(folder))
        browser = driver.chromium.launch(executable_path=program, args=list(FLAGS))
        page = browser.new_page(viewport={"width": size[0] + 360, "height": size[1] + 320})
        page.set_default_timeout(120_000)
        page.goto(file.resolve().as_uri())
        page.wait_for_selector("body[data-ready=true]")
        made = measured(page, size, asked.seconds)
        browser.close()
    print(f"Load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n\n{HEAD}")
    print(row(file.name, size, made))
    print(f"\n{'fast enough' if made.suffices else 'too slow'}: at least {LEAST:g} pictures a second, and at most "
          f"{SOON:g} s from a key to the picture, are wanted on a quiet machine")


if __name__ == "__main__":
    main()
