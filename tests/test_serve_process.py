"""The command `gesticulator serve`: its errors and its token; a server's whole life is in `test_deploy.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

from gesticulator.cli import Parser
from gesticulator.live.command import COMMAND, read_token


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
