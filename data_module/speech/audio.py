"""Speech from a sound file, and back: any common format in, mono 16 kHz inside.

A recording is read piece by piece, so an hour of 48 kHz stereo never lies in memory at its own rate.
"""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal

import numpy as np

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.types import Samples, Speech

if TYPE_CHECKING:
    import soundfile
    from typing_extensions import Buffer

SAMPLE_RATE = 16000
"""Hertz of every `Speech` that this module returns."""
SHORTEST = 0.3
"""Seconds: anything shorter holds no block."""

_PIECE = 1 << 18
_LOWEST_RATE = 1000
# A recorder that writes to a pipe cannot go back to fill in the length; these are what it leaves there.
_STREAMED = 0x7FFF0000
_FULL_SCALE = 16.0


class AudioWarning(UserWarning):
    """A recording can be used, but something about it could not be checked."""


def load_speech(path: str | os.PathLike[str]) -> Speech:
    """Read a recording (WAV, FLAC, OGG, MP3; any rate, any number of channels) as mono speech at `SAMPLE_RATE`.

    Channels are averaged. Raises `InputError` with one line for anything that is not a whole recording of
    `SHORTEST` seconds or more; warns with `AudioWarning` where the file does not tell how long it should be.
    """
    import soundfile

    name = Path(path)
    check_file(name)
    try:
        with name.open("rb") as raw, _quiet():
            promise = _promised(raw, name.stat().st_size, name)
            raw.seek(0)
            # A WAV written to a pipe may say 0 bytes of sound; the decoder would believe it.
            with _straight()(_Patched(raw, promise.patch) if promise.patch else raw) as file:
                samples = _decode(file, name, promise)
    except (soundfile.SoundFileError, TypeError, ValueError) as error:
        raise InputError(name, "is not sound that can be decoded", "give a WAV, FLAC, OGG or MP3 file") from error
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror or error})", "check the path and its rights") from None
    if len(samples) < round(SHORTEST * SAMPLE_RATE):
        raise InputError(name, f"lasts {len(samples) / SAMPLE_RATE:.2f} s, too short for a gesture",
                         f"give {SHORTEST} s or more")
    if not promise.known:
        warnings.warn(AudioWarning(f"{name}: its length cannot be checked, so a cut end would go unnoticed"),
                      stacklevel=2)
    return Speech(samples, SAMPLE_RATE)


def resample(speech: Speech, sample_rate: int) -> Speech:
    """The same speech at another sample rate."""
    import soxr

    if speech.sample_rate == sample_rate:
        return speech
    samples = soxr.resample(speech.samples, speech.sample_rate, sample_rate)
    return replace(speech, samples=np.clip(samples, -1.0, 1.0).astype(np.float32), sample_rate=sample_rate)


def write_flac(path: str | os.PathLike[str], speech: Speech) -> None:
    """Write speech as 16-bit FLAC, whole or not at all. Samples beyond [-1, 1] are clipped."""
    import soundfile

    memory = io.BytesIO()
    soundfile.write(memory, np.clip(speech.samples, -1.0, 1.0), speech.sample_rate, format="FLAC", subtype="PCM_16")
    write_bytes(path, memory.getvalue())


def _straight() -> type[soundfile.SoundFile]:
    """A sound file that is only ever read forwards: a seek after each piece is slow in MP3 and, where the length is
    open, fails."""
    import soundfile

    class Straight(soundfile.SoundFile):
        def seekable(self) -> bool:
            return False

    return Straight


@dataclass(frozen=True)
class _Promise:
    """What a header says. known: it tells the length; frames: samples per channel, 0 where the decoder's own count is
    the promise; patch: where a length of 0 stands that has to be read as "to the end"."""

    known: bool
    frames: int = 0
    patch: int = 0


class _Patched(io.RawIOBase):
    """A binary file read as if the four bytes at `place` were 0xFF."""

    def __init__(self, raw: BinaryIO, place: int) -> None:
        self._raw, self._place = raw, place

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._raw.seek(offset, whence)

    def tell(self) -> int:
        return self._raw.tell()

    def readinto(self, target: Buffer) -> int:
        view = memoryview(target).cast("B")
        start = self._raw.tell()
        data = bytearray(self._raw.read(len(view)))
        for place in range(max(start, self._place), min(start + len(data), self._place + 4)):
            data[place - start] = 0xFF
        view[:len(data)] = data
        return len(data)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the decoders' C libraries, which print past Python, off the terminal."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no such terminal
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _reason(error: Exception) -> str:
    text = getattr(error, "error_string", None) or str(error)
    return str(text).rstrip(". ") or type(error).__name__


def check_file(name: Path) -> None:
    """`InputError` where a path cannot be a recording, without reading it."""
    if not name.exists():
        raise InputError(name, "does not exist", "check the path")
    if name.is_dir():
        raise InputError(name, "is a directory", "give a sound file")
    if not name.is_file():
        raise InputError(name, "is not a regular file", "give a sound file")
    if name.stat().st_size == 0:
        raise InputError(name, "is empty", "record or copy it again")


