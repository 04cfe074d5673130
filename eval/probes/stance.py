"""Do legs stand, and like those of people? Sliding feet, knees, weight shifts and stillness of a motion with legs.

    gesticulator probe stance [--speech FILE ...] [--pause 30] [--renderings 4] [--system NAME=DIR] [--people DIR]
        [--out FILE.json]

Ours is rendered here (`infer --legs`) for the sounds that are named, and for a pause of so many seconds, in which
nothing is said. Others bring BVH files with legs, Y up: every one of the folder DIR counts.

The second table compares with people (`eval.clip.standing`), beside three controls made of ours in speech, each of
which must leave the bands: stilts (straight legs under hips that do not move), a statue (hips and legs held still under
a moving trunk), and hips and feet that are pushed about together. `--people` measures the bands anew on a folder of
motion files whose manifest.csv names file, person and kind.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import ConvexHull, QhullError

from data_module.errors import InputError
from data_module.files import read_table
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import read_bvh
from data_module.motion.skeletons import LEG_JOINTS, WHOLE_BODY, find_table
from data_module.speech.audio import SAMPLE_RATE, load_speech
from data_module.types import Array, Motion, Speech
from eval.clip.foreign import find_motions, named
from eval.clip.standing import FIGURES, PEOPLE, StandingSpan, bands, figures, knee_bend, outside, spans_of
from eval.stats import runs
from eval.table import Cell, Column, Marked, Table
from gesticulator.pipeline import Gesticulator

PLANTED = 0.003
"""Metres over its lowest place (the 1st percentile) up to which a foot's ankle and ball count as planted."""
SHIFTED, SLOW = 0.015, 0.4
"""Metres off the middle that the hips must go to either side for a weight shift, and seconds of its smoothing."""
SLIDES = 5.0
"""Millimetres from which a planted foot is seen to slide: a step begins with less."""
STILL = 0.001
"""m/s of the hips below which a body looks frozen."""
_HEEL, _TOES, _HALF = 0.055, 0.070, 0.045
"""Metres of the sole behind the ankle, ahead of the ball, and to either side."""
_EVERY = 0.1
"""Seconds between the frames whose support is looked at."""
_FAINT = 1e-4
"""Loudness of the noise of a pause: a room's, of which full scale is 1."""
_PUSH, _PUSHED = 0.02, 5.0
"""Metres by which the control's feet slide to either side, and seconds of one to and fro."""
_KINDS = ("fidget", "gesture", "idle", "listen", "talk")
"""Kinds of a manifest in which people stand as speakers do."""

COLUMNS = {
    "seconds": Column("length", "s", 0), "slide": Column("slide of planted feet", "mm", 1, "low"),
    "outside": Column("hips outside their support", "%", 1, "low"), "steps": Column("steps", "a minute", 1),
    "shifts": Column("weight shifts", "a minute", 1), "travel": Column("hips' travel to the sides, sd", "cm", 1),
    "knee": Column("knee: least, median, 95 %", "degrees"), "speed": Column("hips' speed: median, most", "cm/s"),
    "frozen": Column("longest without movement", "s", 2, "low"),
}


def measured(motions: Iterable[Motion]) -> dict[str, float | str]:
    """The figures of motions with legs, together: the worst of what should be low, rates and medians over all."""
    of = [_Standing(motion) for motion in motions]
    minutes = sum(one.seconds for one in of) / 60.0
    knees = np.concatenate([one.knees.ravel() for one in of])
    speed = np.concatenate([one.speed for one in of])
    return {
        "seconds": minutes * 60.0, "slide": 1000.0 * max(one.slide() for one in of),
        "outside": 100.0 * float(np.mean(np.concatenate([one.outside() for one in of]))),
        "steps": sum(one.steps() for one in of) / minutes, "shifts": sum(one.shifts() for one in of) / minutes,
        "travel": 100.0 * float(np.mean([one.across.std() for one in of])),
        "knee": ", ".join(f"{value:.0f}" for value in (knees.min(), np.median(knees), np.percentile(knees, 95))),
        "speed": ", ".join(f"{100.0 * value:.1f}" for value in (np.median(speed), speed.max())),
        "frozen": max(one.frozen() for one in of)}


