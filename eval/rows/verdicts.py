"""How a claim of a paper is decided: one rule for docs/results/claims.md and docs/coverage.md (docs/verdicts.md).

A claim is that one row's figure is higher than another's, lower, or about the same. Known before the run are the
paper's two figures and the margin, half of the effect that the paper prints. Measured is the paired difference on the
same clips and seeds (one seed is one training, one rendering of each clip), with its intervals of 95 and of 90 % by
variance components (`eval.crossed`); where one clip has three fifths of the squares, that of the middle clips.

- *holds*: the 95 % interval lies on the claim's side of zero, and not within the margin.
- *does not hold*: it lies on the other side; or the 90 % interval lies within the margin on both sides of zero, which
  is two one-sided tests at 5 % (TOST, Schuirmann 1987): equivalent to no effect.
- *no valid test*: the paper prints no effect, so that no margin can be set and nothing could refute the claim; or the
  metric fails its controls (`eval.rows.controls`).
- *undecided*: none of these, or fewer than three seeds. `needed` says how many seeds and clips would tell no effect
  from the paper's at 80 % power, if seeds and clips differ as they did here.

A claim that two rows are alike has the margin `ALIKE`: it holds by TOST, and does not hold where the 95 % interval lies
wholly outside. A claim that something is there at all (above chance, above zero) needs no margin: it holds when every
interval lies above zero, does not hold when one lies below, and is undecided otherwise. A significant difference that
is smaller than the margin counts as none: the order is then the paper's, and the effect is not.

What fools it: no correction is made for the number of claims. The power is of variances that three seeds tell badly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import t

from eval.crossed import Components, satterthwaite
from eval.rows.row import DECIDED
from eval.stats import Interval

HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"
ALIKE = 5.0
"""How far apart two shares of PMB, in percent, may lie and still be called alike."""
NO_TEST = "no valid test"
WORDS = (HOLDS, FAILS, NO_TEST, UNDECIDED)
POWER = 0.8
CLIPS = 60
"""Clips of a whole test split: with as many, `needed` gives the least number of seeds."""
LEAST_CLIPS = 3
"""An interval over fewer decides nothing."""
_SEEDS, _CLIPS = (np.unique(np.geomspace(least, 20_000, 400).round()) for least in (DECIDED, 4))


@dataclass(frozen=True)
class Decision:
    """What became of a claim: one of `WORDS`; why; the difference; the margin (NaN: none); seeds and clips, as many as
    there were and as would decide it (empty: not known)."""

    word: str
    reason: str = ""
    value: Interval = field(default_factory=Interval.undefined)
    margin: float = math.nan
    over: tuple[int, ...] = ()
    needed: tuple[int, ...] = ()


def decide(found: Components, says: str, margin: float) -> Decision:
    """The verdict on a difference. says: "above", "below" or "alike"; margin: positive, in the difference's unit."""
    value, over = found.interval(), (found.seeds, found.clips)
    remark = "of the middle clips, as one has most of the spread" if found.trimmed else ""
    if found.seeds < DECIDED:
        return Decision(UNDECIDED, f"{found.seeds} of {DECIDED} seeds", value, margin, over)
    narrow = found.interval(0.9)
    equivalent = -margin < narrow.low and narrow.high < margin
    word, reason = alike(value, equivalent, margin) if says == "alike" else one_sided(value, equivalent, says)
    needed = needed_for(found, margin, says) if word == UNDECIDED else ()
    return Decision(word, "; ".join(filter(None, (reason, remark))), value, margin, over, needed)


def one_sided(value: Interval, equivalent: bool, says: str) -> tuple[str, str]:
    """Verdict and reason for a claim of more or of less."""
    right, wrong = (value.above(), value.below()) if says == "above" else (value.below(), value.above())
    if equivalent:
        return FAILS, "less than half of the paper's effect" if right else "equivalent to none"
    if wrong:
        return FAILS, "the opposite"
    return (HOLDS, "") if right else (UNDECIDED, "")


def alike(value: Interval, equivalent: bool, margin: float) -> tuple[str, str]:
    """Verdict and reason for a claim that two rows are alike."""
    if equivalent:
        return HOLDS, ""
    apart = value.above(margin) or value.below(-margin)
    return (FAILS, "further apart than the margin") if apart else (UNDECIDED, "")


def present(intervals: Sequence[Interval]) -> Decision:
    """The verdict on a claim that something is there: every interval must lie above zero; the lowest is shown."""
    worst = min(intervals, key=lambda interval: interval.low)
    few = sum(interval.n < LEAST_CLIPS for interval in intervals)
    reason = f"{len(intervals)} intervals, the lowest shown" if len(intervals) > 1 else ""
    if any(interval.below() for interval in intervals):
        return Decision(FAILS, reason, worst, over=(1, worst.n))
    if all(interval.above() for interval in intervals) and not few:
        return Decision(HOLDS, reason, worst, over=(1, worst.n))
    reason = "; ".join(filter(None, (reason, f"{few} are over less than {LEAST_CLIPS} clips" if few else "")))
    return Decision(UNDECIDED, reason, worst, over=(1, worst.n), needed=(1, _clips_for(worst)))


def _clips_for(interval: Interval) -> int:
    """Clips at which a mean as large as this one's would lie above zero four times in five (a normal estimate)."""
    error, size = (interval.high - interval.low) / 3.92, abs(interval.mean)
    return max(LEAST_CLIPS, math.ceil(interval.n * (2.8 * error / size) ** 2)) if size > 0 else 0


def needed_for(found: Components, margin: float, says: str = "above") -> tuple[int, ...]:
    """Seeds and clips that would decide between no effect and twice the margin, each four times in five at least.

    As many seeds as `CLIPS` clips need; where no number does, the pair with the smallest product; empty where there is
    none.
    """
    seeds, clips = np.meshgrid(_SEEDS, np.append(_CLIPS[_CLIPS != CLIPS], CLIPS), indexing="ij")
    error, freedom = satterthwaite(found.seed, found.clip, found.rest, seeds, clips)
    with np.errstate(divide="ignore"):
        decided = 2 * t.cdf(margin / error - t.ppf(0.95, freedom), freedom) - 1 >= POWER
        if says != "alike":
            decided &= t.cdf(2 * margin / error - t.ppf(0.975, freedom), freedom) >= POWER
    whole = decided & (clips == CLIPS)
    pick = whole if whole.any() else decided
    if not pick.any():
        return ()
    place = np.unravel_index(np.argmin(np.where(pick, seeds * clips, np.inf)), seeds.shape)
    return int(seeds[place]), int(clips[place])
