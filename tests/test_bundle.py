"""A bundle on disk: whole, checked, and readable by those who come later."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from untrained import PLAIN, SILENT, untrained

from data_module.errors import InputError
from data_module.types import Speech
from gesticulator import bundle as bundles
from gesticulator.pipeline import Gesticulator

PARTS = ("lexicon", "generator", "interpreter", "style", "encoder", "gate", "interpreter_text", "style_text",
         "q_network", "reward", "reward_judge")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with every part there is."""
    path = tmp_path_factory.mktemp("bundles") / "whole"
    bundles.save(untrained(), path, "a card")
    return path


def copy_of(bundle: Path, folder: Path) -> Path:
    return Path(shutil.copytree(bundle, folder / "copy"))


def edit(folder: Path, **changes: Any) -> None:
    index = json.loads((folder / "bundle.json").read_text())
    (folder / "bundle.json").write_text(json.dumps({**index, **changes}))


def same_weights(one: torch.nn.Module, two: torch.nn.Module) -> bool:
    a, b = ({key: value for key, value in module.state_dict().items() if not key.startswith("styles.")}
            for module in (one, two))
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


def test_every_part_survives_a_round_trip(whole: Path) -> None:
    made, read = untrained(), bundles.load(whole)
    for name in PARTS:
        assert same_weights(getattr(made, name), getattr(read, name)), name
        assert not getattr(read, name).training, name
    assert (read.text, read.config, read.speakers) == (made.text, made.config, made.speakers)
    assert read.silent.tolist() == list(SILENT)
    assert read.levels is not None and made.levels is not None
    for key, value in made.levels.to_dict().items():
        np.testing.assert_allclose(read.levels.to_dict()[key], value, rtol=1e-6)
    for name in ("mean_pose", "rest_pose", "deviation", "bounds", "quiet_low", "quiet_high"):
        np.testing.assert_array_equal(getattr(read.statistics, name), np.float32(getattr(made.statistics, name)))
    # The audio-only twin has no layer for words, the other has: they must not be exchanged.
    assert read.interpreter.encode_text is None and read.interpreter_text is not None
    assert read.interpreter_text.encode_text is not None


@pytest.mark.parametrize("lacking", [("gate",), ("style_text",), ("q_network", "reward", "reward_judge"),
                                     ("interpreter_text", "style_text", "text")])
def test_what_a_bundle_has_not_is_not_there_after_reading(lacking: tuple[str, ...], tmp_path: Path) -> None:
    less = dataclasses.replace(untrained(), **dict.fromkeys(lacking))
    bundles.save(less, tmp_path / "less", "a card")
    read = bundles.load(tmp_path / "less")
    for name in (*PARTS, "text"):
        assert (getattr(read, name) is None) == (name in lacking), name


def test_dimensions_that_the_data_never_moved_are_known_after_reading(tmp_path: Path) -> None:
    plain = untrained(*PLAIN)
    bounds = plain.statistics.bounds.copy()
    bounds[:, 40:] = 0.0
    bundles.save(dataclasses.replace(plain, statistics=dataclasses.replace(plain.statistics, bounds=bounds)),
                 tmp_path / "b", "a card")
    read = bundles.load(tmp_path / "b")
    made = read.lexicon.decode(read.lexicon.vectors)
    assert (made[..., 40:] == 0).all() and (made[..., :40] != 0).any()
    assert read.generator.present.tolist() == [1.0] * 40 + [0.0] * 8