class _Standing:
    """A motion with legs, by the places of its own joints; Y is up."""

    def __init__(self, motion: Motion) -> None:
        positions = kinematics.positions_of(motion)
        places = {name: positions[:, joint] for name, joint in find_table(motion.skeleton.names).items()}
        self.fps, self.seconds, self.hips = motion.fps, motion.duration, places["Hips"]
        self.feet = [(places[side + "Foot"], places[side + "ToeBase"]) for side in ("Left", "Right")]
        self.planted = [np.logical_and(*(part[:, 1] < np.percentile(part[:, 1], 1) + PLANTED for part in foot))
                        for foot in self.feet]
        self.knees = np.stack([knee_bend(*(places[side + part] for part in ("UpLeg", "Leg", "Foot")))
                               for side in ("Left", "Right")])
        ankles = self.feet[0][0], self.feet[1][0]
        way = ankles[0] - ankles[1]
        way = way / np.linalg.norm(way, axis=-1, keepdims=True)
        self.across = np.sum((self.hips - (ankles[0] + ankles[1]) / 2.0) * way, axis=-1)
        self.speed = np.linalg.norm(np.diff(self.hips, axis=0), axis=-1) * self.fps

    def slide(self) -> float:
        """Metres over which an ankle or ball goes at most while its foot is planted, level with the floor."""
        return max((float(np.linalg.norm(np.ptp(part[a:b, [0, 2]], axis=0)))
                    for foot, planted in zip(self.feet, self.planted, strict=True) for part in foot
                    for a, b in runs(planted)), default=0.0)

    def steps(self) -> int:
        """How often a foot leaves the floor and comes back."""
        return sum(max(len(runs(planted)) - 1, 0) for planted in self.planted)

    def shifts(self) -> int:
        """How often the hips go from over one leg to over the other."""
        slow = gaussian_filter1d(self.across, SLOW * self.fps, mode="nearest")
        slow = slow - np.median(slow)
        sides = np.sign(slow[np.abs(slow) > SHIFTED])
        return int(np.count_nonzero(np.diff(sides)))

    def outside(self) -> NDArray[np.bool_]:
        """Whether the hips' middle lies outside the hull of the soles that are planted, every `_EVERY` seconds."""
        frames = range(0, len(self.hips), max(1, round(_EVERY * self.fps)))
        soles = [_soles(*foot) for foot in self.feet]
        return np.array([_beyond(self.hips[t, [0, 2]], [sole[t] for sole, planted in zip(
            soles, self.planted, strict=True) if planted[t]]) for t in frames])

    def frozen(self) -> float:
        """Seconds of the longest stretch in which the hips are slower than `STILL`."""
        return max(((b - a) / self.fps for a, b in runs(self.speed < STILL)), default=0.0)


def _soles(ankle: Array, ball: Array) -> Array:
    """[T, 4, 2] corners of the sole, metres along X and Z."""
    ahead = (ball - ankle)[:, [0, 2]]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    beside = _HALF * np.stack([ahead[:, 1], -ahead[:, 0]], axis=-1)
    heel, toes = ankle[:, [0, 2]] - _HEEL * ahead, ball[:, [0, 2]] + _TOES * ahead
    return np.stack([heel + beside, heel - beside, toes + beside, toes - beside], axis=1)


def _beyond(point: Array, soles: Sequence[Array]) -> bool:
    """Whether a point [2] lies outside the hull of soles; with none it does."""
    try:
        return not soles or bool((ConvexHull(np.concatenate(soles)).equations @ np.append(point, 1.0)).max() > 0.0)
    except QhullError:  # soles without an area
        return True


def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE", help="audio files")
    parser.add_argument("--pause", type=float, default=30.0, metavar="S",
                        help="seconds of a pause, 0 for none (default 30)")
    parser.add_argument("--renderings", type=int, default=4, metavar="N", help="seeds for each (default 4)")
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    parser.add_argument("--system", action="append", default=[], metavar="NAME=DIR", help="BVH files with legs")
    parser.add_argument("--people", type=Path, metavar="DIR", help="people from whom to measure the bands anew")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """A row for ours in speech, ours in a pause, the controls and each folder; InputError without any."""
    if arguments.renderings < 1 or not 0.0 <= arguments.pause <= 600.0:
        raise InputError("--renderings, --pause", "are out of range", "give 1 or more, and 0 to 600 seconds")
    motions = _rendered(arguments)
    controls = {f"{name} (control)": [made(motion) for motion in motions[SPEECH]]
                for name, made in CONTROLS.items() if SPEECH in motions}
    for name, place in named(arguments.system, "--system").items():
        files = find_motions(Path(place))[0].values()
        motions[name] = [_with_legs(file) for file in files if file.suffix.lower() == ".bvh"]
    if not (motions or arguments.people):
        raise InputError("probe stance", "has nothing to look at", "give --speech, --pause, --system or --people")
    note = (f"A foot is planted while its ankle and ball are within {1000 * PLANTED:g} mm of the lowest that they are; "
            f"weight shifts are of {100 * SHIFTED:g} cm to either side at least. (!): slides over {SLIDES:g} mm.")
    people = {} if arguments.people is None else _people(arguments.people)
    motions |= controls
    stable = Table("Stability of the legs", COLUMNS, {name: _judged(measured(of)) for name, of in motions.items()},
                   "motion", [note])
    return [*([stable] if motions else ()), _compared(motions, people)]


