"""A bundle on disk: whole, checked, and readable by those who come later."""

import dataclasses
import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from untrained import PLAIN, SILENT, untrained

from data_module.errors import InputError
from data_module.types import Speech
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import models
from gesticulator.bundle.features import Sizes
from gesticulator.bundle.files import CARD, read_index
from gesticulator.bundle.models import part_table
from gesticulator.gesticulator import Gesticulator

SMALL = ("interpreter.audio_bottleneck=0", "style.audio_bottleneck=0", "generator.audio_bottleneck=0")
SPEECH = Speech(np.random.default_rng(0).normal(0, 0.1, 32000).astype(np.float32), 16000)
PARTS = ("lexicon", "generator", "interpreter", "style", "encoder", "gate", "interpreter_text", "style_text",
         "q_network")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with every part there is."""
    path = tmp_path_factory.mktemp("bundles") / "whole"
    bundles.save(untrained(), path, "a card")
    return path


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The least bundle there is."""
    path = tmp_path_factory.mktemp("bundles") / "small"
    bundles.save(untrained(*PLAIN, *SMALL), path, "a card")
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
        assert same_weights(made.trained(name), read.trained(name)), name
        assert not read.trained(name).training, name
    assert (read.text, read.config, read.speakers) == (made.text, made.config, made.speakers)
    assert read.silent.tolist() == list(SILENT)
    assert read.levels is not None and made.levels is not None
    for key, value in made.levels.to_dict().items():
        np.testing.assert_allclose(read.levels.to_dict()[key], value, rtol=1e-6)
    for name in ("mean_pose", "rest_pose", "deviation", "bounds", "quiet_low", "quiet_high"):
        np.testing.assert_array_equal(getattr(read.statistics, name), np.float32(getattr(made.statistics, name)))
    # The audio-only twin has no layer for words, the other has: they must not be exchanged.
    assert read.interpreter.encode_text is None
    assert read.trained("interpreter_text").encode_text is not None


def test_a_tensor_of_two_parts_is_stored_once_and_read_by_both(whole: Path, tmp_path: Path) -> None:
    made, key = untrained(), "lstm.weight_hh_l0"
    one, two = (made.trained(name).state_dict() for name in ("interpreter", "interpreter_text"))
    assert not torch.equal(one[key], two[key])
    two[key].copy_(one[key])
    folder = tmp_path / "shared"
    bundles.save(made, folder, "a card")
    held, shared = (folder / f"lexeme_interpreter{ending}.safetensors" for ending in ("", "_text"))
    assert key in load_file(held) and key not in load_file(shared)
    assert shared.stat().st_size < (whole / shared.name).stat().st_size
    for name in PARTS:
        assert same_weights(made.trained(name), bundles.load(folder).trained(name)), name
    # Bundles that were written before have every tensor in its own file.
    assert not [files for files in read_index(whole)["shared"].values() if key in files]
    whole_file = {**load_file(shared), key: load_file(held)[key]}
    older = Path(shutil.copytree(folder, tmp_path / "older"))
    rehashed(older, shared.name, whole_file)
    edit(older, shared={})
    assert same_weights(made.trained("interpreter_text"), bundles.load(older).trained("interpreter_text"))
    # What holds the tensor is checked, too.
    held.write_bytes(held.read_bytes()[:-1] + bytes([held.read_bytes()[-1] ^ 1]))
    with pytest.raises(InputError, match=rf"{held.name}: is not the file that the bundle was made with"):
        bundles.load(folder).trained("interpreter_text")
    for holder, wrong in (("gate", rf"{shared.stem}.*does not fit the settings \({key}"), ("../gate", "is missing")):
        edit(folder, shared={shared.stem: {key: holder}})
        with pytest.raises(InputError, match=wrong):
            bundles.load(folder).trained("interpreter_text")


@pytest.mark.parametrize("lacking", [("gate",), ("style_text",), ("q_network",),
                                     ("interpreter_text", "style_text", "text")])
def test_what_a_bundle_has_not_is_not_there_after_reading(lacking: tuple[str, ...], tmp_path: Path) -> None:
    less = untrained().with_parts(**dict.fromkeys(name for name in lacking if name != "text"))
    if "text" in lacking:
        less = dataclasses.replace(less, text=None)
    bundles.save(less, tmp_path / "less", "a card")
    read = bundles.load(tmp_path / "less")
    assert (read.text is None) == ("text" in lacking)
    for name in PARTS:
        assert (name not in read.parts) == (name in lacking), name


