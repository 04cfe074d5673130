"""The server as a process: it starts, shares a socket among workers, and ends with code 0."""

from __future__ import annotations

import asyncio
import os
import platform
import queue
import re
import signal
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pipecat_gesticulator import Hello, Poses, connect

from gesticulator.cli import Parser
from gesticulator.live.command import COMMAND, read_token

GLIBC = platform.libc_ver()[0] == "glibc"
ROOT = Path(__file__).resolve().parents[1]
PROGRAM = "import sys; from gesticulator.live.command import COMMAND; " \
          "sys.exit(COMMAND.main('gesticulator serve', sys.argv[1:]))"
RATE = 16000
_PATIENCE = 300.0
"""Seconds for a line: three processes that start on a core that ten others share took more than 100."""


class Served:
    """A server's process and what it printed."""

    def __init__(self, *arguments: str) -> None:
        self.lines: list[str] = []
        """All of them, as they come."""
        self._new: queue.Queue[str | None] = queue.Queue()
        plain = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
        self.process = subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments], cwd=ROOT, text=True,
                                        stderr=subprocess.PIPE, env=plain)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.port = int(self.await_line(r"listening on ws://127.0.0.1:(\d+)/stream").group(1))

    def _read(self) -> None:
        """Takes every line at once: a server that nobody reads would come to stop."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.rstrip())
            self._new.put(line)
        self._new.put(None)

    def await_line(self, pattern: str) -> re.Match[str]:
        """The next line that has the pattern."""
        try:
            while (line := self._new.get(timeout=_PATIENCE)) is not None:
                if found := re.search(pattern, line):
                    return found
        except queue.Empty:
            self.process.kill()
        raise AssertionError(f"no line has {pattern}: {self.lines}")

    def get(self, path: str) -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=_PATIENCE) as answer:
            return answer.read().decode()

    def end(self) -> None:
        """Stop it as a service manager does."""
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(_PATIENCE) == 0
        self._reader.join()


@contextmanager
def served(*arguments: str) -> Iterator[Served]:
    at = Served("--port", "0", "--drain-seconds", "5", *arguments)
    try:
        yield at
    except BaseException:
        print("the server's lines:", *at.lines, sep="\n")
        raise
    finally:
        if at.process.poll() is None:
            at.process.kill()
            at.process.wait()


def speech(seconds: float) -> bytes:
    """A voice of syllables: five a second of a buzz, with pauses."""
    t = np.arange(int(seconds * RATE)) / RATE
    loud = np.clip(np.sin(2 * np.pi * 2.5 * t), 0, 1) * (np.sin(2 * np.pi * 0.25 * t) > -0.7)
    return (8000 * loud * np.sign(np.sin(2 * np.pi * 120 * t))).astype("<i2").tobytes()


async def talk(port: int, sound: bytes) -> list[Poses]:
    async with connect(f"ws://127.0.0.1:{port}/stream", Hello(RATE, seed=5)) as stream:
        for start in range(0, len(sound), RATE // 5):
            await stream.send(sound[start:start + RATE // 5])
        await stream.finish()
        return [message async for message in stream if isinstance(message, Poses)]


def joined(poses: list[Poses]) -> np.ndarray:
    return np.concatenate([one.rotations for one in poses])


def test_a_single_server_ends_with_code_0_in_the_middle_of_a_stream() -> None:
    with served("--drain-seconds", "0.3") as at:
        at.await_line("INFO ready")

        async def test() -> list[Poses]:
            async with connect(f"ws://127.0.0.1:{at.port}/stream", Hello(RATE)) as stream:
                await stream.send(speech(1.5))
                poses = []
                async for message in stream:
                    if isinstance(message, Poses):
                        if not poses:  # the sound, one message, was received
                            at.process.send_signal(signal.SIGTERM)
                        poses.append(message)
                return poses

        assert len(joined(asyncio.run(test()))) == 90, "what was received is answered first"
        assert at.process.wait(_PATIENCE) == 0


@pytest.mark.parametrize(("arguments", "wrong"), [
    (["--port", "99999"], "port 99999"), (["--host", "no.such.host.invalid"], "no.such.host.invalid"),
    (["--host", "0.0.0.0"], "--token-file"), (["--streams", "0"], "limits.streams"),
    (["--vmc", "nowhere"], "HOST:PORT"),
    (["--bundle", "/no/such/folder"], "is not a folder"), (["--drain-seconds", "nan"], "limits.drain_seconds"),
    (["--threads", "0"], "--threads")])
def test_what_cannot_be_served_is_told_in_one_line(arguments: list[str], wrong: str,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        COMMAND.main("gesticulator serve", ["--port", "0", *arguments])
    assert ended.value.code == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "listening" not in line]
    assert len(lines) == 1 and wrong in lines[0]


def test_the_token_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parser = Parser()
    COMMAND.arguments(parser)
    file = tmp_path / "token"
    file.write_text("sesame\n")
    assert read_token(parser.parse_args(["--token-file", str(file)])) == "sesame"
    assert read_token(parser.parse_args([])) == ""
    monkeypatch.setenv("GESTICULATOR_TOKEN", "other")
    assert read_token(parser.parse_args(["--host", "0.0.0.0"])) == "other"
