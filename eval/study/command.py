"""A user study: the page that raters see, and what their answers say (RG 7.3.3, Figure 12; RACER 5.4, Figure 4).

    gesticulator study make --systems ours=DIR truth=DIR other=DIR --out FOLDER [--clips 10 --seconds 30 --seed 0]
    gesticulator study analyse --key FOLDER/key.json ratings-*.json [--out study.json]

`make` takes folders that hold motion and its speech under the same names in each. It writes the page, one file that
works from a disk without a server (FOLDER/page/index.html), and FOLDER/key.json, which raters must not get. The page
draws the figure itself, the same body for every system at one frame rate, and its ids are opaque.

Theory: each rater sees every clip by every system, one clip's versions in a row. The order is a Williams design
(Williams 1949): over its rows each system comes in each place equally often, and after each other equally often, so
that neither fatigue nor what was seen just before favours any. What fools a study: the true recording among the systems
is the ceiling, and one with the motion of other speech the floor: without both, "3.8" says nothing. Who rates a figure
without face and fingers rates only what it shows.
"""

import argparse
import base64
import hashlib
import json
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import write_text
from data_module.speech.silence import FRAME, pauses, silent_frames
from data_module.types import Motion, Speech
from eval.clip.foreign import named, read_folder
from eval.study import anova
from eval.table import Provenance, publish
from gesticulator.cli import PROGRAM
from gesticulator.export import sound
from gesticulator.export.figure import figure_points

ASPECTS = {
    "human_likeness": "How human-like does the figure move? Please leave the speech aside for this question.",
    "content_match": "How well do the gestures match what is said?",
    "beat_match": "How well do the gestures match the rhythm of the speech?",
    "appropriateness": "How appropriate are the gestures for this speech, all in all?",
    "style": "How well do the gestures match the way the speaker speaks (calm, lively, ...)?",
}
"""Questions for raters. The first three are those of RG 7.3.3; RACER 5.4 calls the first one realism."""
DEFAULT_ASPECTS = ("human_likeness", "content_match", "beat_match")
ENOUGH_SPEECH = 0.6
"""Share of a clip that must lie outside pauses."""
_FADE = 0.03
"""Seconds of the fades at the ends of a clip's sound."""
_ALIKE = 0.05
"""Seconds by which the sounds of one recording may differ."""
FPS = 30
STEPS_PER_METRE = 8192
"""Places travel as int16: an eighth of a millimetre, up to 4 m away."""
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")


@dataclass(frozen=True)
class StudyTake:
    """One recording by every system: the speech and one motion per system."""

    name: str
    speech: Speech
    motions: tuple[Motion, ...]

    @property
    def seconds(self) -> float:
        """How much of it every system moves to; half a frame at the end is forgiven."""
        return min([self.speech.duration, *(motion.duration + 0.5 / motion.fps for motion in self.motions)])


@dataclass(frozen=True)
class StudyClip:
    """A stretch of a take: its start in seconds, and the share of it that is speech."""

    take: int
    start: float
    speech: float


# ---------------------------------------------------------------- the material

def read_takes(systems: Mapping[str, Path]) -> list[StudyTake]:
    """The recordings that every system has; InputError when there is none, or when the sound of one differs."""
    if len(systems) < 2:
        raise InputError("--systems", "needs two systems or more to compare", "write NAME=DIR for each")
    folders = [{name: (clip.motion, clip.speech) for name, clip in read_folder(folder)[0].items()
                if clip.speech is not None} for folder in systems.values()]
    takes = []
    # Only recordings of all systems: raters compare versions of one clip.
    for name in sorted(set.intersection(*map(set, folders))):
        motions, speeches = zip(*(folder[name] for folder in folders), strict=True)
        if any(abs(speech.duration - speeches[0].duration) > _ALIKE for speech in speeches):
            raise InputError(name, "has sounds of different lengths", "compare systems on the same speech")
        takes.append(StudyTake(name, speeches[0], motions))
    if not takes:
        raise InputError("--systems", "have no recording with sound in common",
                         "use the same file names in each folder")
    return takes


