"""Batch inference: process the recordings named on the command line and record the results in a manifest."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from data_module.errors import InputError
from gesticulator.batch import ray_pool
from gesticulator.batch.jobs import Job
from gesticulator.batch.manifest import check_manifest, default_name
from gesticulator.batch.run import BatchTask, Maker, done_here, file_hash, parse_shard, run_batch
from gesticulator.bundle.files import INDEX, bundle_folder, read_index
from gesticulator.version import __version__

_NOT_SETTINGS = {"speech", "output", "preview", "plan_out", "text", "bundle", "list", "quiet", "manifest", "shard",
                 "ray", "retime_report"}
"""Arguments that do not affect the output bytes, or that have their own column in the manifest."""


def run_jobs(jobs: Sequence[Job], args: argparse.Namespace, make: Maker) -> tuple[int, int]:
    """Process recordings that are missing or changed; returns (number of recordings, number done).

    make: called once in each worker; returns the function that processes a job by its number. `InputError` for invalid
    input.
    """
    if any(job.source is None for job in jobs):
        raise InputError("standard input", "is not a recording of a batch", "name files or folders")
    shard = parse_shard(args.shard)
    path = Path(args.manifest) if args.manifest else jobs[0].targets[0].parent / default_name(*shard)
    check_manifest(path)
    if args.ray:
        ray_pool.check_ray(args.ray)
    folder = bundle_folder(args.bundle)
    read_index(folder)
    bundle, settings = file_hash(folder / INDEX), _settings_hash(args)
    tasks = [BatchTask(number, job.source, job.targets, (__version__, bundle, _with_text(settings, job.text)),
                       job.fault) for number, job in enumerate(jobs) if job.source is not None]
    outcomes = partial(ray_pool.done_on_ray, args.ray, make) if args.ray else partial(done_here, make)
    return run_batch(tasks, path, outcomes, shard, args.quiet)


def _settings_hash(args: argparse.Namespace) -> str:
    """SHA-256 of the settings shared by all recordings; a file argument counts by its content, not its name."""
    values = {name: value for name, value in vars(args).items() if name not in _NOT_SETTINGS}
    contents = {name: file_hash(Path(value)) for name, value in values.items()
            if isinstance(value, str) and Path(value).is_file()}
    return hashlib.sha256(repr(sorted((values | contents).items())).encode()).hexdigest()


def _with_text(settings: str, text: Path | None) -> str:
    """The hash of the settings, combined with that of the recording's transcript if it has one."""
    if text is None or not text.is_file():
        return settings
    return hashlib.sha256(settings.encode() + text.read_bytes()).hexdigest()
