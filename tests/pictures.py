"""The pictures of the page in docs/pictures, in a headless Chromium: python tests/pictures.py [viewer] [talk]

`viewer` makes viewer.jpg, two takes of one recording; `talk` makes talk.webp, a moving one of a real voice.
"""

import io
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from browser import PATIENCE, OpenedPage, chromium
from PIL import Image

from gesticulator import Gesticulator
from gesticulator.export.html import write_comparison, write_preview

ROOT = Path(__file__).resolve().parents[1]
PICTURES, SPEECH = ROOT / "docs" / "pictures", ROOT / "examples" / "speech.flac"
FPS, START, COUNT = 12, 5.6, 72  # of the moving picture, hertz and seconds
STAGE_AND_TIMELINE = """() => {
    for (const part of ["#top", "#inspector", ".views", ".bar"]) document.querySelector(part).hidden = true;
    document.querySelector("main").style.gridTemplate = '"stage" minmax(0, 1fr) "desk" auto / minmax(0, 1fr)';
    Object.assign(preview.stage.goal, { yaw: 0.3, pitch: 0.05, distance: 3.1, x: 0, y: 1.18, z: 0 });
    preview.stage.view = { ...preview.stage.goal };
}"""


def shot(opened: OpenedPage, seconds: float) -> Image.Image:
    opened.go_to(seconds)
    return Image.open(io.BytesIO(opened.page.screenshot(timeout=PATIENCE))).convert("RGB")


def main(names: list[str], folder: Path) -> None:
    takes = {name: Gesticulator.from_pretrained()(SPEECH, text=SPEECH.with_suffix(".txt"), face="full", interpreter=name
                                                  ).scene() for name in ("lstm", "advantage")}
    with chromium() as browser:
        if "viewer" in names:
            opened = OpenedPage(browser, write_comparison(folder / "speech.html", takes).as_uri(), 1440, 900)
            opened.page.evaluate("() => preview.session.select(24, 27)")
            shot(opened, 7.9).save(PICTURES / "viewer.jpg", quality=82, optimize=True)
        if "talk" in names:
            opened = OpenedPage(browser, write_preview(folder / "speech.html", takes["lstm"]).as_uri(), 720, 600)
            opened.page.evaluate(STAGE_AND_TIMELINE)
            first, *others = [shot(opened, START + number / FPS) for number in range(COUNT)]
            first.save(PICTURES / "talk.webp", save_all=True, append_images=others, duration=round(1000 / FPS), loop=0,
                       quality=62, method=4)


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        main(sys.argv[1:] or ["viewer", "talk"], Path(temporary))
