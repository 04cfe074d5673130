"""Batches: recordings that are missing or changed are processed, the longest first, and noted in a manifest: JSON
lines, one row per recording with its outputs and settings.

Work is divided by duration, from the files alone, so every machine divides it alike. Each result is written atomically
and does not depend on the worker that made it; so any number of workers, any order and any restart give the same bytes.
Rows are appended and flushed, so that a killed process loses nothing; of two rows for a recording the later counts, and
an incomplete last line is ignored. So the manifests of shards are joined by writing them one after the other.
"""

from __future__ import annotations

import hashlib
import heapq
import json
import os
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from data_module.errors import InputError, complain, one_line
from data_module.files import file_hash, lock, parse_json, read_bytes, remove_unfinished_of, write_bytes
from data_module.registry import Requirement
from data_module.settings import NotNegative, check, from_dict, whole_number
from gesticulator.bundle.files import INDEX, bundle_folder, read_index
from gesticulator.cli import PROGRAM, __version__
from gesticulator.jobs import Job, RunSettings

SUFFIX = ".jsonl"
_LARGEST = 1 << 30
"""Largest manifest, bytes: a million recordings."""
Doing: TypeAlias = "Callable[[str], float]"
"""Processes the recording of that path and returns its duration in seconds; raises InputError or OSError."""
Maker: TypeAlias = "Callable[[], Doing]"
"""Loads the models. It is called once in each worker and must be picklable."""
Processing: TypeAlias = "Callable[[Sequence[ManifestRow]], Iterator[ManifestRow]]"
"""Processes the recordings of rows, and gives back the rows with what came of it, in any order."""
ATTEMPTS = 3
"""Attempts at a task whose worker dies: the task itself is the likelier cause (memory) than chance."""
_LOCAL = "local:"
_MOST_WORKERS = 10_000
_LOADED: dict[str, Doing] = {}
"""In a worker process: the loaded models, by the identity of their maker."""
_MOST_SHARDS = 10**9
_BYTES_PER_SECOND = 16_000
"""Assumed for files whose header lacks a duration, such as MP3 at 128 kbit/s; affects only how work is divided."""


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


def estimated_seconds(row: ManifestRow) -> float:
    """Duration of a recording, estimated from its size; 0 if it cannot be read."""
    path = Path(row.input)
    return path.stat().st_size / _BYTES_PER_SECOND if path.is_file() else 0.0


def parse_shard(text: str | None) -> tuple[int, int]:
    """Parse a shard such as 2/8; None means 1/1, all of it."""
    first, _, last = (text or "1/1").partition("/")
    index, count = whole_number(first, _MOST_SHARDS), whole_number(last, _MOST_SHARDS)
    if not index or not count or index > count:
        raise InputError(f"--shard {str(text)[:40]}", "is not a shard", "write it as 1/8 to 8/8")
    return index, count


def sharded(rows: Sequence[ManifestRow], shard: int, count: int) -> list[ManifestRow]:
    """The rows of one shard (1 to `count`): longest first, each goes to the shard with the least work so far."""
    # A heap of (work so far, shard): equal work goes to the lower number, so all machines agree.
    loads = [(0.0, index) for index in range(1, count + 1)]
    chosen = []
    # By name, not by path: the folder may lie elsewhere on another machine.
    # Longest first: at the end no worker does a long one while the others wait.
    for row in sorted(rows, key=lambda row: (-row.seconds, Path(row.input).name)):
        load, index = heapq.heappop(loads)
        # Recordings of unknown duration still take some time, so they are spread too.
        heapq.heappush(loads, (load + max(row.seconds, 0.1), index))
        if index == shard:
            chosen.append(row)
    return chosen


def attempted(doing: Doing, row: ManifestRow) -> ManifestRow:
    """Process a recording; an error becomes part of its row."""
    # An error is a result, because one bad file must not end a batch of thousands.
    begin, seconds, error = time.perf_counter(), row.seconds, ""
    try:
        seconds = doing(row.input)
    except (InputError, OSError) as fault:
        error = one_line(fault)
    return replace(row, seconds=seconds, error=error, time=time.perf_counter() - begin,
                   worker=f"{socket.gethostname()}:{os.getpid()}")


def done_here(make: Maker, rows: Sequence[ManifestRow]) -> Iterator[ManifestRow]:
    """Process recordings one by one in this process."""
    doing = make()
    for row in rows:
        yield attempted(doing, row)


def run_jobs(jobs: Sequence[Job], settings: RunSettings, processing: Processing) -> tuple[int, int]:
    """Process recordings that are missing or changed; returns (number done, number of recordings). `InputError` for
    invalid input."""
    if any(job.source is None for job in jobs):
        raise InputError("standard input", "is not a recording of a batch", "name files or folders")
    index, count = parse_shard(settings.shard)
    # Beside the outputs, so that a folder of results is self-contained.
    name = f"manifest{'' if count == 1 else f'.{index}-of-{count}'}{SUFFIX}"
    path = Path(settings.manifest or jobs[0].targets[0].parent / name)
    folder = bundle_folder(settings.bundle)
    # A broken bundle is refused before recordings are hashed, which may take minutes.
    read_index(folder)
    # The index holds the hashes of all files of the bundle, so its own stands for them.
    made_by = file_hash(folder / INDEX)
    # The number of threads decides the last bits of the output.
    digests = [hashlib.sha256(f"{job.digest} {settings.threads}".encode()).hexdigest() for job in jobs]
    rows = [ManifestRow(str(job.source), output=tuple(map(str, job.targets)), program=__version__, bundle=made_by,
                        settings=digest) for job, digest in zip(jobs, digests, strict=True)]
    return run_batch(rows, path, processing, (index, count), settings.quiet)


