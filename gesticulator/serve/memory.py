"""Gives back what ended streams leave behind, so that a server's memory does not grow with the number of streams.

The tasks of a connection, their exceptions and their frames refer to each other in circles, which hold the last minute
of poses of the stream (some MB). Only Python's collector frees circles, and only a full collection finds those that
lived for minutes. By itself it makes one when the objects that live long have grown by a quarter: with the half a
million objects of the libraries and models, after hundreds of streams, and each then stops all streams for half a
second. So what is loaded is taken out of its view, which makes a full collection a matter of milliseconds, and there is
one a moment after a stream ends.
"""

from __future__ import annotations

import ctypes
import functools
import gc
from collections.abc import Callable
from contextlib import suppress

RELEASE_SECONDS = 5.0
"""Seconds between two looks at whether streams have ended."""
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8
"""Numbers of parameters of glibc's `mallopt`."""
_OWN_PAGES = 1 << 20
"""Bytes from which a piece of memory gets pages of its own."""


def limit_heap() -> None:
    """Keep the heap of this process from growing with what passes through it; to be called before threads start.

    glibc gives each thread a heap of its own, and moves its threshold for pages of their own up to the largest array
    that was freed: a heap is then full of holes the size of arrays, which small objects between them keep."""
    with suppress(AttributeError, OSError, TypeError):  # musl, macOS, Windows
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_ARENA_MAX, 1)
        mallopt(_MMAP_THRESHOLD, _OWN_PAGES)


def freeze_loaded() -> None:
    """Take what this process has loaded out of the view of the collector, for good."""
    gc.collect()
    gc.freeze()


def release_ended() -> None:
    """Free what ended streams held, and give it back to the system. In a process in which `freeze_loaded` was not
    called it is left to Python, since it would stop all streams for half a second."""
    if gc.get_freeze_count():
        gc.collect()
        _trim()()


@functools.cache
def _trim() -> Callable[[], object]:
    """glibc keeps what is freed in the midst of its heap; other allocators have no such function."""
    try:
        return functools.partial(ctypes.CDLL(None).malloc_trim, ctypes.c_size_t(0))
    except (AttributeError, OSError, TypeError):  # musl, macOS, Windows
        return lambda: None
