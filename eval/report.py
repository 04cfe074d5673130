"""Everything that was measured, on one page: `gesticulator report [--results docs/results] [--out docs/report]`.

The page, `report.md`, is made of what the other commands wrote and measures nothing itself: a page of what holds of
both papers, one of what does not, one of what is open, the method, all claims, the papers' tables with their figures
beside ours, the figures with what is seen in them, the metrics with their controls, all other measurements, and the
chapter of each metric from its own module. Every table is a file of results
(`eval.table`) put under its heading. What is not there is named with the command that makes it. The same inputs give
the same bytes.

What fools it: it shows what lies in the folder, however old. The store's fingerprint in the first table says whether
two parts are of one corpus.
"""

from __future__ import annotations

import argparse
import importlib
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from data_module.errors import InputError
from data_module.files import read_text, write_text
from eval import report_claims
from eval.metrics import METRICS
from eval.probes import PROBES
from eval.stats import Interval
from eval.table import Column, Provenance, Table, load_with_provenance, loads, shown_cell

TITLE = "Gesticulator: what was measured"
CLAIMS = "gesticulator ablate --tables"
ABLATE = "gesticulator ablate --data STORE --work DIR"
SCORE = "gesticulator score --truth STORE --system NAME=DIR --out docs/results/score.json"
BENCHMARKS = {"q_network": ("Cost of a block of the Q-network", "python benchmarks/q_network.py")}
"""Results of benchmarks: a heading, and the command."""
PICTURES = {
    "strip.png": ("RG Fig. 9", "A strip of generated motion",
                  "The example recording, seen from the front and from the side, with the way of the hands before each "
                  "figure, the sound and its beats. One clip, chosen by hand: it shows what motion looks like and "
                  "nothing about how good it is."),
    "style_editing.png": ("RG Fig. 10", "Style editing",
                          "What is asked (dashed) and what the motion does, on one clip and over clips."),
}
"""Pictures that other commands leave in `pictures` beside the results: the paper's figure, a title, a caption."""
CHAPTERS = ("metrics.joint_error", "metrics.fgd", "metrics.gesture_features", "metrics.pmb", "metrics.diversity",
            "metrics.accuracy", "metrics.smoothness", "metrics.beat_consistency", "metrics.mismatch",
            "metrics.evaluate", "metrics.encode", "metrics.audio_clusters", "metrics.eye", "metrics.eye.body",
            "metrics.eye.hands", "metrics.eye.trunk", "metrics.eye.strokes", "metrics.eye.posture",
            "metrics.eye.together", "metrics.eye.units", "metrics.eye.voice", "metrics.eye.frechet",
            "metrics.eye.stability", "metrics.eye.pitch", "baselines.unit_selection", "baselines.controls",
            "baselines.interpreters", "stats", "crossed")
"""The modules of `eval` whose docstrings are the chapters."""
COMMANDS = """\
gesticulator build performer --out STORE                   # a corpus, or see `gesticulator build --help`
gesticulator train --data STORE --out BUNDLE --work DIR
gesticulator ablate --data STORE --work DIR                # every table and figure of both papers; resumes
gesticulator score --truth STORE --system NAME=DIR --out docs/results/score.json
gesticulator probe NAME --data STORE --out docs/results/NAME.json
gesticulator report                                        # this page
"""
MANY = 24
"""Numbers in a line of a figure's table at most."""


# ------------------------------------------------------------------------------------------------- what is there

@dataclass(frozen=True)
class ReportFigure:
    """A figure. paper: its name there, such as "RG Fig. 11"; picture: its file, None where only the numbers are."""

    paper: str
    title: str
    caption: str
    numbers: Mapping[str, Any]
    picture: Path | None


@dataclass(frozen=True)
class Results:
    """What the other commands left in `folder`: tables by the file's name, such as "ablation/table"."""

    folder: Path
    tables: Mapping[str, list[Table]]
    about: Mapping[str, Provenance]
    figures: list[ReportFigure]
    unreadable: list[str]

    def facts(self, name: str) -> Mapping[str, Any]:
        """The raw values of a file, of all its tables; empty where it is not there."""
        return {key: value for table in self.tables.get(name, []) for key, value in table.facts.items()}


