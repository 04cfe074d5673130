"""The rows' figures put into the papers' tables, and the files that hold them.

Nothing is trained or measured here: what the cells hold is averaged over seeds and clips, with 95 % intervals over both
(`eval.crossed`), and shown beside the papers' figures. Under each table stand the references and the controls. A column
in which a control does as well as `ours` or better bears (!), and is named below: it cannot tell good motion from bad
in that respect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from eval.ablate.cells import Cells, CellStore, summaries
from eval.ablate.rows import (
    COLUMNS,
    CONTROLS,
    DECIDED,
    FLOOR,
    OURS,
    PERFORMER,
    REFERENCES,
    SYSTEMS,
    TABLES,
    PaperTable,
    TableLine,
    is_racer,
)
from eval.ablate.verdicts import claims_table
from eval.metrics import pmb
from eval.table import Cell, Column, Provenance, Table, load_with_provenance, save

COMMAND = "gesticulator ablate --tables"
Rows = Mapping[str, Mapping[str, Any]]
"""`eval.ablate.cells.summaries`."""


def mean_of(rows: Rows, name: str, key: str) -> float:
    """A row's mean by a column; NaN where it was not run."""
    return float(rows[name]["figures"][key].mean) if name in rows else math.nan


def beaten(rows: Rows, key: str, suffix: str = "") -> dict[str, float]:
    """The controls that do as well as `ours` or better by a column, with their values; of another split by suffix."""
    good, reference = COLUMNS[key].good, mean_of(rows, OURS, key)
    aim = mean_of(rows, PERFORMER + suffix, key) if good == "near" else 0.0
    if not good or not np.isfinite(reference + aim):
        return {}

    def badness(value: float) -> float:
        return -value if good == "high" else abs(value - aim)

    # The floor is a distance between halves and no motion that could be good or bad.
    values = {name: mean_of(rows, name + suffix, key) for name in CONTROLS if name != FLOOR}
    return {name: value for name, value in values.items()
            if np.isfinite(value) and badness(value) <= badness(reference)}


def _plain(key: str) -> Column:
    column = COLUMNS[key]
    return Column(column.title, column.unit, column.digits, column.good)


# -------------------------------------------------------------------------------------------------------- the papers'

def _lines(table: PaperTable, rows: Rows, suffix: str) -> list[TableLine]:
    """The rows of a table, in order, by the names of the rows on its split."""
    beside = {**REFERENCES, **CONTROLS}
    lines = [TableLine(line.label, line.row + suffix, line.paper) if line.row in beside else line
             for line in table.lines]
    if not table.references:
        return [line for line in lines if line.row in rows]
    there = {line.row for line in lines}
    more = [(name, name) for name, row in rows.items() if row["kind"] == "system" and table.split == "test"]
    more += [(f"{name}: {about}", name + suffix) for name, about in beside.items() if name + suffix in rows]
    return [*lines, *(TableLine(label, name) for label, name in more if name not in there)]


def _label(line: TableLine, rows: Rows) -> str:
    row = rows.get(line.row)
    if row is None:
        return f"{line.label} ({'no motion given' if line.row in SYSTEMS else 'not run'})"
    return line.label + ("" if row["decided"] else f" (undecided: {len(row['seeds'])} of {DECIDED} seeds)")


