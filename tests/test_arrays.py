"""Arrays from files of any origin: what numpy writes comes back, and what lies about itself costs no memory."""

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from data_module.arrays import read_npy, read_npz
from data_module.errors import InputError
from data_module.motion.smplx import read_smplx

KINDS = st.one_of(npst.floating_dtypes(), npst.integer_dtypes(), npst.unsigned_integer_dtypes(), npst.boolean_dtypes(),
                  npst.unicode_string_dtypes(), npst.byte_string_dtypes())


@settings(max_examples=60, deadline=None)
@given(npst.arrays(KINDS, npst.array_shapes(min_dims=0, min_side=0)), st.booleans())
def test_what_numpy_writes_comes_back(tmp_path_factory: pytest.TempPathFactory, array: Any, columns: bool) -> None:
    folder = tmp_path_factory.mktemp("arrays")
    array = np.asfortranarray(array) if columns else array
    np.save(folder / "a.npy", array)
    np.savez(folder / "a.npz", one=array, two=np.arange(3))
    np.savez_compressed(folder / "b.npz", one=array)
    for got in (read_npy(folder / "a.npy"), read_npz(folder / "a.npz")["one"],
                read_npz(folder / "b.npz", ["one"])["one"]):
        assert got.dtype == array.dtype and got.shape == array.shape
        np.testing.assert_array_equal(got, array)
    assert set(read_npz(folder / "a.npz", ["two", "three"])) == {"two"}


def header(kind: object, shape: object, body: bytes = b"") -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + body


def zipped(name: str, data: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", method) as archive:
        archive.writestr(name, data)
    return memory.getvalue()


def patched(data: bytes, size: int) -> bytes:
    """A zip of one member that claims `size` bytes in both of its lists."""
    out = bytearray(data)
    for mark, place in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = out.find(mark) + place
        out[at:at + 4] = struct.pack("<I", size)
    return bytes(out)


GREAT = header("<f8", (75_000_000, 25, 3))  # 45 GB
LIES = {
    "45 GB in a header": (GREAT, "claims 45000000000 bytes, and 0 follow"),
    "a shape beyond 64 bits": (header("<f8", (1 << 62, 1 << 62)), "shaped"),
    "a negative shape": (header("<f8", (-1, 3)), "shaped"),
    "text of a gigabyte": (header("<U999999", (0, 3), b"x"), "claims 0 bytes"),
    "objects": (header("|O", (1,), b"cos\nsystem\n"), "plain"),
    "records": (header([("a", "<f8")], (1,), bytes(8)), "plain"),
    "a header that is deep": (b"\x93NUMPY\x01\x00" + struct.pack("<H", 9000) + b"(" * 9000, "plain"),
    "a header that is code": (b"\x93NUMPY\x01\x00" + struct.pack("<H", 17) + b"__import__('os') ", "plain"),
    "a header that is long": (b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 31), "plain"),
    "cut short": (header("<f8", (4,), bytes(31)), "32 bytes, and 31 follow"),
    "text": (b"0 1 2\n" * 40, "magic string"),
    "nothing": (b"", "plain"),
}


@pytest.mark.parametrize("lie", LIES)
def test_an_array_that_lies_is_refused_before_memory_is_taken(lie: str, tmp_path: Path) -> None:
    data, says = LIES[lie]
    (tmp_path / "a.npy").write_bytes(data)
    (tmp_path / "a.npz").write_bytes(zipped("poses.npy", data))
    check_refused(lambda: read_npy(tmp_path / "a.npy"), says)
    check_refused(lambda: read_npz(tmp_path / "a.npz"), says)


BROKEN = {
    "claims more than its bytes can hold": (patched(zipped("poses.npy", GREAT), 0xFFFFFFF0), "GiB|claims"),
    "claims a little more": (patched(zipped("poses.npy", GREAT), 90_000), "claims"),
    "another method": (zipped("poses.npy", GREAT, zipfile.ZIP_LZMA), "method 14"),
    "a broken end": (zipped("poses.npy", header("<f8", (4,), bytes(32)))[:-30], "plain arrays"),
    "a wrong checksum": (zipped("poses.npy", header("<f8", (4,), bytes(32)), zipfile.ZIP_STORED)
                         .replace(bytes(32), bytes(31) + b"\1"), "CRC|plain arrays"),
    "no zip": (b"PK\x03\x04" + bytes(100), "plain arrays"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_archive_is_one_line(kind: str, tmp_path: Path) -> None:
    data, says = BROKEN[kind]
    (tmp_path / "a.npz").write_bytes(data)
    check_refused(lambda: read_npz(tmp_path / "a.npz"), says)
    check_refused(lambda: read_smplx(tmp_path / "a.npz"), "a.npz")


def test_characters_that_there_are_not_are_one_line(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    for order in "<>":
        codes = np.array([97, 0x10FFFF], order + "u4")
        np.savez(file, words=codes.view(order + "U2"))
        assert read_npz(file)["words"].tolist() == ["a\U0010ffff"]
        np.savez(file, words=(codes + 1).astype(order + "u4").view(order + "U2"))
        with pytest.raises(InputError, match="words holds characters that Unicode does not have"):
            read_npz(file)


def check_refused(read: Any, says: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=says) as caught:
            read()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)
    assert peak < 4e6


SMPLX = {"poses": np.zeros((5, 165)), "trans": np.zeros((5, 3)), "mocap_frame_rate": np.array(30.0)}


@pytest.mark.parametrize(("changed", "says"), [
    ({"mocap_frame_rate": np.array("thirty")}, "no usable mocap_frame_rate"),
    ({"mocap_frame_rate": np.array(np.nan)}, "no usable mocap_frame_rate"),
    ({"mocap_frame_rate": np.array([30.0, 30.0])}, "no usable mocap_frame_rate"),
    ({"poses": np.zeros((5, 165), dtype="U4")}, "no numbers called poses"),
    ({"poses": np.array(1.0)}, "poses of shape"),
    ({"trans": np.array("here")}, "no numbers called trans"),
    ({"poses": np.full((5, 165), 1e300)}, "not angles"),
    ({"trans": np.full((5, 3), 1e300)}, "far away"),
])
def test_smplx_arrays_that_cannot_be_used_are_one_line(changed: dict[str, Any], says: str, tmp_path: Path) -> None:
    assert len(read_smplx(saved(tmp_path / "good.npz", SMPLX))) == 5
    with pytest.raises(InputError, match=says):
        read_smplx(saved(tmp_path / "bad.npz", SMPLX | changed))


def saved(path: Path, arrays: dict[str, Any]) -> Path:
    np.savez(path, **arrays)
    return path
