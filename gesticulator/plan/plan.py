"""The gesture plan: the decisions for one recording, in a file that people and programs read, edit and render again.

A plan holds the sound's name and hash, the seed, the words, the possible choices (`lexicon`, `gestures`), the decisions
of the first generation (`drawn`), and the blocks to play (`blocks`), which can be edited. Blocks that differ from
`drawn` are generated again, all others are replayed (`gesticulator.editing.render`).

The types of the fields carry their ranges, by which `gesticulator.plan.plan_file` reads and checks a file;
`docs/schema/plan.schema.json` is generated from these classes.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias, cast

from msgspec import Meta

from data_module.errors import InputError, shown

if TYPE_CHECKING:
    from data_module.types import Speech

__all__ = ["Block", "BlockDraw", "GestureCue", "GesturePlan", "GestureUnit", "LexemeChoice", "PlanKnobs",
           "PlanSound", "PlanWord", "edited_blocks"]

FORMAT: Final = "gesticulator-plan"
VERSION: Final = 2

Place: TypeAlias = tuple[str | int, ...]
"""The path to a value of a plan: names of members and indices in lists."""

# Literals, so that msgspec checks the words and the schema lists them.
Energy = Literal["calm", "neutral", "lively"]
ENERGIES: Mapping[str, tuple[float, float]] = {"calm": (0.6, 0.6), "neutral": (1.0, 1.0), "lively": (1.5, 1.0)}
"""Energy -> factors on intensity and activity. Calm: smaller gestures, in six tenths of the phrases."""

Hand = Literal["left", "right", "both"]
"""Hands of a gesture unit."""

Flag = Literal["boundary", "onset", "loud_pseudo", "even_pseudo", "edited"]
"""Kinds of beats at which a block ends: the names of `BeatFlag`, and a beat that a user moved or added."""

SETTLES = 0.42
"""Seconds before a range of stillness in which the hands come to rest: the longest duration of a stop."""

PhaseKind = Literal["preparation", "pre-stroke hold", "stroke", "post-stroke hold", "retraction"]
"""Phases of a gesture unit (Kendon; Kita et al.), in their order."""
CurveKnob = Literal["intensity", "height", "speed", "radius"]
"""Knobs that a curve can vary: intensity, and the three hand controls (metres, metres per second, metres)."""

Seconds = Annotated[float, Meta(ge=0.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Intensity = Annotated[float, Meta(ge=0.0, le=2.0)]
# Less than 2^64, which is above what msgspec can state as a bound (see `gesticulator.plan.checks`).
Seed = Annotated[int, Meta(ge=0)]
Variation = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Lexeme = Annotated[int, Meta(ge=0, le=2**16)]
Index = Annotated[int, Meta(ge=0, le=10**7)]


@dataclass(frozen=True)
class PlanSound:
    """The recording of the plan."""

    name: str
    """The name of its file, for information; the sound is identified by its hash."""
    duration: Annotated[float, Meta(gt=0.0)]
    """Seconds."""
    sample_rate: Annotated[int, Meta(ge=1, le=10**6)]
    """Hertz, of the samples that were hashed."""
    sha256: str
    """SHA-256 of the samples: mono float32, little-endian, at this rate, after amplification."""


@dataclass(frozen=True)
class PlanWord:
    """A spoken word."""

    text: str
    """The word as written."""
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
    """A description of its movement, unique in the lexicon."""
    silent: bool
    """True if it counts as stillness."""


@dataclass(frozen=True)
class GestureName:
    """A gesture that a cue can name."""

    name: str
    """Its name in cues."""
    about: str
    """A description of its movement."""


@dataclass(frozen=True)
class LexemeChoice:
    """A lexeme that was considered for a block."""

    lexeme: Lexeme
    """Its number."""
    name: str
    """Its name in `lexicon`."""
    score: float
    """Its score by the interpreter; `score_is` names the kind."""


@dataclass(frozen=True)
class BlockDraw:
    """The keys of a block's random numbers: the same three numbers give the same block."""

    seed: Seed
    """The seed."""
    variation: Variation
    """Another number gives another motion for the same lexeme."""
    block: Index
    """The number of the block when the recording was first cut; any number is allowed."""


