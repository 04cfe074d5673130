"""Links lead somewhere, commands and options that pages show exist, and the README's figures are the stored ones."""

import importlib
import json
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path
from typing import Any, cast

import pytest

from data_module.corpora.table import CORPORA
from eval.table import Table, load
from gesticulator.cli import Command

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
DOCS = ROOT / "docs"
GUIDE = [README, *sorted(DOCS.glob("*.md")), *sorted((DOCS / "api").glob("*.md"))]
"""Pages that people write. Those under docs/results are written by commands."""
PAGES = [*GUIDE, ROOT / "CHANGELOG.md", *sorted((DOCS / "results").rglob("*.md"))]
OF_PERFORMER = re.compile(r"(build performer|smartbody|train-face)\b")
"""Commands of the distribution in integrations/performer."""

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
    lines = [words(line) for line in shell_lines(text(page)) if re.match(r"(\S*/)?gesticulator\s", line)]
    return [call[1:] for call in lines if len(call) > 1]


CALLS = sorted({(of(page), " ".join(map(shlex.quote, call))) for page in GUIDE for call in calls(page)})


@cache
def verbs() -> dict[str, str]:
    """The verbs of this checkout and those of the maker of the corpus."""
    points: dict[str, str] = {}
    for folder in (ROOT, ROOT / "integrations" / "performer"):
        project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        points |= project["entry-points"]["gesticulator.commands"]
    return points


def command(verb: str) -> Command:
    """The command of a verb of this checkout, whatever is installed."""
    module, _, name = verbs()[verb].partition(":")
    return cast(Command, getattr(importlib.import_module(module), name))


def table_rows(source: str) -> list[str]:
    """The rows of all tables of a page, without heads and rules."""
    tables = re.findall(r"(?:^ *\|.*\n?)+", FENCE.sub("", source), re.M)
    return [row for table in tables for row in table.strip().splitlines()[2:]]


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
        if anchor and place in GUIDE:
            assert anchor in anchors(place), f"{of(page)}: {target}"


@pytest.mark.parametrize("page", GUIDE, ids=of)
def test_files_that_are_named_are_there(page: Path) -> None:
    for span in SPAN.findall(FENCE.sub("", text(page))):
        if re.fullmatch(r"[\w/.-]+/[\w.-]+\.(py|md|json|flac|txt)", span) and not span.startswith(("out/", "study/")):
            assert (ROOT / span).exists(), f"{of(page)}: {span}"


