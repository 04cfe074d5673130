"""What README, docs/ and CHANGELOG say is so: length, links, commands, options, figures, pictures."""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from eval.table import Table, load
from gesticulator.cli import Command

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
DOCS = ROOT / "docs"
CHANGELOG = ROOT / "CHANGELOG.md"
WRITTEN = [README, CHANGELOG, *sorted(DOCS.glob("*.md")), *sorted((DOCS / "api").glob("*.md"))]
"""Pages that people write. Those under docs/results are made by commands."""
PAGES = [*WRITTEN, *sorted((DOCS / "results").rglob("*.md"))]
GUIDE = [page for page in WRITTEN if page != CHANGELOG]

README_LINES = 150
TABLE_ROWS = 12
PICTURE_BYTES = 60_000
KEPT_MODULES = {"gesticulator", "gesticulator.infer", "data_module.build"}
FOREIGN_MODULES = {"venv", "pip", "pytest"}
OLD_COMMANDS = {
    "data_module.build", "eval", "eval.ablate", "eval.beat_labels", "eval.claims", "eval.corpus", "eval.figures",
    "eval.gate", "eval.languages", "eval.lexicon_map", "eval.parts", "eval.policies", "eval.racer_ablation",
    "eval.report", "eval.rewards", "eval.score", "eval.speech_levels", "eval.strips", "eval.study",
    "eval.style_editing", "eval.two_languages", "eval.video", "gesticulator", "gesticulator.infer",
    "gesticulator.silent", "gesticulator.train"}
"""What `python -m` took before there was one command with verbs."""

FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.M | re.S)
SPAN = re.compile(r"`([^`]+)`")
LINK = re.compile(r"\[[^\]]*\]\(([^()\s]*(?:\([^()\s]*\)[^()\s]*)*)\)")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@cache
def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def shell_lines(source: str) -> list[str]:
    """Lines of shell in a page: those of fenced blocks and the spans of code, which may break over lines."""
    fenced = [line for language, block in FENCE.findall(source) if language in ("sh", "")
              for line in block.replace("\\\n", " ").splitlines()]
    spans = [" ".join(span.split()) for span in SPAN.findall(FENCE.sub("", source))]
    return [part.strip() for line in fenced + spans for part in line.split("&&")]


def words(line: str) -> list[str]:
    return shlex.split(line, comments=True)


def calls(page: Path) -> list[list[str]]:
    """The arguments of every call of the program that a page shows."""
    found = [words(line) for line in shell_lines(text(page)) if re.match(r"(\S*/)?gesticulator\s", line)]
    return [call[1:] for call in found if len(call) > 1]


CALLS = sorted({(of(page), " ".join(map(shlex.quote, call))) for page in GUIDE for call in calls(page)})


