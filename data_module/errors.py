"""Errors that a user can cause, and the one place that turns them into a line on the terminal."""

from __future__ import annotations

import contextlib
import io
import os
import re
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
_INVISIBLE = re.compile("[\x00-\x1f\x7f-\x9f\u200b\u200e\u200f\u2028-\u202e\u2060\u2066-\u2069\ufeff]")
"""Control characters, with which a terminal clears its screen or changes its title, and those that hide text or turn
its direction."""


class InputError(Exception):
    """Something the user gave cannot be used.

    The message is one line that names the file (or the value), says what is wrong with it and what to do.
    """

    def __init__(self, subject: object, wrong: str, advice: str = "") -> None:
        # What a file says may be part of it, and may be as long as the file.
        wrong = wrong if len(wrong) <= LONGEST_REASON else wrong[:LONGEST_REASON - 3] + "..."
        self.subject, self.wrong, self.advice = str(subject), wrong, advice
        line = f"{subject}: {wrong}" + (f"; {advice}" if advice else "")
        super().__init__(printable(" ".join(line.split())))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """So that one raised in a worker process arrives as it was."""
        return type(self), (self.subject, self.wrong, self.advice)


def printable(text: str) -> str:
    """A text from outside as it may be printed: control characters become escapes such as \\x1b."""
    return _INVISIBLE.sub(lambda match: match.group().encode("unicode_escape").decode(), text)


def shown(value: object, width: int = 40) -> str:
    """A value that was read, in `width` characters at most, for a message: however long or deep, it costs no time."""
    text = value if isinstance(value, str) else str(value) if isinstance(value, float | bool) or value is None \
        else reprlib.repr(value)
    return printable(text[:width])[:width]


def one_line(error: InputError | OSError) -> str:
    """What is wrong, in a line without the program's name; a failure of the disk says what to check."""
    if isinstance(error, InputError):
        return str(error)
    return printable(f"{error.filename or 'output'}: {error.strerror or error}; "
                     "check the path, its rights and the free space")


@contextlib.contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Print an `InputError`, a failure of the disk, too little memory or a package that lacks as one line and leave
    with exit code 2.

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
    except MemoryError as error:
        complain(f"{program}: {_out_of_memory(error)}")
        raise SystemExit(EXIT_BAD_INPUT) from None
    except ImportError as error:
        complain(f"{program}: {_not_installed(error)}")
        raise SystemExit(EXIT_BAD_INPUT) from None
    except KeyboardInterrupt:
        complain(f"{program}: stopped")
        raise SystemExit(EXIT_STOPPED) from None


def _out_of_memory(error: MemoryError) -> str:
    reason = " ".join(str(error).split())[:LONGEST_REASON]
    return printable(f"memory: there is too little of it{f' ({reason})' if reason else ''}; "
                     "give a shorter recording or a smaller file, or close other programs")


def _not_installed(error: ImportError) -> str:
    reason = " ".join(str(error).split())[:LONGEST_REASON]
    return printable(f"{error.name or 'a package'}: cannot be imported ({reason}); install gesticulator again with the "
                     "extra that needs it")


def complain(line: str) -> None:
    """Print a line on standard error, whatever it can show and whether or not it is there.

    Characters that its encoding lacks, and bytes of a file's name that are no text, are written as \\x escapes.
    """
    stream = sys.stderr
    if stream is None:  # it was closed before the program began; print() would write to standard output instead
        return
    encoding = getattr(stream, "encoding", None) or "utf-8"
    line = "\n".join(map(printable, line.split("\n")))
    # A line that broke off its own encoding would end in a traceback in place of the message.
    with contextlib.suppress(OSError, ValueError):  # closed since
        print(line.encode(encoding, "backslashreplace").decode(encoding), file=stream, flush=True)
