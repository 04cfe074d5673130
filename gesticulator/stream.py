"""Gesture while speech arrives: `stream = g.stream(sample_rate=16000)`, `frames = stream.feed(samples)`.

Media time counts the seconds that were fed: sound of the character or of another speaker, and seconds of idling. Frame
n is the pose at n / fps seconds of media time, so a player that runs sound and frames on one clock keeps them in sync,
and no frame is dropped. A stream gives the same frames as a file, whatever the sizes of its pieces.

Sound that is fed without a break is one utterance, cut at its beats; its frames are returned at most
`Stream.look_ahead` seconds after their sound. Between utterances there is no gesture to wait for, so the frames of
idling, thinking and listening are returned at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.speech import onsets, silence
from data_module.speech.audio import SAMPLE_RATE, SampleFeed
from data_module.types import Array, Motion, Samples, Skeleton, Word, knot_times
from gesticulator.body.head_turns import HeadTurns
from gesticulator.body.motion_path import LONGEST_HISTORY, MotionPath
from gesticulator.body.rest import RestKnots
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import SpeechBlock, representation_of
from gesticulator.options import InferenceOptions
from gesticulator.plan.plan import Block
from gesticulator.sampling import loop
from gesticulator.sampling.cutter import TICK, BlockCutter
from gesticulator.sampling.loop import Request, Setup, controls_at

if TYPE_CHECKING:
    from gesticulator.directing.cues import TimedCue
    from gesticulator.directing.directions import Director
    from gesticulator.directing.marks import StreamMarks
    from gesticulator.directing.meanings import MeaningTrack
    from gesticulator.face.motion import FaceMotion
    from gesticulator.face.track import FaceTrack

__all__ = ["Stream", "StreamFrames", "StreamState"]

_KNOT = 0.04
"""Seconds between the knots of idle motion."""
_LONGEST = 3600.0
"""Seconds of idling per call: their frames are generated in one call, which takes memory."""


class StreamState(StrEnum):
    """What the character does: nothing (idle), speak, listen to another, or think before an answer."""

    IDLE = "idle"
    SPEAKING = "speaking"
    LISTENING = "listening"
    THINKING = "thinking"


@dataclass(frozen=True)
class StreamFrames:
    """Final frames, possibly none. They follow the earlier ones without a gap and do not change, unless `interrupt`
    replaces frames that were not played.

    first: the number of the first frame; frame n is the pose at n / fps seconds of media time. rotations: [T, J, 4]
    local rotations, unit quaternions, w first; root_positions: [T, 3] metres; skeleton: of J joints. blocks: those
    that were generated since the earlier frames. face: of the same frames, where one was asked for.
    """

    first: int
    fps: float
    skeleton: Skeleton
    rotations: Array
    root_positions: Array
    blocks: tuple[Block, ...] = ()
    face: FaceMotion | None = None

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def times(self) -> Array:
        """[T] media time of the frames, seconds."""
        times: Array = (self.first + np.arange(len(self))) / self.fps
        return times

    def motion(self) -> Motion:
        """The frames as a motion; ValueError if there are none."""
        return Motion(self.skeleton, self.rotations, self.root_positions, self.fps)


_Parts: TypeAlias = "Generator[tuple[Motion | None, Block | None], None, None]"
StreamCall: TypeAlias = Literal["feed", "pass_over", "idle", "think", "listen", "interrupt", "finish"]
"""A call of a stream that returns frames."""


class Stream:
    """One character that speaks, listens, thinks and idles; memory does not grow with time.

    Created by `Gesticulator.stream`; not thread-safe. `InputError` for invalid sound (NaN, infinite, not of shape [n])
    and for any call after `finish`.
    """

    def __init__(self, bundle: Bundle, setup: Setup, options: InferenceOptions, cutter: Callable[..., BlockCutter],
                 sample_rate: float = SAMPLE_RATE) -> None:
        """setup: the performer; options: frame rate, gain, seed, legs, knobs and cues; cutter: makes the cutter of an
        utterance, whose blocks begin at `start` seconds."""
        if not bundle.config.rests_by_phrase:
            raise InputError("the bundle", "cannot rest without speech",
                             "use one with a lexicon of blocks and silence.rest=life")
        self._bundle, self._setup, self._new_cutter = bundle, setup, cutter
        self._gain = float(options.gain)
        # Two feeds: resampling has a memory, and another speaker's sound must not leak into it.
        self._sound = SampleFeed(sample_rate, self._gain)
        self._voice = SampleFeed(sample_rate, self._gain)
        self._cutter: BlockCutter | None = cutter()
        self._text = self._cutter.reads
        self._performance = loop.begin(bundle, setup, self._text)
        # A plan says what happens at times of a sound that is known; a stream's is not.
        if options.plan is not None:
            raise InputError("plan", "needs a whole recording", "render it without a stream")
        self._director: Director | None = None
        self._marks: StreamMarks | None = None
        self._meanings: MeaningTrack | None = None
        shaping: Callable[[Array, Array], Array] | None = None
        # Imported where it is needed: a plain stream starts faster without it.
        named = representation_of(bundle.config).name == "rotations"
        if self._text and named:
            from gesticulator.directing.meanings import track_of

            self._meanings = track_of(options)
        if options.shaped or options.directed or self._meanings is not None:
            from gesticulator.directing.directions import Director
            from gesticulator.directing.shaping import Shaping

            self._director = Director(bundle, options, (), math.inf)
            shaping = Shaping(bundle, options, setup.speaker, (), np.array([0.0, math.inf]), self._meant)
        if self._text:
            from gesticulator.directing.marks import StreamMarks
            from gesticulator.directing.shaping import with_gestures

            self._marks = StreamMarks(named)
            shaping = shaping or (lambda poses, times: with_gestures(
                poses, times, self._meant(float(times[-1])), options.seed or 0) if len(times) else poses)
        self._path = MotionPath(bundle, setup.speaker, options, shaping=shaping)
        joints = self._path.skeleton.names[:bundle.config.motion.joints]
        self._turns = HeadTurns(int(options.seed), joints)
        self._face = _face_of(options)
        self._scale = bundle.statistics.present / bundle.statistics.deviation
        self._state, self._finished = StreamState.IDLE, False
        self.hurried = False
        """Whether blocks are generated at lower cost: one candidate, few steps, no guidance. Set it when generation
        falls behind; a stream that was never hurried gives the frames of a file."""
        self._begun = self._committed = 0.0  # media time at which the utterance begins, and of the last knot
        self._past_blocks = 0
        rest = bundle.rest_feature(setup.speaker).reshape(1, -1)
        self._shown = deque([(RestKnots(np.zeros(1), rest, np.zeros((1, 3, 2))), rest)])

    # ------------------------------------------------------------------------------------------------------- state

    @property
    def state(self) -> StreamState:
        """The current state of the character."""
        return self._state

    @property
    def time(self) -> float:
        """Media time up to which sound or seconds were fed."""
        return self._begun + self._sound.seconds

    @property
    def made(self) -> int:
        """Count of final frames, which is the number of the next frame."""
        return self._path.next

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._path.fps

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of J joints that the frames animate."""
        return self._path.skeleton

    @property
    def look_ahead(self) -> float:
        """Seconds of sound after a frame that are needed at most before the frame is final; it depends on
        `latency`."""
        beats = self._bundle.config.rhythm.beats
        # From a beat to where the next beat is certain, and from there to where the pauses of the block after it are.
        certain = beats.d_max + beats.d_min + onsets.LOOK_AHEAD
        if not self._path.prompt:
            known = beats.d_max + silence.LOOK_AHEAD + silence.STEP * silence.FRAME
            # A block is generated once the next one is known; its last knot is certain with the knot after that.
            certain = beats.d_max + max(certain, known) + beats.d_max / self._bundle.frames
        return certain + self._path.reach + TICK / SAMPLE_RATE

    @property
    def lacking(self) -> float:
        """Least seconds of sound that `feed` needs to return any frame: sound is processed in ticks of 20 ms."""
        return TICK / SAMPLE_RATE if self._cutter is None else self._cutter.lacking

    @property
    def history(self) -> float:
        """Seconds before the last frame to which `interrupt` can go back: a minute unless set, ten minutes at most.
        Older frames are forgotten with the next ones."""
        return self._path.history

    @history.setter
    def history(self, seconds: float) -> None:
        self._path.history = min(float(seconds), LONGEST_HISTORY)

    @property
    def latency(self) -> str:
        """Look-ahead of the blocks: "full", or "low", with which a block is generated without the one after it. It may
        be set between two calls: frames follow each other without a gap or a jump. After a change to "full" none comes
        for as many seconds of sound as `look_ahead` grows by."""
        return "low" if self._path.prompt else "full"

    @latency.setter
    def latency(self, latency: str) -> None:
        if latency not in ("full", "low"):
            raise InputError(f"latency {latency!r}", "is unknown", "choose full or low")
        self._path.prompt = latency == "low"
        if self._cutter is not None:
            self._cutter.low = self._path.prompt

    # ------------------------------------------------------------------------------------------------------- input

    def steps(self, call: StreamCall, *arguments: Any) -> Generator[StreamFrames, None, None]:
        """A call in steps: the same frames in parts, at most one block or 0.4 s of idle motion at a time, each computed
        when it is asked for. No other call is allowed until the last step, except after closing the iterator (a
        generator): then idling ends at the frames returned so far, and so does media time; what else the call had to do
        is dropped."""
        self._check_open()
        # All calls that return frames are generators, so that a server can take turns between blocks.
        parts: _Parts = getattr(self, f"_{call}")(*arguments)
        first = self._path.next
        try:
            for part in parts:
                yield self._frames(first, part)
                first = self._path.next
        finally:
            # A caller may stop early: closing sets media time to the frames that were returned.
            parts.close()

    def feed(self, samples: NDArray[Any]) -> StreamFrames:
        """Feed speech of the character: samples [n] in [-1, 1], or integers of any width; n may be 0. Returns the
        frames that became final."""
        return self._at_once("feed", samples)

    def pass_over(self, seconds: float) -> StreamFrames:
        """Skip so many seconds of speech that came too late to be generated, and advance media time by them. Sound that
        was fed but not generated yet is skipped too, and its words are forgotten. The hands stop softly and wait for
        the next `feed`. Returns frames up to the new media time, at about the cost of `idle`."""
        return self._at_once("pass_over", seconds)

    def add_words(self, words: Sequence[Word]) -> tuple[Word, ...]:
        """Add words with their media time, seconds. They may come before their sound, late or never: a block is
        generated with the words that are known by then. The words of one call are encoded together.

        Gesture marks in them (`data_module.text.marks`) are made at the word after them, if that comes at least .6 s
        before its motion is final; up to .6 s later, the gesture is as much late; beyond, it is not made. Returns the
        words as they are spoken, without marks. `InputError` if the stream was opened without text.
        """
        *_, spoken = self.adding(words)
        return spoken

    def adding(self, words: Sequence[Word], *batch: int) -> Iterator[tuple[Word, ...]]:
        """`add_words` in steps, each of which gives the words as they are spoken. batch: beginnings of sentences that
        a step reads."""
        self._check_open()
        if not self._text:
            raise InputError("words", "are not read by this stream", "open it with text=True")
        assert self._marks is not None
        # Marks first: they are taken out of the words, which are encoded as they are spoken.
        words = self._marks.take(words, self._committed)
        self._express(words)
        if self._meanings is not None:
            self._meanings.add(words)
        yield words
        placed = [replace(word, start=word.start - self._begun, end=word.end - self._begun) for word in words]
        for _ in self._utterance().add_words(placed, *batch):
            yield words

    def idle(self, seconds: float) -> StreamFrames:
        """Advance media time by seconds without sound: the character comes to rest, with idle motion. Returns the
        frames up to the new media time, those of sound fed before included. 0 seconds end the utterance."""
        return self._at_once("idle", seconds)

    def think(self, seconds: float) -> StreamFrames:
        """As `idle`, while an answer is being prepared: the character looks away."""
        return self._at_once("think", seconds)

    def listen(self, samples: NDArray[Any]) -> StreamFrames:
        """As `idle` for the length of another speaker's sound [n]: the character nods in its pauses, and shifts."""
        return self._at_once("listen", samples)

    def interrupt(self, at: float | None = None) -> StreamFrames:
        """Stop speaking: no new stroke begins, the hands are under 0.3 m/s within 300 ms (350 at full latency) and hang
        within 1.2 s.

        at: media time up to which frames were played, seconds; media time continues from there, and later frames are
        replaced by the returned ones, from number `first` on. None replaces no frame. Sound that was fed for later
        times is forgotten. `InputError` for a time in the future or longer ago than `history`.
        """
        return self._at_once("interrupt", at)

    def finish(self) -> StreamFrames:
        """End the stream and return its last frames. `InputError` if nothing was ever fed."""
        return self._at_once("finish")

    # --------------------------------------------------------------------------------------------------- internals

    def _meant(self, until: float) -> list[TimedCue]:
        """The gestures of words and of marks that begin up to a time."""
        return [*(() if self._meanings is None else self._meanings.cues(until)),
                *(() if self._marks is None else self._marks.cues())]

    def _at_once(self, call: StreamCall, *arguments: Any) -> StreamFrames:
        """All steps of a call as one."""
        first, joints = self._path.next, len(self.skeleton)
        parts = list(self.steps(call, *arguments))
        faces = [part.face for part in parts if part.face is not None]
        if faces:
            from gesticulator.face.motion import joined
        return StreamFrames(
            parts[0].first if parts else first, self.fps, self.skeleton,
            np.concatenate([np.zeros((0, joints, 4)), *(part.rotations for part in parts)]),
            np.concatenate([np.zeros((0, 3)), *(part.root_positions for part in parts)]),
            tuple(block for part in parts for block in part.blocks), joined(faces) if faces else None)

    def _check_open(self) -> None:
        if self._finished:
            raise InputError("the stream", "is finished", "open another")

    def _speak(self) -> None:
        # Turns of the head that belong to listening end when speech begins.
        if self._state != StreamState.SPEAKING:
            # A nod or a look away ends with the state that it belongs to.
            self._turns.release(self._committed)
            self._state = StreamState.SPEAKING

    def _express(self, words: Sequence[Word]) -> None:
        """Let the face show the marks of words that are for it; those that come late begin with the next frame."""
        if self._face is not None:
            from gesticulator.directing.cues import stroke_of_word
            from gesticulator.directing.marks import expressions_of

            for word in words:
                for name in expressions_of(word):
                    self._face.express(max(stroke_of_word(word), self.made / self.fps), name)

    def _utterance(self) -> BlockCutter:
        """The cutter of the current utterance. Its blocks begin after the last knot that was generated."""
        if self._cutter is None:
            self._cutter = self._new_cutter(start=max(self._committed - self._begun, 0.0))
            self._cutter.low = self._path.prompt
        return self._cutter

    def _begin(self, time: float) -> None:
        """Begin the next utterance at media time `time`, without the sound that was fed before."""
        # The new feed has no memory of the old sound: an utterance is cut by itself.
        self._begun, self._sound, self._cutter = time, SampleFeed(self._sound.rate, self._gain), None

    def _feed(self, samples: NDArray[Any]) -> _Parts:
        sound = self._sound.take(samples)
        # No samples are no speech: they only ask for frames that are due.
        if len(samples):
            self._speak()
            if self._face is not None:
                self._face.feed(sound, self._begun)
        if len(sound):
            yield from self._draw(self._utterance().feed(sound))

    def _pass_over(self, seconds: float) -> _Parts:
        _check_seconds(seconds)
        self._speak()
        if self._meanings is not None:
            self._meanings.forget(self._committed)
        if self._face is not None:
            self._face.end()
        # Media time goes on, although nothing is generated for what was passed over.
        self._begin(self.time + seconds)
        yield from self._advance(self._begun)

    def _idle(self, seconds: float) -> _Parts:
        return self._rest(seconds, StreamState.IDLE)

    def _think(self, seconds: float) -> _Parts:
        return self._rest(seconds, StreamState.THINKING)

    def _listen(self, samples: NDArray[Any]) -> _Parts:
        voice = self._voice.take(samples)
        return self._rest(len(samples) / self._voice.rate, StreamState.LISTENING, voice)

    def _interrupt(self, at: float | None = None) -> _Parts:
        final = self._path.next / self.fps
        at = final if at is None else float(at)
        knots, features = self._history()
        if not knots.times[0] <= at <= max(self.time, final):
            raise InputError(f"interrupt at {at:g} s", f"is not between {knots.times[0]:.2f} and {final:.2f} s",
                             "give the media time of the last frame that was played")
        # Sound may be fed further than frames are final; nothing can be taken back there.
        at = min(at, final)
        if self._marks is not None:
            self._marks.interrupt(at)
        # The knots of the earlier frames stay, and one knot more, from which the character goes to rest.
        last = min(int(np.searchsorted(knots.times, at + self._path.reach)) + 2, len(knots.times))
        # Drop knots beyond the history here: the remaining ones become one entry, which is dropped as a whole later.
        old = int(np.searchsorted(knots.times, knots.times[last - 1] - self._path.history))
        old = max(min(old, last - 2 * self._bundle.frames), 0)
        recent = RestKnots(knots.times[old:last], knots.poses[old:last], knots.gains[old:last])
        features = features[old:last]
        if last > 1:
            if self._meanings is not None:
                self._meanings.forget(at)
            self._performance = loop.break_off(self._performance, recent, at)
            self._path.rewind(recent.times, features, min(math.ceil(at * self.fps - 1e-6), self._path.next))
        self._shown = deque([(recent, features)])
        self._committed = float(recent.times[-1])
        self._turns.release(self._committed)
        self._begin(at)
        self._state = StreamState.IDLE
        if self._face is not None:
            self._face.interrupt(at)
        yield None, None  # frames are replaced from here on, even if none follows at once
        yield from self._advance(at)

    def _finish(self) -> _Parts:
        if self.time == 0:
            raise InputError("speech", "holds no samples", "give a recording")
        yield from self._end_utterance()
        self._finished = True
        yield self._path.finish(self._begun), None

    def _end_utterance(self) -> _Parts:
        """Generate the rest of the utterance, and set media time to its end."""
        # Without sound there is no utterance to end.
        if self._sound.seconds == 0 or self._cutter is None:
            return
        cutter, sound = self._cutter, self._sound.finish()
        if self._face is not None:
            self._face.feed(sound, self._begun)
            self._face.end()
        try:
            yield from self._draw(cutter.feed(sound))
            yield from self._draw(cutter.finish())
        finally:
            self._begin(self._begun + cutter.duration)

    def _rest(self, seconds: float, state: StreamState, voice: Samples | None = None) -> _Parts:
        """Advance by seconds in a state other than speaking. voice: samples of another speaker."""
        _check_seconds(seconds)
        yield from self._end_utterance()
        if state != self._state:
            self._turns.release(self._committed)
            if state == StreamState.THINKING:
                self._turns.look_away(self._committed)
            self._state = state
            if self._face is not None:
                self._face.state(self._begun, state.value, self._turns.side)
        # Nods come in the pauses of the other voice, which are found in its sound.
        if voice is not None:
            self._turns.listen(voice, max(self._committed, self._begun))
        until = self._begun + seconds
        self._begin(until)
        try:
            yield from self._advance(until)
        except GeneratorExit:
            self._begin(min(until, self._path.next / self.fps))
            raise

    def _advance(self, until: float) -> _Parts:
        """Generate idle motion until all frames before `until` seconds are final."""
        # A little less, because a whole number of frames must not become one more by rounding.
        count, frames = math.ceil(until * self.fps - 1e-6), self._bundle.frames
        none = np.zeros((0, self._shown[-1][1].shape[1]), np.float32)
        waiting = self._path.push(np.zeros(0), none, count)
        if waiting is not None:
            yield waiting, None
        while self._path.next < count:
            missing = until + self._path.reach - self._committed
            # At most as many knots as a block has, so a step costs no more than a block.
            knots, start = min(max(math.ceil(missing / _KNOT), 1), frames), self._committed
            features, self._performance = loop.idle(self._bundle, self._performance, start, _KNOT, knots)
            times = start + _KNOT * np.arange(1, knots + 1, dtype=np.float64)
            yield self._show(times, features, count), None

    def _draw(self, blocks: Sequence[SpeechBlock]) -> _Parts:
        for block in blocks:
            # The cutter counts from the start of the utterance; keys and times need media time.
            speech = replace(block, number=self._past_blocks, start=block.start + self._begun,
                             end=block.end + self._begun)
            times = knot_times(np.array([speech.start, speech.end]), self._bundle.frames)
            control = controls_at(self._bundle.levels, self._setup.controls, times)
            request = Request(speech, control) if self._director is None else self._director.request(
                speech, times, control)
            generated, self._performance = loop.step(self._bundle, self._setup, self._performance,
                                                     replace(request, fast=self.hurried))
            self._past_blocks += 1
            yield self._show(times, generated.motion), generated.block

    def _show(self, times: Array, features: NDArray[np.float32], until: int | None = None) -> Motion | None:
        """Add knots, features [K, D_m] at times [K]; return the frames that became final, those before `until`."""
        # Head turns are added to what is shown, not to what the generator continues from.
        turned = self._turns(times)
        if turned is not None:
            features = (features + turned * self._scale).astype(np.float32)
        self._shown.append((loop.knots_of(self._performance, times), features))
        while self._shown[0][0].times[-1] < times[-1] - self._path.history:
            self._shown.popleft()
        self._committed = float(times[-1])
        return self._path.push(times, features, until)

    def _history(self) -> tuple[RestKnots, NDArray[np.float32]]:
        """All knots in the history, and their features [M, D_m] with head turns."""
        # Joined only for an interruption, which is rare; every block would cost a copy.
        entries = [knots for knots, _ in self._shown]
        times, poses, gains = (np.concatenate([getattr(knots, name) for knots in entries])
                               for name in ("times", "poses", "gains"))
        return RestKnots(times, poses, gains), np.concatenate([features for _, features in self._shown])

    def _frames(self, first: int, part: tuple[Motion | None, Block | None]) -> StreamFrames:
        motion, block = part
        joints = len(self.skeleton)
        frames = StreamFrames(
            self._path.next if motion is None else first, self.fps, self.skeleton,
            np.zeros((0, joints, 4)) if motion is None else motion.rotations,
            np.zeros((0, 3)) if motion is None else motion.root_positions, () if block is None else (block,))
        if self._face is None:
            return frames
        self._face.history = 2 * self._path.history  # knots are dropped some at a time, at most as many again late
        self._face.blocks(frames.blocks)
        return replace(frames, face=self._face.frames(frames.first, frames.motion())) if len(frames) else frames


def _face_of(options: InferenceOptions) -> FaceTrack | None:
    if options.face == "off":
        return None
    from gesticulator.face.track import FaceTrack

    face = FaceTrack(options, LONGEST_HISTORY)
    if options.cues:
        from gesticulator.directing.cues import expressions_at

        for time, name in expressions_at(options.cues, (), math.inf):
            face.express(time, name, lasting=True)
    return face


def _check_seconds(seconds: float) -> None:
    if not 0 <= seconds <= _LONGEST:
        raise InputError(f"seconds {seconds:g}", "is out of range", f"give 0 to {_LONGEST:g}")
