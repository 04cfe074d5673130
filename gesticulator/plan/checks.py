"""Consistency checks of gesture plans: blocks tile the sound, times rise, names are known."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from itertools import pairwise

from data_module.errors import InputError, shown
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, near_gestures
from gesticulator.plan.plan import GesturePlan, GestureUnit, Place, PlanMeaning, PosePin

SHORTEST, LONGEST = 0.1, 1.0
"""Allowed length of an edited block, seconds (detected blocks last 0.2 to 0.5)."""
LARGEST_SEED = 2**64 - 1
_PUNCTUATION = " .,;:!?\"'“”‘’„«»()[]-–—…¿¡"
CUES_PER_SECOND, ALLOWED_CUES = 4.0, 100
"""Most cues per second of sound; so many are allowed in any case. A gesture takes a second, so more cannot be seen."""
_MOST_OF_CURVES = {"intensity": 2.0, "activity": 1.0, "energy": 2.0}
"""Knob -> greatest value of its curve; the bundle says those of the others."""
PLACED = ("LeftHand", "RightHand", "Head")
"""Joints that can be pinned to a place; arms and spine follow them."""
_EPS = 1e-6
"""Largest difference of two equal times, seconds: numbers in files are rounded."""
_FINGERPRINT = re.compile("([A-Za-z0-9+/]{8})+")
"""Eight characters for each frame of 20 ms."""
_UNIT = 1e-3
"""Largest deviation of the squared length of a quaternion from 1: numbers in files are rounded."""


def plain_word(text: str) -> str:
    """A word in lower case without punctuation, for comparison with cues."""
    return text.strip(_PUNCTUATION).casefold()


def check_plan(plan: GesturePlan) -> None:
    """`InputError` if the parts of a plan are inconsistent."""
    if plan.seed > LARGEST_SEED:
        raise plan.error(("seed",), f"is {plan.seed}", f"give 0 to {LARGEST_SEED}")
    _check_drawn(plan)
    _check_blocks(plan)
    for at, (start, end) in enumerate(plan.knobs.hold_still):
        if not start < end:
            raise plan.error(("knobs", "hold_still", at), f"is {start:g} to {end:g}",
                             "give from and to, the smaller first")
    most = max(ALLOWED_CUES, int(CUES_PER_SECOND * plan.duration))
    if len(plan.cues) > most:
        raise plan.error(("cues", most), f"is one of {len(plan.cues)}", f"give {most} at most")
    spoken = Counter(plain_word(word.text) for word in plan.words)
    for at, cue in enumerate(plan.cues):
        if (cue.word is None) == (cue.time is None):
            raise plan.error(("cues", at), "must have either a word or a time", 'write {"gesture": "wave", "word": '
                             '"hello"} or {"gesture": "wave", "time": 1.5}')
        if cue.time is not None and cue.time > plan.duration:
            raise plan.error(("cues", at, "time"), f"is {cue.time:g}", f"give 0 to {plan.duration:g} seconds")
        if cue.word is not None and spoken[plain_word(cue.word)] < cue.occurrence:
            times = spoken[plain_word(cue.word)]
            raise plan.error(("cues", at, "word"), f"is {shown(cue.word)}, occurrence {cue.occurrence}, and is spoken "
                             f"{times} times" if plan.words else f"is {shown(cue.word)}, and the plan has no words",
                             "give a word of `words`, or a time instead")
        _check_gesture(plan, at, cue.gesture)
    _check_sections(plan)


def _check_sections(plan: GesturePlan) -> None:
    check_units(plan.units, plan.error)
    check_meanings(plan.meanings, plan.error)
    check_pins(plan.pins, plan.error)
    most = max(ALLOWED_CUES, int(CUES_PER_SECOND * plan.duration))
    if len(plan.pins) > most:
        raise plan.error(("pins", most), f"is one of {len(plan.pins)}", f"give {most} at most")
    for at, pin in enumerate(plan.pins):
        if pin.time > plan.duration + _EPS:
            raise plan.error(("pins", at, "time"), f"is {pin.time:g}", f"give 0 to {plan.duration:g} seconds")
    knobs = [curve.knob for curve in plan.curves]
    for at, curve in enumerate(plan.curves):
        check_points(("curves", at), ("times", "values"), (curve.times, curve.values), plan.error)
        highest = _MOST_OF_CURVES.get(curve.knob)
        if highest is not None and (outside := [value for value in curve.values if not 0.0 <= value <= highest]):
            raise plan.error(("curves", at, "values"), f"hold {outside[0]:g}", f"give 0 to {highest:g}")
        if curve.knob in knobs[:at]:
            raise plan.error(("curves", at, "knob"), f"is {curve.knob} again", "give one curve per knob")
    if plan.fingerprint is not None and not _is_fingerprint(plan.fingerprint, plan.sound.duration):
        raise plan.error(("fingerprint",), "is not that of the sound", "leave it as it was written, or remove it")


def _is_fingerprint(text: str, duration: float) -> bool:
    """Whether a text has the form of a fingerprint of this many seconds (`data_module.speech.fingerprint`)."""
    return bool(_FINGERPRINT.fullmatch(text)) and abs(len(text) / 8 - 50 * duration - 1) <= 2


def _check_gesture(plan: GesturePlan, at: int, name: str) -> None:
    lexemes = [entry.name for entry in plan.lexicon]
    if name not in GESTURES and name not in EXPRESSIONS and name not in lexemes and plan.lexicon:
        raise plan.error(("cues", at, "gesture"), f"is {shown(name)}, the name of no gesture",
                         near_gestures(name, lexemes))


def _check_drawn(plan: GesturePlan) -> None:
    drawn = plan.drawn
    count = len(drawn.edges) - 1
    for name in ("flags", "silent", "lexemes"):
        if len(getattr(drawn, name)) != count or count < 1:
            raise plan.error(("drawn", name), f"has {len(getattr(drawn, name))} entries for {count} blocks",
                             "leave `drawn` as it was written")
    if len(drawn.numbers) not in (0, count) or len(set(drawn.numbers)) != len(drawn.numbers):
        raise plan.error(("drawn", "numbers"), f"are not {count} different numbers", "leave `drawn` as it was written")
    if len(drawn.keyed_at) not in (0, count):
        raise plan.error(("drawn", "keyed_at"), f"has {len(drawn.keyed_at)} entries for {count} blocks",
                         "leave `drawn` as it was written")
    if drawn.edges[0] != 0 or any(not a < b for a, b in pairwise(drawn.edges)):
        raise plan.error(("drawn", "edges"), "do not rise from 0", "leave `drawn` as it was written")


def _check_blocks(plan: GesturePlan) -> None:
    """Blocks must tile the sound and have lexemes of the lexicon."""
    if not plan.blocks:
        raise plan.error(("blocks",), "is empty", "leave at least one block")
    known = {entry.lexeme: entry.name for entry in plan.lexicon}
    decided = dict(zip(pairwise(plan.drawn.edges), plan.drawn.lexemes, strict=True))
    edges, at_edge = plan.drawn.edges, 0.0
    pairs = set(pairwise(edges))
    for at, block in enumerate(plan.blocks):
        place: Place = ("blocks", at)
        if block.draw.seed > LARGEST_SEED:
            raise plan.error((*place, "draw", "seed"), f"is {block.draw.seed}", f"give 0 to {LARGEST_SEED}")
        if abs(block.start - at_edge) > _EPS:
            raise plan.error((*place, "start"), f"is {block.start:g}", f"give {at_edge:g}, where the block before ends")
        if (block.start, block.end) not in pairs and not SHORTEST - _EPS <= block.end - block.start <= LONGEST + _EPS:
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
    if abs(at_edge - edges[-1]) > _EPS:
        raise plan.error(("blocks", len(plan.blocks) - 1, "end"), f"is {at_edge:g}", f"give {edges[-1]:g}, the end of "
                         "the sound")


def check_units(units: tuple[GestureUnit, ...], error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` for overlapping units, and for phases that overlap or are not within their unit. error: makes the
    error of a place."""
    end = 0.0
    for at, unit in enumerate(units):
        place: Place = ("units", at)
        if not end <= unit.start < unit.end:
            raise error((*place, "start"), f"is {unit.start:g}", f"give {end:g} or more, and less than its end")
        end = unit.start
        for number, phase in enumerate(unit.phases):
            if not end <= phase.start < phase.end <= unit.end:
                raise error((*place, "phases", number), f"is {phase.start:g} to {phase.end:g} s",
                            f"give a range within {end:g} to {unit.end:g} s")
            end = phase.end
        end = unit.end


