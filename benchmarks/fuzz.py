"""Every reader of files against damaged files: how many end in anything but an answer or a refusal.

    python benchmarks/fuzz.py --inputs 10000 --seed N [--only NAME]

The samples and the ways to damage them are those of `tests/reader_cases.py`. Each reader works in a process of its own
under a limit of memory. An input fails where reading it raises anything but `InputError` (or the two refusals that
corpora and the server document), prints a message of several lines or with control characters, takes over 5 seconds or
over 1 GB, or ends the process.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SECONDS, GIGABYTES = 5.0, 1.0
"""What one reading may take."""
_ADDRESSES = 8 << 30
"""Bytes of address space beyond what the process has when it begins: libraries map much more than they use."""


class TooLongError(BaseException):
    """A reading took over `SECONDS`; no reader catches it by mistake."""


def _stop(*_: object) -> None:
    raise TooLongError


def _peak() -> float:
    """Bytes that this process has held at most since `_reset_peak`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return 0.0


def _reset_peak() -> float:
    """Begin to measure anew; bytes that are held now."""
    Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def damaged(content: bytes, rng: random.Random) -> bytes:
    """The bytes of a sample, damaged one to four times."""
    from reader_cases import DAMAGE

    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        rng.choice(DAMAGE)(data, rng.random(), rng.random(), rng.randrange(16))
    return bytes(data)


def outcome(read: Any, file: Path) -> str:
    """"" where a file is read, or refused as documented; else what is wrong."""
    from data_module.corpora.base import DroppedError
    from data_module.errors import InputError, printable
    from gesticulator.live.protocol import RefusedError

    held, begun = _reset_peak(), time.process_time()
    signal.setitimer(signal.ITIMER_REAL, 12 * SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read(file)
        message = ""
    except (InputError, DroppedError) as error:
        message = str(error)
        if "\n" in message or message != printable(message):
            return "message of several lines or with control characters"
    except RefusedError:
        pass
    except TooLongError:
        return f"over {SECONDS:g} s"
    except BaseException as error:  # noqa: BLE001 - whatever it is, it is what is counted
        return f"{type(error).__name__}: {str(error)[:120]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if time.process_time() - begun > SECONDS:
        return f"over {SECONDS:g} s"
    return f"over {GIGABYTES:g} GB" if _peak() - held > GIGABYTES * 1e9 else ""


def child(name: str, seed: int, first: int, count: int) -> None:
    """Inputs `first` to `count` of one reader; a line for each that begins, and for each that fails."""
    import resource

    from reader_cases import READERS

    case = READERS[name]
    signal.signal(signal.SIGALRM, _stop)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        file = case.sample(folder)
        content = case.content(file)
        case.read(file)
        beside = {other: other.read_bytes() for other in folder.rglob("*") if other.is_file()}
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + _ADDRESSES, resource.RLIM_INFINITY))
        for number in range(first, count):
            print(json.dumps({"begins": number}), flush=True)
            data = damaged(content, random.Random(f"{seed} {name} {number}"))
            for other in folder.rglob("*"):
                if other.is_file() and other not in beside:
                    other.unlink()
            for other, old in beside.items():
                other.write_bytes(old)
            case.packed(file, data)
            wrong = outcome(case.read, file)
            if wrong:
                print(json.dumps({"number": number, "wrong": wrong}), flush=True)
    print(json.dumps({"ends": True}), flush=True)


class Child:
    """A process that tries one reader. It is forked, since importing every library again takes seconds."""

    def __init__(self, name: str, seed: int, count: int) -> None:
        self.name, self.seed, self.count = name, seed, count
        self.failed: list[tuple[int, str]] = []
        self.begin(0)

    def begin(self, first: int) -> None:
        """Try the inputs from `first` on."""
        self.at, self.ended = first, first >= self.count
        ours, theirs = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(ours)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(theirs, 1)
            os.dup2(quiet, 2)
            try:
                child(self.name, self.seed, first, self.count)
            finally:
                os._exit(1)
        os.close(theirs)
        self.lines = os.fdopen(ours, "rb", buffering=0)  # so that select() sees every line

    def step(self) -> bool:
        """Read a line of the child; False when all is done."""
        line = self.lines.readline()
        if line:
            told = json.loads(line) if line.startswith(b"{") else {}
            self.at, self.ended = told.get("begins", self.at), self.ended or "ends" in told
            if "wrong" in told:
                self.failed.append((told["number"], told["wrong"]))
            return True
        self.lines.close()
        _, status = os.waitpid(self.pid, 0)
        if self.ended:
            return False
        self.failed.append((self.at, f"the process ended with {os.waitstatus_to_exitcode(status)}"))
        if self.at + 1 < self.count:
            self.begin(self.at + 1)
            return True
        return False


def main() -> int:
    """Exit code 1 where an input failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000, help="damaged files of all readers together")
    parser.add_argument("--seed", type=int, required=True, help="of the damage")
    parser.add_argument("--only", help="the readers whose names hold this text")
    parser.add_argument("--workers", type=int, default=2, help="readers at a time")
    asked = parser.parse_args()
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    import select

    from reader_cases import READERS

    import gesticulator.live.protocol  # noqa: F401 - once for all children

    names = [name for name in READERS if asked.only is None or asked.only in name]
    shares = {name: asked.inputs // len(names) + (at < asked.inputs % len(names)) for at, name in enumerate(names)}
    found: dict[str, list[tuple[int, str]]] = {}
    waiting, running = list(reversed(names)), dict[int, Child]()
    while waiting or running:
        while waiting and len(running) < asked.workers:
            name = waiting.pop()
            one = Child(name, asked.seed, shares[name])
            running[one.lines.fileno()] = one
        for handle in select.select(list(running), [], [])[0]:
            one = running.pop(handle)
            if one.step():
                running[one.lines.fileno()] = one
                continue
            found[one.name] = one.failed
            print(f"{one.name}: {one.count} inputs, {len(one.failed)} failures", flush=True)
            for wrong, times in Counter(wrong for _, wrong in one.failed).items():
                print(f"    {times} x {wrong} (input {next(n for n, w in one.failed if w == wrong)})", flush=True)
    failures = sum(map(len, found.values()))
    print(f"all: {asked.inputs} inputs, {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
