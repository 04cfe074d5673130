"""Several recordings as clips of one file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gesticulator.batch.clip_options import clip_from_args
from gesticulator.batch.jobs import Job, check_job, load, performed
from gesticulator.export.clip import NAME

if TYPE_CHECKING:
    from data_module.controls import Controls
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.performance import Performance
    from gesticulator.pipeline import Gesticulator

def perform_together(jobs: Sequence[Job], system: Gesticulator, args: argparse.Namespace, controls: Controls | None,
                     retargeter: Retargeter | None) -> float:
    """Process recordings and write them as clips of one file each target; returns their duration in seconds. An error
    of one is an error of all, and nothing is written."""
    from gesticulator.export.glb import write_clips

    clip, stands = clip_from_args(args), retargeter is not None and retargeter.mapping.legs and retargeter.legs
    made: list[Performance] = []
    for job, name in zip(jobs, clip_names(jobs), strict=True):
        check_job(job, args)
        one = performed(job, load(job, args), system, args, controls, args.legs or stands)
        one = one.as_clip(replace(clip, name=name))
        made.append(one if retargeter is None else one.moved_by(retargeter))
    seconds = sum(one.duration for one in made)
    for target in jobs[0].targets:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_clips(target, [one.scene() for one in made])
        if not args.quiet:
            print(f"{len(jobs)} recordings, {seconds:.1f} s -> {target}: "
                  + ", ".join(one.clip.name for one in made if one.clip is not None), flush=True)
    return seconds


def clip_names(jobs: Sequence[Job]) -> list[str]:
    """The names of recordings without suffix, with a number appended to repeated ones."""
    names: list[str] = []
    for job in jobs:
        stem = "stdin" if job.source is None else Path(job.name).stem[:90] or NAME
        names.append(stem if stem not in names else f"{stem} {len(names) + 1}")
    return names


