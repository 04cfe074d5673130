"""Batches: which recordings to process, in which order, on which worker, and what to record of each.

Work is divided by duration, longest first, from the files alone, so every machine divides it alike. Each result is
written atomically and does not depend on the worker that made it; so any number of workers, any order and any restart
give the same bytes.
"""

from __future__ import annotations

import hashlib
import heapq
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from data_module.errors import InputError, complain, one_line
from data_module.files import remove_unfinished_of
from data_module.settings import whole_number
from gesticulator.bundle.files import INDEX, bundle_folder, read_index
from gesticulator.cli import PROGRAM
from gesticulator.jobs import BatchRequest, Job, file_hash
from gesticulator.manifest import DONE, FAILED, Manifest, ManifestRow, check_manifest, default_name, table
from gesticulator.version import __version__

Doing: TypeAlias = "Callable[[int], float]"
"""Processes the recording of that number and returns its duration in seconds; raises InputError or OSError."""
Maker: TypeAlias = "Callable[[], Doing]"
"""Loads the models. It is called once in each worker and must be picklable."""
Outcomes: TypeAlias = "Callable[[Sequence[int]], Iterator[TaskOutcome]]"
"""Processes the recordings of these numbers; the outcomes come in any order."""
READERS = 8
"""Threads that read and hash recordings before processing."""
_MOST_SHARDS = 10**9
_BYTES_PER_SECOND = 16_000
"""Assumed for files whose header lacks a duration, such as MP3 at 128 kbit/s; affects only how work is divided."""


@dataclass(frozen=True)
class BatchTask:
    """A recording to process. number: its index for `Doing`; source: its file; outputs: the files to write; made_with:
    program, bundle and settings, see `ManifestRow`; fault: why it cannot be processed, if known."""

    number: int
    source: Path
    outputs: tuple[Path, ...]
    made_with: tuple[str, str, str]
    fault: InputError | None = None
    seconds: float = 0.0

    @property
    def order(self) -> tuple[float, str]:
        """Sort key: longest first, then by name, independent of the folder's location."""
        return -self.seconds, self.source.name

    def row(self) -> ManifestRow:
        """Its manifest row before processing; reads the file to hash it."""
        program, bundle, settings = self.made_with
        try:
            digest = file_hash(self.source)
        except OSError:
            digest = ""
        return ManifestRow(str(self.source), digest, self.seconds, tuple(map(str, self.outputs)), program=program,
                           bundle=bundle, settings=settings)


@dataclass(frozen=True)
class TaskOutcome:
    """The outcome of a recording: its number, duration in seconds (0 on failure), error message, computing time in
    seconds, and worker."""

    number: int
    seconds: float
    error: str
    time: float
    worker: str


def estimated_seconds(path: Path) -> float:
    """Duration of a recording from its header, else estimated from its size (MP3, whose header takes a process to
    read); 0 if it cannot be read."""
    from data_module.speech.audio import header_seconds

    try:
        return header_seconds(path) or path.stat().st_size / _BYTES_PER_SECOND
    except OSError:
        return 0.0


def parse_shard(text: str | None) -> tuple[int, int]:
    """Parse a shard such as 2/8; None means 1/1, all of it."""
    first, mark, last = (text or "1/1").partition("/")
    index, count = whole_number(first, _MOST_SHARDS), whole_number(last, _MOST_SHARDS)
    if not index or not count or index > count:
        raise InputError(f"--shard {first[:20]}{mark}{last[:20]}", "is not a shard", "write it as 1/8 to 8/8")
    return index, count


def sharded(tasks: Sequence[BatchTask], shard: int, count: int) -> list[BatchTask]:
    """The tasks of one shard (1 to `count`): longest first, each goes to the shard with the least work so far."""
    # A heap of (work so far, shard): equal work goes to the lower number, so all machines agree.
    loads = [(0.0, index) for index in range(1, count + 1)]
    chosen = []
    for task in sorted(tasks, key=lambda task: task.order):
        # Greedy longest-first scheduling: the least loaded shard takes the next task.
        load, index = heapq.heappop(loads)
        # Recordings of unknown duration still take some time, so they are spread too.
        heapq.heappush(loads, (load + max(task.seconds, 0.1), index))
        if index == shard:
            chosen.append(task)
    return chosen


