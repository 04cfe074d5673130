"""Atomic writing of files, reading of text and JSON files within limits, and locks on folders."""

import codecs
import contextlib
import csv
import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import socket
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
from filelock import FileLock, Timeout

from data_module.errors import InputError

LARGEST_TEXT = 1 << 24
"""Largest text file, bytes (16 MiB): the words of an hour, phone by phone and in UTF-16, take half of it."""
LOCK = ".lock"
"""Name of the file that marks a folder as in use."""
WAIT = 0.5
"""Seconds between two attempts to take a lock."""

DEEPEST = 100
"""Greatest nesting depth: our files need 8, a glTF document with extensions about 12."""
MOST_DIGITS = 300
"""Most digits of an integer: a float holds 308, so the conversion cannot overflow."""
MOST_VALUES = 1 << 22
"""Most values of a document (4,194,304), about 80 bytes each: a listing of 100,000 recordings has 2 million."""

# A whole number of too many digits (or similar text).
_LONG_NUMBER = re.compile(rf"(?<![\d.])\d{{{MOST_DIGITS + 1},}}", re.ASCII)

# Byte order marks of text files and their encodings: Praat writes UTF-16.
_MARKED = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
# Characters of a file's name, and random ones, in the name of its temporary file: a long name plus a suffix could
# exceed the limit of the file system.
_PREFIX, _TOKEN = 40, 12
# Names of the temporary files of `write_bytes`.
_UNFINISHED = re.compile(rf"\..{{1,{_PREFIX}}}\.[0-9a-f]{{{_TOKEN}}}")


# ---------------------------------------------------------------------------------------------------- writing

