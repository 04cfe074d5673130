"""An audio output for LiveKit agents that adds gestures: it stands before the session's own output.

    session.output.audio = GestureAudioOutput(session.output.audio, show)

Sound passes at once, to the output behind it and to the server; `show(poses, welcome)` is called with what comes back,
and sends it where the avatar is, such as by `room.local_participant.publish_data`.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
from livekit import rtc
from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities

from pipecat_gesticulator.protocol import Hello, Poses, Welcome
from pipecat_gesticulator.resuming import ResumingStream, connect_resuming

TICK_SECONDS = 0.05
"""How often idle motion is asked for while nothing is said."""
MOST_ORDERS = 5000
"""Messages that may wait for the server."""
Show = Callable[[Poses, Welcome], Awaitable[None]]
_Order = Callable[[ResumingStream], Awaitable[None]]


class GestureAudioOutput(AudioOutput):
    """See the module. A server that is lost is waited for; without one, the agent speaks as ever.

    `capture_frame` sends sound, `flush` asks for the last poses of a segment, and `clear_buffer` takes back the poses
    that were not played.
    """

    def __init__(self, behind: AudioOutput, show: Show, url: str = "ws://127.0.0.1:8765/stream",
                 hello: Hello | None = None, patience: float = 300.0) -> None:
        """behind: plays the sound; hello: what is asked of the server; its rate is that of all sound (default 24 kHz,
        or what `behind` asks for)."""
        super().__init__(label="gesticulator", capabilities=AudioOutputCapabilities(pause=False), next_in_chain=behind,
                         sample_rate=behind.sample_rate)
        self._show, self._url, self._patience = show, url, patience
        self._hello = hello or Hello(behind.sample_rate or 24000, options={"keep_up": True})
        self._orders: asyncio.Queue[_Order] = asyncio.Queue(MOST_ORDERS)
        self._tasks: list[asyncio.Task[None]] = []
        self._lost = False
        self._sent, self._play_end = 0.0, 0.0
        self.problem: Exception | None = None
        """Why there are no gestures any more."""

    def media_time(self) -> float:
        """The media time that is played now, seconds."""
        return max(0.0, self._sent - max(0.0, self._play_end - time.monotonic()))

    def on_attached(self) -> None:
        """Connect."""
        super().on_attached()
        self._play_end = time.monotonic()
        self._tasks = [asyncio.create_task(self._work()), asyncio.create_task(self._tick())]

    def on_detached(self) -> None:
        """Let go of the server."""
        super().on_detached()
        self._lost = True
        for task in self._tasks:
            task.cancel()
        self._tasks = []

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        """Sound of the agent: to the server, and on."""
        await super().capture_frame(frame)
        sound = _mono(frame, self._hello.sample_rate)
        seconds = len(sound) / 2 / self._hello.sample_rate
        self._sent += seconds
        self._play_end = max(self._play_end, time.monotonic()) + seconds
        self._order(lambda stream: stream.send(sound))
        if self.next_in_chain is not None:
            await self.next_in_chain.capture_frame(frame)

    def flush(self) -> None:
        """The segment is complete."""
        super().flush()
        self._order(lambda stream: stream.idle(0.0))
        if self.next_in_chain is not None:
            self.next_in_chain.flush()

    def clear_buffer(self) -> None:
        """The agent was interrupted."""
        super().flush()  # the next frame begins another segment
        at = self.media_time()
        self._sent, self._play_end = at, time.monotonic()
        self._order(lambda stream: stream.interrupt(at))
        if self.next_in_chain is not None:
            self.next_in_chain.clear_buffer()

    def _order(self, order: _Order) -> None:
        if self._lost:
            return
        try:
            self._orders.put_nowait(order)
        except asyncio.QueueFull:
            self._lost = True

    async def _work(self) -> None:
        try:
            async with connect_resuming(self._url, self._hello, self._patience) as stream:
                sending = asyncio.create_task(self._obey(stream))
                try:
                    async for message in stream:
                        if isinstance(message, Poses):
                            await self._show(message, stream.welcome)
                finally:
                    sending.cancel()
                    await asyncio.gather(sending, return_exceptions=True)
        except (OSError, ValueError) as error:  # also every refusal
            self.problem = error
        finally:
            self._lost = True

    async def _obey(self, stream: ResumingStream) -> None:
        while True:
            await (await self._orders.get())(stream)

    async def _tick(self) -> None:
        """While nothing is said, media time goes on with the clock."""
        with contextlib.suppress(asyncio.CancelledError):
            while not self._lost:
                await asyncio.sleep(TICK_SECONDS)
                late = time.monotonic() - self._play_end
                if late > 0:
                    self._sent += late
                    self._play_end += late
                    self._order(_idle(late))


def _idle(seconds: float) -> _Order:
    return lambda stream: stream.idle(seconds)


def _mono(frame: Any, rate: int) -> bytes:
    """A frame as 16-bit mono sound at a rate; interpolated, which is enough for gestures."""
    samples = np.frombuffer(frame.data, np.int16).reshape(-1, frame.num_channels).mean(axis=1)
    if frame.sample_rate != rate and len(samples):
        places = np.arange(int(len(samples) * rate / frame.sample_rate)) * (frame.sample_rate / rate)
        samples = np.interp(places, np.arange(len(samples)), samples)
    return bytes(samples.astype("<i2").tobytes())
