"""A batch as the command line asks for it: from the recordings that are named to a manifest of what was done."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

from data_module.errors import InputError
from gesticulator.batch import ray_pool
from gesticulator.batch.manifest import check_manifest, default_name
from gesticulator.batch.run import BatchTask, Maker, asked_shard, done_here, file_hash, run_batch
from gesticulator.bundle.bundle import SHIPPED
from gesticulator.bundle.files import INDEX, read_index
from gesticulator.version import __version__

_NOT_SETTINGS = {"speech", "output", "preview", "plan_out", "text", "bundle", "list", "quiet", "manifest", "shard",
                 "ray"}
"""Arguments that change no byte of what is written, or are noted by themselves."""


class NamedRecording(Protocol):
    """A recording of a command line: its file (None is standard input), what is written, its transcript, and why it
    cannot be done."""

    @property
    def source(self) -> Path | None:
        """Its file."""

    @property
    def targets(self) -> tuple[Path, ...]:
        """What is written."""

    @property
    def text(self) -> Path | None:
        """Its transcript."""

    @property
    def fault(self) -> InputError | None:
        """Why it cannot be done."""


def run_jobs(jobs: Sequence[NamedRecording], asked: argparse.Namespace, make: Maker) -> tuple[int, int]:
    """Do what is missing or changed; how many recordings there were, and how many of them are done.

    make: gives in each worker what does a job by its number. `InputError` for what cannot be used.
    """
    if any(job.source is None for job in jobs):
        raise InputError("standard input", "is no recording of a batch", "name files or folders")
    shard = asked_shard(asked.shard)
    path = Path(asked.manifest) if asked.manifest else jobs[0].targets[0].parent / default_name(*shard)
    check_manifest(path)
    if asked.ray:
        ray_pool.check_ray(asked.ray)
    folder = Path(asked.bundle) if asked.bundle else SHIPPED
    read_index(folder)
    bundle, settings = file_hash(folder / INDEX), _settings_hash(asked)
    tasks = [BatchTask(number, job.source, job.targets, (__version__, bundle, _with_text(settings, job.text)),
                       job.fault) for number, job in enumerate(jobs) if job.source is not None]
    outcomes = partial(ray_pool.done_on_ray, asked.ray, make) if asked.ray else partial(done_here, make)
    return run_batch(tasks, path, outcomes, shard, asked.quiet)


def _settings_hash(asked: argparse.Namespace) -> str:
    """SHA-256 of what was asked of every recording; of files that were named, of what they hold."""
    told = {name: value for name, value in vars(asked).items() if name not in _NOT_SETTINGS}
    held = {name: file_hash(Path(value)) for name, value in told.items()
            if isinstance(value, str) and Path(value).is_file()}
    return hashlib.sha256(repr(sorted((told | held).items())).encode()).hexdigest()


def _with_text(settings: str, text: Path | None) -> str:
    """The hash of the settings, and of a recording's own transcript, where it has one."""
    if text is None or not text.is_file():
        return settings
    return hashlib.sha256(settings.encode() + text.read_bytes()).hexdigest()
