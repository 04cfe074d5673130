"""Gesture while speech arrives: `stream = g.stream(sample_rate=16000)`, `frames = stream.feed(samples)`.

Media time counts the seconds that were taken in: sound that was fed or listened to, and seconds of idling. Frame n is
the pose at n / fps seconds of it, whenever it is made; who plays sound and frames by one clock has them in step, and
nothing is dropped. Whatever the sizes of the pieces, the frames of a stream together are the frames of a file.

Sound that is fed without a break is one utterance, cut at its beats; frames are given `Stream.look_ahead` seconds after
their sound at most. Between utterances nothing is waited for: what is said, thought or listened to next is known to be
no gesture of hers, so frames come at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.speech import onsets, silence
from data_module.speech.audio import SAMPLE_RATE, SampleFeed
from data_module.types import Array, Blocks, Motion, Samples, Skeleton, Word
from gesticulator.body.head_turns import HeadTurns
from gesticulator.body.motion_path import HISTORY, LONGEST_HISTORY, MotionPath
from gesticulator.body.rest import RestKnots
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock
from gesticulator.drawing.cutter import TICK, BlockCutter
from gesticulator.drawing.drawer import FREE
from gesticulator.drawing.driver import BlockRequest, Cast, Driver, controls_at
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import Block

if TYPE_CHECKING:
    from gesticulator.directing.directions import Director

__all__ = ["Stream", "StreamFrames", "StreamState"]

_KNOT = 0.04
"""Seconds between the poses of idling."""
_LONGEST = 3600.0
"""Seconds of idling at once: their frames are made at once."""


class StreamState(StrEnum):
    """What the character does: nothing (idle), speak, listen to another, or think before an answer."""

    IDLE = "idle"
    SPEAKING = "speaking"
    LISTENING = "listening"
    THINKING = "thinking"


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
    blocks: tuple[Block, ...] = ()

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


_Made: TypeAlias = "list[tuple[Motion | None, Block | None]]"


class Stream:
    """One character that speaks, listens, thinks and idles; memory does not grow with time.

    `Gesticulator.stream` makes one. Not for several threads at once. `InputError` for sound that is none (NaN,
    infinite, another shape than [n]), and for anything that is asked after `finish`.
    """

    def __init__(self, bundle: Bundle, cast: Cast, options: InferenceOptions, cutter: Callable[..., BlockCutter],
                 sample_rate: float = SAMPLE_RATE) -> None:
        """cast: who gestures; options: of which fps, gain, seed and legs are taken; cutter: makes one for an utterance
        whose blocks begin at so many seconds (`start`)."""
        if not bundle.system.streams:
            raise InputError("the bundle", "does not know how to rest without speech",
                             "use one of lexemes whose phrases rest (silence.rest=life)")
        self._bundle, self._cast, self._new_cutter = bundle, cast, cutter
        self._gain, self._rate = float(options.gain), sample_rate
        self._feed = SampleFeed(sample_rate, self._gain)
        self._voice = SampleFeed(sample_rate, self._gain)
        self._cutter: BlockCutter | None = cutter()
        self._text = self._cutter.reads
        self._driver = Driver(bundle, cast)
        self._driver.begin(self._text)
        if options.plan is not None:
            raise InputError("plan", "is of a whole recording", "render it without a stream")
        self._director: Director | None = None
        shaping = None
        if options.shaped or options.directed:
            from gesticulator.directing import directions as directing

            self._director = directing.Director(bundle, options, (), math.inf)
            shaping = directing.shaping(bundle, options, cast.speaker, (), np.array([0.0, math.inf]))
        self._path = MotionPath(bundle, cast.speaker, options, self._cutter.latency == "low", shaping)
        self._path.history = HISTORY
        joints = self._path.skeleton.names[:bundle.config.motion.joints]
        self._turns = HeadTurns(int(options.seed), joints)
        self._scale = bundle.statistics.present.numpy() / bundle.statistics.deviation
        self._state, self._finished, self._hurried = StreamState.IDLE, False, False
        self._begun = self._committed = 0.0  # media time where the utterance begins, and of the last knot
        self._past_blocks = 0
        rest = bundle.rest_feature(cast.speaker).cpu().numpy().astype(np.float32).reshape(1, -1)
        self._shown = deque([(RestKnots(np.zeros(1), rest, np.zeros((1, 2, 2))), rest)])

    # -------------------------------------------------------------------------------------------------- what it is

    @property
    def state(self) -> StreamState:
        """What the character does now."""
        return self._state

    @property
    def time(self) -> float:
        """Seconds of media time that were taken in."""
        return self._begun + self._feed.seconds

    @property
    def made(self) -> int:
        """Frames that are final; the next has this number."""
        return self._path.next

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._path.fps

    @property
    def skeleton(self) -> Skeleton:
        """Of the J joints that the frames rotate."""
        return self._path.skeleton

    @property
    def look_ahead(self) -> float:
        """Seconds of sound after a frame's own that may be needed before it is final, at most."""
        beats = self._bundle.config.rhythm.beats
        # From a beat to where the next one is certain, and from the next to where the pauses of the block after it are.
        certain = beats.d_max + beats.d_min + onsets.LOOK_AHEAD
        if not self._path.prompt:
            known = beats.d_max + silence.LOOK_AHEAD + silence.STEP * silence.FRAME
            # A block is drawn when the next is known, and its last knot is certain with the one after that.
            certain = beats.d_max + max(certain, known) + beats.d_max / self._bundle.frames
        return certain + self._path.reach + TICK / SAMPLE_RATE

    @property
    def lacking(self) -> float:
        """Seconds of sound that `feed` needs at least to give anything: it is taken in ticks of 50 ms."""
        return TICK / SAMPLE_RATE if self._cutter is None else self._cutter.lacking

    @property
    def history(self) -> float:
        """Seconds before the last frame that `interrupt` can go back to: a minute, or as many as are set, up to ten
        minutes. What lies further back is let go of with the next frames."""
        return self._path.history

    @history.setter
    def history(self, seconds: float) -> None:
        if not 0 < seconds <= LONGEST_HISTORY:
            raise InputError(f"history {seconds:g} s", "is out of range", f"give up to {LONGEST_HISTORY:g}")
        self._path.history = float(seconds)

    @property
    def hurried(self) -> bool:
        """Blocks are drawn at less cost: one candidate in few steps, without guidance. Set it where there is no time;
        a stream that never was hurried gives the frames of a file."""
        return self._hurried

    @hurried.setter
    def hurried(self, on: bool) -> None:
        self._hurried = on
        self._driver.hurry(on)

    # -------------------------------------------------------------------------------------------------- what is done

    def feed(self, samples: NDArray[Any]) -> StreamFrames:
        """Sound that the character says: [n] in [-1, 1] (or whole numbers of any width), any number of them, 0 too.
        Gives the frames that are final by it."""
        self._check_open()
        first, sound = self._path.next, self._feed.take(samples)
        if len(samples) and self._state != StreamState.SPEAKING:
            self._turns.release(self._committed)
            self._state = StreamState.SPEAKING
        return self._given(first, self._draw(self._utterance().feed(sound)) if len(sound) else [])

    def pass_over(self, seconds: float) -> StreamFrames:
        """So many seconds of what she says came too late to be drawn: media time goes on by them. What was fed and is
        not drawn yet is passed over with them, and words for it are forgotten. Her hands stop softly and wait, and go
        on with the next `feed`. Gives frames up to the new media time; costs about as little as `idle`."""
        self._check_open()
        _check_seconds(seconds)
        first = self._path.next
        if self._state != StreamState.SPEAKING:
            self._turns.release(self._committed)
            self._state = StreamState.SPEAKING
        self._begin(self.time + seconds)
        return self._given(first, self._advance(self._begun))

    def add_words(self, words: Sequence[Word]) -> None:
        """What is said, with seconds of media time. Words may come before their sound, late or never: a block is drawn
        with the words that are known by then. Those that come together are read together. `InputError` where the
        stream was not made to read."""
        self._check_open()
        if not self._text:
            raise InputError("words", "are not read by this stream", "open it with text=True")
        self._utterance().add_words([replace(word, start=word.start - self._begun, end=word.end - self._begun)
                                     for word in words])

    def idle(self, seconds: float) -> StreamFrames:
        """So many seconds of media time without sound: she comes to rest and stays alive. Gives frames up to their end,
        what was fed before included: nothing is waited for. 0 says that no more sound comes for now."""
        return self._rests(seconds, StreamState.IDLE)

    def think(self, seconds: float) -> StreamFrames:
        """As `idle`, while an answer is thought of: she looks away."""
        return self._rests(seconds, StreamState.THINKING)

    def listen(self, samples: NDArray[Any]) -> StreamFrames:
        """As `idle` for as long as this sound of another's voice [n] lasts: she nods in its pauses, and shifts."""
        self._check_open()
        heard = self._voice.take(samples)
        return self._rests(len(samples) / self._voice.rate, StreamState.LISTENING, heard)

    def interrupt(self, at: float | None = None) -> StreamFrames:
        """Stop speaking: no stroke begins any more, the hands are under 0.3 m/s within 300 ms and hang within 1.2 s.

        at: seconds of media time up to which was played; later frames are taken back, and media time goes on from
        there. None keeps all that is final. Sound that was fed for later is forgotten. What is given (its `first` says
        from where on) replaces what was taken back; `idle` and the others give what follows. `InputError` for a time
        that is not yet, or longer ago than `history`.
        """
        self._check_open()
        made = self._path.next / self.fps
        at = made if at is None else float(at)
        knots, shown = self._history()
        if not knots.times[0] <= at <= max(self.time, made):
            raise InputError(f"interrupt at {at:g} s", f"is not between {knots.times[0]:.2f} and {made:.2f} s",
                             "give the time up to which was played")
        at = min(at, made)
        # What the frames before were made of stays, and one knot beyond; there she breaks off.
        last = min(int(np.searchsorted(knots.times, at + self._path.reach)) + 2, len(knots.times))
        # What is too long ago is let go of here: after this all is one piece, which later ones are measured by.
        old = int(np.searchsorted(knots.times, knots.times[last - 1] - self._path.history))
        old = max(min(old, last - 2 * self._bundle.frames), 0)
        kept = RestKnots(knots.times[old:last], knots.poses[old:last], knots.gains[old:last])
        shown = shown[old:last]
        if last > 1:
            self._driver.break_off(kept, at)
            self._path.rewind(kept.times, shown, min(math.ceil(at * self.fps - 1e-6), self._path.next))
        self._shown = deque([(kept, shown)])
        self._committed = float(kept.times[-1])
        self._turns.release(self._committed)
        self._begin(at)
        self._state = StreamState.IDLE
        return self._given(self._path.next, self._advance(at))

    def finish(self) -> StreamFrames:
        """The rest: no sound comes any more. `InputError` where nothing was ever taken in."""
        self._check_open()
        if self.time == 0:
            raise InputError("speech", "holds no samples", "give a recording")
        first, made = self._path.next, self._end_utterance()
        made.append((self._path.finish(self._begun), None))
        self._finished = True
        return self._given(first, made)

    # -------------------------------------------------------------------------------------------------- how

    def _check_open(self) -> None:
        if self._finished:
            raise InputError("the stream", "is finished", "open another")

    def _utterance(self) -> BlockCutter:
        """What cuts the sound that is fed. What was shown already is not drawn again."""
        if self._cutter is None:
            self._cutter = self._new_cutter(start=max(self._committed - self._begun, 0.0))
        return self._cutter

    def _begin(self, time: float) -> None:
        """Media time goes on at `time`; what was fed is done with."""
        self._begun, self._feed, self._cutter = time, SampleFeed(self._feed.rate, self._gain), None

    def _end_utterance(self) -> _Made:
        """Draw what was fed to its end; media time stands there."""
        if self._feed.seconds == 0 or self._cutter is None:
            return []
        cutter = self._cutter
        made = self._draw(cutter.feed(self._feed.finish()))
        made += self._draw(cutter.finish())
        self._begin(self._begun + cutter.duration)
        return made

    def _rests(self, seconds: float, state: StreamState, heard: Samples | None = None) -> StreamFrames:
        self._check_open()
        _check_seconds(seconds)
        first, made = self._path.next, self._end_utterance()
        if state != self._state:
            self._turns.release(self._committed)
            if state == StreamState.THINKING:
                self._turns.look_away(self._committed)
            self._state = state
        if heard is not None:
            self._turns.listen(heard, max(self._committed, self._begun))
        self._begin(self._begun + seconds)
        return self._given(first, made + self._advance(self._begun))

    def _advance(self, until: float) -> _Made:
        """Idle until all frames before `until` seconds are made."""
        count, frames = math.ceil(until * self.fps - 1e-6), self._bundle.frames
        none = np.zeros((0, self._shown[-1][1].shape[1]), np.float32)
        made: _Made = [(self._path.push(np.zeros(0), none, count), None)]
        while self._path.next < count:
            away = until + self._path.reach - self._committed
            knots, start = min(max(math.ceil(away / _KNOT), 1), frames), self._committed
            features = self._driver.idle(start, _KNOT, knots)
            times = start + _KNOT * np.arange(1, knots + 1, dtype=np.float64)
            made.append((self._show(times, features, count), None))
        return made

    def _draw(self, blocks: Sequence[SpeechBlock]) -> _Made:
        made: _Made = []
        for block in blocks:
            speech = replace(block, number=self._past_blocks, start=block.start + self._begun,
                             end=block.end + self._begun)
            edges = np.array([speech.start, speech.end])
            times = Blocks(edges, np.zeros(1, np.int8), np.zeros(1, bool), self._bundle.frames, 1.0).knot_times
            direction = FREE if self._director is None else self._director.direction(times, speech.start)
            drawn = self._driver.draw(BlockRequest(
                speech, controls_at(self._bundle.levels, self._cast.controls, times), direction))
            self._past_blocks += 1
            made.append((self._show(times, drawn.motion), drawn.block))
        return made

    def _show(self, times: Array, features: NDArray[np.float32], until: int | None = None) -> Motion | None:
        """The frames that are certain by more knots, [K, D_m] at times [K], up to the one before `until`."""
        turned = self._turns(times)
        if turned is not None:
            features = (features + turned * self._scale).astype(np.float32)
        self._shown.append((self._driver.knots(times), features))
        while self._shown[0][0].times[-1] < times[-1] - self._path.history:
            self._shown.popleft()
        self._committed = float(times[-1])
        return self._path.push(times, features, until)

    def _history(self) -> tuple[RestKnots, NDArray[np.float32]]:
        """All knots that are remembered, and the features [M, D_m] that were shown."""
        knots = [one for one, _ in self._shown]
        times, poses, gains = (np.concatenate([getattr(one, name) for one in knots])
                               for name in ("times", "poses", "gains"))
        return RestKnots(times, poses, gains), np.concatenate([features for _, features in self._shown])

    def _given(self, first: int, made: _Made) -> StreamFrames:
        parts = [part for part, _ in made if part is not None]
        joints = len(self.skeleton)
        return StreamFrames(
            first, self.fps, self.skeleton, np.concatenate([np.zeros((0, joints, 4)), *(p.rotations for p in parts)]),
            np.concatenate([np.zeros((0, 3)), *(part.root_positions for part in parts)]),
            tuple(block for _, block in made if block is not None))


def _check_seconds(seconds: float) -> None:
    if not 0 <= seconds <= _LONGEST:
        raise InputError(f"seconds {seconds:g}", "is out of range", f"give 0 to {_LONGEST:g}")
