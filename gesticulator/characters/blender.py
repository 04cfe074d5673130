"""Runs scripts in Blender, in a separate process.

Blender is either a Python with the `bpy` wheel (this one, or another), or the program `blender`. A job starts one,
which takes half a second.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

from data_module.errors import InputError, install_line

VARIABLE = "GESTICULATOR_BLENDER"
"""Environment variable with the path of the Blender, or the Python with bpy, to use."""
SCRIPT = Path(__file__).parents[1] / "export" / "blender_child.py"
"""The script that converts files."""
SECONDS = 1800
"""Time limit of a job, seconds: an hour of motion takes some minutes."""
_WARNING = "gesticulator: "
"""How the lines begin that `SCRIPT` prints for the user."""
_EXCEPTION = re.compile(r"[A-Za-z_.]*(Error|Exception|Interrupt|Exit): ")
_ADVICE = f"{install_line('fbx')} (Python 3.11), or install Blender, or name one in {VARIABLE}"


class BlenderWarning(UserWarning):
    """Something of a character that its FBX file lacks, or that Blender shows in another way than the file has it."""


def glb_of(path: Path) -> bytes:
    """The character of an FBX file at rest as GLB. `InputError` without Blender or if it cannot read the file."""
    if not path.is_file():
        raise InputError(path, "does not exist" if not path.exists() else "is not a regular file", "check the path")
    state = path.stat()
    return _converted(path, (state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=1)
def _converted(path: Path, changed: tuple[int, int]) -> bytes:
    """changed: tells the states of a file apart."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "character.glb"
        say(path, run_in_blender(path, SCRIPT, str(path.resolve()), str(target)))
        return target.read_bytes()


def say(path: Path, printed: str) -> None:
    """Give the warnings about a file among the lines that the script printed."""
    for line in printed.splitlines():
        if line.startswith(_WARNING):
            warnings.warn(BlenderWarning(f"{path.name}: {line.removeprefix(_WARNING)}"), stacklevel=5)


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
        messages = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
        # The exception itself: Blender adds lines on the places in its own code.
        reason = next((line for line in reversed(messages) if _EXCEPTION.match(line)), messages[-1])
        advice = "export it as binary FBX, or as GLB" if "ASCII FBX" in reason \
            else "open it in Blender, and export it again"
        raise InputError(subject, f"was rejected by Blender ({reason})", advice)
    return done.stdout
