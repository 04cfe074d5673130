"""The pictures of the page in docs/pictures, in a headless Chromium: python tests/pictures.py [viewer] [talk]

`viewer` makes viewer.jpg, two takes of one recording; `talk` makes talk.webp, a moving one of a real voice.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from browser import PATIENCE, OpenedPage, chromium
from PIL import Image

from gesticulator import Gesticulator
from gesticulator.export.html import write_comparison, write_preview
from gesticulator.performance import Performance

ROOT = Path(__file__).resolve().parents[1]
PICTURES, SPEECH = ROOT / "docs" / "pictures", ROOT / "examples" / "speech.flac"
FPS, START, SECONDS = 12, 5.6, 6.0
"""Of the moving picture: pictures a second, and the stretch of the recording, seconds."""
SIZE = 720, 600


def perform(interpreter: str | None = None) -> Performance:
    return Gesticulator.from_pretrained()(SPEECH, text=SPEECH.with_suffix(".txt"), face="full", interpreter=interpreter)


def viewer(folder: Path) -> None:
    """Two takes, side by side."""
    page = write_comparison(folder / "speech.html", {name: perform(name).scene() for name in ("lstm", "advantage")})
    with chromium() as browser:
        opened = OpenedPage(browser, page.as_uri(), 1440, 900)
        opened.page.set_default_timeout(PATIENCE)
        opened.go_to(7.9)
        opened.page.evaluate("() => preview.session.select(24, 27)")
        opened.page.wait_for_timeout(1000)
        shot = Image.open(io.BytesIO(opened.page.screenshot(timeout=PATIENCE)))
    shot.convert("RGB").save(PICTURES / "viewer.jpg", quality=82, optimize=True)


def talk(folder: Path) -> None:
    """The stage and the timeline, picture by picture."""
    page, shots = write_preview(folder / "speech.html", perform().scene()), []
    with chromium() as browser:
        opened = OpenedPage(browser, page.as_uri(), *SIZE)
        opened.page.set_default_timeout(PATIENCE)
        opened.page.evaluate("""() => {
            for (const part of ["#top", "#inspector", ".views", ".bar"]) document.querySelector(part).hidden = true;
            document.querySelector("main").style.gridTemplate = '"stage" minmax(0, 1fr) "desk" auto / minmax(0, 1fr)';
            const { stage } = preview;
            Object.assign(stage.goal, { yaw: 0.3, pitch: 0.05, distance: 3.1, x: 0, y: 1.18, z: 0 });
            stage.view = { ...stage.goal };
        }""")
        for number in range(round(FPS * SECONDS)):
            opened.go_to(START + number / FPS)
            shots.append(Image.open(io.BytesIO(opened.page.screenshot(timeout=PATIENCE))).convert("RGB"))
    shots[0].save(PICTURES / "talk.webp", save_all=True, append_images=shots[1:], duration=round(1000 / FPS), loop=0,
                  quality=62, method=6)


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        for name in sys.argv[1:] or ["viewer", "talk"]:
            {"viewer": viewer, "talk": talk}[name](Path(temporary))
