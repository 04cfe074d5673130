"""The manifest of a batch: one row per recording with its outputs and settings, as Parquet or JSON lines.

While a batch runs, rows are appended to a journal beside the manifest, one line each, so that nothing is lost if the
process is killed; the next run reads it. `gesticulator manifest` joins the manifests of shards and summarises them.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from data_module.errors import InputError, printable, shown
from data_module.files import lock, parse_json, write_bytes
from gesticulator.cli import Command

DONE, FAILED = "done", "failed"
SUFFIXES = (".parquet", ".jsonl")
"""Suffixes of a manifest; Parquet needs pyarrow."""
_JOURNAL = ".journal"
_LONGEST_LINE = 1 << 20
"""Largest row in JSON, bytes (1 MiB): paths and an error message take a few kilobytes."""
_MOST_ROWS = 10_000_000
"""Most rows of a manifest: more than any corpus has. A Parquet file of a few bytes can claim any number."""
_MOST_BYTES = 1 << 32
"""Largest size of all columns together, uncompressed bytes (4 GiB)."""
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


def row_of(entry: Any) -> ManifestRow:
    """The row from plain values; absent or null values get their defaults. ValueError for invalid values."""
    if not isinstance(entry, Mapping):
        raise ValueError("a row is not an object")
    values = {column.name: entry[column.name] for column in fields(ManifestRow) if entry.get(column.name) is not None}
    for name, value in values.items():
        if not _fits(name, value):
            raise ValueError(f"{name} is {shown(value)}")
    if "input" not in values or values.get("status", DONE) not in (DONE, FAILED):
        raise ValueError("a row without an input or a status")
    row = ManifestRow(**values)
    return replace(row, output=tuple(row.output), seconds=float(row.seconds), time=float(row.time))


def _fits(name: str, value: Any) -> bool:
    if name in ("seconds", "time"):
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if name == "output":
        return isinstance(value, list | tuple) and all(isinstance(path, str) and "\0" not in path for path in value)
    return isinstance(value, str) and "\0" not in value


def check_manifest(path: Path) -> None:
    """`InputError` if a manifest of that name cannot be written here."""
    if path.suffix not in SUFFIXES:
        raise InputError(path, "is not the name of a manifest", f"use a name that ends in {' or '.join(SUFFIXES)}")
    if path.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise InputError(path, "needs pyarrow, which is not installed", "pip install 'gesticulator[parquet]', or name "
                         f"it {path.with_suffix('.jsonl')}")


def default_name(index: int = 1, count: int = 1) -> str:
    """The default file name of a manifest; that of a shard contains its number."""
    shard = "" if count == 1 else f".{index}-of-{count}"
    return f"manifest{shard}.parquet" if find_spec("pyarrow") is not None else f"manifest{shard}.jsonl"


def read_manifest(path: Path) -> dict[str, ManifestRow]:
    """Input -> its row, including rows of the journal beside it; an incomplete last line of the journal is ignored.
    `InputError` if the file is not a manifest, or neither manifest nor journal exists."""
    check_manifest(path)
    entries: list[Any] = []
    journal = path.with_name(path.name + _JOURNAL)
    if not path.exists() and not journal.exists():
        raise InputError(path, "does not exist", "give the manifest of a batch")
    try:
        if path.exists():
            entries += _read_table(path) if path.suffix == ".parquet" else _lines(path, whole=True)
        if journal.exists():
            entries += _lines(journal, whole=False)
        return {row.input: row for row in map(row_of, entries)}
    except (ValueError, OSError) as error:
        raise InputError(path, f"is not a manifest ({' '.join(str(error).split())[:80]})", _ADVICE) from None


def _read_table(path: Path) -> list[Any]:
    """The rows of a Parquet file; its columns are checked before they are read (ValueError)."""
    import pyarrow
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            about, schema = file.metadata, _schema()
            # Uncompressed sizes from the footer, before anything is decompressed.
            size = sum(about.row_group(group).total_byte_size for group in range(about.num_row_groups))
            if not 0 <= about.num_rows <= _MOST_ROWS or not 0 <= size <= _MOST_BYTES:
                raise ValueError(f"it claims {about.num_rows} rows of {size} bytes")
            names = [name for name in schema.names if name in file.schema_arrow.names]
            for name in names:
                kind = file.schema_arrow.field(name).type
                if not _is_kind(kind, schema.field(name).type):
                    raise ValueError(f"its column {name} holds {kind}, not {schema.field(name).type}")
            rows: list[Any] = file.read(names).to_pylist()
            return rows
    except (pyarrow.ArrowException, KeyError, TypeError, OverflowError) as error:
        raise ValueError(str(error)) from None


def _lines(path: Path, whole: bool) -> list[Any]:
    """The values of a file of JSON lines. whole: False ignores an incomplete last line."""
    rows: list[Any] = []
    with path.open("rb") as file:
        while line := file.readline(_LONGEST_LINE + 1):
            if len(line) > _LONGEST_LINE:
                raise InputError(path, "has a line longer than 1 MiB", _ADVICE)
            if line.strip() and (whole or line.endswith(b"\n")):
                rows.append(_entry(line))
    return rows


def _entry(line: bytes) -> Any:
    try:
        return parse_json(line, "a row", "", python=True)
    except InputError as error:
        raise ValueError(error.wrong) from None


def _is_kind(kind: Any, wanted: Any) -> bool:
    """Whether a column has the wanted type in any of its sizes, or no values at all."""
    from pyarrow import types

    if types.is_list(wanted):
        return types.is_null(kind) or ((types.is_list(kind) or types.is_large_list(kind)) and _is_kind(
            kind.value_type, wanted.value_type))
    if types.is_string(wanted):
        return bool(types.is_null(kind) or types.is_string(kind) or types.is_large_string(kind))
    return bool(types.is_null(kind) or kind.equals(wanted))


def _schema() -> Any:
    import pyarrow

    # Columns without an entry are strings.
    kinds = {"seconds": pyarrow.float64(), "time": pyarrow.float64(), "output": pyarrow.list_(pyarrow.string())}
    return pyarrow.schema([(column.name, kinds.get(column.name, pyarrow.string())) for column in fields(ManifestRow)])


def write_manifest(path: Path, rows: Iterable[ManifestRow]) -> None:
    """Write rows sorted by input, atomically."""
    # Sorted, so that the order in which recordings finish does not change the file.
    entries = [asdict(row) for row in sorted(rows, key=lambda row: row.input)]
    if path.suffix == ".jsonl":
        write_bytes(path, "".join(json.dumps(entry, ensure_ascii=True) + "\n" for entry in entries).encode())
        return
    import pyarrow
    from pyarrow import parquet

    out = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(list(map(_as_text, entries)), _schema()), out, compression="zstd")
    write_bytes(path, out.getvalue())


def _as_text(entry: dict[str, Any]) -> dict[str, Any]:
    """Escape the bytes of names that are not valid text: Parquet holds only UTF-8."""
    def plain(value: Any) -> Any:
        if isinstance(value, str):
            return value.encode("utf-8", "backslashreplace").decode()
        return list(map(plain, value)) if isinstance(value, tuple) else value

    return {name: plain(value) for name, value in entry.items()}


class Manifest:
    """A manifest being written, locked against other processes; used in a `with`. `InputError` if it is locked."""

    def __init__(self, path: Path) -> None:
        check_manifest(path)
        self.path = path
        self._journal_path = path.with_name(path.name + _JOURNAL)
        self._held = contextlib.ExitStack()
        self._journal: IO[bytes] | None = None
        self.rows: dict[str, ManifestRow] = {}
        """Input -> its row."""

    def __enter__(self) -> Manifest:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as held:
            # Two batches with one manifest would overwrite each other's rows.
            held.enter_context(lock(self.path, "a batch", beside=True))
            if self.path.exists() or self._journal_path.exists():
                self.rows = read_manifest(self.path)
                self._merge_journal()  # must not append to an incomplete line
            self._journal = held.enter_context(self._journal_path.open("ab"))
            self._held = held.pop_all()
        return self

    def add(self, row: ManifestRow) -> None:
        """Add a row, or replace that of the same recording; it has been flushed when this returns."""
        assert self._journal is not None
        self.rows[row.input] = row
        self._journal.write((json.dumps(asdict(row), ensure_ascii=True) + "\n").encode())
        self._journal.flush()

    def _merge_journal(self) -> None:
        if self.rows or self.path.exists():
            write_manifest(self.path, self.rows.values())
        self._journal_path.unlink(missing_ok=True)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
                 ) -> None:
        with self._held:
            self._merge_journal()


# ------------------------------------------------------------------------------------------------------ the verb

def table(rows: Sequence[ManifestRow], unchanged: int = 0) -> str:
    """The summary of a batch. unchanged: number of rows that were up to date before."""
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
    p.add_argument("-o", "--output", type=Path, metavar="FILE", help="write all rows to one manifest "
                   "(.parquet, .jsonl)")
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
    examples=("manifest out/manifest.parquet", "manifest out/manifest.1-of-2.parquet out/manifest.2-of-2.parquet "
              "-o out/manifest.parquet --failed"))
