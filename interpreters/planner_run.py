"""What the planner of gesture units decides for a block, the dimensions of a unit's style, and the runners of both
(`interpreters.planner`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from data_module.layers_run import BlockDense, Floats, Gru, Tensors
from interpreters.base import BlockFeatures, Scores
from interpreters.settings import PlannerConfig, StyleConfig

__all__ = ["APEXES", "CLASSES", "CODE", "HANDS", "PHASES", "SIZES", "PlannerRunner", "UnitDecision", "UnitStyleRunner"]

PHASES = ("rest", "preparation", "stroke", "hold", "retraction")
HANDS = ("none", "left", "right", "both")
"""The hands that are not at rest."""
SIZES = ("none", "small", "medium", "large")
"""Size of the stroke that the block prepares or makes; "none" in other phases."""
APEXES = ("none", "now", "next", "later")
"""Whether the apex of that stroke lies in this block, in the next one, or later."""
CLASSES = (len(PHASES), len(HANDS), len(SIZES), len(APEXES))
CODE = ("speed", "range", "height", "reach")
"""The dimensions of a style code."""

LEAST_HOLD = 0.6
"""Shortest hold, seconds."""
_MOST = 2.5
"""Largest value of a style code."""
_NO_HOLD = np.array(PHASES) != "hold"


@dataclass(frozen=True)
class UnitDecision:
    """The decision for one block, as indices into `PHASES`, `HANDS`, `SIZES` and `APEXES`."""

    phase: int
    hand: int
    size: int
    apex: int

    @property
    def rests(self) -> bool:
        return PHASES[self.phase] == "rest"

    def begins_after(self, before: UnitDecision | None) -> bool:
        """Whether the hands set out here: to prepare a stroke, or to make one that was not prepared. before: the
        decision for the block before."""
        phase, last = PHASES[self.phase], "rest" if before is None else PHASES[before.phase]
        return phase != last and (phase == "preparation" or (phase == "stroke" and last != "preparation"))

    def follows(self, before: UnitDecision | None) -> bool:
        """Whether a stroke begins here right after the apex of another. before: the decision for the block before."""
        return before is not None and PHASES[self.phase] == PHASES[before.phase] == "stroke" \
            and APEXES[before.apex] == "now"

    @property
    def row(self) -> NDArray[np.float32]:
        """[U] the four decisions, each one-hot, side by side."""
        decided = (self.phase, self.hand, self.size, self.apex)
        return np.concatenate([np.eye(count, dtype=np.float32)[choice]
                               for choice, count in zip(decided, CLASSES, strict=True)])

    @property
    def holds(self) -> bool:
        return PHASES[self.phase] == "hold"


@dataclass(frozen=True)
class PlannerState:
    """hidden: of the GRU; speaker: [P] one-hot; last: the decision before, by index; held: seconds for which the hands
    have been held."""

    hidden: Floats | None
    speaker: Floats
    last: tuple[int, ...]
    held: float = 0.0


class PlannerRunner:
    """Three blocks of low-level audio, the speaker and the decision before to the next decision: `UnitPlanner`."""

    def __init__(self, config: PlannerConfig, frames: int, audio_width: int, speakers: int, lexemes: int,
                 tensors: Tensors) -> None:
        """Arguments as of `UnitPlanner`."""
        self._speakers, embedding = speakers, config.embedding
        self._encode_audio = BlockDense(tensors.within("encode_audio"), frames, audio_width, config.audio_features,
                                        bottleneck=config.audio_bottleneck)
        self._past = [tensors.take(f"past.{level}.weight", count + 1, embedding) for level, count in enumerate(CLASSES)]
        self._given = [tensors.take(f"given.{level}.weight", count, embedding)
                       for level, count in enumerate(CLASSES[:-1])]
        self._gru = Gru(tensors.within("gru"), frames * config.audio_features + len(CLASSES) * embedding + speakers,
                        config.width)
        self._heads = [tensors.dense(f"heads.{level}", config.width + level * embedding, count)
                       for level, count in enumerate(CLASSES)]
        self._fit = tensors.take("fit", lexemes, len(PHASES) * len(HANDS)).astype(np.float64)

    def start(self, speaker: int) -> PlannerState:
        """Before the first block."""
        # The row of a missing past, which follows the classes, stands before the first block.
        return PlannerState(None, np.eye(self._speakers, dtype=np.float32)[speaker], CLASSES)

    def step(self, state: PlannerState, features: BlockFeatures, noise: Scores, temperature: float = 1.0,
             bias: Scores | None = None) -> tuple[UnitDecision, PlannerState]:
        """The decision for the next block: arg max of logits / temperature + Gumbel noise, which is a sample; the
        likeliest at temperature 0. noise: [sum of `CLASSES`] standard Gumbel numbers. bias: [5] added to the logits of
        the phases, that of a hold only after a stroke or a hold, where hands are up. A hold lasts at least `LEAST_HOLD`
        seconds: a hand takes half of that to stop, so a shorter one is not visible."""
        past = [table[choice] for table, choice in zip(self._past, state.last, strict=True)]
        row = np.concatenate([self._encode_audio(features.low).ravel(), *past, state.speaker])
        out, hidden = self._gru(row[None, None], state.hidden)
        seconds = 0.0 if features.durations is None else features.durations[1]
        # The GRU has read this block's audio all the same, so its state is that of training.
        if 0.0 < state.held < LEAST_HOLD:
            return UnitDecision(*state.last), replace(state, hidden=hidden, held=state.held + seconds)
        raised = state.last[0] < len(PHASES) and PHASES[state.last[0]] in ("stroke", "hold")
        context, decided = out[0, 0], list[int]()
        for level, (last, count) in enumerate(zip(accumulate(CLASSES), CLASSES, strict=True)):
            each = noise[last - count:last]
            scores = self._heads[level](context).astype(np.float64)
            if level == 0 and bias is not None:
                scores += np.where(raised | _NO_HOLD, bias, 0.0)
            if temperature > 0:
                # The Gumbel-max trick: the arg max is a sample of the softmax, decided by the given noise alone.
                scores = scores / temperature + each
            decided.append(int(scores.argmax()))
            if level < len(self._given):
                context = np.concatenate([context, self._given[level][decided[level]]])
        decision = UnitDecision(*decided)
        held = state.held + seconds if decision.holds else 0.0
        return decision, PlannerState(hidden, state.speaker, tuple(decided), held)

    def bias(self, decision: UnitDecision) -> Scores:
        """[S] what the phase and the hand add to the scores of the lexemes: log p(phase, hand | lexeme)."""
        return self._fit[:, decision.phase * len(HANDS) + decision.hand]


@dataclass(frozen=True)
class UnitStyleState:
    """hidden: of the GRU; speaker: [P] one-hot; total: [d_z] sum of the predictions of this unit's blocks so far, and
    their number."""

    hidden: Floats | None
    speaker: Floats
    total: Floats
    count: int


class UnitStyleRunner:
    """Three blocks of low-level audio and the speaker to the style code of the gesture unit: `UnitStyleInterpreter`."""

    def __init__(self, config: StyleConfig, frames: int, audio_width: int, speakers: int, code_width: int,
                 tensors: Tensors) -> None:
        """Arguments as of `UnitStyleInterpreter`."""
        self._config, self._speakers = config, speakers
        self._encode_audio = BlockDense(tensors.within("encode_audio"), frames, audio_width, config.audio_features,
                                        bottleneck=config.audio_bottleneck)
        self._gru = Gru(tensors.within("gru"), frames * config.audio_features
                        + (speakers if config.use_speaker else 0), config.width)
        self._to_code = tensors.dense("to_code", config.width, code_width)
        self._gain = tensors.take("gain", code_width)

    def start(self, speaker: int) -> UnitStyleState:
        """Before the first block."""
        return UnitStyleState(None, np.eye(self._speakers, dtype=np.float32)[speaker], np.zeros_like(self._gain), 0)

    def step(self, state: UnitStyleState, features: BlockFeatures, resting: bool = False
             ) -> tuple[Floats, UnitStyleState]:
        """The code [d_z] of the next block's unit, and the state after it; resting: the block belongs to no unit, so
        the next unit starts anew and the code is 0."""
        rows = [self._encode_audio(features.low).ravel(), *([state.speaker] if self._config.use_speaker else [])]
        out, hidden = self._gru(np.concatenate(rows)[None, None], state.hidden)
        if resting:
            # The GRU goes on through rests: it measures the voice, not the unit.
            nothing = np.zeros_like(self._gain)
            return nothing, UnitStyleState(hidden, state.speaker, nothing, 0)
        # The mean over the unit so far: the style of a unit becomes clearer while it lasts.
        total, count = state.total + self._to_code(out[0, 0]), state.count + 1
        code: Floats = np.clip(self._gain * total / np.float32(count), -_MOST, _MOST).astype(np.float32)
        return code, UnitStyleState(hidden, state.speaker, total, count)
