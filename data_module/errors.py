"""Errors that a user can cause, and the one place that turns them into a line on the terminal."""

from __future__ import annotations

import contextlib
import io
import os
import reprlib
import sys
from collections.abc import Iterator

__all__ = ["InputError", "complain", "one_line_errors"]

LONGEST_REASON = 500
"""Characters of what is wrong: some four lines of a terminal."""
EXIT_BAD_INPUT = 2
EXIT_PIPE = 141
"""What a shell reports of a program that SIGPIPE (13) ended: 128 + 13."""
EXIT_STOPPED = 130
"""The same of one that SIGINT (2) ended."""


class InputError(Exception):
    """Something the user gave cannot be used.

    The message is one line that names the file (or the value), says what is wrong with it and what to do.
    """

    def __init__(self, subject: object, wrong: str, advice: str = "") -> None:
        # What a file says may be part of it, and may be as long as the file.
        wrong = wrong if len(wrong) <= LONGEST_REASON else wrong[:LONGEST_REASON - 3] + "..."
        self.subject, self.wrong, self.advice = str(subject), wrong, advice
        line = f"{subject}: {wrong}" + (f"; {advice}" if advice else "")
        super().__init__(" ".join(line.split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """So that one raised in a worker process arrives as it was."""
        return type(self), (self.subject, self.wrong, self.advice)


def shown(value: object, width: int = 40) -> str:
    """A value that was read, in `width` characters at most, for a message: however long or deep, it costs no time."""
    return (str(value) if isinstance(value, str | float | bool) or value is None else reprlib.repr(value))[:width]


def one_line(error: InputError | OSError) -> str:
    """What is wrong, in a line without the program's name; a failure of the disk says what to check."""
    if isinstance(error, InputError):
        return str(error)
    return f"{error.filename or 'output'}: {error.strerror or error}; check the path, its rights and the free space"


@contextlib.contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Print an `InputError`, or a failure of the disk, as one line and leave with exit code 2.

    What is printed within it never fails for the sake of a character: one that the terminal's encoding lacks, or a byte
    of a file's name that is no text, is written as a \\x escape.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
    except InputError as error:
        complain(f"{program}: {one_line(error)}")
        raise SystemExit(EXIT_BAD_INPUT) from None
    except BrokenPipeError:
        # Whoever read the output has seen enough (`| head`); what is still to be flushed has nowhere to go.
        if sys.stdout is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(EXIT_PIPE) from None
    except OSError as error:
        complain(f"{program}: {one_line(error)}")
        raise SystemExit(EXIT_BAD_INPUT) from None
    except KeyboardInterrupt:
        complain(f"{program}: stopped")
        raise SystemExit(EXIT_STOPPED) from None


def complain(line: str) -> None:
    """Print a line on standard error, whatever it can show and whether or not it is there.

    Characters that its encoding lacks, and bytes of a file's name that are no text, are written as \\x escapes.
    """
    stream = sys.stderr
    if stream is None:  # it was closed before the program began; print() would write to standard output instead
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    # A line that broke off its own encoding would end in a traceback in place of the message.
    with contextlib.suppress(OSError, ValueError):  # closed since
        print(line.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)
