"""`python -m gesticulator.infer speech.flac -o gesture.bvh --preview gesture.html`: the main job.

Only what is needed is imported, and only after the command line is understood.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import warnings
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError, one_line_errors
from gesticulator import __version__
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from data_module.controls import Controls
    from gesticulator.pipeline import Gesticulator

PROGRAM = "gesticulator"
TRANSCRIPTS = (".TextGrid", ".json", ".srt", ".vtt", ".txt")
_CONTROLS = (("height", "height of the right hand over the hips", "METRES"),
             ("speed", "mean speed of the hands", "METRES/S"),
             ("radius", "mean distance of the hands from the body's axis", "METRES"))


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(PROGRAM, description="Speech in, gesture out: upper-body motion for a recorded voice.")
    p.add_argument("speech", nargs="+", help="sound files (WAV, FLAC, OGG, MP3; 0.3 s to one hour)")
    p.add_argument("-o", "--output", required=True, metavar="FILE",
                   help="the motion to write (.bvh); a folder when there are several recordings")
    p.add_argument("--preview", metavar="FILE.html",
                   help="also write a page that shows it; a folder when there are several recordings")
    p.add_argument("--explain", metavar="FILE.json",
                   help="also write the blocks and their lexemes; a folder when there are several recordings")
    p.add_argument("--text", metavar="FILE",
                   help="what is said: plain text, TextGrid, SRT, VTT or JSON with word times; a folder of files named "
                        "like the recordings when there are several. Without it the voice alone is heard")
    p.add_argument("--speaker", help="whose habits of moving (a performer of the bundle, not a voice)")
    p.add_argument("--interpreter", choices=INTERPRETERS,
                   help="what chooses the lexemes: the LSTM of Rhythmic Gesticulator, RACER's Q-network (cql), or a "
                        "speaker's frequencies alone (default: lstm where the bundle has it)")
    p.add_argument("--seed", type=int, default=0, help="the same seed gives the same bytes (default 0)")
    p.add_argument("--temperature", type=float,
                   help="how freely lexemes are drawn; 0 always takes the likeliest (default: the bundle's)")
    for flag, what, unit in _CONTROLS:
        p.add_argument(f"--hand-{flag}", metavar=f"low|mid|high|{unit}|FILE.csv",
                       help=f"{what}: a level, a number, or a curve over time (CSV with columns time,value)")
    p.add_argument("--activity", type=float, metavar="0..1",
                   help="how readily to gesture at all; 0 is stillness, 1 never holds back (default: the bundle's)")
    p.add_argument("--fps", type=float, help="frames per second of the motion (default 60)")
    p.add_argument("--bundle", metavar="DIR", help="a trained bundle (default: the one that is shipped)")
    p.add_argument("--threads", type=int, default=1, help="threads of torch (default 1, which is fastest here)")
    p.add_argument("--quiet", action="store_true", help="no progress bar and no summary")
    p.add_argument("--version", action="version", version=f"gesticulator {__version__}")
    return p


def _place(given: str | None, source: Path, many: bool, suffix: str) -> Path | None:
    if given is None:
        return None
    return Path(given) / f"{source.stem}{suffix}" if many else Path(given)


def _transcript(given: str | None, source: Path, many: bool) -> Path | None:
    if given is None:
        return None
    place = Path(given)
    if not place.exists():
        raise InputError(place, "does not exist", "check --text")
    if not place.is_dir():
        if many:
            raise InputError(place, "is one transcript for several recordings",
                             "name a folder of transcripts named like the recordings")
        return place
    found = next((place / f"{source.stem}{suffix}" for suffix in TRANSCRIPTS
                  if (place / f"{source.stem}{suffix}").is_file()), None)
    if found is None:
        raise InputError(place, f"holds no transcript of {source.name}",
                         f"name it {source.stem}{' or '.join(TRANSCRIPTS)}, or leave --text out")
    return found


class Job:
    """One recording and what is to be written for it."""

    def __init__(self, source: Path, arguments: argparse.Namespace, many: bool) -> None:
        self.source = source
        self.motion = _place(arguments.output, source, many, ".bvh")
        self.preview = _place(arguments.preview, source, many, ".html")
        self.explain = _place(arguments.explain, source, many, ".json")
        self.text = _transcript(arguments.text, source, len(arguments.speech) > 1)

    @property
    def targets(self) -> list[Path]:
        """All files it writes."""
        return [path for path in (self.motion, self.preview, self.explain) if path is not None]


def plan(arguments: argparse.Namespace) -> list[Job]:
    """What to do, with everything checked that can be checked before the work: names, suffixes, folders, rights."""
    sources = [Path(name) for name in arguments.speech]
    many = len(sources) > 1 or Path(arguments.output).is_dir()
    jobs = [Job(source, arguments, many) for source in sources]
    seen: dict[Path, Path] = {}
    for job in jobs:
        for target, suffix in ((job.motion, ".bvh"), (job.preview, ".html"), (job.explain, ".json")):
            if target is None:
                continue
            if target.suffix.lower() != suffix:
                raise InputError(target, f"does not end in {suffix}", f"name it {target.stem or 'gesture'}{suffix}")
            if target in seen:
                raise InputError(job.source, f"would be written to {target} like {seen[target]}", "rename one of them")
            seen[target] = job.source
            if target.resolve() == job.source.resolve():
                raise InputError(target, "is the recording itself", "choose another output")
            _check_place(target, many)
    return jobs


def _check_place(target: Path, many: bool) -> None:
    folder = target.parent
    if many and not folder.exists():
        folder.mkdir(parents=True)
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "make it first, or choose another output")
    if target.is_dir():
        raise InputError(target, "is a folder", "choose another output")
    if not os.access(folder, os.W_OK) or (target.exists() and not os.access(target, os.W_OK)):
        raise InputError(target, "cannot be written", "choose another output or change its rights")


def asked_controls(system: Gesticulator, arguments: argparse.Namespace) -> Controls | None:
    """What the command asks of the style; None when it asks nothing."""
    from data_module.controls import controls_from

    height, speed, radius = (getattr(arguments, f"hand_{name}") for name, _, _ in _CONTROLS)
    if height is None and speed is None and radius is None:
        return None
    if system.bundle.levels is None:
        raise InputError("--hand-height, --hand-speed, --hand-radius", "are not heard by this bundle",
                         "use a bundle trained with style editing, or leave them out")
    return controls_from(height, speed, radius, system.bundle.levels)


def perform(job: Job, system: Gesticulator, arguments: argparse.Namespace, controls: Controls | None = None) -> str:
    """Do one recording; the summary."""
    from tqdm import tqdm

    from data_module.speech.audio import load_speech
    from gesticulator.export import write

    speech = load_speech(job.source)
    begin = time.perf_counter()
    with closing(tqdm(desc=job.source.name, unit=" blocks", leave=False,
                      disable=arguments.quiet or not sys.stderr.isatty())) as bar:
        def on_block(done: int, total: int) -> None:
            bar.total = total
            bar.update()

        made = system(speech, text=job.text, speaker=arguments.speaker, seed=arguments.seed, fps=arguments.fps,
                      interpreter=arguments.interpreter, temperature=arguments.temperature, controls=controls,
                      activity=arguments.activity, on_block=on_block)
    spent = time.perf_counter() - begin
    written = [str(write(target, made)) for target in job.targets]
    return (f"{job.source.name}: {speech.duration:.1f} s, {len(made.blocks) - 1} beats, "
            f"{len(set(made.lexemes.tolist()))} of {len(system.bundle.lexicon.vectors)} lexemes, "
            f"real-time factor {spent / speech.duration:.3f} -> {', '.join(written)}"
            + "".join(f"\n  {note}" for note in made.notes))


def _say_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"{PROGRAM}: warning: {message}", file=sys.stderr)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit code 0, or 2 with one line for bad input."""
    arguments = parser().parse_args(argv)
    with one_line_errors(PROGRAM), warnings.catch_warnings():
        jobs = plan(arguments)
        # Only our own warnings concern the user; those of libraries do not.
        warnings.simplefilter("ignore")
        for name in ("data_module", "gesticulator"):
            warnings.filterwarnings("default", module=name)
        warnings.showwarning = _say_warning
        from data_module.speech.audio import check_file

        for job in jobs:
            check_file(job.source)
        import torch

        from gesticulator.pipeline import Gesticulator

        torch.set_num_threads(max(1, arguments.threads))
        system = Gesticulator.from_pretrained(arguments.bundle)
        system.speaker_index(arguments.speaker)
        controls = asked_controls(system, arguments)
        for job in jobs:
            summary = perform(job, system, arguments, controls)
            if not arguments.quiet:
                print(summary)
    return 0


if __name__ == "__main__":
    sys.exit(main())