def attempted(doing: Doing, number: int) -> TaskOutcome:
    """Process a recording; an error becomes part of the outcome."""
    # An error is a result, because one bad file must not end a batch of thousands.
    begin, seconds, fault = time.perf_counter(), 0.0, ""
    try:
        seconds = doing(number)
    except (InputError, OSError) as error:
        fault = one_line(error)
    return TaskOutcome(number, seconds, fault, time.perf_counter() - begin, f"{socket.gethostname()}:{os.getpid()}")


def done_here(make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Process recordings one by one in this process."""
    doing = make()
    for number in numbers:
        yield attempted(doing, number)


def run_jobs(jobs: Sequence[Job], request: BatchRequest, bundle: str | None, threads: int, quiet: bool,
             outcomes: Outcomes) -> tuple[int, int]:
    """Process recordings that are missing or changed; returns (number of recordings, number done).

    bundle: its name or folder. threads: of torch, which decide the last bits of the output. outcomes: see `run_batch`.
    `InputError` for invalid input.
    """
    if any(job.source is None for job in jobs):
        raise InputError("standard input", "is not a recording of a batch", "name files or folders")
    shard = parse_shard(request.shard)
    # Beside the outputs, so that a folder of results is self-contained.
    path = Path(request.manifest or jobs[0].targets[0].parent / default_name(*shard))
    check_manifest(path)
    folder = bundle_folder(bundle)
    # A broken bundle is refused before recordings are hashed, which may take minutes.
    read_index(folder)
    index = file_hash(folder / INDEX)
    tasks = [BatchTask(number, job.source, job.targets, (__version__, index, _settings(job, threads)), job.fault)
             for number, job in enumerate(jobs) if job.source is not None]
    return run_batch(tasks, path, outcomes, shard, quiet)


def _settings(job: Job, threads: int) -> str:
    return hashlib.sha256(f"{job.digest} {threads}".encode()).hexdigest()


def run_batch(tasks: Sequence[BatchTask], manifest: Path, outcomes: Outcomes, shard: tuple[int, int] = (1, 1),
              quiet: bool = False) -> tuple[int, int]:
    """Process recordings that are missing or changed and record them; returns (recordings in the shard, number done).

    outcomes: processes recordings by number, given longest first, yielding in any order. `InputError` if another
    process has locked the manifest.
    """
    from concurrent.futures import ThreadPoolExecutor

    from tqdm import tqdm

    # Threads, because a shared folder has high latency but serves many requests at a time.
    with ThreadPoolExecutor(READERS, thread_name_prefix="reader") as readers, Manifest(manifest) as notes:
        lengths = readers.map(estimated_seconds, [task.source for task in tasks])
        chosen = sharded([replace(task, seconds=seconds) for task, seconds in zip(tasks, lengths, strict=True)], *shard)
        waiting: dict[int, ManifestRow] = {}
        for task, row in zip(chosen, readers.map(BatchTask.row, chosen), strict=True):
            # A row counts as done only if recording, program, bundle, settings and outputs are those of now.
            before = notes.rows.get(str(task.source))
            if task.fault is not None:
                notes.add(replace(row, status=FAILED, error=one_line(task.fault)))
                complain(f"{PROGRAM}: {one_line(task.fault)}")
            elif before is None or before.made_of != row.made_of or not before.stands():
                waiting[task.number] = row
        # Rows of an earlier run that are still valid.
        unchanged = sum(notes.rows[str(task.source)].status == DONE for task in chosen
                        if task.number not in waiting and task.fault is None)
        # A killed run or worker may have left partially written files.
        # Only files of this shard: another machine may be writing its own into the same folder.
        outputs = [output for task in chosen if task.number in waiting for output in task.outputs]
        remove_unfinished_of(outputs)
        with tqdm(total=round(sum(row.seconds for row in waiting.values())), unit=" s of sound",
                  disable=quiet or not sys.stderr.isatty()) as bar:
            for outcome in outcomes(list(waiting)) if waiting else ():
                row = waiting[outcome.number]
                bar.update(round(row.seconds))
                notes.add(replace(row, seconds=outcome.seconds or row.seconds, status=FAILED if outcome.error else DONE,
                                  error=outcome.error, time=outcome.time, worker=outcome.worker))
                if outcome.error:
                    complain(f"{PROGRAM}: {outcome.error}")
        remove_unfinished_of(outputs)
        # Rows of recordings that are no longer named stay in the manifest, but not in the summary.
        rows = [notes.rows[str(task.source)] for task in chosen]
    if not quiet:
        print(f"{manifest}:\n{table(rows, unchanged)}", flush=True)
    return len(rows), sum(row.status == DONE for row in rows)
