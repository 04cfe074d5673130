"""The soak's report: a column for each piece, and the stored page says what the stored runs say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmark_files import benchmark

ROOT = Path(__file__).parents[1]
STORED = ROOT / "docs" / "results" / "soak.json"


@pytest.fixture(autouse=True)
def neighbours(monkeypatch: pytest.MonkeyPatch) -> None:
    """The soak imports the attacks and the client."""
    monkeypatch.syspath_prepend(str(ROOT / "integrations" / "pipecat-gesticulator"))
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))


def test_the_stored_page_is_that_of_the_stored_pieces() -> None:
    pieces = json.loads(STORED.read_text())["pieces"]
    page = benchmark("soak").table(pieces)
    assert STORED.with_suffix(".md").read_text() == page
    for piece in pieces:
        assert piece["minutes"] >= 80 and piece["concurrent"] >= 8
        assert f"commit {piece['commit']}" in page


def test_a_piece_with_lost_frames_shows_it_in_its_own_column() -> None:
    [piece, *_] = json.loads(STORED.read_text())["pieces"]
    good = {**piece, "lost": 0, "doubled": 0}
    bad = {**piece, "lost": 7, "doubled": 1, "exit_code": 3, "oddities": ["face: frame 9 for 2"]}
    page = benchmark("soak").table([good, bad])
    assert "| frames lost | 0 | 7 |" in page
    for name in ("nothing lost", "nothing came twice", "ended well"):
        assert f"| {name} | yes | **no** |" in page
    assert "- Piece 2: face: frame 9 for 2" in page
