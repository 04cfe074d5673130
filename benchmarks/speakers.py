"""Does every speaker gesture like a person? `python benchmarks/speakers.py STORE [--bundle DIR] [--seconds 60]`.

Each speaker of the bundle gestures for the voice of the real take in GESTICULATOR_DATA and for recordings of the test
split. The figures that have a bound in the acceptance (`eval.acceptance.motion.bounds`) are averaged over these
renderings, and held against the bound and against twice its margin: a range about its middle is twice as wide, a limit
on one side is twice or half as large.
"""

from __future__ import annotations

import argparse
import math
import shlex
import sys

import numpy as np

from data_module.speech import audio
from eval.acceptance.bounds import Bound, bounds_of
from eval.clip.measure import real_take
from eval.context import opened
from eval.metrics import eye
from eval.metrics.eye import common_body
from eval.metrics.eye.body import HZ
from eval.renderings import TAKE, AcceptanceVoice, held_out_voices
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.pipeline import Gesticulator

ROWS = bounds_of("motion")
FIGURES = {name: row.bound for name, row in ROWS.items() if not row.over and name.startswith("eye_")}


def doubled(bound: Bound) -> Bound:
    """Twice the margin of a bound."""
    if math.isfinite(bound.low) and math.isfinite(bound.high):
        spare = 0.5 * (bound.high - bound.low)
        return Bound(bound.low - spare, bound.high + spare)
    return Bound(0.5 * bound.low, 2.0 * bound.high)


def figures(gesticulator: Gesticulator, voices: list[AcceptanceVoice], speaker: str) -> dict[str, float]:
    """The mean of each figure over the voices; NaN where none has it."""
    measured = []
    for seed, voice in enumerate(voices):
        made = gesticulator(audio.resample(voice.speech, audio.SAMPLE_RATE), speaker=speaker, seed=seed)
        measured.append(eye.of_body(common_body(made.motion), voice.heard, made.blocks.edges))
    rows = {name: np.array([one[name] for one in measured]) for name in FIGURES}
    return {name: float(np.nanmean(row)) if np.isfinite(row).any() else math.nan for name, row in rows.items()}


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--seconds", type=float, default=60.0)
    p.add_argument("--limit", type=int, default=6, help="recordings of the test split (default 6)")
    p.add_argument("--out")
    a = p.parse_args()
    folder = bundle_folder(a.bundle)
    gesticulator = Gesticulator(bundles.load(folder))
    take = real_take(HZ, own_rig=True)
    voices = [] if take is None else [AcceptanceVoice("take", take[1], TAKE, take[0])]
    joints = gesticulator.bundle.config.motion.joints
    voices += held_out_voices(opened(a.store, None)[0], a.limit, joints, seconds=a.seconds)
    found = {speaker: figures(gesticulator, voices, speaker) for speaker in gesticulator.speakers}
    publish([table(found, len(voices))], a.out, Provenance.now(
        shlex.join(["python", "benchmarks/speakers.py", *sys.argv[1:]]), folder / INDEX))


def table(found: dict[str, dict[str, float]], voices: int) -> Table:
    """A row for each speaker: how many bounds it keeps, and those that it misses by more than their margin again."""
    columns = {"kept": Column("bounds kept", "", 0), "of": Column("of", "", 0),
               "beyond": Column("outside of twice the margin", "", 0), "which": Column("which", "")}
    rows = {}
    for speaker, values in found.items():
        known = {name: value for name, value in values.items() if math.isfinite(value)}
        beyond = [name for name, value in known.items() if not doubled(FIGURES[name]).keeps(value)]
        rows[speaker] = {"kept": sum(FIGURES[name].keeps(value) for name, value in known.items()), "of": len(known),
                         "beyond": len(beyond),
                         "which": "; ".join(f"{name} {known[name]:.{ROWS[name].digits}f}" for name in beyond) or "-"}
    return Table("Speakers against the bounds of the acceptance", columns, rows, "speaker",
                 [f"Means over {voices} voices: the real take's and recordings of the test split, one seed each."])


if __name__ == "__main__":
    main()
