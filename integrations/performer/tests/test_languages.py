"""Corpora in other languages."""

from __future__ import annotations

from pathlib import Path

import pytest
from gesticulator_performer import voices
from gesticulator_performer.reader import Performer, PerformerOptions, Script

from data_module.corpora.base import Reader
from data_module.errors import InputError

# ---------------------------------------------------------------------------------------------------- corpora

def _plan(source: Path, *spoken: str, hours: float = 1.5) -> Reader:
    return Performer(source, PerformerOptions(hours=hours, languages=spoken))


@pytest.mark.parametrize("spoken", [("de",), ("de", "es"), ("cmn",), ("cmn", "de", "es")])
def test_a_corpus_of_other_languages_has_nothing_else(outside_data: Path, spoken: tuple[str, ...]) -> None:
    items = _plan(outside_data, *spoken).items()
    infos = [item.info for item in items]
    assert {info.language for info in infos} == set(spoken)
    talks = [info for info in infos if info.name.startswith("talk")]
    assert {info.language for info in talks if info.split == "train"} == set(spoken)
    assert all(voices.VOICES[info.voice].language == info.language for info in talks)
    assert {info.voice for info in infos if info.name.startswith("read")} == {
        f"{language}_prose_1" for language in spoken if language != "cmn"}
    kept = {info.voice for info in talks if info.split == "test"}
    assert kept and not kept & {info.voice for info in talks if info.split != "test"}
    train = {u.text for item in items if isinstance(item.content, Script) and item.info.split != "test"
             for u in item.content.utterances}
    test = {u.text for item in items if isinstance(item.content, Script) and item.info.split == "test"
            for u in item.content.utterances}
    assert test and not train & test


def test_without_languages_talks_are_english_and_every_reading_is_used(outside_data: Path) -> None:
    pytest.importorskip("pocketsphinx")
    reader = Performer(outside_data, PerformerOptions())
    talks = [item for item in reader.items() if item.info.part == "talk"]
    assert [(item.info.name, item.info.split, item.info.voice) for item in talks[:8]] == [
        ("talk_0000_brad", "train", "slt"), ("talk_0001_brad2", "train", "rms"), ("talk_0002_connor", "train", "kal"),
        ("talk_0003_garza", "train", "us_f3"), ("talk_0004_brad", "train", "rms_light"),
        ("talk_0005_brad2", "train", "gb_m3"), ("talk_0006_brad", "test", "awb"),
        ("talk_0007_connor", "train", "slt_high")]
    assert {item.info.language for item in talks} == {"en"}
    assert {item.info.voice for item in reader.items() if item.info.language != "en"} == {"de_prose_1", "es_prose_1"}
    assert "languages" not in reader.settings()


def test_languages_that_nobody_speaks_are_refused(outside_data: Path) -> None:
    with pytest.raises(InputError, match=r"--languages de,xx: no voice speaks xx.*cmn, de, en, es"):
        _plan(outside_data, "de", "xx")
