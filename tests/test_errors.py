"""What a user did wrong is one line, whatever the terminal can show."""

import subprocess
import sys

import pytest

from data_module.errors import EXIT_BAD_INPUT, InputError, complain, install_line, one_line, one_line_errors, shown

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


def test_what_is_long_or_deep_is_shown_short() -> None:
    deep: list[object] = []
    for _ in range(900):
        deep = [deep]
    assert shown("text") == "text" and shown(1.5) == "1.5" and shown(True) == "True"
    for value in ("x" * 1000, 10 ** 4000, deep, {"a": deep}):
        assert len(shown(value)) <= 40


@pytest.mark.parametrize(("given", "printed"), [
    ("\x1b]0;title\x07.wav", r"\x1b]0;title\x07.wav"), ("a\x9b2J", r"a\x9b2J"), ("\u202egpj.wav", r"\u202egpj.wav"),
    ("\ufeffa\x7f\0", r"\ufeffa\x7f\x00"), ("Gr\u00fc\u00dfe \u65e5\u672c \u0645\u06cc\u200c\u062e", None),
])
def test_control_characters_are_printed_as_escapes(given: str, printed: str | None, capsys: pytest.CaptureFixture[str]
                                                    ) -> None:
    printed = given if printed is None else printed
    assert str(InputError(given, "is bad", "mend it")) == f"{printed}: is bad; mend it"
    assert one_line(OSError(2, "No such file", given)).startswith(f"{printed}: No such file")
    assert shown(given) == printed[:40]
    complain(f"program: {given}")
    assert capsys.readouterr().err == f"program: {printed}\n"


@pytest.mark.parametrize(("raised", "line"), [
    (MemoryError("Unable to allocate 119. GiB"), "program: memory: there is too little (Unable to allocate 119. "
     "GiB); give a shorter recording or a smaller file, or close other programs\n"),
    (MemoryError(), "program: memory: there is too little; give a shorter recording or a smaller file, or close "
     "other programs\n"),
    (ModuleNotFoundError("No module named 'PIL'", name="PIL"), "program: PIL: cannot be imported "
     f"(No module named 'PIL'); run {install_line('video')}\n"),
])
def test_too_little_memory_and_lacking_packages_are_one_line(raised: Exception, line: str,
                                                             capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, one_line_errors("program"):
        raise raised
    assert (ended.value.code, capsys.readouterr().err) == (EXIT_BAD_INPUT, line)


def test_a_message_is_one_line() -> None:
    assert str(InputError("a\nb", "is\r\nwrong\x0b", "")) == "a b: is wrong"