@dataclass(frozen=True)
class Block:
    """A block: from one beat to the next, with one lexeme."""

    start: Seconds
    """Seconds; the end of the block before."""
    end: Seconds
    """Seconds; its beat. Move it together with the start of the next block; delete a beat by joining two blocks."""
    lexeme: Lexeme | None
    """The number of its lexeme in `lexicon`. With another number the block is generated again; null lets the
    interpreter choose."""
    silent: bool
    """True brings the hands to rest in the block."""
    draw: BlockDraw
    """The keys of its random numbers. With another variation the block is generated again."""
    flag: Flag = "edited"
    """The kind of beat at its end."""
    name: str | None = None
    """The name of its lexeme, for information; `lexeme` determines the motion."""
    locked: bool = False
    """True protects the block from changes of the knobs."""
    intensity: Intensity = 1.0
    """Size of its gesture: at 0 the hands hang, 1 is as generated, 2 is largest; multiplied by that of `knobs`."""
    mirror: bool = False
    """True exchanges left and right in the block."""
    gate: float | None = None
    """The gate's probability of a gesture; null without a gate."""
    alternatives: tuple[LexemeChoice, ...] = ()
    """The best lexemes, best first, to choose from."""
    score: float | None = None
    """The score of its lexeme, as those of `alternatives`; null without scores."""
    rank: Annotated[int, Meta(ge=1, le=2**16)] | None = None
    """How many lexemes have a score as high as its lexeme, with itself; null without scores."""


@dataclass(frozen=True)
class DrawnBlocks:
    """The decisions of the first generation, for N blocks; do not edit."""

    edges: tuple[Seconds, ...]
    """[N + 1] beats, seconds."""
    flags: tuple[Flag, ...]
    """[N] the kind of beat at the end of each block."""
    silent: tuple[bool, ...]
    """[N] true for a block in a pause of the speech."""
    lexemes: tuple[Lexeme, ...]
    """[N] the lexeme of each block."""
    knobs: PlanKnobs
    """The knobs of the first generation."""
    numbers: tuple[Index, ...] = ()
    """[N] the number of each block in `draw`, of a plan that was re-timed; left out for 0 to N - 1."""
    keyed_at: tuple[Seconds, ...] = ()
    """[N] the time by which the random numbers of each block are keyed, of a plan that was re-timed: where it began in
    the first sound, seconds; left out for the starts of the blocks."""


@dataclass(frozen=True)
class PlanKnobs:
    """Knobs of the whole performance."""

    intensity: Intensity = 1.0
    """Size of the gestures: at 0 the hands hang, 1 is as generated, 2 is largest."""
    mirror: bool = False
    """True exchanges left and right."""
    energy: Energy = "neutral"
    """A named pair of factors on intensity and activity."""
    activity: Share = 1.0
    """Share of the speaking time with gestures."""
    hold_still: tuple[tuple[Seconds, Seconds], ...] = ()
    """Ranges (from, to) in which the hands rest, seconds."""

    @property
    def size(self) -> float:
        """Intensity with the factor of the energy, 0 to 2."""
        return min(self.intensity * ENERGIES[self.energy][0], 2.0)

    @property
    def share(self) -> float:
        """Activity with the factor of the energy, 0 to 1."""
        return self.activity * ENERGIES[self.energy][1]

    def still_at(self, start: float, end: float) -> tuple[tuple[float, float], ...]:
        """The parts of the range from start to end in which the hands should rest or go to rest."""
        # Hands need time to come to rest, so the blocks before a range are concerned, too.
        ranges = ((max(begin - SETTLES, start), min(stop, end)) for begin, stop in self.hold_still)
        return tuple((begin, stop) for begin, stop in ranges if begin < stop)


