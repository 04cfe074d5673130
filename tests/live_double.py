"""A stream that needs no models, to test what is around it: every frame tells its number by its first joint."""

import asyncio
import math
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from face_samples import at_rest

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Word
from gesticulator.body.motion_path import HISTORY
from gesticulator.face.visemes import VISEMES
from gesticulator.live.limits import ServerAddress, ServerLimits
from gesticulator.live.protocol import StreamRequest
from gesticulator.live.server import LiveServer
from gesticulator.live.session import Session
from gesticulator.live.vmc import VmcOutput
from gesticulator.plan.plan import Block, BlockDraw
from gesticulator.stream import StreamFrames, StreamState

Share = float | Callable[[], float]
"""Seconds of work for a second of sound."""
LOOK_AHEAD = 0.5
STEP = 0.4
"""Seconds of a wait that are computed at a time."""
TURN = 0.001
"""Radians about Y for each frame."""


class TellingStream:
    """Frame k turns the hips by k * TURN about Y; half a second of sound is looked ahead, and is a block."""

    skeleton = CHARACTER
    lacking = 0.05
    look_ahead = LOOK_AHEAD

    def __init__(self, request: StreamRequest, seconds: float = 0.0, share: Share = 0.0) -> None:
        self.request, self.seconds, self.share = request, seconds, share
        self.hurried, self.history, self.latency = False, HISTORY, "full"
        self.time = 0.0
        self.made = 0
        self.state = StreamState.IDLE
        self.words: list[Word] = []

    def steps(self, call: str, *arguments: Any) -> Generator[StreamFrames, None, None]:
        """A call in one step; waits in steps of 0.4 s, which end where they are closed."""
        if call not in ("idle", "think") or arguments[0] <= STEP:
            yield getattr(self, call)(*arguments)
            return
        for number in range(math.ceil(arguments[0] / STEP)):
            yield getattr(self, call)(min(STEP, arguments[0] - number * STEP))

    def feed(self, samples: np.ndarray) -> StreamFrames:
        share = self.share() if callable(self.share) else self.share
        time.sleep(self.seconds + share * len(samples) / self.request.sample_rate * (0.7 if self.hurried else 1.0))
        if samples.max(initial=0.0) > 0.999:
            raise RuntimeError("a model failed\nwith two lines")
        self.time += len(samples) / self.request.sample_rate
        self.state = StreamState.SPEAKING
        return self._until(self.time - LOOK_AHEAD)

    def pass_over(self, seconds: float) -> StreamFrames:
        self.time += seconds
        return self._all(StreamState.SPEAKING)

    def listen(self, samples: np.ndarray) -> StreamFrames:
        self.time += len(samples) / self.request.sample_rate
        return self._all(StreamState.LISTENING)

    def idle(self, seconds: float) -> StreamFrames:
        self.time += seconds
        return self._all(StreamState.IDLE)

    def think(self, seconds: float) -> StreamFrames:
        self.time += seconds
        return self._all(StreamState.THINKING)

    def interrupt(self, at: float | None = None) -> StreamFrames:
        if at is not None:
            if at < self.time - self.history:
                raise InputError("interrupt", "is too long ago", "give a later time")
            self.made = min(math.ceil(at * self.request.fps - 1e-6), self.made)
            self.time = min(at, self.made / self.request.fps)  # as in the stream, no further than there are frames
        return self._all(StreamState.IDLE)

    def adding(self, words: list[Word], *batch: int) -> Iterator[tuple[Word, ...]]:
        assert self.request.options.get("text"), "a stream without text takes no words"
        self.words += words
        yield tuple(words)

    def finish(self) -> StreamFrames:
        return self._until(self.time)

    def _all(self, state: StreamState) -> StreamFrames:
        self.state = state
        return self._until(self.time)

    def _until(self, seconds: float) -> StreamFrames:
        first, fps = self.made, self.request.fps
        self.made = max(int(seconds * fps + 1e-6), first)
        numbers = np.arange(first, self.made)
        turns = np.zeros((len(numbers), len(CHARACTER), 4))
        turns[..., 0] = 1.0
        turns[:, 0] = rotation.from_exponential_map(np.stack([0 * numbers, numbers * TURN, 0 * numbers], -1))
        blocks = tuple(Block(k * LOOK_AHEAD, (k + 1) * LOOK_AHEAD, k, k % 2 == 1, BlockDraw(0, 0, k))
                       for k in range(int(first / fps / LOOK_AHEAD), int(self.made / fps / LOOK_AHEAD)))
        face = None
        if self.request.options.get("face", "off") != "off":  # the mouth opens and shuts once a second
            face = at_rest(len(numbers), fps)
            face.visemes[:, VISEMES.index("aa")] = 0.5 - 0.5 * np.cos(2 * np.pi * numbers / fps)
            face.visemes[:, 0] -= face.visemes[:, VISEMES.index("aa")]
        return StreamFrames(first, fps, CHARACTER, turns, np.tile([0.0, 0.95, 0.0], (len(numbers), 1)), blocks, face)


def figure(server: LiveServer, name: str, **labels: str) -> float:
    """The value of a metric of a server; 0 if nothing was counted."""
    return server.metrics.registry.get_sample_value(f"gesticulator_{name}", labels) or 0.0


def opener(limits: ServerLimits, seconds: float = 0.0, share: Share = 0.0) -> Callable[[str, StreamRequest], Session]:
    """Opens sessions of telling streams; seconds: of work for each piece of sound; share: for each second of it."""
    def open_session(name: str, request: StreamRequest) -> Session:
        return Session(name, request, TellingStream(request, seconds, share), limits)

    return open_session


@contextmanager
def served(limits: ServerLimits, pages: Mapping[str, bytes], vmc: str | None = None, share: Share = 0.0,
           address: ServerAddress | None = None) -> Iterator[tuple[LiveServer, int]]:
    """A server of telling streams in a thread of its own, and its port; vmc: where poses are sent, too; share: of work;
    address: who may connect, at any free port unless it names one."""
    address = address or ServerAddress(port=0)
    listening = address.listen()
    server = LiveServer(address, limits, opener(limits, 0.0, share), None if vmc is None else VmcOutput(vmc), pages)
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=lambda: loop.run_until_complete(server.run(listening)))
    thread.start()
    try:
        yield server, listening.getsockname()[1]
    finally:
        loop.call_soon_threadsafe(server.stop)
        thread.join(20)
        loop.close()
