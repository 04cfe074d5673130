"""Run inside Blender: take jobs from standard input until it ends, so that several need one start of Blender.

A line is a JSON list: the script, the file to which the outcome is written, and the arguments of the script. The
outcome is "" or the message of the error, as JSON. It imports nothing from this package: Blender has its own Python.
"""

from __future__ import annotations

import contextlib
import json
import os
import runpy
import sys
from pathlib import Path


def main() -> None:
    """Work until the other end closes the pipe."""
    with contextlib.suppress(ImportError):  # a second, which jobs would wait for
        import bpy  # type: ignore[import-not-found, unused-ignore]  # noqa: F401
    for line in sys.stdin:
        script, outcome, *arguments = json.loads(line)
        sys.argv = [script, "--", *arguments]
        message = ""
        try:
            runpy.run_path(script, run_name="__main__")
        except Exception as error:  # noqa: BLE001 - one job that fails must not end the others
            message = f"{type(error).__name__}: {error}"
        part = Path(f"{outcome}.part")
        part.write_text(json.dumps(message), encoding="utf-8")
        os.replace(part, outcome)


if __name__ == "__main__":
    main()
