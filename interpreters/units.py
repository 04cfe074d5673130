"""What the planner of gesture units decides for a block, and the dimensions of a unit's style (`interpreters.planner`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["APEXES", "CLASSES", "CODE", "HANDS", "PHASES", "SIZES", "UnitDecision"]

PHASES = ("rest", "preparation", "stroke", "hold", "retraction")
HANDS = ("none", "left", "right", "both")
"""The hands that are not at rest."""
SIZES = ("none", "small", "medium", "large")
"""Size of the stroke that the block prepares or makes; "none" in other phases."""
APEXES = ("none", "now", "next", "later")
"""Whether the apex of that stroke lies in this block, in the next one, or later."""
CLASSES = (len(PHASES), len(HANDS), len(SIZES), len(APEXES))
CODE = ("speed", "range", "height", "reach")
"""The dimensions of a style code."""


@dataclass(frozen=True)
class UnitDecision:
    """The decision for one block, as indices into `PHASES`, `HANDS`, `SIZES` and `APEXES`."""

    phase: int
    hand: int
    size: int
    apex: int

    @property
    def rests(self) -> bool:
        return PHASES[self.phase] == "rest"

    def begins_after(self, before: UnitDecision | None) -> bool:
        """Whether the hands set out here: to prepare a stroke, or to make one that was not prepared. before: the
        decision for the block before."""
        phase, last = PHASES[self.phase], "rest" if before is None else PHASES[before.phase]
        return phase != last and (phase == "preparation" or (phase == "stroke" and last != "preparation"))

    def follows(self, before: UnitDecision | None) -> bool:
        """Whether a stroke begins here right after the apex of another. before: the decision for the block before."""
        return before is not None and PHASES[self.phase] == PHASES[before.phase] == "stroke" \
            and APEXES[before.apex] == "now"

    @property
    def row(self) -> NDArray[np.float32]:
        """[U] the four decisions, each one-hot, side by side."""
        decided = (self.phase, self.hand, self.size, self.apex)
        return np.concatenate([np.eye(count, dtype=np.float32)[choice]
                               for choice, count in zip(decided, CLASSES, strict=True)])

    @property
    def holds(self) -> bool:
        return PHASES[self.phase] == "hold"
