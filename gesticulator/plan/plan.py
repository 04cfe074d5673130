"""The gesture plan: what was decided for a recording, as a file that people and pages read, edit and render again.

A plan holds the sound's name and hash, the seed, the words, what can be chosen (`lexicon`, `gestures`), what was
decided (`drawn`), and `blocks`, in which all that may be edited stands. What differs between `blocks` and `drawn` is
the edit: those stretches are drawn anew, all others are replayed (`gesticulator.directions`).

Plain data: nothing here imports numpy or a model. `docs/schema/plan.schema.json` is made of these classes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from data_module.errors import InputError, shown
from data_module.files import read_text, write_text
from data_module.settings import SettingChoice, SettingRange
from gesticulator.plan.json_lines import LinedJson, parse
from gesticulator.plan.json_lines import Path as Place
from gesticulator.plan.schema import PRIVATE, read_as, schema_of, to_plain
from gesticulator.plan.sections import (
    GestureUnit,
    KnobCurve,
    PlanMeaning,
    PosePin,
    SoundAlignment,
    check_meanings,
    check_pins,
    check_points,
    check_units,
)
from gesticulator.plan.upgrade import FORMAT, VERSION, upgraded

if TYPE_CHECKING:
    from data_module.types import Speech

__all__ = ["GESTURES", "BlockDraw", "GestureCue", "GesturePlan", "LexemeChoice", "PlanBlock", "PlanKnobs", "PlanSound",
           "PlanWord", "check_plan", "edited_blocks", "read_plan", "write_plan_file"]

ENERGIES: Mapping[str, tuple[float, float]] = {"calm": (0.6, 0.6), "neutral": (1.0, 1.0), "lively": (1.5, 1.0)}
"""Energy -> what intensity and activity are multiplied by: calm is smaller gestures in six tenths of the phrases."""

HANDS = ("left", "right", "both")
"""What handedness may prefer."""

FLAGS = ("boundary", "onset", "loud_pseudo", "even_pseudo", "edited")
"""Why a block ends where it ends: the names of `BeatFlag`, and a beat that a user moved or made."""
SHORTEST, LONGEST = 0.1, 1.0
"""Seconds that a block may last whose beats were edited; those that are found last 0.2 to 0.5."""
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
_EPS = 1e-6
"""Seconds within which two times are the same: files round."""
_MOST_BYTES = 32 << 20
"""Bytes of a plan that are read; an hour's has 10 million."""

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
class PlanBlock:
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
    blocks: tuple[PlanBlock, ...]
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
    source: LinedJson | None = field(default=None, metadata=PRIVATE, compare=False, repr=False)
    """The file that it was read from, for messages."""

    @property
    def duration(self) -> float:
        """Seconds that the blocks tile."""
        return self.drawn.edges[-1]

    def error(self, place: Place, wrong: str, advice: str) -> InputError:
        """An error about a part of the plan, with its line where it was read from a file."""
        return (self.source or LinedJson("plan", None, {})).error(place, wrong, advice)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        plain: dict[str, Any] = to_plain(self)
        return plain

    def to_json(self) -> str:
        """As it is written: a line for a block, a word, a lexeme; the same plan gives the same text."""
        return _dump(self.to_dict(), 0) + "\n"


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


def schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a plan."""
    return schema_of(GesturePlan)


# ------------------------------------------------------------------------------------------------------ files

def read_plan(path: str | os.PathLike[str]) -> GesturePlan:
    """A plan from a file; `InputError` with the line and what is allowed where it cannot be used."""
    return parse_plan(read_text(path, "give the file that --plan-out wrote", _MOST_BYTES), str(path))


def parse_plan(text: str, source: str = "plan") -> GesturePlan:
    """A plan from its text; `InputError` with the line and what is allowed. source: what messages call it."""
    lined = upgraded(parse(text, source))
    plan = replace(read_as(GesturePlan, lined), source=lined)
    check_plan(plan)
    return plan


def write_plan_file(path: str | os.PathLike[str], plan: GesturePlan) -> Path:
    """Write a plan, whole or not at all. Returns the path."""
    target = Path(path)
    write_text(target, plan.to_json())
    return target


def _dump(value: Any, depth: int) -> str:
    """JSON with objects of the first two levels on lines of their own, and everything below on one."""
    flat = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if depth > 2 or len(flat) < 100 or not isinstance(value, dict | list) or not value:
        return flat
    if depth == 2 and isinstance(value, dict):
        return flat
    inner = " " * (depth + 1)
    if isinstance(value, dict):
        rows = [f"{json.dumps(key, ensure_ascii=False)}: {_dump(one, depth + 1)}" for key, one in value.items()]
        return "{\n" + ",\n".join(inner + row for row in rows) + "\n" + " " * depth + "}"
    if not isinstance(value[0], dict):
        return flat
    return "[\n" + ",\n".join(inner + _dump(one, depth + 1) for one in value) + "\n" + " " * depth + "]"


# ------------------------------------------------------------------------------------------------------ checks

def check_plan(plan: GesturePlan) -> None:
    """`InputError` where the parts of a plan do not fit each other."""
    _check_drawn(plan)
    _check_blocks(plan)
    for at, (start, end) in enumerate(plan.knobs.hold_still):
        if not start < end:
            raise plan.error(("knobs", "hold_still", at), f"is {start:g} to {end:g}",
                             "give from and to, the lesser first")
    for at, cue in enumerate(plan.cues):
        if (cue.word is None) == (cue.time is None):
            raise plan.error(("cues", at), "must have either a word or a time", 'write {"gesture": "wave", "word": '
                             '"hello"} or {"gesture": "wave", "time": 1.5}')
        if cue.time is not None and cue.time > plan.duration:
            raise plan.error(("cues", at, "time"), f"is {cue.time:g}", f"give 0 to {plan.duration:g} seconds")
        _check_gesture(plan, at, cue.gesture)
    _check_sections(plan)


def _check_sections(plan: GesturePlan) -> None:
    check_units(plan.units, plan.error)
    check_meanings(plan.meanings, plan.error)
    check_pins(plan.pins, plan.error)
    knobs = [curve.knob for curve in plan.curves]
    for at, curve in enumerate(plan.curves):
        check_points(("curves", at), ("times", "values"), (curve.times, curve.values), plan.error)
        if curve.knob in knobs[:at]:
            raise plan.error(("curves", at, "knob"), f"is {curve.knob} once more", "give one curve for a knob")
    if plan.alignment is not None:
        times, there = plan.alignment.times, plan.alignment.there
        check_points(("alignment",), ("times", "there"), (times, there), plan.error)
        check_points(("alignment",), ("there", "times"), (there, times), plan.error)


def _check_gesture(plan: GesturePlan, at: int, name: str) -> None:
    known = [*GESTURES, *(one.name for one in plan.lexicon)]
    if name not in known and plan.lexicon:
        raise plan.error(("cues", at, "gesture"), f"is {shown(name)}",
                         f"give one of {', '.join(GESTURES)}, or a name of the lexicon")


def _check_drawn(plan: GesturePlan) -> None:
    drawn = plan.drawn
    count = len(drawn.edges) - 1
    for name in ("flags", "silent", "lexemes"):
        if len(getattr(drawn, name)) != count or count < 1:
            raise plan.error(("drawn", name), f"has {len(getattr(drawn, name))} entries for {count} blocks",
                             "leave what was drawn as it was written")
    if drawn.edges[0] != 0 or any(not a < b for a, b in zip(drawn.edges, drawn.edges[1:], strict=False)):
        raise plan.error(("drawn", "edges"), "do not rise from 0", "leave what was drawn as it was written")


def _check_blocks(plan: GesturePlan) -> None:
    """Blocks tile the sound, and have lexemes that there are."""
    if not plan.blocks:
        raise plan.error(("blocks",), "is empty", "leave a block at least")
    known = {one.lexeme for one in plan.lexicon}
    edges, at_edge = plan.drawn.edges, 0.0
    pairs = set(zip(edges, edges[1:], strict=False))
    for at, block in enumerate(plan.blocks):
        place: Place = ("blocks", at)
        if abs(block.start - at_edge) > _EPS:
            raise plan.error((*place, "start"), f"is {block.start:g}", f"give {at_edge:g}, where the block before ends")
        if (block.start, block.end) not in pairs and not SHORTEST - _EPS <= block.end - block.start <= LONGEST + _EPS:
            raise plan.error((*place, "end"), f"is {block.end:g}, {block.end - block.start:.3g} s after the start",
                             f"give {block.start + SHORTEST:.6g} to {block.start + LONGEST:.6g} seconds")
        if block.lexeme is not None and known and block.lexeme not in known:
            raise plan.error((*place, "lexeme"), f"is {block.lexeme}", f"give {min(known)} to {max(known)}, or null")
        at_edge = block.end
    if abs(at_edge - edges[-1]) > _EPS:
        raise plan.error(("blocks", len(plan.blocks) - 1, "end"), f"is {at_edge:g}", f"give {edges[-1]:g}, the end of "
                         "the sound")
