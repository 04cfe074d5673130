"""Files written whole or not at all, text files read with one set of messages, and folders that one process holds."""

from __future__ import annotations

import codecs
import contextlib
import csv
import errno
import os
import re
import secrets
import socket
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from data_module.errors import InputError

LARGEST_TEXT = 1 << 24
"""Bytes (16 MiB) of a text file that is read: the words of an hour, phone by phone and in UTF-16, take half of it."""
LOCK = ".lock"
"""Name of the file that marks a folder as in use."""
WAIT = 0.5
"""Seconds between two looks at a lock that is waited for."""

# What a text file may begin with when another program wrote it: Praat writes UTF-16.
_MARKED = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_PREFIX, _TOKEN = 40, 12
"""Characters of a file's name, and of chance, in that of its temporary file: a long name plus an ending could pass the
file system's limit."""
_UNFINISHED = re.compile(rf"\..{{1,{_PREFIX}}}\.[0-9a-f]{{{_TOKEN}}}")
"""Names of the temporary files of `write_bytes`."""
_NO_LOCKS = frozenset({errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL})
"""Errors with which a file system says that it has no locks (some network drives)."""


# ---------------------------------------------------------------------------------------------------- writing

def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a text file whole or not at all: to a temporary file beside it, synced, then renamed."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all: to a temporary file beside it, synced, then renamed; OSError names `path`."""
    with new_file(path) as stream:
        stream.write(data)


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A file to write that gets its name at the end, whole, or not at all where anything is raised meanwhile: it is a
    temporary file beside it, synced, then renamed. OSError names `path`."""
    target = Path(path)
    try:
        temporary, handle = _new_file(target)
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                # Without it the name may reach the disk before the content does, and a power cut leaves an empty file.
                os.fsync(stream.fileno())
            rename(temporary, target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        # The file that the user asked for is named, not the temporary one.
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(target)) from error


def _new_file(target: Path) -> tuple[Path, int]:
    """A new file beside `target`, open for writing, with the rights that the process gives to its files."""
    while True:
        temporary = target.parent / f".{target.name[:_PREFIX]}.{secrets.token_hex(_TOKEN // 2)}"
        with contextlib.suppress(FileExistsError):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
            return temporary, os.open(temporary, flags, 0o666)


def remove_unfinished(folder: Path) -> None:
    """Delete what `write_bytes` had begun in a folder, or below it, when its process was killed."""
    for file in folder.rglob(".*"):
        if _UNFINISHED.fullmatch(file.name):
            file.unlink(missing_ok=True)


def remove_unfinished_of(targets: Iterable[Path]) -> None:
    """Delete what `write_bytes` had begun of these files when its process was killed."""
    names: dict[Path, set[str]] = {}
    for target in targets:
        names.setdefault(target.parent, set()).add(f".{target.name[:_PREFIX]}.")
    for folder, wanted in names.items():
        with contextlib.suppress(OSError):
            for entry in os.scandir(folder):
                if _UNFINISHED.fullmatch(entry.name) and entry.name[:-_TOKEN] in wanted:
                    Path(entry.path).unlink(missing_ok=True)


def rename(source: Path, target: Path) -> None:
    """Give a finished file or folder its name, in place of a file that bears it, and sync the folder that lists it."""
    source.replace(target)
    sync_folder(target.parent)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can (Windows needs no such thing)."""
    if os.name != "posix":
        return
    with contextlib.suppress(OSError):  # some file systems refuse it; the content is synced all the same
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


# ---------------------------------------------------------------------------------------------------- reading

def read_bytes(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT) -> bytes:
    """The bytes of a file; `InputError` for one that is absent, no regular file, or larger than `largest` bytes.

    advice: what to do with a file that is too large.
    """
    name = Path(path)
    try:
        if not name.is_file():
            wrong = "is a folder" if name.is_dir() else "is no regular file" if name.exists() else "does not exist"
            raise InputError(path, wrong, "check the path")
        if name.stat().st_size > largest:
            raise InputError(path, f"is larger than {largest >> 20} MiB", advice)
        return name.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})",
                         "check the path and its rights") from None


