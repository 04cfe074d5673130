"""What do the knobs do? Response curves of intensity, activity, energy, handedness, mirror, stillness and variation.

    gesticulator probe knobs --speech examples/speech.flac [--seeds 3] [--seconds 30] [--out docs/results/knobs.json]

Each row is one setting; sounds and seeds are the same in every row. The figures are those for the eye
(`eval.metrics.eye`), with two beside them: how much of the way of both hands the right one goes, and how often an arm
joint is turned farther than the training data ever show. `left the band` names the figures that lie within the range of
real people at the neutral setting and outside of it here (by their means). What fools it: a figure near the edge of the
band leaves it by little; the range is that of two people.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.speech.audio import load_speech
from data_module.types import Array, Speech
from eval.clip.excerpts import excerpt_of_speech
from eval.clip.measure import real_take
from eval.metrics import eye
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table
from gesticulator.page.session import EditSession
from gesticulator.performance import Performance
from gesticulator.pipeline import Gesticulator

NEUTRAL = "neutral"
FAR = np.radians(5.0)
"""Radians beyond the range of the training data from which a turn counts as too far."""
MOVES = 0.1
"""m/s from which a hand moves."""
STILL = (4.0, 6.0), (10.0, 12.5)
"""Seconds of the ranges that `hold_still` is tried with; what counts is inside of them."""

Settings = Mapping[str, Any]
ROWS: dict[str, Settings] = {
    NEUTRAL: {},
    **{f"intensity {value:g}": {"intensity": value} for value in (0.0, 0.25, 0.5, 0.75, 1.25, 1.5, 2.0)},
    **{f"activity {value:g}": {"activity": value} for value in (0.0, 0.25, 0.5, 0.75)},
    "energy calm": {"energy": "calm"}, "energy lively": {"energy": "lively"},
    "handedness left": {"handedness": "left"}, "handedness right": {"handedness": "right"},
    "handedness both": {"handedness": "both"}, "mirror": {"mirror": True}, "hold still": {"hold_still": STILL},
    "variation 1": {"variation": 1},
}
COLUMNS = {
    "eye_speed_25": Column("hand speed, 25 %", "m/s"), "eye_speed_50": Column("median", "m/s"),
    "eye_speed_95": Column("95 %", "m/s"),
    "eye_stroke_amplitude": Column("stroke amplitude", "cm", 1),
    "eye_one_handed": Column("movement of one hand alone", "%", 0),
    "eye_hand_speed_correlation": Column("both hands' speeds correlate", "", 2),
    "moving": Column("a hand moves", "% of time", 0),
    "right": Column("the right hand's share of the way", "%", 0), "apart": Column("hands from neutral", "cm", 0),
    "eye_hand_in_torso": Column("hand in the torso", "%", 1, "low"),
    "beyond": Column("arm turned too far", "% of time", 1, "low"),
    "still": Column("hand speed in the ranges", "m/s", 3), "left": Column("left the band"),
}


def hands_of(made: Performance) -> Array:
    """[T, 2, 3] metres, the right hand first."""
    return made.positions()[:, [made.joints.index(side + "Hand") for side in ("Right", "Left")]]


def beyond_range(made: Performance, low: Array, high: Array) -> float:
    """Percent of the time in which a joint of an arm is turned more than `FAR` beyond the bounds low, high [3 J]."""
    arms = [j for j, name in enumerate(made.joints) if name.endswith(("Shoulder", "Arm", "ForeArm"))]
    columns = (3 * np.array(arms)[:, None] + np.arange(3)).ravel()
    turns = rotation.unroll(rotation.to_exponential_map(made.rotations[:, arms])).reshape(len(made.rotations), -1)
    outside = np.maximum(turns - high[columns], low[columns] - turns).max(axis=1)
    return 100.0 * float((outside > FAR).mean())


def measured(made: Performance, neutral: Performance, bounds: tuple[Array, Array]) -> dict[str, float]:
    """The figures of a performance; neutral: the same sound and seed with no knob turned; bounds: see
    `beyond_range`."""
    hands, theirs = hands_of(made), hands_of(neutral)
    speeds = np.linalg.norm(np.diff(hands, axis=0), axis=-1) * made.fps
    times = np.arange(len(speeds)) / made.fps
    inside = np.any([(times > begin) & (times < stop) for begin, stop in STILL], axis=0)
    ways = speeds.sum(axis=0)
    return {**eye.figures(made.motion), "moving": 100.0 * float((speeds.max(axis=1) > MOVES).mean()),
            "right": 100.0 * float(ways[0] / max(ways.sum(), 1e-9)), "beyond": beyond_range(made, *bounds),
            "apart": 100.0 * float(np.linalg.norm(hands - theirs, axis=-1).mean()),
            "still": float(speeds[inside].mean()) if inside.any() else float("nan")}


def left_the_band(now: Mapping[str, Interval], neutral: Mapping[str, Interval]) -> str:
    """Names of the figures that are like real people's at neutral, and are not any more."""
    gone = [name for name in eye.RANGES if name in now and eye.within(name, neutral[name].mean)
            and eye.within(name, now[name].mean) is False]
    return ", ".join(name.removeprefix("eye_").replace("_", " ") for name in gone) or "none"