def test_a_bundle_replaces_an_older_one_whole(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    bundles.save(untrained(*PLAIN), copy, "another card")
    assert not (copy / "gate.safetensors").exists() and (copy / bundles.CARD).read_text() == "another card"
    assert bundles.load(copy).gate is None
    assert [path.name for path in tmp_path.iterdir()] == ["copy"], "nothing left of the old one or of the writing"


def test_a_file_that_the_listing_does_not_name_is_ignored(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    files = json.loads((copy / "bundle.json").read_text())["files"]
    (copy / "gate.safetensors").write_bytes(b"not even a file of tensors")
    edit(copy, files={name: digest for name, digest in files.items() if name != "gate.safetensors"})
    read = bundles.load(copy)
    assert read.gate is None and read.interpreter_text is not None


NEW = {"encoder", "text", "control", "gate", "reward", "episodes", "cql", "tokens", "racer"}
NEW_INSIDE = {"front_end": {"layers"}, "motion": {"representation"}, "silence": {"lexemes", "settle"},
              "selection": {"activity", "guidance", "q_temperature"},
              "schedules": {"speech", "contrast", "gate", "interpreter_text", "reward", "cql"},
              "generator": {"audio_bottleneck", "use_control", "style_dropout"},
              "interpreter": {"audio_bottleneck", "text_features", "text_blocks", "text_bottleneck", "text_reading",
                              "reading_dropout", "use_control"},
              "style": {"audio_bottleneck", "text_features", "text_blocks", "text_bottleneck"}}


def as_format_1(path: Path) -> Path:
    """A bundle as version 0.1 wrote it: mel bands, and none of the settings that came later."""
    plain = untrained(*PLAIN, "interpreter.audio_bottleneck=0", "style.audio_bottleneck=0",
                      "generator.audio_bottleneck=0")
    bundles.save(plain, path, "a card")
    index = json.loads((path / "bundle.json").read_text())
    del index["text"]
    config = {key: value for key, value in index["config"].items() if key not in NEW}
    for group, names in NEW_INSIDE.items():
        config[group] = {key: value for key, value in config[group].items() if key not in names}
    (path / "bundle.json").write_text(json.dumps({**index, "format": 1, "config": config}))
    return path


def test_a_bundle_of_format_1_still_gestures(tmp_path: Path) -> None:
    read = bundles.load(as_format_1(tmp_path / "old"))
    assert (read.encoder, read.gate, read.text, read.levels, read.interpreter_text) == (None,) * 5
    speech = Speech(np.random.default_rng(0).normal(0, 0.1, 32000).astype(np.float32), 16000)
    made = Gesticulator(read)(speech)
    assert np.isfinite(made.motion.rotations).all() and made.motion.duration == pytest.approx(2.0, abs=0.02)
    # What the settings mean has not changed: the same weights under today's settings move the same.
    plain = untrained(*PLAIN, "interpreter.audio_bottleneck=0", "style.audio_bottleneck=0",
                      "generator.audio_bottleneck=0")
    bundles.save(plain, tmp_path / "new", "a card")
    again = Gesticulator(bundles.load(tmp_path / "new"))(speech)
    np.testing.assert_array_equal(made.motion.rotations, again.motion.rotations)


def test_a_q_network_of_another_lexicon_is_refused(whole: Path, tmp_path: Path) -> None:
    other = untrained(seed=7)
    bundles.save(other, tmp_path / "other", "a card")
    copy = copy_of(whole, tmp_path)
    shutil.copy(tmp_path / "other" / "q_network.safetensors", copy)
    foreign = json.loads((tmp_path / "other" / "bundle.json").read_text())["files"]["q_network.safetensors"]
    edit(copy, files={**json.loads((copy / "bundle.json").read_text())["files"], "q_network.safetensors": foreign})
    with pytest.raises(InputError, match=r"q_network\.safetensors.*another lexicon"):
        bundles.load(copy)


def test_a_bundle_of_format_2_still_gestures(tmp_path: Path) -> None:
    bundles.save(untrained("schedules.cql.steps=0"), tmp_path / "old", "a card")
    index = json.loads((tmp_path / "old" / "bundle.json").read_text())
    config = {key: value for key, value in index["config"].items()
              if key not in ("reward", "episodes", "cql", "tokens", "racer")}
    config["interpreter"] = {key: value for key, value in config["interpreter"].items() if "reading" not in key}
    for group, names in {"schedules": ("reward", "cql"), "selection": ("q_temperature",)}.items():
        config[group] = {key: value for key, value in config[group].items() if key not in names}
    edit(tmp_path / "old", format=2, config=config)
    system = Gesticulator(bundles.load(tmp_path / "old"))
    speech = Speech(np.random.default_rng(0).normal(0, 0.1, 32000).astype(np.float32), 16000)
    assert np.isfinite(system(speech).motion.rotations).all()
    with pytest.raises(InputError, match=r"--interpreter cql: is not in the bundle.*lstm, statistical"):
        system(speech, interpreter="cql")


@pytest.mark.parametrize("number", [0, 4, 99, "2", None])
def test_an_unknown_format_is_refused_by_its_number(number: object, whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    edit(copy, format=number)
    with pytest.raises(InputError, match=f"format {number}"):
        bundles.load(copy)


def test_broken_and_foreign_bundles_are_refused_by_name(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    for name in ("generator", "gate", "lexeme_interpreter_text"):
        file = copy / f"{name}.safetensors"
        before = file.read_bytes()
        file.write_bytes(before[:-1] + bytes([before[-1] ^ 1]))
        with pytest.raises(InputError, match=rf"{name}\.safetensors.*SHA-256"):
            bundles.load(copy)
        file.write_bytes(before)
    (copy / "generator.safetensors").unlink()
    with pytest.raises(InputError, match="missing"):
        bundles.load(copy)
    index = json.loads((copy / "bundle.json").read_text())
    edit(copy, skeleton={**index["skeleton"], "names": ["A"]})
    with pytest.raises(InputError, match="skeleton"):
        bundles.load(copy)
    (copy / "bundle.json").write_text("{")
    with pytest.raises(InputError, match="broken"):
        bundles.load(copy)
    with pytest.raises(InputError, match="not a bundle"):
        bundles.load(tmp_path)


@pytest.mark.parametrize("text", [None, {"encoder": "minilm", "width": 17}, {"encoder": "minilm"}])
def test_an_interpreter_that_reads_needs_to_know_what(text: object, whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    edit(copy, text=text)
    with pytest.raises(InputError, match="does not fit together"):
        bundles.load(copy)


def test_a_bundle_without_an_interpreter_is_refused(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    files = json.loads((copy / "bundle.json").read_text())["files"]
    edit(copy, files={name: digest for name, digest in files.items() if name != "lexeme_interpreter.safetensors"})
    with pytest.raises(InputError):
        bundles.load(copy)


def test_a_trained_bundle_is_the_same_after_a_round_trip(tiny_bundle: Path, tmp_path: Path) -> None:
    one = bundles.load(tiny_bundle)
    bundles.save(one, tmp_path / "again", (tiny_bundle / bundles.CARD).read_text())
    assert {f.name for f in tiny_bundle.iterdir()} == {f.name for f in (tmp_path / "again").iterdir()}
    for file in tiny_bundle.glob("*.safetensors"):
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()
    assert bundles.load(tmp_path / "again").config == one.config


def test_a_bundle_never_replaces_something_else(tmp_path: Path) -> None:
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").write_text("kept")
    with pytest.raises(InputError, match="not a bundle"):
        bundles.save(untrained(*PLAIN), tmp_path / "precious", "card")
    assert [p.name for p in tmp_path.iterdir()] == ["precious"]
