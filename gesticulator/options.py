"""The options of a performance, `InferenceOptions`, and the range of every number in it.

Nothing heavy is imported, so that the command line checks its arguments before numpy is loaded.
"""

from __future__ import annotations

import math
import numbers
import os
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from data_module.errors import InputError, shown
from gesticulator.plan.plan import ENERGIES, PlanKnobs, shapes

if TYPE_CHECKING:
    from data_module.controls import Controls, Curve
    from gesticulator.plan.plan import Energy, GestureCue, GesturePlan
    from interpreters.base import LexemeInterpreter

__all__ = ["FPS", "RANGES", "HandControl", "InferenceOptions", "Range"]

HandControl: TypeAlias = "float | str | Curve | None"

MEANING_LEVELS = ("off", "few", "normal", "rich")
"""How many of the gestures that the words call for are shown."""
FACES = ("off", "lips", "full")
"""How much of a face moves: nothing, the lips, or also lids, brows, smile and eyes."""
FPS = 60.0
"""Default frames per second of a performance: the models' 20 fps frames, interpolated."""
HAND_UNITS = {"height": "m", "speed": "m/s", "radius": "m"}
HAND_LIMITS = {"height": (-1.5, 2.0), "speed": (0.0, 20.0), "radius": (0.0, 2.0)}
"""Smallest and greatest values of the controls of hands: no body does more."""


@dataclass(frozen=True)
class Range:
    """The range of a number, low to high, both included. whole: integers only; advice: the range in words."""

    low: float
    high: float
    advice: str
    whole: bool = False

    def parse(self, name: str, text: str) -> float:
        """Parse a number; `InputError` with the option's name if the text is not a number or out of range."""
        try:
            # Python reads 0_4 as 4, which is more likely a typo here.
            number = math.nan if "_" in text else int(text) if self.whole else float(text)
        except ValueError:
            number = math.nan
        return self.check(name, number, text)

    def check(self, name: str, number: Any, text: object = None) -> float:
        """Return the number; `InputError` with the option's name if it is not a number or out of range. text: as it
        was given, if not as a number."""
        kind: Any = numbers.Integral if self.whole else numbers.Real
        if isinstance(number, bool) or not isinstance(number, kind) or not self.low <= number <= self.high:  # also NaN
            raise InputError(f"{name} {shown(number if text is None else text)}",
                             f"is not a {'whole ' * self.whole}number in range", f"choose {self.advice}")
        return cast("float", number)


RANGES = {
    "seed": Range(0, 2**64 - 1, "a whole number from 0", whole=True),
    "variation": Range(0, 2**32 - 1, "a whole number from 0", whole=True),
    # At 1000 all lexemes are practically equally likely.
    "temperature": Range(0, 1000, "0 (always the likeliest lexeme) to 1000"),
    "activity": Range(0, 1, "0 (stillness) to 1 (unrestricted)"),
    "fps": Range(1, 1000, "1 to 1000 frames per second"),
    "intensity": Range(0, 2, "0 (the hands hang) to 2 (largest)"),
    "mouth": Range(0, 2, "0 (shut) to 2 (widest)"),
    "mood": Range(-1, 1, "-1 (sad) to 1 (a smile)"),
    # 64 dB bring the faintest speech that is detected (-90 dBFS) to the usual level (-26 dBFS).
    "gain": Range(-70, 70, "-70 to 70 decibels"),
    # Far above any machine's cores; more only wait for each other.
    "threads": Range(1, 256, "1 to 256 threads", whole=True),
}
"""Name -> allowed range. "threads" is an option of the command line, the others are fields of `InferenceOptions`."""


@dataclass(frozen=True)
class OptionFlag:
    """How a field of `InferenceOptions` is set on the command line; a field without one cannot be set there. Its help
    is the first sentence of the docstring below the field.

    metavar: placeholder of the value, or None for a switch. choices: the allowed words. many: the option can be
    repeated. name: the option, if it differs from the field. of_sound: it stands with those of the sound in the help.
    """

    metavar: str | None = None
    choices: tuple[str, ...] = ()
    many: bool = False
    name: str = ""
    of_sound: bool = False


