"""The manifest of a batch: JSON lines, one row per recording with its outputs and settings.

While a batch runs, rows are appended and flushed, so that a killed process loses nothing; of two rows for a recording
the later counts, and an incomplete last line is ignored. At the end, and before more rows are appended, the file is
written anew, sorted. `gesticulator manifest` joins the manifests of shards and summarises them.
"""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from data_module.errors import InputError, printable
from data_module.files import lock, parse_json, write_bytes
from data_module.settings import check, from_dict
from gesticulator.cli import Command

DONE, FAILED = "done", "failed"
SUFFIX = ".jsonl"
_LONGEST_LINE = 1 << 20
"""Largest row in JSON, bytes (1 MiB): paths and an error message take a few kilobytes."""
_ADVICE = "name another, or move it away"


@dataclass(frozen=True)
class ManifestRow:
    """A recording of a batch. It is processed again if `sha256`, `output`, `program`, `bundle` or `settings`
    changed."""

    input: str
    """Path of the recording."""
    sha256: str = ""
    """SHA-256 of its bytes; "" if it could not be read."""
    seconds: float = 0.0
    """Duration; taken from the header or estimated from the file size if processing failed."""
    output: tuple[str, ...] = ()
    """Paths of the output files."""
    status: str = DONE
    """"done" or "failed"."""
    error: str = ""
    """Why it failed, one line."""
    time: float = 0.0
    """Computing time, seconds."""
    program: str = ""
    """Version of the program."""
    bundle: str = ""
    """SHA-256 of the bundle's index, which holds the hashes of all its files."""
    settings: str = ""
    """SHA-256 of the options, including the contents of files that they name."""
    worker: str = field(default="", compare=False)
    """Host and process that processed it."""

    @property
    def made_of(self) -> tuple[object, ...]:
        """Everything that the output depends on, and the output paths."""
        return self.sha256, self.output, self.program, self.bundle, self.settings

    def stands(self) -> bool:
        """Whether it was processed and its output files exist."""
        return self.status == DONE and all(Path(path).is_file() for path in self.output)

    @property
    def line(self) -> bytes:
        """The row as a line of JSON. Bytes of a file name that are not valid text stay, as escapes."""
        return (json.dumps(asdict(self), ensure_ascii=True) + "\n").encode()


def check_manifest(path: Path) -> None:
    """`InputError` if a file of that name cannot be a manifest."""
    if path.suffix != SUFFIX:
        raise InputError(path, "is not the name of a manifest", f"use a name that ends in {SUFFIX}")


def default_name(index: int = 1, count: int = 1) -> str:
    """The default file name of a manifest; that of a shard contains its number."""
    return f"manifest{'' if count == 1 else f'.{index}-of-{count}'}{SUFFIX}"


def read_manifest(path: Path) -> dict[str, ManifestRow]:
    """Input -> its row. `InputError` if the file is not a manifest or does not exist."""
    check_manifest(path)
    rows: dict[str, ManifestRow] = {}
    try:
        with path.open("rb") as file:
            while line := file.readline(_LONGEST_LINE + 1):
                if len(line) > _LONGEST_LINE:
                    raise InputError(path, "has a line longer than 1 MiB", _ADVICE)
                if line.endswith(b"\n"):  # a killed process may leave half a line at the end
                    row = _row(parse_json(line, "a row", "", python=True))
                    rows[row.input] = row
    except FileNotFoundError:
        raise InputError(path, "does not exist", "give the manifest of a batch") from None
    except (InputError, ValueError) as error:
        raise InputError(path, f"is not a manifest ({' '.join(str(error).split())[:80]})", _ADVICE) from None
    return rows


def _row(entry: Any) -> ManifestRow:
    """The row from plain values; ValueError or `InputError` for invalid ones."""
    if not isinstance(entry, Mapping):
        raise ValueError("a row is not an object")
    row = from_dict(ManifestRow, entry)
    check(row)
    # NaN and infinity are JSON to Python, and no file name holds a zero byte.
    if row.status not in (DONE, FAILED) or not 0 <= row.seconds < 1e9 or not 0 <= row.time < 1e9 \
            or any("\0" in path for path in (row.input, *row.output)):
        raise ValueError("a row with an invalid status, duration or path")
    return row


