"""A Pipecat processor that adds gestures: put it between the synthesiser and the transport's output.

Every frame passes at once: the sound waits for nothing. `PoseFrame`s follow, with the media time they belong to; who
shows them asks `media_time()` or counts the sound that was played.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pipecat.adapters.llm.schemas.function_schema import FunctionSchema
from pipecat.adapters.llm.schemas.tools_schema import ToolsSchema
from pipecat.frames.frames import (
    AggregatedTextFrame,
    CancelFrame,
    DataFrame,
    EndFrame,
    Frame,
    InputAudioRawFrame,
    InterruptionFrame,
    OutputTransportMessageUrgentFrame,
    StartFrame,
    TTSAudioRawFrame,
    TTSStoppedFrame,
    TTSTextFrame,
    UserStartedSpeakingFrame,
    UserStoppedSpeakingFrame,
)
from pipecat.processors.frame_processor import FrameDirection, FrameProcessor
from websockets.exceptions import WebSocketException

from pipecat_gesticulator.marks import LETTER_SECONDS, timed_words, without_marks
from pipecat_gesticulator.messages import hello_messages, pose_messages, to_rtvi
from pipecat_gesticulator.protocol import Hello, Poses, Welcome
from pipecat_gesticulator.resuming import ResumingStream, connect_resuming
from pipecat_gesticulator.tools import TOOLS, GestureCalls

TICK_SECONDS = 0.05
"""How often idle motion is asked for while nobody speaks; poses of idle time come so much late."""
REST_SECONDS = 10.0
"""How long the rest of the poses may take at the end."""
MOST_ORDERS = 5000
"""Messages that may wait for the server: minutes of sound, while it starts."""
MOST_WORDS = 500
"""Words in one message."""
FEW_LETTERS = 12
"""Letters below which a sentence says little about the voice."""
HELLO_SECONDS = 10.0
"""How often the skeleton is sent to the client, who may come later, with the poses."""
_Order = Callable[[ResumingStream], Awaitable[None]]


@dataclass
class PoseFrame(DataFrame):
    """Poses of the avatar. welcome: the server's hello, with the skeleton."""

    poses: Poses
    welcome: Welcome = field(repr=False)


