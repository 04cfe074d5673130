"""A user study: the page that raters see, and what their answers say (RG 7.3.3, Figure 12; RACER 5.4, Figure 4).

    gesticulator study make --systems ours=DIR truth=DIR other=DIR --out FOLDER [--clips 10 --seconds 30 --seed 0]
                              [--videos mp4]
    gesticulator study analyse --key FOLDER/key.json ratings-*.json [--out study.json]

`make` takes folders that hold motion (BVH) and its speech under the same names in each. It writes the page, one file
that works from a disk without a server (FOLDER/page/index.html), and FOLDER/key.json, which raters must not get. The
page draws the figure itself, the same body for every system at one frame rate, and its ids are opaque. With `--videos`
each item is a file beside the page instead, of the same figure: all equally long, and equally large.

Theory: each rater sees every clip by every system, one clip's versions in a row. The order is a Williams design
(Williams 1949): over its rows each system comes in each place equally often, and after each other equally often, so
that neither fatigue nor what was seen just before favours any. What fools a study: the true recording among the systems
is the ceiling, and one with the motion of other speech the floor: without both, "3.8" says nothing. Who rates a figure
without face and fingers rates only what it shows.
"""

from __future__ import annotations

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
from data_module.files import write_bytes, write_text
from data_module.motion.bvh import read_bvh
from data_module.speech.audio import load_speech
from data_module.speech.silence import FRAME, pauses, silent_frames
from data_module.types import Motion, Speech
from eval.clip.foreign import find_sound, named
from eval.study import anova
from eval.table import Provenance, publish
from gesticulator.cli import PROGRAM
from gesticulator.export import film, sound
from gesticulator.export.figure import figure_points
from gesticulator.export.writers import check_output

ASPECTS = {
    "human_likeness": "How human-like does the figure move? Please leave the speech aside for this question.",
    "content_match": "How well do the gestures match what is said?",
    "beat_match": "How well do the gestures match the rhythm of the speech?",
    "appropriateness": "How appropriate are the gestures for this speech, all in all?",
    "style": "How well do the gestures match the way the speaker speaks (calm, lively, ...)?",
}
"""Questions for raters. The first three are those of RG 7.3.3; RACER 5.4 calls the first one realism."""
DEFAULT_ASPECTS = ("human_likeness", "content_match", "beat_match")
SCALE = (1, 5)
"""1 is worst, 3 average, 5 best (RG 7.3.3)."""
ENOUGH_SPEECH = 0.6
"""Share of a clip that must lie outside pauses."""
_FADE = 0.03
"""Seconds of the fades at the ends of a clip's sound."""
_ALIKE = 0.9
"""Correlation from which two sound files are of one recording."""
FPS = 30
STEPS_PER_METRE = 8192
"""Places travel as int16: an eighth of a millimetre, up to 4 m away."""
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")


@dataclass(frozen=True)
class StudyTake:
    """One recording by every system: the speech and one motion per system, `seconds` of which all of them cover."""

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


@dataclass(frozen=True)
class StudyOptions:
    """clips: stretches, `seconds` long each. seed: which, and the order. raters: how many orders the page holds; rater
    raters + 1 gets that of rater 1. videos: "mp4" for a video of each item beside the page."""

    clips: int = 10
    seconds: float = 30.0
    seed: int = 0
    raters: int = 30
    aspects: Sequence[str] = DEFAULT_ASPECTS
    videos: str | None = None

    def __post_init__(self) -> None:
        if self.raters < 1:
            raise InputError("--raters", f"must be 1 or more, not {self.raters}")
        if self.clips < 1 or not (np.isfinite(self.seconds) and self.seconds >= 1):
            raise InputError("--clips, --seconds", f"cannot be {self.clips} and {self.seconds:g}",
                             "ask for one clip of 1 s at least")


# ---------------------------------------------------------------- the material

def parse_systems(entries: Sequence[str]) -> dict[str, Path]:
    """NAME=DIR as a mapping, in the given order; InputError for what is not two or more different names."""
    systems = {name: Path(folder) for name, folder in named(entries, "--systems").items()}
    for name, folder in systems.items():
        if not folder.is_dir():
            raise InputError(folder, "is not a folder", f"name the folder of {name}'s motion and sound")
    if len(systems) < 2:
        raise InputError("--systems", "needs two systems or more to compare", "write NAME=DIR for each")
    return systems


