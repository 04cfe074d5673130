"""Sound files: the length promised by the header, and decoding to samples at the original rate, piece by piece.

Decoders silently accept truncated files, so format and expected length are read from the header first. WAV, FLAC, OGG,
MP3 and similar formats are decoded by libsndfile; M4A, MP4, WebM and other containers, including videos, by FFmpeg
through PyAV. A truncated OGG goes unnoticed: it has no length in its header.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Buffer

PIECE = 1 << 18
"""Samples that are decoded at a time, over all channels: 1 MiB."""
PYAV = "pip install 'gesticulator[video]'"
"""Command that installs the decoder of containers."""

# Late start of a video's sound, seconds, above which it is shifted: half a frame of film.
_OFFSET = 0.02
# Late start, seconds, above which it is implausible and ignored.
_MOST_OFFSET = 60.0
# Seconds that may be missing at the end of a container, because of encoder padding and rounding.
_CUT = 0.25


@dataclass(frozen=True)
class Sound:
    """A sound file that is being decoded. rate: samples per second. frames: samples per channel from its header, 0 if
    unknown. pieces: samples [n, channels], to be iterated once; they raise `BrokenSoundError`. known: frames is
    reliable."""

    rate: int
    frames: int
    pieces: Iterator[NDArray[np.float32]]
    known: bool = False


class NoSoundError(Exception):
    """The decoder does not support the file."""


class BrokenSoundError(Exception):
    """The file cannot be decoded to its end; the message says why."""


# ---------------------------------------------------------------------------------------------------- headers

# Least placeholder of the length by a recorder that writes to a pipe and cannot fill it in later.
_STREAMED = 0x7FFF0000
# Most chunks of a WAV before its sound; a dozen are usual.
_MOST_CHUNKS = 1000
# (offset, bytes there, FFmpeg's name of the format): MP4 and M4A, WebM, AVI, WMA and WMV, AMR, MPEG.
_CONTAINERS: tuple[tuple[int, bytes, str], ...] = (
    (4, b"ftyp", "mov,mp4,m4a,3gp,3g2,mj2"), (4, b"moov", "mov,mp4,m4a,3gp,3g2,mj2"),
    (4, b"mdat", "mov,mp4,m4a,3gp,3g2,mj2"), (0, b"\x1aE\xdf\xa3", "matroska,webm"), (8, b"AVI ", "avi"),
    (0, b"0&\xb2u\x8ef\xcf\x11", "asf"), (0, b"#!AMR", "amr"), (0, b"\0\0\x01\xba", "mpeg"),
)


@dataclass(frozen=True)
class Promise:
    """The length in a header. known: it is reliable; frames: samples per channel, 0 to use the decoder's count; patch:
    position of a length of 0 that means "to the end"."""

    known: bool
    frames: int = 0
    patch: int = 0


class Patched(io.RawIOBase):
    """A binary file with the four bytes at `place`, if that is not 0, replaced by 0xFF, and seeks that never fail:
    libsndfile seeks before the start of damaged files, and Python would print the exception on the terminal."""

    def __init__(self, raw: BinaryIO, place: int = 0) -> None:
        self._raw, self._place = raw, place

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        try:
            return self._raw.seek(offset, whence)
        except (OSError, ValueError):
            return self._raw.tell()

    def tell(self) -> int:
        return self._raw.tell()

    def readinto(self, target: Buffer) -> int:
        view = memoryview(target).cast("B")
        start = self._raw.tell()
        data = bytearray(self._raw.read(len(view)))
        if self._place:
            for place in range(max(start, self._place), min(start + len(data), self._place + 4)):
                data[place - start] = 0xFF
        view[:len(data)] = data
        return len(data)


def container_of(head: bytes) -> str:
    """FFmpeg's name of the format of a video or container, from its first bytes; "" for others."""
    for place, mark, kind in _CONTAINERS:
        if head[place:place + len(mark)] == mark:
            return kind
    # AAC without a container: the 12 bits that MPEG's frames begin with, then layer 0, which MP3 never has.
    if len(head) > 1 and head[0] == 0xFF and head[1] & 0xF6 == 0xF0:
        return "aac"
    # A transport stream: packets of 188 bytes, each beginning with G.
    return "mpegts" if head[:1] == b"G" and head[188:189] == b"G" and head[376:377] == b"G" else ""


def is_mpeg(head: bytes) -> bool:
    """Whether a file begins as MP3 does: with an ID3 tag, or with a frame."""
    return head[:3] == b"ID3" or (len(head) > 1 and head[0] == 0xFF and head[1] & 0xE0 == 0xE0)


def promised(raw: BinaryIO, size: int, name: object) -> Promise:
    """The length in the header of `size` bytes of sound. `InputError` for a shorter file."""
    head = raw.read(12)
    if head[:4] in (b"RIFF", b"RIFX", b"RF64") and head[8:12] == b"WAVE":
        return _promised_by_riff(raw, size, name, "big" if head[:4] == b"RIFX" else "little")
    if head[:4] == b"fLaC":
        # STREAMINFO comes first: 4 bytes of block header, then 36 bits of sample count from its 108th bit.
        raw.seek(0)
        block = raw.read(42)
        count = int.from_bytes(block[21:26], "big") & ((1 << 36) - 1)
        return Promise(count > 0, count)
    if head[:4] == b"OggS":
        return Promise(True)  # the decoder counts up to the last page that is there
    if is_mpeg(head):
        return _promised_by_mpeg(raw, head)
    return Promise(False)


