"""The page of `gesticulator live`, as files that the server gives to a browser."""

from __future__ import annotations

from importlib import resources

from gesticulator.serve.server import Page

_KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
          ".css": "text/css; charset=utf-8", ".txt": "text/plain; charset=utf-8"}


def pages() -> dict[str, Page]:
    """Path -> file."""
    assets = resources.files("gesticulator") / "assets"
    names = {"/": "live/live.html", "/live.css": "live/live.css", "/live.js": "live/live.js",
             "/capture.js": "live/capture.js", "/three.module.min.js": "three.module.min.js",
             "/three.LICENSE.txt": "three.LICENSE.txt"}
    return {path: Page((assets / name).read_bytes(), _KINDS[name[name.rindex("."):]])
            for path, name in names.items()}
