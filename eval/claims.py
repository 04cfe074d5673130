"""What the papers say, and whether it is so here: every claim of both, each a paired test over seeds and clips.

    python -m eval.claims [--results docs/results] [--out FILE.json] [--differences]

A claim says that one row's figure lies above (or below) another's, or that both are alike. The rows' values on the same
seeds and clips are subtracted; the mean difference has a 95 % interval by the bootstrap, seeds and clips both drawn
anew. The claim holds when the whole interval lies on its side, does not hold when it lies on the other, and is
undecided between. One that says "alike" holds when the interval lies within `ALIKE` of zero. Fewer than three seeds
decide nothing, whatever the interval. The figures are those that `eval.ablate` and `eval.racer_ablation` have kept in
the folders ablation and racer of the results. Three claims are read from other commands' files there (`ELSEWHERE`);
they are of one bundle, with intervals over clips alone, and hold when all of several intervals lie on their side.

What fools it: no correction is made for the number of claims (one in forty that is false will seem to hold); three
seeds are few, and their bootstrap is narrow; a part that does nothing on this corpus may matter on another.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import one_line_errors
from data_module.types import Array
from eval import racer_ablation
from eval.ablation_tables import COLUMNS, DECIDED, Cells, read_cells
from eval.ablations import OURS, PERFORMER, ROWS, TABLES, Paper
from eval.bootstrap import Interval
from eval.racer_ablation import interval_over
from eval.results import loaded, publish

HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"
ALIKE = 5.0
"""How far apart two shares of PMB, in percent, may lie and still be called alike."""
RACER_TABLE = "RACER Table 2"
_PAPERS_KEY = {"pmb_above_chance": "pmb", "return": "return", "judge_return": "return"}


@dataclass(frozen=True)
class Claim:
    """`first`'s figure is higher than `second`'s ("above"), lower ("below") or the same ("alike").

    where: the table it is read from. needs: why it cannot be tested here at all, or where it is.
    """

    where: str
    first: str
    second: str
    metric: str
    says: str = "above"
    needs: str = ""

    @property
    def sentence(self) -> str:
        """For a reader."""
        if self.needs:
            return self.first
        title = COLUMNS[self.metric].title if self.metric in COLUMNS else f"{self.metric.replace('_', ' ')}"
        words = {"above": "higher than", "below": "lower than", "alike": "about that of"}[self.says]
        return f"{title}: {self.first} {words} {self.second}"


def _above(where: str, metric: str, first: str, *others: str) -> list[Claim]:
    return [Claim(where, first, other, metric) for other in others]


def _below(where: str, metric: str, first: str, *others: str) -> list[Claim]:
    return [Claim(where, first, other, metric, "below") for other in others]


def _alike(where: str, first: str, *others: str) -> list[Claim]:
    return [Claim(where, first, other, "pmb_above_chance", "alike") for other in others]


def _rhythmic_gesticulator() -> list[Claim]:
    pmb, parts = "pmb_above_chance", ("no-segmentation", "no-lexemes", "no-style", "audio-only")
    out = [claim for metric in ("maje", "mad", "fgd") for claim in _below("RG Table 1", metric, OURS, *parts)]
    out += _above("RG Table 1", pmb, OURS, "no-segmentation", "no-lexemes", "audio-only")
    out += _alike("RG Table 1", OURS, "no-style") + _above("RG Table 1", pmb, PERFORMER, OURS)
    # Each step of Table 2 adds to variance and takes from FGD.
    steps = ("no-audio-no-style", "no-style", "random-style")
    out += [claim for less, more in zip(steps, steps[1:], strict=False)
            for claim in (*_above("RG Table 2", "variance", more, less), *_below("RG Table 2", "fgd", more, less))]
    out += _above("RG Table 2", "variance", OURS, "no-style") + _below("RG Table 2", "fgd", OURS, "random-style")
    out += _above("RG Table 2", pmb, "no-style", "no-audio-no-style") + _alike("RG Table 2", OURS, "random-style")
    out += _above("RG Table 2", "variance", PERFORMER, "no-style")
    out += _below("RG Table 3", "fgd", "style-reads", OURS) + _alike("RG Table 3", "style-reads", OURS)
    out += _below("RG Table 4", "fgd", OURS, "range-0.2-1.0", "range-0.5-1.0")
    out += _above("RG Table 4", pmb, OURS, "range-0.5-1.0") + _alike("RG Table 4", OURS, "range-0.2-1.0")
    out += _above("RG Table 5", "diversity", OURS, "no-lexemes") + _above("RG Table 5", "diversity", PERFORMER, OURS)
    out += _above("RG Table 6", "accuracy", OURS, "statistical") + _below("RG Table 6", "fgd", OURS, "statistical")
    out += _above("RG Table 6", pmb, OURS, "statistical")
    out += _below("RG Table 7", "fgd", OURS, "no-position") + _above("RG Table 7", pmb, OURS, "no-position")
    out += _below("RG Fig. 18", "fgd", "size-100", "size-10", "size-400")
    out += _alike("RG Fig. 18", "size-100", "size-10", "size-400")
    out += _below("RG 6.4.1", "silence_speed", OURS, "no-hint", "no-augmentation")
    return out


def _racer() -> list[Claim]:
    ours, others = racer_ablation.OURS, ("supervised", "distance", "dqn", "actor-critic")
    out = [claim for metric in ("return", "judge_return")
           for claim in _above(RACER_TABLE, metric, ours, *others)]
    out += _above(RACER_TABLE, "pmb_above_chance", ours, *others)
    return out + [claim for metric in ("maje", "mad", "fgd") for claim in _below(RACER_TABLE, metric, ours, *others)]


_SYSTEMS = "needs the motion of the other systems for the test speech"
_PEOPLE = "needs people who look at it"
NOT_HERE = [
    Claim("RG Table 1", "ours beats SG, Ges, GTC and S2AG in MAJE, MAD, FGD and PMB", "", "", needs=_SYSTEMS),
    Claim("RG Fig. 11", "ours has the highest PMB of all systems at every delta", "", "", needs=_SYSTEMS),
    Claim("RG Fig. 12", "people prefer ours", "", "", needs=_PEOPLE),
    Claim("RG Fig. 10", "motion follows what is asked of height, speed and radius", "", "",
          needs="run eval.style_editing"),
    Claim("RG Fig. 13", "a model of one language gestures in time with others, for each above chance", "", "",
          needs="run eval.languages"),
    Claim("RG Fig. 14", "the high level tells lexemes better than the low one", "", "", needs="run eval.speech_levels"),
    Claim("RACER Table 1", "RACER beats SG, Ges, S2AG and Bailando in MAJE, MAD, FGD and PMB", "", "", needs=_SYSTEMS),
    Claim("RACER Fig. 4", "people prefer RACER", "", "", needs=_PEOPLE),
]
CLAIMS: list[Claim] = [*_rhythmic_gesticulator(), *_racer(), *NOT_HERE]


@dataclass(frozen=True)
class Verdict:
    """What became of a claim. difference: first less second; seeds, clips: how many pairs of each."""

    verdict: str
    reason: str = ""
    difference: Interval | None = None
    seeds: int = 0
    clips: int = 0


def paired(first: dict[int, dict[str, Any]], second: dict[int, dict[str, Any]], metric: str) -> Array:
    """[seeds, clips] first less second, on the seeds and clips that both have; what has no seed pairs with all."""
    shared = sorted(set(first) & set(second))
    if (set(first) == {0}) != (set(second) == {0}):
        shared = sorted({*first, *second} - {0})
    sides = [[{clip["name"]: clip.get(metric, np.nan) for clip in rows.get(seed, rows.get(0, {"clips": []}))["clips"]}
              for seed in shared] for rows in (first, second)]
    if not shared:
        return np.zeros((0, 0))
    names = [name for name in sides[0][0] if all(name in own for side in sides for own in side)]
    own, other = (np.array([[row[name] for name in names] for row in side], dtype=np.float64) for side in sides)
    return np.asarray(own - other)


def judged(claim: Claim, cells: Cells) -> Verdict:
    """Whether a claim holds for these cells, by row and seed."""
    if claim.needs:
        return Verdict(UNDECIDED, claim.needs)
    lacking = [name for name in (claim.first, claim.second) if not cells.get(name)]
    if lacking:
        return Verdict(UNDECIDED, f"not run: {', '.join(lacking)}")
    apart = paired(cells[claim.first], cells[claim.second], claim.metric)
    apart = apart[np.isfinite(apart).any(axis=1)] if apart.size else apart
    if not apart.size:
        return Verdict(UNDECIDED, "no figure of a clip that both have")
    found = interval_over(apart, np.ones(apart.shape[1]))
    seeds, clips = len(apart), found.clips
    if seeds < DECIDED:
        return Verdict(UNDECIDED, f"{seeds} of {DECIDED} seeds", found, seeds, clips)
    return Verdict(decided(found, claim.says), "", found, seeds, clips)


def _style_editing(told: Mapping[str, Any]) -> list[Interval]:
    """Each feature's two steps, over the spread of the feature in the data."""
    out = []
    for feature, own in told["editing"].items():
        for step in (own["low_to_mid"], own["mid_to_high"]):
            mean, low, high = (step[key] / told["spread"][feature] for key in ("mean", "low", "high"))
            out.append(Interval(mean, low, high, step["clips"]))
    return out


