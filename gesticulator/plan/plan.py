"""The gesture plan: what was decided for a recording, as a file that people and pages read, edit and render again.

A plan holds the sound's name and hash, the seed, the words, what can be chosen (`lexicon`, `gestures`), what was
decided (`drawn`), and `blocks`, in which all that may be edited stands. What differs between `blocks` and `drawn` is
the edit: those stretches are drawn anew, all others are replayed (`gesticulator.directions`).

Plain data: nothing here imports numpy or a model. `docs/schema/plan.schema.json` is made of these classes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

from data_module.settings import PRIVATE, SettingChoice, SettingRange

if TYPE_CHECKING:
    from data_module.errors import InputError
    from data_module.types import Speech
    from gesticulator.plan.json_lines import Path as Place

__all__ = ["GESTURES", "Block", "BlockDraw", "GestureCue", "GesturePlan", "GestureUnit", "LexemeChoice", "PlanKnobs",
           "PlanSound", "PlanWord", "edited_blocks"]

FORMAT, VERSION = "gesticulator-plan", 2

ENERGIES: Mapping[str, tuple[float, float]] = {"calm": (0.6, 0.6), "neutral": (1.0, 1.0), "lively": (1.5, 1.0)}
"""Energy -> what intensity and activity are multiplied by: calm is smaller gestures in six tenths of the phrases."""

HANDS = ("left", "right", "both")
"""What handedness may prefer."""

FLAGS = ("boundary", "onset", "loud_pseudo", "even_pseudo", "edited")
"""Why a block ends where it ends: the names of `BeatFlag`, and a beat that a user moved or made."""
GESTURES = {
    "wave": "the right hand goes up beside the head, palm ahead, and waves (made by formula)",
    "point left": "the left arm points to her left (made by formula)",
    "point right": "the right arm points to her right (made by formula)",
    "point ahead": "the right arm points ahead, at the listener (made by formula)",
    "me": "the right hand comes to the chest (made by formula)",
    "stop": "the right hand goes up in front, palm ahead (made by formula)",
    "shrug": "both shoulders rise, the forearms open, palms up, the head tilts (made by formula)",
    "open palms": "both hands come forward and open, palms up (made by formula)",
    "nod": "the head nods twice (made by formula)",
    "shake head": "the head turns to both sides, twice (made by formula)",
}
"""The gestures that can be asked for by name, beside the names of the lexicon. The lexicon knows movements and no
meanings, so these are small movements of our own that are laid over what was drawn."""

SETTLES = 0.42
"""Seconds before a range of stillness in which the hands come to rest, the longest that a stop takes."""

PHASES = ("preparation", "pre-stroke hold", "stroke", "post-stroke hold", "retraction")
"""Phases of a gesture unit (Kendon; Kita et al.), in the order in which they come."""
UNIT_HANDS = ("left", "right", "both")
CURVES = ("intensity", "activity", "height", "speed", "radius")
"""What a curve may vary: two knobs, and the three hand controls in their units (metres, metres per second, metres)."""

Seconds = Annotated[float, SettingRange(0.0)]
Intensity = Annotated[float, SettingRange(0.0, 2.0)]
Seed = Annotated[int, SettingRange(0, 2**64 - 1)]
Variation = Annotated[int, SettingRange(0, 2**32 - 1)]
Lexeme = Annotated[int, SettingRange(0, 2**16)]
Index = Annotated[int, SettingRange(0, 10**7)]


@dataclass(frozen=True)
class PlanSound:
    """The recording that the plan is of."""

    name: str
    """Its file's name, to be found by; what counts is the hash."""
    duration: Annotated[float, SettingRange(0.0, above=True)]
    """Seconds."""
    sample_rate: Annotated[int, SettingRange(1, 10**6)]
    """Hertz, at which the hash was taken."""
    sha256: str
    """Of the samples as they were heard: mono float32, little-endian, at this rate, amplified as asked."""


@dataclass(frozen=True)
class PlanWord:
    """A word as spoken."""

    text: str
    """As it is written."""
    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""


@dataclass(frozen=True)
class LexemeName:
    """A lexeme that can be chosen."""

    lexeme: Lexeme
    """Its number in the lexicon."""
    name: str
    """What its movement looks like, unique in the lexicon."""
    silent: bool
    """Whether it counts as stillness."""


