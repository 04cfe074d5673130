"""Many recordings: which of them are to be done, in which order, by whom, and what is noted of each.

Work is divided by seconds of sound, longest first, by the files alone, so every machine divides it alike. Each result
is written whole or not at all and does not depend on who made it; so any number of workers, any order and any restart
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
"""Does the recording of that number and gives its seconds of sound; InputError or OSError where it cannot."""
Maker: TypeAlias = "Callable[[], Doing]"
"""Loads the models. It is called once in each worker, in whose process it must be known by its name."""
READERS = 8
"""Threads that read recordings before the work."""
_Given = TypeVar("_Given")
_Found = TypeVar("_Found")
_MOST_SHARDS = 10**9
_BYTES_PER_SECOND = 16_000
"""Of a recording whose header does not tell its length, such as MP3 at 128 kbit/s: only who does what depends on it."""


@dataclass(frozen=True)
class BatchTask:
    """A recording to do. number: what `Doing` knows it by; source: its file; outputs: what is made of it; made_with:
    program, bundle and settings, see `ManifestRow`; fault: why it cannot be done, if that is known."""

    number: int
    source: Path
    outputs: tuple[Path, ...]
    made_with: tuple[str, str, str]
    fault: InputError | None = None
    seconds: float = 0.0

    @property
    def order(self) -> tuple[float, str]:
        """Longest first, then by name: the same wherever the folder lies."""
        return -self.seconds, self.source.name

    def row(self) -> ManifestRow:
        """Of it, before it is done. The file is read for its hash."""
        program, bundle, settings = self.made_with
        try:
            digest = file_hash(self.source)
        except OSError:
            digest = ""
        return ManifestRow(str(self.source), digest, self.seconds, tuple(map(str, self.outputs)), program=program,
                           bundle=bundle, settings=settings)


@dataclass(frozen=True)
class TaskOutcome:
    """What became of a recording: its number, seconds of sound (0 where it failed), what was wrong, seconds of
    computing, and which worker did it."""

    number: int
    seconds: float
    error: str
    time: float
    worker: str


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def told_seconds(path: Path) -> float:
    """Seconds of a recording by its header, else guessed by its size; 0 for what is none. MP3 is guessed: its header
    takes a process to read."""
    from data_module.speech.audio import header_seconds

    try:
        return header_seconds(path) or path.stat().st_size / _BYTES_PER_SECOND
    except OSError:
        return 0.0


def _read(one: Callable[[_Given], _Found], items: Sequence[_Given]) -> list[_Found]:
    """Do one thing to all, by several threads: a shared folder answers late, and many at once."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(READERS, thread_name_prefix="reader") as readers:
        try:
            return list(readers.map(one, items))
        except BaseException:
            readers.shutdown(wait=False, cancel_futures=True)  # the rest of 100,000 is not waited for
            raise


def asked_shard(text: str | None) -> tuple[int, int]:
    """A shard such as 2/8; the whole, 1/1, where none is asked for."""
    first, mark, last = (text or "1/1").partition("/")
    index, count = whole_number(first, _MOST_SHARDS), whole_number(last, _MOST_SHARDS)
    if not index or not count or index > count:
        raise InputError(f"--shard {first[:20]}{mark}{last[:20]}", "is no shard", "write it as 1/8 to 8/8")
    return index, count


def sharded(tasks: Sequence[BatchTask], shard: int, count: int) -> list[BatchTask]:
    """The tasks of shard 1 to `count`: the longest goes first, each to the shard that has the least to do."""
    loads = [(0.0, index) for index in range(1, count + 1)]
    mine = []
    for task in sorted(tasks, key=lambda task: task.order):
        load, index = heapq.heappop(loads)
        # A recording of no length still takes a moment, so they are spread, too.
        heapq.heappush(loads, (load + max(task.seconds, 0.1), index))
        if index == shard:
            mine.append(task)
    return mine


