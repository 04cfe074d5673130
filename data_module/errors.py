"""Errors that a user can cause, and the one place that turns them into a line on the terminal."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

EXIT_BAD_INPUT = 2
EXIT_PIPE = 141


class InputError(Exception):
    """Something the user gave cannot be used.

    The message is one line that names the file (or the value), says what is wrong with it and what to do.
    """

    def __init__(self, subject: object, wrong: str, advice: str = "") -> None:
        self.subject, self.wrong, self.advice = str(subject), wrong, advice
        line = f"{subject}: {wrong}" + (f"; {advice}" if advice else "")
        super().__init__(" ".join(line.split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """So that one raised in a worker process arrives as it was."""
        return type(self), (self.subject, self.wrong, self.advice)


@contextlib.contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Print an `InputError`, or a failure of the disk, as one line and leave with exit code 2."""
    try:
        yield
    except InputError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(EXIT_BAD_INPUT) from None
    except BrokenPipeError:
        # Whoever read the output has seen enough (`| head`); what is still to be flushed has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(EXIT_PIPE) from None
    except OSError as error:
        where = error.filename or "output"
        print(f"{program}: {where}: {error.strerror or error}; check the path, its rights and the free space",
              file=sys.stderr)
        raise SystemExit(EXIT_BAD_INPUT) from None
    except KeyboardInterrupt:
        print(f"{program}: stopped", file=sys.stderr)
        raise SystemExit(130) from None