@pytest.mark.parametrize(("page", "line"), CALLS, ids=[f"{page}: {line}" for page, line in CALLS])
def test_verbs_and_options_are_known(page: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    call = words(line)
    if call[0] in ("VERB", "--help", "--version"):
        return
    # What is no bare word is a recording, and `infer` is meant.
    if OF_PERFORMER.match(" ".join(call)) and "performer" not in CORPORA:
        pytest.skip("a command of gesticulator-performer, which is not installed")
    bare = re.fullmatch(r"[a-z]+(-[a-z]+)?", call[0]) is not None
    verb, rest = (call[0], call[1:]) if bare else ("infer", call)
    assert verb in verbs(), f"{page}: there is no verb {verb}"
    options = {option for word in rest if word.startswith("--") for option in OPTION.findall(word)}
    if not options:
        return
    # The first word may name a part that has options of its own: `study make`, `bundle inspect`.
    part = [rest[0]] if re.fullmatch(r"[a-z][a-z-]*", rest[0]) else []
    with pytest.raises(SystemExit) as stop:
        command(verb).main(f"gesticulator {verb}", [*part, "--help"])
    assert stop.value.code == 0
    known = set(OPTION.findall(capsys.readouterr().out))
    assert options <= known, f"{page}: {verb} does not know {', '.join(sorted(options - known))}"


def result(name: str) -> Any:
    return json.loads((DOCS / "results" / name).read_text(encoding="utf-8"))


def tables(name: str) -> dict[str, Table]:
    return {table.title: table for table in load(DOCS / "results" / name)}


def test_the_figures_of_the_readme_are_those_that_are_stored() -> None:
    quality, claims = tables("quality.json"), tables("claims.json")["Claims"].facts
    motion = tables("motion.json")
    controls = motion["Controls, words, interpreters, cost"].rows
    perceived = motion["Perceptual figures"].rows
    same = tables("stability.json")["The same sound exported again"].rows
    speed, onsets = result("realtime.json"), [row["f"] for row in result("onsets.json")["rows"].values()]
    times, valid, about = speed["real_time_factor"][0], claims["count"]["valid"], quality["Reconstruction"].facts

    def shown(title: str, row: str, column: str, digits: int, bounds: bool = True) -> str:
        cell: Any = quality[title].rows[row][column]
        return cell.text(digits) if bounds else f"{cell.mean:.{digits}f}"

    right, others = "Lexeme accuracy", ("value", "statistical", "speakers")

    def eye(row: str, *names: str) -> list[str]:
        return [str(perceived[f"{row}, BEAT voice"][system]).removesuffix(" !") for system in names]

    def apart(sound: str) -> str:
        return f"{float(str(same[f'hands apart, {sound}, cm']['value']).split()[0]):.0f}"

    timing = "PMB above chance, 0.1 s, first detector, %"
    far, size = "window Frechet to the reference", "stroke amplitude, median, cm"
    expected = [
        eye(far, *others),
        [motion["Acceptance of the motion"].notes[0].removesuffix(" clauses hold.")],
        eye(size, "value", "speakers"), eye("pauses with a moving hand, %", "value", "speakers"),
        eye("forearm outward, of the time, %", "value", "speakers"), eye(timing, *others),
        [f"{apart('6 dB quieter')} / {apart('MP3, 192 kbit/s')}", apart("another seed")],
        [", ".join(re.findall(r"in order in (\d+) %", " ".join(
            str(row["reason"]) for name, row in controls.items() if ", mid over low, " in name)))],
        [shown(right, "lstm", "free_running", 1),
         *(shown(right, name, "free_running", 1, False) for name in ("previous lexeme and speaker", "majority"))],
        [f"{sum(onsets) / len(onsets):.2f}"],
        [" / ".join(str(number) for number in (valid["holds"], valid["reversed"] + valid["no effect"],
                                               valid["inert"], valid["no valid test"], valid["undecided"]))],
        [f"{times['warm_lstm']:.2f} / {times['cold']:.2f}",
         f"{times['warm_with_text']:.2f} / {times['cold_with_text']:.2f}"],
    ]
    for row, values in zip(table_rows(text(README)), expected, strict=True):
        for value in values:
            assert value in row, f"{value} is stored, the README says {row}"
    assert f"{about['store']['test_recordings']} test recordings" in text(README)
    assert f"{about['seconds'] / 60:.0f} minutes" in text(README)


def shown_rows(page: str) -> dict[str, list[str]]:
    rows = [[cell.strip() for cell in row.strip().strip("|").split("|")] for row in table_rows(text(DOCS / page))]
    return {row[0]: row[1:] for row in rows}


def test_figures_of_the_guides_are_those_that_are_stored() -> None:
    speed, found, stream = result("realtime.json")["real_time_factor"][0], shown_rows("use.md"), result("stream.json")
    assert found["audio only"] == [f"{speed[name]:.2f}" for name in ("warm_lstm", "cold")]
    assert found["with a transcript, which is aligned and encoded"] == [
        f"{speed[name]:.2f}" for name in ("warm_with_text", "cold_with_text")]
    live, both = shown_rows("live.md"), ("full", "low")
    assert live['`latency="low"`'][:4] == [f"{value:.2f}" for value in stream["low"]["late"].values()]
    assert live["a piece of 20 ms that completes a block, p50 / p95 / p99, ms"] == [
        " / ".join(f"{1000 * stream[mode]['block'][name]:.1f}" for name in ("p50", "p95", "p99")) for mode in both]
    assert live["share of a processor per stream"] == [f"{stream[mode]['busy']:.3f}" for mode in both]
    for mode in both:
        pmb = [f"{stream[mode][name]:.1f}" for name in ("pmb", "pmb_chance", "pmb_above_chance")]
        assert live[f"`{mode}`"][:2] == pmb[:2] and live[f"`{mode}`"][2].startswith(f"{pmb[2]} (")
    kept = shown_rows("paper.md")["bounds that are kept"][0]
    assert tables("paper_motion.json")["Acceptance of the motion"].notes[0].startswith(kept)
