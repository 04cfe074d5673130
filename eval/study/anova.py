"""Analysis of the ratings of a user study: means, one-way ANOVA and Tukey's test, ranks (RG 7.3.3; RACER Figure 4).

Theory: one-way ANOVA asks whether systems differ at all, F = (spread between systems) / (spread within); Tukey's honest
significant difference asks which pairs do, at 5 % for all pairs together. Both take every rating as an independent
draw, as the paper does, though answers of one rater, and about one clip, are alike: where some raters prefer a system
and others do not, they find too much. So the bootstrap draws raters AND clips anew (crossed, Owen 2007): believe a
difference that both it and Tukey's test find. What fools all of it: raters who do not look. One who gives the same
answer to everything is named.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from data_module.errors import InputError, shown
from data_module.files import read_json, read_text
from data_module.types import Array
from eval.stats import LEVEL, Interval, crossed_means, limits, mean
from eval.table import Cell, Column, Table

COLUMNS = ("study", "rater", "item", "aspect", "rating")
"""Of a CSV file of ratings, one rating a row; others are ignored."""
_CONSTANT = 5
"""So many answers or more, all alike, name a rater."""
_LOWEST, _MOST_STEPS = 0, 100
"""The first step of a scale at least, and how many follow: each is a column of the tables."""
_SHARE = (LEVEL[1] - LEVEL[0]) / 100


class KeyItem(msgspec.Struct, frozen=True):
    """What an opaque id stands for: the number of a clip and the name of a system."""

    clip: int
    system: str


class Key(msgspec.Struct, frozen=True):
    """The secret of a study, key.json. items: every clip by every system, under its opaque id."""

    study: str
    systems: Annotated[tuple[str, ...], msgspec.Meta(min_length=2)]
    aspects: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    clips: tuple[Any, ...]
    scale: tuple[int, int]
    items: dict[str, KeyItem]


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


def read_key(path: Path) -> Key:
    """The key that `study make` wrote; InputError for anything else."""
    document = read_json(path, "give the file that was saved")
    try:
        key = msgspec.convert(document, Key)
        known = {(item.clip, key.systems.index(item.system)) for item in key.items.values()}
        # Every clip by every system: what the tables need, and no more than the file itself names.
        if known != {*itertools.product(range(min(len(key.clips), len(key.items))), range(len(key.systems)))} or any(
                len(set(names)) < len(names) for names in (key.systems, key.aspects)):
            raise ValueError("an item is missing, or a name is there twice")
    except (msgspec.ValidationError, ValueError):
        raise InputError(path, "is not the key of a study", "give the key.json that `study make` wrote") from None
    low, high = key.scale
    if not _LOWEST <= low < high <= _LOWEST + _MOST_STEPS:
        raise InputError(path, f"has a scale from {shown(low, 12)} to {shown(high, 12)}",
                         f"give whole numbers from {_LOWEST} to {_LOWEST + _MOST_STEPS}, the lesser first")
    return key


def read_answers(paths: Sequence[Path], key: Key) -> list[Answer]:
    """The answers of all files, .json or .csv as the page saves them; InputError names the first that cannot be."""
    return [_answer(row, key, path) for path in paths for row in _rows(path)]


def _rows(path: Path) -> list[dict[str, Any]]:
    try:
        if path.suffix.lower() == ".csv":
            table = csv.DictReader(io.StringIO(read_text(path, "give the file that was saved")))
            return [{name: row[name] for name in COLUMNS} for row in table]
        document = read_json(path, "give the file that was saved")
        return [{"study": document["study"], "rater": document["rater"], "item": str(answer["item"]), "aspect": aspect,
                 "rating": rating} for answer in document["answers"] for aspect, rating in answer["ratings"].items()]
    except (KeyError, TypeError, AttributeError, csv.Error):
        raise InputError(path, "is not a file of ratings",
                         f"give what the page saved; the columns of a table are {', '.join(COLUMNS)}") from None


def _answer(row: Mapping[str, Any], key: Key, path: Path) -> Answer:
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


def gather(answers: Sequence[Answer], key: Key, without: Sequence[str] = ()) -> Ratings:
    """The answers as a table, checked.

    A rating that is there twice, alike, counts once; twice and different is an InputError, for two raters must have
    used one number. Missing answers and raters who say one thing throughout are noted; the latter stay in unless
    `without` names them.
    """
    unknown = sorted(set(without) - {answer.rater for answer in answers})
    if unknown:
        raise InputError("--without", f"rater {unknown[0]} gave no answer", "name raters that are in the files")
    counted = [answer for answer in answers if answer.rater not in without]
    if not counted:
        raise InputError("ratings", "hold no answer", "give what the raters saved")
    # By length first, so that rater 10 comes after rater 9.
    raters = tuple(sorted({answer.rater for answer in counted}, key=lambda name: (len(name), name)))
    values = np.full((len(raters), len(key.clips), len(key.systems), len(key.aspects)), np.nan)
    doubled: Counter[str] = Counter()
    for answer in counted:
        item = key.items[answer.item]
        place = (raters.index(answer.rater), item.clip, key.systems.index(item.system),
                 key.aspects.index(answer.aspect))
        known = bool(np.isfinite(values[place]))
        doubled[answer.rater] += known
        if known and values[place] != answer.rating:
            raise InputError(answer.source, f"rater {answer.rater} rates {answer.item} twice and differently",
                             "give each rater a number of their own, or one file")
        values[place] = answer.rating
    notes = [f"left out on demand: rater {name}" for name in without]
    notes += [f"rater {name}: {n} answers are there twice and count once" for name, n in doubled.items() if n]
    wanted = len(key.items) * len(key.aspects)
    for name, given_by in zip(raters, values, strict=True):
        given = given_by[np.isfinite(given_by)]
        if len(given) < wanted:
            notes.append(f"rater {name}: {wanted - len(given)} of {wanted} answers are missing")
        if len(given) >= _CONSTANT and len(np.unique(given)) == 1:
            notes.append(f"rater {name}: gives {given[0]:g} to everything; consider --without {name}")
    return Ratings(key, raters, values, tuple(notes))


# ---------------------------------------------------------------- statistics

@dataclass(frozen=True)
class Anova:
    """One-way ANOVA: F, its p and both degrees of freedom, eta squared; NaN where `reason` says they are undefined."""

    f: float
    p: float
    df: tuple[int, int]
    eta_squared: float
    reason: str = ""

    def line(self) -> str:
        """For a table's notes."""
        if self.reason:
            return f"One-way ANOVA is not defined: {self.reason}."
        return (f"One-way ANOVA: F({self.df[0]}, {self.df[1]}) = {self.f:.2f}, p {_p(self.p, '= ')}, eta squared "
                f"{self.eta_squared:.3f}.")


