"""The data sets that can be read, one file and one entry of `CORPORA` each.

A new data set is one file here, with a reader as `data_module.corpora.base` describes it, and one line in `CORPORA`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from data_module.corpora.base import (
    DroppedError,
    Imported,
    Item,
    Options,
    Reader,
    StrokeSource,
    load,
    split_of,
    spread,
    trimmed,
)
from data_module.errors import InputError

__all__ = ["CORPORA", "STROKE_SOURCES", "DroppedError", "Imported", "Item", "Options", "Reader", "StrokeSource", "load",
           "open_corpus", "open_strokes", "split_of", "spread", "trimmed"]


def open_corpus(name: str, source: Path | None, options: Options) -> Reader:
    """The reader `name` on the folder `source`; `InputError` when there is no such reader or no such folder."""
    if name not in CORPORA:
        known = ", ".join((*CORPORA, *STROKE_SOURCES))
        raise InputError(name, "is no data set that can be read", f"take one of {known}")
    _check_folder(source)
    return CORPORA[name](source, options)


def open_strokes(name: str, source: Path | None, options: Options) -> StrokeSource:
    """The source of strokes `name`, a key of `STROKE_SOURCES`, on the folder `source`; `InputError` without it."""
    _check_folder(source)
    return STROKE_SOURCES[name](source, options)


def _check_folder(source: Path | None) -> None:
    if source is not None and not source.is_dir():
        raise InputError(source, "is not a folder" if source.exists() else "does not exist", "check --source")


def _performer(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.performer import Performer

    return Performer(source, options)


def _folder(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.folder import Folder

    return Folder(source, options)


def _trinity(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.trinity import Trinity

    return Trinity(source, options)


def _zeroeggs(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.zeroeggs import ZeroEggs

    return ZeroEggs(source, options)


def _mocca(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.mocca import Mocca

    return Mocca(source, options)


def _beat(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.beat import Beat

    return Beat(source, options)


def _beat2(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.beat2 import Beat2

    return Beat2(source, options)


def _ted(source: Path | None, options: Options) -> Reader:
    from data_module.corpora.ted import Ted

    return Ted(source, options)


def _smartbody(source: Path | None, options: Options) -> StrokeSource:
    from data_module.corpora.smartbody import SmartBody

    return SmartBody(source, options)


CORPORA: dict[str, Callable[[Path | None, Options], Reader]] = {
    "performer": _performer,
    "folder": _folder,
    "trinity": _trinity,
    "zeroeggs": _zeroeggs,
    "mocca": _mocca,
    "beat": _beat,
    "beat2": _beat2,
    "ted": _ted,
}
"""Name on the command line -> what opens the reader. The readers are imported only when they are asked for."""

STROKE_SOURCES: dict[str, Callable[[Path | None, Options], StrokeSource]] = {
    "smartbody": _smartbody,
}
"""The same, for what makes a folder of strokes and no store."""