@dataclass(frozen=True)
class GestureCue:
    """A gesture at a word or at a time."""

    gesture: str
    """A name of `gestures` (blended over the motion) or of `lexicon` (played in the block at that time)."""
    word: str | None = None
    """The word at which the gesture is made; alternative to `time`."""
    occurrence: Annotated[int, Meta(ge=1, le=10**6)] = 1
    """The number of the word among equal ones, from 1."""
    time: Seconds | None = None
    """Time of its stroke, seconds; alternative to `word`."""
    intensity: Intensity = 1.0
    """Size of the gesture, as the intensity of a block."""
    mirror: bool = False
    """True makes the gesture with the other hand."""
    source: str | None = None
    """Where the cue comes from: "mark" for a mark in the text; null for one of the user."""


@dataclass(frozen=True)
class GesturePhase:
    """A phase of a gesture unit."""

    kind: PhaseKind
    """The kind of phase."""
    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""


@dataclass(frozen=True)
class GestureUnit:
    """A gesture unit: from the moment the hands leave rest until they are at rest again, over several blocks."""

    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""
    phases: tuple[GesturePhase, ...] = ()
    """Its phases, in order and without overlap; there may be gaps, and several strokes."""
    hand: Hand | None = None
    """The hand that makes it; null if undecided."""
    size: Intensity = 1.0
    """Size of its gestures, as the intensity of a block."""


@dataclass(frozen=True)
class PlanMeaning:
    """The meaning of a stretch of speech, as far as a gesture can express it."""

    start: Seconds
    """Seconds."""
    end: Seconds
    """Seconds."""
    kind: str
    """The kind of meaning, such as "negation", "pointing" or "size"."""
    about: str = ""
    """The meaning in words."""
    certainty: Share | None = None
    """Probability that the meaning is right, or the score of the words that tell it."""
    source: str = ""
    """Where the meaning comes from: "words" if it was found in the spoken words."""
    word: str | None = None
    """The word that carries it, as written."""
    gesture: str | None = None
    """The gesture that shows it, a name of `gestures`; null shows none. Delete the entry to leave it out."""
    time: Seconds | None = None
    """Time of the gesture's stroke, seconds."""
    intensity: Intensity = 1.0
    """Size of the gesture, as the intensity of a block."""
    mirror: bool = False
    """True makes the gesture with the other hand."""


@dataclass(frozen=True)
class PosePin:
    """A fixed rotation, position or both of a joint at one time. The motion goes through it smoothly."""

    time: Seconds
    """Seconds."""
    joint: str
    """The joint's name in the skeleton; for a position LeftHand, RightHand or Head."""
    rotation: tuple[float, float, float, float] | None = None
    """Its local rotation, a unit quaternion, w first."""
    position: tuple[float, float, float] | None = None
    """Its position, metres: Y up, facing +Z, the floor at 0."""
    hold: Seconds = 0.0
    """Seconds for which the pin holds."""


@dataclass(frozen=True)
class KnobCurve:
    """A knob that changes over time: linear between its points, constant before and after them."""

    knob: CurveKnob
    """The name of the knob."""
    times: tuple[Seconds, ...]
    """[M] seconds, rising."""
    values: tuple[float, ...]
    """[M] the knob's value at these times, in its unit."""