def one_way(groups: Sequence[Array]) -> Anova:
    """One-way ANOVA of one array of ratings per system."""
    df = len(groups) - 1, sum(map(len, groups)) - len(groups)
    if min(map(len, groups)) < 2:
        return Anova(math.nan, math.nan, df, math.nan, "a system has fewer than two ratings")
    # Without spread inside the systems F is infinite and says nothing.
    within = sum(float(((group - group.mean()) ** 2).sum()) for group in groups)
    if within == 0:
        return Anova(math.nan, math.nan, df, math.nan, "no system's ratings differ among themselves")
    pooled = np.concatenate(list(groups))
    f, p = stats.f_oneway(*groups)
    return Anova(float(f), float(p), df, 1.0 - within / float(((pooled - pooled.mean()) ** 2).sum()))


def rank_counts(values: Array) -> NDArray[np.int64]:
    """[K, K]: how often system k took place 1..K among a rater's answers on a clip, values [R, C, K] (RACER Figure 4).

    A place is one more than the number of systems rated higher, so equals share the better place. Comparisons that
    lack an answer do not count.
    """
    systems = values.shape[2]
    whole = values.reshape(-1, systems)
    # A place among three is no place among four.
    whole = whole[np.isfinite(whole).all(axis=1)]
    places = (whole[:, None, :] > whole[:, :, None]).sum(axis=2)
    return np.stack([np.bincount(places[:, k], minlength=systems) for k in range(systems)])


