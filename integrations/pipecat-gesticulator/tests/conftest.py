"""A gesticulator server for the tests: the one that GESTICULATOR_URL names, or one of `gesticulator` on the path."""

from __future__ import annotations

import os
import re
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
    program = shutil.which("gesticulator")
    if program is None:
        pytest.skip("no gesticulator on the path, and GESTICULATOR_URL is not set")
    server = subprocess.Popen([program, "serve", "--port", "0"], stderr=subprocess.PIPE, text=True)
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
