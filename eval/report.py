"""Everything that was measured, on one page: `report.md`, and the same as one `report.html` that needs nothing else.

    python -m eval.report [--results docs/results] [--out docs/report] [--title TITLE]

The page is made of what the other commands have kept and measures nothing itself: the claims of both papers and what
became of them, the papers' tables with their figures beside ours, the figures, the metrics with their controls, all
other measurements, and the chapter of each metric from its own module. What is not there is named with the command that
makes it. The HTML is rendered from the Markdown, so that both say the same; pictures are inlined, nothing is fetched,
and the same inputs give the same bytes.

What fools it: it shows what lies in the folder, however old. The store's fingerprint in the first table tells whether
two parts are of one corpus.
"""

from __future__ import annotations

import argparse
import base64
import html
import importlib
import importlib.util
import math
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote

from data_module.errors import InputError, one_line_errors
from data_module.files import write_text
from eval import ablation_figures, ablation_tables, claims, racer_ablation
from eval.ablation_tables import COLUMNS, Cells
from eval.ablations import CONTROLS, ELSEWHERE, FLOOR, REAL_TAKE, REFERENCES, SYSTEMS, TABLES
from eval.claims import FAILS, HOLDS, UNDECIDED
from eval.metrics import pmb
from eval.results import loaded

if TYPE_CHECKING:
    from markdown_it.token import Token

TITLE = "Gesticulator: what was measured"
NO_VALUE = "-"
PAPERS = {"RG": "Rhythmic Gesticulator", "RACER": "RACER"}
OTHER_DATA = ("The papers' figures are of other data, another skeleton and another FGD network: "
              "compare the order, not the values.")
ABLATE = "eval.ablate --data STORE --work DIR"

OTHERS: dict[str, tuple[str, str]] = {
    "figures": ("The models on the test split", "python -m eval.figures --data STORE"),
    "policies": ("Lexeme interpreters as policies", "python -m eval.policies --data STORE --work DIR"),
    "rewards": ("Does RACER's reward rank?", "python -m eval.rewards --data STORE --work DIR"),
    "parts": ("What text and the learned speech levels bought", "python -m eval.parts --data STORE --work DIR"),
    "style_editing": ("Style editing (RG Fig. 10)", "python -m eval.style_editing --data STORE"),
    "gate": ("The gate between gesture and rest", "python -m eval.gate --data STORE"),
    "languages": ("Other languages (RG Fig. 13)", "python -m eval.languages --data SPEECH_FOLDER"),
    "two_languages": ("A speech encoder of two languages",
                      "python -m eval.two_languages --data STORE --other STORE2 --work DIR"),
    "speech_levels": ("What the speech levels tell (RG Fig. 14)", "python -m eval.speech_levels --data STORE"),
    "q_network": ("What a block costs the Q-network", "python benchmarks/q_network.py"),
    "racer_published": ("RACER at its published widths", "python benchmarks/racer_published.py"),
}
"""What other commands keep as RESULTS/NAME.md: a heading, and the command."""

PICTURES: dict[str, tuple[str, str, str]] = {
    "strip.png": ("RG Fig. 9", "A strip of generated motion",
                  "The example recording, seen from the front and from the side, with the way of the hands before each "
                  "figure, the sound and its beats. One clip, chosen by hand: it shows what motion looks like and "
                  "nothing about how good it is."),
    "style_editing.png": ("RG Fig. 10", "Style editing",
                          "What is asked (dashed) and what the motion does, on one clip and over clips."),
}
"""Pictures that other commands keep in `pictures` beside the results: the paper's figure, a title, a caption."""

METRICS = (*(f"metrics.{name}" for name in ("joint_error", "fgd", "gesture_features", "pmb", "diversity", "smoothness",
                                            "beat_consistency", "mismatch")), "baselines", "bootstrap")
"""The modules whose docstrings are the chapters."""

COMMANDS = """\
python -m data_module.build performer --out STORE          # a corpus, or see `python -m data_module.build --help`
python -m gesticulator.train --data STORE --out BUNDLE --work DIR
python -m eval.ablate --data STORE --work DIR              # every table and figure of both papers; resumes
python -m eval.racer_ablation --data STORE --work DIR --motion
python -m eval.claims                                      # what holds
python -m eval.score --truth STORE --system NAME=DIR --out docs/results/score.json
python -m eval.report                                      # this page
"""


# ------------------------------------------------------------------------------------------------- what is there