@dataclass(frozen=True)
class GestureName:
    """A gesture that a cue can ask for by name."""

    name: str
    """What a cue calls it."""
    about: str
    """What it does, and what it is made of."""


@dataclass(frozen=True)
class LexemeChoice:
    """A lexeme that was considered for a block."""

    lexeme: Lexeme
    """Its number."""
    name: str
    """Its name in `lexicon`."""
    score: float
    """What the interpreter thought of it; `score_is` says in what."""
    prior: float | None = None
    """Of the interpreter "advantage": how likely the behaviour policy makes it."""
    advantage: float | None = None
    """Of the interpreter "advantage": what the reward expects of it beyond the mean, in standard deviations."""


@dataclass(frozen=True)
class BlockDraw:
    """What a block's noise is drawn from: the same three numbers give the same block."""

    seed: Seed
    """The seed."""
    variation: Variation
    """Another number draws the same lexeme in another manner."""
    block: Index
    """The block that it was, when the recording was first cut; any number will do."""


@dataclass(frozen=True)
class Block:
    """A block: from one beat to the next, with one lexeme."""

    start: Seconds
    """Seconds; where the block before ends."""
    end: Seconds
    """Seconds: its beat. Move it together with the start of the next block; delete a beat by joining two blocks."""
    lexeme: Lexeme | None
    """What is gestured, a number of `lexicon`. Another one draws the block anew; null lets the interpreter choose."""
    silent: bool
    """True brings the hands to rest in the block."""
    draw: BlockDraw
    """What its noise is drawn from. Another variation draws the block anew."""
    flag: Annotated[str, SettingChoice(FLAGS)] = "edited"
    """Why there is a beat at its end."""
    name: str | None = None
    """The name of its lexeme, to read; `lexeme` counts."""
    locked: bool = False
    """True keeps the block as it was drawn, whatever knobs are turned."""
    intensity: Intensity = 1.0
    """How large its gesture is: at 0 the hands hang, 1 is as drawn, 2 largest; times that of `knobs`."""
    mirror: bool = False
    """True exchanges left and right in it."""
    gate: float | None = None
    """How likely the gate thought a gesture, where it was asked."""
    alternatives: tuple[LexemeChoice, ...] = ()
    """The best lexemes, best first, to choose among."""
    chosen: dict[str, float] | None = None
    """Of the interpreter "advantage": what the lexeme that was played is worth (prior, advantage)."""
    runner_up: dict[str, float] | None = None
    """Of the interpreter "advantage": the best other lexeme (id), and what it would have been worth more."""


@dataclass(frozen=True)
class DrawnBlocks:
    """What was decided when the recording was first drawn; not to be edited. N blocks."""

    edges: tuple[Seconds, ...]
    """[N + 1] seconds: the beats."""
    flags: Annotated[tuple[str, ...], SettingChoice(FLAGS)]
    """[N] why there is a beat at each block's end."""
    silent: tuple[bool, ...]
    """[N] whether the block is a silence of the voice."""
    lexemes: Annotated[tuple[int, ...], SettingRange(0, 2**16)]
    """[N] the lexeme of each."""
    knobs: PlanKnobs
    """The knobs that it was drawn with."""


@dataclass(frozen=True)
class PlanKnobs:
    """How the whole is performed."""

    intensity: Intensity = 1.0
    """How large gestures are: at 0 the hands hang, 1 is as drawn, 2 largest."""
    mirror: bool = False
    """True exchanges left and right of everything."""
    energy: Annotated[str, SettingChoice(tuple(ENERGIES))] = "neutral"
    """A named combination of intensity and activity, on top of them."""
    activity: Annotated[float, SettingRange(0.0, 1.0)] = 1.0
    """How much of the time of speech is gestured in."""
    handedness: Annotated[str, SettingChoice(HANDS)] | None = None
    """Which hand's lexemes are preferred; null prefers none."""
    hold_still: tuple[tuple[Seconds, Seconds], ...] = ()
    """Ranges of seconds, each from and to, in which the hands rest."""


    @property
    def size(self) -> float:
        """Intensity with what the energy makes of it, 0 to 2."""
        return min(self.intensity * ENERGIES[self.energy][0], 2.0)

    @property
    def share(self) -> float:
        """Activity with what the energy makes of it, 0 to 1."""
        return self.activity * ENERGIES[self.energy][1]

    def draws_as(self, other: PlanKnobs) -> bool:
        """Whether blocks are drawn alike: intensity and mirror are applied afterwards, and stillness is a block's."""
        return self.share == other.share and self.handedness == other.handedness

    def still_at(self, start: float, end: float) -> tuple[tuple[float, float], ...]:
        """The parts of the range from start to end in which the hands are to rest, or on their way there."""
        ways = ((max(begin - SETTLES, start), min(stop, end)) for begin, stop in self.hold_still)
        return tuple((begin, stop) for begin, stop in ways if begin < stop)


