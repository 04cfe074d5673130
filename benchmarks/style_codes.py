"""Do style codes of blocks change the motion? `python benchmarks/style_codes.py STORE [--bundle paper] [--limit N]`.

Each recording of the test split (unseen voices, texts and takes) is gestured for with the same lexemes and other style
codes (RG 5.3, 6.2): predicted from the voice, zero, and drawn from N(0, I) anew on each block, which is the prior of
RG Eq. 14; and with the predicted codes over another draw of the lexemes. The distance is the mean over joints and
frames of the distance between the joints of two renderings, in millimetres. Codes matter if random ones move the joints
about as far as another draw of the lexemes does; they are inert if they hardly move them.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from data_module.errors import InputError
from data_module.motion.kinematics import positions_of
from data_module.speech import audio
from data_module.types import Array
from eval import stats
from eval.baselines.interpreters import RandomStyle
from eval.context import opened
from eval.renderings import AcceptanceVoice, held_out_voices
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.pipeline import Gesticulator
from interpreters.lstm import StyleInterpreter

RATE = 20.0
MILLIMETRES = 1000.0
CODES = ("zero", "random", "another draw")
COLUMNS = {"apart": Column("from the predicted codes, mm", "", 1), "speed": Column("hands, m/s", "", 3),
           "share": Column("of another draw", "%", 1)}


class Scaled(RandomStyle):
    """Random codes of deviation `size`; 0 is the mean of the prior."""

    def __init__(self, code_width: int, size: float) -> None:
        super().__init__(code_width, 1)
        self.size = size

    def step(self, *arguments: Any) -> tuple[Tensor, np.random.Generator]:
        """See `RandomStyle.step`."""
        code, state = super().step(*arguments)
        return self.size * code, state


def of_voice(systems: Mapping[str, Gesticulator], voice: AcceptanceVoice) -> dict[str, tuple[float, float]]:
    """For each kind of codes, the distance from the motion of the predicted ones, millimetres, and the speed of the
    hands, metres per second."""
    speech = audio.resample(voice.speech, audio.SAMPLE_RATE)
    predicted = systems["predicted"]
    motions = {name: system(speech, seed=0, fps=RATE).motion for name, system in systems.items()}
    motions["another draw"] = predicted(speech, seed=1, fps=RATE).motion
    places = {name: positions_of(motion) for name, motion in motions.items()}
    hands = [motions["predicted"].skeleton.index(f"{side}Hand") for side in ("Left", "Right")]
    return {name: (float(MILLIMETRES * np.linalg.norm(own - places["predicted"], axis=-1).mean()),
                   _speed(own[:, hands])) for name, own in places.items()}


def _speed(hands: Array) -> float:
    return float(RATE * np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean())


def table(rows: list[dict[str, tuple[float, float]]]) -> Table:
    """Distances and speeds with bootstrap intervals over recordings."""
    cells = {}
    for name in ("predicted", *CODES):
        apart, speed = (np.array([row[name][k] for row in rows]) for k in (0, 1))
        draw = np.array([row["another draw"][0] for row in rows])
        cells[name] = {"speed": stats.mean_interval(speed)}
        if name != "predicted":
            cells[name]["apart"] = stats.mean_interval(apart)
            cells[name]["share"] = stats.of_set(
                lambda chosen, apart=apart, draw=draw: float(100 * apart[chosen].sum() / draw[chosen].sum()), len(rows))
    return Table("Style codes of blocks", COLUMNS, cells, "codes", [
        f"{len(rows)} recordings of the test split, by the default performer, at the bundle's temperature. The same "
        "lexemes in all rows but the last. Distance of the joints from those of the predicted codes, mean over joints "
        "and frames; bootstrap 95 % intervals over recordings. The link between voice and manner is planted by the "
        "corpus' rules, at full strength."])


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", default="paper", metavar="NAME|DIR", help="paper, or a folder (default: paper)")
    p.add_argument("--seconds", type=float, default=30.0)
    p.add_argument("--limit", type=int, help="recordings, at most")
    p.add_argument("--out")
    a = p.parse_args()
    store, _ = opened(a.store, None)
    folder = bundle_folder(a.bundle)
    bundle = bundles.load(folder)
    if not isinstance(bundle.style, StyleInterpreter):
        raise InputError(folder, "has no style codes of blocks", "train one with the preset `paper`")
    systems = {"predicted": Gesticulator(bundle)}
    for name, size in (("zero", 0.0), ("random", 1.0)):
        other: Any = Scaled(bundle.code_width, size)
        systems[name] = Gesticulator(bundle.with_parts(style=other, style_text=None))
    rows = [of_voice(systems, voice)
            for voice in held_out_voices(store, a.limit, bundle.config.motion.joints, seconds=a.seconds)]
    publish([table(rows)], a.out, Provenance.now(
        shlex.join(["python", "benchmarks/style_codes.py", *sys.argv[1:]]), folder / INDEX))


if __name__ == "__main__":
    main()