def paper_table(title: str, rows: Rows) -> Table:
    """One table of the paper: our figure, and the paper's in a column beside it where it has one."""
    table = TABLES[title]
    suffix = "" if table.split == "test" else f"-{table.split}"
    lines = _lines(table, rows, suffix)
    papers = {key for line in lines for key in line.paper}
    # A table without references has no controls by which a column could be refuted.
    fooled = {key: beaten(rows, key, suffix) if table.references else {} for key in table.columns}
    columns: dict[str, Column] = {}
    for key in table.columns:
        # The mark stands in the heading, since it is about the measure and not about a row.
        columns[key] = replace(_plain(key), title=COLUMNS[key].title + (" (!)" if fooled[key] else ""))
        if COLUMNS[key].paper in papers:
            columns[f"{key}, paper"] = Column(f"the paper's, {' / '.join(table.places)}")
    body: dict[str, dict[str, Cell]] = {}
    for line in lines:
        cells: dict[str, Cell] = dict(rows[line.row]["figures"]) if line.row in rows else {}
        cells |= {f"{key}, paper": " / ".join(f"{value:g}" if math.isfinite(value) else "-" for value in
                                              line.paper.get(COLUMNS[key].paper, ())) for key in table.columns}
        body[_label(line, rows)] = {key: cells.get(key) for key in columns}
    notes = [f"(!) {COLUMNS[key].heading}, {mean_of(rows, OURS, key):.{COLUMNS[key].digits}f}: no worse are "
             + ", ".join(f"{name} ({value:.{COLUMNS[key].digits}f})" for name, value in values.items()) + "."
             for key, values in fooled.items() if values]
    return Table(f"{title} ({table.split})", columns, body, "row", notes)


def curve_table(rows: Rows) -> Table:
    """RG Fig. 11 in numbers."""
    columns = {f"{delta:g}": Column(f"{delta:g} s", digits=1) for delta in pmb.DELTAS}
    return Table("PMB, %, by delta (RG Fig. 11)", columns, {
        name: dict(zip(columns, row["pmb_curve"], strict=True)) for name, row in rows.items() if row["pmb_curve"]},
        "row")


# ---------------------------------------------------------------------------------------------------------- all of it

def corpus_table(facts: Mapping[str, Any]) -> Table:
    """The data and their limits, which a reader has to know before any figure."""
    store = facts["store"]
    title = ("The corpus is synthetic, made by rule" if store.get("name") == PERFORMER
             else f"The corpus is {store.get('name', 'not recorded')}")
    planted = "Links between speech and motion are planted in it. " if store.get("name") == PERFORMER else ""
    return Table(title, {}, {}, notes=[
        f"{planted}Fingerprint {str(store.get('fingerprint', '-'))[:12]}, {store['test_recordings']} test recordings. "
        f"Every row is trained on it from the preset {facts['preset']}; no shipped bundle is measured."])


def about_table(facts: Mapping[str, Any]) -> Table:
    """How to read the tables; its facts are what they are of."""
    return Table("Ablation", {}, {}, notes=[
        "Means over seeds and clips with 95 % intervals by variance components. The "
        "paper's figures are of other data, another skeleton and another network for FGD: compare the order, not the "
        "values. FGD, diversity and motion variance are means of the jackknife's values, so less biased than the "
        "figures of the sets. (!): a control, motion that is known to be wrong, does as well as `ours` or better.",
        *facts.get("notes", ()), *(f"Not run: {name}: {why}." for name, why in facts["refused"].items())],
        facts={key: value for key, value in facts.items() if key != "rows"})


def write(cells: Cells, facts: Mapping[str, Any], out: Path, about: Provenance,
          decided: Provenance | None = None) -> None:
    """OUT/table.json and claims.json beside OUT, each with its Markdown.

    facts: "preset", "store", "refused" and "rows", the summaries of the cells. about: where the cells come from;
    decided: where the verdicts do, if they are of another commit.
    """
    rows: Rows = facts["rows"]
    # RACER's table has no line where none of its rows was run.
    titles = [title for title in TABLES if title != "RACER Table 2" or any(map(is_racer, rows))]
    save([corpus_table(facts), about_table(facts), *(paper_table(title, rows) for title in titles), curve_table(rows)],
         out / "table.json", about)
    save([corpus_table(facts), claims_table(cells)], out.parent / "claims.json", decided or about)


def redraw(out: Path) -> None:
    """The tables and claims from the cells that are there; what they are of is read from table.json.

    InputError without either.
    """
    cells = CellStore(out).read()
    if not cells:
        raise InputError(out, "holds no cells", "run the rows first")
    # Cells carry figures alone; preset, store and provenance are those of the run that made them.
    tables, about = load_with_provenance(out / "table.json")
    facts = next(table.facts for table in tables if "store" in table.facts)
    write(cells, {**facts, "rows": summaries(cells)}, out, about, Provenance.now(COMMAND))
