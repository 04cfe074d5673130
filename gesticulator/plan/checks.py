"""Consistency checks of gesture plans, which types cannot state: blocks tile the sound, times rise, names are known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

from data_module.errors import shown
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, near_gestures
from gesticulator.plan.plan import GesturePlan, Place

SHORTEST, LONGEST = 0.1, 1.0
"""Allowed length of an edited block, seconds (detected blocks last 0.2 to 0.5)."""
CUES_PER_SECOND, ALLOWED_CUES = 4.0, 100
"""Most cues per second of sound; so many are allowed in any case. A gesture takes a second, so more cannot be seen."""
_LARGEST_SEED = 2**64 - 1
_PUNCTUATION = " .,;:!?\"'“”‘’„«»()[]-–—…¿¡"
_MOST_OF_CURVES = {"intensity": 2.0, "activity": 1.0, "energy": 2.0}
"""Knob -> greatest value of its curve; the bundle says those of the others."""
_PLACED = ("LeftHand", "RightHand", "Head")
"""Joints that can be pinned to a place; arms and spine follow them."""
_EPS = 1e-6
"""Largest difference of two equal times, seconds: numbers in files are rounded."""
_UNIT = 1e-3
"""Largest deviation of the squared length of a quaternion from 1: numbers in files are rounded."""
_AS_WRITTEN = "leave `drawn` as it was written"


def plain_word(text: str) -> str:
    """A word in lower case without punctuation, for comparison with cues."""
    return text.strip(_PUNCTUATION).casefold()


def check_plan(plan: GesturePlan) -> None:
    """`InputError` if the parts of a plan are inconsistent."""
    # The first generation comes first: the other checks look blocks up in it.
    for check in (_check_drawn, _check_blocks, _check_cues, _check_units, _check_meanings, _check_pins, _check_curves):
        check(plan)


def _check_drawn(plan: GesturePlan) -> None:
    drawn = plan.drawn
    count = len(drawn.edges) - 1
    for name in ("flags", "silent", "lexemes", "numbers", "keyed_at"):
        entries = getattr(drawn, name)
        # The last two stand only in plans that were re-timed.
        may_lack = not entries and name in ("numbers", "keyed_at")
        if count < 1 or (len(entries) != count and not may_lack):
            raise plan.error(("drawn", name), f"has {len(entries)} entries for {count} blocks", _AS_WRITTEN)
    if len(set(drawn.numbers)) != len(drawn.numbers):
        raise plan.error(("drawn", "numbers"), "has equal numbers", _AS_WRITTEN)
    if drawn.edges[0] != 0 or any(not a < b for a, b in pairwise(drawn.edges)):
        raise plan.error(("drawn", "edges"), "do not rise from 0", _AS_WRITTEN)
    seeds: dict[Place, int] = {("blocks", at, "draw", "seed"): block.draw.seed for at, block in enumerate(plan.blocks)}
    for place, seed in {("seed",): plan.seed, **seeds}.items():
        if seed > _LARGEST_SEED:
            raise plan.error(place, f"is {seed}", f"give 0 to {_LARGEST_SEED}")


def _check_blocks(plan: GesturePlan) -> None:
    """Blocks must tile the sound and have lexemes of the lexicon."""
    if not plan.blocks:
        raise plan.error(("blocks",), "is empty", "leave at least one block")
    known = {entry.lexeme: entry.name for entry in plan.lexicon}
    decided = dict(zip(pairwise(plan.drawn.edges), plan.drawn.lexemes, strict=True))
    at_edge, end = 0.0, plan.drawn.edges[-1]
    for at, block in enumerate(plan.blocks):
        place: Place = ("blocks", at)
        if abs(block.start - at_edge) > _EPS:
            raise plan.error((*place, "start"), f"is {block.start:g}", f"give {at_edge:g}, where the block before ends")
        # Detected blocks may have any length; a moved beat must leave one that motion can be generated for.
        if (block.start, block.end) not in decided \
                and not SHORTEST - _EPS <= block.end - block.start <= LONGEST + _EPS:
            raise plan.error((*place, "end"), f"is {block.end:g}, {block.end - block.start:.3g} s after the start",
                             f"give {block.start + SHORTEST:.6g} to {block.start + LONGEST:.6g} seconds")
        if block.lexeme is not None and known and block.lexeme not in known:
            raise plan.error((*place, "lexeme"), f"is {block.lexeme}", f"give {min(known)} to {max(known)}, or null")
        # The name beside a lexeme that was edited may still be that of the lexeme before.
        if block.name and block.lexeme is not None and known.get(block.lexeme, block.name) != block.name \
                and decided.get((block.start, block.end)) == block.lexeme:
            raise plan.error((*place, "name"), f"is {shown(block.name)}, but lexeme {block.lexeme} is "
                             f"{shown(known[block.lexeme])}", "edit `lexeme`, which determines the motion")
        at_edge = block.end
    if abs(at_edge - end) > _EPS:
        raise plan.error(("blocks", len(plan.blocks) - 1, "end"), f"is {at_edge:g}", f"give {end:g}, the end of the "
                         "sound")


def _check_cues(plan: GesturePlan) -> None:
    _check_count(plan, "cues")
    # The words of the plan decide: a transcript that was corrected by hand is the one that cues refer to.
    spoken = Counter(plain_word(word.text) for word in plan.words)
    lexemes = [entry.name for entry in plan.lexicon]
    for at, cue in enumerate(plan.cues):
        if (cue.word is None) == (cue.time is None):
            raise plan.error(("cues", at), "must have either a word or a time", 'write {"gesture": "wave", "word": '
                             '"hello"} or {"gesture": "wave", "time": 1.5}')
        _check_time(plan, ("cues", at), cue.time)
        if cue.word is not None and spoken[plain_word(cue.word)] < cue.occurrence:
            raise plan.error(("cues", at, "word"), f"is {shown(cue.word)}, occurrence {cue.occurrence}, and is spoken "
                             f"{spoken[plain_word(cue.word)]} times", "give a word of `words`, or a time instead")
        # A plan without the names of its lexicon may name a lexeme that only the bundle knows.
        if lexemes and cue.gesture not in (*GESTURES, *EXPRESSIONS, *lexemes):
            raise plan.error(("cues", at, "gesture"), f"is {shown(cue.gesture)}, the name of no gesture",
                             near_gestures(cue.gesture, lexemes))


def _check_count(plan: GesturePlan, name: str) -> None:
    count, most = len(getattr(plan, name)), max(ALLOWED_CUES, int(CUES_PER_SECOND * plan.duration))
    if count > most:
        raise plan.error((name, most), f"is one of {count}", f"give {most} at most")


def _check_time(plan: GesturePlan, place: Place, time: float | None) -> None:
    if time is not None and time > plan.duration + _EPS:
        raise plan.error((*place, "time"), f"is {time:g}", f"give 0 to {plan.duration:g} seconds")


def _check_units(plan: GesturePlan) -> None:
    """Units and their phases follow each other without overlap, phases within their unit."""
    # One cursor for both levels: phases fill their unit, and the next unit begins after it.
    end = 0.0
    for at, unit in enumerate(plan.units):
        if not end <= unit.start < unit.end:
            raise plan.error(("units", at, "start"), f"is {unit.start:g}",
                             f"give {end:g} or more, and less than its end")
        end = unit.start
        for number, phase in enumerate(unit.phases):
            if not end <= phase.start < phase.end <= unit.end:
                raise plan.error(("units", at, "phases", number), f"is {phase.start:g} to {phase.end:g} s",
                                 f"give a range within {end:g} to {unit.end:g} s")
            end = phase.end
        end = unit.end


def _check_meanings(plan: GesturePlan) -> None:
    for at, meaning in enumerate(plan.meanings):
        if not meaning.start <= meaning.end:
            raise plan.error(("meanings", at), f"is {meaning.start:g} to {meaning.end:g} s",
                             "give from and to, the smaller first")
        if meaning.gesture is not None and meaning.gesture not in GESTURES:
            raise plan.error(("meanings", at, "gesture"), f"is {shown(meaning.gesture)}, the name of no gesture",
                             near_gestures(meaning.gesture))
        if (meaning.gesture is None) != (meaning.time is None):
            raise plan.error(("meanings", at), "has either a gesture or a time alone", "give both, or neither")


def _check_pins(plan: GesturePlan) -> None:
    _check_count(plan, "pins")
    for at, pin in enumerate(plan.pins):
        _check_time(plan, ("pins", at), pin.time)
        if pin.position is not None and pin.joint not in _PLACED:
            raise plan.error(("pins", at, "joint"), f"is {shown(pin.joint)}, which cannot be pinned to a place",
                             f"give one of {', '.join(_PLACED)}, or a rotation instead of the position")
        # Without either, the pin would only hold still what the motion does anyway.
        if pin.rotation is None and pin.position is None:
            raise plan.error(("pins", at), "has neither a rotation nor a position", "give one of them, or both")
        if pin.rotation is not None and abs(sum(part * part for part in pin.rotation) - 1.0) > _UNIT:
            raise plan.error(("pins", at, "rotation"), "is not a unit quaternion", "give w, x, y and z of length 1")


def _check_curves(plan: GesturePlan) -> None:
    """What changes over time: ranges of stillness, curves of knobs, and the map onto another sound."""
    for at, (start, end) in enumerate(plan.knobs.hold_still):
        if not start < end:
            raise plan.error(("knobs", "hold_still", at), f"is {start:g} to {end:g}",
                             "give from and to, the smaller first")
    # Of two curves of one knob only the first would count.
    knobs = [curve.knob for curve in plan.curves]
    for at, curve in enumerate(plan.curves):
        _check_points(plan, ("curves", at), times=curve.times, values=curve.values)
        highest = _MOST_OF_CURVES.get(curve.knob)
        if highest is not None and (outside := [value for value in curve.values if not 0.0 <= value <= highest]):
            raise plan.error(("curves", at, "values"), f"hold {outside[0]:g}", f"give 0 to {highest:g}")
        if curve.knob in knobs[:at]:
            raise plan.error(("curves", at, "knob"), f"is {curve.knob} again", "give one curve per knob")


def _check_points(plan: GesturePlan, place: Place, **columns: Sequence[float]) -> None:
    """`InputError` if two columns [M] are empty or differ in length, or the first does not rise."""
    (name, first), (other, second) = columns.items()
    if not first or len(first) != len(second):
        raise plan.error((*place, other), f"has {len(second)} entries for {len(first)} {name}",
                         "give the same number of both, at least one")
    if any(not a < b for a, b in pairwise(first)):
        raise plan.error((*place, name), "do not rise", "sort them, without duplicates")
