"""The search finds what is known to be best, goes on after a kill in the trial that was under way, and refuses what is
no range."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from gesticulator_extra.tune import COMMAND, SearchRange, SettingSearch, Value, report

from data_module.errors import InputError

RANGES = (SearchRange.parse("rate=1e-4..1e0:log"), SearchRange.parse("width=1..9"), SearchRange.parse("kind=a,b"))


@pytest.mark.parametrize(("text", "whole", "log"), [("a.b=1..8", True, False), ("a.b=1..8.0", False, False),
                                                    ("a.b=1e-4..0.1:log", False, True), ("a.b=-3..4", True, False)])
def test_a_range_is_read(text: str, whole: bool, log: bool) -> None:
    one = SearchRange.parse(text)
    assert (one.path, one.whole, one.log) == ("a.b", whole, log) and one.low < one.high


@pytest.mark.parametrize("text", ["a", "a=", "=1..2", "a=2..1", "a=1..2:cube", "a=0..1:log", "a=1..x", "a=1..2..3",
                                  "a=1..inf", "a=nan..2"])
def test_what_is_no_range_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="is not a range"):
        SearchRange.parse(text)


def apart(settings: Mapping[str, Value]) -> float:
    """0 at a rate of 0.01, a width of 7 and kind b."""
    import math

    rate, width = float(settings["rate"]), int(settings["width"])
    return (math.log10(rate) + 2) ** 2 + (width - 7) ** 2 / 10 + (settings["kind"] != "b")


def test_the_best_is_found_and_a_search_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("optuna", reason="Optuna is not installed: pip install 'gesticulator-extra[tune]'")
    search, tried = SettingSearch(tmp_path / "t.db", "s", RANGES), list[Mapping[str, Value]]()

    def noted(settings: Mapping[str, Value]) -> float:
        tried.append(settings)
        return apart(settings)

    first = search.run(noted, 10)
    assert len(tried) == 10 and [value for value, _ in first] == sorted(apart(one) for one in tried)
    found = search.run(noted, 50)
    assert len(tried) == 50 == len({tuple(one.values()) for one in tried}), "nothing is tried twice"
    value, settings = found[0]
    assert value < 0.2 and settings["kind"] == "b" and 0.004 < float(settings["rate"]) < 0.025
    assert search.run(noted, 20) == found and len(tried) == 50
    assert report(found, "lexicon", "error")[1].endswith("--set kind=b")
    highest = SettingSearch(tmp_path / "t.db", "h", RANGES, highest=True).run(apart, 5)
    assert highest[0][0] == max(value for value, _ in highest)


def test_a_trial_that_was_killed_is_done_again(tmp_path: Path) -> None:
    pytest.importorskip("optuna", reason="Optuna is not installed: pip install 'gesticulator-extra[tune]'")
    code = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from test_tune import RANGES, apart
from gesticulator_extra.tune import SettingSearch
seen = []
def killed(settings):
    seen.append(settings)
    if len(seen) == 3:
        Path({str(tmp_path / "last")!r}).write_text(repr(settings))
        os.kill(os.getpid(), 9)
    return apart(settings)
SettingSearch(Path({str(tmp_path / "t.db")!r}), "s", RANGES).run(killed, 5)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    tried: list[str] = []

    def noted(settings: Mapping[str, Value]) -> float:
        tried.append(repr(settings))
        return apart(settings)

    found = SettingSearch(tmp_path / "t.db", "s", RANGES).run(noted, 5)
    assert len(found) == 5 and len(tried) == 3 and tried[0] == (tmp_path / "last").read_text()


def test_a_stage_is_tuned(tiny_store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("optuna", reason="Optuna is not installed: pip install 'gesticulator-extra[tune]'")
    asked = ["--data", str(tiny_store), "--work", str(tmp_path / "w"), "--preset", "tiny", "--stage", "lexicon",
             "--set", "schedules.speech.steps=1", "--set", "schedules.contrast.steps=1", "--search",
             "schedules.lexicon.steps=1,60", "--trials", "3", "--figure"]
    with pytest.raises(SystemExit):
        COMMAND.main("gesticulator tune", [*asked, "beauty"])
    assert "choose among" in capsys.readouterr().err
    assert COMMAND.main("gesticulator tune", [*asked, "quantised"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("3 trials; quantised of lexicon")
    rows = [tuple(line.split()) for line in lines[1:]]
    assert len(rows) == 3 and [float(row[0]) for row in rows] == sorted(float(row[0]) for row in rows)
    assert len({row[0] for row in rows}) == len({row[2] for row in rows}), "the same settings, the same figure"
