"""A Ray cluster that loses parts: the driver, a worker that is slow, and in the end its head. Nothing is lost or done
twice, and nothing is half-written."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import soundfile
from ports import free_port

from data_module.build import main
from data_module.errors import EXIT_BAD_INPUT, InputError
from data_module.files import remove_unfinished_of, write_bytes
from data_module.motion import skeletons
from data_module.motion.bvh import write_bvh
from gesticulator.batch import TaskOutcome
from gesticulator.manifest import DONE, FAILED, read_manifest

pytest.importorskip("ray", reason="Ray is not installed: pip install 'gesticulator[scale]'")
if not Path("/proc/self/stat").exists():
    pytest.skip("processes are looked up as on Linux", allow_module_level=True)
from gesticulator import ray_pool

ROOT = Path(__file__).resolve().parent.parent
SPEECH = ROOT / "examples" / "speech.flac"
NAMES = tuple(f"clip_{place}" for place in range(5))
BAD = "clip_2"
DRIVER = """
import os, sys
from gesticulator import cli
from gesticulator import manifest
add = manifest.Manifest.add
def add_and_kill(self, row):
    add(self, row)
    {}
manifest.Manifest.add = add_and_kill
sys.exit(cli.main(sys.argv[1:]))
"""
"""A driver that does something when it has noted a row."""


def begun(folder: Path) -> tuple[int, subprocess.Popen[bytes]]:
    """The port and the process of a head that has begun. Ray gives up where its own processes are not there within
    30 s, as on a machine that does much else: it is tried again."""
    for _ in range(3):
        port = free_port()
        said = folder / f"head-{port}.log"
        folder.mkdir(exist_ok=True)
        command = [str(Path(sys.executable).parent / "ray"), "start", "--head", "--block", f"--port={port}",
                   "--num-cpus=2", "--include-dashboard=false", f"--temp-dir={folder}"]
        with said.open("wb") as log:
            head = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        deadline = time.monotonic() + 120
        while head.poll() is None and time.monotonic() < deadline:
            if b"Ray runtime started" in said.read_bytes():
                return port, head
            time.sleep(0.1)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(head.pid, signal.SIGKILL)
        head.wait()
    pytest.fail(said.read_text())


def end_head(head: int) -> None:
    """Kill the head of a cluster, and wait until its workers, whom nobody kills, have noticed."""
    parents, below = {}, {head}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[int(file.parent.name)] = int(file.read_text().rpartition(")")[2].split()[1])
    while more := {pid for pid, parent in parents.items() if parent in below} - below:
        below |= more
    with contextlib.suppress(ProcessLookupError):
        os.killpg(head, signal.SIGKILL)
    deadline = time.monotonic() + 120
    while any(_lives(pid) for pid in below) and time.monotonic() < deadline:
        time.sleep(0.1)


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.fixture(scope="module")
def head() -> Iterator[tuple[str, int]]:
    """The address and the group of processes of the head of a cluster of two workers; --ray auto finds it."""
    # The name of a socket may have 107 characters.
    folder = Path(f"/tmp/ray-{os.getpid()}")
    told = {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0", "OMP_NUM_THREADS": "1",
            "PYTHONPATH": os.pathsep.join([str(ROOT), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in told.items():
            patch.setenv(name, value)
        port, process = begun(folder)
        patch.setenv("RAY_ADDRESS", f"127.0.0.1:{port}")
        yield f"127.0.0.1:{port}", process.pid
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five recordings of one to two seconds, of which one has no sound."""
    folder, rng = tmp_path_factory.mktemp("source"), np.random.default_rng(0)
    samples, rate = soundfile.read(SPEECH, dtype="int16")
    for place, name in enumerate(NAMES):
        frames = 60 + 12 * place
        write_bvh(folder / f"{name}.bvh", skeletons.from_vector(np.cumsum(rng.normal(0, 0.004, (frames, 48)), 0), 60.0))
        soundfile.write(folder / f"{name}.flac", samples[place * rate:place * rate + frames * rate // 60], rate)
    (folder / f"{BAD}.flac").write_bytes(b"no sound")
    return folder


@pytest.fixture(scope="module")
def plain(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a build by one process writes."""
    out = tmp_path_factory.mktemp("plain") / "store"
    assert main(["folder", "--source", str(source), "--out", str(out), "--workers", "1"]) == 0
    return contents(out)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def build(source: Path, out: Path, ray: str, *, noting: str = "pass") -> subprocess.CompletedProcess[str]:
    """A driver that builds on Ray and runs a line of code whenever it notes a row."""
    command = [sys.executable, "-c", DRIVER.format(noting), "build", "folder", "--source", str(source), "--out",
               str(out), "--ray", ray]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


def check_store(out: Path, plain: dict[str, bytes]) -> None:
    """The store is whole and the same, and every recording has a row."""
    assert contents(out) == plain
    (notes,) = out.parent.glob(f"{out.name}.manifest.*")
    rows = read_manifest(notes)
    assert {name: row.status for name, row in rows.items()} == dict.fromkeys(NAMES, DONE) | {BAD: FAILED}
    assert "clip_2.flac" in rows[BAD].error
    assert {file.name for file in out.parent.iterdir()} == {out.name, notes.name}


def test_a_driver_that_is_killed_leaves_only_what_is_missing(head: tuple[str, int], source: Path,
                                                             plain: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "store"
    assert build(source, out, "auto", noting="os.kill(os.getpid(), 9)").returncode == -signal.SIGKILL
    assert not out.exists() and len(read_manifest(next(tmp_path.glob("*.journal")).with_suffix(""))) == 1
    done = build(source, out, head[0])
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split(" recordings were there already")[0].rsplit("(", 1)[1]) >= 1
    check_store(out, plain)


# ----------------------------------------------------------------------------------------------- a worker that is slow

def _write(folder: Path, number: int) -> float:
    """Whoever comes first is slow for ever, and is in the middle of writing; all others are quick."""
    with contextlib.suppress(FileExistsError):
        (folder / "slow").touch(exist_ok=False)
        (folder / f".{number}.out.{number:012x}").touch()
        time.sleep(600)
    time.sleep(0.05)
    with (folder / "done").open("a") as done:
        done.write(f"{number}\n")
    write_bytes(folder / f"{number}.out", b"made")
    return 1.0


def _writer(folder: Path) -> Callable[[int], float]:
    return partial(_write, folder)


def test_a_slow_worker_does_not_hold_up_the_end(head: tuple[str, int], tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_pool, "SLOW_SECONDS", 0.5)
    outcomes: list[TaskOutcome] = list(ray_pool.done_on_ray(head[0], partial(_writer, tmp_path), range(6)))
    assert sorted(one.number for one in outcomes) == list(range(6)) and not any(one.error for one in outcomes)
    assert outcomes[-1].number in (0, 1), "the one that was begun first, done again"
    assert sorted((tmp_path / "done").read_text().split()) == sorted(map(str, range(6))), "nothing else is done twice"
    remove_unfinished_of(tmp_path / f"{number}.out" for number in range(6))
    assert not list(tmp_path.glob(".*"))


def _cannot(folder: Path) -> Callable[[int], float]:
    raise InputError(folder, "is not on this machine", "mount it")


def test_a_worker_that_cannot_begin_is_told_once(head: tuple[str, int], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a worker: cannot do its work .*is not on this machine"):
        list(ray_pool.done_on_ray(head[0], partial(_cannot, tmp_path), range(100)))


# ---------------------------------------------------------------------------------------------------------- the head

def test_a_head_that_is_killed_is_told_and_the_next_run_goes_on(head: tuple[str, int], source: Path,
                                                                plain: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "store"
    # A worker has one recording at a time, so two are left when the workers have noticed.
    lost = build(source, out, head[0], noting=f"import test_ray_faults as own; own.end_head({head[1]})")
    assert lost.returncode == EXIT_BAD_INPUT and not out.exists()
    said = lost.stderr.strip().splitlines()
    assert [line for line in said if line.startswith("gesticulator: --ray")] == said[-1:] and "is lost" in said[-1]
    with pytest.raises(InputError, match="cannot be reached"):
        list(ray_pool.done_on_ray(head[0], partial(_writer, tmp_path), [0]))
    done = build(source, out, "auto")  # there is none now: on this machine
    assert done.returncode == 0, done.stderr
    check_store(out, plain)