def choose_clips(takes: Sequence[StudyTake], count: int, seconds: float, seed: int) -> list[StudyClip]:
    """`count` stretches that do not overlap, spread over the takes, each with enough speech; InputError for fewer."""
    rng = np.random.default_rng(seed)
    offered: list[list[StudyClip]] = []
    for number, take in enumerate(takes):
        # A random shift, so that the seed chooses stretches and not only their order.
        slots = int((take.seconds + 1e-6) // seconds)
        shift = rng.uniform(0.0, max(take.seconds - slots * seconds, 0.0))
        loud = ~pauses(silent_frames(take.speech.samples, take.speech.sample_rate))
        clips = [StudyClip(number, round(start, 3), round(float(
            loud[round(start / FRAME):round((start + seconds) / FRAME)].mean()), 3))
            for start in (shift + seconds * np.arange(slots)).tolist()]
        clips = [clip for clip in clips if clip.speech >= ENOUGH_SPEECH]
        offered.append([clips[k] for k in rng.permutation(len(clips))])
    # One of each take before a second one of any.
    turns = [offered[k][turn] for turn in range(max(map(len, offered))) for k in rng.permutation(len(takes))
             if turn < len(offered[k])]
    if len(turns) < count:
        raise InputError("--clips", f"only {len(turns)} stretches of {seconds:g} s with enough speech, not {count}",
                         "ask for fewer or shorter ones, or give more recordings")
    return turns[:count]


# ---------------------------------------------------------------- the order

def williams(n: int) -> NDArray[np.int64]:
    """[n or 2 n, n] orders of n things: each comes in each place, and right after each other one, equally often."""
    first = np.array([k // 2 + 1 if k % 2 else -(k // 2) for k in range(n)]) % n
    # For odd n neighbours balance only together with the rows read backwards.
    rows = (first + np.arange(n)[:, None]) % n
    return rows if n % 2 == 0 else np.concatenate([rows, rows[:, ::-1]])


def orders(systems: int, clips: int, raters: int, seed: int) -> list[list[tuple[int, int]]]:
    """For each rater the (clip, system) pairs in the order to be shown, all of them once.

    Clips go by a Williams design over raters; within a clip, systems by one over raters and clips, so that a single
    rater's share is nearly balanced too. `seed` says which clip and which system is which number of the designs.
    """
    rng = np.random.default_rng(seed)
    clip_of, system_of = rng.permutation(clips), rng.permutation(systems)
    clip_rows, system_rows = williams(clips), williams(systems)
    # A clip starts at a row of its own, so that a rater's clips differ; shuffled, lest its place in time say which.
    turn = rng.permutation(clips)
    return [[(int(clip_of[c]), int(system_of[s])) for c in clip_rows[rater % len(clip_rows)]
             for s in system_rows[(rater + turn[c]) % len(system_rows)]] for rater in range(raters)]


# ---------------------------------------------------------------- the page

def make(systems: Mapping[str, Path], out: Path, options: argparse.Namespace) -> Path:
    """Write `out`/page/index.html and `out`/key.json; returns the page. The same input gives the same page and key.

    options: those of the command. Rater raters + 1 gets the order of rater 1.
    """
    if min(options.raters, options.clips) < 1 or not (np.isfinite(options.seconds) and options.seconds >= 1):
        raise InputError("--raters, --clips, --seconds", "are too few", "ask for 1 rater and one clip of 1 s at least")
    clips, seconds, seed = options.clips, float(options.seconds), options.seed
    takes, aspects = read_takes(systems), list(dict.fromkeys(options.aspects))
    chosen = choose_clips(takes, clips, seconds, seed)
    # Ids are hashes of the whole sources, which no rater has: knowing the seed and the names would not undo them.
    source = _digest(takes, seed)
    ids = {(c, k): _opaque(source, f"item {c} {k}") for c in range(clips) for k in range(len(systems))}
    study = _opaque(source, f"study {clips} {seconds:g} {aspects}")
    key = {"study": study, "seed": seed, "seconds": seconds, "scale": anova.SCALE, "aspects": aspects,
           "systems": list(systems),
           "clips": [{"recording": takes[clip.take].name, "start": clip.start, "speech": clip.speech}
                     for clip in chosen],
           "items": {name: {"clip": c, "system": list(systems)[k]} for (c, k), name in ids.items()}}
    # Sorted by hash: neither items nor sounds lie in the page in the order of systems and clips.
    items = sorted(ids, key=lambda pair: ids[pair])
    sounds = sorted(range(clips), key=lambda c: _opaque(source, f"sound {c}"))
    times = np.arange(round(FPS * seconds) + 1) / FPS
    shown = {(c, k): figure_points(motion, np.minimum(chosen[c].start + times, (len(motion) - 1) / motion.fps))
             for c, k in items for motion in [takes[chosen[c].take].motions[k]]}
    stretches = [_stretch(takes[chosen[c].take].speech, chosen[c].start, seconds) for c in sounds]
    data = {"study": study, "fps": FPS, "seconds": seconds, "scale": anova.SCALE,
            "questions": [[name, ASPECTS[name]] for name in aspects],
            "stepsPerMetre": STEPS_PER_METRE, "points": list(shown[items[0]]), "soundType": sound.MEDIA_TYPE,
            "sounds": [base64.b64encode(sound.compress(stretch)).decode() for stretch in stretches],
            "items": [{"id": ids[c, k], "sound": sounds.index(c), "motion": encoded_points(shown[c, k])}
                      for c, k in items],
            "orders": [[items.index(pair) for pair in row]
                       for row in orders(len(systems), clips, options.raters, seed)]}
    (out / "page").mkdir(parents=True, exist_ok=True)
    write_text(out / "key.json", json.dumps(key, indent=1) + "\n")
    write_text(out / "page" / "index.html", page_of(data))
    return out / "page" / "index.html"


def encoded_points(points: dict[str, NDArray[np.float64]]) -> str:
    """Places [T, 3] of points, metres, as the page reads them: int16 in base64, frame by frame."""
    # Integers of an eighth of a millimetre: half the size of floats, and finer than a pixel.
    steps = np.round(np.stack(list(points.values()), axis=1) * STEPS_PER_METRE)
    return base64.b64encode(np.clip(steps, -32768, 32767).astype("<i2").tobytes()).decode()


def page_of(data: dict[str, Any]) -> str:
    """The page with its data and the program that draws the figure."""
    text_of_data = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("</", "<\\u002f")
    text, figure = ((resources.files("eval") / "assets" / name).read_text(encoding="utf-8")
                    for name in ("study.html", "figure.js"))
    parts = {"data": text_of_data, "study": data["study"], "figure": figure}
    return _SLOT.sub(lambda match: parts[match.group(1)], text)


def _opaque(source: str, what: str) -> str:
    return hashlib.sha256(f"{source} {what}".encode()).hexdigest()[:10]


def _digest(takes: Sequence[StudyTake], seed: int) -> str:
    # Names are not enough: the same files with other content must not keep their ids.
    digest = hashlib.sha256(str(seed).encode())
    for take in takes:
        digest.update(take.name.encode() + take.speech.samples.tobytes())
        for motion in take.motions:
            digest.update(motion.rotations.tobytes() + motion.root_positions.tobytes())
    return digest.hexdigest()


def _stretch(speech: Speech, start: float, seconds: float) -> Speech:
    """The sound of a stretch, its ends faded so that a cut word does not click."""
    first = round(start * speech.sample_rate)
    samples = speech.samples[first:first + round(seconds * speech.sample_rate)].copy()
    ramp = np.linspace(0.0, 1.0, round(_FADE * speech.sample_rate), dtype=np.float32)
    # A cut in the middle of a word clicks, and a click would be rated.
    samples[:len(ramp)] *= ramp
    samples[len(samples) - len(ramp):] *= ramp[::-1]
    return Speech(samples, speech.sample_rate)


# ---------------------------------------------------------------- the command

def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator study make` and `analyse`."""
    commands = parser.add_subparsers(dest="command", required=True)
    m = commands.add_parser("make", help="make the page for raters, and the key that they must not see")
    m.add_argument("--systems", nargs="+", required=True, metavar="NAME=DIR",
                   help="folder with the motion and audio of each system")
    m.add_argument("--out", type=Path, required=True, metavar="FOLDER",
                   help="output folder for page/index.html and key.json")
    m.add_argument("--clips", type=int, default=10, metavar="N", help="number of clips (default 10)")
    m.add_argument("--seconds", type=float, default=30.0, metavar="S", help="duration of a clip, seconds (default 30)")
    m.add_argument("--seed", type=int, default=0, metavar="K",
                   help="seed of the choice and order of the clips (default 0)")
    m.add_argument("--raters", type=int, default=30, metavar="N", help="number of different orders (default 30)")
    m.add_argument("--aspects", nargs="+", choices=ASPECTS, default=list(DEFAULT_ASPECTS),
                   help="the question to the raters")
    a = commands.add_parser("analyse", help="compute means, intervals, ANOVA, Tukey HSD and ranks")
    a.add_argument("--key", type=Path, required=True, metavar="FILE.json")
    a.add_argument("ratings", nargs="+", type=Path, metavar="RATINGS.json", help="the raters' answers")
    a.add_argument("--out", metavar="FILE.json", help="output file; a .md is written beside it")


def run(arguments: argparse.Namespace) -> int:
    """Make the page, or analyse what was saved; InputError for input that cannot be used."""
    if arguments.command == "analyse":
        key = anova.read_key(arguments.key)
        publish(anova.tables(anova.read_ratings(arguments.ratings, key)), arguments.out,
                Provenance.now(shlex.join([PROGRAM, *sys.argv[1:]])))
        return 0
    systems = {name: Path(folder) for name, folder in named(arguments.systems, "--systems").items()}
    page = make(systems, arguments.out, arguments)
    print(f"{page} is for the raters (1 to {arguments.raters}: page?rater=7 fills in the number); "
          f"keep {arguments.out / 'key.json'} to yourself")
    return 0
