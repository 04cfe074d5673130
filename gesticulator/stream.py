"""Gesture while speech arrives: `stream = g.stream(sample_rate=16000)`, `frames = stream.feed(samples)`.

Media time counts the seconds that were taken in: sound that was fed or listened to, and seconds of idling. Frame n is
the pose at n / fps seconds of it, whenever it is made; who plays sound and frames by one clock has them in step, and
nothing is dropped. Whatever the sizes of the pieces, the frames of a stream together are the frames of a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module.types import Array, Motion, Skeleton, Word

if TYPE_CHECKING:
    from gesticulator.performance import InferenceOptions
    from gesticulator.pipeline import Gesticulator

LATENCIES = ("full", "low")


class StreamState(StrEnum):
    """What the character does: nothing (idle), speak, listen to another, or think before an answer."""

    IDLE = "idle"
    SPEAKING = "speaking"
    LISTENING = "listening"
    THINKING = "thinking"


@dataclass(frozen=True)
class StreamBlock:
    """A block that was drawn, as an event. start, end: seconds of media time (a beat lies on the end); lexeme: what was
    played; silent: the block lies in a pause."""

    start: float
    end: float
    lexeme: int
    silent: bool


@dataclass(frozen=True)
class StreamFrames:
    """Frames that are final: they follow those before without a gap and will not change, unless `interrupt` takes the
    ones back that were not played. There may be none.

    first: the number of the first frame; frame n is the pose at n / fps seconds of media time. rotations: [T, J, 4]
    local rotations, unit quaternions, w first; root_positions: [T, 3] metres; skeleton: of J joints. blocks: those that
    were drawn since the frames before.
    """

    first: int
    fps: float
    skeleton: Skeleton
    rotations: Array
    root_positions: Array
    blocks: tuple[StreamBlock, ...] = ()

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def times(self) -> Array:
        """[T] seconds of media time of the frames."""
        times: Array = (self.first + np.arange(len(self))) / self.fps
        return times

    def motion(self) -> Motion:
        """The frames as a motion; ValueError where there are none."""
        return Motion(self.skeleton, self.rotations, self.root_positions, self.fps)


class Stream:
    """One character that speaks, listens, thinks and idles; memory does not grow with time.

    Not for several threads at once. `InputError` for sound that is none (NaN, infinite, another shape than [n]), and
    for anything that is asked after `finish`.
    """

    def __init__(self, gesticulator: Gesticulator, options: InferenceOptions, *, sample_rate: int = 16000,
                 latency: str = "full", text: bool = False) -> None:
        """options: as for a file; sample_rate: hertz of what is fed; latency: "full" hears the block after a block
        before it draws it, "low" does with what was heard of it by then; text: words will come (`add_words`)."""
        raise NotImplementedError

    @property
    def state(self) -> StreamState:
        """What the character does now."""
        raise NotImplementedError

    @property
    def time(self) -> float:
        """Seconds of media time that were taken in."""
        raise NotImplementedError

    @property
    def made(self) -> int:
        """Frames that are final; the next has this number."""
        raise NotImplementedError

    @property
    def skeleton(self) -> Skeleton:
        """Of the J joints that the frames rotate."""
        raise NotImplementedError

    def feed(self, samples: NDArray[Any]) -> StreamFrames:
        """Sound that the character says: [n] in [-1, 1] (or whole numbers of any width), any number of them, 0 too.
        Gives the frames that are final by it."""
        raise NotImplementedError

    def add_words(self, words: Sequence[Word]) -> None:
        """What is said, with seconds of media time. Words may come before their sound, late or never: a block is drawn
        with the words that are known by then."""
        raise NotImplementedError

    def idle(self, seconds: float) -> StreamFrames:
        """So many seconds of media time without sound: she comes to rest and stays alive. Gives frames up to their end,
        what was fed before included: nothing is waited for. 0 says that no more sound comes for now."""
        raise NotImplementedError

    def think(self, seconds: float) -> StreamFrames:
        """As `idle`, while an answer is thought of: she looks away."""
        raise NotImplementedError

    def listen(self, samples: NDArray[Any]) -> StreamFrames:
        """As `idle` for as long as this sound of another's voice [n] lasts: she nods in its pauses, and shifts."""
        raise NotImplementedError

    def interrupt(self, at: float | None = None) -> StreamFrames:
        """Stop speaking: no stroke begins any more, the hands are under 0.3 m/s within 300 ms and hang within 1.2 s.

        at: seconds of media time up to which was played; later frames are taken back, and media time goes on from
        there. None keeps all that is final. Sound that was fed for later is forgotten. What is given (its `first` says
        from where on) replaces what was taken back; `idle` and the others give what follows.
        """
        raise NotImplementedError

    def finish(self) -> StreamFrames:
        """The rest: no sound comes any more."""
        raise NotImplementedError
