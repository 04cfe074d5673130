"""The first pages of the report: what holds of the papers, what does not, what could not be tested, and how it was.

All of it is read from claims.json (`eval.rows.decisions`); where that is not there the pages say so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from eval import crossed
from eval.rows import controls, verdicts
from eval.rows.verdicts import FAILS, HOLDS, NO_TEST, UNDECIDED
from eval.stats import Interval
from eval.table import Column, Table

Claim = Mapping[str, Any]
UNPRINTED = "the paper prints no effect"
_DIGITS = 2
COLUMNS = {"claim": Column("claim"), "paper": Column("the paper"), "here": Column("here"), "margin": Column("margin")}


def _claims(facts: Mapping[str, Any], word: str) -> list[tuple[int, Claim]]:
    """The claims of a verdict with their numbers; empty where the facts are of another form."""
    found = facts.get("claims")
    return [(number, claim) for number, claim in enumerate(found, start=1) if claim.get("verdict") == word] \
        if isinstance(found, list) else []


def _difference(claim: Claim) -> str:
    held = claim.get("difference")
    if not isinstance(held, Mapping):
        return "-"
    return f"{held['mean']:.4g}" if held["low"] == held["high"] else Interval.from_dict(held).text(_digits(held))


def _digits(held: Mapping[str, Any]) -> int:
    """As many as show the interval's width in two figures."""
    width = float(held["high"] or 0) - float(held["low"] or 0)
    return 0 if width >= 200 else 1 if width >= 2 else _DIGITS if width >= 0.1 else 3


def _sentence(claim: Claim) -> str:
    reason = str(claim.get("reason") or "")
    return f"{claim.get('where')}. {claim.get('sentence')}" + (f" ({reason})" if reason else "")


def _page(claims: Sequence[tuple[int, Claim]]) -> str:
    """A table of claims, a line each, by their numbers."""
    return Table("", COLUMNS, {str(number): {
        "claim": _sentence(claim), "paper": str(claim.get("paper") or "no figures"), "here": _difference(claim),
        "margin": _margin(claim)} for number, claim in claims}).markdown()


def _margin(claim: Claim) -> str | None:
    margin = claim.get("margin")
    return f"{margin:.3g}" if isinstance(margin, int | float) and math.isfinite(margin) else None


def failing_metrics(facts: Mapping[str, Any]) -> list[str]:
    """The metrics by which claims have no valid test, as motion that is known to be wrong does as well."""
    return list(dict.fromkeys(str(claim.get("sentence")).partition(":")[0] for _, claim in _claims(facts, NO_TEST)
                              if str(claim.get("reason")).partition("; beside")[0] != UNPRINTED))


def _effects(facts: Mapping[str, Any], word: str) -> str:
    """The effects of a verdict in a sentence."""
    found = facts.get("effects")
    named = [f"{effect['effect']} (claim {effect['claim']})" for effect in found if effect.get("verdict") == word] \
        if isinstance(found, list) else []
    return "; ".join(named)


def what_holds(facts: Mapping[str, Any]) -> list[str]:
    """One page: the effects and claims that hold."""
    claims = _claims(facts, HOLDS)
    return [f"Of the effects that the papers give their parts: {_effects(facts, HOLDS) or 'none'}.", "",
            f"{len(claims)} claims. The difference is first less second, with its 95 % interval over seeds and clips; "
            "the margin is half of the paper's effect.", "", _page(claims)]


def what_does_not(facts: Mapping[str, Any]) -> list[str]:
    """One page: the effects and claims that do not hold."""
    claims = _claims(facts, FAILS)
    return [f"Of the effects: {_effects(facts, FAILS) or 'none'}.", "",
            f"{len(claims)} claims: the opposite was found, or a difference so near to none that half of the paper's "
            "effect is excluded on both sides.", "", _page(claims)]


