"""How a claim is decided: one rule, two readings. docs/results.md has both for a reader, with the controls by column.

A claim is that one row's figure is lower than another's, higher, or about the same. Measured is the paired difference
on the same clips and seeds, with its intervals of 95 and of 90 % by variance components (`eval.crossed`).

- *holds*: the 95 % interval lies on the claim's side of zero, and not within the margin.
- *reversed*: it lies on the other side; of rows that are called alike: wholly outside the margin.
- *no effect*: the 90 % interval lies within the margin on both sides of zero, which is two one-sided tests at 5 %
  (TOST, Schuirmann 1987). A significant difference that is smaller than the margin counts as none.
- *undecided*: none of these, or fewer than three seeds. `needed` says how many seeds and clips would tell no effect
  from the paper's at 80 % power, if seeds and clips differ as they did here.
- *inert*: two rows are alike by this column, and no other claim about the two holds or is reversed. What changes
  nothing leaves this unchanged, too; that is no success and is not counted as one.

*As published* is by the paper's own column. *Valid* is by a column that its controls cannot beat: what a control does
as well proves nothing, so a claim that would hold, or might, by such a column has *no valid test*, and so has one
without any margin. A negative stands: who does not win even by a lenient measure has not won.

A control must be worse than ours, the whole 95 % interval of the paired difference; a still body must have less of an
amount, and jitter no more of it than the performer. A distance between sets takes motion for another speech for
perfect, by construction; it must order rising doses of damage instead (`out_of_order`).

What fools it: no correction is made for the number of claims. The power is of variances that three seeds tell badly.
"""

import itertools
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import t

from eval.ablate.cells import Cell, Cells, difference, pairs, values_of
from eval.ablate.rows import (
    COLUMNS,
    DECIDED,
    DOSED,
    DOSES,
    ELSEWHERE,
    OURS,
    PERFORMER,
    SIGNS,
    TABLES,
    Claim,
    Elsewhere,
    PaperTable,
    is_racer,
)
from eval.crossed import Components, components, satterthwaite
from eval.stats import Interval
from eval.table import Column, Table

HOLDS, REVERSED, NO_EFFECT, UNDECIDED, NO_TEST = "holds", "reversed", "no effect", "undecided", "no valid test"
INERT = "inert"
WORDS = (HOLDS, REVERSED, NO_EFFECT, INERT, NO_TEST, UNDECIDED)
CLAIMS = "Claims"
"""The title of the table of claims."""
NOT_RUN = "(not run)"
COLLAPSED = math.log(2)
"""Nats of lexemes in a recording below which a policy has collapsed: fewer than two lexemes would give it."""
POWER = 0.8
CLIPS = 60
"""Clips of a whole test split: with as many, `needed` gives the least number of seeds."""
LEAST_CLIPS = 3
"""An interval over fewer decides nothing."""
_SEEDS, _CLIPS = (np.unique(np.geomspace(least, 20_000, 400).round()) for least in (DECIDED, 4))


@dataclass(frozen=True)
class Decision:
    """The decision on a claim: one of `WORDS`; why; the difference; the margin (NaN: none); seeds and clips, as many as
    there were and as would decide it (empty: not known)."""

    word: str
    reason: str = ""
    value: Interval = field(default_factory=Interval.undefined)
    margin: float = math.nan
    over: tuple[int, ...] = ()
    needed: tuple[int, ...] = ()


# ---------------------------------------------------------------------------------------------------------- the rule

def decide(measured: Components, sign: str, margin: float) -> Decision:
    """The verdict on a difference. sign: "<", ">" or "="; margin: positive, in the difference's unit, NaN for none."""
    value, over = measured.interval(), (measured.seeds, measured.clips)
    if measured.seeds < DECIDED:
        return Decision(UNDECIDED, f"{measured.seeds} of {DECIDED} seeds", value, margin, over)
    narrow = measured.interval(0.9)
    # Two one-sided tests at 5 % are one interval of 90 %. A NaN margin makes this false.
    equivalent = -margin < narrow.low and narrow.high < margin
    word, reason = alike(value, equivalent, margin) if sign == "=" else one_sided(value, equivalent, sign)
    needed = needed_for(measured, margin, sign) if word == UNDECIDED and math.isfinite(margin) else ()
    return Decision(word, reason, value, margin, over, needed)