def run_batch(rows: Sequence[ManifestRow], path: Path, processing: Processing, shard: tuple[int, int] = (1, 1),
              quiet: bool = False) -> tuple[int, int]:
    """Process the recordings of rows that are missing or changed, and add the rows to the manifest at `path`; returns
    (number done, recordings in the shard)."""
    from tqdm import tqdm

    with opened_manifest(path) as manifest:
        chosen = sharded([replace(row, seconds=estimated_seconds(row)) for row in rows], *shard)
        chosen = [_hashed(row) for row in chosen]
        waiting = [row for row in chosen if not row.is_done_by(manifest.rows.get(row.input))]
        # A killed run or worker may have left partially written files. Only files of this shard: another machine may be
        # writing its own into the same folder.
        outputs = [Path(output) for row in waiting for output in row.output]
        remove_unfinished_of(outputs)
        with tqdm(total=len(waiting), unit=" recordings", disable=quiet or not sys.stderr.isatty()) as bar:
            for row in processing(waiting) if waiting else ():
                bar.update()
                manifest.add(row)
                if row.error:
                    complain(f"{PROGRAM}: {row.error}")
        remove_unfinished_of(outputs)
        # Rows of recordings that are no longer named stay in the manifest, but not in the summary.
        done = [row for row in (manifest.rows[row.input] for row in chosen) if not row.error]
    if not quiet:
        print(f"{path}: {len(done)} of {len(chosen)} recordings done, {len(chosen) - len(waiting)} of them before; "
              f"{sum(row.seconds for row in done) / 3600:.2f} h of sound, {sum(row.time for row in done) / 3600:.2f} h "
              "of computing", flush=True)
    return len(done), len(chosen)


def _hashed(row: ManifestRow) -> ManifestRow:
    try:
        return replace(row, sha256=file_hash(Path(row.input)))
    except OSError:
        return row  # the error is that of processing it


# ----------------------------------------------------------------------------------------------------- on a Ray cluster

# A task is a recording. As many are in flight as the cluster has processors, so that they start in their order, the
# longest first; Ray gives the task of a worker that died to another one. A worker process loads the models for its
# first task and keeps them for the next ones.

def check_ray(given: str) -> None:
    """`InputError` if Ray is not installed or the value of --ray is invalid."""
    Requirement("ray", "Ray (or use --shard)", "scale").check("--ray")
    if given.startswith(_LOCAL) and not whole_number(given[len(_LOCAL):], _MOST_WORKERS):
        raise InputError(f"--ray {given[:40]}", "is not a number of workers", "write --ray local:4")


def done_on_ray(given: str, make: Maker, rows: Sequence[ManifestRow]) -> Iterator[ManifestRow]:
    """Process the recordings of rows on a cluster; their rows come in the order in which they finish.

    given: "auto" (the cluster running here), the address of a cluster, or "local:N" for N workers on this machine.
    `InputError` if no cluster answers, if it is lost, or if a worker cannot load the models.
    """
    import ray

    # A connection that the caller made stays open afterwards.
    connected = not ray.is_initialized()
    try:
        if connected:
            _connect(ray, given)
        # One processor for a task, because the models use one thread.
        task = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_do)
        workers = int(ray.cluster_resources().get("CPU", 1))
        # In a list, Ray does not fetch it for every task: the maker holds all jobs.
        maker, waiting, running = [ray.put(make)], deque(rows), dict[Any, ManifestRow]()
        while waiting or running:
            while waiting and len(running) < workers:
                row = waiting.popleft()
                running[task.remote(maker, row)] = row
            (reference, *_), _ = ray.wait(list(running))
            yield _done(ray, reference, running.pop(reference))
    except ConnectionError as error:
        raise InputError(f"--ray {given}", f"cannot be reached ({_short(error)})", "check the address, and "
                         "RAY_AUTH_MODE where the cluster has a token; finished recordings are kept") from None
    finally:
        if connected:
            ray.shutdown()


def _connect(ray: Any, given: str) -> None:
    """Connect to a cluster, or start one on this machine."""
    # Workers import packages from the same paths and use one thread each, as on a single machine.
    environment = {name: os.environ[name] for name in ("PYTHONPATH", "GESTICULATOR_DATA") if name in os.environ}
    where: dict[str, Any] = {"address": given}
    if given.startswith(_LOCAL):
        where = {"address": "local", "num_cpus": int(given[len(_LOCAL):]), "include_dashboard": False}
    # Workers must not print into the terminal of the command.
    ray.init(**where, log_to_driver=False, logging_level="ERROR",
             runtime_env={"env_vars": {**environment, "OMP_NUM_THREADS": "1"}})


def _do(maker: list[Any], row: ManifestRow) -> ManifestRow | str:
    """In a worker: process a recording; returns the error message if the models cannot be loaded here."""
    import ray

    # A worker process may outlive a batch: another one has other settings.
    key = maker[0].hex()
    if key not in _LOADED:
        try:
            _LOADED[key] = ray.get(maker[0])()
        except (InputError, OSError) as error:  # not an error of this recording: none could be done here
            return one_line(error)
    return attempted(_LOADED[key], row)


def _done(ray: Any, reference: Any, row: ManifestRow) -> ManifestRow:
    """The row of a task that ended."""
    try:
        result = ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # `_do` reports errors of users itself, so the program differs there
        raise InputError("a worker", f"could not start ({_short(error)})", "install the same program on every machine"
                         ) from None
    except ray.exceptions.RayError as error:
        return replace(row, error=f"its worker died {ATTEMPTS} times ({_short(error)})")
    if isinstance(result, str):
        raise InputError("a worker", f"cannot do its work ({result})", "give all machines the same files")
    return ManifestRow(**vars(result))


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[-120:]
