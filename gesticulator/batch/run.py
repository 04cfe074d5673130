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
from typing import TypeAlias, TypeVar

from data_module.build import end_with_parent
from data_module.errors import InputError, complain, one_line
from data_module.files import remove_unfinished_of
from data_module.settings import whole_number
from gesticulator.batch.manifest import DONE, FAILED, Manifest, ManifestRow, table
from gesticulator.cli import PROGRAM

Doing: TypeAlias = "Callable[[int], float]"
"""Processes the recording of that number and returns its duration in seconds; raises InputError or OSError."""
Maker: TypeAlias = "Callable[[], Doing]"
"""Loads the models. It is called once in each worker and must be picklable."""
READERS = 8
"""Threads that read and hash recordings before processing."""
_Given = TypeVar("_Given")
_Found = TypeVar("_Found")
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


def file_hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def estimated_seconds(path: Path) -> float:
    """Duration of a recording from its header, else estimated from its size (MP3, whose header takes a process to
    read); 0 if it cannot be read."""
    from data_module.speech.audio import header_seconds

    try:
        return header_seconds(path) or path.stat().st_size / _BYTES_PER_SECOND
    except OSError:
        return 0.0


def _read(one: Callable[[_Given], _Found], items: Sequence[_Given]) -> list[_Found]:
    """Apply a function to all items in several threads: a shared folder has high latency but serves many requests."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(READERS, thread_name_prefix="reader") as readers:
        try:
            return list(readers.map(one, items))
        except BaseException:
            readers.shutdown(wait=False, cancel_futures=True)  # do not wait for the remaining items
            raise


def parse_shard(text: str | None) -> tuple[int, int]:
    """Parse a shard such as 2/8; None means 1/1, all of it."""
    first, mark, last = (text or "1/1").partition("/")
    index, count = whole_number(first, _MOST_SHARDS), whole_number(last, _MOST_SHARDS)
    if not index or not count or index > count:
        raise InputError(f"--shard {first[:20]}{mark}{last[:20]}", "is not a shard", "write it as 1/8 to 8/8")
    return index, count


def sharded(tasks: Sequence[BatchTask], shard: int, count: int) -> list[BatchTask]:
    """The tasks of one shard (1 to `count`): longest first, each goes to the shard with the least work so far."""
    loads = [(0.0, index) for index in range(1, count + 1)]
    chosen = []
    for task in sorted(tasks, key=lambda task: task.order):
        load, index = heapq.heappop(loads)
        # Recordings of unknown duration still take some time, so they are spread too.
        heapq.heappush(loads, (load + max(task.seconds, 0.1), index))
        if index == shard:
            chosen.append(task)
    return chosen


def attempted(doing: Doing, number: int) -> TaskOutcome:
    """Process a recording; an error becomes part of the outcome."""
    begin, seconds, fault = time.perf_counter(), 0.0, ""
    try:
        seconds = doing(number)
    except (InputError, OSError) as error:
        fault = one_line(error)
    return TaskOutcome(number, seconds, fault, time.perf_counter() - begin, f"{socket.gethostname()}:{os.getpid()}")


def done_in_processes(workers: int, make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Process recordings in several local processes; `InputError` if one of them is killed."""
    if workers <= 1 or len(numbers) <= 1:
        yield from done_here(make, numbers)
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool

    # Spawned, not forked: the same on every system, and numpy re-reads the number of threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(numbers)), context, _begin, (make,)) as pool:
        try:
            for future in as_completed([pool.submit(_do, number) for number in numbers]):
                yield future.result()
        except BrokenProcessPool:
            raise InputError("a process", "was killed (perhaps out of memory)", "repeat the command with "
                             "fewer processes: finished recordings are kept") from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_doing: Doing | None = None
"""The function that processes recordings in a worker of `done_in_processes`."""


def _begin(make: Maker) -> None:
    global _doing
    end_with_parent()
    _doing = make()


def _do(number: int) -> TaskOutcome:
    assert _doing is not None
    return attempted(_doing, number)


def done_here(make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Process recordings one by one in this process."""
    doing = make()
    for number in numbers:
        yield attempted(doing, number)


def run_batch(tasks: Sequence[BatchTask], manifest: Path, outcomes: Callable[[Sequence[int]], Iterator[TaskOutcome]],
              shard: tuple[int, int] = (1, 1), quiet: bool = False) -> tuple[int, int]:
    """Process recordings that are missing or changed and record them; returns (recordings in the shard, number done).

    outcomes: processes recordings by number, given longest first, yielding in any order. `InputError` if another
    process has locked the manifest.
    """
    from tqdm import tqdm

    lengths = _read(estimated_seconds, [task.source for task in tasks])
    chosen = sharded([replace(task, seconds=seconds) for task, seconds in zip(tasks, lengths, strict=True)], *shard)
    with Manifest(manifest) as notes:
        waiting: dict[int, ManifestRow] = {}
        for task, row in zip(chosen, _read(BatchTask.row, chosen), strict=True):
            before = notes.rows.get(str(task.source))
            if task.fault is not None:
                notes.add(replace(row, status=FAILED, error=one_line(task.fault)))
                complain(f"{PROGRAM}: {one_line(task.fault)}")
            elif before is None or before.made_of != row.made_of or not before.stands():
                waiting[task.number] = row
        unchanged = sum(notes.rows[str(task.source)].status == DONE for task in chosen
                   if task.number not in waiting and task.fault is None)
        # A killed run or worker may have left partially written files.
        outputs = [output for task in chosen if task.number in waiting for output in task.outputs]
        remove_unfinished_of(outputs)
        with tqdm(total=round(sum(row.seconds for row in waiting.values())), unit=" s of sound",
                  disable=quiet or not sys.stderr.isatty()) as bar:
            for one in outcomes(list(waiting)) if waiting else ():
                row = waiting[one.number]
                bar.update(round(row.seconds))
                notes.add(replace(row, seconds=one.seconds or row.seconds, status=FAILED if one.error else DONE,
                                  error=one.error, time=one.time, worker=one.worker))
                if one.error:
                    complain(f"{PROGRAM}: {one.error}")
        remove_unfinished_of(outputs)
        rows = [notes.rows[str(task.source)] for task in chosen]
    if not quiet:
        print(f"{manifest}:\n{table(rows, unchanged)}", flush=True)
    return len(rows), sum(row.status == DONE for row in rows)