def gather(folder: Path) -> Results:
    """Read a folder of results; InputError where nothing of what the report shows is in it."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "name the one that the evaluation commands write to")
    tables: dict[str, list[Table]] = {}
    about: dict[str, Provenance] = {}
    unreadable: list[str] = []
    known = ("claims", "ablation/table", "score", *probe_files(), *BENCHMARKS)
    others = [file.relative_to(folder).with_suffix("").as_posix() for file in sorted(folder.rglob("*.json"))]
    for name in dict.fromkeys((*known, *others)):
        file = folder / f"{name}.json"
        if file.is_file():
            try:
                tables[name], about[name] = load_with_provenance(file)
            except InputError:
                if name in known:
                    unreadable.append(f"{name}.json")
    figures = _figures(folder, unreadable)
    if not tables and not any(figure.picture is None or figure.picture.parent.parent == folder for figure in figures):
        raise InputError(folder, "holds no results", "run an evaluation command first: gesticulator --help")
    return Results(folder, tables, about, figures, unreadable)


def probe_files() -> dict[str, str]:
    """File of results -> the probe that writes it."""
    return {name.replace("-", "_"): name for name in PROBES}


def _figures(folder: Path, unreadable: list[str]) -> list[ReportFigure]:
    """The ablation's figures and the pictures of other commands, in the papers' order."""
    found = []
    for file in sorted((folder / "ablation").glob("figure-*.json")):
        try:
            told = loads(read_text(file, "draw it again"))
            picture = next((own for ending in (".svg", ".png") if (own := file.with_suffix(ending)).is_file()), None)
            figure = ReportFigure(told["figure"], told["title"], told["caption"], dict(told["numbers"]), picture)
            "\n".join([figure.paper, *_lines_of(figure, folder)])  # TypeError where a text is something else
            found.append(figure)
        except (InputError, ValueError, KeyError, TypeError, AttributeError):
            unreadable.append(f"ablation/{file.name}")
    pictures = folder.parent / "pictures"
    found += [ReportFigure(*about, {}, pictures / file) for file, about in PICTURES.items()
              if (pictures / file).is_file()]
    return sorted(found, key=lambda figure: (_order(figure.paper), figure.title))


def _order(name: str) -> tuple[int, int, str]:
    """Where a figure of the papers stands: "RG Fig. 8b" is (0, 8, "b"); what has no number comes last."""
    found = re.search(r"(RG|RACER)\D*(\d{1,9})\s*([a-z]?)", name)
    return (("RG", "RACER").index(found[1]), int(found[2]), found[3]) if found else (2, 0, name)


# --------------------------------------------------------------------------------------------------------- sections

def document(results: Results, out: Path, title: str = TITLE) -> str:
    """The whole report as Markdown, for a file in `out`."""
    sections = {
        "What this is": _about(results),
        **_verdict_pages(results),
        **_limits(results, out),
        "Claims": _tables_of(results, "claims", CLAIMS),
        "Tables": _tables_of(results, "ablation/table", ABLATE),
        "Figures": _figure_lines(results, out),
        "Metrics and their controls": _tables_of(results, "score", SCORE),
        "Other measurements": _other_lines(results),
        "The metrics": _metric_lines(),
        "How to run all of it again": ["```sh", *COMMANDS.splitlines(), "```"]}
    body = "\n".join(line for name, lines in sections.items() for line in (f"## {name}", "", *lines, ""))
    contents = "\n".join(f"- [{text}](#{anchor})" for level, text, anchor in headings(body) if level == 2)
    return f"# {title}\n\n{contents}\n\n{body}".rstrip() + "\n"


def headings(markdown: str) -> list[tuple[int, str, str]]:
    """(level, text, anchor) of each heading outside of fences; anchors are what GitHub makes of them."""
    out: list[tuple[int, str, str]] = []
    seen: dict[str, int] = {}
    for part in re.split(r"^```.*?^```$", markdown, flags=re.MULTILINE | re.DOTALL):
        for marks, text in re.findall(r"^(#{1,6}) (.+)$", part, flags=re.MULTILINE):
            slug = re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-")
            seen[slug] = seen.get(slug, -1) + 1
            out.append((len(marks), text, f"{slug}-{seen[slug]}" if seen[slug] else slug))
    return out


def _verdict_pages(results: Results) -> dict[str, list[str]]:
    """What holds, what does not, what is open, and the method; empty where claims.json does not say."""
    facts = results.facts("claims")
    if not isinstance(facts.get("claims"), list):
        return {}
    return {"What holds": report_claims.what_holds(facts), "What does not hold": report_claims.what_does_not(facts),
            "What could not be tested, and what is undecided": report_claims.what_is_open(facts),
            "Method": report_claims.method()}


def _about(results: Results) -> list[str]:
    """What was run, in a few lines, and what became of it."""
    lines = ["What the evaluation commands found, beside what two papers print: *Rhythmic Gesticulator* (RG, 2022) and "
             "*RACER* (2023). The papers' figures are of other data, another skeleton and another FGD network: compare "
             "the order, not the values. `-` stands where a figure is undefined or was not measured. Intervals are "
             "of 95 %: over seeds and clips where there are several of both, else by the bootstrap over clips.", ""]
    count = results.facts("claims").get("count")
    if isinstance(count, dict) and all(isinstance(number, int) for number in count.values()):
        told = ", ".join(f"{number} {verdict}" for verdict, number in count.items())
        lines += [f"> **Of {sum(count.values())} claims: {told}.**", ">"]
    flags = results.facts("score").get("flags")
    titles = [str(flag.get("title")) for flag in flags if isinstance(flag, dict)] if isinstance(flags, list) else []
    beaten = "; ".join(dict.fromkeys((*titles, *report_claims.failing_metrics(results.facts("claims")))))
    lines += [f"> Metrics that a control beats: {beaten or 'none, or not measured'}.", ""]
    lines += [Table("", {"store": Column("store"), "fingerprint": Column("fingerprint")}, {
        name: {"store": store.get("name"), "fingerprint": str(store.get("fingerprint", "-"))[:12]}
        for name in results.tables if isinstance(store := results.facts(name).get("store"), dict)}, "file").markdown()]
    if results.unreadable:
        lines += [f"Cannot be read, so left out: {', '.join(f'`{name}`' for name in results.unreadable)}.", ""]
    return lines


def _limits(results: Results, out: Path) -> dict[str, list[str]]:
    """What the corpus cannot show, from limits.md beside the results."""
    limits = results.folder / "limits.md"
    return {"What this corpus cannot show": [_included(limits, out)]} if limits.is_file() else {}


def _included(file: Path, out: Path) -> str:
    """A Markdown file as part of a page in `out`: headings below ours, links from here."""
    text = re.sub(r"^#{1,6}(?= )", "####", read_text(file, "save it as text in UTF-8").strip(), flags=re.MULTILINE)
    return re.sub(r"(?<=\]\()(?![a-z]+:|#|/)([^)\s]+)(?=\))", lambda link: _link(file.parent / link[1], out), text)


def _link(file: Path, out: Path) -> str:
    """A file as a link from `out`."""
    return quote(Path(os.path.relpath(file, out)).as_posix())


def _tables_of(results: Results, name: str, command: str, level: int = 3) -> list[str]:
    """All tables of a file of results, their titles as headings; or how to make it."""
    if name not in results.tables:
        return [f"`{name}.json` is not there: `{command}` makes it."]
    return [results.about[name].markdown(), *(re.sub(r"^### ", "#" * level + " ", table.markdown())
                                      for table in results.tables[name])]


def _figure_lines(results: Results, out: Path) -> list[str]:
    """Each figure with its caption and numbers."""
    lines = [line for figure in results.figures for line in _lines_of(figure, out)]
    return lines or [f"No figure is there: `{ABLATE}` draws them."]


def _lines_of(figure: ReportFigure, out: Path) -> list[str]:
    named = f"{figure.paper}: {figure.title}"
    alt = re.sub(r"[\[\]\n]", " ", named)
    lines = [f"### {named}", "", f"![{alt}]({_link(figure.picture, out)})" if figure.picture else
             "The picture is not there.", "", " ".join(filter(None, (
                 figure.caption, report_claims.seen(figure.paper, figure.numbers)))), ""]
    return [*lines, numbers_table(figure.numbers).markdown()] if figure.numbers else lines


def numbers_table(numbers: Mapping[str, Any]) -> Table:
    """A figure's numbers, a line each, or a table where several rows have the same columns; of a list that is longer
    than `MANY` its length."""
    parts = [value for value in numbers.values() if isinstance(value, Mapping)]
    if len(parts) == len(numbers) > 1 and all(list(part) == list(parts[0]) for part in parts) and all(
            isinstance(value, int | float) for part in parts for value in part.values()):
        return Table("", {str(key): Column(str(key)) for key in parts[0]}, {
            name: {str(key): _number(value) for key, value in part.items()} for name, part in numbers.items()})
    rows = {}
    for name, value in _flat("", numbers):
        long = isinstance(value, list) and len(value) > MANY
        parts = value if isinstance(value, list) else [value]
        rows[name] = {"value": f"{len(value)} values, in the file" if long else ", ".join(map(_number, parts))}
    return Table("", {"value": Column("value")}, rows)


def _flat(name: str, value: Any) -> Iterable[tuple[str, Any]]:
    if isinstance(value, Mapping) and not {"mean", "low", "high"} <= set(value):
        for key, inner in value.items():
            yield from _flat(f"{name}, {key}" if name else str(key), inner)
    else:
        yield name, value


def _number(value: Any) -> str:
    if isinstance(value, Mapping):
        return Interval.from_dict(value).text(3)
    return shown_cell(value if isinstance(value, str | int) or value is None else float(f"{value:.4g}"), 4)


def _other_lines(results: Results) -> list[str]:
    """What the probes and the benchmarks found; and those that were not run."""
    told = {name: (PROBES[probe].about, f"gesticulator probe {probe}") for name, probe in probe_files().items()}
    told |= BENCHMARKS
    lines = []
    for name, (question, command) in told.items():
        if name in results.tables:
            lines += [f"### {question[0].upper()}{question[1:]}", "", *_tables_of(results, name, command, 4)]
    answered = [name for name in results.tables if name not in (*told, "claims", "ablation/table", "score")]
    for name in answered:
        when = "of earlier weights" if name.startswith("earlier/") else "measured once"
        lines += [f"### {name.rpartition('/')[2].replace('_', ' ').capitalize()}, {when}", "",
                  *_tables_of(results, name, "", 4)]
    lacking = [f"`{name}.json` (`{command}`)" for name, (_, command) in told.items() if name not in results.tables]
    return [*lines, *([f"Not there: {', '.join(lacking)}."] if lacking else [])]


def _metric_lines() -> list[str]:
    """What every metric needs and what fools it, and the chapter of each module."""
    columns = {"unit": Column("unit"), "good": Column("good"), "needs": Column("needs"), "fooled": Column("fooled by")}
    table = Table("", columns, {metric.about: {
        "unit": metric.unit, "good": metric.good or "no judgement", "needs": ", ".join(metric.inputs),
        "fooled": ", ".join(metric.fooled_by)} for metric in METRICS.usable().values()}, "metric")
    lines = [table.markdown(), "The chapters, each from the docstring of its module:", ""]
    for name in CHAPTERS:
        text = (importlib.import_module(f"eval.{name}").__doc__ or "").strip()
        lines += [f"### {re.split('[:.]', text, maxsplit=1)[0]}", "", f"`eval.{name}`. {text}", ""]
    return lines


# ------------------------------------------------------------------------------------------------------- the command

def report(folder: Path, out: Path, title: str = TITLE) -> Path:
    """Write OUT/report.md of what lies in `folder`; InputError where that is nothing."""
    text = document(gather(folder), out, title)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "report.md", text)
    return out / "report.md"


def arguments(parser: argparse.ArgumentParser) -> None:
    """What `gesticulator report` takes."""
    parser.add_argument("--results", type=Path, default=Path("docs/results"), metavar="DIR",
                        help="folder of stored results (default docs/results)")
    parser.add_argument("--out", type=Path, default=Path("docs/report"), metavar="DIR",
                        help="output folder for report.md (default docs/report)")
    parser.add_argument("--title", default=TITLE, help=f"heading of the page (default: {TITLE})")


def run(arguments: argparse.Namespace) -> int:
    """Write it and name it."""
    print(report(arguments.results, arguments.out, " ".join(arguments.title.split()) or TITLE))
    return 0