@cache
def verbs() -> dict[str, str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    points: dict[str, str] = project["entry-points"]["gesticulator.commands"]
    return points


def command(verb: str) -> Command:
    """The command of a verb of this checkout, whatever is installed."""
    module, _, name = verbs()[verb].partition(":")
    found: Command = getattr(importlib.import_module(module), name)
    return found


def rows_of_tables(source: str) -> list[list[str]]:
    """The rows of every table, without heads and rules."""
    tables: list[list[str]] = []
    for block in re.findall(r"(?:^ *\|.*\n?)+", FENCE.sub("", source), re.M):
        tables.append(block.strip().splitlines()[2:])
    return tables


def section(source: str, title: str) -> str:
    found = re.search(rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", source, re.M | re.S)
    assert found, f"there is no section {title}"
    return found.group(1)


DIALECT = re.compile(r"\b(she|her|hers|herself|whoever|told by|asked of)\b", re.I)
"""Words that the pages do without: the figure on screen is "the character"."""


@pytest.mark.parametrize("verb", verbs())
def test_the_help_speaks_of_the_character(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command(verb).main(f"gesticulator {verb}", ["--help"])
    assert not DIALECT.findall(capsys.readouterr().out)


@pytest.mark.parametrize("page", GUIDE, ids=of)
def test_pages_speak_of_the_character(page: Path) -> None:
    assert not DIALECT.findall(text(page)), of(page)


def test_the_readme_is_short_and_has_one_table() -> None:
    source = text(README)
    assert len(source.splitlines()) <= README_LINES
    tables = rows_of_tables(source)
    assert len(tables) == 1
    assert tables == rows_of_tables(section(source, "How good"))
    assert 1 <= len(tables[0]) <= TABLE_ROWS


def test_the_readme_opens_with_a_picture_and_two_commands_for_a_fresh_machine() -> None:
    before = text(README).partition("\n## ")[0]
    blocks = [(language, block.strip()) for language, block in FENCE.findall(before)]
    assert before.index("![") < before.index("```")
    assert [language for language, _ in blocks] == ["sh", "sh"]
    for _, block in blocks:
        assert len(block.splitlines()) == 1
        assert block.startswith("python3 -m venv .venv && .venv/bin/pip install ")


def test_the_readme_lists_ten_things_each_with_a_command() -> None:
    items = re.split(r"^\d+\. ", section(text(README), "Ten things to do with it"), flags=re.M)[1:]
    assert len(items) == 10
    assert all("`gesticulator " in item for item in items)


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub and the site make it."""
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()).strip().replace(" ", "-")


@cache
def anchors(page: Path) -> set[str]:
    return {slug(heading) for heading in re.findall(r"^#+ (.*)$", FENCE.sub("", text(page)), re.M)}


@pytest.mark.parametrize("page", PAGES, ids=of)
def test_links_lead_somewhere(page: Path) -> None:
    source = SPAN.sub("", FENCE.sub("", text(page)))
    for target in LINK.findall(source):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        place = (page.parent / file).resolve() if file else page
        assert place.exists(), f"{of(page)}: {target}"
        if anchor and place in WRITTEN:
            assert anchor in anchors(place), f"{of(page)}: {target}"


def test_pages_of_the_site_link_to_nothing_outside_it() -> None:
    for page in GUIDE:
        if page != README:
            for target in LINK.findall(SPAN.sub("", FENCE.sub("", text(page)))):
                file = target.partition("#")[0]
                if file and not re.match(r"[a-z]+:", target):
                    assert (page.parent / file).resolve().is_relative_to(DOCS), f"{of(page)}: {target}"


def test_every_result_is_reached_from_the_results() -> None:
    reached = {(DOCS / target).resolve() for page in ("results.md", "racer.md", "limits.md")
               for target in LINK.findall(text(DOCS / page)) if target.startswith("results/")}
    made = {path for path in (DOCS / "results").rglob("*.md") if path.stem != "index"}
    assert made <= reached


@pytest.mark.parametrize("page", GUIDE, ids=of)
def test_files_that_are_named_are_there(page: Path) -> None:
    for span in SPAN.findall(FENCE.sub("", text(page))):
        if re.fullmatch(r"[\w/.-]+/[\w.-]+\.(py|md|json|flac|txt)", span) and not span.startswith(("out/", "study/")):
            assert (ROOT / span).exists(), f"{of(page)}: {span}"


@pytest.mark.parametrize("page", GUIDE, ids=of)
def test_python_commands_are_there(page: Path) -> None:
    for line in shell_lines(text(page)):
        if found := re.match(r"(?:\S*/)?python3? (-m )?(\S+)", line):
            module, name = found.groups()
            if module:
                assert name in KEPT_MODULES | FOREIGN_MODULES, f"{of(page)}: {line}"
            else:
                assert (ROOT / name).is_file(), f"{of(page)}: {line}"


@pytest.mark.parametrize(("page", "line"), CALLS, ids=[f"{page}: {line}" for page, line in CALLS])
def test_verbs_and_options_are_known(page: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    call = words(line)
    if call[0] in ("VERB", "--help", "--version"):
        return
    # What is no bare word is a recording, and `infer` is meant.
    bare = re.fullmatch(r"[a-z]+(-[a-z]+)?", call[0]) is not None
    verb, rest = (call[0], call[1:]) if bare else ("infer", call)
    assert verb in verbs(), f"{page}: there is no verb {verb}"
    asked = {option for word in rest if word.startswith("--") for option in OPTION.findall(word)}
    if not asked:
        return
    # The first word may name a part that has options of its own: `study make`, `probe motion`, `bundle silent`.
    part = [rest[0]] if re.fullmatch(r"[a-z][a-z-]*", rest[0]) else []
    with pytest.raises(SystemExit) as stop:
        command(verb).main(f"gesticulator {verb}", [*part, "--help"])
    assert stop.value.code == 0
    known = set(OPTION.findall(capsys.readouterr().out))
    assert asked <= known, f"{page}: {verb} does not know {', '.join(sorted(asked - known))}"


def old_to_new() -> dict[str, str]:
    """Module of an old command -> what CHANGELOG says of it."""
    table = {}
    for row in (row for rows in rows_of_tables(text(CHANGELOG)) for row in rows):
        old, new = (cell.strip() for cell in row.strip(" |").split("|")[:2])
        for module in re.findall(r"`python -m ([\w.]+)`", old):
            table[module] = new
    return table


def test_every_command_that_is_gone_has_its_new_verb_in_the_changelog() -> None:
    table = old_to_new()
    assert set(table) == OLD_COMMANDS - KEPT_MODULES
    for module, new in table.items():
        found = re.findall(r"`gesticulator ([a-z]+)", new)
        assert found, f"{module}: no verb"
        assert set(found) <= set(verbs()), f"{module}: {new}"


def result(name: str) -> Any:
    return json.loads((DOCS / "results" / name).read_text(encoding="utf-8"))


def tables(name: str) -> dict[str, Table]:
    return {table.title: table for table in load(DOCS / "results" / name)}


def test_the_figures_of_the_readme_are_those_that_are_stored() -> None:
    quality, claims = tables("quality.json"), tables("claims.json")["Claims"].facts
    motion, asked = tables("motion.json"), tables("style_editing.json")["Style editing"].rows
    seen, held = motion["Beside others, BEAT voice"].rows, motion["Acceptance of the motion"].rows
    same = tables("stability.json")["The same sound exported again, against its first rendering"].rows
    speed, onsets = result("realtime.json"), [row["f"] for row in result("onsets.json")["rows"].values()]
    times, count, about = speed["real_time_factor"][0], claims["count"], quality["Reconstruction"].facts

    def shown(title: str, row: str, column: str, digits: int, bounds: bool = True) -> str:
        cell: Any = quality[title].rows[row][column]
        return cell.text(digits) if bounds else f"{cell.mean:.{digits}f}"

    right, others = "Lexeme accuracy", ("ours", "statistical", "real take")

    def eye(row: str, *systems: str) -> list[str]:
        return [str(seen[row][system]).removesuffix(" !") for system in systems]

    def apart(sound: str) -> str:
        hands: Any = same[sound]["hands"]
        return f"{hands.mean:.0f}"

    timing = "PMB above chance, 0.1 s, first detector, %"
    far, size = "window Frechet distance to real, all clips together", "stroke amplitude, median, cm"
    expected = [
        eye(far, *others),
        [f"{sum(int(str(row['hold'])) for row in held.values())} of "
         f"{sum(int(str(row['of'])) for row in held.values())}"],
        eye(size, "ours", "real take"), eye("pauses with a moving hand, %", "ours", "real take"),
        eye("forearm outward, of the time, %", "ours", "real take"), eye(timing, *others),
        [f"{apart('6 dB quieter')} / {apart('MP3, 192 kbit/s')}", apart("another seed")],
        [", ".join(f"{row['in_order']:.0f}" for row in asked.values())],
        [shown(right, "lstm", "free_running", 1),
         *(shown(right, name, "free_running", 1, False) for name in ("previous lexeme and speaker", "majority"))],
        [f"{sum(onsets) / len(onsets):.2f}"],
        [" / ".join(str(count[verdict]) for verdict in ("holds", "does not hold", "no valid test", "undecided"))],
        [f"{times['warm_lstm']:.2f} / {times['cold']:.2f}",
         f"{times['warm_with_text']:.2f} / {times['cold_with_text']:.2f}"],
    ]
    (rows,) = rows_of_tables(text(README))
    assert len(rows) == len(expected)
    for row, values in zip(rows, expected, strict=True):
        for value in values:
            assert value in row, f"{value} is stored, the README says {row}"
    assert f"{about['store']['test_recordings']} test recordings" in text(README)
    assert f"{about['seconds'] / 60:.0f} minutes" in text(README)


def shown_in_the_glossary() -> set[str]:
    return set(re.findall(r"\]\(pictures/glossary/([\w-]+\.png)\)", text(DOCS / "glossary.md")))


def test_terms_of_the_glossary_have_two_lines_and_a_picture() -> None:
    terms = re.split(r"^## ", text(DOCS / "glossary.md"), flags=re.M)[1:]
    for term in terms[:-1]:
        title, lines, *rest = term.strip().split("\n\n")
        assert len(lines.splitlines()) == 2, title
        assert len(rest) == 1 and rest[0].startswith("!["), title


def test_pictures_of_the_glossary_are_drawn_by_their_script(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    script, folder = DOCS / "pictures" / "make_glossary.py", DOCS / "pictures" / "glossary"
    known = set(re.findall(r'"([a-z-]+)": [a-z_]+[,}]', text(script)))
    assert {f"{name}.png" for name in known} == shown_in_the_glossary() == {path.name for path in folder.iterdir()}
    subprocess.run([sys.executable, script, tmp_path, "onset", "lexeme"], check=True, timeout=300,
                   capture_output=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert {path.name for path in tmp_path.iterdir()} == {"onset.png", "lexeme.png"}
    for path in [*tmp_path.iterdir(), *folder.iterdir()]:
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size < PICTURE_BYTES, path


@pytest.mark.parametrize("tool", ["blender", "unity", "unreal", "godot", "threejs", "vrm"])
def test_the_page_of_a_tool_shows_its_picture(tool: str) -> None:
    picture = DOCS / "pictures" / "tools" / f"{tool}.png"
    assert f"(pictures/tools/{tool}.png)" in text(DOCS / f"{tool}.md")
    assert 4_000 < picture.stat().st_size < 60_000
    assert f'"{tool}": ' in text(DOCS / "pictures" / "make_tools.py")