def read_takes(systems: Mapping[str, Path]) -> list[StudyTake]:
    """The recordings that every system has; InputError when there is none, or when the sound of one differs."""
    folders = []
    for folder in systems.values():
        folders.append({file.stem: (file, sound_file) for file in sorted(folder.iterdir())
                        if file.suffix.lower() == ".bvh" and (sound_file := find_sound(folder, file.stem))})
        if not folders[-1]:
            raise InputError(folder, "has no BVH file with a sound file of the same name", "put both there")
    # Only recordings of all systems: raters compare versions of one clip.
    common = sorted(set.intersection(*map(set, folders)))
    if not common:
        raise InputError("--systems", "have no recording in common", "use the same file names in each folder")
    takes = []
    for stem in common:
        (_, first), *others = files = [pairs[stem] for pairs in folders]
        speech = load_speech(first)
        for _, other in others:
            if not _same_sound(speech, load_speech(other)):
                raise InputError(other, f"is not the sound of {first}", "compare systems on the same speech")
        takes.append(StudyTake(stem, speech, tuple(read_bvh(motion) for motion, _ in files)))
    return takes


def _same_sound(a: Speech, b: Speech) -> bool:
    """True if both are one recording, whatever the files' formats; an end cut by less than a frame of video counts."""
    if abs(a.duration - b.duration) > 0.05:
        return False
    size = min(len(a.samples), len(b.samples))
    x, y = a.samples[:size].astype(np.float64), b.samples[:size].astype(np.float64)
    # By correlation: the same recording at another level or from a lossy file counts as one.
    return float(x @ y) >= _ALIKE * float(np.sqrt((x @ x) * (y @ y)))


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

def make(systems: dict[str, Path], out: Path, options: StudyOptions) -> Path:
    """Write `out`/page/index.html and `out`/key.json; returns the page. The same input gives the same page and key."""
    clips, seconds, seed, videos = options.clips, options.seconds, options.seed, options.videos
    if videos is not None:
        # What cannot be written is said before minutes of drawing.
        check_output(out / f"item.{videos}")
    takes, aspects = read_takes(systems), list(options.aspects)
    chosen = choose_clips(takes, clips, seconds, seed)
    # Ids are hashes of the whole sources, which no rater has: knowing the seed and the names would not undo them.
    source = _digest(takes, seed)
    ids = {(c, k): _opaque(source, f"item {c} {k}") for c in range(clips) for k in range(len(systems))}
    study = _opaque(source, f"study {clips} {seconds:g} {aspects}")
    key = {"study": study, "seed": seed, "seconds": float(seconds), "scale": SCALE, "aspects": aspects,
           "systems": list(systems),
           "clips": [{"recording": takes[clip.take].name, "start": clip.start, "speech": clip.speech}
                     for clip in chosen],
           "items": {name: {"clip": c, "system": list(systems)[k]} for (c, k), name in ids.items()}}
    # Sorted by hash: neither items nor sounds lie in the page in the order of systems and clips.
    items = sorted(ids, key=lambda pair: ids[pair])
    sounds = sorted(range(clips), key=lambda c: _opaque(source, f"sound {c}"))
    shown = {(c, k): _places(takes[chosen[c].take].motions[k], chosen[c].start, seconds) for c, k in items}
    stretches = {c: _stretch(takes[chosen[c].take].speech, chosen[c].start, seconds) for c in sounds}
    data = {"study": study, "fps": FPS, "seconds": float(seconds), "scale": SCALE,
            "questions": [[name, ASPECTS[name]] for name in aspects]}
    if videos is None:
        data |= {"stepsPerMetre": STEPS_PER_METRE, "points": list(shown[items[0]]), "soundType": sound.MEDIA_TYPE,
                 "sounds": [base64.b64encode(sound.compress(stretches[c])).decode() for c in sounds],
                 "items": [{"id": ids[c, k], "sound": sounds.index(c), "motion": encoded_points(shown[c, k])}
                           for c, k in items]}
    else:
        data |= {"videos": videos, "items": [{"id": ids[pair]} for pair in items]}
    data["orders"] = [[items.index(pair) for pair in row] for row in orders(len(systems), clips, options.raters, seed)]
    (out / "page").mkdir(parents=True, exist_ok=True)
    write_text(out / "key.json", json.dumps(key, indent=1) + "\n")
    if videos is not None:
        _film({ids[c, k]: (shown[c, k], stretches[c]) for c, k in items}, out / "page")
    # Videos lie beside the page, on a disk or a server; without them nothing but the page itself is ever read.
    write_text(out / "page" / "index.html", page_of(data, "blob:" if videos is None else "'self' file:"))
    return out / "page" / "index.html"