def test_a_bundle_replaces_an_older_one_whole(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    bundles.save(untrained(*PLAIN), copy, "another card")
    assert not (copy / "gate.safetensors").exists() and (copy / CARD).read_text() == "another card"
    assert "gate" not in bundles.load(copy).parts
    assert [path.name for path in tmp_path.iterdir()] == ["copy"], "nothing left of the old one or of the writing"


def test_weights_that_the_listing_leaves_out_are_refused(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    files = json.loads((copy / "bundle.json").read_text())["files"]
    edit(copy, files={name: digest for name, digest in files.items() if name != "gate.safetensors"})
    with pytest.raises(InputError, match=r"gate\.safetensors: is not in the list"):
        bundles.load(copy)
    (copy / "gate.safetensors").unlink()
    (copy / "notes.txt").write_text("other files are ignored")
    assert "gate" not in bundles.load(copy).parts


def test_a_q_network_of_another_lexicon_is_refused(whole: Path, tmp_path: Path) -> None:
    other = untrained(seed=7)
    bundles.save(other, tmp_path / "other", "a card")
    copy = copy_of(whole, tmp_path)
    shutil.copy(tmp_path / "other" / "q_network.safetensors", copy)
    foreign = json.loads((tmp_path / "other" / "bundle.json").read_text())["files"]["q_network.safetensors"]
    edit(copy, files={**json.loads((copy / "bundle.json").read_text())["files"], "q_network.safetensors": foreign})
    opened = bundles.load(copy)
    with pytest.raises(InputError, match=r"q_network\.safetensors.*another lexicon"):
        opened.trained("q_network")


@pytest.mark.parametrize("number", [0, 8, "2", True])
def test_an_unknown_format_is_refused_by_its_number(number: object, whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    edit(copy, format=number)
    with pytest.raises(InputError, match=f"format {str(number)[:20]}"):
        bundles.load(copy)


def test_broken_and_foreign_bundles_are_refused_by_name(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    for name in ("generator", "gate", "lexeme_interpreter_text"):
        file = copy / f"{name}.safetensors"
        before = file.read_bytes()
        file.write_bytes(before[:-1] + bytes([before[-1] ^ 1]))
        opened = bundles.load(copy)
        with pytest.raises(InputError, match=rf"{name}\.safetensors.*SHA-256"):
            _ = opened.trained({part.file: own for own, part in part_table().items()}[name])
        file.write_bytes(before)
    (copy / "generator.safetensors").unlink()
    with pytest.raises(InputError, match="missing"):
        bundles.load(copy)
    files = json.loads((copy / "bundle.json").read_text())["files"]
    edit(copy, files={name: digest for name, digest in files.items() if name != "generator.safetensors"})
    with pytest.raises(InputError, match="lacks generator"):
        bundles.load(copy)
    edit(copy, files=files)
    index = json.loads((copy / "bundle.json").read_text())
    edit(copy, skeleton={**index["skeleton"], "names": ["A"]})
    with pytest.raises(InputError, match="skeleton"):
        bundles.load(copy)
    edit(copy, skeleton=index["skeleton"], config={**index["config"], "fourth_model": {}})
    with pytest.raises(InputError, match=r"bundle\.json: has other settings than this version \(fourth_model is not"):
        bundles.load(copy)
    (copy / "bundle.json").write_text("{")
    with pytest.raises(InputError, match="broken"):
        bundles.load(copy)
    with pytest.raises(InputError, match="not a bundle"):
        bundles.load(tmp_path)


def test_a_bundle_never_replaces_something_else(tmp_path: Path) -> None:
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file").write_text("kept")
    with pytest.raises(InputError, match="not a bundle"):
        bundles.save(untrained(*PLAIN), tmp_path / "precious", "card")
    assert [p.name for p in tmp_path.iterdir()] == ["precious"]


# ---- what a bundle must survive

def rehashed(folder: Path, name: str, tensors: dict[str, torch.Tensor]) -> None:
    """Put other tensors into a file of weights, and their hash into the list."""
    save_file(tensors, folder / name)
    files = json.loads((folder / "bundle.json").read_text())["files"]
    edit(folder, files={**files, name: hashlib.sha256((folder / name).read_bytes()).hexdigest()})


def test_sizes_that_the_weights_do_not_have_are_refused_before_memory_is_taken(small: Path, tmp_path: Path) -> None:
    copy = copy_of(small, tmp_path)
    code = """
import json, pathlib, resource, sys
from data_module.errors import InputError
from data_module.types import Speech
from gesticulator.bundle.bundle import load
folder = pathlib.Path(sys.argv[1])
text = (folder / "bundle.json").read_text()
loaded = load(folder)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in ("lexicon.size", "lexicon.code_width", "generator.lstm_width", "generator.hidden", "interpreter.width"):
    index, (group, name) = json.loads(text), path.split(".")
    index["config"][group][name] = 65536
    (folder / "bundle.json").write_text(json.dumps(index))
    try:
        loaded = load(folder)
        [loaded.trained(name) for name in loaded.parts]
        print("opened")
    except InputError as error:
        print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    done = subprocess.run([sys.executable, "-c", code, str(copy)], capture_output=True, text=True, check=True)
    *said, grown = done.stdout.splitlines()
    assert len(said) == 5 and all("does not fit the settings" in line for line in said), said
    assert int(grown) < 100_000, "kilobytes"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_no_numbers_are_found_at_loading(value: float, small: Path, tmp_path: Path) -> None:
    copy = copy_of(small, tmp_path)
    tensors = load_file(copy / "generator.safetensors")
    tensors["to_motion.bias"][3] = value
    rehashed(copy, "generator.safetensors", tensors)
    with pytest.raises(InputError, match=r"generator\.safetensors: holds values that are no num.*\(to_motion\.bias\)"):
        _ = bundles.load(copy).generator


def test_other_tensors_are_told_by_name(small: Path, tmp_path: Path) -> None:
    for number, change in enumerate((lambda t: t.pop("to_motion.bias"), lambda t: t.update(more=torch.zeros(1)),
                                     lambda t: t.update({"to_motion.bias": torch.zeros(3)}))):
        copy = Path(shutil.copytree(small, tmp_path / str(number)))
        tensors = load_file(copy / "generator.safetensors")
        change(tensors)
        rehashed(copy, "generator.safetensors", tensors)
        with pytest.raises(InputError, match=r"does not fit the settings \((to_motion\.bias|more):"):
            _ = bundles.load(copy).generator


@pytest.mark.parametrize("data", [b"", b"x", b"\xff" * 64, (2**62).to_bytes(8, "little") + b"{}",
                                  (2).to_bytes(8, "little") + b"{}", (40).to_bytes(8, "little") + b"[" * 40])
@pytest.mark.parametrize("name", ["statistics", "lexicon", "generator"])
def test_a_broken_file_of_weights_with_the_right_hash_is_one_line(name: str, data: bytes, small: Path, tmp_path: Path
                                                                  ) -> None:
    copy = copy_of(small, tmp_path)
    (copy / f"{name}.safetensors").write_bytes(data)
    files = json.loads((copy / "bundle.json").read_text())["files"]
    edit(copy, files={**files, f"{name}.safetensors": hashlib.sha256(data).hexdigest()})
    with pytest.raises(InputError) as error:
        _ = bundles.load(copy).generator
    assert f"{name}.safetensors" in str(error.value) and "\n" not in str(error.value)


def test_only_what_is_asked_for_is_opened(whole: Path, tmp_path: Path) -> None:
    copy = copy_of(whole, tmp_path)
    for name in ("q_network", "gate", "lexeme_interpreter_text", "style_interpreter_text"):
        (copy / f"{name}.safetensors").write_bytes(b"not weights at all")
    system = Gesticulator.from_pretrained(copy)
    intact = Gesticulator.from_pretrained(whole)
    np.testing.assert_array_equal(system(SPEECH).motion.rotations, intact(SPEECH).motion.rotations)
    with pytest.raises(InputError, match=r"q_network\.safetensors"):
        system(SPEECH, interpreter="cql")


def test_who_judges_a_policy_is_not_shipped_with_it(tmp_path: Path) -> None:
    judge = models.reward(Sizes(untrained().config, 48, 9, 9, False, 2, 0, torch.ones(48)), untrained().config.reward)
    made = untrained().with_parts(reward=judge, reward_judge=judge)
    assert made.reward is judge
    bundles.save(made, tmp_path / "b", "a card")
    read = bundles.load(tmp_path / "b")
    assert read.reward is None and read.reward_judge is None and "q_network" in read.parts
    assert not [file for file in read_index(tmp_path / "b")["files"] if "reward" in file]