def _languages(told: Mapping[str, Any]) -> list[Interval]:
    """PMB above chance of the shipped model on each language but its own."""
    groups = next(iter(told["systems"].values()))["groups"]
    return [Interval(**own["above_chance"]) for name, own in groups.items() if not name.startswith("English")]


def _speech_levels(told: Mapping[str, Any]) -> list[Interval]:
    """How much more the high level's clusters say of the lexemes that were made."""
    return [Interval(**own) for own in told["figure_14"]["generated"]["gain_differences"].values()]


ELSEWHERE: dict[str, tuple[str, Callable[[Mapping[str, Any]], list[Interval]]]] = {
    "RG Fig. 10": ("style_editing", _style_editing), "RG Fig. 13": ("languages", _languages),
    "RG Fig. 14": ("speech_levels", _speech_levels)}
"""By a claim's place: the file of the results that it is read from, and the intervals that must lie above 0 there."""
LEAST_CLIPS = 3
"""An interval over fewer decides nothing."""


def measured_elsewhere(results: Path) -> dict[str, Verdict]:
    """Verdicts on the claims of `ELSEWHERE` whose file is there; the difference is that of the worst interval."""
    out = {}
    for where, (name, read) in ELSEWHERE.items():
        try:
            found = read(loaded((results / f"{name}.json").read_text()))
        except (FileNotFoundError, ValueError, KeyError):
            continue
        worst, few = min(found, key=lambda own: own.low), sum(own.clips < LEAST_CLIPS for own in found)
        verdicts = {decided(own, "above") for own in found}
        verdict = next((one for one in (FAILS, UNDECIDED) if one in verdicts), HOLDS)
        if few and verdict == HOLDS:
            verdict = UNDECIDED
        told = f"{len(found)} intervals, the lowest shown" + (f"; {few} are over less than {LEAST_CLIPS} clips"
                                                             if few else "")
        out[where] = Verdict(verdict, told, worst, 1, worst.clips)
    return out


