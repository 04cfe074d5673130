"""A limit for what must never hang, far above what it takes on any processor."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def never_hangs(seconds: float = 30.0) -> Iterator[None]:
    """TimeoutError where the body takes so many seconds, a thousand times what it should.

    For input on which an algorithm of a higher order takes minutes to hours, and the right one milliseconds: it tells
    the two apart whatever the processor and whatever else runs there. Where there is no alarm (Windows), no limit.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"not done after {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
