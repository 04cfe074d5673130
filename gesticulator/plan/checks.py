"""Consistency checks of gesture plans, which types cannot state: blocks tile the sound, times rise, names are known."""

from collections import Counter
from collections.abc import Iterator
from itertools import chain, pairwise

from data_module.errors import shown
from gesticulator.plan.gestures import EXPRESSIONS, GESTURES, near_gestures
from gesticulator.plan.plan import GesturePlan, Place

SHORTEST, LONGEST = 0.1, 1.0
"""Allowed length of an edited block, seconds (detected blocks last 0.2 to 0.5)."""
CUES_PER_SECOND, ALLOWED_CUES = 4.0, 100
"""Most cues per second of sound; so many are allowed in any case. A gesture takes a second, so more cannot be seen."""
_LARGEST_SEED = 2**64 - 1
_PUNCTUATION = " .,;:!?\"'“”‘’„«»()[]-–—…¿¡"
# Joints that can be pinned to a place; arms and spine follow them.
_PLACED = ("LeftHand", "RightHand", "Head")
# Largest difference of two equal times, seconds: numbers in files are rounded.
_EPS = 1e-6
# Largest deviation of the squared length of a quaternion from 1: numbers in files are rounded.
_UNIT = 1e-3

Fault = tuple[Place, str, str]
"""A part of a plan, what is wrong with it, and what to do."""


def plain_word(text: str) -> str:
    """A word in lower case without punctuation, for comparison with cues."""
    return text.strip(_PUNCTUATION).casefold()


def check_plan(plan: GesturePlan) -> None:
    """`InputError` if the parts of a plan are inconsistent."""
    # The first generation comes first: the other checks look blocks up in it.
    for fault in chain(*(check(plan) for check in (_drawn, _blocks, _cues, _meanings, _pins, _curves))):
        raise plan.error(*fault)


def _drawn(plan: GesturePlan) -> Iterator[Fault]:
    drawn = plan.drawn
    count = len(drawn.edges) - 1
    for name in ("flags", "silent", "lexemes", "numbers", "keyed_at"):
        entries = getattr(drawn, name)
        # The last two stand only in plans that were re-timed.
        may_lack = not entries and name in ("numbers", "keyed_at")
        twice = name == "numbers" and len(set(entries)) < len(entries)
        if count < 1 or twice or (len(entries) != count and not may_lack):
            yield ("drawn", name), f"are {len(entries)} entries for {count} blocks", "leave `drawn` as it was written"
    if drawn.edges[0] != 0 or any(not a < b for a, b in pairwise(drawn.edges)):
        yield ("drawn", "edges"), "do not rise from 0", "leave `drawn` as it was written"
    seeds: dict[Place, int] = {("blocks", at, "draw", "seed"): block.draw.seed for at, block in enumerate(plan.blocks)}
    for place, seed in {("seed",): plan.seed, **seeds}.items():
        if seed > _LARGEST_SEED:
            yield place, f"is {seed}", f"give 0 to {_LARGEST_SEED}"


def _blocks(plan: GesturePlan) -> Iterator[Fault]:
    # Blocks must tile the sound and have lexemes of the lexicon.
    if not plan.blocks:
        yield ("blocks",), "is empty", "leave at least one block"
    known = [entry.lexeme for entry in plan.lexicon]
    detected, at_edge, end = set(pairwise(plan.drawn.edges)), 0.0, plan.drawn.edges[-1]
    for at, block in enumerate(plan.blocks):
        if abs(block.start - at_edge) > _EPS:
            yield ("blocks", at, "start"), f"is {block.start:g}", f"give {at_edge:g}, where the block before ends"
        # Detected blocks may have any length; a moved beat must leave one that motion can be generated for.
        if (block.start, block.end) not in detected \
                and not SHORTEST - _EPS <= block.end - block.start <= LONGEST + _EPS:
            yield (("blocks", at, "end"), f"is {block.end:g}, {block.end - block.start:.3g} s after the start",
                   f"give {block.start + SHORTEST:.6g} to {block.start + LONGEST:.6g} seconds")
        if block.lexeme is not None and known and block.lexeme not in known:
            yield ("blocks", at, "lexeme"), f"is {block.lexeme}", f"give {min(known)} to {max(known)}, or null"
        at_edge = block.end
    if abs(at_edge - end) > _EPS:
        yield ("blocks", len(plan.blocks) - 1, "end"), f"is {at_edge:g}", f"give {end:g}, the end of the sound"


