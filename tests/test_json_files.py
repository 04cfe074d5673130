"""The one reader of JSON: what is not JSON, or would cost memory or a crash later, is named with its place."""

import json
import math
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.files import DEEPEST, MOST_DIGITS, MOST_VALUES, parse_json, read_json, read_object

_PLAIN = st.recursive(st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
                      | st.text(st.characters(exclude_categories=("Cs",))),
                      lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20)


@given(_PLAIN)
def test_what_python_writes_is_read_as_it_was(value: object) -> None:
    for ascii_only in (True, False):
        text = json.dumps(value, ensure_ascii=ascii_only)
        if "\0" not in text:
            try:
                data = text.encode()
            except UnicodeEncodeError:  # a name of half a character
                continue
            assert parse_json(data, "a", "") == value


@pytest.mark.parametrize(("text", "wrong"), [
    ("", "line 1: is not valid JSON"), ("{", "line 1"), ("[1,\n2,\n}", "line 3"),
    ("NaN", "not valid"), ("[Infinity]", "not valid"), ("[-Infinity]", "not valid"),
    ("9" * (MOST_DIGITS + 1), "a number of 301 digits"), ("-" + "9" * 5000, "a number of 5000 digits"),
    ("1e999", "out of range"), ("-1E+400", "out of range"), ("1" * 400 + ".5", "a number of 400 digits"),
    ("[" * (DEEPEST + 1) + "]" * (DEEPEST + 1), "nested more than 100 deep"), ("[" * 100_000, "nested more than 100"),
    ('{"a":' * 5000 + "1" + "}" * 5000, "nested more than 100 deep"), ('["\\ud800"]', "not valid"),
    ('{"\\udfff": 1}', "surrogate"), ("[" + "[]," * MOST_VALUES + "1]", "more than 4,194,304 values"),
])
def test_what_is_refused(text: str, wrong: str) -> None:
    with pytest.raises(InputError, match=wrong) as error:
        parse_json(text, "a.json", "mend it")
    assert str(error.value).startswith("a.json: ") and str(error.value).endswith("; mend it")
    assert len(str(error.value)) < 200


def test_too_many_values_are_refused_before_they_are_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(msgspec.json, "decode", lambda text: pytest.fail("a text of too many values is parsed"))
    for text, wrong in (("[" + "0," * (MOST_VALUES + 1) + "0]", "values"), ("9" * 100_000, "digits")):
        with pytest.raises(InputError, match=wrong):
            parse_json(text, "a", "")


@pytest.mark.parametrize(("text", "value"), [
    ("9" * MOST_DIGITS, int("9" * MOST_DIGITS)), ("1e308", 1e308), ("1e0000000001", 10.0), ("1e-999", 0.0),
    ("[" * DEEPEST + "]" * DEEPEST, None), ('"1e999"', "1e999"),
    ('{"a": 1, "a": 2}', {"a": 2}), ('"\\ud83d\\ude00"', "\N{GRINNING FACE}"),
])
def test_what_is_taken(text: str, value: object) -> None:
    assert value is None or parse_json(text, "a", "") == value


def test_marks_zero_bytes_and_other_encodings(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        file.write_bytes('{"a": "ü"}'.encode(encoding))
        assert read_json(file, "") == {"a": "ü"} == parse_json(file.read_bytes(), file, "")
    file.write_bytes(b'"a\0"')
    with pytest.raises(InputError, match="zero byte"):
        read_json(file, "")
    file.write_bytes(b'\n"\xff"')
    with pytest.raises(InputError, match="line 2: is not text in UTF-8"):
        read_json(file, "")
    file.write_text("[1]")
    with pytest.raises(InputError, match="is not a JSON object"):
        read_object(file, "")
    with pytest.raises(InputError, match="is larger than 0 MiB"):
        read_object(file, "", 2)
    with pytest.raises(InputError, match="does not exist"):
        read_json(tmp_path / "b.json", "")


def test_what_python_writes_beyond_the_standard_is_read_where_it_wrote_it() -> None:
    told = {"a": math.inf, "b": "caf\udce9.wav"}
    assert parse_json(json.dumps(told), "a", "", python=True) == told
    assert math.isnan(parse_json("NaN", "a", "", python=True))
    with pytest.raises(InputError):
        parse_json("9" * 5000, "a", "", python=True)
