"""Analysis of the ratings of a user study: means, one-way ANOVA and Tukey's test, ranks (RG 7.3.3; RACER Figure 4).

Theory: one-way ANOVA asks whether systems differ at all, F = (spread between systems) / (spread within); Tukey's honest
significant difference asks which pairs do, at 5 % for all pairs together. Both take every rating as an independent
draw, as the paper does, though answers of one rater, and about one clip, are alike: where some raters prefer a system
and others do not, they find too much. So the bootstrap draws raters AND clips anew (crossed, Owen 2007): believe a
difference that both it and Tukey's test find. What fools all of it: raters who do not look. One who gives the same
answer to everything is named.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from data_module.errors import InputError
from data_module.files import read_json
from data_module.types import Array
from eval.stats import Interval, crossed_means, limits, mean
from eval.table import Cell, Column, Table

_CONSTANT = 5
"""So many answers or more, all alike, name a rater."""
SCALE = (1, 5)
"""1 is worst, 3 average, 5 best (RG 7.3.3)."""


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
    items: dict[str, KeyItem]


class RatedItem(msgspec.Struct, frozen=True):
    """An opaque id, and a rating for each aspect."""

    item: str
    ratings: dict[str, Annotated[int, msgspec.Meta(ge=SCALE[0], le=SCALE[1])]]


class RatingFile(msgspec.Struct, frozen=True):
    """What the page saves of one rater."""

    study: str
    rater: Annotated[str, msgspec.Meta(min_length=1)]
    answers: Annotated[tuple[RatedItem, ...], msgspec.Meta(min_length=1)]


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
    return key


def read_ratings(paths: Sequence[Path], key: Key) -> Ratings:
    """The answers of all files as the page saved them, as a table; InputError names the first that cannot be used."""
    files = {}
    for path in paths:
        try:
            files[str(path)] = file = msgspec.convert(read_json(path, "give the file that was saved"), RatingFile)
        except msgspec.ValidationError as error:
            raise InputError(path, f"is not a file of ratings: {error}", "give what the page saved") from None
        if file.study != key.study:
            raise InputError(path, f"belongs to study {file.study!r}, and the key to {key.study!r}",
                             "give ratings and key of one study")
    return gather(files, key)


def gather(files: Mapping[str, RatingFile], key: Key) -> Ratings:
    """Files of ratings by their names as a table, checked.

    A rating that is there twice, alike, counts once; twice and different is an InputError, for two raters must have
    used one number. Missing answers and raters who say one thing throughout are noted, and stay in.
    """
    # By length first, so that rater 10 comes after rater 9.
    raters = tuple(sorted({file.rater for file in files.values()}, key=lambda name: (len(name), name)))
    values = np.full((len(raters), len(key.clips), len(key.systems), len(key.aspects)), np.nan)
    for source, file in files.items():
        rated = [(answer.item, aspect, rating) for answer in file.answers for aspect, rating in answer.ratings.items()]
        for name, aspect, rating in rated:
            if name not in key.items or aspect not in key.aspects:
                raise InputError(source, f"rates {name!r} for {aspect!r}, which the key does not know")
            item = key.items[name]
            place = (raters.index(file.rater), item.clip, key.systems.index(item.system), key.aspects.index(aspect))
            if np.isfinite(values[place]) and values[place] != rating:
                raise InputError(source, f"rater {file.rater} rates {name} twice and differently",
                                 "give each rater a number of their own, or one file")
            values[place] = rating
    notes, wanted = [], len(key.items) * len(key.aspects)
    for name, by_rater in zip(raters, values, strict=True):
        given = by_rater[np.isfinite(by_rater)]
        if len(given) < wanted:
            notes.append(f"rater {name}: {wanted - len(given)} of {wanted} answers are missing")
        if len(given) >= _CONSTANT and len(np.unique(given)) == 1:
            notes.append(f"rater {name}: gives {given[0]:g} to everything; consider leaving that file out")
    return Ratings(key, raters, values, tuple(notes))


# ---------------------------------------------------------------- statistics

def one_way(groups: Sequence[Array]) -> tuple[float, float]:
    """F and p of a one-way ANOVA of one array of ratings per system; NaN where it is undefined."""
    # Without spread inside the systems F is infinite and says nothing.
    if min(map(len, groups)) < 2 or not any(np.ptp(group) for group in groups):
        return math.nan, math.nan
    f, p = stats.f_oneway(*groups)
    return float(f), float(p)


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


# ---------------------------------------------------------------- tables

def tables(ratings: Ratings) -> list[Table]:
    """For each aspect its systems and their pairs."""
    key, out = ratings.key, list[Table]()
    about = (f"Study {key.study}: {len(ratings.raters)} raters, {len(key.clips)} clips, {len(key.systems)} systems, "
             f"ratings from {SCALE[0]} (worst) to {SCALE[1]} (best). Intervals are of 95 %: the bootstrap draws raters "
             "and clips anew, Tukey's test takes every rating as independent.")
    for number, aspect in enumerate(key.aspects):
        values = ratings.values[..., number]
        groups = [of_system[np.isfinite(of_system)] for of_system in np.moveaxis(values, 2, 0)]
        title, means, (f, p) = aspect.replace("_", " "), crossed_means(values), one_way(groups)
        notes = [] if out else [about, *(f"To be looked at: {note}." for note in ratings.notes)]
        within = sum(map(len, groups)) - len(groups)
        notes.append("One-way ANOVA is not defined." if math.isnan(f) else
                     f"One-way ANOVA: F({len(groups) - 1}, {within}) = {f:.2f}, p {_p(p, '= ')}.")
        out += [_systems(title, key, values, groups, means, notes),
                _pairs(f"{title}, pairs", key.systems, groups, means, len(ratings.raters))]
    return out


def _systems(title: str, key: Key, values: Array, groups: Sequence[Array], means: Array, notes: Sequence[str]) -> Table:
    """Of each system its mean, and how often it took each place."""
    places, ranks = [f"place {place + 1}" for place in range(len(groups))], rank_counts(values)
    columns = {name: Column(name) for name in ("ratings", "mean, bootstrap", *places)}
    rows: dict[str, dict[str, Cell]] = {name: {
        "ratings": len(group), "mean, bootstrap": limits(mean(group), means[:, k], len(group)),
        **dict(zip(places, ranks[k].tolist(), strict=True))}
        for k, (name, group) in enumerate(zip(key.systems, groups, strict=True))}
    return Table(title, columns, rows, "system", notes)


def _pairs(title: str, names: Sequence[str], groups: Sequence[Array], means: Array, raters: int) -> Table:
    """Tukey's test for each pair of systems, and the bootstrap interval of their difference from means [draws, K]."""
    # Where the analysis of variance is undefined Tukey's test is too; the bootstrap is not.
    test = None if math.isnan(one_way(groups)[0]) else stats.tukey_hsd(*groups)
    rows: dict[str, dict[str, Cell]] = {}
    for a, b in itertools.combinations(range(len(groups)), 2):
        apart = mean(groups[a]) - mean(groups[b])
        tukey, p = Interval.exact(apart, raters), math.nan
        if test is not None:
            bounds, p = test.confidence_interval(0.95), float(test.pvalue[a, b])
            tukey = Interval(apart, float(bounds.low[a, b]), float(bounds.high[a, b]), raters)
        rows[f"{names[a]} - {names[b]}"] = {"Tukey": tukey, "p": _p(p), "bootstrap": limits(
            apart, means[:, a] - means[:, b], raters)}
    return Table(title, {name: Column(name) for name in ("Tukey", "p", "bootstrap")}, rows, "difference")


def _p(value: float, sign: str = "") -> str:
    """p with the asterisks of RG Figure 12: one below 0.05, two below 0.01, three below 0.001."""
    if math.isnan(value):
        return "-"
    stars = sum(value < limit for limit in (0.05, 0.01, 0.001))
    return ("< 0.0001" if value < 1e-4 else f"{sign}{value:.4f}") + (" " + "*" * stars if stars else "")
