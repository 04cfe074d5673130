"""Tables and claims of two runs: each whole from one of them, and no row beside one of the other."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_module.errors import InputError
from eval.ablate.cells import Cells, summaries
from eval.ablate.earlier import measured, word_of
from eval.ablate.rows import ELSEWHERE, TABLES
from eval.ablate.tables import write
from eval.ablate.verdicts import HOLDS, WORDS, present
from eval.table import Provenance, Table, load

CLIPS = 12


def cells(**fgd: float) -> Cells:
    """Three seeds of rows whose FGD is about so much."""
    rng = np.random.default_rng(0)
    hard = rng.normal(0, 1, size=CLIPS)

    def cell(value: float) -> dict[str, Any]:
        return {"clips": [{"name": str(k), "fgd": float(value + hard[k] + rng.normal(0, 0.1))} for k in range(CLIPS)],
                "sets": {}}

    return {name.replace("_", "-"): {seed: cell(value) for seed in (1, 2, 3)} for name, value in fgd.items()}


def run(out: Path, commit: str, rows: Cells, earlier: Path | None = None) -> tuple[dict[str, Table], Table]:
    """The tables by title and the claims that a run of these rows writes."""
    facts = {"preset": "paper-quick", "refused": {}, "rows": summaries(rows),
             "store": {"name": "made", "fingerprint": commit * 8, "test_recordings": CLIPS}}
    write(rows, facts, out, Provenance("ablate", commit, "none", "2026-01-01", "2 cores"), earlier=earlier)
    claims = next(table for table in load(out.parent / "claims.json") if table.title == "Claims")
    return {table.title: table for table in load(out / "table.json")}, claims


def claim(claims: Table, where: str, text: str) -> dict[str, object]:
    """The line of a claim."""
    return next(dict(row) for row in claims.rows.values() if (row["where"], row["claim"]) == (where, text))


BY_BEATS = ("RG Table 1", "FGD: ours lower than no-segmentation")
BY_RANGE = ("RG Table 4", "FGD: ours lower than range-0.2-1.0")


def test_a_table_and_a_claim_are_of_the_run_that_has_their_rows(tmp_path: Path) -> None:
    first = tmp_path / "first" / "ablation"
    before, decided = run(first, "aaaa", cells(ours=10, no_segmentation=90))
    tables, claims = run(tmp_path / "second" / "ablation", "bbbb", cells(ours=50, range_0_2_1_0=40) | {
        "range-0.2-1.0": cells(x=80)["x"]}, first)
    one, four = "RG Table 1 (test)", "RG Table 4 (test)"
    assert tables[one].rows == before[one].rows and "aaaa" in tables[one].notes[-1]
    assert measured(tables[four]) == 2 and not any("Of the run" in note for note in tables[four].notes)
    assert tables[four].rows["0.2 to 0.5 s"]["fgd"].mean == pytest.approx(50, abs=1)  # type: ignore[union-attr]
    kept, new = claim(claims, *BY_BEATS), claim(claims, *BY_RANGE)
    assert {**claim(decided, *BY_BEATS), "run": "aaaa, corpus aaaaaaaa"} == kept
    assert new["run"] == "bbbb, corpus bbbbbbbb" and str(new["published"]).startswith("holds")
    # `ours` is in both runs, but is never compared with the other run's rows.
    neither = claim(claims, "RG Table 1", "FGD: ours lower than no-style")
    assert "not run: no-style" in str(neither["published"])
    count = claims.facts["count"]["published"]
    elsewhere = sum(present(other).word == HOLDS for other in ELSEWHERE)
    assert (count["holds"], sum(count.values())) == (2 + elsewhere, len(claims.rows))


def test_a_third_run_keeps_the_names_of_the_first_two(tmp_path: Path) -> None:
    one, two, three = (tmp_path / name / "ablation" for name in ("one", "two", "three"))
    run(one, "aaaa", cells(ours=10, no_segmentation=90))
    run(two, "bbbb", cells(ours=50) | {"range-0.2-1.0": cells(x=80)["x"]}, one)
    tables, claims = run(three, "cccc", cells(ours=30, no_position=60), two)
    assert [tables[f"RG Table {number} (test)"].notes[-1] for number in (1, 4)] == [
        f"Of the run {name}, corpus {name * 2}." for name in ("aaaa", "bbbb")]
    assert [str(claim(claims, *which)["run"])[:4] for which in (BY_BEATS, BY_RANGE, (
        "RG Table 7", "FGD: ours lower than no-position"))] == ["aaaa", "bbbb", "cccc"]


def test_what_is_no_run_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"table\.json"):
        run(tmp_path / "out" / "ablation", "bbbb", cells(ours=50), tmp_path / "nothing")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("word", WORDS)
def test_the_word_of_a_verdict_is_read_whatever_stands_around_it(word: str) -> None:
    assert word_of(word) == word_of(f"{word} (not run: range-0.2-1.0)") == word
    assert word_of(f"PMB at 0.1 s above chance, %, 21.5 [12.7, 30.4] (6.6): {word} (a control holds: no)") == word
    with pytest.raises(ValueError, match="no verdict"):
        word_of("PMB at 0.1 s")


def test_every_table_has_a_title_of_its_own() -> None:
    """Tables of two runs are told apart by their titles."""
    assert len({f"{title} ({table.split})" for title, table in TABLES.items()}) == len(TABLES)