class GesticulatorProcessor(FrameProcessor):
    """Sends what the synthesiser says to a gesticulator server, and pushes the poses downstream.

    An interruption takes back the poses that were not played yet. While the user speaks the avatar listens, then it
    thinks until it is answered. A server that is lost is waited for, and the stream goes on where it was
    (`ResumingStream`); show the poses with a `SteadyPlayer`. One that cannot be reached at all, or does not come back
    within `patience`, costs an error frame and nothing else.

    With the option "text" the server gets the words, too. A synthesiser that tells when it says each word
    (`TTSTextFrame` with a time) has its times passed on; for others, they are estimated before their sound from how
    fast the voice spoke so far. Gesture marks in them are made. The voice leaves the marks out if the synthesiser has
    the text transform `marks.spoken_text`.

    With `messages`, the poses also go to the client by the transport's data channel, as RTVI messages (`messages.py`).
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765/stream", *, fps: float = 60.0, seed: int = 0,
                 options: dict[str, Any] | None = None, token: str | None = None, patience: float = 300.0,
                 messages: bool = False, **kwargs: Any) -> None:
        """url: of the server. options: as in the schema, such as {"activity": 0.6}; `keep_up` is true unless told.
        patience: seconds for which a lost server is waited for. messages: send the poses to the client, too."""
        super().__init__(**kwargs)
        self._url, self._patience, self._messages = url, patience, messages
        self.calls = GestureCalls()
        """What a language model called for (`register_tools`)."""
        self._greeted = -math.inf
        """time.monotonic() at which the skeleton was sent to the client."""
        self._asked = {"fps": fps, "seed": seed, "options": {"keep_up": True, **(options or {})}, "token": token}
        self._rate = 24000
        self._pipeline_clock: Any = None
        """The pipeline's clock, nanoseconds; None before the processor is set up."""
        self._orders: asyncio.Queue[_Order] = asyncio.Queue(MOST_ORDERS)
        self._tasks: list[asyncio.Task[None]] = []
        self._ended = asyncio.Event()
        self._lost = False
        self._sent = 0.0
        """Seconds of media time that were asked for: sound and idle time."""
        self._play_end = 0.0
        """time.monotonic() at which all of it will have been played."""
        self._user_speaks = False
        self._waits = "idle"
        self._text = bool((options or {}).get("text", False))
        self._letter, self._letters, self._said_at = LETTER_SECONDS, 0, 0.0
        """Seconds per letter; letters of the sentence that is spoken now, and the media time at which it began."""
        self._sentence = ""
        """The sentence that was announced and has no sound yet."""
        self._timed = False
        """Whether the synthesiser tells when it says each word, so that nothing is estimated."""
        self._began: tuple[int, float] | None = None
        """Pipeline time (nanoseconds) and media time at which the sound of this answer began."""

    def register_tools(self, llm: Any) -> ToolsSchema:
        """Let a language model call make_gesture and set_mood; the tools for its context. With the option "text"."""
        async def carry_out(params: Any) -> None:
            await params.result_callback(self.calls.call(params.function_name, params.arguments))

        for tool in TOOLS:
            llm.register_function(tool["name"], carry_out)
        return ToolsSchema(standard_tools=[FunctionSchema(**tool) for tool in TOOLS])

    def media_time(self) -> float:
        """The media time that is played now, seconds, where sound is played as it comes."""
        return max(0.0, self._sent - max(0.0, self._play_end - time.monotonic()))

    async def setup(self, setup: Any) -> None:
        """Take the rate that the pipeline speaks at, and its clock."""
        await super().setup(setup)
        self._rate = getattr(setup, "audio_out_sample_rate", 0) or self._rate
        self._pipeline_clock = setup.clock

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Pass the frame on, and have the server told what it means."""
        await super().process_frame(frame, direction)
        if isinstance(frame, StartFrame):
            self._play_end = time.monotonic()
            self._tasks = [self.create_task(self._work()), self.create_task(self._tick())]
        if isinstance(frame, EndFrame):
            await self._end()
        await self.push_frame(frame, direction)
        if isinstance(frame, CancelFrame):
            await self._stop()
        elif not self._lost:
            self._tell(frame)

    async def cleanup(self) -> None:
        """Let go of the server."""
        await self._stop()
        await super().cleanup()

    def _tell(self, frame: Frame) -> None:
        if isinstance(frame, TTSAudioRawFrame):
            self._waits = "idle"
            if self._began is None:
                self._began = self._pipeline_time(), self._sent
            self._say()
            self._send(frame)
        elif isinstance(frame, TTSTextFrame):
            self._pass_on(frame)
        elif isinstance(frame, AggregatedTextFrame):
            if self._text and not self._timed and frame.will_be_spoken:
                self._measure()
                self._sentence = self.calls.marked(frame.text)
        elif isinstance(frame, TTSStoppedFrame):
            self._measure()
            self._began = None
            self._order(lambda stream: stream.idle(0.0))  # the last poses wait for sound that does not come
        elif isinstance(frame, InterruptionFrame):
            at = self.media_time()
            self._sent, self._play_end, self._letters = at, time.monotonic(), 0
            self._sentence, self._began = "", None
            self.calls.forget()
            self._order(lambda stream: stream.interrupt(at))
        elif isinstance(frame, UserStartedSpeakingFrame):
            self._user_speaks = True
            self._order(lambda stream: stream.listen())
        elif isinstance(frame, UserStoppedSpeakingFrame):
            self._user_speaks, self._waits = False, "think"
            self._order(lambda stream: stream.speak())
        elif isinstance(frame, InputAudioRawFrame) and self._user_speaks and self._play_end <= time.monotonic():
            self._send(frame)

    def _pipeline_time(self) -> int:
        return 0 if self._pipeline_clock is None else int(self._pipeline_clock.get_time())

    def _pass_on(self, frame: TTSTextFrame) -> None:
        """Send a word at the time that the synthesiser says, if it says one."""
        if not self._text or not frame.pts or self._began is None or not frame.text.strip():
            return
        self._timed = True
        if self._letters:
            return  # this sentence was estimated; the next ones are not
        begun, said_at = self._began
        self._send_words(self.calls.marked(frame.text), said_at + max(0.0, (frame.pts - begun) / 1e9))

    def _say(self) -> None:
        """Have the words of the announced sentence sent, whose sound begins."""
        text, self._sentence = self._sentence, ""
        if not text:
            return
        self._letters, self._said_at = len(without_marks(text).strip()), self._sent
        self._send_words(text, self._sent)

    def _send_words(self, text: str, start: float) -> None:
        words = timed_words(text, start, self._letter)
        for first in range(0, len(words), MOST_WORDS):
            self._order(partial(ResumingStream.add_words, words=words[first:first + MOST_WORDS]))

    def _measure(self) -> None:
        """Learn how long a letter takes from the sentence that was spoken."""
        seconds = self._sent - self._said_at
        if self._letters >= FEW_LETTERS and seconds > 0:
            self._letter += 0.5 * (min(max(seconds / self._letters, 0.03), 0.2) - self._letter)
        self._letters = 0

    def _send(self, frame: TTSAudioRawFrame | InputAudioRawFrame) -> None:
        samples = _mono(frame.audio, frame.num_channels, frame.sample_rate, self._rate)
        seconds = len(samples) / self._rate
        self._sent += seconds
        self._play_end = max(self._play_end, time.monotonic()) + seconds
        self._order(lambda stream: stream.send(samples.astype("<i2").tobytes()))

    def _order(self, order: _Order) -> None:
        """Have something sent, without waiting for it. What does not fit any more ends the gestures, not the talk."""
        try:
            self._orders.put_nowait(order)
        except asyncio.QueueFull:
            self._lost = True

    async def _work(self) -> None:
        """Hold the stream open, and push what comes from it."""
        try:
            async with connect_resuming(self._url, Hello(self._rate, **self._asked), self._patience) as stream:
                sending = self.create_task(self._obey(stream))
                try:
                    async for message in stream:
                        if isinstance(message, Poses):
                            await self.push_frame(PoseFrame(message, stream.welcome))
                            if self._messages:
                                await self._message(message, stream.welcome)
                finally:
                    await self.cancel_task(sending)
        except (WebSocketException, OSError, ValueError) as error:
            await self.push_error(f"no gestures: {type(error).__name__}: {error}")
        finally:
            self._lost = True
            self._ended.set()

    async def _message(self, poses: Poses, welcome: Welcome) -> None:
        """Send poses to the client. They are urgent: in their turn they would wait until the sound before is played."""
        messages = list(pose_messages(poses, self.media_time()))
        if time.monotonic() - self._greeted > HELLO_SECONDS:
            self._greeted = time.monotonic()
            messages = [*hello_messages(welcome), *messages]
        for one in messages:
            await self.push_frame(OutputTransportMessageUrgentFrame(message=to_rtvi(one)))

    async def _obey(self, stream: ResumingStream) -> None:
        with contextlib.suppress(WebSocketException):  # whoever receives hears of it too
            while True:
                await (await self._orders.get())(stream)

    async def _tick(self) -> None:
        """While nobody speaks, media time goes on with the clock."""
        while not self._lost:
            await asyncio.sleep(TICK_SECONDS)
            late = time.monotonic() - self._play_end
            if late <= 0 or (self._user_speaks and late < 4 * TICK_SECONDS):
                continue
            self._sent += late
            self._play_end += late
            motion = ResumingStream.think if self._waits == "think" else ResumingStream.idle
            self._order(partial(motion, seconds=late))

    async def _end(self) -> None:
        """Have the rest of the poses pushed before the pipeline ends."""
        if self._lost or not self._tasks:
            return
        self._order(lambda stream: stream.finish())
        try:
            async with asyncio.timeout(REST_SECONDS):
                await self._ended.wait()
        except TimeoutError:
            await self.push_error("no gestures: the server did not finish")

    async def _stop(self) -> None:
        self._lost = True
        for task in self._tasks:
            await self.cancel_task(task)
        self._tasks = []


def _mono(sound: bytes, channels: int, rate: int, wanted: int) -> NDArray[np.int16]:
    """16 bit sound as one channel at the rate that the server was told; interpolated, which is enough for gestures."""
    whole = len(sound) // (2 * channels) * 2 * channels
    samples = np.frombuffer(sound[:whole], "<i2").reshape(-1, channels).mean(axis=1)
    if rate != wanted and len(samples):
        places = np.arange(int(len(samples) * wanted / rate)) * (rate / wanted)
        samples = np.interp(places, np.arange(len(samples)), samples)
    return samples.astype(np.int16)
