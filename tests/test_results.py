"""Where figures are kept: JSON that any program reads, and NaN again for our own."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.results import dumped, keep, loaded, publish

VALUES = st.recursive(st.floats() | st.integers() | st.booleans() | st.text(),
                      lambda own: st.lists(own, max_size=3) | st.dictionaries(st.text(), own, max_size=3), max_leaves=8)


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_what_is_finite_comes_back_and_what_is_not_is_undefined(result: dict[str, object]) -> None:
    def strict(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    text = dumped(result)
    json.loads(text, parse_constant=strict)
    same(result, loaded(text))


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


def test_json_and_markdown_stand_beside_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep({"b": float("nan"), "a": [1.5]}, "| a |\n", tmp_path / "new" / "x.json")
    assert json.loads((tmp_path / "new" / "x.json").read_text()) == {"b": None, "a": [1.5]}
    assert (tmp_path / "new" / "x.md").read_text() == "| a |\n"
    publish({}, "shown", None)
    assert capsys.readouterr().out == "shown\n" and sorted(path.name for path in tmp_path.iterdir()) == ["new"]
