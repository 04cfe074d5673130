"""The manifest of a batch: JSON lines, one row per recording with its outputs and settings.

Rows are appended and flushed, so that a killed process loses nothing; of two rows for a recording the later counts, and
an incomplete last line is ignored. So the manifests of shards are joined by writing them one after the other.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

from data_module.errors import InputError
from data_module.files import lock, parse_json, read_bytes, write_bytes
from data_module.settings import NotNegative, check, from_dict

SUFFIX = ".jsonl"
_LARGEST = 1 << 30
"""Largest manifest, bytes: a million recordings."""


@dataclass(frozen=True)
class ManifestRow:
    """A recording of a batch. It is processed again if it failed, if `sha256`, `output`, `program`, `bundle` or
    `settings` changed, or if an output is missing."""

    input: str
    """Path of the recording."""
    sha256: str = ""
    """SHA-256 of its bytes; "" if it could not be read."""
    seconds: NotNegative = 0.0
    """Duration; taken from the header or estimated from the file size if processing failed."""
    output: tuple[str, ...] = ()
    """Paths of the output files."""
    error: str = ""
    """Why it failed, one line; "" if it succeeded."""
    time: NotNegative = 0.0
    """Computing time, seconds."""
    program: str = ""
    """Version of the program."""
    bundle: str = ""
    """SHA-256 of the bundle's index, which holds the hashes of all its files."""
    settings: str = ""
    """SHA-256 of the options, including the contents of files that they name."""
    worker: str = ""
    """Host and process that processed it."""

    def is_done_by(self, before: ManifestRow | None) -> bool:
        """Whether a row of an earlier run succeeded with the same input and settings, and its outputs exist."""
        if before is None or before.error or not all(Path(path).is_file() for path in before.output):
            return False
        return all(getattr(self, name) == getattr(before, name)
                   for name in ("sha256", "output", "program", "bundle", "settings"))

    @property
    def line(self) -> bytes:
        """The row as a line of JSON. Bytes of a file name that are not valid text stay, as escapes."""
        return (json.dumps(asdict(self), ensure_ascii=True) + "\n").encode()


def check_manifest(path: Path) -> None:
    """`InputError` if a file of that name cannot be a manifest."""
    if path.suffix != SUFFIX:
        raise InputError(path, "is not the name of a manifest", f"use a name that ends in {SUFFIX}")


def read_manifest(path: Path) -> dict[str, ManifestRow]:
    """Input -> its row. `InputError` if the file is not a manifest or does not exist."""
    check_manifest(path)
    rows: dict[str, ManifestRow] = {}
    for line in read_bytes(path, "give the manifest of a batch", _LARGEST).splitlines(keepends=True):
        if line.endswith(b"\n"):  # a killed process may leave half a line at the end
            row = _row(path, line)
            rows[row.input] = row
    return rows


def _row(path: Path, line: bytes) -> ManifestRow:
    try:
        # Names of files that are not valid text come as unpaired surrogates, which JSON itself forbids.
        entry = parse_json(line, "a row", "", python=True)
        row = from_dict(ManifestRow, entry if isinstance(entry, Mapping) else {})
        check(row)
    except InputError as error:
        raise InputError(path, f"is not a manifest ({str(error)[:80]})", "name another, or move it away") from None
    return row


@dataclass(frozen=True)
class Manifest:
    """A manifest being written. rows: input -> its row; file: to which rows are appended."""

    rows: dict[str, ManifestRow]
    file: BinaryIO

    def add(self, row: ManifestRow) -> None:
        """Add a row, or replace that of the same recording; it has been flushed when this returns."""
        self.rows[row.input] = row
        self.file.write(row.line)
        # Flushed, not synced: the rows must survive a killed process, not a power failure.
        self.file.flush()


@contextmanager
def opened_manifest(path: Path) -> Iterator[Manifest]:
    """A manifest, new or with the rows of earlier runs; `InputError` if another process writes it."""
    check_manifest(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Two batches with one manifest would overwrite each other's rows.
    with lock(path, "a batch", beside=True):
        rows = read_manifest(path) if path.exists() else {}
        # Written anew, because rows must not be appended to an incomplete line.
        write_bytes(path, b"".join(row.line for row in rows.values()))
        with path.open("ab") as file:
            yield Manifest(rows, file)