def write_manifest(path: Path, rows: Iterable[ManifestRow]) -> None:
    """Write rows atomically, sorted by input, so that the order in which recordings finish does not change the file."""
    write_bytes(path, b"".join(row.line for row in sorted(rows, key=lambda row: row.input)))


class Manifest:
    """A manifest being written, locked against other processes; used in a `with`. `InputError` if it is locked."""

    def __init__(self, path: Path) -> None:
        check_manifest(path)
        self.path = path
        self._open = contextlib.ExitStack()
        self._file: IO[bytes] | None = None
        self.rows: dict[str, ManifestRow] = {}
        """Input -> its row."""

    def __enter__(self) -> Manifest:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as opened:
            # Two batches with one manifest would overwrite each other's rows.
            opened.enter_context(lock(self.path, "a batch", beside=True))
            if self.path.exists():
                self.rows = read_manifest(self.path)
                write_manifest(self.path, self.rows.values())  # must not append to an incomplete line
            self._file = opened.enter_context(self.path.open("ab"))
            self._open = opened.pop_all()
        return self

    def add(self, row: ManifestRow) -> None:
        """Add a row, or replace that of the same recording; it has been flushed when this returns."""
        assert self._file is not None
        self.rows[row.input] = row
        self._file.write(row.line)
        # Flushed, not synced: the rows must survive a killed process, not a power failure.
        self._file.flush()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        with self._open:
            assert self._file is not None
            self._file.close()  # Windows cannot replace an open file
            write_manifest(self.path, self.rows.values())


# ------------------------------------------------------------------------------------------------------ the verb

def table(rows: Sequence[ManifestRow], unchanged: int = 0) -> str:
    """The summary of a batch. unchanged: number of rows that were up to date before."""
    # Failed recordings took time, too, but say nothing of the speed.
    done = [row for row in rows if row.status == DONE]
    hours, spent = sum(row.seconds for row in done) / 3600, sum(row.time for row in done)
    cells = [("recordings", f"{len(rows)}"), ("done", f"{len(done)}"), ("of which before", f"{unchanged}"),
             ("failed", f"{len(rows) - len(done)}"), ("audio", f"{hours:.2f} h"),
             ("computing", f"{spent / 3600:.2f} h"),
             ("real-time factor", f"{spent / hours / 3600:.3f}" if hours else "-")]
    return "\n".join(f"  {name:<18}{value:>12}" for name, value in cells if name != "of which before" or unchanged)


def merged(paths: Iterable[Path]) -> dict[str, ManifestRow]:
    """The rows of several manifests; of two rows for one recording a successful one wins, then the later."""
    rows: dict[str, ManifestRow] = {}
    for path in paths:
        for row in read_manifest(path).values():
            # Shards overlap after the number of shards was changed.
            before = rows.get(row.input)
            if before is None or before.status == FAILED or row.status == DONE:
                rows[row.input] = row
    return rows


def _arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("manifest", nargs="+", type=Path, metavar="MANIFEST", help="manifests of a batch or of its shards")
    p.add_argument("-o", "--output", type=Path, metavar="FILE.jsonl", help="write all rows to one manifest")
    p.add_argument("--failed", action="store_true", help="list the failures and their reasons")


def _run(args: argparse.Namespace) -> int:
    if args.output is not None:
        check_manifest(args.output)
    rows = merged(args.manifest)
    if args.output is not None:
        write_manifest(args.output, rows.values())
    for row in sorted(rows.values(), key=lambda row: row.input) if args.failed else ():
        if row.status == FAILED:
            print(printable(f"{row.input}: {row.error}"))
    print(table(list(rows.values())), flush=True)
    return 0


COMMAND = Command(
    "join the manifests of a batch and show what succeeded and failed", _arguments, _run,
    examples=("manifest out/manifest.jsonl",
              "manifest out/manifest.1-of-2.jsonl out/manifest.2-of-2.jsonl -o out/manifest.jsonl --failed"))
