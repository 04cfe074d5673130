"""The cells of an ablation read back, and put into the papers' tables (see `eval.ablate`).

Nothing is trained or measured here: what a folder of cells holds is averaged over seeds and clips, with bootstrap 95 %
intervals over both, and shown beside the papers' figures. Under each table stand the references and the controls. A
column in which a control does as well as `ours` or better bears (!), and is named below: it cannot tell good motion
from bad in that respect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.types import Array
from eval.ablations import CONTROLS, FLOOR, OURS, PERFORMER, REFERENCES, ROWS, SYSTEMS, TABLES, Paper
from eval.metrics import pmb
from eval.racer_ablation import interval_over
from eval.results import loaded

DECIDED = 3
"""Fewer seeds decide nothing."""
PAPERS_DELTA = 0.2


@dataclass(frozen=True)
class Column:
    """A figure of a table: its heading, its digits, the key of the paper's figures that stand beside it, and what is
    good: "low", "high", "near" (the performer's), or "" where no motion is judged by it."""

    title: str
    digits: int
    paper: str = ""
    good: str = ""


COLUMNS: dict[str, Column] = {
    "maje": Column("MAJE, mm", 1, "maje", "low"), "mad": Column("MAD, mm/s^2", 0, "mad", "low"),
    "fgd": Column("FGD", 2, "fgd", "low"), "pmb": Column(f"PMB at {PAPERS_DELTA} s, %", 1, "pmb", "high"),
    "pmb_above_chance": Column(f"PMB at {pmb.DELTA} s above chance, %", 1, "", "high"),
    "diversity": Column("diversity, nats", 2, "diversity", "near"),
    "variance": Column("motion variance", 3, "variance", "near"),
    "accuracy": Column("right, free-running, %", 1, "accuracy"),
    "teacher_forced": Column("right, teacher-forced, %", 1),
    "speech_speed": Column("hands in speech, m/s", 3, "", "near"),
    "silence_speed": Column("hands in silence, m/s", 3, "", "near"),
}
"""One value a clip."""


def file_of(out: Path, name: str, seed: int) -> Path:
    """Where a cell is kept."""
    return out / f"{name}-{seed}.json"


def finished(file: Path, key: str | None = None) -> dict[str, Any] | None:
    """What a file holds; None where it is missing, cut short, or of other settings than `key`."""
    try:
        known: dict[str, Any] = loaded(file.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return known if key in (None, known.get("key")) else None


Cells = dict[str, dict[int, dict[str, Any]]]
"""By row and seed; what has no seed is at 0."""


def read_cells(folder: Path, shared: str | None = None) -> Cells:
    """The finished cells of a folder; InputError when they do not stand on the same."""
    cells: Cells = {}
    stands = set()
    for file in sorted(folder.glob("*-*.json")):
        known = finished(file)
        if known is None or not {"row", "shared"} <= set(known) or shared not in (None, known["shared"]):
            continue
        stands.add(known["shared"])
        cells.setdefault(known["row"], {})[int(known["seed"])] = known
    if len(stands) > 1:
        raise InputError(folder, "holds figures of different presets, stores or versions", "keep them in two folders")
    return cells


def values_of(cells: Sequence[Mapping[str, Any]], key: str) -> Array:
    """[seeds, clips] of one column."""
    return np.array([[clip.get(key, float("nan")) for clip in one["clips"]] for one in cells], dtype=np.float64)


def tabled(cells: Cells) -> dict[str, Any]:
    """Every row's figures with their intervals over seeds and clips."""
    rows = {}
    for name, by_seed in cells.items():
        own = [by_seed[seed] for seed in sorted(by_seed)]
        rows[name] = {
            "settings": own[0]["settings"], "question": own[0]["question"], "kind": own[0].get("kind", "row"),
            "seeds": sorted(by_seed), "decided": set(by_seed) == {0} or len(by_seed) >= DECIDED,
            "seconds": [one["seconds"]["training"] for one in own if "seconds" in one],
            "pmb_curve": np.mean([one["sets"]["pmb_curve"]["percent"] for one in own], axis=0).tolist()
            if "pmb_curve" in own[0]["sets"] else [],
            "fgd": [one["sets"]["fgd"] for one in own if "fgd" in one["sets"]],
            "figures": {key: interval_over(values_of(own, key), np.ones(len(own[0]["clips"]))).to_dict()
                        for key in COLUMNS}}
    return rows


def beaten(rows: Mapping[str, Any], key: str, suffix: str = "") -> dict[str, float]:
    """The controls that do as well as `ours` or better by a column, with their values; of another split by suffix."""
    good, own = COLUMNS[key].good, _mean(rows, OURS, key)
    aim = _mean(rows, PERFORMER + suffix, key) if good == "near" else 0.0
    if not good or not np.isfinite(own + aim):
        return {}

    def badness(value: float) -> float:
        return -value if good == "high" else abs(value - aim)

    found = {name: _mean(rows, name + suffix, key) for name in CONTROLS if name != FLOOR}
    return {name: value for name, value in found.items() if np.isfinite(value) and badness(value) <= badness(own)}


def _mean(rows: Mapping[str, Any], name: str, key: str) -> float:
    return float(rows[name]["figures"][key]["mean"]) if name in rows else float("nan")


def _cell(value: Mapping[str, float], digits: int) -> str:
    if not np.isfinite(value["mean"]):
        return "-"
    return f"{value['mean']:.{digits}f} [{value['low']:.{digits}f}, {value['high']:.{digits}f}]"


def _paper(pair: tuple[float | None, float | None] | None) -> str:
    return "" if pair is None else " / ".join("-" if one is None else f"{one:g}" for one in pair)


def _stands(title: str, rows: Mapping[str, Any]) -> list[tuple[str, str, Paper]]:
    """What stands in a table, in order: for each line its heading, its row, and the paper's figures."""
    table = TABLES[title]
    suffix = "" if table.split == "test" else f"-{table.split}"
    beside = {**REFERENCES, **CONTROLS}
    stands = [(line.label, line.row + (suffix if line.row in beside else ""), line.paper) for line in table.lines]
    there = {row for _, row, _ in stands}
    more = [(name, name) for name, row in rows.items() if row["kind"] == "system" and table.split == "test"]
    more += [(f"{name}: {about}", name + suffix) for name, about in beside.items() if name + suffix in rows]
    return [*stands, *((label, name, {}) for label, name in more if name not in there)]


def table_lines(title: str, rows: Mapping[str, Any], refused: Mapping[str, str]) -> list[str]:
    """One table of the paper as Markdown: our figure, and the paper's in a column beside it where it has one."""
    table, stands = TABLES[title], _stands(title, rows)
    suffix = "" if table.split == "test" else f"-{table.split}"
    papers = {key for _, _, paper in stands for key in paper}
    fooled = {key: beaten(rows, key, suffix) for key in table.columns}
    heads = [f"{title} ({table.split})"]
    for key in table.columns:
        heads.append(COLUMNS[key].title + (" (!)" if fooled[key] else ""))
        if COLUMNS[key].paper in papers:
            heads.append(f"the paper's, {' / '.join(table.places)}")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for text, name, paper in stands:
        row = rows.get(name)
        if row is None:
            text += f" ({'not handed in' if name in SYSTEMS else refused.get(name, 'not run')})"
        elif not row["decided"]:
            text += f" (undecided: {len(row['seeds'])} of {DECIDED} seeds)"
        cells = [text]
        for key in table.columns:
            cells.append("-" if row is None else _cell(row["figures"][key], COLUMNS[key].digits))
            if COLUMNS[key].paper in papers:
                cells.append(_paper(paper.get(COLUMNS[key].paper)))
        lines.append("| " + " | ".join(cells) + " |")
    told = [f"(!) {COLUMNS[key].title}, {_mean(rows, OURS, key):.{COLUMNS[key].digits}f}: no worse are "
            + ", ".join(f"{name} ({value:.{COLUMNS[key].digits}f})" for name, value in own.items()) + "."
            for key, own in fooled.items() if own]
    return [*lines, *([""] if told else []), *told]


def markdown(result: Mapping[str, Any]) -> str:
    """All tables for a reader."""
    rows, told = result["rows"], result["store"]
    lines = [f"Preset {result['preset']}; test split: {told['test_recordings']} recordings. Means over seeds and clips "
             "with bootstrap 95 % intervals, both drawn anew. The paper's figures are of other data, another skeleton "
             "and another network for FGD: compare the order, not the values. FGD, diversity and motion variance "
             "are means of the jackknife's values, so less biased than the figures of the sets (in the JSON). (!): a "
             "control, motion that is known to be wrong, does as well as `ours` or better.", ""]
    for title in TABLES:
        lines += [*table_lines(title, rows, result["refused"]), ""]
    deltas = [f"{delta:g}" for delta in pmb.DELTAS]
    lines += ["| PMB, %, by delta in s (RG Fig. 11) | " + " | ".join(deltas) + " |", "|---" * (len(deltas) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(f"{value:.1f}" for value in row["pmb_curve"]) + " |"
              for name, row in rows.items() if row["pmb_curve"]]
    lines += ["", "| row | settings | seconds of training, by seed |", "|---|---|---|"]
    lines += [f"| {name} | {' '.join(row['settings'])} | {', '.join(f'{s:.0f}' for s in row['seconds'])} |"
              for name, row in rows.items() if name in ROWS]
    lines += ["", *(f"Not run: {name}: {why}." for name, why in result["refused"].items())]
    return "\n".join(lines).rstrip() + "\n"
