"""`gesticulator infer`: from recordings to motion files, the main command.

Everything that can be checked before the work is checked first (`gesticulator.jobs.jobs_of`). An error of the
command is an `InputError`; an error of one recording is stored in its `Job`, so that the others are still processed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial

from data_module.errors import EXIT_BAD_INPUT, InputError, complain, one_line
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings
from gesticulator.jobs import Job, RunSettings, infer_arguments, jobs_of, run_settings_of
from gesticulator.worker import Worker, check_job, retargeter_for

EXIT_PART_FAILED = 1


def run(args: argparse.Namespace) -> int:
    """Process all recordings; exit code 0, 1 if some failed, 2 if none succeeded."""
    jobs, settings = jobs_of(args), run_settings_of(args)
    # Warnings of libraries mean nothing to a user of the command.
    with our_warnings():
        if settings.is_batch:
            done, total = _run_batch(jobs, settings)
        else:
            done, total = _run_all(jobs, settings), len(jobs)
    return 0 if done == total else EXIT_PART_FAILED if done else EXIT_BAD_INPUT


def _run_all(jobs: Sequence[Job], settings: RunSettings) -> int:
    """Process recordings and print a summary of each; the number of those that succeeded."""
    if len(jobs) == 1:
        check_job(jobs[0])  # before the models are loaded
    worker, done = _worker(jobs, settings), 0
    for job in jobs:
        try:
            with limited_threads(settings.threads):
                _, summary = worker.perform(job)
        except (InputError, OSError) as error:
            # The error of a single recording is that of the command: exit code 2, and no summary.
            if len(jobs) == 1:
                raise
            complain(f"{PROGRAM}: {one_line(error)}")
            continue
        done += 1
        if not settings.quiet:
            print(summary, flush=True)
    if done < len(jobs):
        complain(f"{PROGRAM}: {done} of {len(jobs)} recordings done, {len(jobs) - done} failed")
    # One line at the end, because lines of single recordings scroll away.
    elif len(jobs) > 1 and not settings.quiet:
        print(f"{len(jobs)} recordings done", flush=True)
    return done


def _worker(jobs: Sequence[Job], settings: RunSettings) -> Worker:
    """Load the character and the models, and check that these can follow the options."""
    from gesticulator.gesticulator import Gesticulator

    options, retargeter = jobs[0].options, retargeter_for(jobs[0].character, settings.quiet)
    with limited_threads(settings.threads):
        worker = Worker(Gesticulator.from_pretrained(settings.bundle), retargeter)
        # A wrong option is the error of the command, not of each recording.
        if options.plan is None:
            worker.gesticulator.resolver.setup(options, text=False)
    return worker


def _run_batch(jobs: Sequence[Job], settings: RunSettings) -> tuple[int, int]:
    """Process recordings that are not done yet and record them in a manifest; (number done, number of recordings)."""
    from gesticulator import batch

    # A function that can be pickled: with Ray it is called on other machines.
    make = partial(_process, jobs, settings)
    processing = partial(batch.done_here, make)
    if settings.ray is not None:
        from gesticulator.ray_pool import check_ray, done_on_ray

        check_ray(settings.ray)
        processing = partial(done_on_ray, settings.ray, make)
    return batch.run_jobs(jobs, settings, processing)


def _process(jobs: Sequence[Job], settings: RunSettings) -> Callable[[str], float]:
    """Load the models; returns a function that processes the recording at a path and returns its duration in
    seconds."""
    # By path and not by number: a row of the manifest knows its recording by it.
    worker, by_path = _worker(jobs, settings), {str(job.source): job for job in jobs}

    def process(path: str) -> float:
        with limited_threads(settings.threads):
            seconds, _ = worker.perform(by_path[path])
            return seconds

    return process


COMMAND = Command(
    "generate gestures for recordings of speech", infer_arguments, run,
    examples=(
        "infer speech.wav -o gesture.bvh --preview gesture.html",
        "infer speech.wav -o gesture.bvh --text speech.txt",
        "infer silence.wav --character rig.glb -o idle.glb --loop --clip-name idle",
        "infer speech.wav -o gesture.bvh --hand-height low --hand-speed 0.3 --activity 0.6",
        "infer speech2.wav -o gesture.bvh --plan plan.json --retime --plan-out plan2.json",
        "infer speech.wav -o gesture.bvh --text speech.txt --cue bread=wave --hold-still 3.2-5.0",
        "infer recordings/ -o out/ --preview out/ --text texts/",
        "infer recordings/ -o out/ --shard 2/8",
        "infer recordings/ -o out/ --ray local:4",
        "infer - -o gesture.bvh < speech.wav",
    ))


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `python -m gesticulator.infer`."""
    return COMMAND.main(f"{PROGRAM} infer", argv)


if __name__ == "__main__":
    sys.exit(main())