@dataclass(frozen=True)
class Drawn:
    """A figure. name: the paper's, such as "RG Fig. 11"; picture: its file, None where only the numbers are."""

    name: str
    title: str
    caption: str
    numbers: Mapping[str, Any]
    picture: Path | None


@dataclass(frozen=True)
class Kept:
    """What the other commands have left in `folder`. None, or empty: it is not there."""

    folder: Path
    ablation: dict[str, Any] | None
    cells: Cells
    racer: dict[str, Any] | None
    racer_cells: Cells
    score: dict[str, Any] | None
    figures: list[Drawn]
    unreadable: list[str]


def gather(results: Path) -> Kept:
    """Read a folder of results; InputError where nothing of what the report shows is in it."""
    if not results.is_dir():
        raise InputError(results, "is not a folder", "name the one that the evaluation commands write to")
    unreadable: list[str] = []

    def read(name: str) -> dict[str, Any] | None:
        return _json(results, name, unreadable)

    folder = results / "ablation"
    table = read("ablation/table.json")
    if table is not None and not isinstance(table.get("rows"), dict):
        unreadable.append("ablation/table.json")
        table = None
    cells = ablation_tables.read_cells(folder, table.get("shared") if table else None)
    if table is None and cells:
        table = {"rows": ablation_tables.tabled(cells)}
    kept = Kept(results, table, cells, read("racer/table.json"), claims.racer_cells(results / "racer"),
                read("score.json"), _figures(results, unreadable), unreadable)
    texts = [name for name in (*OTHERS, "score", "limits") if (results / f"{name}.md").is_file()]
    if not (kept.ablation or kept.racer or kept.racer_cells or kept.score or texts
            or any(own.picture is None or own.picture.parent == folder for own in kept.figures)):
        raise InputError(results, "holds no results", "run an evaluation command first: python -m eval --help")
    return kept


def _json(results: Path, name: str, unreadable: list[str]) -> dict[str, Any] | None:
    """A file's object; None where it is not there or, noted, cannot be read."""
    file = results / name
    if not file.is_file():
        return None
    try:
        found = loaded(file.read_text(encoding="utf-8"))
    except ValueError:
        found = None
    if isinstance(found, dict):
        return found
    unreadable.append(name)
    return None


def _figures(results: Path, unreadable: list[str]) -> list[Drawn]:
    """The ablation's figures and the pictures of other commands, in the papers' order."""
    found = []
    for file in sorted((results / "ablation").glob("*.json")):
        told = _json(results, f"ablation/{file.name}", unreadable)
        if told is not None and isinstance(told.get("figure"), str):
            picture = next((own for ending in (".svg", ".png") if (own := file.with_suffix(ending)).is_file()), None)
            numbers = told.get("numbers")
            found.append(Drawn(told["figure"], str(told.get("title", file.stem)), str(told.get("caption", "")),
                               numbers if isinstance(numbers, dict) else {}, picture))
    pictures = results.parent / "pictures"
    found += [Drawn(name, title, caption, {}, pictures / file) for file, (name, title, caption) in PICTURES.items()
              if (pictures / file).is_file()]
    return sorted(found, key=lambda own: (_place(own.name), own.title))


def _place(name: str) -> tuple[int, int, str]:
    """Where a figure of the papers stands: "RG Fig. 8b" is (0, 8, "b"); what has no number comes last."""
    found = re.search(r"(RG|RACER)\D*(\d+)\s*([a-z]?)", name)
    return (list(PAPERS).index(found[1]), int(found[2]), found[3]) if found else (len(PAPERS), 0, name)


# ------------------------------------------------------------------------------------------------ pieces of Markdown

def _cell(text: object) -> str:
    """Text that may stand in a table."""
    return re.sub(r"(?<!\\)\|", r"\\|", " ".join(str(text).split()))


def table(heads: Sequence[object], rows: Iterable[Sequence[object]]) -> list[str]:
    """A Markdown table."""
    return ["| " + " | ".join(map(_cell, heads)) + " |", "|---" * len(heads) + "|",
            *("| " + " | ".join(map(_cell, row)) + " |" for row in rows)]


def folded(title: str, lines: Sequence[str]) -> list[str]:
    """Lines that a reader opens."""
    return ["<details>", f"<summary>{html.escape(title, quote=False)}</summary>", "", *lines, "", "</details>"]


def _is_interval(value: Any) -> bool:
    return isinstance(value, dict) and {"mean", "low", "high"} <= set(value)


