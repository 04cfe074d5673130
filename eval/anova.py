"""What the ratings of a user study say: means, one-way ANOVA and Tukey's test, ranks (RG 7.3.3; RACER Figure 4).

Theory: one-way ANOVA asks whether systems differ at all, F = (spread between systems) / (spread within); Tukey's honest
significant difference asks which pairs do, at 5 % for all pairs together. Both take every rating as an independent
draw, as the paper does. That they are not: answers of one rater, and answers about one clip, are alike. Where raters
are strict or mild towards all systems alike, this only makes the tests miss more; where some raters prefer a system
and others do not, they find too much, because thirty answers of one rater count as thirty people. So the bootstrap
interval draws raters AND clips anew (crossed, Owen 2007), and for a pair of systems the difference in the same draws:
believe a difference that both it and Tukey's test find. What fools all of it: raters who do not look. One who gives
the same answer to everything is named.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from data_module.errors import InputError
from data_module.files import read_text
from data_module.types import Array
from eval.stats import Interval, crossed_means
from eval.table import Cell, Column, Table

DRAWS = 2000
LEVEL = 0.95
COLUMNS = ("study", "rater", "item", "aspect", "rating")
"""Of a CSV file of ratings, one rating a row; others are ignored."""
_CONSTANT = 5
"""So many answers or more, all alike, name a rater."""


@dataclass(frozen=True)
class Key:
    """What the page kept to itself: items maps an opaque id to (clip, system), both as numbers."""

    study: str
    systems: tuple[str, ...]
    aspects: tuple[str, ...]
    clips: int
    scale: tuple[int, int]
    items: dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Answer:
    """One rating, and the file it came in."""

    rater: str
    item: str
    aspect: str
    rating: int
    source: str


@dataclass(frozen=True)
class Ratings:
    """values [R raters, C clips, K systems, A aspects], NaN where an answer is missing; notes: what was odd."""

    key: Key
    raters: tuple[str, ...]
    values: Array
    notes: tuple[str, ...]


# ---------------------------------------------------------------- reading

def read_key(path: Path) -> Key:
    """The key that `study make` wrote; InputError for anything else."""
    told = _json(path)
    try:
        systems, (low, high) = tuple(told["systems"]), told["scale"]
        items = {name: (int(own["clip"]), systems.index(own["system"])) for name, own in told["items"].items()}
        key = Key(told["study"], systems, tuple(told["aspects"]), len(told["clips"]), (int(low), int(high)), items)
        if len(systems) < 2 or not all(0 <= clip < key.clips for clip, _ in items.values()):
            raise ValueError("an item belongs to no clip")
        return key
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(path, "is not the key of a study", "give the key.json that `study make` wrote") from None


def read_answers(paths: Sequence[Path], key: Key) -> list[Answer]:
    """The answers of all files, .json or .csv as the page saves them; InputError names the first that cannot be."""
    return [_answer(row, key, path) for path in paths for row in _rows(path)]


def _rows(path: Path) -> list[dict[str, Any]]:
    if path.suffix.lower() == ".csv":
        try:
            rows = list(csv.DictReader(io.StringIO(read_text(path, "give the file that was saved"))))
        except csv.Error as error:
            raise InputError(path, f"is not a table ({error})", "give the file that was saved") from None
        if rows and not set(COLUMNS) <= set(rows[0]):
            raise InputError(path, "is not a file of ratings", f"its columns must be {', '.join(COLUMNS)}")
        return rows
    told = _json(path)
    try:
        return [{"study": told["study"], "rater": told["rater"], "item": str(own["item"]), "aspect": aspect,
                 "rating": rating} for own in told["answers"] for aspect, rating in own["ratings"].items()]
    except (KeyError, TypeError, AttributeError):
        raise InputError(path, "is not a file of ratings", "give what the page saved") from None


def _answer(row: dict[str, Any], key: Key, path: Path) -> Answer:
    if row["study"] != key.study:
        raise InputError(path, f"belongs to study {row['study']!r}, and the key to {key.study!r}",
                         "give ratings and key of one study")
    if row["item"] not in key.items or row["aspect"] not in key.aspects:
        raise InputError(path, f"rates {row['item']!r} for {row['aspect']!r}, which the key does not know")
    rater, (low, high) = str(row["rater"] or "").strip(), key.scale
    if not rater:
        raise InputError(path, "has an answer without a rater", "each answer needs the rater's number")
    try:
        rating = float(row["rating"])
    except (TypeError, ValueError, OverflowError):
        rating = math.nan
    if not (rating.is_integer() and low <= rating <= high):
        raise InputError(path, f"rater {rater} gives {row['item']} {row['rating']!r} for {row['aspect']}",
                         f"ratings are whole numbers from {low} to {high}")
    return Answer(rater, row["item"], row["aspect"], int(rating), str(path))


def _json(path: Path) -> Any:
    try:
        return json.loads(read_text(path, "give the file that was saved"))
    except json.JSONDecodeError as error:
        raise InputError(path, f"is not JSON (line {error.lineno})", "give the file that was saved") from None


# ---------------------------------------------------------------- checking

def gather(answers: Sequence[Answer], key: Key, without: Sequence[str] = ()) -> Ratings:
    """The answers as a table, checked.

    A rating that is there twice, alike, counts once and is noted; twice and different is an InputError, for two raters
    must have used one number. Missing answers and raters who say one thing throughout are noted; the latter stay in
    unless `without` names them.
    """
    unknown = sorted(set(without) - {answer.rater for answer in answers})
    if unknown:
        raise InputError("--without", f"rater {unknown[0]} gave no answer", "name raters that are in the files")
    kept = [answer for answer in answers if answer.rater not in without]
    if not kept:
        raise InputError("ratings", "hold no answer", "give what the raters saved")
    raters = tuple(sorted({answer.rater for answer in kept}, key=lambda name: (len(name), name)))
    values = np.full((len(raters), key.clips, len(key.systems), len(key.aspects)), np.nan)
    first: dict[tuple[str, str, str], Answer] = {}
    doubled: dict[str, int] = defaultdict(int)
    for answer in kept:
        what = (answer.rater, answer.item, answer.aspect)
        doubled[answer.rater] += what in first
        known = first.setdefault(what, answer)
        if known.rating != answer.rating:
            raise InputError(answer.source, f"rater {answer.rater} rates {answer.item} twice and differently (also in "
                             f"{known.source})", "give each rater a number of their own, or one file")
        values[raters.index(answer.rater), *key.items[answer.item], key.aspects.index(answer.aspect)] = answer.rating
    notes = [f"left out on demand: rater {name}" for name in without]
    notes += [f"rater {name}: {n} answers are there twice and count once" for name, n in doubled.items() if n]
    return Ratings(key, raters, values, (*notes, *_remarks(raters, values, key)))


def _remarks(raters: Sequence[str], values: Array, key: Key) -> list[str]:
    """Who left something out, and who says the same of everything."""
    notes = []
    asked = np.zeros(values.shape[1:], dtype=bool)
    for clip, system in key.items.values():
        asked[clip, system] = True
    for name, own in zip(raters, values, strict=True):
        missing, given = int(np.isnan(own[asked]).sum()), own[np.isfinite(own)]
        if missing:
            notes.append(f"rater {name}: {missing} of {int(asked.sum())} answers are missing")
        if len(given) >= _CONSTANT and len(np.unique(given)) == 1:
            notes.append(f"rater {name}: gives {given[0]:g} to everything; consider --without {name}")
    return notes


# ---------------------------------------------------------------- statistics

def one_way(groups: Sequence[Array]) -> dict[str, Any]:
    """One-way ANOVA of one array of ratings per system: F, p, both degrees of freedom, eta squared.

    F, p and eta squared are None, and `reason` says why, where they are not defined.
    """
    count, between = sum(map(len, groups)), len(groups) - 1
    result: dict[str, Any] = {"F": None, "p": None, "df": [between, count - len(groups)], "eta_squared": None}
    if min(map(len, groups)) < 2:
        return {**result, "reason": "a system has fewer than two ratings"}
    within = sum(float(((own - own.mean()) ** 2).sum()) for own in groups)
    if within == 0:
        return {**result, "reason": "no system's ratings differ among themselves"}
    pooled = np.concatenate(list(groups))
    f, p = stats.f_oneway(*groups)
    share = 1.0 - within / float(((pooled - pooled.mean()) ** 2).sum())
    return {**result, "F": float(f), "p": float(p), "eta_squared": share}


def pairs(groups: Sequence[Array], draws: Array, names: Sequence[str]) -> list[dict[str, Any]]:
    """Tukey's test for each pair of systems, and the bootstrap interval of the pair's difference from draws [D, K]."""
    defined = one_way(groups)["F"] is not None
    told = stats.tukey_hsd(*groups) if defined else None
    limits = told.confidence_interval(LEVEL) if told is not None else None
    rows = []
    for a in range(len(groups)):
        for b in range(a + 1, len(groups)):
            row: dict[str, Any] = {"pair": [names[a], names[b]], "difference": _mean(groups[a], groups[b]),
                                   "p": None, "tukey": None, "bootstrap": _limits(draws[:, a] - draws[:, b])}
            if told is not None and limits is not None:
                row |= {"p": float(told.pvalue[a, b]), "tukey": [float(limits.low[a, b]), float(limits.high[a, b])]}
            rows.append(row)
    return rows


def rank_counts(values: Array) -> NDArray[np.int64]:
    """[K, K]: how often system k took place 1..K among a rater's answers on a clip, values [R, C, K] (RACER Figure 4).

    A place is one more than the number of systems rated higher, so equals share the better place. Comparisons that
    lack an answer do not count.
    """
    systems = values.shape[2]
    whole = values.reshape(-1, systems)
    whole = whole[np.isfinite(whole).all(axis=1)]
    places = (whole[:, None, :] > whole[:, :, None]).sum(axis=2)
    return np.stack([np.bincount(places[:, k], minlength=systems) for k in range(systems)])


def analyse(ratings: Ratings, seed: int = 0, draws: int = DRAWS) -> dict[str, Any]:
    """Every figure of the study, as plain values; None where something is not defined."""
    key = ratings.key
    aspects: dict[str, Any] = {}
    for number, aspect in enumerate(key.aspects):
        values = ratings.values[..., number]
        groups = [own[np.isfinite(own)] for own in np.moveaxis(values, 2, 0)]
        means = crossed_means(values, seed, draws)
        places = rank_counts(values)
        scores = np.arange(key.scale[0], key.scale[1] + 1)
        aspects[aspect] = {
            "systems": {name: {"ratings": len(own), "mean": _mean(own), "t": _t_interval(own),
                               "bootstrap": _limits(means[:, k]), "total": int(own.sum()),
                               "scores": [int((own == score).sum()) for score in scores],
                               "places": places[k].tolist()}
                        for k, (name, own) in enumerate(zip(key.systems, groups, strict=True))},
            "comparisons": int(places[0].sum()), "anova": one_way(groups), "pairs": pairs(groups, means, key.systems)}
    return {"study": key.study, "raters": len(ratings.raters), "clips": key.clips, "systems": list(key.systems),
            "scale": list(key.scale), "notes": list(ratings.notes), "aspects": aspects}


def _mean(own: Array, less: Array | None = None) -> float | None:
    """Mean of the ratings, less the mean of others where they are given."""
    if len(own) == 0 or (less is not None and len(less) == 0):
        return None
    return float(own.mean() - (0.0 if less is None else less.mean()))


def _t_interval(own: Array) -> list[float] | None:
    """Student's interval of the mean, every rating taken as a draw of its own, as Figure 12's bars seem to be."""
    if len(own) < 2:
        return None
    half = float(stats.t.ppf(0.5 + LEVEL / 2, len(own) - 1) * own.std(ddof=1) / math.sqrt(len(own)))
    return [float(own.mean()) - half, float(own.mean()) + half]


def _limits(drawn: Array) -> list[float] | None:
    finite = drawn[np.isfinite(drawn)]
    if len(finite) == 0:
        return None
    low, high = np.percentile(finite, [50 * (1 - LEVEL), 50 * (1 + LEVEL)])
    return [float(low), float(high)]


# ---------------------------------------------------------------- tables

def tables(ratings: Ratings, seed: int = 0, draws: int = DRAWS) -> list[Table]:
    """For each aspect its systems and their pairs; the raw figures of `analyse` are facts of the first."""
    result = analyse(ratings, seed, draws)
    low, high = result["scale"]
    about = (f"Study {result['study']}: {result['raters']} raters, {result['clips']} clips, {len(result['systems'])} "
             f"systems, ratings from {low} (worst) to {high} (best). Intervals are of 95 %: t takes every rating as "
             "independent, the bootstrap draws raters and clips anew.")
    out: list[Table] = []
    for aspect, own in result["aspects"].items():
        title = aspect.replace("_", " ")
        scores = {f"rated {score}": Column(f"rated {score}") for score in range(low, high + 1)}
        places = {f"place {place + 1}": Column(f"place {place + 1}") for place in range(len(own["systems"]))}
        columns = {"ratings": Column("ratings"), "t": Column("mean, t"), "bootstrap": Column("mean, bootstrap"),
                   **scores, "total": Column("total"), **places}
        rows: dict[str, dict[str, Cell]] = {
            name: {"ratings": s["ratings"], "total": s["total"],
                   **{key: _interval(s["mean"], s[key], s["ratings"]) for key in ("t", "bootstrap")},
                   **dict(zip(scores, s["scores"], strict=True)), **dict(zip(places, s["places"], strict=True))}
            for name, s in own["systems"].items()}
        out.append(Table(title, columns, rows, "system", [
            *([] if out else [about, *(f"To be looked at: {note}." for note in result["notes"])]),
            _anova_line(own["anova"])], {} if out else result))
        pair_columns = {"tukey": Column("difference, Tukey"), "p": Column("p"),
                        "bootstrap": Column("difference, bootstrap")}
        compared: dict[str, dict[str, Cell]] = {
            " - ".join(row["pair"]): {"p": _p(row["p"]), **{
                key: _interval(row["difference"], row[key], result["raters"]) for key in ("tukey", "bootstrap")}}
            for row in own["pairs"]}
        out.append(Table(f"{title}, pairs", pair_columns, compared, "pair"))
    return out


def _interval(mean: float | None, bounds: Sequence[float] | None, n: int) -> Interval:
    low, high = bounds if bounds is not None else (math.nan, math.nan)
    return Interval(math.nan if mean is None else mean, low, high, n)


def _anova_line(own: dict[str, Any]) -> str:
    if own["F"] is None:
        return f"One-way ANOVA is not defined: {own['reason']}."
    return (f"One-way ANOVA: F({own['df'][0]}, {own['df'][1]}) = {own['F']:.2f}, p {_p(own['p'], '= ')}, "
            f"eta squared {own['eta_squared']:.3f}.")


def _p(value: float | None, sign: str = "") -> str:
    """p with the asterisks of RG Figure 12: one below 0.05, two below 0.01, three below 0.001."""
    if value is None:
        return "-"
    stars = sum(value < limit for limit in (0.05, 0.01, 0.001))
    return ("< 0.0001" if value < 1e-4 else f"{sign}{value:.4f}") + (" " + "*" * stars if stars else "")