def encoded_points(points: dict[str, NDArray[np.float64]]) -> str:
    """Places [T, 3] of points, metres, as the page reads them: int16 in base64, frame by frame."""
    # Integers of an eighth of a millimetre: half the size of floats, and finer than a pixel.
    steps = np.round(np.stack(list(points.values()), axis=1) * STEPS_PER_METRE)
    return base64.b64encode(np.clip(steps, -32768, 32767).astype("<i2").tobytes()).decode()


def page_of(data: dict[str, Any], media: str) -> str:
    """The page with its data, the program that draws the figure, and where its media may come from."""
    text_of_data = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("</", "<\\u002f")
    text, figure = ((resources.files("eval") / "assets" / name).read_text(encoding="utf-8")
                    for name in ("study.html", "figure.js"))
    parts = {"data": text_of_data, "study": data["study"], "media": media, "figure": figure}
    return _SLOT.sub(lambda match: parts[match.group(1)], text)


def _film(items: dict[str, tuple[dict[str, NDArray[np.float64]], Speech]], folder: Path) -> None:
    """Each item as `folder`/ID.mp4, written in the order of their ids."""
    for name, (shown, speech) in items.items():
        # The page's last place is the end of its last frame; a video's last frame begins one before.
        points = {joint: places[:-1] for joint, places in shown.items()}
        write_bytes(folder / f"{name}.mp4", film.encode(points, speech))


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


def _places(motion: Motion, start: float, seconds: float) -> dict[str, NDArray[np.float64]]:
    """Where the figure's points are, [FPS * seconds + 1, 3] metres each: one body, standing, facing the viewer."""
    return figure_points(motion, np.minimum(start + np.arange(round(FPS * seconds) + 1) / FPS,
                                            (len(motion) - 1) / motion.fps))


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
                   help="folder with the motion (BVH) and audio of each system")
    m.add_argument("--out", type=Path, required=True, metavar="FOLDER",
                   help="output folder for page/index.html and key.json")
    m.add_argument("--clips", type=int, default=10, metavar="N", help="number of clips (default 10)")
    m.add_argument("--seconds", type=float, default=30.0, metavar="S", help="duration of a clip, seconds (default 30)")
    m.add_argument("--seed", type=int, default=0, metavar="K",
                   help="seed of the choice and order of the clips (default 0)")
    m.add_argument("--raters", type=int, default=30, metavar="N", help="number of different orders (default 30)")
    m.add_argument("--aspects", nargs="+", choices=ASPECTS, default=list(DEFAULT_ASPECTS),
                   help="the question to the raters")
    m.add_argument("--videos", choices=("mp4",),
                   help="write each item as a video beside the page, instead of drawing it on the page")
    a = commands.add_parser("analyse", help="compute means, intervals, ANOVA, Tukey HSD and ranks")
    a.add_argument("--key", type=Path, required=True, metavar="FILE.json")
    a.add_argument("ratings", nargs="+", type=Path, metavar="RATINGS", help="the raters' answers, .json or .csv")
    a.add_argument("--without", nargs="+", default=[], metavar="RATER", help="exclude these raters")
    a.add_argument("--seed", type=int, default=0, help="seed of the bootstrap (default 0)")
    a.add_argument("--out", metavar="FILE.json", help="output file; a .md is written beside it")


def run(arguments: argparse.Namespace) -> int:
    """Make the page, or analyse what was saved; InputError for input that cannot be used."""
    if arguments.command == "analyse":
        key = anova.read_key(arguments.key)
        ratings = anova.gather(anova.read_answers(arguments.ratings, key), key, without=arguments.without)
        publish(anova.tables(ratings, arguments.seed), arguments.out,
                Provenance.now(shlex.join([PROGRAM, *sys.argv[1:]])))
        return 0
    page = make(parse_systems(arguments.systems), arguments.out, StudyOptions(
        arguments.clips, arguments.seconds, arguments.seed, arguments.raters, list(dict.fromkeys(arguments.aspects)),
        arguments.videos))
    print(f"{page} is for the raters (1 to {arguments.raters}: page?rater=7 fills in the number); "
          f"keep {arguments.out / 'key.json'} to yourself")
    return 0
