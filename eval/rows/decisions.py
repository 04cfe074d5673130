"""The verdict on every claim, and on every effect of docs/coverage.md: claims.json and claims.md.

What the cells hold is compared by `eval.rows.verdicts`; what probes and benchmarks measured is read from their files of
results (`PROBED`). Where a metric fails its controls, the claim beside it on the same two rows by a metric that passes
is named. Nothing is measured here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from eval.crossed import robust
from eval.rows import OURS
from eval.rows.cells import Cells
from eval.rows.claims import CLAIMS, PaperClaim, margin_of, papers_numbers
from eval.rows.controls import failing
from eval.rows.effects import EFFECTS
from eval.rows.tables import pairs
from eval.rows.verdicts import FAILS, HOLDS, NO_TEST, UNDECIDED, WORDS, Decision, decide, present
from eval.stats import Interval
from eval.table import Column, Table, load

BESIDE = "pmb_above_chance"
"""The metric of quality that passes its controls, and which both papers print beside the others."""
SHORTEST = 200.0
"""Milliseconds of the shortest block."""


def judged(claim: PaperClaim, cells: Cells, results: Path | None = None) -> Decision:
    """The verdict on a claim by these cells. results: where the returns of those who do not listen are read."""
    if claim.needs:
        return Decision(UNDECIDED, claim.needs)
    lacking = [name for name in (claim.first, claim.second) if not cells.get(name)]
    if lacking:
        return Decision(UNDECIDED, f"not run: {', '.join(lacking)}")
    _, apart = pairs(cells[claim.first], cells[claim.second], claim.metric)
    apart = apart[np.isfinite(apart).any(axis=1)] if apart.size else apart
    if not apart.size:
        return Decision(UNDECIDED, "no figure of a clip that both have")
    found = robust(apart)
    margin = margin_of(claim, cells, found.trimmed)
    ours = "size-100" if claim.first.startswith("size-") else OURS
    fooled = failing(claim.metric, cells, results, ours)
    printed = papers_numbers(claim)
    if fooled or not printed or not math.isfinite(margin):
        none = "" if printed else "the paper prints no effect"
        reason = "; ".join(filter(None, (none, fooled))) or "no figure here to carry the paper's effect over to"
        return Decision(NO_TEST, reason, found.interval(), margin, (found.seeds, found.clips))
    return decide(found, claim.says, margin)


# ------------------------------------------------------------------------------------------------------------- probes

def _facts(tables: Sequence[Table]) -> list[Interval]:
    """What a probe says that its claim rests on."""
    return [Interval.from_dict(held) for held in tables[0].facts["claim"]]


def _column(title: str, column: str, *rows: str) -> Callable[[Sequence[Table]], list[Interval]]:
    """Intervals of a column of the table of that title; of all rows where none is named."""
    def read(tables: Sequence[Table]) -> list[Interval]:
        table = next(one for one in tables if one.title == title)
        cells = [table.rows[row][column] for row in rows or table.rows]
        return [cell for cell in cells if isinstance(cell, Interval)]
    return read


def _retrieval(tables: Sequence[Table]) -> list[Interval]:
    """R@1 either way above chance, in percent, of both rewards on captured motion; ends against the chance's ends."""
    rows = [row for name, row in tables[0].rows.items() if "captured" in name and name.endswith("of same recording")]
    found = [(row[f"{way}_r1"], row["chance_r1"]) for row in rows for way in ("motion", "audio")]
    return [Interval(hit.mean - chance.mean, hit.low - chance.high, hit.high - chance.low, hit.n)
            for hit, chance in found if isinstance(hit, Interval) and isinstance(chance, Interval)]


def _spared(tables: Sequence[Table]) -> list[Interval]:
    """Milliseconds that a decision leaves of the shortest block, for our network and for one of the paper's size."""
    costs = [float(str(cell)) for name, row in tables[0].rows.items() if "cached" in name for cell in row.values()]
    return [Interval(SHORTEST - max(costs), SHORTEST - max(costs), SHORTEST - max(costs),
                     int(tables[0].facts["decisions"]))]


_LEVELS = ("new words, AUC: level 8 - level 2", "energy, R2: level 2 - level 8", "pitch, R2: level 2 - level 8")
PROBED: dict[str, tuple[tuple[str, ...], Callable[[Sequence[Table]], list[Interval]]]] = {
    "RG Fig. 10": (("style_editing", "earlier/style_editing"), _facts),
    "RG Fig. 13": (("paper_languages", "languages", "earlier/languages"), _facts),
    "RG Fig. 14": (("earlier/speech_levels",), _facts),
    "RG Eq. 1": (("word_contrast",), _facts),
    "RG 4.1.3": (("earlier/speech_levels",), _column("What is said of the levels", "difference", *_LEVELS)),
    "RG 7.1.2": (("two_languages", "earlier/two_languages"),
                 _column("A speech encoder of one language or of two", "two - one")),
    "RACER 4.2": (("rewards", "earlier/rewards"), _retrieval),
    "RACER 1": (("q_network",), _spared),
}
"""By a claim's place: the files of results that answer it, of which the first that is there counts, and the intervals
in them that must lie above zero."""