def table(figures: Mapping[str, Sequence[Mapping[str, float]]]) -> Table:
    """Rows of settings. figures: setting -> those of each sound and seed, `NEUTRAL` among them."""
    means = {row: {name: mean_interval([one[name] for one in own]) for name in own[0]
                   if np.isfinite([one[name] for one in own]).any()} for row, own in figures.items()}
    rows: dict[str, dict[str, Cell]] = {}
    for row, own in means.items():
        rows[row] = {name: own.get(name) for name in COLUMNS if name != "left"}
        rows[row]["left"] = left_the_band(own, means[NEUTRAL])
    count = len(figures[NEUTRAL])
    note = (f"{count} renderings in each row, the same sounds and seeds; means with bootstrap 95 % intervals. The "
            "band: the range of two real people (eval.metrics.eye). The ranges: "
            + " and ".join(f"{begin:g} to {stop:g} s" for begin, stop in STILL) + ", held still in one row alone.")
    return Table("Effect of the knobs", COLUMNS, rows, "setting", [note])


def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="audio files (default: the real recording in GESTICULATOR_DATA)")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="renderings per audio file (default 3)")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S",
                        help="seconds of each audio file (default 30)")
    parser.add_argument("--only", nargs="+", choices=list(ROWS), metavar="ROW", help="only these settings")
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """One table; InputError where there is no sound."""
    if arguments.seeds < 1 or not 15.0 <= arguments.seconds <= 3600.0:
        raise InputError("--seeds, --seconds", "are out of range", "give 1 or more, and 15 to 3600 seconds")
    take = None if arguments.speech else real_take(60.0)
    sounds = [load_speech(file) for file in arguments.speech] or ([take[1]] if take else [])
    if not sounds:
        raise InputError("probe knobs", "has nothing to gesture for", "give --speech")
    system = Gesticulator.from_pretrained(arguments.bundle)
    return [table(played(system, [excerpt_of_speech(sound, arguments.seconds) for sound in sounds], arguments.seeds,
                         arguments.only or list(ROWS)))]


def played(system: Gesticulator, sounds: Sequence[Speech], seeds: int, rows: Sequence[str]
           ) -> dict[str, list[dict[str, float]]]:
    """Setting -> the figures of each sound and seed; `NEUTRAL` is always among them."""
    speaker, statistics = system.speaker_index(None), system.bundle.statistics
    low, high = (statistics.denormalise(bound, speaker) for bound in statistics.bounds)
    figures: dict[str, list[dict[str, float]]] = {row: [] for row in dict.fromkeys((NEUTRAL, *rows))}
    for sound in sounds:
        for seed in range(seeds):
            neutral = system(sound, seed=seed)
            drawn, plans = neutral.plan(), EditSession(system, neutral)
            for row, own in figures.items():
                made = neutral
                if set(ROWS[row]) & {"variation", "hold_still"}:
                    made = system(sound, seed=seed, **ROWS[row])
                elif row != NEUTRAL:
                    # What changes finished poses alone is rendered from the same drawing.
                    plan = replace(drawn, knobs=replace(drawn.knobs, **ROWS[row]))
                    made = plans.perform(plan) if plan.manner == drawn.manner else \
                        system(sound, seed=seed, **ROWS[row])
                own.append(measured(made, neutral, (low, high)))
    return figures
