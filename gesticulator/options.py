"""What can be asked of a performance: `InferenceOptions`, and the range of every number in it.

Nothing heavy is imported, so that the command line checks its numbers before numpy and torch are loaded.
"""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

from data_module.errors import InputError
from gesticulator.plan.plan import ENERGIES, HANDS, PlanKnobs, shapes

if TYPE_CHECKING:
    from data_module.controls import Controls, Curve
    from gesticulator.plan.plan import GestureCue, GesturePlan
    from interpreters.base import LexemeInterpreter

__all__ = ["FPS", "RANGES", "HandControl", "InferenceOptions", "Range"]

HandControl: TypeAlias = "float | str | os.PathLike[str] | Curve | None"

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
    "variation": Range(0, 2**32 - 1, "a whole number from 0", whole=True),
    # At 1000 the lexemes are already as good as equally likely.
    "temperature": Range(0, 1000, "0 (always the likeliest lexeme) to 1000"),
    "beta": Range(0, 20, "0 (the behaviour policy itself) to 20"),
    "activity": Range(0, 1, "0 (stillness) to 1 (never holds back)"),
    "fps": Range(1, 1000, "1 to 1000 frames per second"),
    # 64 dB bring the faintest speech that is listened for (-90 dBFS) to the usual level (-26 dBFS).
    "intensity": Range(0, 2, "0 (the hands hang) to 2 (largest)"),
    "gain": Range(-70, 70, "-70 to 70 decibels"),
    # Far above any machine's cores; beyond the system's limit on threads torch ends the process.
    "threads": Range(1, 256, "1 to 256 threads", whole=True),
}
"""What each number may be. "threads" belongs to the command, the others to `InferenceOptions`."""


@dataclass(frozen=True)
class OptionFlag:
    """How a field of `InferenceOptions` is set on the command line; without one it cannot be.

    help: one line. metavar: what stands for the value, or None for a field that is true or false. choices: the words
    that it may be. many: the option may be given several times. name: the option, where it is not the field's name.
    group: the heading that it stands under.
    """

    help: str
    metavar: str | None = None
    choices: tuple[str, ...] = ()
    many: bool = False
    name: str = ""
    group: str = "motion"


_AUDIO = "audio and transcript"


def _option(default: Any, text: str, metavar: str | None = None, **more: Any) -> Any:
    return field(default=default, metadata={"flag": OptionFlag(text, metavar, **more)})


