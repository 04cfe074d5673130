"""`gesticulator infer speech.wav -o gesture.bvh --preview gesture.html`: the main job, as a command.

Everything that can be checked before the work is (`gesticulator.batch.jobs`). A fault of the command is an
`InputError`; a fault of one recording is kept in its `Job`, so that the others are still done. Only what is
needed is imported, and only after the command line is understood.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import EXIT_BAD_INPUT, InputError, complain, one_line
from gesticulator import __version__
from gesticulator.batch.jobs import Job, is_folder, plan
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings
from gesticulator.performance import ENERGIES, FPS, HANDS, RANGES, UNITS, WRITERS, check_output, suffix_of
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from data_module.controls import Controls
    from data_module.speech.audio import SpeechPieces
    from data_module.types import Speech
    from gesticulator.characters.retarget import Retargeter
    from gesticulator.performance import InferenceArguments, Performance
    from gesticulator.pipeline import Gesticulator
    from gesticulator.plan.plan import GestureCue, GesturePlan

EXIT_PART_FAILED = 1
_OUTPUTS = {"preview": ".html", "plan_out": ".json"}
"""Argument that names a file of one kind to write -> its suffix; --output takes every kind."""
STREAMED = (".bvh", ".glb")
"""Endings of what can be written in pieces (`gesticulator.batch.long`), in bounded memory."""
_LONG = 300.0
"""Seconds from which on a recording is done in pieces; below, all of it takes less memory than the models do."""
FORMAT = "bvh"
"""What is written to a folder that --output names, when not told."""
_SHORT = {".g1": ".g1.csv"}
"""What --format may be called, too."""


def number(name: str) -> Callable[[str], float]:
    """Reads the argument --NAME, in its range of `gesticulator.performance.RANGES`."""
    return lambda text: RANGES[name].parse(f"--{name}", text)


def _seconds(text: str) -> tuple[float, float]:
    """A range of seconds such as 3.2-5.0."""
    begin, mark, stop = text.partition("-")
    try:
        first, last = float(begin), float(stop)
    except ValueError:
        mark, first, last = "", 0.0, 0.0
    if not mark or not 0 <= first < last < float("inf"):
        raise InputError(f"--hold-still {text[:40]}", "is no range of seconds", "write it as 3.2-5.0")
    return first, last


def _cue(text: str) -> GestureCue:
    """A cue such as hello=wave, hello:2=wave or 2.5=shrug."""
    from gesticulator.plan.plan import GestureCue

    at, mark, gesture = text.rpartition("=")
    if not mark or not at or not gesture:
        raise InputError(f"--cue {text[:40]}", "is no cue", "write WORD=GESTURE (hello=wave) or SECONDS=GESTURE")
    try:
        return GestureCue(gesture, time=float(at))
    except ValueError:
        word, _, count = at.rpartition(":")
    if word and count.isdecimal() and int(count):
        return GestureCue(gesture, word, int(count))
    return GestureCue(gesture, at)


def arguments(p: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    p.usage = f"{p.prog} SPEECH [SPEECH ...] -o FILE [options]"
    p.add_argument("speech", nargs="*", metavar="SPEECH", help="sound files (WAV, FLAC, OGG, MP3; M4A, MP4, "
                   "WebM and other video with PyAV; 0.3 s to one hour), folders of them, patterns such as '*.wav', or "
                   "- for standard input")
    out = p.add_argument_group("what is written (one of them at least)", "A path that ends in / or is a folder takes a "
                               "file for each recording, by its\nname; anything else is the file itself. Missing "
                               "folders are made.")
    out.add_argument("-o", "--output", metavar="FILE", action="append", help="the motion, in the format of its suffix: "
                     + ", ".join(sorted(set(WRITERS) - {".html", ".json"})) + "; may be given several times")
    out.add_argument("--format", metavar="SUFFIX", help=f"what -o writes where it is a folder (default {FORMAT})")
    out.add_argument("--unit", choices=tuple(UNITS), default="cm", help="unit of length of a .bvh (default cm)")
    out.add_argument("--preview", metavar="FILE.html", help="a page that plays it in a browser")
    out.add_argument("--plan-out", "--explain", metavar="FILE.json", help="the gesture plan: what was decided, "
                     "to read, to edit and to render again with --plan")
    many = p.add_argument_group("many recordings", "What is done is noted in a manifest; a second run does "
                                "only what is missing or changed.")
    many.add_argument("--manifest", metavar="FILE", help="note it here (.parquet or .jsonl); the default with --shard "
                      "and --ray is manifest.parquet in the folder of -o")
    many.add_argument("--shard", metavar="I/N", help="do the share I of N, equal by seconds of sound; "
                      "gesticulator manifest joins their manifests")
    many.add_argument("--ray", metavar="WHERE", help="do them on a Ray cluster: auto, its address, or local:N for N "
                      "workers here")
    performance_arguments(p)


def performance_arguments(p: argparse.ArgumentParser) -> None:
    """Add what tells how a recording is performed, whatever is made of it."""
    heard = p.add_argument_group("what is heard")
    heard.add_argument("--text", metavar="FILE", help="what is said: plain text, TextGrid, SRT, VTT or JSON with word "
                       "times; or a folder of files named like the recordings")
    heard.add_argument("--gain", type=number("gain"), default=0.0, metavar="DB",
                       help="amplify the recording first, in decibels (default 0)")
    heard.add_argument("--any-length", action="store_true", help="take recordings of more than an hour, too")
    style = p.add_argument_group("how it moves", "VALUE is low, mid or high, a number, or a CSV file with the columns "
                                 "time and value.")
    style.add_argument("--speaker", metavar="NAME", help="whose habits of moving (see --list speakers)")
    style.add_argument("--hand-height", metavar="VALUE", help="height of the right hand over the hips, metres")
    style.add_argument("--hand-speed", metavar="VALUE", help="mean speed of the hands, metres per second")
    style.add_argument("--hand-radius", metavar="VALUE", help="mean distance of the hands from the body's axis, metres")
    style.add_argument("--activity", type=number("activity"), metavar="0..1",
                       help="how much of the time of speech to gesture in; 0 is stillness, 1 never holds back")
    style.add_argument("--interpreter", choices=INTERPRETERS, help="what chooses the lexemes: " + ", ".join(
        f"{name} ({entry.about})" for name, entry in INTERPRETERS.items()))
    style.add_argument("--temperature", type=number("temperature"), metavar="T",
                       help="how freely lexemes are sampled; 0 always takes the likeliest")
    style.add_argument("--beta", type=number("beta"), metavar="B",
                       help="with --interpreter advantage: how far lexemes are drawn to what a learned reward says "
                       "they are worth; 0 gives exactly those of lstm")
    style.add_argument("--seed", type=number("seed"), default=0, metavar="N",
                       help="the same seed gives the same bytes (default 0)")
    style.add_argument("--variation", type=number("variation"), default=0, metavar="N",
                       help="the same beats and lexemes, drawn in another manner (default 0)")
    style.add_argument("--legs", action="store_true",
                       help="let her stand on legs (54 joints): she shifts her weight, her feet stay planted")
    style.add_argument("--seated", action="store_true", help="let her sit on a chair, legs and hips still (54 joints)")
    style.add_argument("--intensity", type=number("intensity"), default=1.0, metavar="0..2",
                       help="how large gestures are; at 0 the hands hang (default 1)")
    style.add_argument("--energy", choices=tuple(ENERGIES), default="neutral",
                       help="on top of them: calm is .6 of intensity and activity, lively 1.5 of intensity")
    style.add_argument("--handedness", choices=HANDS, help="the hand that is preferred, or both of them, "
                       "each taking part in the strokes of the other")
    style.add_argument("--mirror", action="store_true", help="exchange left and right")
    style.add_argument("--hold-still", type=_seconds, action="append", default=[], metavar="FROM-TO",
                       help="seconds in which the hands rest, such as 3.2-5.0; may be given several times")
    style.add_argument("--cue", type=_cue, action="append", default=[], metavar="WORD=GESTURE",
                       help="a gesture at a word, or at a time: hello=wave, hello:2=wave at the second, 2.5=shrug "
                       "(gesticulator plan names lists them)")
    style.add_argument("--plan", metavar="FILE", help="render a gesture plan (.json, .bml): what was drawn is "
                       "replayed, what was edited is drawn anew; --seed does not matter")
    style.add_argument("--fps", type=number("fps"), default=FPS, metavar="N",
                       help=f"frames per second of the motion (default {FPS:g})")
    body = p.add_argument_group("whose body", "A character of yours, from Mixamo, VRM, Unreal, Blender or elsewhere; "
                                "see gesticulator character --help.")
    body.add_argument("--character", metavar="FILE", help="move this character: .bvh, .glb, .gltf, .vrm, or .fbx where "
                      "Blender is installed; she stands on her legs, unless she sits in the file or --seated leaves "
                      "them and her hips alone")
    body.add_argument("--mapping", metavar="FILE.json", help="which of her nodes is which joint, where they are not "
                      "found by themselves")
    body.add_argument("--save-mapping", metavar="FILE.json", help="write what was found, to look at or to correct")
    body.add_argument("--no-contacts", action="store_true", help="copy directions only: hands may enter a wide trunk")
    p.add_argument("--bundle", metavar="DIR", help="a trained bundle (default: the one that is shipped)")
    p.add_argument("--list", choices=("speakers", "interpreters"), help="list what the bundle has, and do nothing else")
    p.add_argument("--threads", type=number("threads"), default=1, metavar="N",
                   help="threads; bytes are the same for the same number (default 1, which is fastest for most)")
    p.add_argument("--quiet", action="store_true", help="no progress bar and no summary")
    p.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")


def run(asked: argparse.Namespace) -> int:
    """Do every recording; exit code 0, 1 where a part of them failed, 2 where none could be done."""
    jobs = [] if asked.list else _plan(asked)
    if not asked.list and (asked.manifest or asked.shard or asked.ray):
        return _run_batch(jobs, asked)
    retargeter = None if asked.list else _retargeter(asked)
    alone = len(jobs) == 1
    done = 0
    with our_warnings():
        ready = [job for job in jobs if _went_well(partial(_check, job, asked), alone)]
        if ready or asked.list:
            with limited_threads(int(asked.threads)):
                from gesticulator.pipeline import Gesticulator

                system = Gesticulator.from_pretrained(asked.bundle)
                if asked.list:
                    return _list(system, asked.list)
                system.speaker_index(asked.speaker)
                controls = asked_controls(system, asked)
                done = sum(_went_well(partial(perform, job, system, asked, controls, retargeter), alone)
                           for job in ready)
    return 0 if alone else _conclude(len(jobs), done, asked.quiet)


def _run_batch(jobs: list[Job], asked: argparse.Namespace) -> int:
    """Do every recording that is not done yet, and note it in a manifest; the exit code of `run`."""
    from gesticulator.batch.infer_batch import run_jobs

    with our_warnings():
        total, done = run_jobs(jobs, asked, partial(_worker, jobs, asked))
    return 0 if done == total else EXIT_PART_FAILED if done else EXIT_BAD_INPUT


def _worker(jobs: Sequence[Job], asked: argparse.Namespace) -> Callable[[int], float]:
    """Loads what jobs need, and gives what does the job of a number and tells its seconds of sound."""
    from gesticulator.pipeline import Gesticulator

    retargeter = _retargeter(asked)
    with limited_threads(int(asked.threads)):
        system = Gesticulator.from_pretrained(asked.bundle)
    system.speaker_index(asked.speaker)
    controls = asked_controls(system, asked)
    silent = argparse.Namespace(**{**vars(asked), "quiet": True})

    def do(number: int) -> float:
        _check(jobs[number], asked)
        with limited_threads(int(asked.threads)):
            return perform(jobs[number], system, silent, controls, retargeter)

    return do


def _went_well(step: Callable[[], object], alone: bool) -> bool:
    """Whether a step did its work. A fault of one recording among several is told; that of the only one is raised."""
    try:
        step()
    except BrokenPipeError:  # whoever read the summaries has gone: no recording's fault
        raise
    except (InputError, OSError) as error:
        if alone:
            raise
        complain(f"{PROGRAM}: {one_line(error)}")
        return False
    return True


def _plan(asked: argparse.Namespace) -> list[Job]:
    if not asked.speech:
        raise InputError("speech", "is missing", f"name a sound file; see {PROGRAM} infer --help")
    jobs = plan(asked.speech, _asked_outputs(asked), asked.text)
    if asked.plan is not None:
        if len(jobs) > 1:
            raise InputError("--plan", f"is of one recording, and {len(jobs)} are given", "give the one")
        if asked.text is not None:
            raise InputError("--text", "stands in the plan already", "leave it out")
        _asked_plan(asked)  # what is wrong with it is found before the work
    return jobs


def _asked_outputs(asked: argparse.Namespace) -> dict[str, str]:
    """Suffix -> the file or folder to write to. `InputError` for what cannot be written here, or twice."""
    given = [(_suffix_of(name, asked.format), name) for name in asked.output or ()]
    given += [(suffix, getattr(asked, name)) for name, suffix in _OUTPUTS.items() if getattr(asked, name) is not None]
    outputs: dict[str, str] = {}
    for suffix, name in given:
        if suffix in outputs:
            raise InputError(name, f"is a second {suffix} beside {outputs[suffix]}", "name one of them")
        check_output(Path(name) / f"gesture{suffix}" if is_folder(name) else name)
        outputs[suffix] = name
    if asked.unit != "cm" and ".bvh" not in outputs:
        raise InputError("--unit", "is for .bvh", "leave it out: other formats have their own")
    return outputs


def _suffix_of(name: str, told: str | None) -> str:
    """The kind of file that an output is."""
    if is_folder(name):
        asked = "." + (told or FORMAT).lower().lstrip(".")
        return _SHORT.get(asked, asked)
    if told is not None:
        raise InputError("--format", f"is for folders, and {name} is a file", "leave it out")
    return suffix_of(name) or f".{FORMAT}"


def _check(job: Job, asked: argparse.Namespace) -> None:
    """`InputError` where the recording cannot be done, as far as is known without reading it."""
    from data_module.speech.audio import check_file

    if job.fault is not None:
        raise job.fault
    if job.source is not None:
        check_file(job.source, asked.any_length)
    elif sys.stdin is None or sys.stdin.isatty():
        raise InputError("standard input", "is closed" if sys.stdin is None else "is a terminal",
                         f"pipe a recording into {PROGRAM}, or name a file")


def asked_controls(system: Gesticulator, asked: argparse.Namespace) -> Controls | None:
    """What the command asks of the style; None when it asks nothing."""
    from data_module.controls import controls_from

    asked_for = asked.hand_height, asked.hand_speed, asked.hand_radius
    if asked_for == (None, None, None):
        return None
    if system.bundle.levels is None:
        raise InputError("--hand-height, --hand-speed, --hand-radius", "are not heard by this bundle",
                         "use a bundle trained with style editing, or leave them out")
    return controls_from(*asked_for, system.bundle.levels)


def _retargeter(asked: argparse.Namespace) -> Retargeter | None:
    """What brings motions onto the character that is asked for; None for our own skeleton.

    The mapping is saved before it is judged: what cannot be used as it is can then be corrected.
    """
    if asked.character is None:
        for name in ("mapping", "save_mapping"):
            if getattr(asked, name) is not None:
                raise InputError(f"--{name.replace('_', '-')}", "is about a character", "name one with --character")
        return None
    from gesticulator.characters.choice import choose
    from gesticulator.characters.retarget import Retargeter

    character, mapping = choose(asked.character, asked.mapping, asked.save_mapping)
    legs = False if asked.seated else True if asked.legs else None
    made = Retargeter(character, mapping, contacts=not asked.no_contacts, legs=legs)
    if legs is None and not made.legs and not asked.quiet:
        complain(f"{PROGRAM}: {asked.character}: sits, so hips and legs stay as they are; --legs lets her stand")
    return made


def perform(job: Job, system: Gesticulator, asked: argparse.Namespace, controls: Controls | None = None,
            retargeter: Retargeter | None = None) -> float:
    """Do one recording and print its summary; its seconds."""
    with _opened(job, asked) as sound:
        if not 0 < sound.seconds < _LONG and _in_pieces(job, asked, system):
            return _perform_long(job, sound, system, asked, controls)
        speech = _heard(job, asked, sound)
    begin = time.perf_counter()
    stands = retargeter is not None and retargeter.mapping.legs and retargeter.legs
    made = replace(performed(job, speech, system, asked, controls, asked.legs or stands), sound_name=job.name)
    if retargeter is not None:
        made = replace(made, character=retargeter(made.motion))
    spent = time.perf_counter() - begin
    written = [made.save(target, unit=asked.unit if target.suffix.lower() == ".bvh" else "cm")
               for target in job.targets]
    _say_done(job, asked, _Done(speech.duration, made.lexemes.tolist(), len(system.bundle.vectors),
                                spent / speech.duration), written, made.notes)
    return speech.duration


@dataclass(frozen=True)
class _Done:
    """What a summary tells: seconds of sound, the lexemes played, how many there are, and seconds per second."""

    seconds: float
    lexemes: Sequence[int]
    lexicon: int
    factor: float


def _say_done(job: Job, asked: argparse.Namespace, done: _Done, written: Sequence[Path], notes: Sequence[str] = ()
              ) -> None:
    if not asked.quiet:
        print(f"{job.name}: {done.seconds:.1f} s, {len(done.lexemes) - 1} beats, "
              f"{len(set(done.lexemes))} of {done.lexicon} lexemes, "
              f"real-time factor {done.factor:.3f} -> {', '.join(map(str, written))}"
              + "".join(f"\n  {note}" for note in notes), flush=True)


def _in_pieces(job: Job, asked: argparse.Namespace, system: Gesticulator) -> bool:
    """Whether so little is asked that a recording may be done in pieces: no character, words or plan, which need the
    whole, and files that can be written so."""
    from gesticulator.batch.long import can_be_done

    whole = asked.character, asked.plan, asked.text, asked.cue or None
    return (whole == (None,) * len(whole) and all(target.suffix.lower() in STREAMED for target in job.targets)
            and can_be_done(system.bundle))


def _perform_long(job: Job, sound: SpeechPieces, system: Gesticulator, asked: argparse.Namespace,
                  controls: Controls | None) -> float:
    """Do a recording of some minutes or more in pieces, in bounded memory; its seconds."""
    from tqdm import tqdm

    from gesticulator.batch.long import perform_long

    begin = time.perf_counter()
    with closing(tqdm(desc=job.name, unit=" s", leave=False, total=round(sound.seconds) or None,
                      disable=asked.quiet or not sys.stderr.isatty())) as bar:
        def on_sound(seconds: float) -> None:
            bar.update(round(seconds) - bar.n)

        made = perform_long(system, sound, job.targets, asked_options(asked, controls, asked.legs), asked.unit,
                            on_sound)
    if made.note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {made.note}")
    spent = time.perf_counter() - begin
    _say_done(job, asked, _Done(made.seconds, made.lexemes, len(system.bundle.vectors), spent / made.seconds),
              job.targets)
    return made.seconds


def _opened(job: Job, asked: argparse.Namespace) -> AbstractContextManager[SpeechPieces]:
    """The recording, to be read."""
    from data_module.speech.audio import speech_pieces

    return speech_pieces(job.source or sys.stdin.buffer, asked.any_length)


def load(job: Job, asked: argparse.Namespace) -> Speech:
    """The recording as it is; a warning where little of it will be heard, even amplified as was asked."""
    with _opened(job, asked) as sound:
        return _heard(job, asked, sound)


def _heard(job: Job, asked: argparse.Namespace, sound: SpeechPieces) -> Speech:
    from data_module.speech.audio import amplified, level_note

    speech = sound.whole()
    note = level_note(amplified(speech, asked.gain))
    if note is not None:
        complain(f"{PROGRAM}: warning: {job.name}: {note}")
    return speech


def performed(job: Job, speech: Speech, system: Gesticulator, asked: argparse.Namespace, controls: Controls | None,
              legs: bool) -> Performance:
    """What the command asks of a recording, with a bar on the terminal while it is drawn."""
    from tqdm import tqdm

    with closing(tqdm(desc=job.name, unit=" blocks", leave=False,
                      disable=asked.quiet or not sys.stderr.isatty())) as bar:
        def on_block(done: int, total: int) -> None:
            bar.total = total
            bar.update()

        return system(speech, text=job.text, on_block=on_block, **asked_options(asked, controls, legs))


def asked_options(asked: argparse.Namespace, controls: Controls | None, legs: bool) -> InferenceArguments:
    """What the command asks of a performance."""
    return {"speaker": asked.speaker, "interpreter": asked.interpreter, "seed": int(asked.seed),
            "variation": int(asked.variation), "temperature": asked.temperature, "beta": asked.beta,
            "activity": asked.activity, "fps": asked.fps, "gain": asked.gain, "controls": controls,
            "intensity": asked.intensity, "mirror": asked.mirror, "energy": asked.energy,
            "handedness": asked.handedness, "hold_still": tuple(asked.hold_still), "cues": tuple(asked.cue),
            "plan": _asked_plan(asked), "legs": legs, "seated": asked.seated}


def _asked_plan(asked: argparse.Namespace) -> GesturePlan | None:
    """The plan to render, if any."""
    if asked.plan is None:
        return None
    from gesticulator.plan.bml import read_any_plan

    return read_any_plan(asked.plan)


def _list(system: Gesticulator, what: str) -> int:
    """Print the names, the one that is taken when none is told first marked."""
    names = system.speakers if what == "speakers" else system.interpreters
    default = system.speakers[system.speaker_index(None)] if what == "speakers" else names[0]
    for name in names:
        print(f"{name}  (default)" if name == default else name)
    return 0


def _conclude(count: int, done: int, quiet: bool) -> int:
    """Sum up a batch of `count` recordings of which `done` were done; the exit code."""
    if done < count:
        complain(f"{PROGRAM}: {done} of {count} recordings done, {count - done} failed")
        return EXIT_PART_FAILED if done else EXIT_BAD_INPUT
    if not quiet:
        print(f"{count} recordings done", flush=True)
    return 0


COMMAND = Command(
    "speech in, gesture out: upper-body motion for recorded voices", arguments, run,
    examples=(
        "infer speech.wav -o gesture.bvh --preview gesture.html",
        "infer speech.wav -o gesture.bvh --text speech.txt",
        "infer speech.wav -o gesture.glb -o gesture.vrma -o gesture.mp4",
        "infer recordings/ -o out/ --format fbx",
        "infer speech.wav --character rig.glb -o talk.glb",
        "infer speech.wav -o gesture.bvh --hand-height low --hand-speed 0.3 --activity 0.6",
        "infer speech.wav -o gesture.bvh --plan-out plan.json --energy calm",
        "infer speech.wav -o again.bvh --plan plan.json --intensity 1.3",
        "infer speech.wav -o gesture.bvh --text speech.txt --cue bread=wave --hold-still 3.2-5.0",
        "infer recordings/ -o out/ --preview out/ --text texts/",
        "infer recordings/ -o out/ --manifest out/manifest.parquet",
        "infer recordings/ -o out/ --shard 2/8",
        "infer recordings/ -o out/ --ray local:4",
        "infer - -o gesture.bvh < speech.wav",
        "infer --list speakers",
    ))


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `python -m gesticulator.infer`."""
    return COMMAND.main(f"{PROGRAM} infer", argv)


if __name__ == "__main__":
    sys.exit(main())
