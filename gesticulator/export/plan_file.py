"""`.json` and `.bml`: the plan of a scene, in our format and in Behavior Markup Language."""

from __future__ import annotations

from pathlib import Path

from data_module.files import write_text
from gesticulator.export.writers import Scene


def write_plan(path: Path, scene: Scene) -> Path:
    """Write the plan as JSON, atomically. Returns `path`."""
    write_text(path, scene.plan.to_json())
    return path


def write_bml(path: Path, scene: Scene) -> Path:
    """Write the plan as BML, atomically. Returns `path`."""
    from gesticulator.plan.bml import bml_of

    write_text(path, bml_of(scene.plan))
    return path
