"""What a server does with the allocator of the system."""

from __future__ import annotations

import ctypes
import platform
import subprocess
import sys
from types import SimpleNamespace

import pytest

from gesticulator.serve.memory import limit_heap

GLIBC = platform.libc_ver()[0] == "glibc"
_PROGRAM = """
import ctypes, threading
from gesticulator.serve.memory import limit_heap

libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.free.argtypes = [ctypes.c_void_p]
if {limited}:
    limit_heap()
libc.free(libc.malloc(20_000_000))  # by itself, glibc then takes up to 20 MB from the heap
kept = libc.malloc(5_000_000)
go = threading.Barrier(8)

def work():
    libc.malloc(100_000)
    go.wait()

threads = [threading.Thread(target=work) for _ in range(8)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
libc.fopen.restype = ctypes.c_void_p
out = ctypes.c_void_p(libc.fopen(b"/dev/stdout", b"w"))
libc.malloc_info(0, out)
libc.fclose(out)
"""


@pytest.mark.skipif(not GLIBC, reason="only glibc has mallopt and malloc_info (Linux but Alpine)")
@pytest.mark.parametrize("limited", [False, True])
def test_a_limited_heap_is_one_and_gives_large_pieces_their_own_pages(limited: bool) -> None:
    """By glibc's own account, `malloc_info`."""
    told = subprocess.run([sys.executable, "-c", _PROGRAM.format(limited=limited)], capture_output=True, text=True,
                          check=True).stdout
    heaps = told.count("<heap nr=")
    pages = told.rpartition('<total type="mmap" count="')[2]
    count, size = int(pages.partition('"')[0]), int(pages.partition('size="')[2].partition('"')[0])
    assert (heaps == 1) == limited
    assert (count >= 1 and size >= 5_000_000) == limited


@pytest.mark.parametrize("library", [TypeError, OSError, SimpleNamespace()], ids=["Windows", "none", "without mallopt"])
def test_where_the_allocator_has_no_limits_nothing_happens(library: object, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(name: None) -> object:
        if isinstance(library, type):
            raise library("no such library")
        return library

    monkeypatch.setattr(ctypes, "CDLL", load)
    limit_heap()
