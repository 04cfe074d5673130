"""The plan of a performance: its blocks, what was considered for each, and everything needed to render it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from gesticulator.plan.plan import (
    FORMAT,
    GESTURES,
    VERSION,
    Block,
    DrawnBlocks,
    GestureName,
    GesturePlan,
    LexemeName,
    PlanSound,
    PlanWord,
    sound_hash,
)

if TYPE_CHECKING:
    from data_module.types import Blocks, Speech
    from gesticulator.drawing.rollout import BlockMotion
    from gesticulator.options import InferenceOptions

_ABOVE = ("seed", "variation", "speaker", "interpreter", "activity")
"""Settings that stand elsewhere in a plan."""
_GESTURES = tuple(GestureName(name, about) for name, about in GESTURES.items())


@dataclass(frozen=True)
class Origin:
    """What made a performance. options: with nothing left to the bundle; program: the version and the bundle, in plain
    values; settings: everything that the generation depends on; score_is: what the scores are."""

    options: InferenceOptions
    program: Mapping[str, Any]
    settings: Mapping[str, Any]
    score_is: str


def plan_of(speech: Speech, cut: Blocks, blocks: Sequence[BlockMotion], origin: Origin) -> GesturePlan:
    """The plan of a first drawing. cut: the N blocks of the speech. Lexemes have no names yet (`named`)."""
    settings, decisions = origin.settings, tuple(block.block for block in blocks)
    drawn = DrawnBlocks(tuple(cut.edges.tolist()), tuple(block.flag for block in decisions),
                        tuple(block.silent for block in decisions), tuple(block.lexeme for block in blocks),
                        origin.options.knobs)
    made_by = {**origin.program, "settings": {key: value for key, value in settings.items() if key not in _ABOVE}}
    return GesturePlan(
        FORMAT, VERSION, made_by, PlanSound("", speech.duration, speech.sample_rate, sound_hash(speech)),
        int(settings["seed"]), int(settings["variation"]), str(settings["speaker"]), str(settings["interpreter"]),
        drawn, decisions, drawn.knobs, tuple(origin.options.cues), _words(speech), (), _GESTURES, origin.score_is)


def rendered_plan(plan: GesturePlan, speech: Speech, blocks: Sequence[BlockMotion], origin: Origin) -> GesturePlan:
    """The plan that was rendered, with what the models chose in its edited blocks. Parts that did not change are the
    same objects, so that a page is sent only what did."""
    # The sound was compared with the plan's before it was rendered (`directions.check_plan_of`).
    sound, words = PlanSound("", speech.duration, speech.sample_rate, plan.sound.sha256), _words(speech)
    return replace(plan, sound=sound, blocks=tuple(_rendered(block, made) for block, made
                                                   in zip(plan.blocks, blocks, strict=True)),
                   words=plan.words if words == plan.words else words, gestures=_GESTURES, score_is=origin.score_is,
                   source=None)


def _rendered(block: Block, made: BlockMotion) -> Block:
    """A planned block with what was decided when it was drawn; itself where it says so already."""
    now, choices = made.block, block.alternatives
    rows = [(one.lexeme, one.score, one.prior, one.advantage) for one in now.alternatives]
    if [(one.lexeme, one.score, one.prior, one.advantage) for one in choices] != rows:
        choices = now.alternatives
    lexeme = made.lexeme if block.lexeme is None else block.lexeme
    before = (block.lexeme, block.gate, block.chosen, block.runner_up)
    if choices is block.alternatives and before == (lexeme, now.gate, now.chosen, now.runner_up):
        return block
    return replace(block, lexeme=lexeme, gate=now.gate, alternatives=choices, chosen=now.chosen,
                   runner_up=now.runner_up)


def named(plan: GesturePlan, names: tuple[LexemeName, ...]) -> GesturePlan:
    """The plan with the names of lexemes; blocks that have them already are the same objects."""
    called = {one.lexeme: one.name for one in names}
    blocks = []
    for block in plan.blocks:
        name, choices = called.get(block.lexeme) if block.lexeme is not None else None, block.alternatives
        for one in choices:
            if one.name != called.get(one.lexeme, ""):
                choices = tuple([replace(one, name=called.get(one.lexeme, "")) for one in choices])
                break
        same = name == block.name and choices is block.alternatives
        blocks.append(block if same else replace(block, name=name, alternatives=choices))
    return replace(plan, blocks=tuple(blocks), lexicon=names)


def _words(speech: Speech) -> tuple[PlanWord, ...]:
    return tuple(PlanWord(word.text, word.start, word.end) for word in speech.words or () if word.text.strip())
