"""The log of a server whose standard error is not read: events do not wait, and what was dropped is counted."""

from __future__ import annotations

import io
import logging
import os
import re
import threading
import time

from gesticulator.serve.log import WaitlessHandler


def _log(handler: logging.Handler) -> logging.Logger:
    log = logging.Logger("of the test")
    log.addHandler(handler)
    return log


def test_lines_come_out_in_order_and_are_written_at_the_end() -> None:
    stream = io.StringIO()
    handler = WaitlessHandler(stream)
    log = _log(handler)
    for number in range(500):
        log.info("line %d", number)
    handler.close()
    assert stream.getvalue().splitlines() == [f"line {number}" for number in range(500)]


def test_a_reader_who_stands_still_holds_no_event_up() -> None:
    """A pipe takes 64 kB; then a write to it waits for its reader."""
    out, into = os.pipe()
    with os.fdopen(into, "w") as stream, os.fdopen(out) as reader:
        handler = WaitlessHandler(stream, lines=50)
        log = _log(handler)
        for number in range(5000):
            log.info("%d %s", number, "x" * 100)
        lines: list[str] = []

        def read() -> None:
            lines.extend(line.rstrip() for line in reader)

        reading = threading.Thread(target=read)
        reading.start()
        while handler.queue.qsize():
            time.sleep(0.001)
        log.info("after it")
        handler.close()
        stream.close()
        reading.join()
    assert lines[-1] == "after it"
    dropped = sum(int(found.group(1)) for line in lines if (found := re.match(r"(\d+) lines were dropped", line)))
    written = [int(line.split()[0]) for line in lines if line.endswith("x")]
    assert dropped > 1000 and written == sorted(written)
    assert dropped + len(written) == 5000
    assert written[:50] == list(range(50)), "as many as may wait"


def test_a_stream_that_is_closed_ends_nothing() -> None:
    stream = io.StringIO()
    handler = WaitlessHandler(stream)
    stream.close()
    log = _log(handler)
    log.info("unheard")
    handler.close()
    log.info("unheard")