def shown(value: Any, digits: int | None = None) -> str:
    """A number, an interval or a list of numbers for a reader; "-" for what is undefined."""
    if _is_interval(value):
        mean, low, high = (shown(value.get(key), digits) for key in ("mean", "low", "high"))
        return mean if NO_VALUE in (mean, low, high) else f"{mean} [{low}, {high}]"
    if isinstance(value, list | tuple):
        return ", ".join(shown(own, digits) for own in value)
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return NO_VALUE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        if digits is not None:
            return f"{value:.{digits}f}"
        return f"{value:.4g}" if isinstance(value, float) else f"{value}"
    return str(value)


def numbers_table(numbers: Mapping[str, Any]) -> list[str]:
    """A figure's numbers: a line each, with columns where all entries are objects or lists of one shape."""
    if not numbers:
        return []

    def inner(value: Any) -> bool:
        return isinstance(value, dict) and not _is_interval(value)

    values = list(numbers.values())
    if all(inner(value) and not any(map(inner, value.values())) for value in values):
        heads = list(dict.fromkeys(key for value in values for key in value))
        if len(heads) <= _MANY:
            return table(["", *heads], [[name, *(shown(value[key]) if key in value else "" for key in heads)]
                                        for name, value in numbers.items()])
    if all(isinstance(value, list) and len(value) == len(values[0]) <= _MANY for value in values):
        first, *rest = numbers.items()
        return table([first[0], *map(shown, first[1])], [[name, *map(shown, value)] for name, value in rest])
    return table(["", "value"], [[name, _long(value)] for name, value in _flat("", numbers)])


_MANY = 24
"""Numbers in a line of a small table at most."""


def _flat(name: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict) and not _is_interval(value):
        return [one for key, own in value.items() for one in _flat(f"{name}, {key}" if name else str(key), own)]
    return [(name, value)]


def _long(value: Any) -> str:
    if isinstance(value, list) and len(value) > _MANY:
        return f"{len(value)} values, in the file"
    return shown(value)


def included(file: Path, out: Path) -> list[str]:
    """The lines of a Markdown file that another command keeps, as part of a page in `out`: headings below ours, links
    from here, "-" for NaN."""
    lines = []
    for line in file.read_text(encoding="utf-8").strip().splitlines():
        if line.startswith("|"):
            line = re.sub(r"(?<=\|) *nan(?: \[nan, nan\])? *(?=\|)", f" {NO_VALUE} ", line, flags=re.IGNORECASE)
        line = re.sub(r"^#{1,6}(?= )", "####", line)
        lines.append(re.sub(r"(?<=\]\()(?![a-z]+:|#|/)([^)\s]+)(?=\))",
                            lambda found: _relative(file.parent / found[1], out), line))
    return lines


def _relative(file: Path, out: Path) -> str:
    """A file as a link from `out`."""
    return quote(Path(os.path.relpath(file, out)).as_posix())


def _lacking(name: str, command: str) -> str:
    return f"`{name}` is not there: `{command}` makes it."


# --------------------------------------------------------------------------------------------------------- sections

def _about(kept: Kept, found: Mapping[str, Any], out: Path) -> list[str]:
    """What was run, in a few lines, and what became of it."""
    lines = ["What the evaluation commands have kept, beside what two papers print: *Rhythmic Gesticulator* (RG, "
             f"2022) and *RACER* (2023). {OTHER_DATA} `{NO_VALUE}` stands where a figure is undefined or was not "
             "measured.", "", *_summary(kept, found), ""]
    lines += table(["what", "store", "how", "seeds", "clips"], _runs(kept))
    lines += ["", f"A claim or a row is decided with {ablation_tables.DECIDED} seeds or more. Intervals are bootstrap "
              "95 %, over clips, and over seeds where there are several."]
    if kept.unreadable:
        names = ", ".join(f"`{name}`" for name in sorted(set(kept.unreadable)))
        lines += ["", f"Cannot be read, so left out: {names}."]
    limits = kept.folder / "limits.md"
    return [*lines, "", "### What this corpus cannot show", "", *included(limits, out)] if limits.is_file() else lines


