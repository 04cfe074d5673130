"""Draws the zoo of `tests/zoo.py`: python benchmarks/zoo.py [--out docs/pictures/zoo.jpg]

Each character that is sound is moved by a gesture of the shipped weights and drawn at three moments by three.js in a
headless Chromium, from its file as it is; those that are refused are listed with the reason. The packages are kept in
the folder that GESTICULATOR_ZOO names; what this machine cannot get is left out and said.
"""

from __future__ import annotations

import argparse
import base64
import http.server
import io
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from data_module.errors import InputError  # noqa: E402
from data_module.types import Motion  # noqa: E402
from gesticulator import Gesticulator  # noqa: E402
from gesticulator.characters.reading import read_character  # noqa: E402
from gesticulator.characters.retarget import Retargeter  # noqa: E402
from tests.browser import chromium  # noqa: E402
from tests.zoo import ANIMALS, Animal, Unavailable, character_file, folder  # noqa: E402

MOMENTS = (1.5, 5.0, 9.0)
"""Seconds."""
WIDTH, HEIGHT, CAPTION = 120, 150, 13
"""Pixels of a picture, and of the line above three of them."""
COLUMNS = 4
SILENT = 300
"""Seconds without a request after which a page that is not ready is given up."""
_NAMES = {".gltf": "model/gltf+json", ".glb": "model/gltf-binary"}


def moments() -> Motion:
    """The poses of the example at the moments that are drawn."""
    motion = Gesticulator.from_pretrained()(ROOT / "examples" / "speech.flac", fps=20.0, legs=True).motion
    kept = [round(moment * motion.fps) for moment in MOMENTS]
    return replace(motion, rotations=motion.rotations[kept], root_positions=motion.root_positions[kept])


def pose_of(retargeter: Retargeter, motion: Motion) -> dict[str, Any]:
    """What the page sets: local rotations and the place of the hips, by the number of the node in the file."""
    moved = retargeter(motion)
    at = moved.character.node_ids
    poses = [[{"node": at[node], "q": np.roll(moved.rotations[frame, node], -1).tolist()} for node in moved.moved]
             for frame in range(len(moved))]
    hips = [None if moved.translations is None else {"node": at[moved.hips], "t": place.tolist()}
            for place in (moved.translations if moved.translations is not None else np.zeros((len(moved), 3)))]
    return {"poses": poses, "hips": hips}


class _Site(http.server.SimpleHTTPRequestHandler):
    """The page, three.js, and the folder of the zoo under /zoo/."""

    def translate_path(self, path: str) -> str:
        plain = path.split("?")[0]
        if plain.startswith("/zoo/"):
            return str(folder() / plain.removeprefix("/zoo/"))
        return str(ROOT / "tests" / "js" / plain.lstrip("/"))

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is logged."""


def opened(browser: Any, address: str) -> Any:
    """The page, once it is ready, however busy the machine is. RuntimeError if it says that something is wrong;
    TimeoutError if it has asked for nothing for `SILENT` seconds."""
    page, wrong, last = browser.new_page(), [], [time.monotonic()]
    page.set_default_timeout(0)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("requestfailed", lambda request: wrong.append(f"{request.url}: {request.failure}"))
    page.on("requestfinished", lambda _: last.append(time.monotonic()))
    page.goto(address, wait_until="commit")
    while not page.evaluate("Boolean(window.ready)"):
        if wrong:
            raise RuntimeError(f"{address}: {wrong[0]}")
        if time.monotonic() - last[-1] > SILENT:
            raise TimeoutError(f"{address}: not ready, and no request for {SILENT} s")
        page.wait_for_timeout(200)
    return page


def pictures(animals: list[tuple[Animal, Path, Retargeter]], motion: Motion) -> list[tuple[str, list[bytes]]]:
    """The name of each character and its JPEGs."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Site)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    out = []
    with chromium() as browser:
        page = opened(browser, f"http://127.0.0.1:{server.server_port}/zoo.html")
        for animal, file, retargeter in animals:
            address = "/zoo/" + str(file.relative_to(folder()))
            drawn = page.evaluate("([file, pose, w, h]) => draw(file, pose, w, h)",
                                  [address, pose_of(retargeter, motion), WIDTH, HEIGHT])
            out.append((animal.name, [base64.b64decode(url.split(",")[1]) for url in drawn]))
    server.shutdown()
    return out


def sheet(drawn: list[tuple[str, list[bytes]]], out: Path) -> None:
    """One picture of all, as JPEG."""
    from PIL import Image, ImageDraw

    wide, high = WIDTH * len(MOMENTS), HEIGHT + CAPTION
    whole = Image.new("RGB", (wide * COLUMNS, high * -(-len(drawn) // COLUMNS)), "white")
    for place, (name, images) in enumerate(drawn):
        x, y = wide * (place % COLUMNS), high * (place // COLUMNS)
        ImageDraw.Draw(whole).text((x + 3, y + 1), name, fill="black")
        for index, image in enumerate(images):
            whole.paste(Image.open(io.BytesIO(image)), (x + WIDTH * index, y + CAPTION))
    out.parent.mkdir(parents=True, exist_ok=True)
    whole.save(out, quality=78, optimize=True)


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", metavar="FILE.jpg", type=Path, default=ROOT / "docs" / "pictures" / "zoo.jpg")
    a = p.parse_args()
    motion, sound = moments(), []
    for animal in ANIMALS:
        try:
            file = character_file(animal)
            retargeter = Retargeter(read_character(file))
        except Unavailable as reason:
            print(f"{animal.name}: not to be had: {reason}")
        except InputError as error:
            print(f"{animal.name}: refused: {error}")
        else:
            print(f"{animal.name}: moved{'; '.join(('', *retargeter.doubts))}")
            if file.suffix in _NAMES:
                sound.append((animal, file, retargeter))
    sheet(pictures(sound, motion), a.out)


if __name__ == "__main__":
    main()