def decided(difference: Interval, says: str) -> str:
    """What an interval of the difference says of a claim."""
    low, high = difference.low, difference.high
    if says == "alike":
        within, outside = low > -ALIKE and high < ALIKE, low > ALIKE or high < -ALIKE
        return HOLDS if within else FAILS if outside else UNDECIDED
    if says == "below":
        low, high = -high, -low
    return HOLDS if low > 0 else FAILS if high < 0 else UNDECIDED


def _paper_line(where: str, row: str) -> Paper:
    if where == RACER_TABLE:
        return {key: (value, None) for key, value in racer_ablation.PAPER.get(row, {}).items()}
    lines = TABLES[where].lines if where in TABLES else ()
    return next((line.paper for line in lines if line.row == row), {})


def papers_numbers(claim: Claim) -> str:
    """The paper's own two figures, on Trinity and on TED; empty where it prints none."""
    key = _PAPERS_KEY.get(claim.metric, claim.metric)
    one, other = (_paper_line(claim.where, row).get(key) for row in (claim.first, claim.second))
    if one is None or other is None:
        return ""
    return "; ".join(f"{place} {a:g} and {b:g}" for place, a, b in zip(("Trinity", "TED"), one, other, strict=True)
                     if a is not None and b is not None)


def racer_cells(folder: Path) -> Cells:
    """What `eval.racer_ablation` has kept, as cells: values on the recordings, and the motion's where it was played."""
    cells: Cells = {}
    for name in racer_ablation.ROWS:
        for file in sorted(folder.glob(f"{name}-*.json")):
            try:
                known = loaded(file.read_text())
                played = known.get("motion", {}).get("recordings", [])
                clips = [{**own, **(played[k] if k < len(played) else {})} for k, own in enumerate(known["recordings"])]
                cells.setdefault(name, {})[int(known["seed"])] = {"clips": clips}
            except (ValueError, KeyError):
                continue  # cut short, or the file of another row with a longer name
    return cells