def _summary(kept: Kept, found: Mapping[str, Any]) -> list[str]:
    count, rows = found["count"], found["claims"]
    untried = sum(row["verdict"] == UNDECIDED and row["difference"] is None for row in rows)
    lines = [f"> **Of {len(rows)} claims {count[HOLDS]} hold, {count[FAILS]} do not hold and {count[UNDECIDED]} are "
             f"undecided**, {untried} of these because nothing here tests them.", ">"]
    if kept.score is None:
        lines.append("> Which metrics a control beats is not known: " + _lacking("score.json", _SCORE))
    else:
        titles = dict.fromkeys(kept.score["metrics"][flag["metric"]]["title"] for flag in kept.score.get("flags", []))
        lines.append(f"> Metrics that a control beats (eval.score): {'; '.join(titles) or 'none'}.")
    marked = dict.fromkeys(head.replace("(!)", "").strip() for title in TABLES if kept.ablation
                           for head in _tabled(kept.ablation, title)[0].split("|") if "(!)" in head)
    if marked:
        lines += [">", f"> Columns of the tables in which a control does as well as the system: {'; '.join(marked)}."]
    return lines


_SCORE = "python -m eval.score --truth STORE --system NAME=DIR --out docs/results/score.json"


def _store(told: Any) -> str:
    told = told if isinstance(told, dict) else {}
    known = [str(told["name"])] if "name" in told else []
    return " ".join([*known, *([f"`{str(told['fingerprint'])[:12]}`"] if "fingerprint" in told else [])]) or NO_VALUE


def _seeds(by_row: Iterable[Iterable[int]]) -> str:
    return ", ".join(map(str, sorted({seed for seeds in by_row for seed in seeds} - {0}))) or NO_VALUE


def _runs(kept: Kept) -> list[list[str]]:
    """Of what corpus each part is, and of how much of it."""
    out = []
    if kept.ablation is not None:
        rows = kept.ablation["rows"]
        clips = max((cell.get("clips") or 0 for row in rows.values() if row.get("kind", "row") == "row"
                     for cell in row["figures"].values()), default=0)
        preset = kept.ablation.get("preset")
        out.append(["ablation", _store(kept.ablation.get("store")), f"{len(rows)} rows, "
                    + (f"preset `{preset}`" if preset else "of cells alone: the command has not finished"),
                    _seeds(row["seeds"] for row in rows.values()), str(clips)])
    if kept.racer is not None:
        told, how = kept.racer.get("store", {}), kept.racer.get("settings", {})
        rows = kept.racer.get("rows", {})
        out.append(["RACER's ablation", _store(told), f"{len(rows)} rows, {how.get('steps')} steps",
                    _seeds(row["seeds"] for row in rows.values()), str(told.get("test_recordings", NO_VALUE))])
    if kept.score is not None:
        told = kept.score
        out.append(["eval.score", NO_VALUE, f"{', '.join(told.get('systems', []))}; controls: "
                    f"{', '.join(told.get('controls', [])) or 'none'}; {told.get('fps', 0):g} fps", NO_VALUE,
                    f"{len(told.get('clips', []))} ({told.get('seconds', 0):.0f} s)"])
    return out or [["nothing", *[NO_VALUE] * 4]]


def _claims(found: Mapping[str, Any]) -> list[str]:
    """The papers' claims, by paper and table."""
    rows = found["claims"]
    lines = ["A difference is that of the first less the second, paired over seeds and clips. A claim holds when the "
             "whole interval lies on its side, does not hold when it lies on the other, and is undecided between. No "
             f"correction is made for their number. {OTHER_DATA}", ""]
    by: dict[str, list[Any]] = {}
    for row in sorted(rows, key=lambda row: _order(row["where"])):
        by.setdefault(row["where"], []).append(row)
    lines += table(["where", "claims", "hold", "do not hold", "undecided"],
                   [[where, len(own), *(sum(row["verdict"] == verdict for row in own)
                                        for verdict in (HOLDS, FAILS, UNDECIDED))] for where, own in by.items()])
    for short, paper in PAPERS.items():
        own = {where: claimed for where, claimed in by.items() if where.split()[0] == short}
        lines += ["", f"### Claims of {paper}"]
        for where, claimed in own.items():
            if not all(row.get("needs") for row in claimed):
                # The first column would say in each line what the heading says.
                lines += ["", f"#### {where}", "", *("|" + line.split("|", 2)[2] for line in _claim_table(claimed))]
        rest = [row for claimed in own.values() if all(row.get("needs") for row in claimed) for row in claimed]
        lines += ["", "#### Not to be tested by these rows", "", *_claim_table(rest)] if rest else []
    return lines


def _claim_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    told = claims.markdown({"claims": rows, "count": dict.fromkeys((HOLDS, FAILS, UNDECIDED), 0)})
    head, *lines = (line for line in told.splitlines() if line.startswith("|"))
    return [re.sub(r"\| \|$", "| verdict |", head), *lines]


