"""Work counted in calls: a bound that is the same on every machine, where one of seconds is not."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any


@dataclass
class Calls:
    """Calls of Python and C functions of this thread."""

    count: int = 0


@contextmanager
def counted_calls() -> Iterator[Calls]:
    """Count the calls that are made inside, by the interpreter's own hook for profilers."""
    calls = Calls()

    def count_call(_frame: FrameType, event: str, _argument: object) -> None:
        calls.count += event in ("call", "c_call")

    with profiled(count_call):
        yield calls


@contextmanager
def profiled(hook: Callable[[FrameType, str, Any], object]) -> Iterator[None]:
    """Call `hook` for every call and return inside, as `sys.setprofile` does."""
    before = sys.getprofile()
    sys.setprofile(hook)
    try:
        yield
    finally:
        sys.setprofile(before)
