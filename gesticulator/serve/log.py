"""The server's log, which must not stop the server: a pipe that is not read any more blocks what writes to it."""

from __future__ import annotations

import contextlib
import logging
import queue
import sys
import threading
from logging.handlers import QueueHandler
from typing import TextIO

LINES = 10_000
"""Lines that may wait to be written; later ones are dropped, and their number is written in their place."""
CLOSE_SECONDS = 2.0
"""Time for the lines that wait when the process ends."""


class WaitlessHandler(QueueHandler):
    """Writes to a stream in a thread of its own, so that no event waits for the reader of the stream."""

    def __init__(self, stream: TextIO | None = None, lines: int = LINES) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue(lines)
        super().__init__(self._lines)
        self._stream = sys.stderr if stream is None else stream
        self._dropped = 0
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def prepare(self, record: logging.LogRecord) -> str:
        """The line of an event."""
        return self.format(record)

    def enqueue(self, line: str) -> None:  # type: ignore[override]
        """Let the line of an event wait, or drop it if too many do."""
        try:
            if self._dropped:
                self._lines.put_nowait(f"{self._dropped} lines were dropped: standard error was not read")
                self._dropped = 0
            self._lines.put_nowait(line)
        except queue.Full:
            self._dropped += 1

    def close(self) -> None:
        """Write what waits, for a bounded time."""
        if self._thread.is_alive():
            with contextlib.suppress(queue.Full):
                self._lines.put(None, timeout=CLOSE_SECONDS)
                self._thread.join(CLOSE_SECONDS)
        super().close()

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                self._stream.write(line + "\n")
                self._stream.flush()
            except (OSError, ValueError):  # the stream is closed
                return


def log_to_stderr(log: logging.Logger) -> None:
    """Print a log on standard error, one line per event."""
    handler = WaitlessHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    for old in log.handlers:
        old.close()
    log.handlers[:] = [handler]
    log.setLevel(logging.INFO)
    log.propagate = False