def read_text(path: str | os.PathLike[str], advice: str, largest: int = LARGEST_TEXT) -> str:
    """The text of a file in UTF-8, with or without a byte order mark, or in UTF-16 with one; line ends become "\\n".

    advice: what to do when it is none. InputError for a file that is absent, no regular file, larger than `largest`
    bytes, or not text.
    """
    text = decoded(read_bytes(path, advice, largest), path, advice)
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def decoded(data: bytes, source: object, advice: str) -> str:
    """Bytes as text in UTF-8 or, with a byte order mark, UTF-16; `InputError` with the line where they are none."""
    encoding = next((encoding for mark, encoding in _MARKED if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(source, f"line {line}: is not text in UTF-8", advice) from None
    if "\0" in text:
        raise InputError(source, f"line {text.count(chr(10), 0, text.index(chr(0))) + 1}: is not text in UTF-8 "
                         "(it has a zero byte)", advice)
    return text


def read_table(path: str | os.PathLike[str], advice: str) -> list[tuple[int, dict[str, str | None]]]:
    """The rows of a table with a head and commas, each with its last line: a cell that a short row lacks is None.

    InputError as of `read_text`, and with the line for what is no row (a cell of more than 131,072 characters).
    """
    table = csv.DictReader(read_text(path, advice).split("\n"))
    rows: list[tuple[int, dict[str, str | None]]] = []
    try:
        rows += [(table.line_num, dict(row)) for row in table]
    except csv.Error as error:
        raise InputError(path, f"line {table.line_num + 1}: is no row of a table ({error})", advice) from None
    return rows


# ---------------------------------------------------------------------------------------------------- locks

@contextlib.contextmanager
def lock(folder: str | os.PathLike[str], what: str, *, beside: bool = False, shared: bool = False,
         wait: bool = False) -> Iterator[None]:
    """Hold a folder, which is made where it is missing, against every other process and thread.

    what: the work, for the message ("a training"). beside: put the lock file next to the folder, not into it, for a
    folder that is renamed while it is held. shared: together with others who say so, and against those who do not
    (Windows cannot: there it is held alone). wait: until it is free. The system itself lets go when a process dies, so
    no lock is ever stale.
    InputError when somebody else holds the folder. Where the file system has no locks, the work goes on without one.
    """
    place = Path(folder)
    if beside:
        file = place.with_name(f".{place.name}{LOCK}")
        file.parent.mkdir(parents=True, exist_ok=True)
    else:
        file = place / LOCK
        place.mkdir(parents=True, exist_ok=True)
    handle = _locked(file, place, what, shared, wait)
    try:
        yield
    finally:
        if os.name == "posix":  # while it is held, so that nobody loses a lock to it; see `_locked`
            if not shared or _take(handle):  # whoever is the last to share it
                file.unlink(missing_ok=True)
            os.close(handle)
        else:
            _release(handle)
            os.close(handle)
            with contextlib.suppress(OSError):  # another process may have it open already
                file.unlink(missing_ok=True)


def _locked(file: Path, folder: Path, what: str, shared: bool, wait: bool) -> int:
    """A descriptor that holds the lock on `file`."""
    while True:
        handle, pause = os.open(file, os.O_RDWR | os.O_CREAT, 0o666), 0.01
        try:
            if not _take(handle, shared):
                if not wait:
                    raise InputError(folder, f"is in use by {_holder(handle)}",
                                     "wait until it has ended, or choose another folder")
                pause = WAIT
            # Whoever held it before removes the file: a lock on a removed file holds nothing.
            elif _is_at(handle, file):
                os.ftruncate(handle, 0)
                os.write(handle, f"{what}\n{os.getpid()}\n{socket.gethostname()}\n".encode())
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
        time.sleep(pause)


def _is_at(handle: int, file: Path) -> bool:
    """Whether an open file is the one that has this name now; between two looks another may have come and gone."""
    try:
        return os.path.samestat(os.fstat(handle), file.stat())
    except FileNotFoundError:
        return False


def _holder(handle: int) -> str:
    """Who wrote the lock file: "a training (process 123 on HOST)"."""
    try:
        lines = os.read(handle, 4096).decode("utf-8", "replace").split("\n")
    except OSError:  # Windows lets nobody read what is locked
        lines = []
    if len(lines) < 3 or not lines[0]:
        return "another process"
    return f"{lines[0]} (process {lines[1]} on {lines[2]})"


def _take(handle: int, shared: bool = False) -> bool:
    """Whether the lock could be had, without waiting."""
    try:
        if os.name == "nt":
            import msvcrt

            # A byte far behind the text, which stays readable for others.
            os.lseek(handle, 1 << 20, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined, unused-ignore]
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in _NO_LOCKS
    return True


def _release(handle: int) -> None:
    if os.name == "nt":
        import msvcrt

        os.lseek(handle, 1 << 20, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)  # type: ignore[attr-defined, unused-ignore]