def one_sided(value: Interval, equivalent: bool, sign: str) -> tuple[str, str]:
    """Verdict and reason for a claim of more or of less."""
    right, wrong = (value.above(), value.below()) if sign == ">" else (value.below(), value.above())
    if equivalent:
        return NO_EFFECT, "less than the margin" if right else ""
    if wrong:
        return REVERSED, ""
    return (HOLDS, "") if right else (UNDECIDED, "")


def alike(value: Interval, equivalent: bool, margin: float) -> tuple[str, str]:
    """Verdict and reason for a claim that two rows are alike."""
    if equivalent:
        return HOLDS, ""
    apart = value.above(margin) or value.below(-margin)
    return (REVERSED, "further apart than the margin") if apart else (UNDECIDED, "")


def present(claim: Elsewhere) -> Decision:
    """The verdict on a claim that something is there at all: the lowest of its intervals must lie above zero."""
    if not claim.lowest:
        return Decision(UNDECIDED, claim.needs)
    mean, low, high, clips = claim.lowest
    worst = Interval(mean, low, high, int(clips))
    reason = f"the lowest of {claim.intervals} intervals" if claim.intervals > 1 else ""
    if worst.below():
        return Decision(REVERSED, reason, worst, over=(1, worst.n))
    if worst.above() and worst.n >= LEAST_CLIPS:
        return Decision(HOLDS, reason, worst, over=(1, worst.n))
    # Clips at which a mean as large as this one would lie above zero four times in five, by a normal estimate: the
    # interval is 3.92 standard errors wide, and 2.8 of them are 1.96 for 95 % and 0.84 for the power.
    error, size = (worst.high - worst.low) / 3.92, abs(worst.mean)
    needed = max(LEAST_CLIPS, math.ceil(worst.n * (2.8 * error / size) ** 2)) if size > 0 else 0
    return Decision(UNDECIDED, reason, worst, over=(1, worst.n), needed=(1, needed))


def needed_for(measured: Components, margin: float, sign: str = ">") -> tuple[int, ...]:
    """Seeds and clips that would decide between no effect and twice the margin, each four times in five at least.

    As many seeds as `CLIPS` clips need; where no number does, the pair with the smallest product; empty where there is
    none.
    """
    # All pairs on a grid of geometric steps: the answer is an order of magnitude, not a design.
    seeds, clips = np.meshgrid(_SEEDS, np.append(_CLIPS[_CLIPS != CLIPS], CLIPS), indexing="ij")
    error, freedom = satterthwaite(measured.seed, measured.clip, measured.rest, seeds, clips)
    with np.errstate(divide="ignore"):
        decided = 2 * t.cdf(margin / error - t.ppf(0.95, freedom), freedom) - 1 >= POWER
        if sign != "=":
            decided &= t.cdf(2 * margin / error - t.ppf(0.975, freedom), freedom) >= POWER
    # A whole test split is at hand in any case, so seeds are counted first.
    whole = decided & (clips == CLIPS)
    pick = whole if whole.any() else decided
    if not pick.any():
        return ()
    place = np.unravel_index(np.argmin(np.where(pick, seeds * clips, np.inf)), seeds.shape)
    return int(seeds[place]), int(clips[place])


# ------------------------------------------------------------------------------------------------ margins and controls

def margin_of(claim: Claim, cells: Cells, column: str) -> float:
    """Half of the effect that the paper prints, positive, in the unit of `column` here; NaN where it prints none.

    On the first data set for which the paper prints both figures. Distances, variances and returns are other numbers
    on other data, so theirs is a share of `second`'s figure here; shares of PMB, points of accuracy and nats are taken
    as they stand. Rows that are called alike, and those of which the paper prints nothing, have the fixed margin of the
    column, NaN where it has none.
    """
    printed = TABLES[claim.where].both(claim)
    if not printed or claim.sign == "=":
        return COLUMNS[column].alike
    _, first, second = printed[0]
    if COLUMNS[claim.metric].margin != "share":
        return abs(first - second) / 2
    # Distances of other data are other numbers, so the paper's effect is carried over as a share.
    here = values_of(list(cells[claim.second].values()), column)
    # A share of the second row's figure, as the paper's effect is a share of its own.
    base = float(np.nanmean(here)) if np.isfinite(here).any() else math.nan
    return abs(first - second) / second / 2 * base if base > 0 else math.nan


