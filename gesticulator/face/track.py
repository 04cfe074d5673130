"""The face over media time, for a file and a stream alike: sound, states and blocks in, frames out.

The mouth follows the sound (`lips`); lids, brows and eyes move by themselves (`life`); expressions come at cues and
marks. The eyes hold their target while the body turns the head: the turn of the head is subtracted from the gaze.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from data_module.motion import kinematics, rotation
from data_module.types import Array, Motion, Samples, Word
from gesticulator.body.life import eased
from gesticulator.face.life import RATE, FaceLife
from gesticulator.face.lips import Lips, with_strength
from gesticulator.face.motion import FaceMotion
from gesticulator.face.visemes import SILENT, VISEMES
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import Block

_MOST_ASIDE, _MOST_UP = math.radians(28.0), math.radians(18.0)
"""Farthest turn of an eye in the head; people turn the head for more."""
_MOUTH_SMILES = 0.5
"""Share of a smile that is left where the mouth is wide open."""


class FaceTrack:
    """The face of one character; memory does not grow with time."""

    def __init__(self, options: InferenceOptions, history: float = math.inf) -> None:
        """options: of the performance, with a face. history: seconds before the last frame to which `interrupt` may go
        back."""
        self._options, self.history = options, history
        self._lips: deque[Lips] = deque()
        self._states: deque[tuple[float, str]] = deque([(0.0, "idle")])
        self._life = FaceLife(options.seed)
        self._steps: deque[tuple[float, float, float, float]] = deque()
        self._first = 0
        self._cues = FaceCues()

    # ------------------------------------------------------------------------------------------------------ input

    def feed(self, samples: Samples, start: float) -> None:
        """Take more of the character's speech at 16 kHz. start: media time of the first sample of this utterance,
        seconds; another value than before begins another utterance."""
        if not self._lips or self._lips[-1].start != start:
            self.state(start, "speaking")
            self._lips.append(Lips(start))
        self._lips[-1].feed(samples)

    def end(self, words: Sequence[Word] = ()) -> None:
        """End the utterance. words: its words with times from the start of its sound, if they are known; the mouth
        follows their phones."""
        if self._lips:
            self._lips[-1].finish()
            if words:
                self._lips[-1].follow(words)

    def state(self, at: float, name: str, side: float = 0.0) -> None:
        """From media time `at` on the character is "speaking", "listening", "thinking" or "idle". side: where the head
        of a thinker turns to: positive to the left, negative to the right, 0 for either."""
        if side:
            name += " left" if side > 0 else " right"
        # A state that is told again must not begin anew: a thinker would look aside again.
        if self._states[-1][1] != name:
            self._states.append((at, name))

    def blocks(self, blocks: Iterable[Block]) -> None:
        """The next blocks of the body; brows rise on beats at which the hands gesture."""
        for block in blocks:
            if not block.silent:
                self._life.accent(block.start)

    def express(self, time: float, name: str, lasting: bool = False) -> None:
        """Add a cue of `plan.gestures.EXPRESSIONS` at media time `time`. lasting: an interruption keeps it."""
        self._cues.add(time, name, lasting)

    def interrupt(self, at: float) -> None:
        """The speech stops at media time `at`, which may be in the past: later sound is forgotten, and the character is
        idle."""
        # What was said after the moment is gone as a whole; the utterance across it is cut.
        while self._lips and self._lips[-1].start >= at:
            self._lips.pop()
        if self._lips:
            self._lips[-1].cut(at)
        while len(self._states) > 1 and self._states[-1][0] >= at:
            self._states.pop()
        self._cues.interrupt(at)
        self.state(at, "idle")

    # ----------------------------------------------------------------------------------------------------- output

    def frames(self, first: int, motion: Motion) -> FaceMotion:
        """The face at the frames of the body's `motion`. first: the number of its first frame in the media."""
        count = len(motion)
        times = (first + np.arange(count)) / motion.fps
        visemes = self._visemes(times) if count else np.zeros((0, len(VISEMES)))
        visemes = with_strength(visemes, self._options.mouth)
        none, lips = np.zeros(count), self._options.face == "lips"
        if lips or not count:
            return FaceMotion(visemes, none, none, none, np.zeros((count, 2)), motion.fps, lips)
        # The face of the lips alone ends above: its steps are neither needed nor paid for.
        steps = self._stepped(times)
        mood, lifted = self._cues.at(times, self._options.mood)
        # A wide mouth cannot smile as much as a shut one.
        smile = mood * (1.0 - (1.0 - _MOUTH_SMILES) * (1.0 - visemes[:, SILENT]))
        brows = np.clip(steps[:, 1] + lifted + 0.25 * np.minimum(mood, 0.0), -1.0, 1.0)
        face = FaceMotion(visemes, np.clip(steps[:, 0], 0.0, 1.0), brows, smile, in_head(steps[:, 2:], motion),
                          motion.fps)
        self._forget(float(times[-1]))
        return face

    def _visemes(self, times: Array) -> Array:
        """[T, 15] weights at rising times [T], each of the latest utterance that had begun by then."""
        out = np.zeros((len(times), len(VISEMES)))
        out[:, SILENT] = 1.0
        # Utterances follow each other in time: each has the frames from its start to the next one's.
        edges = [*np.searchsorted(times, [lips.start for lips in self._lips]), len(times)]
        for lips, first, last in zip(self._lips, edges, edges[1:], strict=False):
            if last > first:
                out[first:last] = lips.at(times[first:last])
        return out

    def _stepped(self, times: Array) -> Array:
        """[T, 4] the values of `FaceLife.step` at rising times, between steps in proportion."""
        # One step beyond the last time, so that every time lies between two steps.
        last = math.floor(times[-1] * RATE) + 1
        while self._first + len(self._steps) <= last:
            now = self._life.time
            # Sound up to this step is certain: a frame is final later than its sound.
            silent = self._visemes(np.array([now]))[0, SILENT]
            self._steps.append(self._life.step(self._state_at(now), float(silent)))
        where = times * RATE - self._first
        low = np.clip(np.floor(where).astype(np.int64), 0, len(self._steps) - 2)
        share = np.clip(where - low, 0.0, 1.0)[:, None]
        begin, end = int(low[0]), int(low[-1]) + 2
        rows = np.array([self._steps[index] for index in range(begin, end)])
        return np.asarray(rows[low - begin] * (1.0 - share) + rows[low + 1 - begin] * share)

    def _state_at(self, time: float) -> str:
        return next((name for at, name in reversed(self._states) if at <= time), self._states[0][1])

    def _forget(self, now: float) -> None:
        oldest = now - self.history
        self._cues.forget(oldest)
        while len(self._lips) > 1 and self._lips[1].start < oldest:
            self._lips.popleft()
        if self._lips and math.isfinite(oldest):
            self._lips[0].forget(oldest)
        while len(self._states) > 1 and self._states[1][0] < oldest:
            self._states.popleft()
        while len(self._steps) > 2 and (self._first + 1) / RATE < oldest:
            self._steps.popleft()
            self._first += 1