def _decode(file: soundfile.SoundFile, name: Path, promise: _Promise) -> Samples:
    """All samples as mono at `SAMPLE_RATE`, [n]."""
    import soxr

    rate = int(file.samplerate)
    if rate < _LOWEST_RATE:
        raise InputError(name, f"has {rate} samples per second, too few for speech", "record at 8 kHz or more")
    resampler = soxr.ResampleStream(rate, SAMPLE_RATE, 1, dtype="float32") if rate != SAMPLE_RATE else None
    told = promise.frames or file.frames
    buffer, frames = bytearray(), 0
    for piece in _pieces(file, name):
        frames += len(piece)
        buffer += (piece if resampler is None else resampler.resample_chunk(piece)).tobytes()
    if frames == 0:
        raise InputError(name, "holds no samples", "record or copy it again")
    if resampler is not None:
        buffer += resampler.resample_chunk(np.zeros(0, np.float32), last=True).tobytes()
    if promise.known and frames < told:
        raise InputError(name, f"is cut short: {frames / rate:.2f} s of the {told / rate:.2f} s that its header "
                         "promises", "copy it again from its source")
    samples = np.frombuffer(buffer, dtype=np.float32)
    np.clip(samples, -1.0, 1.0, out=samples)  # resampling overshoots a little at full scale
    return samples


def _pieces(file: soundfile.SoundFile, name: Path) -> Iterator[Samples]:
    """The file's samples, piece by piece, channels averaged; `InputError` where they are not sound."""
    import soundfile

    while True:
        try:
            piece = file.read(_PIECE, dtype="float32", always_2d=True)
        except soundfile.SoundFileError as error:
            raise InputError(name, f"breaks off: it cannot be decoded to its end ({_reason(error)})",
                             "copy it again from its source") from None
        if len(piece) == 0:
            return
        if not np.isfinite(piece).all():
            raise InputError(name, "holds samples that are not numbers (NaN or infinite)", "export it again")
        if np.abs(piece).max() > _FULL_SCALE:
            raise InputError(name, f"holds samples up to {np.abs(piece).max():.3g}, where full scale is 1",
                             "export it again, scaled to [-1, 1]")
        yield np.ascontiguousarray(piece.mean(axis=1, dtype=np.float32))


def _promised(raw: BinaryIO, size: int, name: Path) -> _Promise:
    """What the header promises. Raises `InputError` for a container that ends before its promise.

    The decoder shortens a WAV silently to what is there, so containers are looked into here.
    """
    head = raw.read(12)
    if head[:4] in (b"RIFF", b"RIFX", b"RF64") and head[8:12] == b"WAVE":
        return _promised_by_riff(raw, size, name, "big" if head[:4] == b"RIFX" else "little")
    if head[:4] == b"fLaC":
        # STREAMINFO comes first: 4 bytes of block header, then 36 bits of sample count from its 108th bit.
        raw.seek(0)
        block = raw.read(42)
        count = int.from_bytes(block[21:26], "big") & ((1 << 36) - 1)
        return _Promise(count > 0, count)
    if head[:4] == b"OggS":
        return _Promise(_ogg_is_closed(raw, size))
    if head[:3] == b"ID3" or (len(head) > 1 and head[0] == 0xFF and head[1] & 0xE0 == 0xE0):
        return _promised_by_mpeg(raw, head)
    return _Promise(False)


def _promised_by_riff(raw: BinaryIO, size: int, name: Path, order: Literal["little", "big"]) -> _Promise:
    """Walk the chunks to the sound and compare its length with what is there."""
    position, long_length = 12, 0
    while position + 8 <= size:
        raw.seek(position)
        chunk = raw.read(8)
        length = int.from_bytes(chunk[4:], order)
        if chunk[:4] == b"ds64":
            raw.seek(position + 16)
            long_length = int.from_bytes(raw.read(8), "little")
        if chunk[:4] == b"data":
            there = size - position - 8
            if length == 0xFFFFFFFF and long_length:
                length = long_length
            elif length == 0 and there > 0:
                return _Promise(False, patch=position + 4)
            elif length >= _STREAMED and length > there:
                return _Promise(False)
            if length > there:
                raise InputError(name, f"is cut short: {there} of the {length} bytes of sound that its header promises",
                                 "copy it again from its source")
            return _Promise(True)
        position += 8 + length + (length & 1)
    raise InputError(name, "holds no sound: its header breaks off", "copy it again from its source")


def _ogg_is_closed(raw: BinaryIO, size: int) -> bool:
    """True when the last page is whole and says that it is the last."""
    tail = min(size, 1 << 17)  # a page is 65,307 bytes at most
    raw.seek(size - tail)
    data = raw.read(tail)
    start = data.rfind(b"OggS")
    if start < 0 or start + 27 > len(data):
        return False
    segments = data[start + 26]
    table = data[start + 27:start + 27 + segments]
    return len(table) == segments and start + 27 + segments + sum(table) <= len(data) and bool(data[start + 5] & 4)


def _promised_by_mpeg(raw: BinaryIO, head: bytes) -> _Promise:
    """Samples per channel that the encoder's own first frame ("Xing" or "Info") counts, less its padding."""
    start = 0
    if head[:3] == b"ID3":
        start = 10 + sum((byte & 0x7F) << shift for byte, shift in zip(head[6:10], (21, 14, 7, 0), strict=True))
    raw.seek(start)
    frame = raw.read(4096)
    mark = max(frame.find(b"Xing"), frame.find(b"Info"))
    if mark < 0 or mark > 64 or len(frame) < mark + 12 or not frame[mark + 7] & 1:
        return _Promise(False)
    version_one = frame[1] >> 3 & 3 == 3
    frames = int.from_bytes(frame[mark + 8:mark + 12], "big")
    # Encoder delay and padding, and the decoder's own delay, are trimmed from the ends: allow for all of them.
    return _Promise(True, max(1, frames - 4) * (1152 if version_one else 576))
