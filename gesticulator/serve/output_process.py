"""VMC and OSC from a process of their own: what the server computes holds Python's lock, and each datagram of a frame
would wait for it.

The server hands frames to a thread, which writes them into a pipe, so that nothing here makes it wait. The process
needs no models; it ends with the server, however that ends, and is replaced if it dies.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import queue
import signal
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import wait
from typing import TYPE_CHECKING

from gesticulator.serve.vmc import SentFrames

if TYPE_CHECKING:
    from multiprocessing.connection import Connection as Pipe
    from multiprocessing.process import BaseProcess

    from gesticulator.serve.vmc import VmcOutput
    from gesticulator.stream import StreamFrames

LOG = logging.getLogger("gesticulator.serve")
_MOST_WAITING = 1000
"""Messages that wait for the process: a minute and more of blocks. Beyond, frames are dropped."""
_AGAIN_SECONDS = 5.0
"""Least time between two starts of the process."""
_END_SECONDS = 5.0
"""Time for the process to end."""


_Message = tuple[str, SentFrames | None] | None
"""A stream with frames, or without for its end; None for the end of all."""


class OutputProcess:
    """A `VmcOutput` in a process of its own; see `PoseOutput`."""

    def __init__(self, make: Callable[[], VmcOutput]) -> None:
        """make: the output, picklable, and known to be valid."""
        self._make = make
        self._context = multiprocessing.get_context("spawn")
        self._waiting: queue.Queue[_Message] = queue.Queue(_MOST_WAITING)
        self._writer = threading.Thread(target=self._write, name="outputs", daemon=True)
        self._process: BaseProcess | None = None
        self._pipe: Pipe | None = None
        self._born = 0.0

    def start(self) -> None:
        """Start the process, and the thread that writes to it."""
        self._spawn()
        self._writer.start()

    def stop(self) -> None:
        """End the process, with what it has not played."""
        with contextlib.suppress(queue.Full):
            self._waiting.put(None, timeout=_END_SECONDS)
        self._writer.join(_END_SECONDS)
        if self._process is not None:
            self._process.join(_END_SECONDS)
            self._process.kill()
            self._process.join()

    def take(self, stream: str, frames: StreamFrames) -> None:
        """Add at least one frame of a stream."""
        self._put((stream, SentFrames(frames.first, frames.motion(), frames.face)))

    def leave(self, stream: str) -> None:
        """End a stream. Its remaining frames are played unless another stream adds frames."""
        self._put((stream, None))

    def _put(self, message: _Message) -> None:
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(message)

    def _spawn(self) -> None:
        theirs, self._pipe = self._context.Pipe(duplex=False)
        self._process = self._context.Process(target=_play, args=(self._make, theirs), name="gesticulator-output",
                                              daemon=True)
        self._process.start()
        self._born = time.monotonic()
        theirs.close()

    def _write(self) -> None:
        while (message := self._waiting.get()) is not None:
            try:
                assert self._pipe is not None
                self._pipe.send(message)
            except OSError:
                if time.monotonic() - self._born >= _AGAIN_SECONDS:
                    LOG.warning("the process that sends poses died; another takes its place")
                    self._spawn()
        if self._pipe is not None:
            self._pipe.close()


def _play(make: Callable[[], VmcOutput], pipe: Pipe) -> None:
    """Main function of the process: play what comes until the pipe or the server ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal, which means the server
    import gesticulator.export.vrma  # noqa: F401  # now, not when the first frame is due

    server = multiprocessing.parent_process()
    ends = [] if server is None else [server.sentinel]
    output = make()
    output.start()
    with contextlib.suppress(EOFError, OSError):
        while pipe in wait([pipe, *ends]):
            stream, frames = pipe.recv()
            if frames is None:
                output.leave(stream)
            else:
                output.take(stream, frames)
    output.stop()
