"""`gesticulator infer`: from recordings to motion files, the main command.

Everything that can be checked before the work is checked first (`gesticulator.batch.jobs`). An error of the command is
an `InputError`; an error of one recording is stored in its `Job`, so that the others are still processed. Modules are
imported only when needed, after the command line has been parsed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from data_module.errors import EXIT_BAD_INPUT, InputError, complain, one_line
from gesticulator.arguments import (
    check_choices,
    check_cues,
    controls_from_args,
    performance_arguments,
    plan_from_args,
    print_list,
)
from gesticulator.batch.jobs import (
    Job,
    check_job,
    clip_is_asked,
    is_folder,
    perform,
    plan,
    prepare_blender,
    retargeter_for,
)
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings
from gesticulator.export.writers import ELSEWHERE, UNITS, WRITERS, check_output, suffix_of

EXIT_PART_FAILED = 1
_OUTPUTS = {"preview": ".html", "plan_out": ".json"}
"""Argument for an output file of one format -> its suffix; --output takes every format."""
FORMAT = "bvh"
"""The format written to a folder if --format is not given."""


def arguments(p: argparse.ArgumentParser) -> None:
    p.usage = f"{p.prog} SPEECH [SPEECH ...] -o FILE [options]"
    p.add_argument("speech", nargs="*", metavar="SPEECH",
                   help="audio files (WAV, FLAC, OGG, MP3; M4A, MP4, WebM and other video with PyAV; 0.3 s to one "
                   "hour), folders of them, patterns such as '*.wav', or - for standard input")
    out = p.add_argument_group(
        "output (at least one is required)", "A path that ends in / or is a folder receives one file per recording, "
        "named\nafter it; any other path is the file itself. Missing folders are created.")
    out.add_argument("-o", "--output", metavar="FILE", action="append", help="motion, in the format given by the "
                     "suffix: " + ", ".join(sorted(set(WRITERS) - {".html", ".json"})) + "; can be repeated")
    out.add_argument("--format", metavar="SUFFIX", help=f"format of -o if it is a folder (default {FORMAT})")
    out.add_argument("--unit", choices=tuple(UNITS), default="cm", help="unit of length in .bvh files (default cm)")
    out.add_argument("--preview", metavar="FILE.html", help="a page that plays the motion in a browser")
    out.add_argument("--plan-out", "--explain", metavar="FILE.json",
                     help="the gesture plan: every decision, to read, edit and render again with --plan")
    out.add_argument("--retime-report", metavar="FILE.json", help="with --retime: what was kept, moved, decided anew "
                     "and lost")
    _clip_arguments(p)
    many = p.add_argument_group("many recordings", "A manifest records what was done; a second run processes only "
                                                   "what is missing or changed.")
    many.add_argument("--manifest", metavar="FILE",
                      help="the manifest (.parquet or .jsonl); default with --shard and --ray: manifest.parquet in "
                      "the folder of -o")
    many.add_argument("--shard", metavar="I/N",
                      help="process shard I of N, of equal duration; gesticulator manifest joins their manifests")
    many.add_argument("--ray", metavar="WHERE",
                      help="process on a Ray cluster: auto, its address, or local:N for N workers on this machine")
    performance_arguments(p)


def _clip_arguments(p: argparse.ArgumentParser) -> None:
    clip = p.add_argument_group("clips for animation tools", "See docs/clips.md.")
    clip.add_argument("--clip-name", metavar="NAME", help="name of the animation in the file (default gesture)")
    clip.add_argument("--keys", metavar="DEGREES", type=_keys, help="leave out keys that interpolation restores within "
                      "so many degrees in .glb, .vrma and .fbx, or all to write every frame (default 0.1)")
    clip.add_argument("--loop", action="store_true", help="the end passes into the beginning without a seam")
    clip.add_argument("--mask", choices=("upper",), help="upper: animate the upper body alone; hips and legs have no "
                      "tracks")
    clip.add_argument("--layer", choices=("additive",), help="additive: the upper body relative to its resting pose, "
                      "to be added to an idle clip of the file")
    clip.add_argument("--root", choices=("hips", "none"), default="hips", help="none: the hips stay in place (default "
                      "hips: they travel a few centimetres as the weight shifts)")
    clip.add_argument("--sound", action="store_true", help="write the speech as WAV beside the motion")
    clip.add_argument("--one-file", action="store_true", help="write several recordings as clips of one .glb file, "
                      "named after them")


def _keys(text: str) -> float:
    from gesticulator.export.clip import parse_keys

    return parse_keys(text)


def _upper(args: argparse.Namespace) -> bool:
    """Whether only the upper body is written."""
    return args.mask is not None or args.layer is not None


def run(args: argparse.Namespace) -> int:
    """Process all recordings; exit code 0, 1 if some failed, 2 if none succeeded."""
    jobs = [] if args.list else _plan(args)
    check_choices(args)
    if not args.list and (args.manifest or args.shard or args.ray):
        return _run_batch(jobs, args)
    prepare_blender(jobs, args)
    retargeter = None if args.list else retargeter_for(args, _upper(args))
    alone = len(jobs) == 1
    done = 0
    with our_warnings():
        ready = [job for job in jobs if _succeeded(partial(check_job, job, args), alone)]
        if ready or args.list:
            with limited_threads(int(args.threads)):
                from gesticulator.pipeline import Gesticulator

                system = Gesticulator.from_pretrained(args.bundle)
                if args.list:
                    print_list(system, args.list)
                    return 0
                check_cues(system, args)
                controls = controls_from_args(system, args)
                if args.one_file:
                    from gesticulator.batch.clips import perform_together

                    perform_together(jobs, system, args, controls, retargeter)
                    return 0
                done = sum(_succeeded(partial(perform, job, system, args, controls, retargeter), alone)
                           for job in ready)
    return 0 if alone else _conclude(len(jobs), done, args.quiet)


def _run_batch(jobs: list[Job], args: argparse.Namespace) -> int:
    """Process recordings that are not done yet and record them in a manifest; the exit code of `run`."""
    from gesticulator.batch.infer_batch import run_jobs

    with our_warnings():
        total, done = run_jobs(jobs, args, partial(_worker, jobs, args))
    return 0 if done == total else EXIT_PART_FAILED if done else EXIT_BAD_INPUT


def _worker(jobs: Sequence[Job], args: argparse.Namespace) -> Callable[[int], float]:
    """Load the models; returns a function that processes a job by its number and returns its duration in seconds."""
    from gesticulator.pipeline import Gesticulator

    prepare_blender(jobs, args)
    retargeter = retargeter_for(args, _upper(args))
    with limited_threads(int(args.threads)):
        system = Gesticulator.from_pretrained(args.bundle)
    check_cues(system, args)
    controls = controls_from_args(system, args)
    silent = argparse.Namespace(**{**vars(args), "quiet": True})

    def do(number: int) -> float:
        check_job(jobs[number], args)
        with limited_threads(int(args.threads)):
            return perform(jobs[number], system, silent, controls, retargeter)

    return do


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


def _plan(args: argparse.Namespace) -> list[Job]:
    if not args.speech:
        raise InputError("speech", "is missing", f"name a sound file; see {PROGRAM} infer --help")
    outputs = _output_files(args)
    if clip_is_asked(args):
        from gesticulator.batch.clip_options import check_clip_outputs

        check_clip_outputs(args, list(outputs))
    jobs = plan(args.speech, outputs, args.text, together=args.one_file)
    if args.retime_report is not None:
        if not args.retime:
            raise InputError("--retime-report", "is for --retime alone", "add --retime, or leave it out")
        check_output(args.retime_report)
    faces = [target for job in jobs for target in job.targets if suffix_of(target).startswith(".face.")]
    if faces and args.face == "off":
        raise InputError(faces[0], "needs a face", "add --face lips or --face full")
    if args.plan is not None:
        if len(jobs) > 1:
            raise InputError("--plan", f"is for one recording, and {len(jobs)} are given", "give one")
        if args.text is not None and not args.retime:
            raise InputError("--text", "is already in the plan", "leave it out")
        plan_from_args(args)  # report errors in the plan before any work
    return jobs


def _output_files(args: argparse.Namespace) -> dict[str, str]:
    """Suffix -> the file or folder to write to. `InputError` if it cannot be written or a format is given twice."""
    given = [(_suffix_of(name, args.format), name) for name in args.output or ()]
    given += [(suffix, getattr(args, name)) for name, suffix in _OUTPUTS.items() if getattr(args, name) is not None]
    outputs: dict[str, str] = {}
    for suffix, name in given:
        if suffix in outputs:
            raise InputError(name, f"is a second {suffix} beside {outputs[suffix]}", "name one of them")
        check_output(Path(name) / f"gesture{suffix}" if is_folder(name) else name)
        outputs[suffix] = name
    if args.unit != "cm" and ".bvh" not in outputs:
        raise InputError("--unit", "is only for .bvh", "leave it out: other formats have their own")
    return outputs


def _suffix_of(name: str, chosen: str | None) -> str:
    """The suffix of an output; chosen: the value of --format."""
    if is_folder(name):
        suffix = "." + (chosen or FORMAT).lower().lstrip(".")
        # A format of two parts may be named by its first: g1 for .g1.csv.
        longer = (known for known in (*WRITERS, *ELSEWHERE) if known.startswith(f"{suffix}."))
        return suffix if suffix in WRITERS else next(longer, suffix)
    if chosen is not None:
        raise InputError("--format", f"is for folders, and {name} is a file", "leave it out")
    return suffix_of(name) or f".{FORMAT}"


def _conclude(count: int, done: int, quiet: bool) -> int:
    """Print how many of `count` recordings were done; the exit code."""
    if done < count:
        complain(f"{PROGRAM}: {done} of {count} recordings done, {count - done} failed")
        return EXIT_PART_FAILED if done else EXIT_BAD_INPUT
    if not quiet:
        print(f"{count} recordings done", flush=True)
    return 0


COMMAND = Command(
    "generate gestures for recordings of speech", arguments, run,
    examples=(
        "infer speech.wav -o gesture.bvh --preview gesture.html",
        "infer speech.wav -o gesture.bvh --text speech.txt",
        "infer speech.wav -o gesture.bvh --transcribe tiny.en",
        "infer speech.wav -o gesture.glb -o gesture.vrma -o gesture.mp4",
        "infer recordings/ -o out/ --format fbx",
        "infer speech.wav --character rig.glb -o talk.glb",
        "infer silence.wav --character rig.glb -o idle.glb --loop --clip-name idle",
        "infer hello.wav bye.wav --character rig.glb -o rig_talking.glb --one-file --mask upper",
        "infer speech.wav -o gesture.bvh --hand-height low --hand-speed 0.3 --activity 0.6",
        "infer speech.wav -o gesture.bvh --plan-out plan.json --energy calm",
        "infer speech.wav -o again.bvh --plan plan.json --intensity 1.3",
        "infer speech2.wav -o gesture.bvh --plan plan.json --retime --plan-out plan2.json",
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
