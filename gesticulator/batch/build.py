"""`gesticulator build`: build a corpus in local processes, in shards, or on a Ray cluster, with a manifest.

Each worker writes its recordings and their outcomes into the unfinished store. The store is finished when all
recordings are there; its bytes do not depend on which worker made them, or in what order.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from data_module import build
from data_module.errors import InputError, complain
from gesticulator.batch.manifest import DONE, FAILED, Manifest, ManifestRow, check_manifest, default_name, table
from gesticulator.cli import PROGRAM, Command

if TYPE_CHECKING:
    from data_module.build_report import Outcome
    from data_module.corpora.base import Item
    from data_module.store import StoreWriter
    from gesticulator.batch.run import BatchTask


def _arguments(p: argparse.ArgumentParser, corpus: str) -> None:
    build.add_arguments(p, corpus)
    many = p.add_argument_group("several machines")
    many.add_argument("--ray", metavar="WHERE",
                      help="build on a Ray cluster: auto, its address, or local:N for N workers on this machine "
                      "(needs Ray)")
    many.add_argument("--shard", metavar="I/N",
                      help="build shard I of N and stop; the same command without --shard builds what is missing and "
                      "finishes the store")
    many.add_argument("--manifest", metavar="FILE",
                      help="record the status of each recording here (.parquet or .jsonl); default with --ray and "
                      "--shard: STORE.manifest.parquet")


def _choose(args: argparse.Namespace) -> int:
    """Parse the rest of the command line for the chosen corpus, and build it."""
    from data_module.corpora.table import reader_of

    reader_of(args.corpus)
    chosen = Command(f"build a training store: {args.corpus}", partial(_arguments, corpus=args.corpus), _run)
    return chosen.main(f"{PROGRAM} build {args.corpus}", args.rest)


def _run(args: argparse.Namespace) -> int:
    if not (args.ray or args.shard or args.manifest):
        return build.run(args)
    from gesticulator.batch import ray_pool
    from gesticulator.batch.run import parse_shard

    shard = parse_shard(args.shard)
    path = Path(args.manifest or args.out.with_name(f"{args.out.name}.{default_name(*shard)}"))
    check_manifest(path)
    if args.ray:
        ray_pool.check_ray(args.ray)
    request = build.asked_for(args)
    from data_module.store import Store

    with Manifest(path) as notes:
        noted = _NotedBuild(notes, args.ray, args.workers, *shard)
        if shard == (1, 1):
            build.run(args, noted.made)
            noted.complete((info.name, info.seconds) for info in Store.open(args.out).recordings)
        else:
            made = build.build_share(request, noted.made, noted.mine)
            noted.complete((outcome.name, outcome.seconds) for outcome in made or ())
            print(f"{args.out}: " + ("is there already" if made is None else f"share {shard[0]} of {shard[1]}"))
        rows = list(notes.rows.values())
    print(f"{path}:\n{table(rows)}", flush=True)
    return 0


@dataclass
class _NotedBuild:
    """Builds recordings and records them in the manifest. ray: see `done_on_ray`; workers: processes without Ray;
    index, count: of the shard."""

    notes: Manifest
    ray: str | None
    workers: int
    index: int
    count: int
    _writer: StoreWriter | None = None

    def mine(self, items: Sequence[Item]) -> list[Item]:
        """The items of this shard, the largest first."""
        from gesticulator.batch.run import sharded

        return [items[task.number] for task in sharded(_tasks(items), self.index, self.count)]

    def made(self, workshop: build.Workshop, items: Sequence[Item]) -> Iterator[Outcome]:
        """See `build.Making`."""
        from gesticulator.batch.ray_pool import done_on_ray
        from gesticulator.batch.run import done_in_processes, sharded

        self._writer = workshop.writer
        settings = self._row("").settings
        for name in [row.input for row in self.notes.rows.values() if row.settings != settings]:
            del self.notes.rows[name]  # rows of an earlier store of the same name
        make = partial(_worker, workshop, tuple(items))
        order = [task.number for task in sharded(_tasks(items), 1, 1)]
        if not order:
            return
        for one in done_on_ray(self.ray, make, order) if self.ray else done_in_processes(self.workers, make, order):
            item = items[one.number]
            outcome = None if one.error else workshop.outcome(item)
            wrong = one.error or (outcome.dropped if outcome is not None else "is not there")
            self.notes.add(replace(self._row(item.info.name, one.seconds), status=FAILED if wrong else DONE,
                                   error=wrong, time=one.time, worker=one.worker))
            if outcome is not None:
                yield outcome
            else:
                complain(f"{PROGRAM}: {item.info.name}: {wrong}")

    def complete(self, made: Iterable[tuple[str, float]]) -> None:
        """Add recordings (name, seconds) that an earlier run built but could not record before it was killed."""
        for name, seconds in made if self._writer is not None else ():
            if name not in self.notes.rows:
                self.notes.add(self._row(name, seconds))

    def _row(self, name: str, seconds: float = 0.0) -> ManifestRow:
        from gesticulator.version import __version__

        assert self._writer is not None
        made_with = hashlib.sha256(json.dumps(self._writer.head, sort_keys=True).encode()).hexdigest()
        files = tuple(str(self._writer.path / "recordings" / f"{name}.{kind}") for kind in ("flac", "npz"))
        return ManifestRow(name, seconds=seconds, output=files, program=__version__, settings=made_with)


def _tasks(items: Sequence[Item]) -> list[BatchTask]:
    from gesticulator.batch.run import BatchTask

    return [BatchTask(number, Path(item.info.name), (), ("", "", ""), seconds=item.size)
            for number, item in enumerate(items)]


def _worker(workshop: build.Workshop, items: Sequence[Item]) -> Callable[[int], float]:
    """Open the corpus; returns a function that builds recording `number` and returns its duration in seconds."""
    from data_module.corpora.table import open_corpus

    workshop.reader = open_corpus(workshop.corpus, workshop.source, workshop.options)
    settings = json.loads(json.dumps(dict(workshop.reader.settings())))
    if settings != workshop.writer.head["settings"]:
        raise InputError(workshop.source or workshop.corpus, "is not the same on all machines",
                         "give them the same files and programs")

    def make(number: int) -> float:
        return workshop.make(items[number]).seconds

    return make


COMMAND = Command(
    "build a training store from recordings of speech and motion", build.choose_corpus, _choose,
    examples=("build folder --source DIR --out store",
              "build beat --source DIR --out store --workers 4", "build beat --source DIR --out store --ray auto",
              "build beat --source DIR --out store --shard 2/8"))