@dataclass(frozen=True)
class GestureCue:
    """A gesture asked for at a word or at a time."""

    gesture: str
    """A name of `gestures` (laid over the motion), or of `lexicon` (played in the block at that time)."""
    word: str | None = None
    """The word at which it is made; or give `time`."""
    occurrence: Annotated[int, SettingRange(1, 10**6)] = 1
    """Which of several such words, from 1."""
    time: Seconds | None = None
    """Seconds at which its stroke arrives; or give `word`."""
    intensity: Intensity = 1.0
    """How large it is."""
    mirror: bool = False
    """True makes it with the other hand."""


@dataclass(frozen=True)
class GesturePhase:
    """A phase of a gesture unit."""

    kind: Annotated[str, SettingChoice(PHASES)]
    """Which phase it is."""
    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""


@dataclass(frozen=True)
class GestureUnit:
    """From where the hands leave rest to where they are at rest again; it spans several blocks."""

    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""
    phases: tuple[GesturePhase, ...] = ()
    """Its phases, in order and without overlap; there may be gaps, and several strokes."""
    hand: Annotated[str, SettingChoice(UNIT_HANDS)] | None = None
    """Which hand makes it; null where that is open."""
    size: Annotated[float, SettingRange(0.0, 2.0)] = 1.0
    """How large it is, as the intensity of a block."""


@dataclass(frozen=True)
class PlanMeaning:
    """What a stretch of the speech means, as far as a gesture can show it."""

    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""
    kind: str
    """What kind of meaning it is, such as "negation", "pointing" or "size"."""
    about: str = ""
    """What is meant, in words."""
    certainty: Annotated[float, SettingRange(0.0, 1.0)] | None = None
    """How certain the finding is."""


@dataclass(frozen=True)
class PosePin:
    """A joint that is to be in one place, or turned in one way, at one time. Give a rotation, a position or both."""

    time: Seconds
    """Seconds."""
    joint: str
    """The joint's name in the skeleton."""
    rotation: tuple[float, float, float, float] | None = None
    """Its local rotation, a unit quaternion, w first."""
    position: tuple[float, float, float] | None = None
    """Its place in metres: Y up, facing +Z, the floor at 0."""
    hold: Seconds = 0.0
    """Seconds that it stays so."""


@dataclass(frozen=True)
class KnobCurve:
    """A knob that changes over time, on straight lines between its points, and constant before and after them."""

    knob: Annotated[str, SettingChoice(CURVES)]
    """Which knob."""
    times: tuple[Seconds, ...]
    """[M] seconds, rising."""
    values: tuple[float, ...]
    """[M] the knob's value at these times, in its unit."""


@dataclass(frozen=True)
class SoundAlignment:
    """How the plan maps onto another export of its sound, in which pauses or tempo were changed."""

    sha256: str
    """Of the samples of the other sound, taken as that of `sound`."""
    duration: Annotated[float, SettingRange(0.0, above=True)]
    """Seconds of the other sound."""
    times: tuple[Seconds, ...]
    """[M] seconds of this plan, rising."""
    there: tuple[Seconds, ...]
    """[M] the same moments in seconds of the other sound, rising; straight lines between them."""


