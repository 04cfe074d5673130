"""Are the planned gesture units played? `python benchmarks/units.py STORE [--bundle DIR] [--seconds 40] [--limit N]`.

Every recording of the test split is gestured for by the default speaker, without its words: a named gesture that a word
calls for is played whatever the plan says. Of the units in each plan:

- holds: the share of the time, after a stop of 0.3 s, in which the acting hand stays under 0.08 m/s, and how far it
  drifts from where it stopped; and the same where words call for named gestures;
- phases: the share of the blocks in which the phase that is measured on the motion (`data_module.motion.phases`) is the
  planned one, beside the share with the plan rolled by half the recording;
- preparations: the share of planned preparations that a stroke follows in the plan.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from data_module.motion.phases import hand_places
from data_module.speech import audio
from data_module.types import Array
from eval import stats
from eval.context import opened
from eval.renderings import held_out_voices
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.pipeline import Gesticulator
from gesticulator.plan.plan import GestureUnit
from gesticulator.training.stages.planner import RATE, units_of
from interpreters.planner import PHASES

STOPS, SLOW = 0.3, 0.08
SIDES = ("left", "right")


def acting(unit: GestureUnit) -> Iterator[int]:
    """The hands that act in a unit, 0 for the left one."""
    for side, name in enumerate(SIDES):
        if unit.hand in (name, "both"):
            yield side


def planned(units: tuple[GestureUnit, ...], edges: Array) -> list[str]:
    """The planned phase of every block with edges [N + 1]."""
    spans = [(phase.start, phase.end, phase.kind.split(" ")[-1]) for unit in units for phase in unit.phases]
    return [next((kind for start, end, kind in spans if start <= middle < end), "rest")
            for middle in (edges[1:] + edges[:-1]) / 2]


def of_recording(hands: Array, units: tuple[GestureUnit, ...], edges: Array) -> dict[str, float]:
    """The figures of one recording; NaN where nothing of the kind was planned."""
    speed = np.linalg.norm(np.gradient(hands, axis=0), axis=-1) * RATE
    slow: list[float] = []
    drift: list[float] = []
    led: list[float] = []
    for unit in units:
        for k, phase in enumerate(unit.phases):
            first, last = round((phase.start + STOPS) * RATE), min(round(phase.end * RATE), len(hands))
            if phase.kind == "preparation":
                led.append(k + 1 < len(unit.phases) and unit.phases[k + 1].kind in ("stroke", "pre-stroke hold"))
            for side in acting(unit):
                if phase.kind.endswith("hold") and last - first > 2:
                    slow.append(float((speed[first:last, side] < SLOW).mean()))
                    drift.append(float(np.linalg.norm(hands[last - 1, side] - hands[first, side])))
    asked, played = planned(units, edges), [PHASES[row[0]] for row in units_of(hands, edges)]
    rolled = asked[len(asked) // 2:] + asked[:len(asked) // 2]
    figures = {"slow": slow, "drift": drift, "led": led,
               "agree": [float(one == other) for one, other in zip(asked, played, strict=True)],
               "chance": [float(one == other) for one, other in zip(rolled, played, strict=True)]}
    return {key: 100.0 * float(np.mean(values)) if values else float("nan") for key, values in figures.items()}


TITLES = {"slow": "holds: acting hand under 0.08 m/s, % of the time", "drift": "holds: drift, cm",
          "slow, words": "holds, with words that call for gestures: under 0.08 m/s, % of the time",
          "drift, words": "holds, with words that call for gestures: drift, cm",
          "agree": "blocks whose phase is played as planned, %", "chance": "the same with the plan rolled by half, %",
          "led": "preparations that a stroke follows in the plan, %"}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--seconds", type=float, default=40.0)
    p.add_argument("--limit", type=int, help="recordings, at most")
    p.add_argument("--out")
    a = p.parse_args()
    store, _ = opened(a.store, None)
    folder = bundle_folder(a.bundle)
    system = Gesticulator(bundles.load(folder))
    rows = []
    for voice in held_out_voices(store, a.limit, system.bundle.config.motion.joints, seconds=a.seconds):
        said = audio.resample(voice.speech, audio.SAMPLE_RATE)
        plain, worded = (of_recording(hand_places(made.motion, RATE), made.plan().units, made.blocks.edges)
                         for made in (system(speech, seed=0) for speech in (replace(said, words=None), said)))
        rows.append(plain | {f"{key}, words": worded[key] for key in ("slow", "drift")})
    cells = {title: {"value": stats.mean_interval([row[key] for row in rows])} for key, title in TITLES.items()}
    publish([Table("Gesture units, planned and played", {"value": Column("mean", "", 1)}, cells, "figure", [
        f"{len(rows)} recordings of the test split, {a.seconds:g} s of each; bootstrap 95 % intervals over "
        "recordings."])], a.out, Provenance.now(shlex.join(["python", "benchmarks/units.py", *sys.argv[1:]]),
                                                folder / INDEX))


if __name__ == "__main__":
    main()