@dataclass(frozen=True)
class GesturePlan:
    """The decisions for one recording, and their edits."""

    format: Literal["gesticulator-plan"]
    """The name of the file format."""
    version: Literal[2]
    """The version of the format."""
    made_by: dict[str, Any]
    """The origin of the plan: `gesticulator` (its version), `bundle` (preset, hash of the lexicon) and `settings`,
    which are replayed; do not edit."""
    sound: PlanSound
    """The recording."""
    seed: Seed
    """The seed of the first generation; --seed has no effect on a plan."""
    variation: Variation
    """The variation of the first generation."""
    speaker: str
    """The performer whose gesture style is used."""
    interpreter: str
    """The name of the model that chose the lexemes."""
    drawn: DrawnBlocks
    """The decisions of the first generation."""
    blocks: tuple[Block, ...]
    """The blocks to play; edit these."""
    knobs: PlanKnobs = PlanKnobs()
    """Knobs of the whole performance; edit these."""
    cues: tuple[GestureCue, ...] = ()
    """Gestures at words or times; edit these."""
    words: tuple[PlanWord, ...] = ()
    """The spoken words, if known."""
    lexicon: tuple[LexemeName, ...] = ()
    """The lexemes that blocks and cues can use, for information."""
    gestures: tuple[GestureName, ...] = ()
    """The gestures that cues can name, for information."""
    score_is: str = "log-probability"
    """The kind of the scores of alternatives."""
    notes: tuple[str, ...] = ()
    """Remarks for the user."""
    units: tuple[GestureUnit, ...] = ()
    """Gesture units, if planned."""
    meanings: tuple[PlanMeaning, ...] = ()
    """Meanings of stretches of the speech, if known."""
    pins: tuple[PosePin, ...] = ()
    """Fixed poses of joints at times."""
    curves: tuple[KnobCurve, ...] = ()
    """Knobs that change over time; at most one curve per knob."""
    fingerprint: Annotated[str, Meta(pattern="^([A-Za-z0-9+/]{8})+$")] | None = None
    """The fingerprint of the sound, by which the plan is moved onto another export of it (`--retime`)."""
    source: str = field(default="plan", compare=False, repr=False)
    """The name of the file that the plan was read from, for error messages; not a member of the file."""

    @property
    def duration(self) -> float:
        """Seconds covered by the blocks."""
        return self.drawn.edges[-1]

    def curve(self, knob: str) -> KnobCurve | None:
        """The curve of a knob; None without one."""
        return next((curve for curve in self.curves if curve.knob == knob), None)

    # Every error about a plan names its file first, then the path, so that an editor can jump there.
    def error(self, place: Place, wrong: str, advice: str) -> InputError:
        """An error about a part of the plan, which names the file and the path of the part."""
        return InputError(self.source, f"{place_of(place)} {wrong}", advice)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        plain: dict[str, Any] = _plain(self)
        return plain

    def to_json(self) -> str:
        """The text of the file: one line per block, word and lexeme; the same plan gives the same text."""
        return _in_lines(self.to_dict()) + "\n"


@functools.cache
def members(kind: type) -> Mapping[str, bool]:
    """Member of the file -> whether it is left out while it is null or empty: all fields of a class but `source`."""
    return {field.name: field.default in (None, ()) for field in dataclasses.fields(cast(Any, kind)) if field.compare}


def _plain(record: Any) -> Any:
    # Plain values for JSON.
    if isinstance(record, tuple | list):
        return [_plain(entry) for entry in record]
    if not dataclasses.is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else record
    values = ((name, getattr(record, name), optional) for name, optional in members(cast(type, type(record))).items())
    return {name: _plain(value) for name, value, optional in values if not (optional and value in (None, ()))}


def _in_lines(value: Any, depth: int = 0) -> str:
    # JSON text with one line for each member of the first two levels; deeper values stay on one line, so that a changed
    # block is one changed line for tools that compare files.
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    is_object = isinstance(value, dict)
    # Short values, lists of numbers, and everything from the rows of lists on stay on one line.
    rows_below = value if is_object and depth < 2 else isinstance(value, list) and value and isinstance(value[0], dict)
    if not rows_below or depth > 2 or len(flat) < 100:
        return flat
    indent = "\n" + " " * (depth + 1)
    rows = [f"{json.dumps(key, ensure_ascii=False)}: {_in_lines(inner, depth + 1)}" for key, inner in value.items()] \
        if is_object else [_in_lines(inner, depth + 1) for inner in value]
    first, last = "{}" if is_object else "[]"
    return first + indent + ("," + indent).join(rows) + "\n" + " " * depth + last


