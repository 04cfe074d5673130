"""What can be asked of a performance: `InferenceOptions`, checked when it is made.

Nothing heavy is imported, so that the command line checks its numbers against the same ranges before torch is loaded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, TypedDict

from data_module.errors import InputError

if TYPE_CHECKING:
    from os import PathLike

    from data_module.controls import Controls, Curve
    from interpreters.base import LexemeInterpreter

HandControl: TypeAlias = "float | str | PathLike[str] | Curve | None"


FPS = 60.0
"""Frames per second of a performance when not told: the models' 20 fps frames, interpolated."""


@dataclass(frozen=True)
class Range:
    """The numbers that a setting takes: low to high, both included; whole: no fractions."""

    low: float
    high: float
    advice: str
    whole: bool = False

    def parse(self, name: str, text: str) -> float:
        """The number that a text gives; `InputError` with the name where it gives none or one out of range."""
        try:
            # Python reads 0_4 as 4, which nobody means here.
            number = math.nan if "_" in text else int(text) if self.whole else float(text)
        except ValueError:
            raise InputError(f"{name} {text[:40]}", f"is no {'whole ' if self.whole else ''}number",
                             f"choose {self.advice}") from None
        return self.check(name, number)

    def check(self, name: str, number: float) -> float:
        """The number itself; `InputError` with the name where it is out of range or no number at all."""
        if isinstance(number, bool) or not hasattr(number, "__index__" if self.whole else "__float__"):
            raise InputError(f"{name} {number!r}", f"is no {'whole ' if self.whole else ''}number",
                             f"choose {self.advice}")
        if not self.low <= number <= self.high:  # also NaN
            shown = f"{number:g}" if not abs(number) > 1e300 or math.isinf(number) else "of that size"
            raise InputError(f"{name} {shown}", "is out of range", f"choose {self.advice}")
        return number


RANGES = {
    "seed": Range(0, 2**64 - 1, "a whole number from 0", whole=True),
    # At 1000 the lexemes are already as good as equally likely.
    "temperature": Range(0, 1000, "0 (always the likeliest lexeme) to 1000"),
    "activity": Range(0, 1, "0 (stillness) to 1 (never holds back)"),
    "fps": Range(1, 1000, "1 to 1000 frames per second"),
    # 64 dB bring the faintest speech that is listened for (-90 dBFS) to the usual level (-26 dBFS).
    "gain": Range(-70, 70, "-70 to 70 decibels"),
    # Far above any machine's cores; beyond the system's limit on threads torch ends the process.
    "threads": Range(1, 256, "1 to 256 threads", whole=True),
}
"""What each number may be. "threads" belongs to the command, the others to `InferenceOptions`."""


@dataclass(frozen=True)
class InferenceOptions:
    """What is asked of a performance; what is None is the bundle's own choice. `InputError` for a value out of range.

    A hand control is "low", "mid" or "high" (quantiles of the training data), a number in its unit, a `Curve` over
    time, or the path of a CSV file with the columns time and value (RG 7.2.1).
    """

    speaker: str | None = None
    """Whose habits of moving: a performer of the bundle (`Gesticulator.speakers`), not a voice."""
    interpreter: str | LexemeInterpreter | None = None
    """What chooses the lexemes: a name of `Gesticulator.interpreters` ("lstm", "cql", "statistical") or an object."""
    seed: int = 0
    """The same seed, bundle and speech give the same performance."""
    temperature: float | None = None
    """How freely lexemes are sampled, 0 to 1000: 0 takes the likeliest, 1 samples from the interpreter's scores."""
    activity: float | None = None
    """How readily to gesture at all, 0 (stillness) to 1 (the gate never closes)."""
    fps: float = FPS
    """Frames per second of the motion, 1 to 1000."""
    gain: float = 0.0
    """Decibels by which the recording is amplified first, -70 to 70; beyond full scale it is clipped."""
    hand_height: HandControl = None
    """Height of the right hand over the hips, metres."""
    hand_speed: HandControl = None
    """Mean speed of both hands, metres per second."""
    hand_radius: HandControl = None
    """Mean horizontal distance of both hands from the body's axis, metres."""
    controls: Controls | None = None
    """The three hand controls in one object, instead of them."""

    def __post_init__(self) -> None:
        for name in ("seed", "temperature", "activity", "fps", "gain"):
            value = getattr(self, name)
            if value is not None or name not in ("temperature", "activity"):
                RANGES[name].check(name, value)
        if self.controls is not None and any(part is not None for part in self.hands):
            raise InputError("controls", "are given beside hand_height, hand_speed or hand_radius", "give one or other")

    @property
    def hands(self) -> tuple[HandControl, ...]:
        """The hand controls in the order of `data_module.controls.FEATURES`."""
        return self.hand_height, self.hand_speed, self.hand_radius


class InferenceArguments(TypedDict, total=False):
    """The fields of `InferenceOptions` as keyword arguments, for type checkers."""

    speaker: str | None
    interpreter: str | LexemeInterpreter | None
    seed: int
    temperature: float | None
    activity: float | None
    fps: float
    gain: float
    hand_height: HandControl
    hand_speed: HandControl
    hand_radius: HandControl
    controls: Controls | None