@dataclass(frozen=True)
class GesturePlan:
    """What was decided for one recording, and what is to be changed."""

    format: Annotated[str, SettingChoice((FORMAT,))]
    """What kind of file this is."""
    version: Annotated[int, SettingChoice((VERSION,))]
    """Of the format."""
    made_by: dict[str, Any]
    """What made it: `gesticulator` (its version), `bundle` (preset, lexicon: a hash) and `settings`, which are
    replayed; not to be edited."""
    sound: PlanSound
    """The recording."""
    seed: Seed
    """What it was drawn from; with a plan, --seed does not matter."""
    variation: Variation
    """Which variation of it."""
    speaker: str
    """Whose habits of moving."""
    interpreter: str
    """What chose the lexemes."""
    drawn: DrawnBlocks
    """What was decided first."""
    blocks: tuple[Block, ...]
    """What is to be played; edit these."""
    knobs: PlanKnobs = PlanKnobs()
    """How the whole is performed; edit these."""
    cues: tuple[GestureCue, ...] = ()
    """Gestures asked for; edit these."""
    words: tuple[PlanWord, ...] = ()
    """What is said, where it is known."""
    lexicon: tuple[LexemeName, ...] = ()
    """The lexemes that can be chosen, to read."""
    gestures: tuple[GestureName, ...] = ()
    """The gestures that cues can ask for, to read."""
    score_is: str = "log-probability"
    """What the scores of alternatives are."""
    notes: tuple[str, ...] = ()
    """What the user should know."""
    units: tuple[GestureUnit, ...] = ()
    """Gesture units, where they are planned."""
    meanings: tuple[PlanMeaning, ...] = ()
    """What stretches of the speech mean, where that is known."""
    pins: tuple[PosePin, ...] = ()
    """Joints that are to be in a place at a time."""
    curves: tuple[KnobCurve, ...] = ()
    """Knobs that change over time; one curve for a knob at most."""
    alignment: SoundAlignment | None = None
    """How the plan maps onto another export of its sound."""
    source: Any = field(default=None, metadata=PRIVATE, compare=False, repr=False)
    """The `LinedJson` that it was read from, for messages; None for a plan that was not read."""

    @property
    def duration(self) -> float:
        """Seconds that the blocks tile."""
        return self.drawn.edges[-1]

    def error(self, place: Place, wrong: str, advice: str) -> InputError:
        """An error about a part of the plan, with its line where it was read from a file."""
        from gesticulator.plan.json_lines import LinedJson

        error: InputError = (self.source or LinedJson("plan", None, {})).error(place, wrong, advice)
        return error

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        from gesticulator.plan.schema import to_plain

        plain: dict[str, Any] = to_plain(self)
        return plain

    def to_json(self) -> str:
        """As it is written: a line for a block, a word, a lexeme; the same plan gives the same text."""
        from gesticulator.plan.json_lines import in_lines

        return in_lines(self.to_dict()) + "\n"


def sound_hash(speech: Speech) -> str:
    """SHA-256 of the samples, little-endian float32."""
    return hashlib.sha256(speech.samples.astype("<f4").tobytes()).hexdigest()


def edited_blocks(plan: GesturePlan) -> tuple[bool, ...]:
    """For each block whether it must be drawn anew; the others are replayed.

    A block is as it was drawn when its beats, lexeme, silence and draw are, and no knob that changes drawing was turned
    since; a lock keeps knobs away.
    """
    drawn, knobs = plan.drawn, plan.knobs
    places = {pair: at for at, pair in enumerate(zip(drawn.edges, drawn.edges[1:], strict=False))}
    alike, as_still = knobs.draws_as(drawn.knobs), knobs.hold_still == drawn.knobs.hold_still
    out = []
    for block in plan.blocks:
        # An edit runs through this for every block of the recording: nothing is called that need not be.
        place, draw = (block.start, block.end), block.draw
        same = False
        if place in places:
            at = places[place]
            same = block.lexeme == drawn.lexemes[at] and block.silent == drawn.silent[at] \
                and (draw.seed, draw.variation, draw.block) == (plan.seed, plan.variation, at)
        if same and not block.locked:
            same = alike and (as_still or knobs.still_at(*place) == drawn.knobs.still_at(*place))
        out.append(not same)
    return tuple(out)


def shapes(plan: GesturePlan) -> bool:
    """Whether drawn poses are changed by what the plan says of its blocks, or may be."""
    knobs = plan.knobs
    if knobs.size != 1.0 or knobs.handedness is not None:
        return True
    return any(block.intensity != 1.0 or block.mirror or (block.locked and knobs != plan.drawn.knobs)
               for block in plan.blocks)