def place_of(path: Place) -> str:
    """A path as text, such as blocks[3].lexeme; "the file" for the root."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path).lstrip(".")
    return shown(text, 80) or "the file"


def sound_hash(speech: Speech) -> str:
    """SHA-256 of the samples, little-endian float32."""
    # The samples as they are heard, not the file: the same sound in another container is the same recording.
    return hashlib.sha256(speech.samples.astype("<f4", order="C", copy=False).data).hexdigest()


def edited_blocks(plan: GesturePlan) -> tuple[bool, ...]:
    """Whether each block must be generated again; the others are replayed. A block is replayed if its beats, lexeme,
    silence and random keys are those of the first generation, and the knobs that influence its generation are too,
    unless it is locked."""
    # Activity changes every block that is not locked; size and mirroring are applied afterwards.
    edited = edited_themselves(plan)
    if plan.knobs.share == plan.drawn.knobs.share:
        return edited
    return tuple([changed or not block.locked for changed, block in zip(edited, plan.blocks, strict=True)])


def edited_themselves(plan: GesturePlan) -> tuple[bool, ...]:
    """`edited_blocks`, apart from knobs of the whole recording."""
    drawn, knobs = plan.drawn, plan.knobs
    numbers = drawn.numbers or range(len(drawn.lexemes))
    first = dict(zip(pairwise(drawn.edges), zip(drawn.lexemes, drawn.silent, numbers, strict=True), strict=True))
    as_still = knobs.hold_still == drawn.knobs.hold_still
    out = []
    for block in plan.blocks:
        place, draw = (block.start, block.end), block.draw
        same = first.get(place) == (block.lexeme, block.silent, draw.block) \
            and (draw.seed, draw.variation) == (plan.seed, plan.variation)
        # Only here does a block depend on its place: ranges of stillness concern those that they overlap.
        if same and not block.locked and not as_still:
            same = knobs.still_at(*place) == drawn.knobs.still_at(*place)
        out.append(not same)
    return tuple(out)


def shapes(plan: GesturePlan) -> bool:
    """Whether the plan may change the generated poses, by intensity, mirroring or a gesture that shows a meaning."""
    # Most plans change no pose: then none of the arms' movements need to be remembered.
    knobs = plan.knobs
    if knobs.size != 1.0 or plan.curve("intensity") or any(meaning.gesture for meaning in plan.meanings):
        return True
    return any(block.intensity != 1.0 or block.mirror or (block.locked and knobs != plan.drawn.knobs)
               for block in plan.blocks)


def words_of(speech: Speech) -> tuple[PlanWord, ...]:
    """The words of a speech, as a plan stores them."""
    return tuple(PlanWord(word.text, word.start, word.end) for word in speech.words or () if word.text.strip())


def fingerprinted(plan: GesturePlan, speech: Speech) -> GesturePlan:
    """The plan with the fingerprint of its sound, by which it can be moved onto another export."""
    from data_module.speech.fingerprint import fingerprint, fingerprint_text

    return plan if plan.fingerprint is not None else replace(plan, fingerprint=fingerprint_text(fingerprint(speech)))


def named(plan: GesturePlan, names: tuple[LexemeName, ...]) -> GesturePlan:
    """The plan with the names of lexemes and gestures."""
    from gesticulator.plan.gestures import GESTURES

    by_lexeme = {entry.lexeme: entry.name for entry in names}
    blocks = [replace(block, name=None if block.lexeme is None else by_lexeme.get(block.lexeme), alternatives=tuple(
        replace(choice, name=by_lexeme.get(choice.lexeme, "")) for choice in block.alternatives))
        for block in plan.blocks]
    return replace(plan, blocks=tuple(blocks), lexicon=names,
                   gestures=tuple(GestureName(name, about) for name, about in GESTURES.items()))
