"""Speech in, gesture out. `Gesticulator.from_pretrained()` loads the shipped bundle; see `gesticulator.pipeline`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from gesticulator.performance import Performance
    from gesticulator.pipeline import Gesticulator

__all__ = ["Gesticulator", "Performance", "__version__"]


def __getattr__(name: str) -> Any:
    # torch takes seconds to import: only when it is asked for.
    if name == "Gesticulator":
        from gesticulator.pipeline import Gesticulator

        return Gesticulator
    if name == "Performance":
        from gesticulator.performance import Performance

        return Performance
    raise AttributeError(name)