def in_head(target: Array, motion: Motion) -> Array:
    """[T, 2] turn of the eyes in the head, radians to the left and up, that looks at `target` [T, 2] (relative to
    straight ahead of a character that faces +Z) in spite of the head's pose; within what eyes can turn."""
    skeleton = motion.skeleton
    world = kinematics.global_rotations(skeleton, motion.rotations)[:, skeleton.index("Head")]
    ahead = rotation.rotate(world, np.array([0.0, 0.0, 1.0]))
    # The gaze is meant for the world, and the body has turned the head: what it turned is taken off.
    head = np.stack([np.arctan2(ahead[:, 0], ahead[:, 2]), np.arcsin(np.clip(ahead[:, 1], -1.0, 1.0))], axis=1)
    most = np.array([_MOST_ASIDE, _MOST_UP])
    # Softly limited: eyes that stop at a hard limit would jerk while the head turns on.
    return np.asarray(most * np.tanh((target - head) / most))


def face_of(options: InferenceOptions, samples: Samples, blocks: Iterable[Block], motion: Motion,
            words: Sequence[Word] = (), cues: Iterable[tuple[float, str]] = ()) -> FaceMotion:
    """The face of a whole recording at 16 kHz, for the body's `motion`. words: with their times, if they are known;
    cues: time and name of expressions."""
    track = FaceTrack(options)
    track.feed(samples, 0.0)
    track.end(words)
    track.blocks(blocks)
    for time, name in cues:
        track.express(time, name)
    return track.frames(0, motion)


