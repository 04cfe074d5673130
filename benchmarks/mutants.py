"""Do the tests notice a wrong formula? One-line mutants, each with the test file that must kill it.

    python benchmarks/mutants.py [--only SUBSTRING]

A mutant replaces a fragment of one line of a formula. Its test file runs on a temporary copy of the tree, never on the
checkout, with `pytest -x -n 0`. It is killed when a test fails within the limit, 60 s of processor time, that passes
again without it; a mutant that breaks the import, or a test that fails without it, proves nothing and counts as an
error. Exit code 1 if one survives, is in error, or if its fragment does not occur exactly once in its file.

`--only` runs the mutants whose formula, file or test contains the substring. Each run of pytest is a fork of a process
that has loaded the libraries once, which halves the time; Linux and macOS alone can do that.
"""

import argparse
import importlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LIMIT = 60.0
"""Seconds of processor time in which a test file must kill its mutant."""
PATIENCE = 5.0
"""Times the limit on the clock, after which a run is stopped: the machine may be busy with other work."""
PACKAGES = {"data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval"}
LIBRARIES = ("numpy", "torch", "scipy.stats", "scipy.signal", "scipy.ndimage", "scipy.spatial.transform", "scipy.fft",
             "sklearn.cluster", "librosa", "soxr", "soundfile", "hypothesis.strategies", "pytest")
KILLED, SURVIVED, ERROR = "killed", "survived", "error"


@dataclass(frozen=True)
class Mutant:
    """A wrong formula. formula: its name in words; file: where it stands; fragment: a part of one line of it;
    replacement: what stands there instead; test: the file that must notice."""

    formula: str
    file: str
    fragment: str
    replacement: str
    test: str

    def occurrences(self, root: Path = ROOT) -> int:
        """How often the fragment occurs in its file; 0 where the file is missing."""
        path = root / self.file
        return path.read_text(encoding="utf-8").count(self.fragment) if path.is_file() else 0

    @property
    def haystack(self) -> str:
        """What `--only` searches."""
        return f"{self.formula} {self.file} {self.test}"


TABLE = Path(__file__).with_suffix(".toml")
MUTANTS = tuple(Mutant(**row) for row in tomllib.loads(TABLE.read_text(encoding="utf-8"))["mutant"])


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant, the processor seconds that its test file took, and which test killed it, or why none."""

    verdict: str
    seconds: float
    note: str = ""


def copied_tree(target: Path) -> None:
    """The files of the checkout that git does not ignore, as they are now."""
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                            check=True, capture_output=True).stdout.decode().split("\0")
    for name in filter(None, listed):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, target / name)


def load_libraries() -> None:
    """Import what nearly every test file imports and no mutant touches: forks need not do it again."""
    for name in LIBRARIES:
        importlib.import_module(name)
    own = sorted({name.split(".")[0] for name in sys.modules} & PACKAGES)
    if own:
        raise RuntimeError(f"{', '.join(own)} would be the checkout's in every fork, without mutants")


@dataclass(frozen=True)
class Ended:
    """How a run of pytest ended. code: None where it was stopped; seconds: of the processor; failed: the test that
    failed first, empty for none; output: its last lines."""

    code: int | None
    seconds: float
    failed: str
    output: str


class FirstFailure:
    """A plugin of pytest that writes down which test fails first."""

    def __init__(self, note: Path) -> None:
        self.note = note

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Called by pytest for each phase of each test."""
        if report.failed and not self.note.exists():
            self.note.write_text(report.nodeid, encoding="utf-8")


def run_tests(tree: Path, tests: str) -> Ended:
    """Run a test file of a tree, or one test of it."""
    with tempfile.TemporaryDirectory() as folder:
        output, note = Path(folder) / "output", Path(folder) / "failed"
        child = os.fork()
        if child == 0:
            os.setsid()
            stream = os.open(output, os.O_WRONLY | os.O_CREAT)
            os.dup2(stream, 1)
            os.dup2(stream, 2)
            os._exit(pytest_in(tree, tests, FirstFailure(note)))
        code, seconds = awaited(child)
        lines = output.read_text(encoding="utf-8", errors="replace").splitlines() if output.exists() else []
        failed = note.read_text(encoding="utf-8") if note.exists() else ""
    return Ended(code, seconds, failed, "\n".join(lines[-15:]))


