"""Tables: JSON that any program reads and that comes back, Markdown that renders, files whole or not at all."""

import hashlib
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from eval.context import without_work
from eval.stats import Interval
from eval.table import (
    MOST_COLUMNS,
    NO_BUNDLE,
    NOT_RECORDED,
    Cell,
    Column,
    Marked,
    Provenance,
    Table,
    dumps,
    load,
    load_with_provenance,
    markdown,
    publish,
    save,
    undefined,
)

VALUES = st.recursive(st.floats() | st.integers() | st.booleans() | st.text(),
                      lambda own: st.lists(own, max_size=3) | st.dictionaries(st.text(), own, max_size=3), max_leaves=8)
RESULTS = Path(__file__).parent.parent / "docs" / "results"
STORED = [file for file in sorted(RESULTS.rglob("*.json")) if file.with_suffix(".md").is_file()]
"""Files of tables."""
ROW: dict[str, Cell] = {"a": Interval(1.25, 1.0, 1.5, 3), "b": Marked(2, "(!)", "too good"), "c": "x | y"}
TABLE = Table("Speed", {"a": Column("hands", "m/s", 1, "near"), "b": Column("n", digits=0), "c": Column("text")},
              {"ours": ROW, "theirs": {"a": None, "b": math.nan}}, head="system", notes=["One note."],
              facts={"curve": [1.0, math.nan]})


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_what_is_finite_comes_back_and_what_is_not_is_undefined(result: dict[str, object]) -> None:
    def strict(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    text = dumps(result)
    json.loads(text, parse_constant=strict)
    same(result, undefined(json.loads(text)))


def same(given: object, back: object) -> None:
    if isinstance(given, dict):
        assert isinstance(back, dict) and list(back) == list(given)
        for key in given:
            same(given[key], back[key])
    elif isinstance(given, list):
        assert isinstance(back, list)
        for one, other in zip(given, back, strict=True):
            same(one, other)
    elif isinstance(given, float) and not math.isfinite(given):
        assert isinstance(back, float) and math.isnan(back)
    else:
        assert back == given


def test_numbers_of_numpy_are_numbers() -> None:
    assert json.loads(dumps({"n": np.int64(3), "yes": np.bool_(True), "x": [np.float32(0.5)]})) == {
        "n": 3, "yes": True, "x": [0.5]}


ABOUT = Provenance("gesticulator probe x", "abc1234", NO_BUNDLE, "2026-01-02", NOT_RECORDED)


def test_no_table_is_written_without_saying_where_it_comes_from(tmp_path: Path) -> None:
    for name in ("command", "commit", "bundle", "date", "machine"):
        with pytest.raises(ValueError, match=name):
            replace(ABOUT, **{name: " "})
    (tmp_path / "x.json").write_text(dumps({"tables": [TABLE.to_dict()]}))
    with pytest.raises(InputError, match="holds no tables"):
        load(tmp_path / "x.json")


def test_provenance_has_the_commit_and_the_hash_of_the_bundles_index(tmp_path: Path) -> None:
    index = tmp_path / "bundle.json"
    index.write_bytes(b"weights")
    about = Provenance.now("gesticulator probe x", index)
    assert about.bundle == hashlib.sha256(b"weights").hexdigest()[:12] and "cores" in about.machine
    assert about.commit == NOT_RECORDED or re.fullmatch("[0-9a-f]{7,}(-dirty)?", about.commit)
    assert Provenance.now("gesticulator probe x").bundle == NO_BUNDLE
    assert ABOUT.markdown() == ("`gesticulator probe x` · commit `abc1234` · bundle none · 2026-01-02 · "
                                "machine: not recorded\n")


def test_a_wide_table_goes_on_below_with_the_same_rows() -> None:
    keys = [f"k{number}" for number in range(17)]
    wide = Table("Wide", {key: Column(key) for key in keys}, {"ours": {key: float(key[1:]) for key in keys}}, "row")
    lines = [line.strip("| ").split(" | ") for line in wide.markdown().splitlines() if line.startswith("| ")]
    assert [len(line) for line in lines] == [7, 7, 7, 7, 6, 6]
    assert max(map(len, lines)) <= MOST_COLUMNS
    assert [key for head in lines[::2] for key in head[1:]] == keys
    assert [float(value) for row in lines[1::2] for value in row[1:]] == list(range(17))
    assert all(row[0] == "ours" for row in lines[1::2]) and all(head[0] == "row" for head in lines[::2])


def test_a_table_comes_back_from_its_file_and_markdown_stands_beside_it(tmp_path: Path) -> None:
    save([TABLE, TABLE], tmp_path / "new" / "x.json", ABOUT)
    (first, second), about = load_with_provenance(tmp_path / "new" / "x.json")
    assert about == ABOUT
    assert first.rows["ours"] == ROW and first.columns == TABLE.columns and first.notes == ["One note."]
    assert first.rows["theirs"] == {"a": None, "b": None} and math.isnan(first.facts["curve"][1])
    assert (tmp_path / "new" / "x.md").read_text() == "\n".join(
        [ABOUT.markdown(), first.markdown(), second.markdown()])


def test_a_table_is_printed_where_no_file_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    publish([TABLE], None, ABOUT)
    shown = capsys.readouterr().out
    assert "1.2 [1.0, 1.5]" in shown and "One note." in shown


@pytest.mark.parametrize("file", STORED, ids=lambda file: file.relative_to(RESULTS).as_posix())
def test_a_stored_table_says_where_it_comes_from_and_fits_a_page(file: Path) -> None:
    tables, about = load_with_provenance(file)
    page = file.with_suffix(".md").read_text()
    assert page == markdown(tables, about), "what is read is what was written"
    assert page.startswith(f"`{about.command}` · commit ")
    assert not re.search(r"[ =]/\w", about.command), "names no place of one machine"
    heads = [line for line in page.splitlines() if set(line) == {"|", "-"}]
    assert heads and all(line.count("---") <= MOST_COLUMNS for line in heads)
    assert all(table.title for table in tables)


def test_a_command_is_recorded_without_its_work_folder() -> None:
    words = ["probe", "motion", "--work", "/a/b", "--limit", "16", "--work=/a/b", "--out", "motion.json"]
    assert without_work(words) == ["probe", "motion", "--limit", "16", "--out", "motion.json"]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"tables": [1]}', '{"tables": [{}]}', "[" * 5000])
def test_a_file_that_holds_no_tables_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(InputError, match=r"x\.json"):
        load(tmp_path / "x.json")
    with pytest.raises(InputError, match="not there"):
        load(tmp_path / "y.json")