_MOOD_CHANGES = 0.6
"""Seconds in which a mood gives way to the next."""
_AGAIN = 0.05
"""Seconds within which the same expression is the same cue, sent twice."""


@dataclass(frozen=True)
class _Expression:
    """An expression. mood: of the mouth, -1 to 1, or None for the mood of the settings; brows: -1 to 1, added; lasts:
    seconds at full strength, infinite for a mood; rises, falls: seconds."""

    mood: float | None = None
    brows: float = 0.0
    lasts: float = np.inf
    rises: float = _MOOD_CHANGES
    falls: float = 0.0


_EXPRESSIONS = {
    "happy": _Expression(0.7), "sad": _Expression(-0.7), "neutral": _Expression(),
    # Spontaneous smiles last 0.7 to 4 s (Ekman and Friesen 1982).
    "smile": _Expression(0.9, 0.0, 1.4, 0.4, 0.7),
    "frown": _Expression(-0.2, -1.0, 0.8, 0.25, 0.4),
    "raise brows": _Expression(None, 1.0, 0.4, 0.18, 0.35)}
"""How the names of `plan.gestures.EXPRESSIONS` look."""


class FaceCues:
    """The expressions of one face, by their times."""

    def __init__(self) -> None:
        self._cues: list[tuple[float, str]] = []
        self._lasting: set[tuple[float, str]] = set()

    def add(self, time: float, name: str, lasting: bool = False) -> None:
        """Add an expression of `EXPRESSIONS` from media time `time` on; KeyError for an unknown name. lasting: an
        interruption keeps it."""
        _EXPRESSIONS[name]
        if lasting:
            self._lasting.add((time, name))
        if not any(other == name and abs(at - time) < _AGAIN for at, other in self._cues):
            self._cues = sorted([*self._cues, (time, name)])

    def interrupt(self, at: float) -> None:
        """Forget the expressions that begin at media time `at` or later, except lasting ones."""
        self._cues = [cue for cue in self._cues if cue[0] < at or cue in self._lasting]

    def forget(self, oldest: float) -> None:
        """Forget the expressions that no longer show at media time `oldest`: moments, and moods before the last."""
        # The last mood that is fully there still shows, however old it is; those before it do not.
        moods = [time for time, name in self._cues if np.isinf(_EXPRESSIONS[name].lasts)
                 and time + _MOOD_CHANGES <= oldest]
        last = max(moods, default=-np.inf)
        self._cues = [(time, name) for time, name in self._cues
                      if (time >= last if np.isinf(_EXPRESSIONS[name].lasts) else _end(time, name) > oldest)]

    def at(self, times: Array, mood: float) -> tuple[Array, Array]:
        """[T] the mood, -1 to 1, and [T] what is added to the brows, at media times [T]. mood: without cues."""
        now, brows = np.full(len(times), mood), np.zeros(len(times))
        # Moods first: a smile passes over the mood that lasts.
        for time, name in sorted(self._cues, key=lambda cue: np.isfinite(_EXPRESSIONS[cue[1]].lasts)):
            expression = _EXPRESSIONS[name]
            share = eased((times - time) / expression.rises)
            if np.isfinite(expression.lasts):
                share = share - eased((times - time - expression.rises - expression.lasts) / expression.falls)
            if expression.mood is not None:
                now = now + (expression.mood - now) * share
            elif np.isinf(expression.lasts):
                now = now + (mood - now) * share
            brows = brows + expression.brows * share
        return np.asarray(now), np.asarray(brows)


def _end(time: float, name: str) -> float:
    """Media time at which an expression of a moment has passed."""
    expression = _EXPRESSIONS[name]
    return time + expression.rises + expression.lasts + expression.falls