def write_text(path: str | os.PathLike[str], text: str) -> None:
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    with new_file(path) as stream:
        stream.write(data)


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A file that appears whole at the end, or not at all if an exception is raised: a temporary file beside it is
    synced, then renamed. On Linux it has no name until then, so that a killed process leaves nothing. OSError names
    `path`."""
    target = Path(path)
    temporary = target.parent / f".{target.name[:_PREFIX]}.{secrets.token_hex(_TOKEN // 2)}"
    try:
        try:
            with _without_name(target.parent) or temporary.open("xb") as stream:
                yield stream
                stream.flush()
                # Without it the name may reach the disk before the content, and a power failure leaves an empty file.
                os.fsync(stream.fileno())
                if isinstance(stream.name, int):
                    # With a folder's number, which an absolute path ignores, Python follows the link to the file.
                    os.link(f"/proc/self/fd/{stream.name}", temporary, src_dir_fd=stream.name)
            rename(temporary, target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        # Name the file of the user, not the temporary one.
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(target)) from error


def _without_name(folder: Path) -> BinaryIO | None:
    """A new file in a folder that has no name yet; None where the system or the file system has no such files."""
    with contextlib.suppress(OSError, AttributeError):
        if Path("/proc/self/fd").is_dir():
            return open(os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb")
    return None


def remove_unfinished_of(targets: Iterable[Path]) -> None:
    """Delete the temporary files of these files that killed processes left."""
    names: dict[Path, set[str]] = {}
    for target in targets:
        names.setdefault(target.parent, set()).add(f".{target.name[:_PREFIX]}.")
    for folder, wanted in names.items():
        with contextlib.suppress(OSError):
            for entry in os.scandir(folder):
                if _UNFINISHED.fullmatch(entry.name) and entry.name[:-_TOKEN] in wanted:
                    Path(entry.path).unlink(missing_ok=True)


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_free(target: Path) -> bool:
    """Whether a folder can be written there: nothing is, or an empty folder."""
    return not target.exists() or (target.is_dir() and not any(target.iterdir()))


@contextlib.contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """The folder TARGET.partial to fill, which takes the name of `target` at the end, or is deleted if an exception is
    raised. InputError if `target` exists and is not empty."""
    if not is_free(target):
        raise InputError(target, "is already there", "delete it or choose another folder")
    # Beside the target, as a rename is atomic within one file system only.
    partial = target.with_name(target.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        yield partial
        if target.exists():
            target.rmdir()
        rename(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def rename(source: Path, target: Path) -> None:
    """Rename a finished file or folder, replacing a file of that name, and sync the parent folder (Windows has no need
    of that)."""
    source.replace(target)
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):  # some file systems refuse it; the content is synced all the same
        handle = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


# ---------------------------------------------------------------------------------------------------- reading

def read_bytes(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT) -> bytes:
    """The bytes of a file; `InputError` as of `opened`, and with `advice` for more than `largest` bytes."""
    try:
        with opened(path) as stream:
            if os.fstat(stream.fileno()).st_size > largest:
                raise InputError(path, f"is larger than {largest >> 20} MiB", advice)
            return stream.read()
    except OSError as error:
        raise _unreadable(path, error) from None


def opened(path: str | os.PathLike[str]) -> BinaryIO:
    """A regular file, open for reading; `InputError` if it is missing, not a regular file or not readable."""
    name = Path(path)
    try:
        if not name.is_file():
            wrong = "is a folder" if name.is_dir() else "is not a regular file" if name.exists() else "does not exist"
            raise InputError(path, wrong, "check the path")
        return name.open("rb")
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unreadable(path, error) from None


def _unreadable(path: str | os.PathLike[str], error: Exception) -> InputError:
    return InputError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})",
                      "check the path and its rights")


def read_text(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT, other: str = "") -> str:
    """The text of a file in UTF-8, with or without a byte order mark, or in UTF-16 with one; line ends become "\\n".
    other: the encoding that a file in none of these is read in, with a warning; "" for none. InputError as of
    `read_bytes`, and with `advice` for a file that is not text."""
    text = decoded(read_bytes(path, advice, largest), path, advice, other)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def decoded(data: bytes, source: object, advice: str, other: str = "") -> str:
    """Bytes as text in UTF-8 or, with a byte order mark, UTF-16, or in `other`, see `read_text`; `InputError` with the
    line that is not text."""
    encoding = next((encoding for mark, encoding in _MARKED if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        wrong = f"line {line}: is not text in UTF-8"
        try:
            text = data.decode(other or encoding)
        except UnicodeDecodeError:
            raise InputError(source, wrong, advice) from None
        warnings.warn(f"{source}: {wrong}, so it is read as {other}", stacklevel=2)
    if "\0" in text:
        raise InputError(source, f"line {text.count(chr(10), 0, text.index(chr(0))) + 1}: is not text in UTF-8 "
                         "(it has a zero byte)", advice)
    return text


def read_table(path: str | os.PathLike[str], advice: str) -> list[tuple[int, dict[str, str | None]]]:
    """The rows of a CSV file with a header, each with its last line number; missing cells of short rows are None.
    InputError as of `read_text`, and with the line of an invalid row (a cell of more than 131,072 characters)."""
    table = csv.DictReader(read_text(path, advice).split("\n"))
    rows: list[tuple[int, dict[str, str | None]]] = []
    try:
        rows += [(table.line_num, dict(row)) for row in table]
    except csv.Error as error:
        raise InputError(path, f"line {table.line_num + 1}: is not a row of a table ({error})", advice) from None
    return rows


# ---------------------------------------------------------------------------------------------------- locks

@contextlib.contextmanager
def lock(folder: str | os.PathLike[str], what: str, *, beside: bool = False, wait: bool = False) -> Iterator[None]:
    """Lock a folder, which is created if it is missing, against all other processes and threads.

    what: the work, for the message ("a training"). beside: put the lock file next to the folder instead of into it, for
    a folder that is renamed while locked. wait: until the lock is free. The system releases the lock when a process
    dies, so it is never stale. InputError if another process has the lock.
    """
    place = Path(folder)
    file = place.with_name(f".{place.name}{LOCK}") if beside else place / LOCK
    file.parent.mkdir(parents=True, exist_ok=True)
    held = FileLock(file, timeout=-1 if wait else 0, poll_interval=WAIT)
    try:
        held.acquire()
    except Timeout:
        holder = "another process"
        with contextlib.suppress(OSError):  # locked files cannot be read on Windows
            holder = file.read_text(encoding="utf-8") or holder
        raise InputError(place, f"is in use by {holder}", "wait until it has ended, or choose another folder") from None
    try:
        with contextlib.suppress(OSError):
            file.write_text(f"{what} (process {os.getpid()} on {socket.gethostname()})", encoding="utf-8")
        yield
    finally:
        # Removed while it is locked: a process that opened it before sees that the name is gone, and retries.
        with contextlib.suppress(OSError):  # Windows removes no open file, and filelock leaves none there
            file.unlink()
        held.release()


# ---------------------------------------------------------------------------------------------------- JSON

def read_json(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT, *, python: bool = False) -> Any:
    """The value in a JSON file. `InputError`, with `advice`, as of `read_text` (missing, larger than `largest` bytes,
    not text) and of `parse_json`."""
    return parse_json(read_text(path, advice, largest), path, advice, python=python)


def read_object(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT, *, python: bool = False
                ) -> dict[str, Any]:
    """The object in a JSON file; `InputError` as of `read_json`, and for any other value."""
    value = read_json(path, advice, largest, python=python)
    if not isinstance(value, dict):
        raise InputError(path, "is not a JSON object in braces", advice)
    return value


def parse_json(data: str | bytes, source: object, advice: str, *, python: bool = False) -> Any:
    """The value of a JSON text (RFC 8259); of duplicate keys the last counts.

    source: name in messages. python: accept Python's extensions: NaN, Infinity, and unpaired surrogates (invalid bytes
    in file names). `InputError` for invalid JSON, nesting deeper than `DEEPEST`, more than `MOST_VALUES` values, a
    number that does not fit a float, NaN or Infinity, or an unpaired surrogate.
    """
    text = decoded(data, source, advice) if isinstance(data, bytes) else data
    # Before the parser runs: values take memory, and the conversion of digits takes quadratic time. What is in strings
    # counts, too: no text that we read holds so many marks or digits.
    if text.count(",") + text.count("[") + text.count("{") > MOST_VALUES:
        raise InputError(source, f"holds more than {MOST_VALUES:,} values", advice)
    if long := _LONG_NUMBER.search(text):
        raise InputError(source, f"is not valid JSON (a number of {len(long[0])} digits)", advice)
    try:
        value = json.loads(text) if python else msgspec.json.decode(text)
    except RecursionError:
        raise InputError(source, _TOO_DEEP, advice) from None
    except (msgspec.MsgspecError, ValueError) as error:
        raise InputError(source, _invalid(text, str(error)), advice) from None
    _check_depth(value, source, advice)
    return value


_TOO_DEEP = f"is not valid JSON (nested more than {DEEPEST} deep)"


def _invalid(text: str, reason: str) -> str:
    """The parser's message, with the line of its "(byte 12)" or, without one, the last line."""
    place = re.search(r" \(byte (\d+)\)$", reason)
    line = text.encode("utf-8", "replace")[:int(place[1]) if place else None].count(b"\n") + 1
    reason = reason.removesuffix(place[0] if place else "").removeprefix("JSON is malformed: ")
    return f"line {line}: is not valid JSON ({reason[:100]})"


def _check_depth(value: Any, source: object, advice: str) -> None:
    """`InputError` for nesting deeper than `DEEPEST`: whatever walks the value later does so by recursion."""
    level = [value] if isinstance(value, list | dict) else []
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in (outer.values() if isinstance(outer, dict) else outer)
                 if isinstance(inner, list | dict)]
        if not level:
            return
    raise InputError(source, _TOO_DEEP, advice)
