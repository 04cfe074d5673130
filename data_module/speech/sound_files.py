"""Sound files: decoding to samples at the original rate, piece by piece.

WAV, FLAC, OGG, MP3 and similar formats are decoded by libsndfile; M4A, MP4, WebM and other containers, including
videos, by FFmpeg through PyAV. A truncated file is noticed where the header has the number of samples, as in FLAC and
most containers; others are read as far as they go.
"""

from __future__ import annotations

import contextlib
import io
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.registry import Requirement

if TYPE_CHECKING:
    from typing_extensions import Buffer

PIECE = 1 << 18
"""Samples that are decoded at a time, over all channels: 1 MiB."""

# Late start of a video's sound, seconds, above which it is shifted: half a frame of film.
_OFFSET = 0.02
# Share of its length that is decoded at least.
_LEAST = 0.05
# Late start, seconds, above which it is implausible and ignored.
_MOST_OFFSET = 60.0


@dataclass(frozen=True)
class Sound:
    """A sound file that is being decoded. rate: samples per second. frames: samples per channel that its header
    promises, 0 if unknown. pieces: samples [n, channels], to be iterated once; they raise `BrokenSoundError`. centre:
    which channel that is in 5.1 and 7.1. tracks: how many sounds there are, of which this is the first."""

    rate: int
    frames: int
    pieces: Iterator[NDArray[np.float32]]
    centre: int = 2
    tracks: int = 1


class NoSoundError(Exception):
    """The decoder does not support the file."""


class BrokenSoundError(Exception):
    """The file cannot be decoded to its end; the message says why."""


# ---------------------------------------------------------------------------------------------------- headers

# Samples (two years) above which a decoder's length means that it is unknown.
_OPEN_END = 1 << 40
# Bytes from which a format is recognised: the samples of a WAV seldom begin later, whatever notes come before them.
_HEAD = 1 << 16
# How the header of a WAV ends whose length was left open, as 0, by a program that could not go back to fill it in.
_OPEN_WAV = b"data\0\0\0\0"
# (offset, bytes there, FFmpeg's name of the format): MP4 and M4A, WebM, AVI, WMA and WMV, AMR, MPEG, Flash, DTS, Real,
# MXF of cameras, DV, and WTV of television.
_CONTAINERS: tuple[tuple[int, bytes, str], ...] = (
    (4, b"ftyp", "mov,mp4,m4a,3gp,3g2,mj2"), (4, b"moov", "mov,mp4,m4a,3gp,3g2,mj2"),
    (4, b"mdat", "mov,mp4,m4a,3gp,3g2,mj2"), (0, b"\x1aE\xdf\xa3", "matroska,webm"), (8, b"AVI ", "avi"),
    (0, b"0&\xb2u\x8ef\xcf\x11", "asf"), (0, b"#!AMR", "amr"), (0, b"\0\0\x01\xba", "mpeg"),
    (0, b"FLV", "flv"), (0, b"\x7f\xfe\x80\x01", "dts"), (0, b"TTA1", "tta"), (0, b"Creative V", "voc"),
    (0, b".RMF", "rm"), (0, b".ra\xfd", "rm"), (0, b"\x06\x0e+4\x02\x05\x01\x01\r\x01\x02", "mxf"),
    (0, b"\x1f\x07\0", "dv"), (0, b"\xb7\xd8\0 7I\xda\x11", "wtv"),
)
# The same for formats of which libsndfile reads some codecs only: WAV, Ogg, AIFF, CAF; and for WavPack, which it lacks.
_SECOND_TRY = ((8, b"WAVE", "wav"), (0, b"OggS", "ogg"), (0, b"FORM", "aiff"), (0, b"caff", "caf"), (0, b"wvpk", "wv"))
# W64 with the long form of its header, and a format of samples there that is floating point.
_WAVE_64, _LONG_FORM, _FLOATS = b"riff.\x91\xcf\x11", (64, b"\xfe\xff"), (88, b"\x03\0")
# What telephones record: without a header, so that nothing but the name tells them. libsndfile's names, and FFmpeg's.
_BY_NAME = {".sln": "PCM_16", ".ul": "ULAW", ".ulaw": "ULAW", ".mulaw": "ULAW", ".al": "ALAW", ".alaw": "ALAW",
            ".gsm": "gsm", ".g722": "g722"}
