"""The plan of a performance: its blocks, what was considered for each, and all that is needed to render it again."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from data_module.types import BeatFlag
from gesticulator.directing.directions import knobs_of
from gesticulator.plan.plan import (
    FORMAT,
    GESTURES,
    VERSION,
    BlockDraw,
    DrawnBlocks,
    GestureName,
    GesturePlan,
    LexemeChoice,
    PlanBlock,
    PlanKnobs,
    PlanSound,
    PlanWord,
    sound_hash,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from data_module.types import Blocks, Speech
    from gesticulator.drawing.rollout import LexemeWorth
    from gesticulator.options import InferenceOptions
    from gesticulator.plan.plan import LexemeName

_ABOVE = ("seed", "variation", "speaker", "interpreter", "activity")
"""Settings that stand elsewhere in a plan."""


class Performed(Protocol):
    """What of a performance its plan is made of; see `gesticulator.performance.Performance`."""

    @property
    def speech(self) -> Speech: ...
    @property
    def blocks(self) -> Blocks: ...
    @property
    def lexemes(self) -> NDArray[np.int64]: ...
    @property
    def best(self) -> NDArray[np.int64]: ...
    @property
    def scores(self) -> NDArray[np.float64]: ...
    @property
    def gate(self) -> NDArray[np.float64] | None: ...
    @property
    def weighed(self) -> LexemeWorth | None: ...
    @property
    def made_by(self) -> Mapping[str, Any]: ...
    @property
    def options(self) -> InferenceOptions | None: ...
    @property
    def names(self) -> Callable[[], tuple[LexemeName, ...]] | None: ...
    @property
    def sound_name(self) -> str: ...
    @property
    def score_is(self) -> str: ...
    @property
    def notes(self) -> tuple[str, ...]: ...


def plan_of(performance: Performed) -> GesturePlan:
    """What was decided. Of a performance that was rendered from a plan: that plan, with what was chosen since."""
    options = performance.options
    rendered = None if options is None else options.plan
    names = () if performance.names is None else performance.names()
    called = {one.lexeme: one.name for one in names}
    settings = performance.made_by.get("settings", {})
    seed, variation = int(settings.get("seed", 0)), int(settings.get("variation", 0))
    if rendered is not None:
        seed, variation = rendered.seed, rendered.variation
    blocks = _blocks(performance, called, BlockDraw(seed, variation, 0))
    speech = performance.speech
    # A file's name may hold bytes that are no text.
    sound_name = performance.sound_name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    drawn = DrawnBlocks(
        tuple(performance.blocks.edges.tolist()), tuple(block.flag for block in blocks),
        tuple(block.silent for block in blocks), tuple(performance.lexemes.tolist()),
        PlanKnobs() if options is None else knobs_of(options))
    plan = GesturePlan(
        FORMAT, VERSION, {**{key: value for key, value in performance.made_by.items() if key != "settings"},
                          "settings": {key: value for key, value in settings.items() if key not in _ABOVE}},
        PlanSound(sound_name, speech.duration, speech.sample_rate, sound_hash(speech)),
        seed, variation, str(settings.get("speaker", "")), str(settings.get("interpreter", "")), drawn, blocks,
        drawn.knobs, () if options is None else tuple(cue for cue in options.cues),
        tuple(PlanWord(word.text, word.start, word.end) for word in speech.words or () if word.text.strip()),
        names, tuple(GestureName(name, about) for name, about in GESTURES.items()), performance.score_is,
        performance.notes)
    if rendered is None:
        return plan
    kept = []
    for block, now, played in zip(rendered.blocks, blocks, performance.lexemes.tolist(), strict=True):
        lexeme = played if block.lexeme is None else block.lexeme
        kept.append(replace(now, start=block.start, end=block.end, silent=block.silent, flag=block.flag,
                            draw=block.draw, locked=block.locked, intensity=block.intensity, mirror=block.mirror,
                            lexeme=lexeme, name=called.get(lexeme)))
    return replace(plan, drawn=rendered.drawn, blocks=tuple(kept), knobs=rendered.knobs, cues=rendered.cues,
                   made_by=rendered.made_by, notes=rendered.notes)


def _blocks(performance: Performed, called: dict[int, str], draw: BlockDraw) -> tuple[PlanBlock, ...]:
    edges, worth = performance.blocks.edges.tolist(), performance.weighed
    count = len(performance.blocks)
    gates = np.full(count, np.nan) if performance.gate is None else performance.gate
    out = []
    for i in range(count):
        best, played = performance.best[i], int(performance.lexemes[i])
        alternatives = tuple(LexemeChoice(int(lexeme), called.get(int(lexeme), ""), float(score),
                                          **({} if worth is None else worth.entry(i, place)))
                             for place, (lexeme, score) in enumerate(zip(best, performance.scores[i], strict=True)))
        out.append(PlanBlock(
            edges[i], edges[i + 1], played, bool(performance.blocks.silent[i]), replace(draw, block=i),
            BeatFlag(int(performance.blocks.flags[i])).name.lower(), called.get(played),
            gate=None if np.isnan(gates[i]) else float(gates[i]), alternatives=alternatives,
            chosen=None if worth is None else worth.entry(i, -1),
            runner_up=None if worth is None else worth.runner_up(best, played, i)))
    return tuple(out)
