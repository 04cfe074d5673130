"""Which metrics may carry a claim: those on which motion that is known to be wrong does worse.

Three kinds, each with the controls that must change it:

- Quality (MAJE, MAD, FGD, PMB): the performer's motion for another speech (`shuffled`), played backwards (`reversed`),
  with each joint 2 cm off (`jitter`), or held still (`still`) must be worse than ours: the 95 % interval of the paired
  difference lies on the worse side. What has no figure there (a still body has no beats) is not asked.
- Amounts (diversity, motion variance, hand speed): the papers claim more or less of them, not better or worse, and a
  shuffled or reversed clip has as much. They must see that a still body has less than ours, and must not take noise for
  more: jitter may not have more than the performer.
- Returns: random and majority lexemes must earn less than the performer's, interval apart from interval.

Accuracy counts decisions, not motion: it has no control here. What a metric's controls did is of the split and store
that the rows are of.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from data_module.errors import InputError
from eval.crossed import crossed
from eval.rows import OURS, PERFORMER
from eval.rows.cells import Cells
from eval.rows.row import COLUMNS, JUDGING, TRAINING
from eval.rows.tables import pairs
from eval.stats import Interval
from eval.table import Table, load

WRONG = ("shuffled", "reversed", "jitter", "still")
QUALITY = ("maje", "mad", "fgd", "pmb", "pmb_above_chance")
AMOUNTS = ("diversity", "variance", "speech_speed", "silence_speed")
RETURNS = {"return": TRAINING, "judge_return": JUDGING}
"""Columns of returns, and the reward that each is of."""
POLICIES = ("policies", "earlier/policies")
"""Files of results with the returns of the performer and of those who do not listen; the first that is there counts."""


def failing(metric: str, cells: Cells, results: Path | None = None, ours: str = OURS) -> str:
    """Why a metric carries no claim, for a reader; empty where it may. ours: the row that the controls stand beside."""
    suffix = "" if ours == OURS else "-val"
    if metric in RETURNS:
        return _returns(metric, results)
    if metric in QUALITY:
        good = COLUMNS[metric].good
        return _fooled(metric, cells, [name + suffix for name in WRONG], ours, good == "low")
    if metric in AMOUNTS:
        less = _fooled(metric, cells, [f"still{suffix}"], ours, False)
        more = _unequal(cells, f"jitter{suffix}", PERFORMER + suffix, metric)
        raised = [f"jitter has more than the performer ({more.text(COLUMNS[metric].digits)})"] if more.above() else []
        return "; ".join(filter(None, (less, *raised)))
    return ""


def _unequal(cells: Cells, first: str, second: str, metric: str) -> Interval:
    """First less second, paired."""
    if first not in cells or second not in cells:
        return Interval.undefined()
    _, apart = pairs(cells[first], cells[second], metric)
    return crossed(apart) if apart.size else Interval.undefined()


def _fooled(metric: str, cells: Cells, wrong: list[str], ours: str, low: bool) -> str:
    """Those of the controls that are not worse than ours. low: whether less is better."""
    differences = {name: _unequal(cells, name, ours, metric) for name in wrong}
    worse: Callable[[Interval], bool] = (lambda apart: apart.above()) if low else (lambda apart: apart.below())
    if not any(apart.n for apart in differences.values()):
        return "its controls were not run"
    found = [name for name, apart in differences.items() if apart.n and not worse(apart)]
    return f"{', '.join(found)} no worse than {ours}" if found else ""


def _returns(metric: str, results: Path | None) -> str:
    """Those who do not listen and do not earn less than the performer by a reward."""
    table = _policies(RETURNS[metric], results)
    if table is None:
        return "not known to be higher for the performer than for random lexemes"
    performer = table.rows[PERFORMER].get(metric)
    others = {name: table.rows[name].get(metric) for name in ("random", "majority") if name in table.rows}
    found = [name for name, value in others.items() if isinstance(value, Interval) and isinstance(performer, Interval)
             and value.high >= performer.low]
    return f"{' and '.join(found)} lexemes not shown to earn less than the performer's" if found else ""


def _policies(reward: str, results: Path | None) -> Table | None:
    for name in POLICIES if results else ():
        file = Path(results or ".") / f"{name}.json"
        try:
            return next(table for table in load(file) if table.title == f"Policies: {reward}")
        except (InputError, StopIteration):
            continue
    return None
