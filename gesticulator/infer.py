"""`gesticulator infer`: from recordings to motion files, the main command. A `Worker` processes one recording: it
reads, generates, lays out as a clip or on a character, and writes.

Everything that can be checked before the work is checked first (`gesticulator.jobs.jobs_of`). An error of the
command is an `InputError`; an error of one recording is stored in its `Job`, so that the others are still processed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from data_module.errors import EXIT_BAD_INPUT, InputError, complain, one_line, printable
from data_module.files import opened
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings, status
from gesticulator.jobs import CharacterRequest, Job, RunSettings, infer_arguments, jobs_of, run_settings_of

if TYPE_CHECKING:
    from data_module.types import Speech
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.performance import Performance

EXIT_PART_FAILED = 1
LOW_LEVEL = -45.0
"""Level of speech, dBFS, below which a recording is about 20 dB too low and quiet syllables get lost."""


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
    begin, shown, done = time.perf_counter(), len(jobs) == 1 and not settings.quiet, 0
    if len(jobs) == 1:
        check_job(jobs[0])  # before the models are loaded
    if shown:
        status(f"{jobs[0].name}: loading the models")
    worker = replace(_worker(jobs, settings), begin=begin if shown else None)
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
            status("")
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
        batch.check_ray(settings.ray)
        processing = partial(batch.done_on_ray, settings.ray, make)
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


def check_job(job: Job) -> None:
    """`InputError` if the recording cannot be processed, as far as can be known without reading it."""
    if job.fault is not None:
        raise job.fault
    if job.source is not None:
        opened(job.source).close()
    elif sys.stdin is None or sys.stdin.isatty():
        raise InputError("standard input", "holds no recording", f"pipe one into {PROGRAM}, or name a file")


def retargeter_for(character: CharacterRequest | None, quiet: bool = False) -> Retargeter | None:
    """The retargeter for the requested character; None for the default skeleton. quiet: print no remarks about it.

    The mapping is saved before it is checked, so that an unusable one can be corrected.
    """
    if character is None:
        return None
    from gesticulator.characters.reading import choose
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.characters.rig import note_of

    # An unclear rig is an error here, before any sound is read.
    rig, mapping = choose(character.file, character.mapping, character.save_mapping)
    retargeter = Retargeter(rig, mapping, contacts=character.contacts, legs=character.legs)
    note = note_of(rig, mapping.joints["Hips"])
    remarks = [note] if note else []
    remarks += [f"{doubt}; look at the result" for doubt in retargeter.doubts]
    for remark in () if quiet else remarks:
        complain(f"{PROGRAM}: {character.file}: {remark}")
    return retargeter


@dataclass(frozen=True)
class Worker:
    """What the jobs of a command are processed with. retargeter: None for the default skeleton; begin: of a command
    that shows what it does with one recording, by `time.perf_counter`."""

    gesticulator: Gesticulator
    retargeter: Retargeter | None = None
    begin: float | None = None

    def perform(self, job: Job) -> tuple[float, str]:
        """Process one recording: read it, generate its gestures and write the files. Returns seconds of sound, and the
        summary for the user."""
        check_job(job)
        speech = load(job)
        # Without reading: the factor compares computing with the duration.
        begin = time.perf_counter()
        # What somebody looks at should look back: a page has a face, other files have one that was asked for.
        bare = job.options.face == "off" and any(target.suffix.lower() == ".html" for target in job.targets)
        shown = replace(job, options=replace(job.options, face="full")) if bare else job
        performance = self._laid_out(job, self.performed(shown, speech))
        timing = f"{speech.duration / (time.perf_counter() - begin):.1f} times as fast as real time"
        # Files appear whole, so what is there after an error can be used.
        written = [(performance if target.suffix.lower() == ".html" or not bare else replace(performance, face=None))
                   .save(target) for target in job.targets]
        pages = [f"open {page} in a browser to watch it" for page in written if page.suffix.lower() == ".html"]
        if self.begin is not None:
            timing += f" ({time.perf_counter() - self.begin:.1f} s in all, {begin - self.begin:.1f} s of it to start)"
        lexemes = performance.lexemes.tolist()
        line = (f"{job.name}: {speech.duration:.1f} s, {len(lexemes) - 1} beats, {len(set(lexemes))} of "
                f"{len(self.gesticulator.bundle.vectors)} lexemes, {timing} -> "
                f"{printable(', '.join(map(str, written)))}")
        return speech.duration, "\n  ".join([line, *performance.decided.notes, *pages])

    def performed(self, job: Job, speech: Speech) -> Performance:
        """The performance of a recording, on the default skeleton; with legs, too, where the character stands."""
        # Legs cost time, so they are generated only where something shows them.
        stands = self.retargeter is not None and self.retargeter.mapping.legs and self.retargeter.legs
        options: dict[str, Any] = {**vars(job.options), "legs": job.options.legs or stands}
        if self.begin is not None:
            doing = f"{job.name}: {speech.duration:.1f} s of sound, generating gestures"
            # A plan may turn out to be of another sound: then a log has the error alone.
            status(doing, logged=job.options.plan is None)
            self.gesticulator.on_block = lambda done, total: status(f"{doing}, block {done} of {total}")
        performance = self.gesticulator(speech, text=job.text, **options)
        return performance.labelled(job.name, performance.decided.notes)

    def _laid_out(self, job: Job, performance: Performance) -> Performance:
        """The performance as the clip of the job, on the character."""
        if job.clip is not None:
            performance = performance.as_clip(job.clip)
        return performance if self.retargeter is None else performance.moved_by(self.retargeter)


def load(job: Job) -> Speech:
    """The recording; warns if it is too quiet even after the requested gain, and if it holds music."""
    from data_module.speech.audio import amplified, load_speech

    speech = load_speech(job.source or sys.stdin.buffer)
    for note in filter(None, (level_note(amplified(speech, job.options.gain)), music_note(speech))):
        complain(f"{PROGRAM}: warning: {job.name}: {note}")
    return speech


def level_note(speech: Speech) -> str | None:
    """A note for the user on a recording whose level is far too low, with the gain to apply; None for others."""
    from data_module.speech.silence import FAINTEST_SPEECH, MARGIN, TYPICAL_LEVEL, frame_levels, loudness

    frames = loudness(frame_levels(speech.samples, speech.sample_rate))
    if (loudest := float(frames.levels.max())) <= FAINTEST_SPEECH:
        return f"all of it is silence (its loudest 10 ms are at {loudest:.0f} dBFS); record it again"
    loud = frames.levels[frames.levels > (frames.floor + MARGIN).clip(FAINTEST_SPEECH)]
    level = float(loud.mean()) if len(loud) else loudest
    gain = round(TYPICAL_LEVEL - level)
    return None if level >= LOW_LEVEL else \
        f"its speech is at {level:.0f} dBFS, nearly silent; amplify it by {gain} dB (--gain {gain})"


def music_note(speech: Speech) -> str | None:
    """A note for the user on a recording that holds music or steady tones, by half a minute from its middle; None for
    others. Neither drums, noise nor a song without instruments is recognised."""
    import numpy as np

    from data_module.speech.audio import SAMPLE_RATE, resample

    half, middle = round(15.0 * speech.sample_rate), len(speech.samples) // 2
    samples = resample(replace(speech, samples=speech.samples[max(0, middle - half):middle + half], words=()),
                       SAMPLE_RATE).samples
    if len(samples) < SAMPLE_RATE:
        return None
    # Partials of speech glide: in 358 readings, a peak of the spectrum (470 to 3100 Hz, 10 dB above the median) that
    # keeps to 8 Hz for .3 s is found in at most 2.3 % of the time; in chords, bells and songs with a band, in 90 %.
    frames = np.lib.stride_tricks.sliding_window_view(samples, 2048)[::512] * np.hanning(2048).astype(np.float32)
    levels = 20.0 * np.log10(np.abs(np.fft.rfft(frames)[:, 58:402]) + 1e-9)
    inner = levels[:, 2:-2]
    peaks = inner == np.lib.stride_tricks.sliding_window_view(levels, 5, axis=1).max(axis=-1)
    peaks &= inner > np.maximum(np.median(inner, axis=1, keepdims=True) + 10.0, loud := inner.max() - 40.0)
    steady = np.any(np.lib.stride_tricks.sliding_window_view(peaks, 10, axis=0).all(axis=-1), axis=1)
    share = steady.sum() / (inner.max(axis=1) > loud).sum()
    return None if share < 0.1 else f"{share:.0%} of it has steady tones, as music has; gestures follow speech alone"


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
