"""Runs scripts in Blender, in a separate process.

Blender is either a Python with the `bpy` wheel (this one, or another), or the program `blender`. A job starts one,
which takes half a second.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
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
    """Run a script in Blender; returns its output. `InputError` about `subject` without Blender or if it fails."""
    command = check_blender(subject)
    whole = [*command, str(script), *(["--"] if "--background" in command else []), *arguments]
    # Blender has its own Python and packages, and its FBX exporter numbers objects by hashes of strings.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PYTHONHASHSEED": "0"}
    try:
        done = subprocess.run(whole, capture_output=True, text=True, errors="replace", timeout=SECONDS,
                              env=environment, check=False)
    except OSError as error:
        raise InputError(command[0], f"cannot be run ({error.strerror or error})", _ADVICE) from None
    except subprocess.TimeoutExpired:
        raise InputError(subject, f"took Blender more than {SECONDS} s", "give a shorter recording") from None
    if done.returncode:
        messages = (done.stderr or done.stdout).strip().splitlines()
        raise InputError(subject, f"was rejected by Blender ({messages[-1] if messages else 'no message'})", _ADVICE)
    return done.stdout