def claims(ablation: Cells, racer: Cells, elsewhere: Mapping[str, Verdict] | None = None) -> dict[str, Any]:
    """Every claim and what became of it, as plain values. elsewhere: see `measured_elsewhere`."""
    rows = []
    for claim in CLAIMS:
        known = (elsewhere or {}).get(claim.where) if claim.needs else None
        found = known or judged(claim, racer if claim.where == RACER_TABLE else ablation)
        rows.append({**asdict(claim), "sentence": claim.sentence, "paper": papers_numbers(claim),
                     **asdict(found)})
    return {"claims": rows, "count": {name: sum(row["verdict"] == name for row in rows)
                                      for name in (HOLDS, FAILS, UNDECIDED)}}


def markdown(result: dict[str, Any]) -> str:
    """The claims for a reader."""
    count = result["count"]
    lines = [f"{count[HOLDS]} claims hold, {count[FAILS]} do not, {count[UNDECIDED]} are undecided. Differences are "
             "paired, with bootstrap 95 % intervals over seeds and clips. The papers' figures are of other data: "
             "compare the order.", "",
             "| where | claim | the paper's figures | difference here | seeds, clips | |", "|---|---|---|---|---|---|"]
    for row in result["claims"]:
        own, digits = row["difference"], COLUMNS[row["metric"]].digits if row["metric"] in COLUMNS else 2
        shown = "-" if own is None else (f"{own['mean']:.{digits}f} [{own['low']:.{digits}f}, "
                                         f"{own['high']:.{digits}f}]")
        why = f" ({row['reason']})" if row["reason"] else ""
        pairs = f"{row['seeds']}, {row['clips']}" if own is not None else "-"
        lines.append(f"| {row['where']} | {row['sentence']} | {row['paper']} | {shown} | {pairs} | "
                     f"{row['verdict']}{why} |")
    return "\n".join(lines) + "\n"


def differences(cells: Cells, metrics: Sequence[str] = ("pmb_above_chance", "fgd", "diversity")) -> str:
    """What `ours` is less each other row of the papers' tables, paired, as Markdown; beside it the paper's, Trinity."""
    lines = TABLES["RG Table 1"].lines + TABLES["RG Table 2"].lines + TABLES["RG Table 4"].lines
    lines += TABLES["RG Table 6"].lines + TABLES["RG Table 7"].lines
    papers: dict[str, dict[str, float]] = {}
    for line in lines:
        known = {key: pair[0] for key, pair in line.paper.items() if pair[0] is not None}
        papers.setdefault(line.row, {}).update(known)
    out = [f"| ours less | {' | '.join(COLUMNS[key].title for key in metrics)} | the paper's PMB at 0.2 s; FGD |",
           "|---" * (len(metrics) + 2) + "|"]
    for row in dict.fromkeys(line.row for line in lines if line.row in ROWS and line.row != OURS):
        if row not in cells or OURS not in cells:
            continue
        shown = []
        for key in metrics:
            apart = paired(cells[OURS], cells[row], key)
            own, digits = interval_over(apart, np.ones(apart.shape[1])), COLUMNS[key].digits
            shown.append(f"{own.mean:+.{digits}f} [{own.low:.{digits}f}, {own.high:.{digits}f}]")
        theirs = [f"{papers[OURS][key] - papers[row][key]:+.1f}" for key in ("pmb", "fgd") if key in papers[row]]
        out.append(f"| {row} | {' | '.join(shown)} | {'; '.join(theirs)} |")
    return "\n".join(out) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.claims", description="Which claims of the papers hold here?")
    p.add_argument("--results", default="docs/results", metavar="DIR", help="what the other commands have kept")
    p.add_argument("--differences", action="store_true", help="show what ours is less each row instead")
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.claims"):
        results = Path(arguments.results)
        if arguments.differences:
            print(differences(read_cells(results / "ablation")), end="")
            return 0
        result = claims(read_cells(results / "ablation"), racer_cells(results / "racer"), measured_elsewhere(results))
        publish(result, markdown(result), arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
