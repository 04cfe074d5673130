"""The rows' figures put into the papers' tables.

Nothing is trained or measured here: what the cells hold is averaged over seeds and clips, with 95 % intervals over both
(`eval.crossed`), and shown beside the papers' figures. Under each table stand the references and the controls. A column
in which a control does as well as `ours` or better bears (!), and is named below: it cannot tell good motion from bad
in that respect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from eval import stats
from eval.crossed import crossed
from eval.metrics import pmb
from eval.rows import CONTROLS, FLOOR, OURS, PERFORMER, REFERENCES, SYSTEMS, TABLES, racer, rg
from eval.rows.cells import Cells, weights_of
from eval.rows.row import COLUMNS, DECIDED, DECISIONS, PLAYED, PaperTable, RowColumn, TableLine
from eval.table import Cell, Column, Table

Rows = Mapping[str, Mapping[str, Any]]
"""`eval.rows.cells.summaries`."""


def mean_of(rows: Rows, name: str, key: str) -> float:
    """A row's mean by a column; NaN where it was not run."""
    return float(rows[name]["figures"][key].mean) if name in rows else float("nan")


def beaten(rows: Rows, key: str, suffix: str = "") -> dict[str, float]:
    """The controls that do as well as `ours` or better by a column, with their values; of another split by suffix."""
    good, ours = COLUMNS[key].good, mean_of(rows, OURS, key)
    aim = mean_of(rows, PERFORMER + suffix, key) if good == "near" else 0.0
    if not good or not np.isfinite(ours + aim):
        return {}

    def badness(value: float) -> float:
        return -value if good == "high" else abs(value - aim)

    found = {name: mean_of(rows, name + suffix, key) for name in CONTROLS if name != FLOOR}
    return {name: value for name, value in found.items() if np.isfinite(value) and badness(value) <= badness(ours)}


def _lines(table: PaperTable, rows: Rows, suffix: str) -> list[TableLine]:
    """What stands in a table, in order, by the names of the rows on its split."""
    beside = {**REFERENCES, **CONTROLS}
    lines = [replace(line, row=line.row + suffix) if line.row in beside else line for line in table.lines]
    if not table.references:
        return [line for line in lines if line.row in rows]
    there = {line.row for line in lines}
    more = [(name, name) for name, row in rows.items() if row["kind"] == "system" and table.split == "test"]
    more += [(f"{name}: {about}", name + suffix) for name, about in beside.items() if name + suffix in rows]
    return [*lines, *(TableLine(label, name) for label, name in more if name not in there)]


def _label(line: TableLine, rows: Rows, refused: Mapping[str, str]) -> str:
    row = rows.get(line.row)
    if row is None:
        why = "not handed in" if line.row in SYSTEMS else refused.get(line.row, "not run")
        return f"{line.label} ({why})"
    same = f" = {row['run_as']}" if row["run_as"] != line.row and line.row in racer.ROWS else ""
    undecided = "" if row["decided"] else f" (undecided: {len(row['seeds'])} of {DECIDED} seeds)"
    return line.label + same + undecided


def _paper(table: PaperTable, pair: tuple[float | None, float | None] | None) -> str:
    known = [] if pair is None else [value for value, place in zip(pair, table.places, strict=True) if place]
    return " / ".join("-" if value is None else f"{value:g}" for value in known)