def _order(where: str) -> tuple[int, bool, tuple[int, int, str]]:
    """By paper; tables first; by number."""
    return _place(where)[0], "Table" not in where, _place(where)


def _tables(kept: Kept, out: Path) -> list[str]:
    """The papers' tables, theirs beside ours."""
    lines = [OTHER_DATA]
    if kept.ablation is None:
        lines += ["", _lacking("ablation/table.json", f"python -m {ABLATE}")]
    else:
        lines += [*_network_lines(kept.ablation["rows"])]
        for title in TABLES:
            lines += ["", f"### {title}", "", *_tabled(kept.ablation, title), *_undefined(kept.ablation["rows"], title)]
        lines += ["", "### Rows", "", *_row_lines(kept.ablation)]
    return [*lines, "", "### RACER Table 2", "", *_racer_lines(kept, out)]


def _tabled(ablation: Mapping[str, Any], title: str) -> list[str]:
    rows = {name: {**row, "figures": {key: _without_null(cell) for key, cell in row["figures"].items()}}
            for name, row in ablation["rows"].items()}
    return ablation_tables.table_lines(title, rows, ablation.get("refused", {}))


def _without_null(cell: Mapping[str, Any]) -> dict[str, Any]:
    """NaN for null, which JSON of other programs has for it."""
    return {key: math.nan if value is None else value for key, value in cell.items()}


def _undefined(rows: Mapping[str, Any], title: str) -> list[str]:
    """Why a figure of this table is undefined, row by row."""
    of_table, told = TABLES[title], dict[str, list[str]]()
    suffix = "" if of_table.split == "test" else f"-{of_table.split}"
    names = dict.fromkeys([name for line in of_table.lines for name in (line.row, line.row + suffix)]
                          + [name + suffix for name in (*REFERENCES, *CONTROLS)])
    for name in names:
        for key in of_table.columns:
            cell = rows.get(name, {}).get("figures", {}).get(key)
            if cell is not None and shown(cell.get("mean")) == NO_VALUE:
                told.setdefault(_why(rows[name], name, key), []).append(f"{COLUMNS[key].title} of {name}")
    return ["", *(f"- Undefined: {', '.join(what)}: {why}" for why, what in told.items())] if told else []


def _why(row: Mapping[str, Any], name: str, key: str) -> str:
    """Why a row has no figure in a column."""
    if row["figures"][key].get("reason"):
        return str(row["figures"][key]["reason"])
    if key == "fgd":
        reasons = [str(one["reason"]) for by_seed in row.get("fgd", []) for one in by_seed[:1] if one.get("reason")]
        return reasons[0] if reasons else "it is not of the speech that the performer's windows are of"
    if key in ("accuracy", "teacher_forced"):
        unchosen = name.startswith((*REFERENCES, *CONTROLS, *SYSTEMS))
        return ("no interpreter chose its lexemes" if unchosen
                else "its lexicon is not the one that judges, so no lexeme is the right one")
    if name.startswith(FLOOR):
        return "a floor is of distances between sets"
    if name.startswith(REAL_TAKE) and key in ("maje", "mad"):
        return "there is no motion of the performer for that speech"
    return "not defined for these clips"


def _network_lines(rows: Mapping[str, Any]) -> list[str]:
    """What FGD is measured in, and by every network."""
    measured = {name: row["fgd"] for name, row in rows.items() if row.get("fgd") and row["fgd"][0]}
    if not measured:
        return []
    networks = next(iter(measured.values()))[0]

    def mean(seeds: Sequence[Sequence[Mapping[str, Any]]], which: int) -> str:
        got = [own[which]["distance"] for own in seeds if len(own) > which and own[which]["distance"] is not None]
        few = any(own[which].get("reason") for own in seeds if len(own) > which)
        told = shown(sum(got) / len(got), 2) if got else NO_VALUE
        return f"{told} (few)" if few else told

    titles = [f"{one['features']}, {one['frames']} frames" for one in networks]
    of = networks[0]
    lines = ["", f"FGD in the tables is that of {of['features']}: windows of {of['frames']} frames at "
             f"{of['fps']:g} fps, SHA-256 `{str(of['sha256'])[:12]}`."]
    by_all = table(["FGD of the whole set, mean over seeds", *titles],
                   [[name, *(mean(seeds, k) for k in range(len(titles)))] for name, seeds in measured.items()])
    return [*lines, "", *folded("FGD by every network", [*by_all, "", "few: fewer windows than the network's features "
                                                         "call for (see the chapter on FGD)."])]