def _promised_by_riff(raw: BinaryIO, size: int, name: object, order: Literal["little", "big"]) -> Promise:
    """Find the chunk with the sound and compare its length with the size of the file."""
    position, long_length = 12, 0
    for _ in range(_MOST_CHUNKS):
        if position + 8 > size:
            break
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
                return Promise(False, patch=position + 4)
            # A recorder that writes to a pipe leaves a placeholder: nothing can be checked.
            elif length >= _STREAMED and length > there:
                return Promise(False)
            if length > there:
                raise InputError(name, f"is cut short: {there} of the {length} bytes of sound that its header promises",
                                 "copy it again from its source")
            return Promise(True)
        if not chunk[:4].isascii() or not chunk[:4].decode("ascii").isprintable():
            break
        # Chunks begin at even positions: an odd length is followed by a byte of padding.
        position += 8 + length + (length & 1)
    raise InputError(name, "holds no sound: its header breaks off", "copy it again from its source")


def _promised_by_mpeg(raw: BinaryIO, head: bytes) -> Promise:
    """Samples per channel from the encoder's info frame ("Xing" or "Info"), less its padding."""
    start = 0
    if head[:3] == b"ID3":
        start = 10 + sum((byte & 0x7F) << shift for byte, shift in zip(head[6:10], (21, 14, 7, 0), strict=True))
    raw.seek(start)
    frame = raw.read(4096)
    mark = max(frame.find(b"Xing"), frame.find(b"Info"))
    if mark < 0 or mark > 64 or len(frame) < mark + 12 or not frame[mark + 7] & 1:
        return Promise(False)
    version_one = frame[1] >> 3 & 3 == 3
    frames = int.from_bytes(frame[mark + 8:mark + 12], "big")
    # Encoder delay and padding, and the decoder's own delay, are trimmed from the ends: allow for all of them.
    return Promise(True, max(1, frames - 4) * (1152 if version_one else 576))


# ---------------------------------------------------------------------------------------------------- libsndfile

@contextlib.contextmanager
def sndfile(raw: BinaryIO) -> Iterator[Sound]:
    import soundfile

    class ForwardOnlyFile(soundfile.SoundFile):
        """Without seeks, which fail after each piece if the length is unknown."""

        def seekable(self) -> bool:
            return False

    try:
        file = ForwardOnlyFile(raw)
    except (soundfile.SoundFileError, TypeError, ValueError) as error:
        raise NoSoundError from error
    with file:
        yield Sound(int(file.samplerate), int(file.frames), _of_sndfile(file))


def _of_sndfile(file: Any) -> Iterator[NDArray[np.float32]]:
    import soundfile

    size = max(1, PIECE // file.channels)
    while True:
        try:
            piece = file.read(size, dtype="float32", always_2d=True)
        except soundfile.SoundFileError as error:
            raise BrokenSoundError(str(getattr(error, "error_string", None) or error).rstrip(". ")) from None
        if len(piece) == 0:
            return
        yield piece


# ---------------------------------------------------------------------------------------------------- containers

@contextlib.contextmanager
def container(raw: BinaryIO, kind: str, name: object) -> Iterator[Sound]:
    """Decode the first sound in a container, with silence for a late start; kind: FFmpeg's name of the format.
    InputError if PyAV is not installed or there is no sound."""
    try:
        import av
    except ImportError:
        raise InputError(name, "is a video or container, and its decoder (PyAV) is not installed",
                         f"{PYAV}, or convert it to WAV") from None
    raw.seek(0)
    try:
        file: Any = av.open(raw, mode="r", format=kind.split(",")[0])
    except (av.error.FFmpegError, ValueError) as error:
        raise NoSoundError from error
    with file:
        if not file.streams.audio:
            raise InputError(name, "has no sound", "give a video with sound, or its sound file")
        stream = file.streams.audio[0]
        # For an unknown codec there is no context, and then no rate either.
        rate = int(stream.rate or 0) if stream.codec_context is not None else 0
        if rate <= 0:
            raise NoSoundError
        known = stream.duration is not None and stream.time_base is not None
        seconds = float(stream.duration * stream.time_base) if known else (file.duration or 0) / av.time_base
        late = float(stream.start_time * stream.time_base) if stream.start_time and stream.time_base else 0.0
        late = late if _OFFSET < late < _MOST_OFFSET else 0.0
        yield Sound(rate, max(0, round((seconds + late - _CUT) * rate)), _of_container(file, stream, rate, late), known)


def _of_container(file: Any, stream: Any, rate: int, late: float) -> Iterator[NDArray[np.float32]]:
    import av

    if late:
        yield np.zeros((round(late * rate), 1), np.float32)
    planes = None
    try:
        for frame in file.decode(stream):
            if planes is None:
                # Convert the sample format of the codec to floats, one row per channel.
                planes = av.AudioResampler(format="fltp", layout=frame.layout, rate=rate)
            for part in planes.resample(frame):
                yield np.ascontiguousarray(part.to_ndarray().T, dtype=np.float32)
        for part in planes.resample(None) if planes is not None else ():
            yield np.ascontiguousarray(part.to_ndarray().T, dtype=np.float32)
    except (av.error.FFmpegError, ValueError) as error:
        raise BrokenSoundError(str(error).splitlines()[0][:120] if str(error) else type(error).__name__) from None