def pytest_in(tree: Path, tests: str, plugin: FirstFailure) -> int:
    """Exit code of pytest in this process, which sees the packages of a tree alone."""
    os.chdir(tree)
    checkout = {str(ROOT), str(ROOT / "benchmarks")}
    sys.path[:] = [str(tree), *(path for path in sys.path if path not in checkout)]
    os.environ |= {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    import pytest

    code = int(pytest.main(["-x", "-n", "0", "-q", "--no-header", "-p", "no:cacheprovider", tests], [plugin]))
    sys.stdout.flush()
    return code


def awaited(child: int) -> tuple[int | None, float]:
    """Exit code and processor seconds of a child, with the children that it waited for; it is stopped, code None, after
    `PATIENCE` limits on the clock."""
    until = time.monotonic() + PATIENCE * LIMIT
    while time.monotonic() < until:
        ended, status, used = os.wait4(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    _, _, used = os.wait4(child, 0)
    return None, used.ru_utime + used.ru_stime


def tried(mutant: Mutant, tree: Path) -> Outcome:
    """Run a mutant's test file on the copied tree with its line replaced, and put the line back.

    A test that fails for another reason kills nothing: the one that failed must pass once the line is put back.
    """
    count = mutant.occurrences(tree)
    if count != 1:
        return Outcome(ERROR, 0.0, f"its fragment occurs {count} times in {mutant.file}")
    path = tree / mutant.file
    original = path.read_text(encoding="utf-8")
    try:
        write_source(path, original.replace(mutant.fragment, mutant.replacement))
        ended = run_tests(tree, mutant.test)
    finally:
        write_source(path, original)
    if ended.code == 0:
        return Outcome(SURVIVED, ended.seconds)
    if ended.code is None or ended.seconds > LIMIT:
        return Outcome(SURVIVED, ended.seconds, f"not noticed within {LIMIT:g} s")
    if ended.code != 1:
        return Outcome(ERROR, ended.seconds, f"pytest ended with {ended.code}:\n{ended.output}")
    again = run_tests(tree, ended.failed)
    if again.code != 0:
        return Outcome(ERROR, ended.seconds, f"{ended.failed} fails without the mutant, too:\n{again.output}")
    return Outcome(KILLED, ended.seconds, ended.failed.partition("::")[2])


def write_source(path: Path, text: str) -> None:
    """Write a module without leaving compiled code behind that has its time stamp and size."""
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()
    path.write_text(text, encoding="utf-8")


def judged(mutants: Iterable[Mutant]) -> dict[Mutant, Outcome]:
    """Each mutant's outcome, printed as it comes."""
    load_libraries()
    outcomes: dict[Mutant, Outcome] = {}
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copied_tree(tree)
        for mutant in mutants:
            outcome = outcomes[mutant] = tried(mutant, tree)
            print(f"{outcome.verdict:8}  {outcome.seconds:5.1f} s  {mutant.file}: {mutant.formula}"
                  + (f"\n{'':20}{outcome.note}" if outcome.note else ""), flush=True)
    return outcomes


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--only", default="", metavar="SUBSTRING", help="of the formula, the file or the test")
    asked = p.parse_args(arguments)
    chosen = [mutant for mutant in MUTANTS if asked.only in mutant.haystack]
    if not chosen:
        p.error(f"no mutant matches {asked.only!r}")
    started = time.perf_counter()
    outcomes = judged(chosen)
    killed = sum(outcome.verdict == KILLED for outcome in outcomes.values())
    print(f"{killed} of {len(outcomes)} killed in {time.perf_counter() - started:.0f} s")
    return 0 if killed == len(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
