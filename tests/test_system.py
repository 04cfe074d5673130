"""The systems that a bundle may be, and what is known of each."""

from __future__ import annotations

import pytest

from data_module.settings import with_settings
from gesticulator.bundle.bundle import required
from gesticulator.bundle.config import system_of
from gesticulator.training.presets import PRESETS, preset
from gesticulator.training.stages import STAGES, wanted


@pytest.mark.parametrize("name", PRESETS)
def test_what_each_preset_is(name: str) -> None:
    system = system_of(preset(name))
    racer, flow = name.startswith("racer"), name == "default"
    assert system.drawing.name == ("decoded" if racer else "flow" if flow else "regression")
    assert (system.blocks, system.varies) == (not racer, flow)
    assert system.streams == system.lives == (name in ("default", "paper-quick", "regression"))


@pytest.mark.parametrize("name", PRESETS)
def test_a_system_trains_what_its_bundle_cannot_do_without(name: str) -> None:
    config = preset(name)
    stages = wanted(config)
    assert {stage.part for stage in stages} >= set(required(config))
    assert system_of(config).naming.stage in {stage.name for stage in stages}
    assert all(system_of(config).uses(stage.name) for stage in stages)


def test_idle_stages_are_stages() -> None:
    for name in PRESETS:
        assert system_of(preset(name)).drawing.idle <= set(STAGES)


def test_a_rest_that_lives_can_be_turned_off() -> None:
    config = with_settings(preset("default"), ["silence.rest=decay"])
    system = system_of(config)
    assert system.varies and not system.lives and not system.streams
