"""The protocol of lexeme interpreters, its defaults, and the one place where a lexeme is chosen from scores.

`Interpreter` is everything that the product asks of one. An object with `start` and `step` alone (`LexemeInterpreter`)
is enough to play: `as_interpreter` answers the rest for it. A class of our own derives from `InterpreterDefaults` and
overrides what differs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import nn

__all__ = ["BlockFeatures", "Explanation", "Interpreter", "InterpreterDefaults", "InterpreterParts", "InterpreterSizes",
           "LexemeInterpreter", "Scores", "as_interpreter", "select"]

Scores = NDArray[np.float64]
Need = Literal["text", "pose", "control", "durations"]
"""What an interpreter may read beside the sound: `BlockFeatures.text`, `past`, `control` and `durations`."""
EVERY_NEED: frozenset[Need] = frozenset(("text", "pose", "control", "durations"))


@dataclass(frozen=True)
class BlockFeatures:
    """What an interpreter hears of one block.

    low, high: [3K, d] the two levels of audio on the window of the block before, the block and the block after.
    silent: the block is a silence. text: [3K, d_t + 1] word vectors and the flag of the empty word on the same window,
    or None in the audio-only path. control: [K, 2 F] what is asked of F features of style and whether it is asked, or
    None when nothing is. past: [K, D_m] the block before as it was drawn, normalised, or None where nobody says.
    durations: seconds of the block before and of this one, or None.
    """

    low: Tensor
    high: Tensor
    silent: bool = False
    text: Tensor | None = None
    control: Tensor | None = None
    past: Tensor | None = None
    durations: tuple[float, float] | None = None


@runtime_checkable
class LexemeInterpreter(Protocol):
    """The least that an interpreter must have: scores for the next lexeme, block by block."""

    def start(self, speaker: int, first_lexeme: int) -> Any:
        """The state before the first block, for a speaker (index) whose resting lexeme is `first_lexeme`."""
        ...

    def step(self, state: Any, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, Any]:
        """Scores [S] for this block's lexeme given what went before, and the state after it.

        Scores are natural logarithms of probabilities, or Q values where `gives_values` says so. The state that is
        given must not change.
        """
        ...


@dataclass(frozen=True)
class Explanation:
    """Why an interpreter scored the last block as it did. log_prior: [S] ln of how likely the behaviour policy makes
    each lexeme; advantage: [S] how much more than its mean a reward expects of each, in standard deviations."""

    log_prior: NDArray[np.float64]
    advantage: NDArray[np.float64]


@runtime_checkable
class Interpreter(LexemeInterpreter, Protocol):
    """All that the product asks of an interpreter; `InterpreterDefaults` answers for those without anything special."""

    @property
    def name(self) -> str:
        """What a plan calls it."""
        ...

    @property
    def gives_values(self) -> bool:
        """Scores are Q values, not log-probabilities."""
        ...

    @property
    def steerable(self) -> bool:
        """It takes a beta (`steered`)."""
        ...

    @property
    def beta(self) -> float | None:
        """How far its choice is drawn to a learned reward; None where it is not steerable."""
        ...

    @property
    def needs(self) -> frozenset[Need]:
        """What it reads beside the sound; the rest of `BlockFeatures` changes nothing."""
        ...

    def steered(self, beta: float | None, temperature: float) -> Interpreter:
        """The same with this beta (None: as it is), for lexemes that are sampled at this temperature."""
        ...

    def guided(self, guidance: float) -> Interpreter:
        """With scores taken further from those without sound, s + guidance (s - s without sound); itself where it was
        not taught to do without sound."""
        ...

    def explain(self, state: Any) -> Explanation | None:
        """Why it scored the block before `state` as it did; None where it has no more to say than the scores."""
        ...


class InterpreterDefaults:
    """What most interpreters answer to `Interpreter`: log-probabilities, no beta, no guidance, no explanation."""

    name: str = ""
    gives_values: bool = False
    steerable: bool = False

    @property
    def beta(self) -> float | None:
        """See `Interpreter.beta`."""
        return None

    @property
    def needs(self) -> frozenset[Need]:
        """See `Interpreter.needs`: everything, where nobody says."""
        return EVERY_NEED

    def steered(self, beta: float | None, temperature: float) -> Any:
        """See `Interpreter.steered`; InputError for a beta."""
        if beta is not None:
            raise InputError(f"beta {beta:g}", "is heard by the interpreter advantage alone",
                             "choose that one, or leave beta out")
        return self

    def guided(self, guidance: float) -> Any:
        """See `Interpreter.guided`."""
        return self

    def explain(self, state: Any) -> Explanation | None:
        """See `Interpreter.explain`."""
        return None

    @classmethod
    def open(cls, parts: InterpreterParts) -> Any:
        """The interpreter of a bundle: the trained model itself, or made of the counts where there is none."""
        return parts.model if parts.model is not None else cls(parts.frequencies, parts.transitions)  # type: ignore[call-arg]


class _Adapted(InterpreterDefaults):
    """An object that has `start` and `step`, with the defaults for the rest; named by its class."""

    def __init__(self, inner: LexemeInterpreter) -> None:
        self.inner, self.name = inner, type(inner).__name__

    def start(self, speaker: int, first_lexeme: int) -> Any:
        """See `LexemeInterpreter.start`."""
        return self.inner.start(speaker, first_lexeme)

    def step(self, state: Any, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, Any]:
        """See `LexemeInterpreter.step`."""
        return self.inner.step(state, features, previous_lexeme)


def opened(kind: Any, parts: InterpreterParts) -> Interpreter:
    """The interpreter of a bundle whose class (or maker) is `kind`; see `InterpreterDefaults.open`."""
    if isinstance(kind, type) and issubclass(kind, InterpreterDefaults):
        return as_interpreter(kind.open(parts))
    return as_interpreter(parts.model if parts.model is not None else kind(parts.frequencies, parts.transitions))


_OPTIONAL = frozenset(("gives_values", "steerable", "beta", "needs", "steered", "guided", "explain"))


def as_interpreter(given: object) -> Interpreter:
    """An `Interpreter` of any object that has `start` and `step`; itself where it is one already.

    InputError for an object without them, and for one that has some of the optional members but not all: what it says
    there would be ignored.
    """
    if isinstance(given, Interpreter):
        return given
    kind = type(given).__name__
    if not isinstance(given, LexemeInterpreter):
        raise InputError(f"interpreter {kind}", "has no start and step", "see interpreters.base.LexemeInterpreter")
    partly = sorted(_OPTIONAL & set(dir(given)))
    if partly:
        raise InputError(f"interpreter {kind}", f"has {', '.join(partly)} but not all of the protocol",
                         "derive it from interpreters.base.InterpreterDefaults")
    return _Adapted(given)


@dataclass(frozen=True)
class InterpreterSizes:
    """What shapes the weights of an interpreter besides its settings.

    frames: K; low, high: widths d + 1 of the two levels of audio; speakers: P; text: d_t + 1, 0 without words; control:
    2 F; motion: D_m; lexemes: [S, D_s] the codebook; silent: the silent lexemes.
    """

    frames: int
    low: int
    high: int
    speakers: int
    text: int
    control: int
    motion: int
    lexemes: Tensor
    silent: Sequence[int] = ()


@dataclass(frozen=True)
class InterpreterParts:
    """What a bundle has for an interpreter that is opened (`InterpreterDefaults.open`).

    model: the trained part, None for one without weights; prior: the interpreter that it stands on, where its entry
    names one; frequencies: [speakers, S] and transitions: [S, S], counted on the training split; settings: its own, by
    the name of the entry's section; beta: the bundle's.
    """

    model: nn.Module | None
    prior: Interpreter | None
    frequencies: NDArray[np.float64]
    transitions: NDArray[np.float64]
    settings: Any
    beta: float


def select(scores: Scores, *, allowed: NDArray[np.int64] | None = None, temperature: float = 0.0,
           top: int | None = None, rng: np.random.Generator | None = None) -> int:
    """One lexeme from scores [S]: the best (temperature 0), or one drawn from softmax(scores / temperature).

    allowed: indices to choose among (the silent mask); None or empty allows all. top: draw among the best `top` only.
    """
    if temperature < 0 or (top is not None and top < 1):
        raise ValueError("temperature must not be negative and top must be positive")
    masked = np.array(scores, dtype=np.float64)
    if allowed is not None and len(allowed):
        blocked = np.ones(len(masked), dtype=bool)
        blocked[allowed] = False
        masked[blocked] = -np.inf
    if temperature == 0 or rng is None:
        return int(np.argmax(masked))
    if top is not None and top < len(masked):
        masked[masked < np.sort(masked)[-top]] = -np.inf
    weights = np.exp((masked - masked.max()) / temperature)
    return int(rng.choice(len(weights), p=weights / weights.sum()))
