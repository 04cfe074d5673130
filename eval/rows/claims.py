"""What the papers say, and whether it is so here: every claim of both, each a paired test over seeds and clips.

A claim says that one row's figure lies above (or below) another's, or that both are alike. The rows' values on the same
seeds and clips are subtracted; the mean difference has a 95 % interval by the bootstrap, seeds and clips both drawn
anew. The claim holds when the whole interval lies on its side, does not hold when it lies on the other, and is
undecided between. One that says "alike" holds when the interval lies within `ALIKE` of zero. Fewer than three seeds
decide nothing, whatever the interval. Beside each claim stands what could have been seen: the least true difference
that four of five such experiments would decide (`detectable`). What is undecided may be any smaller one. Three claims
are answered by probes (`PROBED`): they are of one bundle, with intervals over clips alone, and hold when all of several
intervals lie on their side.

What fools it: no correction is made for the number of claims (one in forty that is false will seem to hold); three
seeds are few, and their bootstrap is narrow; a part that does nothing on this corpus may matter on another.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np

from data_module.errors import InputError
from eval import stats
from eval.claim import FAILS, HOLDS, UNDECIDED, WHOLE, Bound, Claim, Verdict
from eval.crossed import crossed
from eval.rows import OURS, PERFORMER, TABLES, racer
from eval.rows.cells import Cells
from eval.rows.row import COLUMNS, DECIDED, DECISIONS, RowColumn
from eval.rows.tables import pairs
from eval.table import Column, Table, load

ALIKE = 5.0
"""How far apart two shares of PMB, in percent, may lie and still be called alike."""
RACER_TABLE = "RACER Table 2"
_CONFIDENCE, _POWER = (NormalDist().inv_cdf(share) for share in (0.975, 0.8))
_RELATIVE, _AS_THEY_STAND = ("maje", "mad", "fgd", "variance"), ("pmb", "accuracy", "diversity")
"""Figures whose paper's effect is carried over as a share, and as it stands."""
_PAPERS_KEY = {"pmb_above_chance": "pmb", "judge_return": "return"}
"""Columns that stand for one of the paper's of another name."""
_COLUMNS: dict[str, RowColumn] = {**{key: own for part in DECISIONS.values() for key, own in part.items()}, **COLUMNS}

BOUNDS = {"above": Bound(low=0.0, strict=True, of=WHOLE), "below": Bound(high=0.0, strict=True, of=WHOLE),
          "alike": Bound(-ALIKE, ALIKE, strict=True, of=WHOLE)}
"""Of the difference, first less second."""


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
    def claim(self) -> Claim:
        """About the difference of the two figures."""
        digits = _COLUMNS[self.metric].digits if self.metric in COLUMNS else 2
        return Claim(self.sentence, BOUNDS[self.says], digits)


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


_SYSTEMS = "needs the motion of the other systems for the test speech"
_PEOPLE = "needs people who look at it"
NOT_HERE = [
    PaperClaim("RG Table 1", "ours beats SG, Ges, GTC and S2AG in MAJE, MAD, FGD and PMB", "", "", needs=_SYSTEMS),
    PaperClaim("RG Fig. 11", "ours has the highest PMB of all systems at every delta", "", "", needs=_SYSTEMS),
    PaperClaim("RG Fig. 12", "people prefer ours", "", "", needs=_PEOPLE),
    PaperClaim("RG Fig. 10", "motion follows what is asked of height, speed and radius", "", "",
          needs="run gesticulator probe style-editing"),
    PaperClaim("RG Fig. 13", "a model of one language gestures in time with others, for each above chance", "", "",
          needs="run gesticulator probe languages"),
    PaperClaim("RG Fig. 14", "the high level tells lexemes better than the low one", "", "",
          needs="needs the earlier table of speech levels"),
    PaperClaim("RACER Table 1", "RACER beats SG, Ges, S2AG and Bailando in MAJE, MAD, FGD and PMB", "", "",
               needs=_SYSTEMS),
    PaperClaim("RACER Fig. 4", "people prefer RACER", "", "", needs=_PEOPLE),
]
CLAIMS: list[PaperClaim] = [*_rhythmic_gesticulator(), *_racer(), *NOT_HERE]


def detectable(difference: stats.Interval) -> float:
    """The least true difference whose 95 % interval would leave zero out in four of five experiments as precise.

    (z(0.975) + z(0.8)) standard errors, where the interval is as wide as 2 z(0.975) of them (a normal estimate).
    """
    return (difference.high - difference.low) / 2 * (1 + _POWER / _CONFIDENCE)


def half_of_the_papers(claim: PaperClaim, cells: Cells) -> float | None:
    """Half of the difference that the paper prints (on Trinity), in this table's units; None where it prints none.

    Distances and variances are other numbers on other data, so theirs is a share of `second`'s figure here; shares of
    PMB, points of accuracy and nats are taken as they stand (a point of the paper's PMB, which counts from zero, would
    be more than one above chance, so this half is rather too small).
    """
    key = _PAPERS_KEY.get(claim.metric, claim.metric)
    figures = [_paper(claim.where, row, key)[0] for row in (claim.first, claim.second)]
    if key not in (*_RELATIVE, *_AS_THEY_STAND) or None in figures:
        return None
    first, second = (float(figure) for figure in figures if figure is not None)
    if key in _AS_THEY_STAND:
        return (first - second) / 2
    here = [clip.get(claim.metric, math.nan) for cell in cells.get(claim.second, {}).values() for clip in cell["clips"]]
    base = float(np.nanmean(here)) if np.isfinite(here).any() else math.nan
    return (first - second) / second / 2 * base if base > 0 else None


