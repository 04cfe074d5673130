"""Reward models, which a bundle does not hold: they are found in the work folder of its training.

A bundle plays; what taught its policies and what judges them plays nothing. The work folder names a trained stage by
the hash of all that shapes it, which the bundle's own settings and the fingerprint of its data give again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import torch
from safetensors.torch import load_file

from data_module.layers import freeze
from data_module.store import Store
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import RewardConfig
from gesticulator.bundle.parts import JUDGES
from gesticulator.training.stages import STAGES, Run
from gesticulator.training.stages.base import WEIGHTS, finished
from interpreters.reward import RewardEnsemble


@dataclass(frozen=True)
class _DataOf:
    """All that the name of a stage needs of a store."""

    fingerprint: str


def folder_of(bundle: Bundle, work: Path, name: str) -> Path:
    """Where a work folder holds a reward model of the bundle's own training, if it does."""
    run = Run(bundle.config, cast(Store, _DataOf(str(bundle.provenance.get("fingerprint", "")))), work)
    return run.folder(STAGES[name])


def with_judges(bundle: Bundle, work: Path | None) -> Bundle:
    """The bundle with the reward models that the work folder holds of its training; those that it has already stay."""
    if work is None:
        return bundle
    found = {}
    for name in JUDGES:
        folder = folder_of(bundle, work, name)
        if name not in bundle.parts and finished(folder):
            found[name] = _opened(bundle, folder, name)
    return bundle.with_parts(**found) if found else bundle


def _opened(bundle: Bundle, folder: Path, name: str) -> RewardEnsemble:
    weights = load_file(folder / WEIGHTS)
    frames, motion = bundle.frames, len(bundle.statistics.deviation)
    audio = weights["members.0.read_audio.weight"].shape[1] // frames
    config: RewardConfig = bundle.config.reward if name == "reward" else bundle.config.judge
    with torch.random.fork_rng():
        model = RewardEnsemble(config, frames, motion, audio)
    model.load_state_dict(weights)
    freeze(model)
    return model
