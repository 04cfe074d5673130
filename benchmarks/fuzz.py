"""Every reader of files against damaged files: how many end in anything but an answer or a refusal.

    python benchmarks/fuzz.py --inputs 10000 --seed N [--only NAME]

The samples and the ways to damage them are those of `tests/reader_cases.py`. Each reader works in a process of its own
under a limit of memory. An input fails where reading it raises anything but `InputError` (or the two refusals that
corpora and the server document), prints a message of several lines or with control characters, takes over 5 seconds or
over 1 GB, or ends the process.
"""

import argparse
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SECONDS, GIGABYTES = 5.0, 1.0
"""What one reading may take."""
FORK = multiprocessing.get_context("fork")
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


def child(name: str, seed: int, first: int, count: int, results: Connection) -> None:
    """Try inputs `first` to `count` of one reader. Sends the number of each that begins, with "", and of each that
    fails, with what is wrong; `count` at the end."""
    import resource

    from reader_cases import READERS

    # What libraries print of a damaged file is of no interest.
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
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
            results.send((number, ""))
            data = damaged(content, random.Random(f"{seed} {name} {number}"))
            for other in folder.rglob("*"):
                if other.is_file() and other not in beside:
                    other.unlink()
            for other, old in beside.items():
                other.write_bytes(old)
            case.packed(file, data)
            wrong = outcome(case.read, file)
            if wrong:
                results.send((number, wrong))
    results.send((count, ""))


class Child:
    """A process that tries one reader. It is forked, since importing every library again takes seconds."""

    def __init__(self, name: str, seed: int, count: int) -> None:
        self.name, self.seed, self.count = name, seed, count
        self.failed: list[tuple[int, str]] = []
        self.begin(0)

    def begin(self, first: int) -> None:
        """Try the inputs from `first` on."""
        self.at = first
        self.results, theirs = FORK.Pipe(duplex=False)
        self.process = FORK.Process(target=child, args=(self.name, self.seed, first, self.count, theirs))
        self.process.start()
        theirs.close()

    def step(self) -> bool:
        """Take a result of the process; False when all is done."""
        try:
            self.at, wrong = self.results.recv()
        except (EOFError, OSError):  # at the end, or in the middle of a result
            self.results.close()
            self.process.join()
            if self.at == self.count:
                return False
            self.failed.append((self.at, f"the process ended with {self.process.exitcode}"))
            self.begin(self.at + 1)
        else:
            if wrong:
                self.failed.append((self.at, wrong))
        return True


def main() -> int:
    """Exit code 1 where an input failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000, help="damaged files of all readers together")
    parser.add_argument("--seed", type=int, required=True, help="of the damage")
    parser.add_argument("--only", help="the readers whose names hold this text")
    parser.add_argument("--workers", type=int, default=2, help="readers at a time")
    asked = parser.parse_args()
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

    from reader_cases import READERS

    import gesticulator.live.protocol  # noqa: F401 - once for all children

    names = [name for name in READERS if asked.only is None or asked.only in name]
    shares = {name: asked.inputs // len(names) + (at < asked.inputs % len(names)) for at, name in enumerate(names)}
    found: dict[str, list[tuple[int, str]]] = {}
    waiting, running = list(reversed(names)), dict[Connection, Child]()
    while waiting or running:
        while waiting and len(running) < asked.workers:
            name = waiting.pop()
            one = Child(name, asked.seed, shares[name])
            running[one.results] = one
        for results in wait(list(running)):
            one = running.pop(results)
            if one.step():
                running[one.results] = one
                continue
            found[one.name] = one.failed
            print(f"{one.name}: {one.count} inputs, {len(one.failed)} failures", flush=True)
            for wrong, times in Counter(wrong for _, wrong in one.failed).items():
                print(f"    {times} x {wrong} (input {next(n for n, w in one.failed if w == wrong)})", flush=True)
    failures = sum(map(len, found.values()))
    print(f"all: {asked.inputs} inputs of seed {asked.seed}, {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
