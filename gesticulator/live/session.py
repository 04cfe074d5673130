"""A stream without networking: samples and commands in, packets and events out, a step at a time."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from data_module.errors import InputError
from data_module.motion.skeletons import HIP_HEIGHT
from data_module.types import Word
from gesticulator.body.motion_path import HISTORY, LONGEST_HISTORY
from gesticulator.live.pace import Effort
from gesticulator.live.protocol import VERSION, CloseCode, RefusedError, StreamRequest, joints, pack

if TYPE_CHECKING:
    from data_module.types import Samples
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.live.limits import ServerLimits
    from gesticulator.stream import Stream, StreamFrames


@dataclass
class SessionAnswer:
    """The result of some processing. messages: packets (bytes) and events (text), in order; frames: the same poses."""

    messages: list[bytes | str] = field(default_factory=list)
    frames: list[StreamFrames] = field(default_factory=list)

    def say(self, kind: str, **values: Any) -> None:
        """Add an event."""
        self.messages.append(json.dumps({"type": kind, **values}))


Work: TypeAlias = Generator[SessionAnswer, None, None]
"""Processing in steps of at most a block (15 ms of processor time), each done when it is asked for; see
`Stream.steps`."""


class Session:
    """One client's stream of gestures."""

    def __init__(self, name: str, request: StreamRequest, stream: Stream, limits: ServerLimits) -> None:
        self.name, self.request, self.limits = name, request, limits
        self._stream, self._look_ahead = stream, stream.look_ahead
        self._received = 0.0
        self._state = "idle"
        self._effort, self._skipped = Effort.FULL, 0.0
        self._latency = stream.latency
        self._lift: float | None = None
        """Offset of the root above the floor, metres."""
        self._words: list[Word] = []
        """Words whose poses have not been sent."""

    @property
    def lacking(self) -> float:
        """Least duration of the avatar's audio that produces output, seconds."""
        return self._stream.lacking

    @property
    def until(self) -> float:
        """Media time up to which there are frames, seconds."""
        return self._stream.made / self.request.fps

    def unplayed(self, seconds: float) -> None:
        """Record that the last `seconds` sent cannot have been played yet, so that an interruption can take them
        back."""
        self._stream.history = min(HISTORY + seconds, LONGEST_HISTORY)

    def welcome(self) -> dict[str, Any]:
        """The server's hello."""
        from gesticulator.cli import __version__

        limits, request = self.limits, self.request
        return {
            "type": "hello", "protocol": VERSION, "server": f"gesticulator {__version__}", "stream": self.name,
            "sample_rate": request.sample_rate, "format": request.format, "fps": request.fps,
            "output": request.output, "look_ahead": round(self._look_ahead, 4),
            "joints": joints(self._stream.skeleton) if request.output == "joints" else [],
            "limits": {"message_bytes": limits.message_bytes, "waiting_seconds": limits.waiting_seconds,
                       "stream_seconds": limits.stream_seconds},
        }

    def feed(self, samples: Samples, other_voice: bool = False, effort: Effort = Effort.FULL) -> Work:
        """Process audio of the avatar or, with `other_voice`, of another speaker."""
        seconds = len(samples) / self.request.sample_rate
        self._received += seconds
        if other_voice:
            yield from map(self._answer, self._stream.steps("listen", samples))
            return
        if effort == Effort.NONE:
            self._skipped += seconds
            yield from self._pass_over(seconds)
        else:
            # Hurried audio has a low look-ahead, too: what is late must not wait for the next block.
            self._stream.hurried = effort == Effort.LESS
            self._stream.latency = self._latency if effort == Effort.FULL else "low"
            yield from map(self._answer, self._stream.steps("feed", samples))
        if effort != self._effort or effort == Effort.NONE:
            self._effort = effort
            answer = SessionAnswer()
            answer.say("pace", effort=str(effort.value), passed=round(self._skipped, 6))
            yield answer

    def obey(self, message: dict[str, Any]) -> Work:
        """Execute a client's command (see the schema), or `leave`: finish, because the server stops. A client that may
        come back takes `done` as the end, so only `finish` is answered with it."""
        kind = message["type"]
        if kind in ("idle", "think"):
            yield from self.wait(kind, float(message.get("seconds", 0.0)))
        elif kind == "interrupt":
            # Words after the moment were not spoken; without a moment none of the waiting ones will be.
            at = message.get("time")
            self._words = [word for word in self._words if at is not None and word.start < at]
            replaced = self._interrupt(None if at is None else float(at))
            # A client that comes back has to know which packets were on their way.
            answer = SessionAnswer()
            answer.say("interrupted", time=round(replaced[0].first / self.request.fps, 6))
            yield answer
            yield from map(self._answer, replaced)
            # The voice may have been heard further than there were poses; media time goes on from where it was heard.
            unseen = 0.0 if at is None else min(float(at) - self._stream.time, self.limits.waiting_seconds)
            if unseen > 0.5 / self.request.fps:
                yield from self.wait("idle", unseen)
        elif kind == "words":
            yield from self._add_words(message["words"])
        elif kind in ("finish", "leave"):
            if self._stream.time > 0:  # a stream without input has no remaining frames
                yield from map(self._answer, self._stream.steps("finish"))
            if kind == "finish":
                answer = SessionAnswer()
                answer.say("done", frames=self._stream.made)
                yield answer
        # listen and speak affect the audio that follows

    def wait(self, kind: str, seconds: float) -> Work:
        """Advance media time without audio. kind: "idle" or "think". Closing the iterator ends it at the last frame."""
        steps = self._stream.steps("think" if kind == "think" else "idle", seconds)
        try:
            for frames in steps:
                yield self._answer(frames)
        finally:
            steps.close()

    def _pass_over(self, seconds: float) -> Work:
        yield from map(self._answer, self._stream.steps("pass_over", seconds))
        later = [word for word in self._words if word.start >= self._stream.time]
        # Only words of the skipped audio are dropped; a stream without text has none.
        yield from (SessionAnswer() for _ in (self._stream.adding(later, 1) if later else ()))

    def _interrupt(self, at: float | None) -> list[StreamFrames]:
        try:
            return list(self._stream.steps("interrupt", None if at is None else min(at, self._stream.time)))
        except InputError:  # too long ago to take back: stop after what was sent
            return list(self._stream.steps("interrupt", None))

    def _add_words(self, entries: list[dict[str, Any]]) -> Work:
        if not self.request.options.get("text", False):
            raise RefusedError(CloseCode.BAD_MESSAGE, "words came for a stream without the option text")
        try:
            words = [Word(entry["text"], float(entry["start"]), float(entry["end"])) for entry in entries]
        except ValueError as error:
            raise RefusedError(CloseCode.BAD_MESSAGE, str(error)) from None
        if len(self._words) + len(words) > MOST_WORDS:
            raise RefusedError(CloseCode.TOO_MUCH_SOUND, f"more than {MOST_WORDS} words wait for their sound")
        adding = self._stream.adding(words, 1)
        self._words = sorted([*self._words, *next(adding)], key=lambda word: word.start)
        # Reading a text takes longer than a block, so other streams take turns between two.
        yield from (SessionAnswer() for _ in adding)

    def _answer(self, frames: StreamFrames) -> SessionAnswer:
        answer = SessionAnswer()
        frames = self._standing(frames)
        state = str(self._stream.state.value)
        if state != self._state:
            self._state = state
            answer.say("state", state=state, time=round(frames.first / frames.fps, 6))
        for block in frames.blocks:
            answer.say("lexeme", start=round(float(block.start), 6), end=round(float(block.end), 6),
                       lexeme=block.lexeme, silent=block.silent)
            answer.say("beat", time=round(float(block.end), 6))
        end = (frames.first + len(frames)) / frames.fps
        while self._words and self._words[0].start < end:
            word = self._words.pop(0)
            answer.say("word", text=word.text, start=word.start, end=word.end)
        if len(frames):
            answer.messages.append(pack(frames, self.request, state, self._received))
            answer.frames.append(frames)
        return answer

    def _standing(self, frames: StreamFrames) -> StreamFrames:
        """The frames with the hips lifted above the floor if the models place them at the origin; decided once."""
        if len(frames) and self._lift is None:
            self._lift = HIP_HEIGHT if frames.root_positions[0, 1] < HIP_HEIGHT / 4 else 0.0
        if not self._lift or not len(frames):
            return frames
        return replace(frames, root_positions=frames.root_positions + np.array([0.0, self._lift, 0.0]))


MOST_WORDS = 20_000
"""Most pending words: two hours of speech."""


def session_opener(gesticulator: Gesticulator, limits: ServerLimits) -> Callable[[str, StreamRequest], Session]:
    """A function that opens a session for a stream's name and request; `InputError` for an unsupported request."""
    def open_session(name: str, request: StreamRequest) -> Session:
        options = {name: value for name, value in request.options.items() if name != "keep_up"}
        stream = gesticulator.stream(sample_rate=request.sample_rate, seed=request.seed, fps=request.fps, **options)
        return Session(name, request, stream, limits)

    return open_session
