"""The property that every reader of files must have: damaged files give an error of one line, soon and in little space.
"""

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from reader_cases import Case, damages

from data_module.corpora.base import DroppedError
from data_module.errors import InputError
from gesticulator.live.protocol import RefusedError

resource = pytest.importorskip("resource", reason="what a process has taken is POSIX's to tell")

CALLS, MEGABYTES = 500_000, 500.0
"""What one reading may take: calls of Python and C functions, not seconds, which differ between machines."""
EXAMPLES = int(os.environ.get("GESTICULATOR_FUZZ", "20"))
"""Damaged files per reader; the variable is for a longer search."""


def _peak() -> float:
    """Megabytes that this process has held at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _held() -> float:
    """Megabytes that it holds now, where the system tells; else what it has held at most."""
    file = Path("/proc/self/statm")
    return int(file.read_text().split()[1]) * resource.getpagesize() / 1e6 if file.is_file() else _peak()


@contextmanager
def counted_calls() -> Iterator[list[str]]:
    """The calls of Python and C functions that this thread makes inside, by the interpreter's own hook for profilers:
    a bound on their number is the same on every machine, where one of seconds is not."""
    calls: list[str] = []
    before = sys.getprofile()
    sys.setprofile(lambda _frame, event, _argument: calls.append(event) if event in ("call", "c_call") else None)
    try:
        yield calls
    finally:
        sys.setprofile(before)


def check_damaged(case: Case, tmp_path: Path) -> None:
    """Reads the sample of a case and damaged forms of it; only errors of one line may come out, within the bounds."""
    file = case.sample(tmp_path)
    content = case.content(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case.read(file)
    beside = {other: other.read_bytes() for other in tmp_path.rglob("*") if other.is_file()}

    @settings(max_examples=max(5, round(case.examples * EXAMPLES)), deadline=None, database=None, derandomize=True,
              phases=(Phase.generate, Phase.shrink), suppress_health_check=list(HealthCheck))
    @given(damages())
    def survives(wanted: list[tuple[Callable[..., None], float, float, int]]) -> None:
        data = bytearray(content)
        for damage, a, b, choice in wanted:
            damage(data, a, b, choice)
        for other, old in beside.items():
            other.write_bytes(old)
        case.packed(file, bytes(data))
        said = ""
        before, peak = _held(), _peak()
        try:
            with warnings.catch_warnings(), counted_calls() as calls:
                warnings.simplefilter("ignore")
                warnings.filterwarnings("error", category=RuntimeWarning)
                case.read(file)
        except (InputError, DroppedError, RefusedError) as error:
            said = str(error)
        assert "\n" not in said and len(said) < 1000 + len(str(tmp_path))
        grown = _peak() - before if _peak() > peak else 0.0
        assert len(calls) < CALLS and grown < MEGABYTES, f"{len(calls)} calls, {grown:.0f} MB"

    survives()