def probed(results: Path) -> dict[str, Decision]:
    """Verdicts on the claims of `PROBED` whose file is there."""
    out = {}
    for where, (names, read) in PROBED.items():
        files = [results / f"{name}.json" for name in names]
        try:
            found = read(load(next((file for file in files if file.is_file()), files[0])))
        except (InputError, KeyError, IndexError, StopIteration):
            continue
        if found:
            out[where] = present(found)
    return out


# -------------------------------------------------------------------------------------------------------------- table

def decided(cells: Cells, results: Path | None = None) -> list[Decision]:
    """The verdict on each of `CLAIMS`. results: where the probes keep what they found."""
    elsewhere = probed(results) if results else {}
    return [(elsewhere.get(claim.where) if claim.needs else None) or judged(claim, cells, results) for claim in CLAIMS]


def beside(number: int, decisions: Sequence[Decision]) -> int | None:
    """The number of the claim about the timing of the same two rows that has a valid test, where this one has none."""
    claim = CLAIMS[number]
    if claim.needs or decisions[number].word != NO_TEST:
        return None
    return next((k for k, other in enumerate(CLAIMS) if (other.where, other.first, other.second, other.metric)
                 == (claim.where, claim.first, claim.second, BESIDE) and decisions[k].word != NO_TEST), None)


def claims_table(cells: Cells, results: Path | None = None) -> Table:
    """Every claim and what became of it, and the effects that rest on them (facts["effects"])."""
    decisions = decided(cells, results)
    count = {name: sum(found.word == name for found in decisions) for name in WORDS}
    rows, facts = {}, []
    for number, (claim, found) in enumerate(zip(CLAIMS, decisions, strict=True)):
        other = beside(number, decisions)
        known, margin = math.isfinite(found.value.mean), found.margin
        reason = "; ".join(filter(None, (found.reason, f"beside it: {other + 1}" if other is not None else "")))
        rows[str(number + 1)] = {
            "where": claim.where, "claim": claim.sentence, "paper": papers_numbers(claim),
            "difference": found.value.text(claim.digits) if known else None,
            "margin": f"{margin:.{claim.digits}f}" if math.isfinite(margin) else None,
            "pairs": ", ".join(map(str, found.over)) or None,
            "verdict": found.word + (f" ({reason})" if reason else ""),
            "needed": ", ".join(map(str, found.needed)) or None}
        facts.append({**asdict(claim), "name": claim.name, "sentence": claim.sentence, "paper": papers_numbers(claim),
                      "verdict": found.word, "reason": reason, "difference": found.value.to_dict() if found.over
                      else None, "margin": margin if math.isfinite(margin) else None, "pairs": list(found.over),
                      "needed": list(found.needed)})
    columns = {key: Column(title) for key, title in (
        ("where", "where"), ("claim", "claim"), ("paper", "the paper's figures"), ("difference", "difference here"),
        ("margin", "margin"), ("pairs", "seeds, clips"), ("verdict", "verdict"),
        ("needed", "seeds, clips that would decide"))}
    return Table("Claims", columns, rows, "", [
        f"{count[HOLDS]} claims hold, {count[FAILS]} do not, {count[NO_TEST]} have no valid test, {count[UNDECIDED]} "
        "are undecided. Differences are paired, with 95 % intervals over seeds and clips; the margin is half of the "
        "paper's effect; the last column is for 80 % power. The papers' figures are of other data: compare the order."],
        {"claims": facts, "count": count, "effects": effects(decisions)})


def effects(decisions: Sequence[Decision]) -> list[dict[str, Any]]:
    """The effects of docs/coverage.md: each has the verdict of the first of its claims that has a valid test."""
    by_name = {claim.name: number for number, claim in enumerate(CLAIMS)}
    out = []
    for effect in EFFECTS:
        numbers = [by_name[name] for name in effect.claims]
        deciding = next((k for k in numbers if decisions[k].word != NO_TEST), numbers[0])
        out.append({"effect": effect.says, "rows": list(effect.rows), "verdict": decisions[deciding].word,
                    "claim": deciding + 1, "claims": [k + 1 for k in numbers], "reason": decisions[deciding].reason})
    return out