@dataclass(frozen=True)
class InferenceOptions:
    """Everything that can be asked of a performance, the one place where options are written: the command line is
    made from these fields. None leaves a choice to the bundle. `InputError` for a value out of range.

    A hand control is "low", "mid" or "high" (quantiles of the training data), a number in its unit, a `Curve` over
    time, or the path of a CSV file with the columns time and value (RG 7.2.1).
    """

    speaker: str | None = _option(None, "performer whose way of moving to use (see --list speakers)", "NAME")
    """The performer whose way of moving to use (`Gesticulator.speakers`); it is not a voice."""
    interpreter: str | LexemeInterpreter | None = _option(None, "the model that chooses the lexemes", "NAME")
    """What chooses the lexemes: a name of `Gesticulator.interpreters` ("lstm", "cql", "advantage", "statistical") or an
    object (`interpreters.base.LexemeInterpreter`)."""
    seed: int = _option(0, "the same seed gives the same bytes (default 0)", "N")
    """The same seed, bundle and speech give the same performance."""
    variation: int = _option(0, "another rendering of the same beats and lexemes (default 0)", "N")
    """Another rendering of the same beats and lexemes; 0 is the first."""
    temperature: float | None = _option(None, "randomness of the choice of lexemes; 0 takes the most likely", "T")
    """How freely lexemes are sampled, 0 to 1000: 0 takes the likeliest, 1 samples from the interpreter's scores."""
    beta: float | None = _option(None, "with --interpreter advantage: how strongly the learned reward biases the "
                                 "choice; 0 is the same as lstm", "B")
    """With the interpreter "advantage": how strongly the learned reward biases the choice, 0 to 20. 0 gives exactly
    the lexemes of "lstm"; a lexeme one standard deviation above the mean is e^beta times likelier."""
    activity: float | None = _option(None, "share of the speaking time with gestures; 0 rests throughout, 1 is "
                                     "unrestricted", "0..1")
    """Share of the time of speech in which to gesture, 0 (stillness) to 1 (all of it). Bundles that do not rest by
    phrases (silence.rest=decay) take it as the threshold of their gate."""
    fps: float = _option(FPS, f"frames per second of the motion (default {FPS:g})", "N")
    """Frames per second of the motion, 1 to 1000."""
    gain: float = _option(0.0, "amplify the recording first, in decibels (default 0)", "DB", group=_AUDIO)
    """Decibels by which the recording is amplified first, -70 to 70; beyond full scale it is clipped."""
    hand_height: HandControl = _option(None, "height of the right hand above the hips, metres", "VALUE")
    """Height of the right hand above the hips, metres."""
    hand_speed: HandControl = _option(None, "mean speed of the hands, metres per second", "VALUE")
    """Mean speed of both hands, metres per second."""
    hand_radius: HandControl = _option(None, "mean distance of the hands from the body's axis, metres", "VALUE")
    """Mean horizontal distance of both hands from the body's axis, metres."""
    controls: Controls | None = None
    """The three hand controls in one object, instead of them."""
    intensity: float = _option(1.0, "size of the gestures; at 0 the hands hang (default 1)", "0..2")
    """Size of the gestures, 0 (the hands hang) to 2; 1 is as generated (`gesticulator.directing.shaping`)."""
    mirror: bool = _option(False, "exchange left and right")
    """Exchange left and right."""
    energy: str = _option("neutral", "on top of intensity and activity: calm multiplies both by .6, lively multiplies "
                          "intensity by 1.5", "NAME", choices=tuple(ENERGIES))
    """"calm", "neutral" or "lively": a named combination of intensity and activity, on top of them."""
    handedness: str | None = _option(None, "preferred hand; with both, each hand joins in the strokes of the other",
                                     "HAND", choices=HANDS)
    """Preferred hand: "left", "right", or "both", where each joins in the strokes of the other."""
    hold_still: tuple[tuple[float, float], ...] = _option(
        (), "rest the hands during these seconds, such as 3.2-5.0; can be repeated", "FROM-TO", many=True)
    """Ranges of seconds, each from and to, in which the hands rest."""
    cues: tuple[GestureCue, ...] = _option(
        (), "a gesture at a word or a time: hello=wave, hello:2=wave (the second hello), 2.5=shrug; can be "
        "repeated (gesticulator plan names lists the gestures)", "WORD=GESTURE", many=True, name="cue")
    """Gestures asked for at words or times."""
    plan: GesturePlan | None = _option(None, "render a gesture plan (.json, .bml): unchanged blocks are replayed, "
                                       "edited ones are generated again; --seed has no effect", "FILE")
    """Render this plan: unchanged blocks are replayed, edited ones are generated again. Seed, variation, speaker,
    interpreter and controls are the plan's."""
    legs: bool = _option(False, "add legs (54 joints): the weight shifts, the feet stay planted")
    """Add legs (54 joints): the weight shifts, the feet stay planted (`gesticulator.body.stance`)."""
    seated: bool = _option(False, "seat the character, with still legs and hips (54 joints)")
    """Sit: with legs, they and the hips stay still."""

    def __post_init__(self) -> None:
        for name in ("seed", "variation", "temperature", "beta", "activity", "intensity", "fps", "gain"):
            value = getattr(self, name)
            if value is not None or name not in ("temperature", "beta", "activity"):
                RANGES[name].check(name, value)
        if self.controls is not None and any(part is not None for part in self.hands):
            raise InputError("controls", "are given beside hand_height, hand_speed or hand_radius", "give one or other")
        if self.energy not in ENERGIES:
            raise InputError(f"energy {self.energy}", "is unknown", f"choose among {', '.join(ENERGIES)}")
        if self.handedness not in (None, *HANDS):
            raise InputError(f"handedness {self.handedness}", "is unknown", f"choose among {', '.join(HANDS)}")
        for begin, stop in self.hold_still:
            if not 0 <= begin < stop < math.inf:
                raise InputError(f"hold_still {begin:g}-{stop:g}", "is no range of seconds", "write it as 3.2-5.0")

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> InferenceOptions:
        """From keyword arguments; TypeError with the nearest name for one that is no option."""
        known = [one.name for one in fields(cls)]
        for name in options:
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                raise TypeError(f"{name} is not an option" + (f"; did you mean {near[0]}?" if near else
                                                              f"; choose among {', '.join(known)}"))
        return cls(**options)

    @property
    def knobs(self) -> PlanKnobs:
        """The knobs of a plan; an activity that is left to the bundle counts as 1."""
        return PlanKnobs(float(self.intensity), self.mirror, self.energy,
                         1.0 if self.activity is None else float(self.activity), self.handedness,
                         tuple((float(begin), float(stop)) for begin, stop in self.hold_still))

    @property
    def energy_share(self) -> float:
        """What the energy multiplies activity by."""
        return ENERGIES[self.energy][1]

    @property
    def directed(self) -> bool:
        """Whether blocks are drawn otherwise than the models would."""
        return bool(self.hold_still or self.cues or self.handedness)

    @property
    def shaped(self) -> bool:
        """Whether drawn poses are changed."""
        sized = self.intensity != 1.0 or ENERGIES[self.energy][0] != 1.0
        return bool(self.cues or self.handedness or sized or (self.plan is not None and shapes(self.plan)))

    @property
    def mirrored(self) -> bool:
        """Whether the whole motion is mirrored; where a plan locks blocks, they are left as they are."""
        return self.mirror and not (self.plan is not None and any(block.locked for block in self.plan.blocks))

    @property
    def hands(self) -> tuple[HandControl, ...]:
        """The hand controls in the order of `data_module.controls.FEATURES`."""
        return self.hand_height, self.hand_speed, self.hand_radius


def interpreter_name(interpreter: str | LexemeInterpreter) -> str:
    """What a plan calls an interpreter: an object's attribute `name` where it is a text, or the name of its class."""
    if isinstance(interpreter, str):
        return interpreter
    name = getattr(interpreter, "name", None)
    return name if isinstance(name, str) and name else type(interpreter).__name__


class InferenceArguments(TypedDict, total=False):
    """The fields of `InferenceOptions` as keyword arguments, for type checkers."""

    speaker: str | None
    interpreter: str | LexemeInterpreter | None
    seed: int
    variation: int
    temperature: float | None
    beta: float | None
    activity: float | None
    fps: float
    gain: float
    hand_height: HandControl
    hand_speed: HandControl
    hand_radius: HandControl
    controls: Controls | None
    intensity: float
    mirror: bool
    energy: str
    handedness: str | None
    hold_still: tuple[tuple[float, float], ...]
    cues: tuple[GestureCue, ...]
    plan: GesturePlan | None
    legs: bool
    seated: bool
