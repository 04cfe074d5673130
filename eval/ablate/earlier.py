"""What an earlier run has and this one lacks: rows may be run on several machines, a table and a claim from one each.

A corpus that is built on another machine differs in its last digits, and so do lexicons that are trained on it. So no
row is compared with one of another run: a table of the paper is that run's which has measured more of its lines, a
claim that run's which has both of its rows; where both runs have, this one's. Every line says which run it is of.

What fools it: the rows of two tables, such as `ours` in Tables 1 and 4, may be of two runs; compare within a table.
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from eval.ablate.verdicts import CLAIMS, WORDS, counted
from eval.stats import Interval
from eval.table import Cell, Column, Provenance, Table, load, load_with_provenance

RUN = "run"
"""The column of claims that names their run."""
_WORD = re.compile(rf"(?:^|: )({'|'.join(sorted(WORDS, key=len, reverse=True))})\b")


def run_name(about: Provenance, facts: dict[str, Any]) -> str:
    """A run by its commit and its corpus."""
    return f"{about.commit}, corpus {str(facts['store'].get('fingerprint', '-'))[:8]}"


def facts_of(tables: Sequence[Table], file: Path) -> dict[str, Any]:
    """What the tables of a run are of; InputError where they do not say it."""
    facts = next((table.facts for table in tables if "store" in table.facts), None)
    if facts is None:
        raise InputError(file, "holds no tables of an ablation", "name the folder of its table.json")
    return dict(facts)


def measured(table: Table) -> int:
    """Rows of which something was measured."""
    return sum(any(_finite(value) for value in row.values()) for row in table.rows.values())


def _finite(value: Cell) -> bool:
    if isinstance(value, Interval):
        return math.isfinite(value.mean)
    return isinstance(value, float) and math.isfinite(value)


def tables_with(tables: Sequence[Table], folder: Path) -> list[Table]:
    """A run's tables, each that of the earlier run (FOLDER/table.json) which has measured more of its rows."""
    others, about = load_with_provenance(folder / "table.json")
    name = run_name(about, facts_of(others, folder / "table.json"))
    earlier = {table.title: table for table in others if table.rows}
    chosen = [_with_run(earlier[table.title], name)
              if table.title in earlier and measured(earlier[table.title]) > measured(table) else table
              for table in tables]
    there = {table.title for table in tables}
    return [*chosen, *(_with_run(table, name) for title, table in earlier.items() if title not in there)]


def _with_run(table: Table, name: str) -> Table:
    # What was taken over before keeps the name of the run that measured it.
    known = any(note.startswith("Of the run ") for note in table.notes)
    return table if known else replace(table, notes=[*table.notes, f"Of the run {name}."])


def claims_with(claims: Table, name: str, folder: Path) -> Table:
    """A run's claims, and the earlier run's verdict (claims.json beside FOLDER) on each whose rows this one lacks.

    name: this run's. InputError without that file.
    """
    others = load(folder.parent / "claims.json")
    tables, about = load_with_provenance(folder / "table.json")
    run = run_name(about, facts_of(tables, folder / "table.json"))
    earlier = next((table for table in others if table.title == CLAIMS), None)
    if earlier is None:
        raise InputError(folder.parent / "claims.json", "holds no claims", "name the folder of an ablation's results")
    # By what is claimed, not by number: another edition may count another claim between.
    by_claim = {(row["where"], row["claim"]): row for row in earlier.rows.values()}
    rows: dict[str, dict[str, Cell]] = {}
    for number, row in claims.rows.items():
        other = by_claim.get((row["where"], row["claim"]))
        taken = other is not None and _lacks(row) and not _lacks(other)
        # What no table carries is of no run: it names its source.
        its_run = name if "paper" in row else None
        rows[number] = {RUN: run, **other} if taken and other else {**row, RUN: its_run}
    count = {reading: {word: Counter(word_of(str(row[reading])) for row in rows.values())[word] for word in WORDS}
             for reading in ("published", "valid")}
    return replace(claims, columns={**claims.columns, RUN: Column("run")}, rows=rows, notes=[counted(count)],
                   facts={"count": count})


def _lacks(row: Any) -> bool:
    return "(not run" in str(row["published"])


def word_of(verdict: str) -> str:
    """The word of `WORDS` with which a verdict begins, behind the column that it is by where it names one."""
    match = _WORD.search(verdict)
    if match is None:
        raise ValueError(f"no verdict in {verdict!r}")
    return match[1]