def check_meanings(meanings: tuple[PlanMeaning, ...], error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` for a meaning that ends before it begins, and for a gesture without a time or an unknown one."""
    for at, meaning in enumerate(meanings):
        if not meaning.start <= meaning.end:
            raise error(("meanings", at), f"is {meaning.start:g} to {meaning.end:g} s",
                        "give from and to, the smaller first")
        if meaning.gesture is not None and meaning.gesture not in GESTURES:
            raise error(("meanings", at, "gesture"), f"is {shown(meaning.gesture)}",
                        f"give one of {', '.join(GESTURES)}, or null")
        if (meaning.gesture is None) != (meaning.time is None):
            raise error(("meanings", at), "has either a gesture or a time alone", "give both, or neither")


def check_pins(pins: tuple[PosePin, ...], error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` for a pin without rotation and position, with a position of another joint than hands and head, or
    with a rotation that is not a unit quaternion."""
    for at, pin in enumerate(pins):
        if pin.position is not None and pin.joint not in PLACED:
            raise error(("pins", at, "joint"), f"is {shown(pin.joint)}, which cannot be pinned to a place",
                        f"give one of {', '.join(PLACED)}, or a rotation instead of the position")
        if pin.rotation is None and pin.position is None:
            raise error(("pins", at), "has neither a rotation nor a position", "give one of them, or both")
        if pin.rotation is not None and abs(sum(part * part for part in pin.rotation) - 1.0) > _UNIT:
            raise error(("pins", at, "rotation"), "is not a unit quaternion", "give w, x, y and z of length 1")


def check_points(place: Place, names: tuple[str, str], columns: tuple[tuple[float, ...], tuple[float, ...]],
                 error: Callable[[Place, str, str], InputError]) -> None:
    """`InputError` if two columns [M] are empty or differ in length, or the first does not rise."""
    first, second = columns
    if not first or len(first) != len(second):
        raise error((*place, names[1]), f"has {len(second)} entries for {len(first)} {names[0]}",
                    "give the same number of both, at least one")
    if any(not a < b for a, b in pairwise(first)):
        raise error((*place, names[0]), "do not rise", "sort them, without duplicates")