def _option(default: Any, metavar: str | None = None, **more: Any) -> Any:
    return field(default=default, metadata={"flag": OptionFlag(metavar, **more)})


@dataclass(frozen=True)
class InferenceOptions:
    """All options of a performance. The command line is generated from these fields. None means the bundle's default.
    `InputError` for a value out of range.

    A hand control is "low", "mid" or "high" (quantiles of the training data), a number in its unit, or a `Curve`
    over time (RG 7.2.1).
    """

    speaker: str | None = _option(None, "NAME")
    """Performer whose gesture style to use (gesticulator bundle inspect lists them). It has nothing to do with the
    voice."""
    interpreter: str | LexemeInterpreter | None = _option(None, "NAME")
    """The model that chooses the lexemes. A name of the bundle's `interpreters` ("lstm", "cql", "statistical") or an
    object (`interpreters.base.LexemeInterpreter`)."""
    seed: int = _option(0, "N")
    """The same seed gives the same bytes, with the same bundle and speech."""
    variation: int = _option(0, "N")
    """Another rendering of the same beats and lexemes. 0 is the first."""
    temperature: float | None = _option(None, "T")
    """Randomness of the choice of lexemes, 0 to 1000: 0 takes the likeliest, 1 samples from the interpreter's
    scores."""
    activity: float | None = _option(None, "0..1")
    """Share of the speaking time with gestures, 0 (rests throughout) to 1 (unrestricted). Bundles that do not rest by
    phrases (silence.rest=decay) use it as the threshold of their gate."""
    fps: float = _option(FPS, "N")
    """Frames per second of the motion, 1 to 1000."""
    gain: float = _option(0.0, "DB", of_sound=True)
    """Amplify the recording first by -70 to 70 decibels. Samples beyond full scale are clipped."""
    transcribe: str | os.PathLike[str] | None = _option(None, "MODEL", of_sound=True)
    """Recognise the words by a Whisper model, offline: tiny.en, or a folder in the format of faster-whisper (extra
    transcribe). A speech with words keeps them (`data_module.text.transcription`). Not for streams."""
    hand_height: HandControl = _option(None, "VALUE")
    """Height of the right hand above the hips, metres."""
    hand_speed: HandControl = _option(None, "VALUE")
    """Mean speed of both hands, metres per second."""
    hand_radius: HandControl = _option(None, "VALUE")
    """Mean horizontal distance of both hands from the body's axis, metres."""
    controls: Controls | None = None
    """The three hand controls in one object, in place of the three fields."""
    intensity: float = _option(1.0, "0..2")
    """Size of the gestures, 0 (the hands hang) to 2; 1 is as generated (`gesticulator.directing.shaping`)."""
    mirror: bool = _option(False)
    """Exchange left and right."""
    energy: Energy = _option("neutral", "NAME", choices=tuple(ENERGIES))
    """On top of intensity and activity: calm multiplies both by .6, lively multiplies intensity by 1.5 (`ENERGIES`)."""
    hold_still: tuple[tuple[float, float], ...] = _option((), "FROM-TO", many=True)
    """Ranges of seconds in which the hands rest, such as 3.2-5.0."""
    cues: tuple[GestureCue, ...] = _option((), "WORD=GESTURE", many=True, name="cue")
    """A gesture at a word or a time: hello=wave, hello:2=wave (the second hello), 2.5=shrug, or with --face full
    2.5=smile (gesticulator gestures lists them)."""
    meaning: str = _option("normal", "LEVEL", choices=MEANING_LEVELS)
    """With words: how many of the gestures that they call for are shown."""
    plan: GesturePlan | None = _option(None, "FILE")
    """Render a gesture plan: unchanged blocks are replayed, edited ones are generated again. Seed, variation, speaker,
    interpreter and controls are taken from the plan."""
    retime: bool = _option(False)
    """With --plan: move the plan onto this new export of its sound first, and report what changed
    (`Gesticulator.retimed`)."""
    legs: bool = _option(False)
    """Add legs (54 joints): the weight shifts, the feet stay planted."""
    seated: bool = _option(False)
    """Seat the character, with still legs and hips (54 joints)."""
    face: str = _option("off", "FACE", choices=FACES)
    """Move the face, too: off, lips, or full, with blinks, brows, smile and gaze. The body is the same with each."""
    mouth: float = _option(1.0, "0..2")
    """With --face: how far the mouth opens, 0 (shut) to 2. 1 is as the network gives it."""
    mood: float = _option(0.0, "-1..1")
    """With --face full: from -1 (sad) to 1 (a smile)."""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value, choices = getattr(self, entry.name), getattr(entry.metadata.get("flag"), "choices", ())
            if choices and value not in (*choices, entry.default):
                raise InputError(f"{entry.name} {value}", "is unknown", f"choose among {', '.join(choices)}")
            # None is the bundle's default, where the field's default is None.
            if entry.name in RANGES and (value is not None or entry.default is not None):
                RANGES[entry.name].check(entry.name, value)
        if self.controls is not None and any(part is not None for part in self.hands):
            raise InputError("controls", "cannot be combined with hand_height, hand_speed or hand_radius",
                             "give one or the other")
        # An option without effect is a mistake of the user, and cheaper to report than to find.
        if self.face == "off" and (self.mouth != 1.0 or self.mood != 0.0):
            raise InputError("mouth" if self.mouth != 1.0 else "mood", "is for a face",
                             "add --face full, or leave it out")
        if self.transcribe is not None and self.plan is not None:
            raise InputError("transcribe", "hears words, and those of a plan are in it", "leave it out")
        if self.retime and self.plan is None:
            raise InputError("retime", "moves a plan, and none is given", "give the plan, too")
        for begin, stop in self.hold_still:
            if not 0 <= begin < stop < math.inf:
                raise InputError(f"hold_still {begin:g}-{stop:g}", "is not a range of seconds", "write it as 3.2-5.0")

    @property
    def knobs(self) -> PlanKnobs:
        """The knobs as a plan stores them; the bundle's default activity is stored as 1."""
        return PlanKnobs(float(self.intensity), self.mirror, self.energy,
                         1.0 if self.activity is None else float(self.activity),
                         tuple((float(begin), float(stop)) for begin, stop in self.hold_still))

    @property
    def _moves(self) -> bool:
        """Whether a cue is of the body, not of the face."""
        if not self.cues:
            return False
        from gesticulator.plan.gestures import EXPRESSIONS

        return any(cue.gesture not in EXPRESSIONS for cue in self.cues)

    @property
    def directed(self) -> bool:
        """Whether options influence the generation of blocks."""
        # Size and mirroring are left out: they are applied to poses after generation.
        return bool(self.hold_still or self._moves)

    @property
    def shaped(self) -> bool:
        """Whether options change the generated poses."""
        # Energy changes the size as well as how often somebody gestures.
        resized = self.intensity != 1.0 or ENERGIES[self.energy][0] != 1.0
        return bool(self._moves or resized or (self.plan is not None and shapes(self.plan)))

    @property
    def mirrored(self) -> bool:
        """Whether the whole motion is mirrored at once; with a plan that locks blocks, each block is by itself."""
        return self.mirror and not (self.plan is not None and any(block.locked for block in self.plan.blocks))

    @property
    def hands(self) -> tuple[HandControl, ...]:
        """The hand controls in the order of `data_module.controls.FEATURES`."""
        return self.hand_height, self.hand_speed, self.hand_radius


def interpreter_name(interpreter: str | LexemeInterpreter) -> str:
    """The name of an interpreter in a plan: the attribute `name` of an object if it is a `str`, or its class name."""
    if isinstance(interpreter, str):
        return interpreter
    name = getattr(interpreter, "name", None)
    return name if isinstance(name, str) and name else type(interpreter).__name__