def what_is_open(facts: Mapping[str, Any]) -> list[str]:
    """Why claims have no valid test, counted; and the undecided ones, with what would decide them."""
    reasons: dict[str, list[int]] = {}
    for number, claim in _claims(facts, NO_TEST):
        reason = str(claim.get("reason") or "").partition("; beside it")[0]
        reasons.setdefault(reason, []).append(number)
    untested = Table("", {"claims": Column("claims"), "count": Column("how many", digits=0)}, {
        reason: {"claims": ", ".join(map(str, numbers)), "count": len(numbers)}
        for reason, numbers in sorted(reasons.items(), key=lambda item: -len(item[1]))}, "no valid test, because")
    still = Table("", {"claim": Column("claim"), "here": Column("here"), "needed": Column("seeds, clips to decide")}, {
        str(number): {"claim": _sentence(claim), "here": _difference(claim),
                      "needed": ", ".join(map(str, claim.get("needed") or [])) or None}
        for number, claim in _claims(facts, UNDECIDED)}, "undecided")
    return ["A claim has no valid test where the paper prints no effect, or where motion that is known to be wrong is "
            "no worse by its metric. It is undecided where the interval leaves both open; the last column is what "
            "would tell no effect from the paper's at 80 % power.", "", untested.markdown(), still.markdown()]


def method() -> list[str]:
    """The rule of verdicts, the controls and the intervals, from the modules that apply them."""
    lines = []
    for title, module in (("The rule", verdicts), ("Which metrics may carry a claim", controls),
                          ("Intervals", crossed)):
        lines += [f"### {title}", "", (module.__doc__ or "").strip(), ""]
    return lines


# ------------------------------------------------------------------------------------------- what a figure shows

Numbers = Mapping[str, Any]


def _styles(n: Numbers) -> str:
    told, ordered = [], []
    for feature in dict.fromkeys(name.partition(", asked")[0] for name in n if ", asked" in name):
        low, mid, high = (float(n[f"{feature}, asked {level}"]) for level in ("low", "mid", "high"))
        told.append(f"{feature} {low:.2f}, {mid:.2f} and {high:.2f}")
        ordered.append(low < mid < high)
    return f"{'; '.join(told)} where low, middle and high are asked for, " + (
        "all in that order" if all(ordered) else f"{sum(ordered)} of {len(ordered)} in that order")


def _timing(n: Numbers) -> str:
    rows = [name for name in ("ours", "performer", "shuffled") if name in n]
    return "; ".join(f"at {delta} s " + ", ".join(f"{name} {float(n[name][delta]):.0f} %" for name in rows)
                     for delta in ("0.1", "0.2") if all(delta in n[name] for name in rows))


def _sweep(n: Numbers) -> str:
    told = []
    for metric in ("FGD", "PMB at 0.1 s above chance, %"):
        values = {name.partition(" ")[0]: float(value) for name, value in n.items()
                  if name.endswith(f"lexemes, {metric}")}
        told.append(f"{metric} " + ", ".join(f"{value:.2g}" for value in values.values()) + " with "
                    + ", ".join(values) + " lexemes")
    return "; ".join(told)


def _levels(n: Numbers) -> str:
    return "; ".join(f"{who}: {float(n[f'{who}, low level, gain in nats']):.3f} nats from the low level, "
                     f"{float(n[f'{who}, high level, gain in nats']):.3f} from the high one" for who in
                     ("performer", "ours") if f"{who}, low level, gain in nats" in n)


SEEN: dict[str, Callable[[Numbers], str]] = {
    "RG Fig. 5 and 8a": lambda n: f"{100 * float(n['share_within_bounds']):.0f} % of the intervals between onsets of "
                                  f"{n['recordings']} recordings lie within the paper's bounds",
    "RG Fig. 6 and 8b": lambda n: f"{n['lexemes_used']} lexemes in {n['blocks']} blocks; of a block's ten neighbours "
                                  f"{100 * float(n['neighbours_in_latents']):.0f} % have its lexeme, so the clouds "
                                  "touch",
    "RG Fig. 10": _styles, "RG Fig. 11": _timing, "RG Fig. 14": _levels,
    "RG Fig. 15": lambda n: ", ".join(f"{value} {name.replace(', lexemes', '')}" for name, value in n.items())
                            + " lexemes in the motion",
    "RG Fig. 16": lambda n: ", ".join(f"{name} {float(value):.0f} %" for name, value in n.items())
                            + " of the motion's beats find an onset within 0.2 s",
    "RG Fig. 17": lambda n: ", ".join(f"{value} {name.replace(', lexemes', '')}" for name, value in n.items())
                            + " lexemes in the motion",
    "RG Fig. 18": _sweep,
}
"""By the paper's figure, what its numbers show."""


def seen(paper: str, numbers: Numbers) -> str:
    """A sentence about what is seen in a figure; empty where its numbers do not say."""
    try:
        told = SEEN[paper](numbers) if paper in SEEN else ""
    except (KeyError, ValueError, TypeError):
        return ""
    return f"Seen here: {told}." if told else ""