def paper_table(title: str, rows: Rows, refused: Mapping[str, str]) -> Table:
    """One table of the paper: our figure, and the paper's in a column beside it where it has one."""
    table = TABLES[title]
    suffix = "" if table.split == "test" else f"-{table.split}"
    lines = _lines(table, rows, suffix)
    papers = {key for line in lines for key in line.paper}
    fooled = {key: beaten(rows, key, suffix) if table.references else {} for key in table.columns}
    columns: dict[str, Column] = {}
    for key, column in table.columns.items():
        columns[key] = replace(column.shown(), title=column.title + (" (!)" if fooled[key] else ""))
        if column.paper in papers:
            columns[f"{key}, paper"] = Column(f"the paper's, {' / '.join(filter(None, table.places))}")
    body: dict[str, dict[str, Cell]] = {}
    for line in lines:
        cells: dict[str, Cell] = dict(rows[line.row]["figures"]) if line.row in rows else {}
        cells |= {f"{key}, paper": _paper(table, line.paper.get(column.paper)) for key, column in table.columns.items()}
        body[_label(line, rows, refused)] = {key: cells.get(key) for key in columns}
    notes = [f"(!) {COLUMNS[key].heading}, {mean_of(rows, OURS, key):.{COLUMNS[key].digits}f}: no worse are "
             + ", ".join(f"{name} ({value:.{COLUMNS[key].digits}f})" for name, value in found.items()) + "."
             for key, found in fooled.items() if found]
    return Table(f"{title} ({table.split})", columns, body, "row", notes)


def curve_table(rows: Rows) -> Table:
    """RG Fig. 11 in numbers."""
    columns = {f"{delta:g}": Column(f"{delta:g} s", digits=1) for delta in pmb.DELTAS}
    return Table("PMB, %, by delta (RG Fig. 11)", columns, {
        name: dict(zip(columns, row["pmb_curve"], strict=True)) for name, row in rows.items() if row["pmb_curve"]},
        "row")


SETTLED = 0.01
"""Share of its validation figure that a stage gains in the last quarter of its training where it is as good as done."""


def training_table(rows: Rows) -> Table:
    """What each row changes, what its training took, and how far it was from done."""
    columns = {"settings": Column("settings"), "seconds": Column("training by seed", "s"),
               "late": Column("most that a stage's validation gained in its last quarter", "%", 1, "low")}
    return Table("What rows change", columns, {
        name: {"settings": " ".join(row["settings"]), "seconds": ", ".join(f"{s:.0f}" for s in row["seconds"]),
               "late": 100.0 * max(row["late_gains"].values()) if row.get("late_gains") else None}
        for name, row in rows.items() if row["kind"] == "row"}, "row", [
            f"A training is done where that is at most {100 * SETTLED:g} %."])


def racer_fgd(rows: Rows) -> Table:
    """FGD of the first seed's set, by each network (see `eval.fgd`)."""
    body: dict[str, dict[str, Cell]] = {}
    columns: dict[str, Column] = {}
    for name, row in rows.items():
        if name in racer.ROWS and row["fgd"]:
            body[name] = {}
            for figure in row["fgd"][0]:
                key = f"{figure['features']}, {figure['frames']} at {figure['fps']:g} fps"
                columns[key] = Column(key)
                body[name][key] = replace(stats.Interval.from_dict(figure["interval"]), mean=figure["distance"])
    return Table("RACER Table 2, FGD of the first seed's set", columns, body, "row")


# -------------------------------------------------------------------------------------------------------- differences

def pairs(first: Mapping[int, Mapping[str, Any]], second: Mapping[int, Mapping[str, Any]], key: str
          ) -> tuple[list[int], np.ndarray[Any, np.dtype[np.float64]]]:
    """Seeds, and [seeds, clips] first less second, on those that both have; what has no seed pairs with all."""
    shared = sorted(set(first) & set(second))
    if (set(first) == {0}) != (set(second) == {0}):
        shared = sorted({*first, *second} - {0})
    if not shared:
        return [], np.zeros((0, 0))
    sides = [[{clip["name"]: clip.get(key, np.nan) for clip in cells.get(seed, cells.get(0, {"clips": []}))["clips"]}
              for seed in shared] for cells in (first, second)]
    names = [name for name in sides[0][0] if all(name in values for side in sides for values in side)]
    ours, theirs = (np.array([[values[name] for name in names] for values in side], dtype=np.float64) for side in sides)
    return shared, np.asarray(ours - theirs)


