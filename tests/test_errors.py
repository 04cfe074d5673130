"""What a user did wrong is one line, whatever the terminal can show."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from data_module.errors import EXIT_BAD_INPUT, InputError, shown

_FAIL = """
from data_module.errors import InputError, one_line_errors
with one_line_errors("program"):
    raise InputError("Gr\\u00fc\\u00dfe \\u65e5.wav", "is bad", "mend it")
"""
_FAIL_ON_BYTES = _FAIL.replace("Gr\\u00fc\\u00dfe \\u65e5.wav", "a\\udcff.wav")
_FAIL_ON_DISK = """
from data_module.errors import one_line_errors
with one_line_errors("program"):
    open("/nowhere/\\udcff.wav")
"""


@pytest.mark.parametrize("encoding", ["ascii:strict", "utf-8:strict", "latin-1:strict"])
@pytest.mark.parametrize(("code", "said"), [
    (_FAIL, {"ascii:strict": b"program: Gr\\xfc\\xdfe \\u65e5.wav: is bad; mend it\n",
             "utf-8:strict": "program: Grüße 日.wav: is bad; mend it\n".encode(),
             "latin-1:strict": "program: Grüße \\u65e5.wav: is bad; mend it\n".encode("latin-1")}),
    (_FAIL_ON_BYTES, b"program: a\\udcff.wav: is bad; mend it\n"),
    (_FAIL_ON_DISK, b"program: /nowhere/\\udcff.wav: No such file or directory; "
                    b"check the path, its rights and the free space\n"),
])
def test_names_that_the_terminal_cannot_show_are_one_line(encoding: str, code: str, said: bytes | dict[str, bytes]
                                                          ) -> None:
    # Python's own standard error never fails; one that was opened anew, as a test runner or a service does, can.
    name, _, errors = encoding.partition(":")
    anew = f"import sys\nsys.stderr = open(2, 'w', encoding={name!r}, errors={errors!r}, closefd=False)\n"
    done = subprocess.run([sys.executable, "-c", anew + code], capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (EXIT_BAD_INPUT, b"")
    assert done.stderr == (said[encoding] if isinstance(said, dict) else said)


@pytest.mark.skipif(sys.platform == "win32", reason="a shell's way to close a stream")
def test_an_error_does_not_go_to_the_output_where_there_is_no_terminal() -> None:
    done = subprocess.run(["/bin/sh", "-c", '"$0" -c "$1" 2>&-', sys.executable, _FAIL], capture_output=True,
                          check=False)
    assert (done.returncode, done.stdout) == (EXIT_BAD_INPUT, b"")


@pytest.mark.parametrize("encoding", ["ascii:strict", "utf-8:strict"])
def test_what_a_command_prints_never_fails_for_a_character(encoding: str) -> None:
    code = ("from data_module.errors import one_line_errors\n"
            "with one_line_errors('program'):\n    print('Gr\\u00fc\\u00dfe a\\udcff.bvh')\n")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False,
                          env=os.environ | {"PYTHONIOENCODING": encoding})
    assert (done.returncode, done.stderr) == (0, b"")
    name = b"Gr\\xfc\\xdfe" if encoding.startswith("ascii") else "Grüße".encode()
    assert done.stdout == name + b" a\\udcff.bvh\n"


def test_what_is_long_or_deep_is_shown_short() -> None:
    deep: list[object] = []
    for _ in range(900):
        deep = [deep]
    assert shown("text") == "text" and shown(1.5) == "1.5" and shown(True) == "True"
    for value in ("x" * 1000, 10 ** 4000, deep, {"a": deep}):
        assert len(shown(value)) <= 40


def test_a_message_is_one_line() -> None:
    assert str(InputError("a\nb", "is\r\nwrong\x0b", "")) == "a b: is wrong"
