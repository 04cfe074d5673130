"""The files of the page of `gesticulator live`."""

from __future__ import annotations

from importlib import resources

from gesticulator.serve.server import Page

_KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8",
          ".css": "text/css; charset=utf-8", ".txt": "text/plain; charset=utf-8"}


def pages() -> dict[str, Page]:
    """URL path -> file."""
    folder = resources.files("gesticulator") / "assets" / "live"
    names = {"/": "live.html", **{f"/{name}": name for name in (
        "live.css", "live.min.js", "capture.js", "licences.txt")}}
    return {path: Page((folder / name).read_bytes(), _KINDS[name[name.rindex("."):]]) for path, name in names.items()}
