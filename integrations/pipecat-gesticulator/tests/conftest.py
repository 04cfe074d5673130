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

import pytest


@pytest.fixture(scope="session")
def url() -> Iterator[str]:
    told = os.environ.get("GESTICULATOR_URL")
    if told:
        yield told
        return
    command = os.environ.get("GESTICULATOR_COMMAND") or shutil.which("gesticulator")
    if command is None:
        pytest.skip("no gesticulator on the path, and GESTICULATOR_URL is not set")
    place = os.environ.get("GESTICULATOR_ROOT")
    server = subprocess.Popen([*shlex.split(command), "serve", "--port", "0"], stderr=subprocess.PIPE, text=True,
                              cwd=place, env={**os.environ, "PYTHONPATH": place} if place else None)
    assert server.stderr is not None
    found = None
    for line in server.stderr:
        found = found or re.search(r"ws://\S+/stream", line)
        if "is ready" in line:
            break
    if found is None:
        pytest.skip("the server did not start")
    yield found.group()
    server.send_signal(signal.SIGTERM)
    assert server.wait(30) == 0
