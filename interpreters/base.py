"""The protocol of lexeme interpreters, its defaults, their pose input, guidance by the audio, and the selection of a
lexeme from scores.

`Interpreter` is the full interface that the product uses. An object with `start` and `step` (`LexemeInterpreter`) is
sufficient: `as_interpreter` adds the defaults. Classes in this package derive from `InterpreterDefaults`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from data_module.layers_run import Floats

__all__ = [
    "BlockFeatures",
    "Interpreter",
    "InterpreterByEar",
    "InterpreterDefaults",
    "InterpreterParts",
    "InterpreterSizes",
    "LexemeInterpreter",
    "Scores",
    "as_interpreter",
    "pose_of",
    "select",
]

Scores = NDArray[np.float64]
Need = Literal["text", "pose", "control", "durations"]
"""Optional inputs besides the audio: `BlockFeatures.text`, `past`, `control` and `durations`."""
EVERY_NEED: frozenset[Need] = frozenset(("text", "pose", "control", "durations"))


@dataclass(frozen=True)
class BlockFeatures:
    """The input features of one block, arrays in single precision.

    low, high: [3K, d] the two levels of audio on the window of the previous, current and next block. silent: the block
    is silent. text: [3K, d_t + 1] word vectors and the flag of the empty word on the same window, or None in the
    audio-only path. control: [K, 2 F] target values of F style features and flags of those that are set, or None.
    past: [K, D_m] the previous block as it was generated, normalised, or None if unknown. durations: seconds of the
    previous and the current block, or None.
    """

    low: Floats
    high: Floats
    silent: bool = False
    text: Floats | None = None
    control: Floats | None = None
    past: Floats | None = None
    durations: tuple[float, float] | None = None


@runtime_checkable
class LexemeInterpreter(Protocol):
    """The minimal interface of an interpreter: scores for the next lexeme, block by block."""

    def start(self, speaker: int, first_lexeme: int) -> Any:
        """The state before the first block, for a speaker (index) whose resting lexeme is `first_lexeme`."""
        ...

    def step(self, state: Any, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, Any]:
        """Scores [S] for this block's lexeme given the history, and the state after it. Scores are natural logarithms
        of probabilities, or Q values if `gives_values`. The given state must not be changed."""
        ...


@runtime_checkable
class Interpreter(LexemeInterpreter, Protocol):
    """The full interface of an interpreter; `InterpreterDefaults` has a default for everything but start and step."""

    @property
    def name(self) -> str:
        ...

    @property
    def gives_values(self) -> bool:
        """Scores are Q values, not log-probabilities."""
        ...

    @property
    def needs(self) -> frozenset[Need]:
        """The inputs that it uses besides the audio; other fields of `BlockFeatures` have no effect."""
        ...

    def guided(self, guidance: float) -> Interpreter:
        """The same with scores s + guidance (s - s without audio); itself if it was not trained without audio."""
        ...


class InterpreterDefaults:
    """Defaults of `Interpreter`: log-probabilities, no guidance."""

    name: str = ""
    gives_values: bool = False

    @property
    def needs(self) -> frozenset[Need]:
        return EVERY_NEED

    def guided(self, guidance: float) -> Any:
        return self

    @classmethod
    def open(cls, parts: InterpreterParts) -> Any:
        """The interpreter of a bundle: the part as it is played, or without one an instance made from the counts."""
        return parts.model if parts.model is not None else cls(parts.frequencies, parts.transitions)  # type: ignore[call-arg]


class _Adapted(InterpreterDefaults):
    """Adapter of an object with `start` and `step`, with the defaults for the rest; named after its class."""

    def __init__(self, inner: LexemeInterpreter) -> None:
        self.inner, self.name = inner, type(inner).__name__

    def start(self, speaker: int, first_lexeme: int) -> Any:
        return self.inner.start(speaker, first_lexeme)

    def step(self, state: Any, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, Any]:
        return self.inner.step(state, features, previous_lexeme)


def opened(kind: Any, parts: InterpreterParts) -> Interpreter:
    # A class with `start` and `step` alone has no weights.
    derived = isinstance(kind, type) and issubclass(kind, InterpreterDefaults)
    return as_interpreter(kind.open(parts) if derived else kind(parts.frequencies, parts.transitions))


_OPTIONAL = frozenset(("gives_values", "needs", "guided", "explain"))


def as_interpreter(given: object) -> Interpreter:
    """Any object with `start` and `step` as an `Interpreter`; itself if it is one already. InputError for an object
    without them, and for one with some but not all of the optional members, because they would be ignored."""
    if isinstance(given, Interpreter):
        return given
    kind = type(given).__name__
    if not isinstance(given, LexemeInterpreter):
        raise InputError(f"interpreter {kind}", "has no start and step", "see interpreters.base.LexemeInterpreter")
    # A class with `needs` but without `guided`, say, would silently lose what it has.
    partly = sorted(_OPTIONAL & set(dir(given)))
    if partly:
        raise InputError(f"interpreter {kind}", f"has {', '.join(partly)} but not all of the protocol",
                         "derive it from interpreters.base.InterpreterDefaults")
    return _Adapted(given)


@dataclass(frozen=True)
class InterpreterSizes:
    """The sizes of an interpreter's weights that depend on the data. frames: K; low, high: widths d + 1 of the two
    levels of audio; speakers: P; text: d_t + 1, 0 without words; control: 2 F; motion: D_m; lexemes: [S, D_s] the
    codebook; silent: the silent lexemes."""

    frames: int
    low: int
    high: int
    speakers: int
    text: int
    control: int
    motion: int
    lexemes: Floats
    silent: Sequence[int] = ()


@dataclass(frozen=True)
class InterpreterParts:
    """The parts of a bundle from which an interpreter is opened (`InterpreterDefaults.open`).

    model: the part as it is played, None without weights; frequencies: [speakers, S] and transitions: [S, S], counted
    on the training split; settings: the group named by the entry's section.
    """

    model: Any
    frequencies: NDArray[np.float64]
    transitions: NDArray[np.float64]
    settings: Any


def select(scores: Scores, *, allowed: NDArray[np.int64] | None = None, temperature: float = 0.0,
           top: int | None = None, rng: np.random.Generator | None = None, noise: Scores | None = None) -> int:
    """One lexeme from scores [S]: the best (temperature 0), or a sample of softmax(scores / temperature). allowed:
    indices to choose from (the silent mask); None or empty allows all. top: sample from the best `top` only. noise: [S]
    standard Gumbel numbers, in place of a generator: the sample is the arg max of scores / temperature + noise."""
    if temperature < 0 or (top is not None and top < 1):
        raise ValueError("temperature must not be negative and top must be positive")
    masked = np.array(scores, dtype=np.float64)
    if allowed is not None and len(allowed):
        blocked = np.ones(len(masked), dtype=bool)
        blocked[allowed] = False
        masked[blocked] = -np.inf
    if temperature == 0 or (rng is None and noise is None):
        return int(np.argmax(masked))
    if top is not None and top < len(masked):
        # Scores equal to the last of the best stay in, whatever their number: none of them is better.
        masked[masked < np.sort(masked)[-top]] = -np.inf
    if noise is not None:
        # The Gumbel-max trick: a sample of the softmax, reproducible block by block from the given noise.
        return int(np.argmax(masked / temperature + noise))
    assert rng is not None
    # The largest exponent is 0, so that exp cannot overflow.
    weights = np.exp((masked - masked.max()) / temperature)
    return int(rng.choice(len(weights), p=weights / weights.sum()))


FRAMES = 3
"""Frames of a block needed for an acceleration."""


def pose_of(past: Any, durations: Any = None) -> tuple[Any, Any, Any]:
    """The last pose of the previous block, its velocity and its acceleration, [..., D_m] each, in the time of this
    block; arrays or tensors.

    past: [..., K, D_m] normalised features of the previous block; durations: seconds of the previous and this block,
    [...] each, equal if None. Every block has K frames, so with the ratio r = this / previous

        v = K r (x_K - x_{K-1}),    a = K r^2 (x_K - 2 x_{K-1} + x_{K-2}):

    v is the displacement over this block at that speed, a the change of v per frame, both in normalised units.
    ValueError for a block of fewer than three frames.
    """
    frames = past.shape[-2]
    if frames < FRAMES:
        raise ValueError(f"a velocity and an acceleration take {FRAMES} frames, and blocks here have {frames}")
    earlier, before, last = past[..., -3, :], past[..., -2, :], past[..., -1, :]
    ratio = 1.0 if durations is None else durations[1] / durations[0]
    return last, frames * ratio * (last - before), frames * ratio ** 2 * (last - 2 * before + earlier)


class HearsOrNot(Interpreter, Protocol):
    """An interpreter that was trained with audio dropout."""

    def step_with_and_without_sound(self, states: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
                                    ) -> list[tuple[Scores, Any]]:
        """The result of `step` for the first state, and for the second with zeros as audio."""
        ...


@dataclass(frozen=True)
class InterpreterByEar(InterpreterDefaults):
    """Classifier-free guidance by the audio: s + g (s - s without audio), normalised, for scores s that are
    log-probabilities. inner: the guided interpreter; guidance: g."""

    inner: HearsOrNot
    guidance: float

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.inner.name

    @property
    def needs(self) -> frozenset[Need]:
        return self.inner.needs

    def start(self, speaker: int, first_lexeme: int) -> tuple[Any, Any]:
        return self.inner.start(speaker, first_lexeme), self.inner.start(speaker, first_lexeme)

    def step(self, state: tuple[Any, Any], features: BlockFeatures, previous_lexeme: int
             ) -> tuple[Scores, tuple[Any, Any]]:
        (guided, with_audio), (unguided, without) = self.inner.step_with_and_without_sound(state, features,
                                                                                           previous_lexeme)
        # Both states take the same previous lexeme, the one that was chosen from the guided scores.
        scores = guided + self.guidance * (guided - unguided)
        # Extrapolated log-probabilities do not sum to 1 any more.
        return scores - np.logaddexp.reduce(scores), (with_audio, without)