_TELEPHONE = {"samplerate": 8000, "channels": 1, "format": "RAW"}
_HEADED = (b"RIFF", b".snd", b"OggS", b"fLaC")
# Bytes of the longest first frame of an MP3, samples in one, and more bytes than any file has.
_FIRST_FRAME, _FRAME_SAMPLES, _ENDLESS = 2881, 1152, 1 << 44
# Streams of frames without a header, of which FFmpeg guesses the length from the first frame.
_HEADLESS = frozenset({"aac", "ac3", "eac3", "dts"})


class Patched(io.RawIOBase):
    """A binary file with the four bytes at `place`, if that is not 0, replaced by 0xFF, and seeks that never fail:
    libsndfile seeks before the start of damaged files, and Python would print the exception on the terminal. endless:
    its length, where that is asked for, is far more than it is."""

    def __init__(self, raw: BinaryIO, place: int = 0, endless: bool = False) -> None:
        self._raw, self._place, self._endless = raw, place, endless
        self._beyond = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._beyond = _ENDLESS if self._endless and (offset, whence) == (0, io.SEEK_END) else 0
        with contextlib.suppress(OSError, ValueError):
            self._raw.seek(offset, whence)
        return self.tell()

    def tell(self) -> int:
        return self._raw.tell() + self._beyond

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
    # AC-3 without a container; E-AC-3 has a number above 10 in the 5 bits of its version.
    if head[:2] == b"\x0b\x77" and len(head) > 5:
        return "eac3" if head[5] >> 3 > 10 else "ac3"
    # libsndfile takes these for whole numbers.
    if head.startswith(_WAVE_64) and all(head[at:at + 2] == mark for at, mark in (_LONG_FORM, _FLOATS)):
        return "w64"
    # A transport stream: packets of 188 bytes, each beginning with G; in those of camcorders after a time of 4 bytes.
    return "mpegts" if head[:377:188] == b"GGG" or head[4:389:192] == b"GGG" else ""


# ---------------------------------------------------------------------------------------------------- libsndfile

@contextlib.contextmanager
def decoder(raw: BinaryIO, name: object) -> Iterator[Sound]:
    """A seekable sound file, from its beginning, in the decoder of its format. `NoSoundError` if no decoder knows it.
    """
    raw.seek(0)
    head = raw.read(_HEAD)
    raw.seek(0)
    by_name = "" if head.startswith(_HEADED) else _BY_NAME.get(PurePath(str(name)).suffix.lower(), "")
    kind = container_of(head) if not by_name else by_name if by_name.islower() else ""
    if head.startswith(b"OggS"):
        # Of streams in a row libsndfile reads the first; then the last page has the number of another stream.
        raw.seek(max(0, raw.seek(0, io.SEEK_END) - _HEAD))
        tail = raw.read()
        kind = "ogg" if tail[tail.rfind(b"OggS"):][14:18] != head[14:18] else kind
        raw.seek(0)
    with contextlib.ExitStack() as files:
        try:
            sound = files.enter_context(container(raw, kind, name) if kind else _sndfile(raw, head, by_name))
        except NoSoundError:
            second = next((kind for at, mark, kind in _SECOND_TRY if head[at:at + len(mark)] == mark), "")
            if kind or not second:
                raise
            raw.seek(0)
            sound = files.enter_context(container(raw, second, name))
        yield sound


@contextlib.contextmanager
def _sndfile(raw: BinaryIO, head: bytes, encoding: str = "") -> Iterator[Sound]:
    """encoding: that of a file without a header."""
    import soundfile

    class ForwardOnlyFile(soundfile.SoundFile):
        """Without seeks, which fail after each piece if the length is unknown."""

        def seekable(self) -> bool:
            return False

    # The decoder would trust a length of 0; one beyond the end of the file it corrects.
    place = head.find(_OPEN_WAV) + 4 if head[:4] == b"RIFF" and _OPEN_WAV in head else 0
    # An MP3 begins with an ID3 tag or a frame.
    mpeg = not encoding and (head[:3] == b"ID3" or _is_frame(head))
    endless = False
    if mpeg:
        place, endless = _miscounted(raw, head)
    try:
        file = ForwardOnlyFile(io.BufferedReader(Patched(raw, place, endless)),
                               **({**_TELEPHONE, "subtype": encoding} if encoding else {}))
    except (soundfile.SoundFileError, TypeError, ValueError) as error:
        raise NoSoundError from error
    frames = 0 if mpeg or file.frames > _OPEN_END else int(file.frames)
    with file:
        # Vorbis and Opus, but not FLAC, have the centre between left and right, and libsndfile leaves it there.
        centre = 1 if file.format == "OGG" and file.subtype != "FLAC" else 2
        yield Sound(int(file.samplerate), frames, _of_sndfile(file, endless), centre)


