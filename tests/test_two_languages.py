"""One language against two for the speech encoder."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import torch

from data_module.speech.speech_encoder import PredictiveCoding, SpeechEncoder
from data_module.store import Store
from eval.commands import PROBE
from eval.probes import two_languages
from gesticulator import config as configs
from gesticulator import presets


@pytest.fixture(scope="module")
def config() -> configs.Config:
    tiny = presets.preset("tiny")
    speech = dataclasses.replace(tiny.schedules.speech, steps=3)
    return dataclasses.replace(tiny, schedules=dataclasses.replace(tiny.schedules, speech=speech))


def test_the_table_pairs_the_same_recordings_and_the_second_language_changes_the_encoder(
        config: configs.Config, tiny_store: Path, tmp_path: Path) -> None:
    store = Store.open(tiny_store)
    row: Any = two_languages.figures(config, store, "en", store, tmp_path, progress=False).rows["en"]
    assert row["recordings"] == len(two_languages.names_of(store, "test"))
    assert row["two - one"].mean == pytest.approx(row["two"].mean - row["one"].mean)
    one, two = (sorted((tmp_path / name).glob("speech-*/weights.safetensors")) for name in ("one", "two"))
    assert one and two and one[0].parent.name != two[0].parent.name, "more speech is another stage"
    linked = {file.stem for file in (tmp_path / "two").glob("speech-of-*/*.flac")}
    assert linked == set(two_languages.names_of(store, "train")), "the test speech stays unheard"


def test_the_crops_and_negatives_are_the_same_for_every_model(config: configs.Config, tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    names = two_languages.names_of(store, "test")
    torch.manual_seed(1)
    model = PredictiveCoding(SpeechEncoder(config.encoder), config.encoder).eval()
    first = two_languages.accuracies(model, store, names, 24000)
    torch.manual_seed(99)
    again = two_languages.accuracies(model, store, names, 24000)
    assert (first == again).all()
    assert ((first > 3) & (first < 30)).all(), "an untrained net is near chance, 9.1 %"


def test_a_language_that_is_not_there_is_one_line(tiny_store: Path, tmp_path: Path,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        PROBE.main("gesticulator probe", ["two-languages", "--data", str(tiny_store), "--other", str(tiny_store),
                                          "--work", str(tmp_path),
                                          "--language", "fr", "--preset", "tiny"])
    assert stop.value.code == 2
    assert "fr" in capsys.readouterr().err
