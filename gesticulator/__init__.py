"""Speech in, gesture out.

>>> from gesticulator import Gesticulator
>>> Gesticulator.from_pretrained()("speech.wav").save("gesture.bvh")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gesticulator.cli import __version__

if TYPE_CHECKING:
    from data_module.controls import Controls, Curve
    from data_module.errors import InputError
    from data_module.speech.audio import load_speech
    from data_module.types import Motion, Speech, Word
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.options import InferenceOptions
    from gesticulator.performance import Performance

__all__ = ["Controls", "Curve", "Gesticulator", "InferenceOptions", "InputError", "Motion", "Performance", "Speech",
           "Word", "__version__", "load_speech"]

_HOMES = {"Controls": "data_module.controls", "Curve": "data_module.controls", "InputError": "data_module.errors",
          "Motion": "data_module.types", "Speech": "data_module.types", "Word": "data_module.types",
          "InferenceOptions": "gesticulator.options", "Performance": "gesticulator.performance",
          "Gesticulator": "gesticulator.gesticulator", "load_speech": "data_module.speech.audio"}
"""Name -> the module that has it, imported when the name is first used."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