def _cues(plan: GesturePlan) -> Iterator[Fault]:
    yield from _bounded(plan, "cues")
    # The words of the plan decide: a transcript that was corrected by hand is the one that cues refer to.
    spoken = Counter(plain_word(word.text) for word in plan.words)
    lexemes = [entry.name for entry in plan.lexicon]
    for at, cue in enumerate(plan.cues):
        count = spoken[plain_word(cue.word or "")]
        if (cue.word is None) == (cue.time is None):
            yield ("cues", at), "must have either a word or a time", "give one of them"
        if cue.word is not None and count < cue.occurrence:
            yield (("cues", at, "word"), f"is {shown(cue.word)}, occurrence {cue.occurrence}, and is spoken {count} "
                   "times", "give a word of `words`, or a time instead")
        # A plan without the names of its lexicon may name a lexeme that only the bundle knows.
        if lexemes and cue.gesture not in (*GESTURES, *EXPRESSIONS, *lexemes):
            yield (("cues", at, "gesture"), f"is {shown(cue.gesture)}, the name of no gesture",
                   near_gestures(cue.gesture, lexemes))


def _bounded(plan: GesturePlan, name: str) -> Iterator[Fault]:
    # Too many cues or pins, and those after the end.
    rows, most = getattr(plan, name), max(ALLOWED_CUES, int(CUES_PER_SECOND * plan.duration))
    if len(rows) > most:
        yield (name, most), f"is one of {len(rows)}", f"give {most} at most"
    for at, row in enumerate(rows):
        if row.time is not None and row.time > plan.duration + _EPS:
            yield (name, at, "time"), f"is {row.time:g}", f"give 0 to {plan.duration:g} seconds"


def _meanings(plan: GesturePlan) -> Iterator[Fault]:
    for at, meaning in enumerate(plan.meanings):
        if meaning.gesture is not None and meaning.gesture not in GESTURES:
            yield (("meanings", at, "gesture"), f"is {shown(meaning.gesture)}, the name of no gesture",
                   near_gestures(meaning.gesture))


def _pins(plan: GesturePlan) -> Iterator[Fault]:
    yield from _bounded(plan, "pins")
    for at, pin in enumerate(plan.pins):
        if pin.position is not None and pin.joint not in _PLACED:
            yield (("pins", at, "joint"), f"is {shown(pin.joint)}, which cannot be pinned to a place",
                   f"give one of {', '.join(_PLACED)}, or a rotation instead of the position")
        # Without either, the pin would only hold still what the motion does anyway.
        if pin.rotation is None and pin.position is None:
            yield ("pins", at), "has neither a rotation nor a position", "give one of them, or both"
        if pin.rotation is not None and abs(sum(part * part for part in pin.rotation) - 1.0) > _UNIT:
            yield ("pins", at, "rotation"), "is not a unit quaternion", "give w, x, y and z of length 1"


def _curves(plan: GesturePlan) -> Iterator[Fault]:
    # Ranges of stillness, and curves of knobs.
    for at, (start, end) in enumerate(plan.knobs.hold_still):
        if not start < end:
            yield ("knobs", "hold_still", at), f"is {start:g} to {end:g}", "give from and to, the smaller first"
    # Of two curves of one knob only the first would count.
    knobs = [curve.knob for curve in plan.curves]
    for at, curve in enumerate(plan.curves):
        if not curve.times or len(curve.times) != len(curve.values):
            yield (("curves", at, "values"), f"has {len(curve.values)} entries for {len(curve.times)} times",
                   "give the same number of both, at least one")
        if any(not a < b for a, b in pairwise(curve.times)):
            yield ("curves", at, "times"), "do not rise", "sort them, without duplicates"
        # The bundle says the bounds of the others.
        outside = [value for value in curve.values if curve.knob == "intensity" and not 0.0 <= value <= 2.0]
        if outside:
            yield ("curves", at, "values"), f"hold {outside[0]:g}", "give 0 to 2"
        if curve.knob in knobs[:at]:
            yield ("curves", at, "knob"), f"is {curve.knob} again", "give one curve per knob"