def beaten_by(column: str, cells: Cells, split: str = "test", ours: str = OURS) -> list[str]:
    """The controls that a column cannot tell from good motion; those that were not run bear a note.

    ours: the row that the controls of the split stand beside.
    """
    suffix, figure = "" if split == "test" else f"-{split}", COLUMNS[column]
    if figure.doses:
        return out_of_order(column, cells, suffix)
    fooled = []
    for name in figure.controls:
        # Noise is more motion, so of an amount it must not have more than the performer has.
        noise = figure.good == "near" and name == "jitter"
        value = difference(cells, name + suffix, PERFORMER + suffix if noise else ours, column)
        worse = not value.above() if noise else value.above() if figure.good == "low" else value.below()
        # A figure that is undefined for a control, as timing is for a body that never moves, is not fooled by it.
        if name + suffix not in cells or (value.n and not worse):
            fooled.append(name if value.n else f"{name} {NOT_RUN}")
    return fooled


def out_of_order(column: str, cells: Cells, suffix: str = "") -> list[str]:
    """The kinds of damage (`eval.baselines.DOSES`) whose doses a distance does not order: of which a greater one is not
    further from the performer than the one before, the whole interval of the paired difference, or the first no further
    than the performer's motion itself."""
    if not {f"{name}{suffix}" for name in (PERFORMER, *DOSED)} <= set(cells):
        return [f"doses of damage {NOT_RUN}"]
    fooled = []
    for kind, count in DOSES.items():
        steps = [PERFORMER + suffix, *(f"{kind}-{dose}{suffix}" for dose in range(1, count + 1))]
        if not all(difference(cells, more, less, column).above() for less, more in itertools.pairwise(steps)):
            fooled.append(f"doses of {kind}")
    return fooled


# ----------------------------------------------------------------------------------------------------------- readings

def reading(claim: Claim, cells: Cells, column: str) -> Decision:
    """The verdict on a claim by a column of these cells, whatever its controls say."""
    lacking = [name for name in (claim.first, claim.second) if not cells.get(name)]
    if lacking:
        return Decision(UNDECIDED, f"not run: {', '.join(lacking)}")
    _, apart = pairs(cells[claim.first], cells[claim.second], column)
    # A seed whose figure is undefined on every clip is no seed of this column.
    apart = apart[np.isfinite(apart).any(axis=1)] if apart.size else apart
    if not apart.size:
        return Decision(UNDECIDED, f"{COLUMNS[column].heading} was not measured of both")
    decision = decide(components(apart), claim.sign, margin_of(claim, cells, column))
    if decision.word == HOLDS and claim.sign == "=" and inert(claim, cells):
        decision = replace(decision, word=INERT, reason="the two differ in nothing that the paper claims of them")
    remarks = [f"{name} has collapsed: {run:.0f} blocks of one lexeme" for name in (claim.first, claim.second)
               if (run := collapsed(cells[name]))]
    return replace(decision, reason="; ".join(filter(None, (decision.reason, *remarks))))


def inert(claim: Claim, cells: Cells) -> bool:
    """True where the papers claim differences of these two rows, and none of them is there, either way round."""
    others = [other for table in TABLES.values() for other in table.claims
              if {other.first, other.second} == {claim.first, claim.second} and other.sign != "="]
    return bool(others) and not any(reading(other, cells, other.metric).word in (HOLDS, REVERSED) for other in others)


def collapsed(by_seed: Mapping[int, Cell]) -> float:
    """The longest run of one lexeme of a collapsed policy (see `COLLAPSED`), mean over clips and seeds; 0 for others
    and for rows that choose no lexemes."""
    clips = [clip for cell in by_seed.values() for clip in cell["clips"] if "lexeme_diversity" in clip]
    if not clips or np.mean([clip["lexeme_diversity"] for clip in clips]) >= COLLAPSED:
        return 0.0
    return float(np.mean([clip["longest_run"] for clip in clips]))


