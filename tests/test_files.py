"""A file is written whole or not at all."""

import errno
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from data_module import files
from data_module.errors import InputError
from data_module.files import lock, read_text, remove_unfinished_of, write_bytes


@pytest.mark.skipif(sys.platform == "win32", reason="permissions are POSIX's")
def test_others_may_read_what_the_mask_lets_them(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_bytes(tmp_path / "a.bin", b"x")
    finally:
        os.umask(before)
    assert (tmp_path / "a.bin").stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(sys.platform == "win32", reason="limits of resources are POSIX's")
def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    import resource

    target = tmp_path / "gesture.bvh"
    target.write_bytes(b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # A limit on the size of files fails the real write half-way, as a full disk does.
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(OSError) as failure:
            write_bytes(target, b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert failure.value.errno == errno.EFBIG
    assert failure.value.filename == str(target)
    assert target.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["gesture.bvh"]


def test_a_missing_folder_is_named_by_the_path_that_was_asked_for(tmp_path: Path) -> None:
    target = tmp_path / "nowhere" / "out.bvh"
    with pytest.raises(FileNotFoundError) as failure:
        write_bytes(target, b"x")
    assert failure.value.filename == str(target)


def test_a_name_as_long_as_the_file_system_allows(tmp_path: Path) -> None:
    target = tmp_path / ("n" * 240 + ".bvh")
    write_bytes(target, b"x")
    assert target.read_bytes() == b"x"


def test_a_text_is_read_in_every_encoding_with_one_kind_of_line_ends(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        file.write_bytes("Füße\r\nzwei\rdrei\n".encode(encoding))
        assert read_text(file, "save it again") == "Füße\nzwei\ndrei\n"


@pytest.mark.parametrize(("data", "says"), [
    (b"one\ntwo \xff\xfe\n", "line 2"), (b"one\n\0\0\n", "line 2"), (b"\xff\xfea", "not text"),
])
def test_what_is_no_text_is_refused_with_the_line(data: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(data)
    with pytest.raises(InputError, match=says):
        read_text(tmp_path / "a.txt", "save it again")


def test_paths_that_hold_no_text_are_refused(tmp_path: Path) -> None:
    for path, says in ((tmp_path, "folder"), (tmp_path / "none", "does not exist"), ("a\0b", "does not exist")):
        with pytest.raises(InputError, match=says):
            read_text(path, "save it again")


_HOLD = """
import sys, time
from data_module.files import lock
with lock(sys.argv[1], "a training", beside=sys.argv[2] == "beside"):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("place", ["inside", "beside"])
def test_a_folder_that_another_process_holds_is_refused_until_it_dies(place: str, tmp_path: Path) -> None:
    folder, beside = tmp_path / "work", place == "beside"
    command = [sys.executable, "-c", _HOLD, str(folder), place]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"work: is in use by a training \\(process {other.pid} on "), \
                lock(folder, "another training", beside=beside):
            pytest.fail("two hold it")
        other.kill()
    # Nothing was cleaned up, and nothing has to be.
    with lock(folder, "another training", beside=beside):
        pass
    assert [file.name for file in tmp_path.rglob("*")] == ([] if beside else ["work"])


def test_a_lock_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "WAIT", 0.01)
    order: list[str] = []

    def second() -> None:
        with lock(tmp_path / "w", "second", wait=True):
            order.append("second")

    thread = threading.Thread(target=second)
    with lock(tmp_path / "w", "first"):
        thread.start()
        time.sleep(0.1)
        order.append("first")
    thread.join()
    assert order == ["first", "second"]


def test_what_a_killed_process_had_begun_leaves_nothing_or_is_removed(tmp_path: Path) -> None:
    # Without O_TMPFILE it is as on another system.
    code = ("import os, sys; from data_module import files\n"
            "if sys.argv[2:]: del os.O_TMPFILE\n"
            "os.fsync = lambda handle: os.kill(os.getpid(), 9)\n"
            "files.write_text(sys.argv[1], 'half')")
    target = tmp_path / "recordings" / "a.json"
    target.parent.mkdir()
    target.write_text("old")
    for arguments, left in (((), 1), (("named",), 2)) if sys.platform == "linux" else (((), 2),):
        subprocess.run([sys.executable, "-c", code, str(target), *arguments], check=False)
        assert len(list(target.parent.iterdir())) == left
    assert target.read_text() == "old"
    for name in (".hidden", ".a.json.0123", "b.json"):
        (target.parent / name).write_text("kept")
    remove_unfinished_of([target])
    assert {file.name for file in target.parent.iterdir()} == {"a.json", ".hidden", ".a.json.0123", "b.json"}
