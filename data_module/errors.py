"""Errors that a user can cause, and their conversion to a line on the terminal."""

from __future__ import annotations

import contextlib
import io
import os
import re
import reprlib
import sys
from collections.abc import Iterator

__all__ = ["PROJECT", "InputError", "complain", "install_line", "one_line_errors"]

PROJECT = "gesticulator"
"""The distribution, and the first part of every group of its entry points."""

LONGEST_REASON = 500
"""Longest description of an error, characters: some four lines of a terminal."""
EXIT_BAD_INPUT = 2
EXIT_PIPE, EXIT_STOPPED = 128 + 13, 128 + 2
"""Exit codes of a program ended by SIGPIPE (13) and by SIGINT (2)."""
# Extra of each package that is imported without a check before (`registry.Requirement`).
EXTRAS = {"torch": "train", "librosa": "train", "sklearn": "train", "matplotlib": "figures", "PIL": "video"}
# Control characters, which can clear a terminal or change its title, and those that hide text or change its direction.
_INVISIBLE = re.compile("[\x00-\x1f\x7f-\x9f\u200b\u200e\u200f\u2028-\u202e\u2060\u2066-\u2069\ufeff\ud800-\udfff]")


class InputError(Exception):
    """Input of the user that cannot be used. The message is one line that names the file (or the value), says what is
    wrong with it and what to do."""

    def __init__(self, subject: object, wrong: str, advice: str = "") -> None:
        # It may contain content of a file, as long as the file.
        wrong = wrong if len(wrong) <= LONGEST_REASON else wrong[:LONGEST_REASON - 3] + "..."
        self.subject, self.wrong, self.advice = str(subject), wrong, advice
        line = f"{subject}: {wrong}" + (f"; {advice}" if advice else "")
        super().__init__(printable(" ".join(line.split())))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        return type(self), (self.subject, self.wrong, self.advice)


def printable(text: str) -> str:
    """Escape control characters and halves of characters in a text from outside, such as \\x1b."""
    return _INVISIBLE.sub(lambda match: match.group().encode("unicode_escape").decode(), text)


def shown(value: object, width: int = 40) -> str:
    """A value from a file in at most `width` characters, for a message; fast for long and deep values."""
    # Plain values as they are; reprlib bounds the time that long and deep ones take.
    text = value if isinstance(value, str) else str(value) if isinstance(value, float | bool) or value is None \
        else reprlib.repr(value)
    return printable(text[:width])[:width]


def install_line(extra: str) -> str:
    """The command that installs an extra from where this distribution came from, as pip noted it (PEP 610): a folder,
    a wheel or a repository; without a note from the package index. With "-e" where pip had it."""
    import json  # these two for this line alone: they would delay each command
    from importlib import metadata

    with contextlib.suppress(metadata.PackageNotFoundError):
        if note := metadata.distribution(PROJECT).read_text("direct_url.json"):
            url, about = (origin := json.loads(note))["url"], origin.get("vcs_info") or {}
            return f'pip install -e "{url.removeprefix("file://")}[{extra}]"' if "editable" in note else \
                f'pip install "{PROJECT}[{extra}] @ {about.get("vcs", "")}{"+" if about else ""}{url}"'
    return f'pip install "{PROJECT}[{extra}]"'


def one_line(error: InputError | OSError | MemoryError | ImportError) -> str:
    """The error in a line without the program's name; for any but an `InputError` with advice."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError):
        return printable(f"{error.filename or 'output'}: {error.strerror or error}; "
                         "check the path, its rights and the free space")
    reason = " ".join(str(error).split())[:LONGEST_REASON]
    if isinstance(error, MemoryError):
        return printable(f"memory: there is too little{f' ({reason})' if reason else ''}; "
                         "give a shorter recording or a smaller file, or close other programs")
    name = error.name or "a package"
    extra = EXTRAS.get(name.partition(".")[0])
    remedy = f"run {install_line(extra)}" if extra else "install gesticulator again"
    return printable(f"{name}: cannot be imported ({reason}); {remedy}")


@contextlib.contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Print an `InputError`, a failure of the disk, lack of memory or a missing package as one line and exit with 2.

    Printing within it never fails because of a character: one that the terminal's encoding lacks, or an invalid byte in
    a file name, is written as a \\x escape.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
    except BrokenPipeError:
        # The reader of the output has closed it (`| head`): discard what is still to be flushed.
        if sys.stdout is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(EXIT_PIPE) from None
    except (InputError, OSError, MemoryError, ImportError) as error:
        complain(f"{program}: {one_line(error)}")
        raise SystemExit(EXIT_BAD_INPUT) from None
    except KeyboardInterrupt:
        complain(f"{program}: stopped")
        raise SystemExit(EXIT_STOPPED) from None


def complain(line: str) -> None:
    """Print a line on standard error, if it is open; characters that its encoding lacks, and invalid bytes in file
    names, are written as \\x escapes."""
    stream = sys.stderr
    if stream is None:  # it was closed before the program began; print() would write to standard output instead
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    line = "\n".join(map(printable, line.split("\n")))
    line = f"{line:<79}" if stream.isatty() else line  # over a status
    # An encoding error would print a traceback in place of the message.
    with contextlib.suppress(OSError, ValueError):  # closed since
        print(line.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)