def leaves_out(difference: stats.Interval, half: float) -> bool:
    """Whether the whole interval lies short of half of the paper's effect."""
    return difference.below(half) if half > 0 else difference.above(half)


def judged(claim: PaperClaim, cells: Cells) -> Verdict:
    """Whether a claim holds for these cells."""
    if claim.needs:
        return claim.claim.undecided(claim.needs)
    lacking = [name for name in (claim.first, claim.second) if not cells.get(name)]
    if lacking:
        return claim.claim.undecided(f"not run: {', '.join(lacking)}")
    _, apart = pairs(cells[claim.first], cells[claim.second], claim.metric)
    apart = apart[np.isfinite(apart).any(axis=1)] if apart.size else apart
    if not apart.size:
        return claim.claim.undecided("no figure of a clip that both have")
    verdict, seeds = claim.claim.judge(crossed(apart)), len(apart)
    if seeds < DECIDED:
        verdict = replace(verdict, holds=None, reason=f"{seeds} of {DECIDED} seeds")
    return replace(verdict, over=(seeds, verdict.value.n))


PROBED = {"RG Fig. 10": ("earlier/style_editing",), "RG Fig. 13": ("languages", "earlier/languages"),
          "RG Fig. 14": ("earlier/speech_levels",)}
"""By a claim's place: the files of results that answer it, of which the first that is there counts. Its first table's
facts have under "claim" the intervals that must lie above 0."""
LEAST_CLIPS = 3
"""An interval over fewer decides nothing."""


def probed(results: Path) -> dict[str, Verdict]:
    """Verdicts on the claims of `PROBED` whose file is there; the difference is that of the worst interval."""
    out = {}
    for claim in (claim for claim in CLAIMS if claim.where in PROBED):
        files = [results / f"{name}.json" for name in PROBED[claim.where]]
        try:
            table = load(next((file for file in files if file.is_file()), files[0]))[0]
            found = [stats.Interval.from_dict(held) for held in table.facts["claim"]]
        except (InputError, KeyError, IndexError):
            continue
        worst, few = min(found, key=lambda interval: interval.low), sum(one.n < LEAST_CLIPS for one in found)
        verdicts = [claim.claim.judge(interval).holds for interval in found]
        holds = False if False in verdicts else None if few or None in verdicts else True
        reason = f"{len(found)} intervals, the lowest shown" + (
            f"; {few} are over less than {LEAST_CLIPS} clips" if few else "")
        out[claim.where] = Verdict(claim.claim, worst, holds, reason, (1, worst.n))
    return out


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


def claims_table(cells: Cells, results: Path | None = None) -> Table:
    """Every claim and what became of it. results: where the probes keep what they found."""
    elsewhere = probed(results) if results else {}
    verdicts = [(elsewhere.get(claim.where) if claim.needs else None) or judged(claim, cells) for claim in CLAIMS]
    count = {name: sum(found.word == name for found in verdicts) for name in (HOLDS, FAILS, UNDECIDED)}
    rows, out_of_reach, without = {}, 0, 0
    for number, (claim, found) in enumerate(zip(CLAIMS, verdicts, strict=True), start=1):
        digits, known = found.claim.digits, math.isfinite(found.value.mean)
        half = half_of_the_papers(claim, cells) if claim.says != "alike" and known else None
        short = half is not None and leaves_out(found.value, half)
        if found.holds is None and half is not None:
            without, out_of_reach = without + 1, out_of_reach + short
        least = detectable(found.value)
        rows[str(number)] = {
            "where": claim.where, "claim": claim.sentence, "paper": papers_numbers(claim),
            "difference": found.value.text(digits) if known else None,
            "detectable": f"{least:.{digits}f}" if math.isfinite(least) else None,
            "half": None if half is None else f"{half:.{digits}f}, {'left out' if short else 'possible'}",
            "pairs": ", ".join(map(str, found.over)) or None,
            "verdict": found.word + (f" ({found.reason})" if found.reason else "")}
    columns = {key: Column(title) for key, title in (
        ("where", "where"), ("claim", "claim"), ("paper", "the paper's figures"), ("difference", "difference here"),
        ("detectable", "could be seen from"),
        ("half", "half of the paper's"), ("pairs", "seeds, clips"), ("verdict", ""))}
    facts = [{**asdict(claim), "sentence": claim.sentence, "paper": papers_numbers(claim), "verdict": found.word,
              "reason": found.reason, "difference": found.value.to_dict() if found.over else None,
              "pairs": list(found.over)} for claim, found in zip(CLAIMS, verdicts, strict=True)]
    return Table("Claims", columns, rows, "", [
        f"{count[HOLDS]} claims hold, {count[FAILS]} do not, {count[UNDECIDED]} are undecided. Differences are paired, "
        "with bootstrap 95 % intervals over seeds and clips; a true difference of the size that could be seen is "
        "decided in four of five such experiments. The papers' figures are of other data: compare the order.",
        f"Of {without} undecided claims on which the paper prints figures, the interval leaves out half of the paper's "
        f"effect in {out_of_reach}: what may be there is smaller."],
        {"claims": facts, "count": count, "smaller": out_of_reach})
