"""Where a recording's page was served, so that it is served there again: a browser keeps edits by address, and a page
that is still open goes on with the program that was started again."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from data_module.errors import InputError
from data_module.files import read_object, write_text
from gesticulator.page.server import PageServer

_LARGEST = 1000
"""Bytes of a place."""


@dataclass(frozen=True)
class PagePlace:
    """The port of a page, and the name under which browsers keep its edits. Neither is secret."""

    port: int
    name: str = field(default_factory=lambda: secrets.token_hex(8))


def page_place(source: Path) -> PagePlace | None:
    """Where a sound's page was served last; None where that is not known."""
    return place_in(_file(source))


def place_in(file: Path) -> PagePlace | None:
    """The place in a file; None where there is none."""
    try:
        told = read_object(file, "remove it", _LARGEST)
    except InputError:
        return None
    port, name = told.get("port"), told.get("name")
    fits = type(port) is int and 0 < port < 65536 and isinstance(name, str) and name.isalnum()
    return PagePlace(port, name) if fits else None  # type: ignore[arg-type]


def served_again(port: int, source: Path, anew: bool = False) -> tuple[PageServer, str]:
    """A server for the page of a sound, at its port where that is free, and the name of its place. port: another one,
    which is taken alone, or 0; anew: browsers forget the edits. `InputError` if `port` cannot be used."""
    known = page_place(source)
    server: PageServer | None = None
    if known is not None and port == 0:
        with suppress(InputError):
            server = PageServer(known.port)
    server = server or PageServer(port)
    place = PagePlace(server.server_port) if known is None or anew else PagePlace(server.server_port, known.name)
    file = _file(source)
    with suppress(OSError):  # without it, the next page is another one
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, json.dumps(asdict(place)))
    return server, place.name


def _file(source: Path) -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    name = hashlib.sha256(os.fsencode(source.absolute())).hexdigest()[:24]
    return Path(cache) / "gesticulator" / "pages" / f"{name}.json"