def _t_interval(ratings: Array) -> Interval:
    """Student's interval of the mean, every rating taken as a draw of its own, as Figure 12's bars seem to be."""
    middle = mean(ratings)
    if len(ratings) < 2:
        return Interval.exact(middle, len(ratings))
    # Answers of one rater are alike, so this interval is too narrow: the bootstrap stands beside it.
    half = float(stats.t.ppf(0.5 + _SHARE / 2, len(ratings) - 1) * ratings.std(ddof=1) / math.sqrt(len(ratings)))
    return Interval(middle, middle - half, middle + half, len(ratings))


# ---------------------------------------------------------------- tables

def tables(ratings: Ratings, seed: int = 0) -> list[Table]:
    """For each aspect its systems and their pairs."""
    key, out = ratings.key, list[Table]()
    about = (f"Study {key.study}: {len(ratings.raters)} raters, {len(key.clips)} clips, {len(key.systems)} systems, "
             f"ratings from {key.scale[0]} (worst) to {key.scale[1]} (best). Intervals are of 95 %: t takes every "
             "rating as independent, the bootstrap draws raters and clips anew.")
    for number, aspect in enumerate(key.aspects):
        values = ratings.values[..., number]
        groups = [of_system[np.isfinite(of_system)] for of_system in np.moveaxis(values, 2, 0)]
        title, means, anova = aspect.replace("_", " "), crossed_means(values, seed), one_way(groups)
        notes = [] if out else [about, *(f"To be looked at: {note}." for note in ratings.notes)]
        out += [_systems(title, key, values, groups, means, [*notes, anova.line()]),
                _pairs(f"{title}, pairs", key.systems, groups, means, len(ratings.raters))]
    return out


def _systems(title: str, key: Key, values: Array, groups: Sequence[Array], means: Array, notes: Sequence[str]) -> Table:
    """Of each system its mean by both intervals, and how often it got each rating and took each place."""
    low, high = key.scale
    columns = {"ratings": Column("ratings"), "t": Column("mean, t"), "bootstrap": Column("mean, bootstrap"),
               **{f"rated {score}": Column(f"rated {score}") for score in range(low, high + 1)},
               "total": Column("total"),
               **{f"place {place + 1}": Column(f"place {place + 1}") for place in range(len(groups))}}
    ranks = rank_counts(values)
    rows: dict[str, dict[str, Cell]] = {name: {
        "ratings": len(group), "t": _t_interval(group), "bootstrap": limits(mean(group), means[:, k], len(group)),
        "total": int(group.sum()), **{f"rated {score}": int((group == score).sum()) for score in range(low, high + 1)},
        **{f"place {place + 1}": int(count) for place, count in enumerate(ranks[k])}}
        for k, (name, group) in enumerate(zip(key.systems, groups, strict=True))}
    return Table(title, columns, rows, "system", notes)


def _pairs(title: str, names: Sequence[str], groups: Sequence[Array], means: Array, raters: int) -> Table:
    """Tukey's test for each pair of systems, and the bootstrap interval of their difference from means [draws, K]."""
    columns = {"tukey": Column("difference, Tukey"), "p": Column("p"), "bootstrap": Column("difference, bootstrap")}
    # Where the analysis of variance is undefined Tukey's test is too; the bootstrap is not.
    test = None if one_way(groups).reason else stats.tukey_hsd(*groups)
    rows: dict[str, dict[str, Cell]] = {}
    for a, b in itertools.combinations(range(len(groups)), 2):
        apart = mean(groups[a]) - mean(groups[b])
        tukey, p = Interval.exact(apart, raters), math.nan
        if test is not None:
            bounds, p = test.confidence_interval(_SHARE), float(test.pvalue[a, b])
            tukey = Interval(apart, float(bounds.low[a, b]), float(bounds.high[a, b]), raters)
        rows[f"{names[a]} - {names[b]}"] = {"tukey": tukey, "p": _p(p), "bootstrap": limits(
            apart, means[:, a] - means[:, b], raters)}
    return Table(title, columns, rows, "pair")


def _p(value: float, sign: str = "") -> str:
    """p with the asterisks of RG Figure 12: one below 0.05, two below 0.01, three below 0.001."""
    if math.isnan(value):
        return "-"
    stars = sum(value < limit for limit in (0.05, 0.01, 0.001))
    return ("< 0.0001" if value < 1e-4 else f"{sign}{value:.4f}") + (" " + "*" * stars if stars else "")
