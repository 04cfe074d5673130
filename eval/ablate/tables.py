"""The rows' figures put into the papers' tables, and the files that hold them.

Nothing is trained or measured here: what the cells hold is averaged over seeds and clips, with 95 % intervals over both
(`eval.crossed`), and shown beside the papers' figures. Under each table stand the references and the controls. A column
in which a control does as well as `ours` or better bears (!), and is named below: it cannot tell good motion from bad
in that respect.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from eval.ablate.cells import Cells, CellStore, summaries
from eval.ablate.earlier import claims_with, facts_of, run_name, tables_with
from eval.ablate.rows import (
    COLUMNS,
    CONTROLS,
    DECIDED,
    DOSED,
    OURS,
    PERFORMER,
    REFERENCES,
    SYSTEMS,
    TABLES,
    PaperTable,
    TableLine,
    base,
    is_racer,
)
from eval.ablate.verdicts import NOT_RUN, beaten_by, claims_table
from eval.metrics import pmb
from eval.table import Cell, Column, Provenance, Table, load_with_provenance, save
from gesticulator.bundle import config as configs
from gesticulator.training.presets import PRESETS

COMMAND = "gesticulator ablate --tables"
Rows = Mapping[str, Mapping[str, Any]]
"""`eval.ablate.cells.summaries`."""


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


def paper_table(title: str, rows: Rows, cells: Cells) -> Table:
    """One table of the paper: our figure, and the paper's in a column beside it where it has one."""
    table = TABLES[title]
    suffix = "" if table.split == "test" else f"-{table.split}"
    lines = _lines(table, rows, suffix)
    papers = {key for line in lines for key in line.paper}
    # A table without references has no controls by which a column could be refuted.
    standard = OURS if table.split == "test" else next(table.claims).first
    fooled = {key: [name for name in beaten_by(key, cells, table.split, standard) if not name.endswith(NOT_RUN)]
              if table.references and standard in rows else [] for key in table.columns}
    columns: dict[str, Column] = {}
    for key in table.columns:
        # The mark stands in the heading, since it is about the measure and not about a row.
        columns[key] = replace(_plain(key), title=COLUMNS[key].title + (" (!)" if fooled[key] else ""))
        if COLUMNS[key].paper in papers:
            columns[f"{key}, paper"] = Column(f"the paper's, {' / '.join(table.places)}")
    body: dict[str, dict[str, Cell]] = {}
    for line in lines:
        figures: dict[str, Cell] = dict(rows[line.row]["figures"]) if line.row in rows else {}
        figures |= {f"{key}, paper": " / ".join(f"{value:g}" if math.isfinite(value) else "-" for value in
                                              line.paper.get(COLUMNS[key].paper, ())) for key in table.columns}
        body[_label(line, rows)] = {key: figures.get(key) for key in columns}
    notes = [f"(!) {COLUMNS[key].heading}: no worse are {', '.join(names)}." for key, names in fooled.items() if names]
    return Table(f"{title} ({table.split})", columns, body, "row", notes)


def curve_table(rows: Rows) -> Table:
    """RG Fig. 11 in numbers."""
    columns = {f"{delta:g}": Column(f"{delta:g} s", digits=1) for delta in pmb.DELTAS}
    return Table("PMB, %, by delta (RG Fig. 11)", columns, {
        name: dict(zip(columns, row["pmb_curve"], strict=True)) for name, row in rows.items() if row["pmb_curve"]},
        "row")


def parts_table(rows: Rows) -> Table:
    """Positive controls of rows and doses of damage: what has to be so if the other tables are to mean anything."""
    columns = {"own_code": _plain("own_code"), "fgd": _plain("fgd")}
    shown = {name: row["figures"] for name, row in rows.items() if row["figures"]["own_code"].n or name in DOSED}
    return Table("Positive controls and doses of damage", columns, {
        name: {"own_code": figures["own_code"], "fgd": figures["fgd"] if name in DOSED else None}
        for name, figures in shown.items()}, "row", [
        "A row's lexemes do something where the interval lies above 0. FGD must rise with the dose."])


# ---------------------------------------------------------------------------------------------------------- all of it

def corpus_table(facts: Mapping[str, Any], run: Provenance) -> Table:
    """The data and their limits, which a reader has to know before any figure. run: of the rows."""
    store = facts["store"]
    title = ("The corpus is synthetic, made by rule" if store.get("name") == PERFORMER
             else f"The corpus is {store.get('name', 'not recorded')}")
    planted = "Links between speech and motion are planted in it. " if store.get("name") == PERFORMER else ""
    return Table(title, {}, {}, notes=[
        f"{planted}Fingerprint {str(store.get('fingerprint', '-'))[:12]}, {store['test_recordings']} test recordings. "
        f"Every row is trained on it from the preset {facts['preset']}; no shipped bundle is measured, but where a "
        "line names one.", *edition(facts, run)])


def edition(facts: Mapping[str, Any], run: Provenance) -> list[str]:
    """Says of rows that the preset has since left behind when they were run; nothing of others."""
    if facts["preset"] in PRESETS and facts.get("system") == configs.digest(base(facts["preset"])):
        return []
    return [f"All rows are of an earlier system than today's preset {facts['preset']}, run by `{run.command}` at "
            f"commit {run.commit}, {run.date}: figures of that commit, until they are run again."]


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
          decided: Provenance | None = None, earlier: Path | None = None) -> None:
    """OUT/table.json and claims.json beside OUT, each with its Markdown.

    facts: "preset", "store", "refused" and "rows", the summaries of the cells. about: where the cells come from;
    decided: where the verdicts do, if they are of another commit; earlier: the results of an earlier run, which has
    what this one lacks (`eval.ablate.earlier`).
    """
    rows: Rows = facts["rows"]
    # RACER's table has no line where none of its rows was run.
    titles = [title for title in TABLES if title != "RACER Table 2" or any(map(is_racer, rows))]
    shown = [*(paper_table(title, rows, cells) for title in titles),
             *filter(lambda table: table.rows, (curve_table(rows), parts_table(rows)))]
    claims = claims_table(cells)
    if earlier is not None:
        shown = tables_with(shown, earlier)
        claims = claims_with(claims, run_name(about, dict(facts)), earlier)
    save([corpus_table(facts, about), about_table(facts), *shown], out / "table.json", about)
    save([corpus_table(facts, about), claims], out.parent / "claims.json", decided or about)


def redraw(out: Path, earlier: Path | None = None) -> None:
    """The tables and claims from the cells that are there; what they are of is read from table.json.

    InputError without either.
    """
    cells = CellStore(out).read()
    if not cells:
        raise InputError(out, "holds no cells", "run the rows first")
    # Cells carry figures alone; preset, store and provenance are those of the run that made them.
    tables, about = load_with_provenance(out / "table.json")
    facts = facts_of(tables, out / "table.json")
    write(cells, {**facts, "rows": summaries(cells)}, out, about, Provenance.now(COMMAND), earlier)
