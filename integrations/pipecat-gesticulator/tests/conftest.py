"""A gesticulator server for the tests.

It is the one that GESTICULATOR_URL names, or one that is started: by GESTICULATOR_COMMAND (run in GESTICULATOR_ROOT),
or by `gesticulator` on the path.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def started(*options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A server at a free port: its URL and its process, once it is ready."""
    command = os.environ.get("GESTICULATOR_COMMAND") or shutil.which("gesticulator")
    if command is None:
        pytest.skip("no server to test against: pip install gesticulator, or name its command in GESTICULATOR_COMMAND")
    place = os.environ.get("GESTICULATOR_ROOT")
    server = subprocess.Popen([*shlex.split(command), "serve", "--port", "0", *options],
                              stderr=subprocess.PIPE, text=True, cwd=place,
                              env={**os.environ, "PYTHONPATH": place} if place else None)
    assert server.stderr is not None
    found = None
    for line in server.stderr:
        found = found or re.search(r"ws://\S+/stream", line)
        if line.rstrip().endswith("ready"):
            break
    if found is None:
        pytest.skip("the server did not start")
    yield found.group(), server
    server.send_signal(signal.SIGTERM)
    assert server.wait(60) == 0


@pytest.fixture(scope="session")
def url() -> Iterator[str]:
    server = os.environ.get("GESTICULATOR_URL")
    if server:
        yield server
        return
    with started() as (found, _):
        yield found
