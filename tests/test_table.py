"""Tables: JSON that any program reads and that comes back, Markdown that renders, files whole or not at all."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from eval.stats import Interval
from eval.table import Cell, Column, Marked, Table, dumps, load, loads, publish, save

VALUES = st.recursive(st.floats() | st.integers() | st.booleans() | st.text(),
                      lambda own: st.lists(own, max_size=3) | st.dictionaries(st.text(), own, max_size=3), max_leaves=8)
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
    same(result, loads(text))


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
    assert loads(dumps({"n": np.int64(3), "yes": np.bool_(True), "x": [np.float32(0.5)]})) == {
        "n": 3, "yes": True, "x": [0.5]}


def test_a_table_comes_back_from_its_file_and_markdown_stands_beside_it(tmp_path: Path) -> None:
    save([TABLE, TABLE], tmp_path / "new" / "x.json")
    first, second = load(tmp_path / "new" / "x.json")
    assert first.rows["ours"] == ROW and first.columns == TABLE.columns and first.notes == ["One note."]
    assert first.rows["theirs"] == {"a": None, "b": None} and math.isnan(first.facts["curve"][1])
    assert (tmp_path / "new" / "x.md").read_text() == first.markdown() + "\n" + second.markdown()


def test_markdown_has_as_many_cells_in_each_line_and_shows_units_digits_marks() -> None:
    lines = [line for line in TABLE.markdown().splitlines() if line.startswith("|")]
    assert {line.replace("\\|", "").count("|") for line in lines} == {5}
    assert "hands, m/s" in lines[0] and "1.2 [1.0, 1.5]" in lines[2] and "2 (!)" in lines[2]
    assert lines[3].split("|")[2:4] == [" - ", " - "]


def test_a_table_is_printed_where_no_file_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    publish([TABLE], None)
    shown = capsys.readouterr().out
    assert "1.2 [1.0, 1.5]" in shown and "One note." in shown


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"tables": [1]}', '{"tables": [{}]}', "[" * 5000])
def test_a_file_that_holds_no_tables_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(InputError, match=r"x\.json"):
        load(tmp_path / "x.json")
    with pytest.raises(InputError, match="not there"):
        load(tmp_path / "y.json")
