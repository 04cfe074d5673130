"""Training stages of other packages, found by entry points."""

from __future__ import annotations

from typing import Any

from data_module.errors import InputError, complain
from data_module.registry import PROJECT, Registry, RegistryEntry
from gesticulator.training.stages.base import Stage

OTHER_STAGES: Registry[RegistryEntry] = Registry("stages", "a gesticulator.training.stages.base.Stage", {},
                                                 RegistryEntry, fits=lambda found: isinstance(found, Stage))


def other_stages() -> dict[str, Stage[Any]]:
    """The stages of other packages by name. An error line is printed for each that cannot be loaded."""
    stages: dict[str, Stage[Any]] = {}
    for name in OTHER_STAGES:
        try:
            stage: Stage[Any] = OTHER_STAGES.load(name)
        except InputError as error:
            complain(f"{PROJECT}: {error}")
        else:
            stages[stage.name] = stage
    return stages
