"""Upgrade bundles of formats 1 to 5 to format 6 without training: names change, and resting distances are added.

The weights stay the same bit by bit, and so does the generated motion. A flow head of format 5 is rejected: its numbers
had another meaning.
"""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from data_module.errors import InputError
from data_module.layers import freeze
from gesticulator.bundle import models
from gesticulator.bundle.bundle import rest_distances
from gesticulator.bundle.config import Config, from_dict, system_of, to_dict
from gesticulator.bundle.features import Statistics, representation_of
from gesticulator.bundle.files import CARD, INDEX, OLDER, lexicon_hash, read_json, replace_folder, write_index
from gesticulator.bundle.models import Sizes

SETTINGS = {("silence", "settle"): "rest_decay", ("interpreter", "text_reading"): "text_head",
            ("interpreter", "reading_dropout"): "text_head_dropout"}
"""Settings renamed in format 4 (later formats only added some): group and old name -> new name."""
TENSORS = {"lexeme_interpreter_text": ("reading.", "text_head.")}
"""File -> old and new prefix of the names of its tensors."""
FIGURES = {"cross_entropy": "nll"}
STAGES = {"cql": "q_network"}


def upgrade(source: Path, target: Path) -> None:
    """Convert the bundle of format 1 to 5 in `source` to format 6 in `target`, atomically. InputError for a bundle of
    another format or with wrong hashes."""
    index = read_json(source / INDEX)
    if index.get("format") not in OLDER or isinstance(index.get("format"), bool):
        raise InputError(source, f"has format {str(index.get('format'))[:20]}", "only formats 1 to 5 can be upgraded")
    try:
        if system_of(settings_of(index["config"])).drawing.samples:
            raise InputError(source, f"has the flow head of format {index['format']}, which is not supported any more",
                             "train it again, or keep the older program")
        files: dict[str, str] = index["files"]
        for name, expected in files.items():
            if Path(name).name != name or hashlib.sha256((source / name).read_bytes()).hexdigest() != expected:
                raise InputError(source / name, "is not the file that the bundle was made with (wrong SHA-256)",
                                 "copy the bundle again")
        replace_folder(target, lambda folder: _write(source, index, folder))
    except (KeyError, TypeError, AttributeError, ValueError, SafetensorError, RuntimeError) as error:
        raise InputError(source, f"does not fit together ({str(error).splitlines()[0][:100]})",
                         "train it again") from None


def settings_of(found: dict[str, Any]) -> Config:
    """The settings of an older bundle under their current names."""
    renamed = {group: dict(value) if isinstance(value, dict) else value for group, value in found.items()}
    for (group, old), new in SETTINGS.items():
        if old in renamed.get(group, {}):
            renamed[group][new] = renamed[group].pop(old)
    return from_dict(Config, renamed)


def _write(source: Path, index: dict[str, Any], folder: Path) -> None:
    config = settings_of(index["config"])
    for name in index["files"]:
        stem = name.removesuffix(".safetensors")
        if stem in TENSORS:
            old, new = TENSORS[stem]
            save_file({new + key.removeprefix(old) if key.startswith(old) else key: value
                       for key, value in load_file(source / name).items()}, folder / name)
        else:
            shutil.copyfile(source / name, folder / name)
    tensors = load_file(source / "statistics.safetensors")
    statistics = _poses(tensors, tuple(index["speakers"]))
    sizes = Sizes(config, representation_of(config).width, 1, 1, False, len(statistics.speakers), 0, statistics.present)
    tokens = models.tokens(sizes)
    tokens.load_state_dict({key: value.float() if value.is_floating_point() else value
                            for key, value in load_file(source / "lexicon.safetensors").items()})
    freeze(tokens)
    if "rest_distances" not in tensors:
        tensors = {**tensors, "rest_distances": torch.as_tensor(rest_distances(tokens, statistics))}
    save_file(tensors, folder / "statistics.safetensors")
    figures = {STAGES.get(stage, stage): {FIGURES.get(name, name): value for name, value in values.items()}
               for stage, values in index["figures"].items()}
    if (folder / CARD).is_file():
        card = (folder / CARD).read_text(encoding="utf-8")
        for old, new in (*FIGURES.items(), *STAGES.items()):
            card = card.replace(f"| {old} |", f"| {new} |")
        (folder / CARD).write_text(card, encoding="utf-8")
    write_index(folder, {
        "config": to_dict(config), "speakers": index["speakers"], "silent_lexemes": index["silent_lexemes"],
        "lexicon_hash": lexicon_hash(tokens.vectors), "text": index.get("text"),
        "audio_levels": _levels(source, index, config, tensors), "provenance": index["provenance"],
        "figures": figures})


def _poses(tensors: dict[str, torch.Tensor], speakers: tuple[str, ...]) -> Statistics:
    """The statistics needed for the resting pose."""
    from gesticulator.bundle.features import Normaliser

    arrays = {key: value.double().numpy() for key, value in tensors.items()}
    none = Normaliser(np.zeros(1), np.ones(1))
    return Statistics(speakers, arrays["mean_pose"], arrays["rest_pose"], arrays["deviation"], arrays["bounds"], none,
                      none)


def _levels(source: Path, index: dict[str, Any], config: Config, tensors: dict[str, torch.Tensor]) -> int:
    """Number of audio levels (1 or 2), from the reward model's weights or else the normalisers."""
    if "audio_levels" in index:
        return int(index["audio_levels"])
    if "reward.safetensors" in index["files"]:
        with safe_open(source / "reward.safetensors", framework="pt") as opened:
            width = opened.get_slice("read_audio.weight").get_shape()[1] // config.rhythm.frames
        return 1 if width == len(tensors["low_mean"]) else 2
    same = len(tensors["low_mean"]) == len(tensors["high_mean"])
    return 1 if same and bool((tensors["low_mean"] == tensors["high_mean"]).all()) else 2