def _row_lines(ablation: Mapping[str, Any]) -> list[str]:
    """What each row asks and changes, and its PMB by delta."""
    rows = ablation["rows"]
    asked = table(["row", "question", "settings", "seeds", "seconds of training, by seed"],
                  [[name, row.get("question", ""), " ".join(f"`{one}`" for one in row.get("settings", [])),
                    _seeds([row["seeds"]]), shown(row.get("seconds", []), 0)] for name, row in rows.items()])
    curves = table(["PMB, %, by delta in s", *(f"{delta:g}" for delta in pmb.DELTAS)],
                   [[name, *(shown(value, 1) for value in row["pmb_curve"])] for name, row in rows.items()
                    if row.get("pmb_curve")])
    refused = [f"- Not run: {name}: {why}" for name, why in ablation.get("refused", {}).items()]
    return [*folded("What each row asks and changes", asked), "", *folded("PMB by delta", curves),
            *(["", *refused] if refused else [])]


def _racer_lines(kept: Kept, out: Path) -> list[str]:
    """RACER Table 2 in short, and all tables of that command."""
    command, lines = "python -m eval.racer_ablation --data STORE --work DIR --motion", list[str]()
    if kept.racer is None:
        lines.append(_lacking("racer/table.json", command))
    else:
        rows, motion = kept.racer.get("rows", {}), kept.racer.get("motion", {})
        heads = ["RACER Table 2", "return of 15 steps", "by the judge", "the paper's, Trinity"]
        heads += [head for title in ("MAJE, mm", "MAD, mm/s^2", "PMB, %", "FGD")
                  for head in (title, "the paper's, Trinity")]
        lines += [f"By `{command}`; the motion is of few recordings, its FGD by the jackknife.", ""]
        lines += table(heads, [_racer_row(name, rows.get(name), motion.get(name, {}), paper)
                               for name, paper in racer_ablation.PAPER.items()])
    file = kept.folder / "racer" / "table.md"
    return [*lines, "", *folded("All tables of RACER's ablation", included(file, out))] if file.is_file() else lines


def _racer_row(name: str, row: Mapping[str, Any] | None, motion: Mapping[str, Any], paper: Mapping[str, float]
               ) -> list[str]:
    figures, moved = (row or {}).get("figures", {}), motion.get("figures", {})
    label = name if row is None or row.get("decided") else f"{name} (undecided: {len(row['seeds'])} seeds)"
    cells = [label if row is not None else f"{name} (not run)", shown(figures.get("return"), 2),
             shown(figures.get("judge_return"), 2), f"{paper['return']:g}" if "return" in paper else ""]
    for key, digits in (("maje", 1), ("mad", 0), ("pmb", 1)):
        cells += [shown(moved.get(key), digits), f"{paper[key]:g}" if key in paper else ""]
    return [*cells, shown(moved.get("fgd"), 2), f"{paper['fgd']:g}"]


def _figure_lines(kept: Kept, out: Path) -> list[str]:
    """Each figure with its numbers, and which are lacking."""
    lines: list[str] = []
    for own in kept.figures:
        lines += ["", f"### {own.name}: {own.title}", ""]
        lines += [f"![{_alt(own)}]({_relative(own.picture, out)})" if own.picture else "The picture is not there."]
        lines += ["", own.caption] if own.caption else []
        lines += ["", *numbers_table(own.numbers)] if own.numbers else []
    lacking = _lacking_figures(kept)
    return [*lines, *(["", "### Figures that are lacking", "", *lacking] if lacking else [])][1:]


def _lacking_figures(kept: Kept) -> list[str]:
    """The papers' figures that are not there, with the command of each."""
    refused, lines = (kept.ablation or {}).get("refused", {}), list[str]()
    for file, figure in ablation_figures.FIGURES.items():
        if not (kept.folder / "ablation" / f"{file}.json").is_file():
            why = f" ({refused[file]})" if file in refused else ""
            lines.append(f"- {figure.paper}, {figure.title}{why}: `python -m {ABLATE} --only {file}`")
    known = {number for name in [own.name for own in kept.figures]
             + [own.paper for own in ablation_figures.FIGURES.values()] for number in _numbers(name)}
    return lines + [f"- {what}: `python -m {module}`" for what, module in ELSEWHERE.items()
                    if _numbers(what) - known]


