"""All stored results on one page: `gesticulator report [--results docs/results] [--out docs/report]`.

The page, `report.md`, is made of what the other commands wrote and measures nothing itself: the tables of every file of
results (`eval.table`) under its name, the claims and the papers' tables first, then the papers' figures. The same
inputs give the same bytes.

What fools it: it shows what lies in the folder, however old. The line under each heading says which command, commit and
bundle the figures are of.
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path
from urllib.parse import quote

from data_module.errors import InputError
from data_module.files import read_text, write_text
from eval.table import load_with_provenance, loads

TITLE = "Gesticulator: what was measured"
FIRST = ("claims", "ablation/table", "score")
"""Sections that stand first where they exist: the subject of both papers."""


def document(folder: Path, out: Path) -> str:
    """The whole page as Markdown, for a file in `out`; InputError where the folder holds no results."""
    if not folder.is_dir():
        raise InputError(folder, "is not a folder", "name the one that the evaluation commands write to")
    # Sorted by path, so that the same results give the same page.
    names = [file.relative_to(folder).with_suffix("").as_posix() for file in sorted(folder.rglob("*.json"))]
    sections: dict[str, list[str]] = {}
    unreadable = []
    for name in dict.fromkeys((*FIRST, *names)):
        try:
            # The figures of an ablation are pictures with titles; every other file holds tables.
            parts = _figures(folder, name, out) if name.endswith("figures") else {name: _section(folder, name)}
        except InputError:
            unreadable.append(f"`{name}.json`")
            continue
        sections |= {part.rpartition("/")[2].replace("_", " ").replace("-", " ").capitalize(): lines
                     for part, lines in parts.items() if lines}
    if not sections:
        raise InputError(folder, "holds no results", "run an evaluation command first: gesticulator --help")
    contents = [f"- [{name}](#{name.lower().replace(' ', '-')})" for name in sections]
    left_out = [f"No tables of results: {', '.join(unreadable)}.", ""] if unreadable else []
    body = [line for name, lines in sections.items() for line in (f"## {name}", "", *lines, "")]
    return "\n".join([f"# {TITLE}", "", *contents, "", *left_out, *body]).rstrip() + "\n"


def _section(folder: Path, name: str) -> list[str]:
    """The lines of a file of results; none where it is not there."""
    file = folder / f"{name}.json"
    if not file.is_file():
        return []
    tables, about = load_with_provenance(file)
    return [about.markdown(), *(table.markdown() for table in tables)]


def _figures(folder: Path, name: str, out: Path) -> dict[str, list[str]]:
    """Name -> lines of the figures of an ablation with their titles; InputError where the file holds no figures."""
    file = folder / f"{name}.json"
    try:
        drawn = [(file.with_name(figure), f"{facts['figure']}: {facts['title']}")
                 for figure, facts in loads(read_text(file, "draw them again")).items()]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(file, "holds no figures of an ablation", "draw them again") from error
    return {place.name: _figure(place, title, out) for place, title in drawn}


def _figure(place: Path, title: str, out: Path) -> list[str]:
    """A picture, whose path has no suffix here, with its title."""
    picture = next((file for ending in (".svg", ".png") if (file := Path(f"{place}{ending}")).is_file()), None)
    link = quote(Path(os.path.relpath(picture, out)).as_posix()) if picture else ""
    alt = re.sub(r"[\[\]\n]", " ", title)
    return [f"![{alt}]({link})" if picture else "The picture is not there.", "", f"{title}."]


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator report`."""
    parser.add_argument("--results", type=Path, default=Path("docs/results"), metavar="DIR",
                        help="folder of stored results (default docs/results)")
    parser.add_argument("--out", type=Path, default=Path("docs/report"), metavar="DIR",
                        help="output folder for report.md (default docs/report)")


def run(arguments: argparse.Namespace) -> int:
    """Write it and name it."""
    text = document(arguments.results, arguments.out)
    arguments.out.mkdir(parents=True, exist_ok=True)
    write_text(arguments.out / "report.md", text)
    print(arguments.out / "report.md")
    return 0