def _judged(row: dict[str, float | str]) -> dict[str, Cell]:
    """The row with a mark at feet that slide."""
    return {key: Marked(value, "(!)") if key == "slide" and isinstance(value, float) and value > SLIDES else value
            for key, value in row.items()}


def _rendered(arguments: argparse.Namespace) -> dict[str, list[Motion]]:
    """Ours in speech and in a pause, as far as they are asked for."""
    asked = {SPEECH: [load_speech(file) for file in arguments.speech],
             "ours, a pause": [_pause(arguments.pause)] if arguments.pause else []}
    if not any(asked.values()):
        return {}
    system = Gesticulator.from_pretrained(arguments.bundle)
    return {name: [system(speech, seed=seed, legs=True).motion for speech in sounds
                   for seed in range(arguments.renderings)] for name, sounds in asked.items() if sounds}


def _compared(motions: Mapping[str, Iterable[Motion]], people: Mapping[str, Sequence[StandingSpan]]) -> Table:
    """The table of how bodies stand, with a mark at what is outside the band of people."""
    rows: dict[str, dict[str, Cell]] = {f"people, {end}": {key: band[place] for key, band in PEOPLE.items()}
                                        for place, end in enumerate(("least", "most"))}
    if people:
        found = bands(people)
        rows |= {f"these people, {end}": {key: band[place] for key, band in found.items()}
                 for place, end in enumerate(("least", "most"))}
    for name, of in motions.items():
        spans = [span for motion in of for span in spans_of(motion)]
        rows[name] = {key: Marked(value, "(!)") if outside(key, value) else value
                      for key, value in figures(spans).items()}
    return Table("Standing, compared with people", FIGURES, rows, "motion", [
        "(!): outside the band of people: the 10th to the 90th percentile over the stretches of 4 s and more in which "
        "they stand; for weight shifts, the rates of the persons."])


def _people(folder: Path) -> dict[str, list[StandingSpan]]:
    """The spans of each person of a folder in which that person stands as speakers do."""
    manifest = folder / "manifest.csv"
    advice = "give a folder with a manifest.csv that names file, person and kind"
    people: dict[str, list[StandingSpan]] = {}
    for line, row in read_table(manifest, advice):
        file, person, kind = (row.get(name) for name in ("file", "person", "kind"))
        if file is None or person is None or kind is None:
            raise InputError(f"{manifest}, line {line}", "lacks file, person or kind", advice)
        if kind in _KINDS:
            people.setdefault(person, []).extend(spans_of(read_bvh(folder / file)))
    return people


def stilts(motion: Motion) -> Motion:
    """The motion of `WHOLE_BODY` on straight legs under hips that neither move nor turn."""
    hips = np.tile([1.0, 0.0, 0.0, 0.0], (len(motion), 1))
    out = _over(motion, hips, np.tile(motion.root_positions.mean(axis=0), (len(motion), 1)))
    for joint in LEG_JOINTS:
        out.rotations[:, WHOLE_BODY.index(joint)] = hips
    return out


def statue(motion: Motion) -> Motion:
    """The motion of `WHOLE_BODY` over the hips and legs of its first frame."""
    hips, root = (np.repeat(path[:1], len(motion), axis=0) for path in (motion.rotations[:, 0], motion.root_positions))
    out = _over(motion, hips, root)
    for joint in LEG_JOINTS:
        out.rotations[:, WHOLE_BODY.index(joint)] = motion.rotations[0, WHOLE_BODY.index(joint)]
    return out


def pushed(motion: Motion) -> Motion:
    """The motion pushed to and fro with its feet."""
    way = _PUSH * np.sin(2.0 * np.pi / _PUSHED * np.arange(len(motion)) / motion.fps)
    return replace(motion, root_positions=motion.root_positions + way[:, None] * [1.0, 0.0, 0.0])


CONTROLS = {"stilts": stilts, "a statue": statue, "pushed feet": pushed}
SPEECH = "ours, speech"


def _over(motion: Motion, hips: Array, root: Array) -> Motion:
    """A copy with other hips [T, 4] and root [T, 3] under a spine that keeps the upper body as it was."""
    spine, rotations = WHOLE_BODY.index("Spine"), motion.rotations.copy()
    rotations[:, spine] = rotation.multiply(rotation.conjugate(hips), rotation.multiply(
        motion.rotations[:, 0], motion.rotations[:, spine]))
    rotations[:, 0] = hips
    return replace(motion, rotations=rotations, root_positions=root)


def _pause(seconds: float) -> Speech:
    """A room in which nothing is said."""
    samples = np.random.default_rng(0).normal(0.0, _FAINT, round(seconds * SAMPLE_RATE))
    return Speech(samples.astype(np.float32), SAMPLE_RATE)


def _with_legs(file: Path) -> Motion:
    motion = read_bvh(file)
    if not set(LEG_JOINTS) <= set(find_table(motion.skeleton.names)):
        raise InputError(file, "has no legs", "make it with infer --legs")
    return motion