def _numbers(name: str) -> set[tuple[str, str]]:
    """The figures that a name is of: "RG Fig. 5 and 8a" is of {("RG", "5"), ("RG", "8")}."""
    named = re.findall(r"(RG|RACER) Fig\. (\d+[a-z]?(?:(?:,| and) \d+[a-z]?)*)", name)
    return {(paper, number) for paper, told in named for number in re.findall(r"\d+", told)}


def _alt(own: Drawn) -> str:
    return re.sub(r"[\[\]\n]", " ", f"{own.name}: {own.title}")


def _score_lines(kept: Kept, out: Path) -> list[str]:
    """The tables of `eval.score`, with what its controls say of the metrics."""
    file = kept.folder / "score.md"
    return [f"By `{_SCORE}`.", "", *included(file, out)] if file.is_file() else [_lacking("score.md", _SCORE)]


def _other_lines(kept: Kept, out: Path) -> list[str]:
    """What all other commands have kept."""
    lines: list[str] = []
    for name, (title, command) in OTHERS.items():
        file = kept.folder / f"{name}.md"
        if file.is_file():
            lines += ["", f"### {title}", "", f"By `{command}`.", "", *folded(f"{name}.md", included(file, out))]
    lacking = [f"`{name}.md` (`{command}`)" for name, (_, command) in OTHERS.items()
               if not (kept.folder / f"{name}.md").is_file()]
    return [*lines, *(["", f"Not there: {', '.join(lacking)}."] if lacking else [])][1:]


def _metric_lines() -> list[str]:
    """The chapter of each metric, from its module."""
    lines = ["Each from the docstring of its module: theory, unit, which way is good, and what fools it."]
    for name in METRICS:
        text = (importlib.import_module(f"eval.{name}").__doc__ or "").strip()
        title = re.split(r"[:.]", text, maxsplit=1)[0]
        lines += ["", f"### {title}", "", f"`eval.{name}`. {text}"]
    return lines


def document(kept: Kept, out: Path, title: str = TITLE) -> str:
    """The whole report as Markdown, for a file in `out`."""
    found = claims.claims(kept.cells, kept.racer_cells, claims.measured_elsewhere(kept.folder))
    sections = {
        "What this is": _about(kept, found, out), "Claims": _claims(found), "Tables": _tables(kept, out),
        "Figures": _figure_lines(kept, out), "Metrics and their controls": _score_lines(kept, out),
        "Other measurements": _other_lines(kept, out), "The metrics": _metric_lines(),
        "How to run all of it again": ["```sh", *COMMANDS.splitlines(), "```"]}
    body = [line for name, lines in sections.items() for line in (f"## {name}", "", *lines, "")]
    contents = [f"{'  ' * (level - 2)}- [{text}](#{slug})"
                for level, text, slug in headings("\n".join([f"# {title}", "", *body])) if level in (2, 3)]
    return "\n".join([f"# {title}", "", f"## {CONTENTS}", "", *contents, "", *body]).rstrip() + "\n"


# ------------------------------------------------------------------------------------------------------------- HTML

CONTENTS = "Contents"
_FOLD = re.compile(r"<details>\n<summary>(.*)</summary>")
_TYPES = {".svg": "image/svg+xml", ".png": "image/png", ".jpg": "image/jpeg"}
_VERDICTS = {HOLDS: "holds", FAILS: "fails", UNDECIDED: "open"}
_NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?(?: \[[^\]]*\]\*?)?(?: / [-\d.]+)?|-")

_PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
{style}</style>
</head>
<body>
<main>
{body}</main>
</body>
</html>
"""


def _parsed(markdown: str) -> list[Token]:
    """Tables are known; HTML is text like any other, but for our own folds (see `_dressed`)."""
    from markdown_it import MarkdownIt

    return MarkdownIt("commonmark", {"html": False}).enable("table").parse(markdown)


def headings(markdown: str) -> list[tuple[int, str, str]]:
    """(level, text, anchor) of each heading; anchors are what GitHub makes of them."""
    tokens, out = _parsed(markdown), list[tuple[int, str, str]]()
    seen: dict[str, int] = {}
    for token, inline in zip(tokens, tokens[1:], strict=False):
        if token.type == "heading_open":
            text = "".join(child.content for child in inline.children or [])
            slug = re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-")
            seen[slug] = seen.get(slug, -1) + 1
            out.append((int(token.tag[1]), text, f"{slug}-{seen[slug]}" if seen[slug] else slug))
    return out


def page(markdown: str, folder: Path, title: str = TITLE) -> str:
    """The report as one HTML file. folder: where the Markdown's pictures are looked up from."""
    from markdown_it import MarkdownIt

    md = MarkdownIt("commonmark", {"html": False})
    anchors = [anchor for _, _, anchor in headings(markdown)]
    body = md.renderer.render(_dressed(_parsed(markdown), anchors, folder), md.options, {})
    style = (resources.files("eval") / "assets" / "report.css").read_text(encoding="utf-8")
    return _PAGE.format(title=html.escape(title), style=style, body=body)


