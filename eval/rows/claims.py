"""What the papers say: every claim of both, with their figures and the margin that follows from them.

A claim says that one row's figure lies above (or below) another's, or that both are alike; how it is decided stands in
`eval.rows.verdicts`. Claims that something is there at all, such as an effect on other languages, are read from what
probes and benchmarks measured (`eval.rows.decisions`); those that need people or other systems wait for them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from eval.crossed import trimmed
from eval.rows import OURS, PERFORMER, TABLES, racer
from eval.rows.cells import Cells, values_of
from eval.rows.row import COLUMNS, DECISIONS, RowColumn
from eval.rows.verdicts import ALIKE

RACER_TABLE = "RACER Table 2"
_RELATIVE, _AS_THEY_STAND = ("maje", "mad", "fgd", "variance", "return"), ("pmb", "accuracy", "diversity")
"""Figures whose paper's effect is carried over as a share, and as it stands."""
_PAPERS_KEY = {"pmb_above_chance": "pmb", "judge_return": "return"}
"""Columns that stand for one of the paper's of another name."""
_COLUMNS: dict[str, RowColumn] = {**{key: own for part in DECISIONS.values() for key, own in part.items()}, **COLUMNS}


@dataclass(frozen=True)
class PaperClaim:
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
        title = _COLUMNS[self.metric].heading if self.metric in COLUMNS else self.metric.replace("_", " ")
        words = {"above": "higher than", "below": "lower than", "alike": "about that of"}[self.says]
        return f"{title}: {self.first} {words} {self.second}"

    @property
    def name(self) -> str:
        """By which an effect names it, such as "RG Table 1: fgd, ours, no-style"."""
        return f"{self.where}: {self.metric}, {self.first}, {self.second}" if not self.needs else (
            f"{self.where}: {self.first}")

    @property
    def digits(self) -> int:
        """As many as its difference is shown with."""
        return _COLUMNS[self.metric].digits if self.metric in COLUMNS else 2


def _above(where: str, metric: str, first: str, *others: str) -> list[PaperClaim]:
    return [PaperClaim(where, first, other, metric) for other in others]


def _below(where: str, metric: str, first: str, *others: str) -> list[PaperClaim]:
    return [PaperClaim(where, first, other, metric, "below") for other in others]


def _alike(where: str, first: str, *others: str) -> list[PaperClaim]:
    return [PaperClaim(where, first, other, "pmb_above_chance", "alike") for other in others]


def _rhythmic_gesticulator() -> list[PaperClaim]:
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
    out += _alike("RG Table 2", "random-style", "no-style")
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


def _racer() -> list[PaperClaim]:
    ours = racer.OURS
    others = tuple(racer.PREFIX + name for name in ("supervised", "distance", "dqn", "actor-critic"))
    out = [claim for metric in ("return", "judge_return")
           for claim in _above(RACER_TABLE, metric, ours, *others)]
    out += _above(RACER_TABLE, "pmb_above_chance", ours, *others)
    return out + [claim for metric in ("maje", "mad", "fgd") for claim in _below(RACER_TABLE, metric, ours, *others)]


_SYSTEMS = "the other systems' motion for the test speech is not here; gesticulator ablate --system takes it"
_PEOPLE = "no people were asked; gesticulator study makes the pages and the analysis"
_PROBE = "not measured: "
_ONCE = "measured once; docs/results.md has the figure"
NOT_HERE = [PaperClaim(where, says, "", "", needs=needs) for where, says, needs in (
    ("RG Table 1", "ours beats SG, Ges, GTC and S2AG in MAJE, MAD, FGD and PMB", _SYSTEMS),
    ("RG Fig. 11", "ours has the highest PMB of all systems at every delta", _SYSTEMS),
    ("RG Fig. 12", "people prefer ours", _PEOPLE),
    ("RG Fig. 10", "motion follows what is asked of height, speed and radius",
     f"{_PROBE}gesticulator probe style-editing"),
    ("RG Fig. 13", "a model of one language gestures in time with others, for each above chance",
     _ONCE),
    ("RG Fig. 14", "the high level tells lexemes better than the low one", _ONCE),
    ("RACER Table 1", "RACER beats SG, Ges, S2AG and Bailando in MAJE, MAD, FGD and PMB", _SYSTEMS),
    ("RACER Fig. 4", "people prefer RACER", _PEOPLE),
    ("RG 4.1.3", "sound is told better from a low level, words from a high one", _ONCE),
    ("RG Eq. 1", "contrast with the words brings the high level nearer to them",
     _ONCE),
    ("RG 7.1.2", "speech of a second language helps the encoder, for either",
     _ONCE),
    ("RACER 4.2", "the reward finds the motion of a sound among others more often than chance, either way",
     f"{_PROBE}gesticulator probe rewards"),
    ("RACER 1", "a decision takes less than the shortest block, 200 ms", f"{_PROBE}python benchmarks/q_network.py"))]
CLAIMS: list[PaperClaim] = [*_rhythmic_gesticulator(), *_racer(), *NOT_HERE]


# ------------------------------------------------------------------------------------------------ the papers' figures

def margin_of(claim: PaperClaim, cells: Cells, of_the_middle: bool = False) -> float:
    """Half of the effect that the paper prints, positive, in this table's units; NaN where it prints none.

    On Trinity, else on the table's other data set. Distances, variances and returns are other numbers on other data, so
    theirs is a share of `second`'s figure here (of_the_middle: of the middle clips); shares of PMB, points of accuracy
    and nats are taken as they stand (a point of the paper's PMB, which counts from zero, would be more than one above
    chance, so this margin is rather too small). Claims of likeness have `ALIKE`.
    """
    if claim.says == "alike":
        return ALIKE if papers_numbers(claim) else math.nan
    key = _PAPERS_KEY.get(claim.metric, claim.metric)
    figures = next((pair for pair in zip(*(_paper(claim.where, row, key) for row in (claim.first, claim.second)),
                                         strict=True) if None not in pair), None)
    if key not in (*_RELATIVE, *_AS_THEY_STAND) or figures is None:
        return math.nan
    first, second = (float(figure) for figure in figures if figure is not None)
    if key in _AS_THEY_STAND:
        return abs(first - second) / 2
    by_seed = list(cells.get(claim.second, {}).values())
    here = values_of(by_seed, claim.metric) if by_seed else np.zeros((0, 0))
    if not np.isfinite(here).any():
        return math.nan
    base = trimmed(here[:, np.isfinite(here).any(axis=0)]).mean if of_the_middle else float(np.nanmean(here))
    return abs(first - second) / second / 2 * base if base > 0 else math.nan


def _paper(where: str, row: str, key: str) -> tuple[float | None, float | None]:
    """The paper's figure of a row, on Trinity and on the other data set of that table."""
    lines = [line for title, table in TABLES.items() if title.split(",")[0] == where for line in table.lines]
    return next((line.paper[key] for line in lines if line.row == row and key in line.paper), (None, None))


def papers_numbers(claim: PaperClaim) -> str:
    """The paper's own two figures, on Trinity and on TED; empty where it prints none."""
    key = _PAPERS_KEY.get(claim.metric, claim.metric)
    one, other = (_paper(claim.where, row, key) for row in (claim.first, claim.second))
    return "; ".join(f"{place} {a:g} and {b:g}" for place, a, b in zip(("Trinity", "TED"), one, other, strict=True)
                     if a is not None and b is not None)
