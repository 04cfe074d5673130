"""Styles heard in the voice are guided: more of them is seen, and nothing else changes."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from performances import example

from data_module.motion.phases import hand_places
from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import with_settings
from gesticulator.systems import movement
from gesticulator.training.stages.heads import style_of

RATE = 20.0


@pytest.fixture(scope="module")
def speech() -> Speech:
    return example(14.0)


def rendered(bundle: Bundle, speech: Speech, code: tuple[float, ...], seed: int, *settings: str) -> np.ndarray:
    """[T, 2, 3] the hands, as the code and the settings have them."""
    style = copy.deepcopy(bundle.trained("style"))
    with torch.no_grad():  # it hears the code in every voice
        style.to_code.weight.zero_()
        style.to_code.bias.copy_(torch.tensor(code))
        style.gain.fill_(1.0)
    told = replace(bundle.with_parts(style=style), config=with_settings(bundle.config, list(settings)))
    return hand_places(Gesticulator(told)(speech, seed=seed).motion, RATE)


@pytest.mark.parametrize("dimension", [0, 3])
def test_contrast_takes_what_is_heard_further(
        system: Gesticulator, speech: Speech, dimension: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a code of speed, or of reach, that is high in one rendering and low in another; in the mean of six draws, as
    one of 14 s may differ by as much for another reason."""
    monkeypatch.setattr(movement, "WAXING", 0.0)
    apart = []
    for contrast in (0.0, 2.0):
        measured = [[style_of(rendered(system.bundle, speech, tuple(sign * 1.5 * np.eye(4)[dimension]), seed,
                                       f"selection.contrast={contrast}"))[dimension] for seed in range(2, 8)]
                    for sign in (1.0, -1.0)]
        apart.append(np.mean(measured[0]) - np.mean(measured[1]))
    assert apart[1] > 1.3 * apart[0] > 0.0
