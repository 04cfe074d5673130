"""The three systems that a bundle may be, and what is known of each."""

from __future__ import annotations

import pytest

from data_module.settings import with_settings
from gesticulator.bundle.bundle import required
from gesticulator.systems import SYSTEMS, system_of
from gesticulator.training.presets import PRESETS, preset
from gesticulator.training.stages import wanted


@pytest.mark.parametrize("name", PRESETS)
def test_the_system_of_each_preset(name: str) -> None:
    system = system_of(preset(name))
    racer, movement = name.startswith("racer"), name == "default"
    assert system is SYSTEMS.load("racer" if racer else "movement" if movement else "paper")
    assert system.BLOCKS is not racer and system.VARIES is movement


@pytest.mark.parametrize("name", PRESETS)
def test_a_system_trains_what_its_bundle_cannot_do_without(name: str) -> None:
    config = preset(name)
    stages = wanted(config)
    assert {stage.part for stage in stages} >= set(required(config))
    assert [stage.name for stage in stages] == [name for name in system_of(config).STAGES if name in
                                                {stage.name for stage in stages}]


def test_a_setting_that_changes_the_system_trains_lexicon_and_generator_again() -> None:
    config = with_settings(preset("paper-quick"), ["system=movement"])
    assert system_of(config).IN_CONTEXT and "style_text" not in {stage.name for stage in wanted(config)}