def difference(cells: Cells, first: str, second: str, key: str, column: RowColumn) -> stats.Interval:
    """A row less another by a column, paired over seeds and clips."""
    shared, apart = pairs(cells[first], cells[second], key)
    if not apart.size:
        return stats.Interval.undefined()
    weights = weights_of([cells[first][seed] for seed in shared], key, column) if column.by_blocks else None
    return crossed(apart, weights)


def difference_table(cells: Cells) -> Table:
    """What `ours` is less each other row of the papers' tables, beside the papers' own (on Trinity)."""
    lines = [line for title in ("RG Table 1", "RG Table 2", "RG Table 4", "RG Table 6", "RG Table 7")
             for line in TABLES[title].lines]
    papers: dict[str, dict[str, float]] = {}
    for line in lines:
        known = {key: pair[0] for key, pair in line.paper.items() if pair[0] is not None}
        papers.setdefault(line.row, {}).update(known)
    keys = ("pmb_above_chance", "fgd", "diversity")
    columns = {key: COLUMNS[key].shown() for key in keys} | {
        f"{key}, paper": Column(f"the paper's {COLUMNS[key].heading}", digits=1) for key in ("pmb", "fgd")}
    body: dict[str, dict[str, Cell]] = {}
    for row in dict.fromkeys(line.row for line in lines if line.row in rg.ROWS and line.row != OURS):
        if row in cells and OURS in cells:
            body[row] = {key: difference(cells, OURS, row, key, COLUMNS[key]) for key in keys}
            body[row] |= {f"{key}, paper": papers[OURS][key] - papers[row][key] for key in ("pmb", "fgd")
                          if key in papers[row]}
    return Table("Ours less each row", columns, body, "row")


def racer_differences(cells: Cells) -> list[Table]:
    """RACER's own row less each other, by every column that decisions are judged by."""
    others = [name for name in racer.ROWS if name in cells and racer.OURS in cells
              and next(iter(cells[name].values())).get("run_as", name) != racer.OURS and name != racer.OURS
              and set(cells[name]) & set(cells[racer.OURS])]
    return [Table(f"RACER Table 2, differences, {part}", {key: column.shown() for key, column in columns.items()}, {
        f"{racer.OURS} - {name}": {key: difference(cells, racer.OURS, name, key, column)
                                   for key, column in columns.items()} for name in others}, "row")
            for part, columns in DECISIONS.items() if part != PLAYED]


# ---------------------------------------------------------------------------------------------------------- all of it

def about(facts: Mapping[str, Any]) -> Table:
    """What the tables are of; its facts are the rows' figures by every column."""
    plain = {name: {**row, "figures": {key: value.to_dict() for key, value in row["figures"].items()}}
             for name, row in facts["rows"].items()}
    told = facts["store"]
    return Table("Ablation", {}, {}, notes=[
        f"Preset {facts['preset']}; test split: {told['test_recordings']} recordings. Means over seeds and clips with "
        "95 % intervals by variance components. The paper's figures are of other data, another skeleton and "
        "another network for FGD: compare the order, not the values. FGD, diversity and motion variance are means of "
        "the jackknife's values, so less biased than the figures of the sets (in the JSON). (!): a control, motion "
        "that is known to be wrong, does as well as `ours` or better.",
        *facts.get("notes", ()), *(f"Not run: {name}: {why}." for name, why in facts["refused"].items())],
        facts={**facts, "rows": plain})


def all_tables(cells: Cells, facts: Mapping[str, Any]) -> list[Table]:
    """Every table; facts: "preset", "store", "refused" and "rows", the summaries of the cells."""
    rows: Rows = facts["rows"]
    tables = [about(facts), *(paper_table(title, rows, facts["refused"]) for title in rg.TABLES), curve_table(rows),
              difference_table(cells)]
    if any(name in rows for name in racer.ROWS):
        tables += [*(paper_table(title, rows, facts["refused"]) for title in racer.TABLES), racer_fgd(rows),
                   *racer_differences(cells)]
    return [*tables, training_table(rows)]
