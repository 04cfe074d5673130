"""`gesticulator infer`: from recordings to motion files, the main command.

Everything that can be checked before the work is checked first (`gesticulator.arguments.jobs_of`). An error of the
command is an `InputError`; an error of one recording is stored in its `Job`, so that the others are still processed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from data_module.errors import EXIT_BAD_INPUT, InputError, complain, one_line
from gesticulator.arguments import (
    RunSettings,
    batch_of,
    check_choices,
    check_options,
    infer_arguments,
    jobs_of,
    run_settings_of,
)
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings
from gesticulator.jobs import Job, Worker, check_job, retargeter_for

if TYPE_CHECKING:
    from gesticulator.batch import BatchRequest
    from gesticulator.gesticulator import Gesticulator

EXIT_PART_FAILED = 1


def run(args: argparse.Namespace) -> int:
    """Process all recordings; exit code 0, 1 if some failed, 2 if none succeeded."""
    settings = run_settings_of(args)
    jobs, batch = jobs_of(args), batch_of(args)
    check_choices(jobs[0].options)
    if batch is not None:
        return _run_batch(jobs, settings, batch)
    retargeter = retargeter_for(jobs[0].character, settings.quiet)
    # The error of a single recording is that of the command: exit code 2, and no summary.
    alone, done = len(jobs) == 1, 0
    with our_warnings():
        # Recordings that cannot be read fail before the models are loaded.
        ready = [job for job in jobs if _succeeded(partial(check_job, job), alone)]
        if ready:
            with limited_threads(settings.threads):
                worker = Worker(_loaded(settings), retargeter, settings.quiet)
                check_options(worker.gesticulator, jobs[0].options)

                def process(job: Job) -> None:
                    _say(worker.perform(job), settings)

                done = sum(_succeeded(partial(process, job), alone) for job in ready)
    return 0 if alone else _conclude(len(jobs), done, settings.quiet)


def _loaded(settings: RunSettings) -> Gesticulator:
    from gesticulator.gesticulator import Gesticulator

    return Gesticulator.from_pretrained(settings.bundle)


def _say(summary: object, settings: RunSettings) -> None:
    if not settings.quiet:
        print(summary, flush=True)


def _run_batch(jobs: Sequence[Job], settings: RunSettings, request: BatchRequest) -> int:
    """Process recordings that are not done yet and record them in a manifest; the exit code of `run`."""
    from gesticulator import batch

    # A function that can be pickled: with Ray it is called on other machines.
    make = partial(_worker, jobs, settings)
    outcomes = partial(batch.done_here, make)
    if request.ray is not None:
        from gesticulator.ray_pool import check_ray, done_on_ray

        check_ray(request.ray)
        outcomes = partial(done_on_ray, request.ray, make)
    with our_warnings():
        total, done = batch.run_jobs(jobs, request, settings.bundle, settings.threads, settings.quiet, outcomes)
    return 0 if done == total else EXIT_PART_FAILED if done else EXIT_BAD_INPUT


def _worker(jobs: Sequence[Job], settings: RunSettings) -> Callable[[int], float]:
    """Load the models; returns a function that processes a job by its number and returns its duration in seconds."""
    retargeter = retargeter_for(jobs[0].character, settings.quiet)
    with limited_threads(settings.threads):
        # In a batch the bar of the whole batch is shown, not one for each recording.
        worker = Worker(_loaded(settings), retargeter, quiet=True)
    check_options(worker.gesticulator, jobs[0].options)

    def process(number: int) -> float:
        with limited_threads(settings.threads):
            return worker.perform(jobs[number]).seconds

    return process


def _succeeded(step: Callable[[], object], alone: bool) -> bool:
    """Whether a step succeeded. The error of one recording among several is printed; that of the only one is raised."""
    try:
        step()
    except BrokenPipeError:  # the reader of the summaries has exited: not an error of the recording
        raise
    except (InputError, OSError) as error:
        if alone:
            raise
        complain(f"{PROGRAM}: {one_line(error)}")
        return False
    return True


def _conclude(count: int, done: int, quiet: bool) -> int:
    """Print how many of `count` recordings were done; the exit code."""
    if done < count:
        complain(f"{PROGRAM}: {done} of {count} recordings done, {count - done} failed")
        return EXIT_PART_FAILED if done else EXIT_BAD_INPUT
    # One line at the end, because lines of single recordings scroll away.
    if not quiet:
        print(f"{count} recordings done", flush=True)
    return 0


COMMAND = Command(
    "generate gestures for recordings of speech", infer_arguments, run,
    examples=(
        "infer speech.wav -o gesture.bvh --preview gesture.html",
        "infer speech.wav -o gesture.bvh --text speech.txt",
        "infer speech.wav -o gesture.bvh --transcribe tiny.en",
        "infer speech.wav -o gesture.glb -o gesture.vrma -o gesture.mp4",
        "infer recordings/ -o out/ --format fbx",
        "infer speech.wav --character rig.glb -o talk.glb",
        "infer silence.wav --character rig.glb -o idle.glb --loop --clip-name idle",
        "infer hello.wav --character rig.glb -o rig_talking.glb --mask upper",
        "infer speech.wav -o gesture.bvh --hand-height low --hand-speed 0.3 --activity 0.6",
        "infer speech.wav -o gesture.bvh --plan-out plan.json --energy calm",
        "infer speech.wav -o again.bvh --plan plan.json --intensity 1.3",
        "infer speech2.wav -o gesture.bvh --plan plan.json --retime --plan-out plan2.json",
        "infer speech.wav -o gesture.bvh --text speech.txt --cue bread=wave --hold-still 3.2-5.0",
        "infer recordings/ -o out/ --preview out/ --text texts/",
        "infer recordings/ -o out/ --manifest out/manifest.jsonl",
        "infer recordings/ -o out/ --shard 2/8",
        "infer recordings/ -o out/ --ray local:4",
        "infer - -o gesture.bvh < speech.wav",
    ))


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `python -m gesticulator.infer`."""
    return COMMAND.main(f"{PROGRAM} infer", argv)


if __name__ == "__main__":
    sys.exit(main())
