"""Is the style that is heard obeyed? `python benchmarks/unit_style.py STORE [--bundle DIR] [--seconds 60] [--limit N]`.

Every recording of the test split (unseen voices, texts and takes) is gestured for three times by the default speaker:
with the style codes that the interpreter hears (`interpreters.planner`), with zeros, and with codes that are drawn
at random for each unit with the same deviations. Of each gesture unit in the output, speed, range, height and reach of
the hands are measured (`unit_styles.style_of`), and compared with the code that was *heard* in the unit's sound:

- explained: R^2 of a linear regression of the measured figures on the heard codes, over all units;
- with the performer: the correlation, over windows of 8 s, of the logarithm of the hands' speed with that of the person
  who really said it. The link between voice and motion of our own corpus is planted by its rules.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from data_module.errors import InputError
from data_module.motion.phases import hand_places
from data_module.speech import audio
from data_module.types import Array
from eval import stats
from eval.context import opened
from eval.renderings import AcceptanceVoice, held_out_voices
from eval.table import Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.pipeline import Gesticulator
from gesticulator.training.stages.planner import RATE, units_of
from gesticulator.training.stages.unit_styles import spans, style_of
from interpreters.base import BlockFeatures
from interpreters.planner import CODE, PHASES, UnitStyleInterpreter, UnitStyleState

WINDOW = 8.0
_STILL, _FEWEST = 0.02, 6
MODES = ("heard", "zero", "random")


class Played(nn.Module):
    """An interpreter whose codes are replaced, and which keeps those that it heard. mode: of `MODES`."""

    def __init__(self, inner: UnitStyleInterpreter, mode: str, seed: int) -> None:
        super().__init__()
        self.inner, self.mode, self.codes = inner, mode, []  # type: ignore[var-annotated]
        self.rng, self.drawn = torch.Generator().manual_seed(seed), torch.zeros(1, len(CODE))

    def start(self, speaker: int) -> UnitStyleState:
        """See `UnitStyleInterpreter.start`."""
        self.codes = []
        return self.inner.start(speaker)

    def step(self, state: UnitStyleState, features: BlockFeatures, resting: bool = False
             ) -> tuple[Tensor, UnitStyleState]:
        """The code of the mode; random ones change where a unit begins."""
        code, after = self.inner.step(state, features, resting)
        heard, _ = self.inner.step(state, features, False)
        self.codes.append(heard[0].numpy())
        if state.count == 0:
            self.drawn = torch.randn(1, len(CODE), generator=self.rng) * (self.inner.gain > 0.1)
        if self.mode == "heard" or resting:
            return code, after
        return (torch.zeros_like(code) if self.mode == "zero" else self.drawn), after


@dataclass(frozen=True)
class Heard:
    """One recording. heard, measured: [n, d_z] of its units; r: correlation with the performer's speed, or NaN."""

    heard: Array
    measured: Array
    r: float


def speeds(hands: Array) -> Array:
    """[n] logarithm of the hands' mean speed over windows of 8 s."""
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean(axis=1) * RATE
    size = int(WINDOW * RATE)
    return np.log([speed[i:i + size].mean() + _STILL for i in range(0, len(speed) - size + 1, size // 2)])


def of_voice(gesticulator: Gesticulator, voice: AcceptanceVoice, played: Played) -> Heard:
    """Perform a voice with the codes of a mode."""
    made = gesticulator(audio.resample(voice.speech, audio.SAMPLE_RATE), seed=0)
    hands, edges = hand_places(made.motion, RATE), made.blocks.edges
    acting = units_of(hands, edges)[:, 0] != PHASES.index("rest")
    codes = np.array(played.codes[:len(acting)])
    heard, measured = [], []
    for first, last in spans(acting):
        own = hands[round(edges[first] * RATE):round(edges[last] * RATE)]
        if len(own) > 1 and last <= len(codes):
            heard.append(codes[first:last].mean(axis=0))
            measured.append(style_of(own))
    r = float("nan")
    if voice.own is not None:
        ours, theirs = speeds(hands), speeds(hand_places(voice.own, RATE))
        count = min(len(ours), len(theirs))
        r = float(np.corrcoef(ours[:count], theirs[:count])[0, 1]) if count >= _FEWEST else r
    width = len(CODE)
    return Heard(np.array(heard).reshape(-1, width), np.array(measured).reshape(-1, width), r)


def explained(rows: Sequence[Heard], dimension: int) -> float:
    """R^2 of the regression of a measured figure on the codes that were heard."""
    heard = np.concatenate([row.heard for row in rows])
    y = np.concatenate([row.measured for row in rows])[:, dimension]
    x = np.column_stack([np.ones(len(heard)), heard])
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float(100 * (1 - left.var() / y.var()))


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--seconds", type=float, default=60.0)
    p.add_argument("--limit", type=int, help="recordings, at most")
    p.add_argument("--out")
    a = p.parse_args()
    store, _ = opened(a.store, None)
    folder = bundle_folder(a.bundle)
    bundle = bundles.load(folder)
    if not isinstance(bundle.style, UnitStyleInterpreter):
        raise InputError(folder, "has no style codes of gesture units", "train one with the preset `default`")
    rows: dict[str, list[Heard]] = {mode: [] for mode in MODES}
    players = {mode: Played(bundle.style, mode, 1) for mode in MODES}
    systems = {mode: Gesticulator(bundle.with_parts(style=player)) for mode, player in players.items()}
    for voice in held_out_voices(store, a.limit, bundle.config.motion.joints, seconds=a.seconds):
        for mode, system in systems.items():
            rows[mode].append(of_voice(system, voice, players[mode]))
    publish([table(rows)], a.out, Provenance.now(
        shlex.join(["python", "benchmarks/unit_style.py", *sys.argv[1:]]), folder / INDEX))


def table(rows: dict[str, list[Heard]]) -> Table:
    """What the heard codes explain, and the correlation with the performers."""
    columns = {name: Column(f"{name} explained", "%", 1) for name in CODE}
    columns |= {"all": Column("explained, mean of the four", "%", 1),
                "r": Column("with the performer, r", "", 3), "apart": Column("heard less this, r", "", 3)}
    cells = {}
    for mode, own in rows.items():
        each = {name: stats.of_set(lambda chosen, k=k, own=own: explained([own[i] for i in chosen], k), len(own))
                for k, name in enumerate(CODE)}
        total = stats.of_set(lambda chosen, own=own: float(np.mean(
            [explained([own[i] for i in chosen], k) for k in range(len(CODE))])), len(own))
        r = [row.r for row in own]
        cells[mode] = {**each, "all": total, "r": stats.mean_interval(r)}
        if mode != "heard":
            cells[mode]["apart"] = stats.paired([row.r for row in rows["heard"]], r)
    count, units = len(rows["heard"]), sum(len(row.heard) for row in rows["heard"])
    return Table("Styles of gesture units, heard and obeyed", columns, cells, "codes", [
        f"{count} recordings of the test split, {units} units; bootstrap 95 % intervals over recordings. The link "
        "between voice and motion is planted by the corpus' rules, at full strength."])


if __name__ == "__main__":
    main()
