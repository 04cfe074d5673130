"""The pictures of the page, in a headless Chromium: python docs/pictures/make_page.py [viewer] [talk]

viewer.jpg shows two takes, talk.webp moves. The voice is of GESTICULATOR_DATA: a LibriVox reading (public domain).
"""

import io
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from gesticulator import Gesticulator
from gesticulator.export.html import write_comparison, write_preview

PICTURES = Path(__file__).resolve().parent
sys.path.insert(0, str(PICTURES.parents[1] / "tests"))
SPEECH, FPS, COUNT = Path(os.environ["GESTICULATOR_DATA"], "speech", "en_austen_0870.flac"), 12, 84
STAGE_AND_TIMELINE = """() => {
    for (const part of ["#top", "#inspector", ".views", ".bar"]) document.querySelector(part).hidden = true;
    document.querySelector("main").style.gridTemplate = '"stage" minmax(0, 1fr) "desk" auto / minmax(0, 1fr)';
    Object.assign(preview.stage.goal, { yaw: 0.3, pitch: 0.05, distance: 3.1, x: 0, y: 1.18, z: 0 });
    preview.stage.view = { ...preview.stage.goal }; }"""


def main(names, folder):
    from browser import PATIENCE, OpenedPage, chromium
    def shot(opened, seconds):
        opened.go_to(seconds)
        return Image.open(io.BytesIO(opened.page.screenshot(timeout=PATIENCE))).convert("RGB")
    takes = {name: Gesticulator.from_pretrained()(SPEECH, text=SPEECH.with_suffix(".txt"), face="full", interpreter=name
                                                  ).scene() for name in ("lstm", "cql")}
    with chromium() as browser:
        if "viewer" in names:
            opened = OpenedPage(browser, write_comparison(folder / "speech.html", takes).as_uri(), 1440, 900)
            opened.page.evaluate("() => preview.session.select(9, 11)")
            shot(opened, 3.6).save(PICTURES / "viewer.jpg", quality=82)
        if "talk" in names:
            opened = OpenedPage(browser, write_preview(folder / "speech.html", takes["lstm"]).as_uri(), 720, 600)
            opened.page.evaluate(STAGE_AND_TIMELINE)
            first, *others = [shot(opened, number / FPS) for number in range(COUNT)]
            first.save(PICTURES / "talk.webp", save_all=True, append_images=others, duration=83, loop=0, quality=62)


if __name__ == "__main__":
    with TemporaryDirectory() as temporary:
        main(sys.argv[1:] or ["viewer", "talk"], Path(temporary))
