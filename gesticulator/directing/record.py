"""The plan of a performance: its blocks, what was considered for each, and all that is needed to render it again."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from data_module.types import BeatFlag
from gesticulator.directing.directions import knobs_of
from gesticulator.plan.plan import (
    GESTURES,
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
from gesticulator.plan.upgrade import FORMAT, VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from data_module.types import Blocks, Speech
    from gesticulator.drawing.rollout import LexemeWorth
    from gesticulator.options import InferenceOptions
    from gesticulator.plan.plan import LexemeName

_ABOVE = ("seed", "variation", "speaker", "interpreter", "activity")
"""Settings that stand elsewhere in a plan."""
_GESTURES = tuple(GestureName(name, about) for name, about in GESTURES.items())


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
    options, speech = performance.options, performance.speech
    names = () if performance.names is None else performance.names()
    called = {one.lexeme: one.name for one in names}
    # A file's name may hold bytes that are no text.
    sound_name = performance.sound_name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    words = tuple(PlanWord(word.text, word.start, word.end) for word in speech.words or () if word.text.strip())
    rendered = None if options is None else options.plan
    if rendered is not None:
        # The sound was compared with the plan's before it was rendered (`directions.check_plan_of`).
        sound = PlanSound(sound_name, speech.duration, speech.sample_rate, rendered.sound.sha256)
        return replace(rendered, sound=sound, blocks=_rendered_blocks(performance, rendered.blocks, called),
                       words=rendered.words if words == rendered.words else words, lexicon=names,
                       gestures=_GESTURES, score_is=performance.score_is, source=None)
    settings = performance.made_by.get("settings", {})
    seed, variation = int(settings.get("seed", 0)), int(settings.get("variation", 0))
    blocks = _first_blocks(performance, called, BlockDraw(seed, variation, 0))
    drawn = DrawnBlocks(
        tuple(performance.blocks.edges.tolist()), tuple(block.flag for block in blocks),
        tuple(block.silent for block in blocks), tuple(performance.lexemes.tolist()),
        PlanKnobs() if options is None else knobs_of(options))
    return GesturePlan(
        FORMAT, VERSION, {**{key: value for key, value in performance.made_by.items() if key != "settings"},
                          "settings": {key: value for key, value in settings.items() if key not in _ABOVE}},
        PlanSound(sound_name, speech.duration, speech.sample_rate, sound_hash(speech)),
        seed, variation, str(settings.get("speaker", "")), str(settings.get("interpreter", "")), drawn, blocks,
        drawn.knobs, () if options is None else tuple(cue for cue in options.cues), words, names, _GESTURES,
        performance.score_is, performance.notes)


def _first_blocks(performance: Performed, called: dict[int, str], draw: BlockDraw) -> tuple[PlanBlock, ...]:
    """The blocks of a first drawing. called: lexeme -> its name."""
    edges, considered = performance.blocks.edges.tolist(), _Considered(performance, called)
    lexemes, silent = performance.lexemes.tolist(), performance.blocks.silent.tolist()
    out = []
    for i, played in enumerate(lexemes):
        flag = BeatFlag(int(performance.blocks.flags[i])).name.lower()
        gate, alternatives, chosen, runner_up = considered.of(i)
        out.append(PlanBlock(edges[i], edges[i + 1], played, silent[i], replace(draw, block=i), flag,
                             called.get(played), gate=gate, alternatives=alternatives, chosen=chosen,
                             runner_up=runner_up))
    return tuple(out)


def _rendered_blocks(performance: Performed, blocks: tuple[PlanBlock, ...], called: dict[int, str]
                     ) -> tuple[PlanBlock, ...]:
    """The blocks of the plan that was rendered, with what was chosen since; those that say it already are left."""
    considered, out = _Considered(performance, called), []
    for i, (block, played) in enumerate(zip(blocks, performance.lexemes.tolist(), strict=True)):
        lexeme = played if block.lexeme is None else block.lexeme
        name = called.get(lexeme)
        now = considered.of(i, block.alternatives)
        before = (block.gate, block.alternatives, block.chosen, block.runner_up)
        if (lexeme, name, now) != (block.lexeme, block.name, before):
            gate, alternatives, chosen, runner_up = now
            block = replace(block, lexeme=lexeme, name=name, gate=gate, alternatives=alternatives, chosen=chosen,
                            runner_up=runner_up)
        out.append(block)
    return tuple(out)


class _Considered:
    """What was considered for each of the N blocks of a performance."""

    def __init__(self, performance: Performed, called: dict[int, str]) -> None:
        worth, self._called = performance.weighed, called
        count = len(performance.blocks)
        gates = np.full(count, np.nan) if performance.gate is None else performance.gate
        self._gates: list[float | None] = [None if gate != gate else gate for gate in gates.tolist()]
        # Plain numbers: a plan of an hour has 50,000 candidates.
        self._best, self._scores = performance.best.tolist(), performance.scores.tolist()
        self._lexemes = performance.lexemes.tolist()
        self._worth = None if worth is None else (worth.prior.tolist(), worth.advantage.tolist())

    def of(self, block: int, before: tuple[LexemeChoice, ...] = ()
           ) -> tuple[float | None, tuple[LexemeChoice, ...], dict[str, float] | None, dict[str, float] | None]:
        """The gate's probability, the alternatives, what the played lexeme is worth, and the best other one.

        before: alternatives that are given back where they are the same.
        """
        called, best, scores = self._called, self._best[block], self._scores[block]
        names = [called.get(lexeme, "") for lexeme in best]
        prior: list[float | None] = [None] * len(best)
        advantage, chosen, runner_up = prior, None, None
        if self._worth is not None:
            prior, advantage = self._worth[0][block], self._worth[1][block]
            chosen = {"prior": prior[-1], "advantage": advantage[-1]}
            other = next((place for place, one in enumerate(best) if one != self._lexemes[block]), 0)
            runner_up = {"id": best[other], "worth_more": advantage[other] - advantage[-1]}
        rows = list(zip(best, names, scores, prior, advantage, strict=False))
        if [(one.lexeme, one.name, one.score, one.prior, one.advantage) for one in before] != rows:
            before = tuple(LexemeChoice(*row) for row in rows)
        return self._gates[block], before, chosen, runner_up