def _block(content: str) -> Token:
    from markdown_it.token import Token

    return Token("html_block", "", 0, content=f"{content}\n")


def _dressed(tokens: Sequence[Token], anchors: Sequence[str], folder: Path) -> list[Token]:
    """Tokens with anchors, boxes that tables scroll in, folds, marked verdicts, and pictures within."""
    out: list[Token] = []
    left, in_contents, skip = iter(anchors), False, 0
    for k, token in enumerate(tokens):
        if skip:
            skip -= 1
            continue
        after = tokens[k + 1] if k + 1 < len(tokens) else None
        if token.type == "paragraph_open" and after is not None and (fold := _fold(after.content)):
            out.append(_block(fold))
            skip = 2
            continue
        if token.type == "heading_open" and after is not None:
            token.attrSet("id", next(left))
            if after.content == CONTENTS:
                out.append(_block("<nav>"))
                in_contents = True
        elif token.type == "table_open":
            out.append(_block('<div class="wide" tabindex="0" role="region" aria-label="table">'))
        elif token.type == "td_open" and after is not None:
            _mark(token, after.content)
        elif token.type == "inline":
            _inline_pictures(token, folder)
        out.append(token)
        if token.type == "table_close":
            out.append(_block("</div>"))
        elif token.type == "bullet_list_close" and in_contents and token.level == 0:
            out.append(_block("</nav>"))
            in_contents = False
    return out


def _fold(content: str) -> str:
    """The HTML of a line that opens or closes a fold; empty for any other."""
    if content == "</details>":
        return content
    opened = _FOLD.fullmatch(content)
    return f"<details><summary>{html.escape(html.unescape(opened[1]), quote=False)}</summary>" if opened else ""


def _mark(cell: Token, content: str) -> None:
    """Numbers stand to the right; a verdict bears its colour."""
    own = next((mark for verdict, mark in _VERDICTS.items()
                if re.fullmatch(rf"{verdict}(?: \(.*\))?", content)), "")
    own = own or ("number" if _NUMBER.fullmatch(content) else "")
    if own:
        cell.attrSet("class", own)


def _inline_pictures(token: Token, folder: Path) -> None:
    """Pictures of this disk as data; any other is named and not fetched."""
    for child in token.children or []:
        if child.type != "image":
            continue
        source, about = str(child.attrGet("src") or ""), html.escape(child.content)
        file = folder / unquote(source)
        kind = _TYPES.get(file.suffix.lower())
        if kind and not re.match(r"[a-z]+:", source) and file.is_file():
            data = base64.b64encode(file.read_bytes()).decode("ascii")
            text = f'<img src="data:{kind};base64,{data}" alt="{about}">'
        else:
            text = f"<em>picture: {about}</em>"
        child.type, child.content, child.children = "html_inline", text, None


# ------------------------------------------------------------------------------------------------------- the command

def report(results: Path, out: Path, title: str = TITLE) -> tuple[Path, Path]:
    """Write OUT/report.md and OUT/report.html of what lies in `results`; InputError where that is nothing."""
    kept = gather(results)
    out.mkdir(parents=True, exist_ok=True)
    markdown = document(kept, out, title)
    places = out / "report.md", out / "report.html"
    write_text(places[0], markdown)
    write_text(places[1], page(markdown, out, title))
    return places


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.report", description="Everything that was measured, on one page.")
    p.add_argument("--results", type=Path, default=Path("docs/results"), metavar="DIR",
                   help="what the evaluation commands have kept (docs/results)")
    p.add_argument("--out", type=Path, default=Path("docs/report"), metavar="DIR",
                   help="for report.md and report.html (docs/report)")
    p.add_argument("--title", default=TITLE, help=f"heading of the page ({TITLE})")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.report"):
        if importlib.util.find_spec("markdown_it") is None:
            raise InputError("the report", "needs markdown-it-py, which is not installed",
                             "pip install 'gesticulator[figures]'")
        for place in report(arguments.results, arguments.out, " ".join(arguments.title.split()) or TITLE):
            print(place)
    return 0


if __name__ == "__main__":
    sys.exit(main())