def _is_frame(data: bytes) -> bool:
    """Whether MPEG audio begins here."""
    return len(data) > 1 and data[0] == 0xFF and data[1] & 0xE0 == 0xE0


def _miscounted(raw: BinaryIO, head: bytes) -> tuple[int, bool]:
    """Where the count of frames of an MP3 stands that is not that of the whole file (0: nowhere), as of several files
    that were joined, and whether the decoder is to read on until the file ends. It would stop at the count or, without
    one, where the file ends if all frames are as large as the first."""
    # Seven bits a byte hold the length of an ID3 tag.
    start = 10 + sum(byte << 7 * place for place, byte in enumerate(head[9:5:-1])) if head[:3] == b"ID3" else 0
    raw.seek(start)
    frame = raw.read(_FIRST_FRAME)
    at = max(frame.find(mark) for mark in (b"Xing", b"Info"))
    # Flags tell which of both is there, then come the frames and the bytes.
    counted, size = at >= 0 and frame[at + 7] & 3 == 3, int.from_bytes(frame[at + 12:at + 16])
    raw.seek(start + size)
    behind = raw.read(3)
    raw.seek(0)
    joined = counted and (behind == b"ID3" or _is_frame(behind))
    return start + at if joined else 0, joined or (at < 0 and b"VBRI" not in frame)


def _of_sndfile(file: Any, endless: bool) -> Iterator[NDArray[np.float32]]:
    """endless: it may end in anything, such as half a frame or a tag, with which the piece before it is lost."""
    import soundfile

    size = _FRAME_SAMPLES if endless else max(1, PIECE // file.channels)
    while True:
        try:
            piece = file.read(size, dtype="float32", always_2d=True)
        except soundfile.SoundFileError as error:
            if endless:
                return
            raise BrokenSoundError(str(getattr(error, "error_string", None) or error).rstrip(". ")) from None
        if len(piece) == 0:
            return
        yield piece


# ---------------------------------------------------------------------------------------------------- containers

@contextlib.contextmanager
def container(raw: BinaryIO, kind: str, name: object) -> Iterator[Sound]:
    """Decode the first sound in a container, with silence for a late start; kind: FFmpeg's name of the format.
    InputError if PyAV is not installed or there is no sound."""
    Requirement("av", f"PyAV (for a video, or a codec in {kind}; or convert it to WAV)", "video").check(name)
    import av

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
        known = kind not in _HEADLESS and stream.duration is not None and stream.time_base is not None
        seconds = float(stream.duration * stream.time_base) if known else 0.0
        # Late is what begins after the file does: the clocks of transport and program streams begin anywhere.
        begin = float(stream.start_time * stream.time_base) if stream.start_time and stream.time_base else 0.0
        late = begin - (file.start_time or 0) / av.time_base if begin else 0.0
        late = late if _OFFSET < late < _MOST_OFFSET else 0.0
        yield Sound(rate, round((seconds + late) * rate), _of_container(file, stream, rate, late, seconds),
                    tracks=len(file.streams.audio))


def _of_container(file: Any, stream: Any, rate: int, late: float, seconds: float) -> Iterator[NDArray[np.float32]]:
    import av

    if late:
        yield np.zeros((round(late * rate), 1), np.float32)
    floats, frames = None, 0
    try:
        # The frame None flushes.
        for frame in itertools.chain(file.decode(stream), [None]):
            if floats is None and frame is not None:
                # Not one row per channel: PyAV 18 crashes with eight of them.
                floats = av.AudioResampler(format="flt", layout=frame.layout, rate=rate)
            for part in floats.resample(frame) if floats is not None else ():
                frames += part.samples
                yield np.asarray(part.to_ndarray(), np.float32).reshape(-1, part.layout.nb_channels)
    except (av.error.FFmpegError, ValueError) as error:
        if not frames:
            raise BrokenSoundError(f"{stream.codec_context.name} in {file.format.name}") from None
        raise BrokenSoundError(str(error).splitlines()[0][:120] if str(error) else type(error).__name__) from None
    # A cut file has more than this; of Vorbis in a WAV no decoder finds its frames.
    if frames < _LEAST * seconds * rate:
        raise BrokenSoundError(f"{stream.codec_context.name} in {file.format.name}")