def readings(claim: Claim, cells: Cells) -> tuple[Decision, Decision, str]:
    """The verdicts as published and valid, and the controls that beat the column of the latter."""
    table, published = TABLES[claim.where], COLUMNS[claim.metric].valid or claim.metric
    # On another split `ours` has no cell, and returns are of a reward of their own: the claim's row stands in for it.
    ours = OURS if table.split == "test" and not any(map(is_racer, COLUMNS[published].controls)) else claim.first
    fooled = ", ".join(beaten_by(published, cells, table.split, ours))
    plain = reading(claim, cells, claim.metric)
    valid = plain if published == claim.metric else reading(claim, cells, published)
    if valid.word in (HOLDS, UNDECIDED) and math.isfinite(valid.value.mean) and (
            fooled or not math.isfinite(valid.margin)):
        none = "" if math.isfinite(valid.margin) else "the paper prints no effect"
        valid = replace(valid, word=NO_TEST, needed=(), reason="; ".join(filter(None, (
            none, "a control does as well, or was not run" if fooled else "", valid.reason))))
    return plain, valid, fooled


# -------------------------------------------------------------------------------------------------------------- table

_COLUMNS = {key: Column(title) for key, title in (
    ("where", "where"), ("claim", "claim"), ("paper", "the paper's figures"),
    ("difference", "difference here (margin)"), ("published", "as published"),
    ("controls", "controls that do as well"), ("valid", "valid"))}


def _shown(decision: Decision, digits: int) -> str | None:
    """The difference with its interval, and the margin where there is one."""
    if not math.isfinite(decision.value.mean):
        return None
    return decision.value.text(digits) + (f" ({decision.margin:.{digits}f})" if math.isfinite(decision.margin) else "")


def _worded(decision: Decision) -> str:
    """The verdict, why, and what would decide it."""
    seeds, clips = decision.needed or (0, 0)
    needs = f"{seeds} seeds of {clips} clips would decide" if decision.needed else ""
    reason = "; ".join(filter(None, (decision.reason, needs)))
    return decision.word + (f" ({reason})" if reason else "")


def _row(claim: Claim, table: PaperTable, cells: Cells) -> tuple[dict[str, str | None], Decision, Decision]:
    """A claim's line and its two verdicts."""
    plain, valid, fooled = readings(claim, cells)
    column = COLUMNS[claim.metric]
    printed = "; ".join(f"{place} {first:g} and {second:g}" for place, first, second in table.both(claim))
    by = f"{COLUMNS[column.valid].heading}, {_shown(valid, column.digits) or '-'}: " if column.valid else ""
    return {"where": claim.where, "claim": f"{column.heading}: {claim.first} {SIGNS[claim.sign]} {claim.second}",
            "paper": printed, "difference": _shown(plain, column.digits), "published": _worded(plain),
            "controls": fooled or None, "valid": by + _worded(valid)}, plain, valid


def _row_elsewhere(claim: Elsewhere) -> tuple[dict[str, str | None], Decision, Decision]:
    decision = present(claim)
    word = _worded(replace(decision, reason="; ".join(filter(None, (decision.reason, claim.source)))))
    return {"where": claim.where, "claim": claim.says, "difference": _shown(decision, 2), "published": word,
            "valid": word}, decision, decision


def claims_table(cells: Cells) -> Table:
    """Every claim of both papers and its two verdicts; its facts count them."""
    rows, published, valid = zip(
        *(_row(claim, table, cells) for table in TABLES.values() for claim in table.claims),
        *map(_row_elsewhere, ELSEWHERE), strict=True)
    count = {reading: {word: Counter(decision.word for decision in of)[word] for word in WORDS}
             for reading, of in (("published", published), ("valid", valid))}
    return Table(CLAIMS, _COLUMNS, {str(number): row for number, row in enumerate(rows, 1)}, "", [counted(count)],
                 {"count": count})


def counted(count: Mapping[str, Mapping[str, int]]) -> str:
    """How often each word is the verdict, by reading and word, and how to read the table."""
    words = {reading: ", ".join(f"{number} {word}" for word, number in by_word.items() if number)
             for reading, by_word in count.items()}
    return (f"As published: {words['published']}. Valid: {words['valid']}. Differences are paired, with 95 % "
            "intervals over seeds and clips; the margin is half of the paper's effect; seeds and clips that would "
            "decide are for 80 % power. The papers' figures are of other data: compare the order.")
