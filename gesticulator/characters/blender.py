"""Runs scripts in Blender, in a separate process.

Blender is either a Python with the `bpy` wheel (this one, or another), or the program `blender`. Its start takes
seconds, so the jobs of one process, reading a character and writing it once for each recording, share one Blender
(`job_in_blender`).
"""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from data_module.errors import InputError

VARIABLE = "GESTICULATOR_BLENDER"
"""Environment variable with the path of the Blender, or the Python with bpy, to use."""
SECONDS = 1800
"""Time limit of a job, seconds: an hour of motion takes some minutes."""
_ADVICE = (f'pip install "gesticulator[fbx]" (Python 3.11), or install Blender, or name one in {VARIABLE}')


def blender() -> list[str] | None:
    """The start of a command that runs a Python script in Blender, up to the script's path; None without Blender."""
    named = os.environ.get(VARIABLE)
    if named:
        return _command(named)
    if importlib.util.find_spec("bpy") is not None:
        return _command(sys.executable)
    program = shutil.which("blender")
    return None if program is None else _command(program)


def check_blender(subject: Path) -> list[str]:
    """The command of `blender`; `InputError` about `subject` if Blender is not installed."""
    command = blender()
    if command is None:
        raise InputError(subject, "needs Blender, which is not installed", _ADVICE)
    return command


def _command(program: str) -> list[str]:
    if Path(program).name.lower().startswith("python"):
        return [program, "-s"]
    # --factory-startup: add-ons and preferences of the user must not change the output.
    return [program, "--background", "--factory-startup", "--python-use-system-env", "--python-exit-code", "1",
            "--python"]


def run_in_blender(subject: Path, script: Path, *arguments: str) -> str:
    """Run a script in Blender; returns its output. `InputError` about `subject` without Blender or if it fails.

    PYTHONHASHSEED is fixed because Blender's FBX exporter numbers objects by hashes of strings.
    """
    command = check_blender(subject)
    whole = [*command, str(script), *(["--"] if "--background" in command else []), *arguments]
    try:
        done = subprocess.run(whole, capture_output=True, text=True, errors="replace", timeout=SECONDS,
                              env=_environment(), check=False)
    except OSError as error:
        raise InputError(command[0], f"cannot be run ({error.strerror or error})", _ADVICE) from None
    except subprocess.TimeoutExpired:
        raise InputError(subject, f"took Blender more than {SECONDS} s", "give a shorter recording") from None
    if done.returncode:
        messages = (done.stderr or done.stdout).strip().splitlines()
        raise InputError(subject, f"was rejected by Blender ({messages[-1] if messages else 'no message'})", _ADVICE)
    return done.stdout


def _environment() -> dict[str, str]:
    """The environment of Blender: without PYTHONPATH, since Blender has its own Python and packages, and with a fixed
    seed for the hashes of strings."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PYTHONHASHSEED": "0"}


_JOBS = Path(__file__).with_name("blender_jobs.py")
_POLL = 0.02
"""Seconds between two looks for the outcome of a job."""


class _Worker:
    """A Blender that takes jobs, for one process."""

    def __init__(self, command: list[str]) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._log = (Path(self._folder.name) / "log.txt").open("w+b")
        self._count = 0
        self._process = subprocess.Popen([*command, str(_JOBS)], stdin=subprocess.PIPE, stdout=self._log,
                                         stderr=subprocess.STDOUT, env=_environment())

    def alive(self) -> bool:
        return self._process.poll() is None

    @property
    def folder(self) -> Path:
        """A temporary folder that is removed when this Blender ends."""
        return Path(self._folder.name)

    def run(self, script: Path, arguments: tuple[str, ...]) -> str:
        """Do a job; returns its error message, "" for none. TimeoutError after `SECONDS`."""
        self._count += 1
        outcome, pipe = self.folder / f"{self._count}.json", self._process.stdin
        assert pipe is not None
        with contextlib.suppress(OSError):  # one that has ended: the outcome says so
            pipe.write(json.dumps([str(script), str(outcome), *arguments]).encode() + b"\n")
            pipe.flush()
        until = time.monotonic() + SECONDS
        # The outcome is a file because Blender itself prints on standard output.
        while not outcome.exists():
            if not self.alive():
                return self._last_line()
            if time.monotonic() > until:
                self.close()
                raise TimeoutError
            time.sleep(_POLL)
        return str(json.loads(outcome.read_text(encoding="utf-8")))

    def _last_line(self) -> str:
        lines = Path(self._log.name).read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "no message"

    def close(self) -> None:
        """End Blender, which has no unfinished job unless it hangs."""
        self._process.kill()
        self._process.wait()
        self._log.close()
        self._folder.cleanup()


_workers: dict[tuple[int, tuple[str, ...]], _Worker] = {}
"""By process, since a fork must not talk into the pipe of its parent, and command."""


@atexit.register
def _close() -> None:
    for (process, _), worker in _workers.items():
        if process == os.getpid():
            worker.close()


def _worker(subject: Path) -> _Worker:
    """The Blender of this process, started if there is none. `InputError` about `subject` without Blender."""
    command = check_blender(subject)
    key = os.getpid(), tuple(command)
    try:
        if key not in _workers or not _workers[key].alive():
            _workers[key] = _Worker(command)
    except OSError as error:
        raise InputError(command[0], f"cannot be run ({error.strerror or error})", _ADVICE) from None
    return _workers[key]


def blender_folder(subject: Path) -> Path:
    """A folder for files of the Blender of this process, which is removed when it ends. `InputError` about `subject`
    without Blender."""
    return _worker(subject).folder


def job_in_blender(subject: Path, script: Path, *arguments: str) -> None:
    """As `run_in_blender`, in a Blender that stays for the next job of this process."""
    try:
        message = _worker(subject).run(script, arguments)
    except TimeoutError:
        raise InputError(subject, f"took Blender more than {SECONDS} s", "give a shorter recording") from None
    if message:
        raise InputError(subject, f"was rejected by Blender ({message.splitlines()[-1]})", _ADVICE)
