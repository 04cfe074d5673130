"""Blender, where it is installed, as a process of its own: what it imports and exports needs no code of ours.

It is either a Python that has the `bpy` wheel (this one, or another), or the program `blender`.
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
"""Environment variable that names the Blender, or the Python with bpy, to use."""
SECONDS = 1800
"""The longest that a job may take: an hour of motion takes some minutes."""
_ADVICE = (f'pip install "gesticulator[fbx]" (Python 3.11), or install Blender, or name one in {VARIABLE}')


def blender() -> list[str] | None:
    """The beginning of a command that runs a Python script in Blender, up to the script's path; None without one."""
    named = os.environ.get(VARIABLE)
    if named:
        return _command(named)
    if importlib.util.find_spec("bpy") is not None:
        return _command(sys.executable)
    found = shutil.which("blender")
    return None if found is None else _command(found)


def check_blender(subject: Path) -> list[str]:
    """The command of `blender`; `InputError` about `subject` where there is none."""
    command = blender()
    if command is None:
        raise InputError(subject, "needs Blender, which is not installed", _ADVICE)
    return command


def _command(program: str) -> list[str]:
    if Path(program).name.lower().startswith("python"):
        return [program, "-s"]
    return [program, "--background", "--factory-startup", "--python-use-system-env", "--python-exit-code", "1",
            "--python"]


def run_in_blender(subject: Path, script: Path, *arguments: str) -> str:
    """Run a script in Blender; what it printed. `InputError` about `subject` where there is no Blender or it failed.

    Strings are hashed the same in every run (PYTHONHASHSEED), since Blender's FBX numbers its objects by hashes.
    """
    command = check_blender(subject)
    whole = [*command, str(script), *(["--"] if "--background" in command else []), *arguments]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PYTHONHASHSEED": "0"}
    try:
        done = subprocess.run(whole, capture_output=True, text=True, errors="replace", timeout=SECONDS,
                              env=environment, check=False)
    except OSError as error:
        raise InputError(command[0], f"cannot be run ({error.strerror or error})", _ADVICE) from None
    except subprocess.TimeoutExpired:
        raise InputError(subject, f"was not done by Blender in {SECONDS} s", "give a shorter recording") from None
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines()
        raise InputError(subject, f"was refused by Blender ({said[-1] if said else 'no message'})", _ADVICE)
    return done.stdout