def attempted(doing: Doing, number: int) -> TaskOutcome:
    """Do a recording; a fault of it is kept."""
    begin, seconds, fault = time.perf_counter(), 0.0, ""
    try:
        seconds = doing(number)
    except (InputError, OSError) as error:
        fault = one_line(error)
    return TaskOutcome(number, seconds, fault, time.perf_counter() - begin, f"{socket.gethostname()}:{os.getpid()}")


def done_in_processes(workers: int, make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Do them in so many processes of this machine; `InputError` where one of these is killed."""
    if workers <= 1 or len(numbers) <= 1:
        yield from done_here(make, numbers)
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from concurrent.futures.process import BrokenProcessPool

    # Spawned, not forked: the same on every system, and numpy reads the number of threads anew.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(numbers)), context, _begin, (make,)) as pool:
        try:
            for future in as_completed([pool.submit(_do, number) for number in numbers]):
                yield future.result()
        except BrokenProcessPool:
            raise InputError("a process", "was ended from outside (perhaps memory ran out)", "do the same again with "
                             "fewer processes: what is done stays") from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_doing: Doing | None = None
"""Of a process of `done_in_processes`."""


def _begin(make: Maker) -> None:
    global _doing
    end_with_parent()
    _doing = make()


def _do(number: int) -> TaskOutcome:
    assert _doing is not None
    return attempted(_doing, number)


def done_here(make: Maker, numbers: Sequence[int]) -> Iterator[TaskOutcome]:
    """Do them in this process, one after the other."""
    doing = make()
    for number in numbers:
        yield attempted(doing, number)


def run_batch(tasks: Sequence[BatchTask], manifest: Path, outcomes: Callable[[Sequence[int]], Iterator[TaskOutcome]],
              shard: tuple[int, int] = (1, 1), quiet: bool = False) -> tuple[int, int]:
    """Do what is missing or changed and note it; how many recordings the shard has, and how many of them are done.

    outcomes: does recordings by their numbers, the longest given first, in any order. `InputError` where another
    process holds the manifest.
    """
    from tqdm import tqdm

    lengths = _read(told_seconds, [task.source for task in tasks])
    mine = sharded([replace(task, seconds=seconds) for task, seconds in zip(tasks, lengths, strict=True)], *shard)
    with Manifest(manifest) as notes:
        waiting: dict[int, ManifestRow] = {}
        for task, row in zip(mine, _read(BatchTask.row, mine), strict=True):
            before = notes.rows.get(str(task.source))
            if task.fault is not None:
                notes.add(replace(row, status=FAILED, error=one_line(task.fault)))
                complain(f"{PROGRAM}: {one_line(task.fault)}")
            elif before is None or before.made_of != row.made_of or not before.stands():
                waiting[task.number] = row
        kept = sum(notes.rows[str(task.source)].status == DONE for task in mine
                   if task.number not in waiting and task.fault is None)
        # What was killed may have left something half-written: a run before this one, or a worker of this one.
        begun = [output for task in mine if task.number in waiting for output in task.outputs]
        remove_unfinished_of(begun)
        with tqdm(total=round(sum(row.seconds for row in waiting.values())), unit=" s of sound",
                  disable=quiet or not sys.stderr.isatty()) as bar:
            for one in outcomes(list(waiting)) if waiting else ():
                row = waiting[one.number]
                bar.update(round(row.seconds))
                notes.add(replace(row, seconds=one.seconds or row.seconds, status=FAILED if one.error else DONE,
                                  error=one.error, time=one.time, worker=one.worker))
                if one.error:
                    complain(f"{PROGRAM}: {one.error}")
        remove_unfinished_of(begun)
        rows = [notes.rows[str(task.source)] for task in mine]
    if not quiet:
        print(f"{manifest}:\n{table(rows, kept)}", flush=True)
    return len(rows), sum(row.status == DONE for row in rows)
