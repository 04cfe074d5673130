"""The plan of a performance: its blocks with their alternatives, and everything needed to render it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any, cast

from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan import (
    FORMAT,
    VERSION,
    DrawnBlocks,
    GestureName,
    GesturePhase,
    GesturePlan,
    GestureUnit,
    Hand,
    LexemeName,
    PhaseKind,
    PlanMeaning,
    PlanSound,
    PlanWord,
    sound_hash,
)

if TYPE_CHECKING:
    from data_module.types import Blocks, Speech
    from gesticulator.options import InferenceOptions
    from gesticulator.sampling.loop import BlockMotion

_ABOVE = ("seed", "variation", "speaker", "interpreter", "activity")
"""Settings that have fields of their own in a plan."""
_SIZES = (1.0, 0.6, 1.0, 1.5)
"""The size of a unit's gestures, as an intensity, for each of the planner's sizes."""


@dataclass(frozen=True)
class Origin:
    """Provenance of a performance. options: with the bundle's defaults filled in; program: version and bundle, in plain
    values; settings: all that the generation depends on; score_is: the kind of scores; meanings: of the words."""

    options: InferenceOptions
    program: Mapping[str, Any]
    settings: Mapping[str, Any]
    score_is: str
    meanings: tuple[PlanMeaning, ...] = ()


def plan_of(speech: Speech, cut: Blocks, blocks: Sequence[BlockMotion], origin: Origin) -> GesturePlan:
    """The plan of a first generation, still without names of lexemes (`named`). cut: the N blocks of the speech."""
    settings, decisions = origin.settings, tuple(block.block for block in blocks)
    drawn = DrawnBlocks(tuple(cut.edges.tolist()), tuple(block.flag for block in decisions),
                        tuple(block.silent for block in decisions), tuple(block.lexeme for block in blocks),
                        origin.options.knobs)
    # What the plan states in fields of its own is not repeated in the settings, where an edit would contradict it.
    made_by = {**origin.program, "settings": {key: value for key, value in settings.items() if key not in _ABOVE}}
    return GesturePlan(
        FORMAT, VERSION, made_by, PlanSound("", speech.duration, speech.sample_rate, sound_hash(speech)),
        int(settings["seed"]), int(settings["variation"]), str(settings["speaker"]), str(settings["interpreter"]),
        drawn, decisions, drawn.knobs, tuple(origin.options.cues), words_of(speech), score_is=origin.score_is,
        units=units_of_blocks(blocks), meanings=origin.meanings)


def rendered_plan(plan: GesturePlan, speech: Speech, blocks: Sequence[BlockMotion], origin: Origin) -> GesturePlan:
    """A plan after rendering, with the models' choices in its edited blocks."""
    # The hash of the sound was compared with the plan's before rendering (`directions.check_plan_of`).
    sound = PlanSound("", speech.duration, speech.sample_rate, plan.sound.sha256)
    decided = tuple(replace(
        block, lexeme=made.lexeme if block.lexeme is None else block.lexeme, gate=made.block.gate,
        alternatives=made.block.alternatives, score=made.block.score, rank=made.block.rank)
        for block, made in zip(plan.blocks, blocks, strict=True))
    return replace(plan, sound=sound, blocks=decided, units=units_of_blocks(blocks) or plan.units,
                   words=words_of(speech), score_is=origin.score_is, source="plan")


def fingerprinted(plan: GesturePlan, speech: Speech) -> GesturePlan:
    """The plan with the fingerprint of its sound, by which it can be moved onto another export."""
    from data_module.speech.fingerprint import fingerprint, fingerprint_text

    return plan if plan.fingerprint is not None else replace(plan, fingerprint=fingerprint_text(fingerprint(speech)))


def named(plan: GesturePlan, names: tuple[LexemeName, ...]) -> GesturePlan:
    """The plan with the names of lexemes and gestures."""
    by_lexeme = {entry.lexeme: entry.name for entry in names}
    blocks = [replace(block, name=None if block.lexeme is None else by_lexeme.get(block.lexeme), alternatives=tuple(
        replace(choice, name=by_lexeme.get(choice.lexeme, "")) for choice in block.alternatives))
        for block in plan.blocks]
    return replace(plan, blocks=tuple(blocks), lexicon=names,
                   gestures=tuple(GestureName(name, about) for name, about in GESTURES.items()))


def words_of(speech: Speech) -> tuple[PlanWord, ...]:
    """The words of a speech, as a plan stores them."""
    return tuple(PlanWord(word.text, word.start, word.end) for word in speech.words or () if word.text.strip())


def units_of_blocks(blocks: Sequence[BlockMotion]) -> tuple[GestureUnit, ...]:
    """The units of a performance, in order: from one rest to the next. () without a planner."""
    groups = groupby(blocks, lambda block: block.unit is not None and bool(block.unit.phase))
    return tuple(_unit(list(group)) for moves, group in groups if moves)


def _unit(blocks: Sequence[BlockMotion]) -> GestureUnit:
    from interpreters.planner import HANDS, PHASES

    decisions = [block.unit for block in blocks if block.unit is not None]
    phases: list[GesturePhase] = []
    struck = False
    for block, decision in zip(blocks, decisions, strict=True):
        # Equal phases of neighbouring blocks are one phase; a hold is named by the stroke that it precedes or follows.
        kind = PHASES[decision.phase]
        struck = struck or kind == "stroke"
        if kind == "hold":
            kind = "post-stroke hold" if struck else "pre-stroke hold"
        start = phases.pop().start if phases and phases[-1].kind == kind else block.block.start
        phases.append(GesturePhase(cast(PhaseKind, kind), start, block.block.end))
    # A unit may change hands: the one that makes most of its blocks names it.
    hands = [decision.hand for decision in decisions if decision.hand]
    hand = cast(Hand, HANDS[max(set(hands), key=hands.count)]) if hands else None
    sizes = [_SIZES[decision.size] for decision in decisions if decision.size]
    size = round(sum(sizes) / len(sizes), 2) if sizes else 1.0
    return GestureUnit(blocks[0].block.start, blocks[-1].block.end, tuple(phases), hand, size)
