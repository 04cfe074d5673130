"""From the bytes of a sound file to samples at its own rate, piece by piece: one decoder for each family of formats.

WAV, FLAC, OGG and their like are decoded by libsndfile here; MP3 by libsndfile in a process of its own (`mp3_child`
tells why); M4A, MP4, WebM and other containers, the sound of a video among them, by FFmpeg through PyAV.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

PIECE = 1 << 18
"""Numbers that are decoded at a time, over all channels: 1 MiB."""
PYAV = "pip install 'gesticulator[video]'"
"""What brings the decoder of containers."""

_OFFSET = 0.02
"""Seconds that the sound of a video may begin late before it is moved: half a frame of film."""
_MOST_OFFSET = 60.0
"""Seconds beyond which such a beginning is not believed."""
_CUT = 0.25
"""Seconds that may be missing at the end of a container: what encoders add at both ends, and rounding."""


@dataclass(frozen=True)
class Sound:
    """A sound file that is being decoded.

    rate: samples per second. frames: samples per channel by its header, 0 where it does not say. pieces: samples
    [n, channels], to be gone through once; they raise `BrokenSoundError`. known: frames can be relied on.
    """

    rate: int
    frames: int
    pieces: Iterator[NDArray[np.float32]]
    known: bool = False


class NoSoundError(Exception):
    """The file is none that the decoder knows."""


class BrokenSoundError(Exception):
    """The file cannot be decoded to its end; the message says why."""


# ---------------------------------------------------------------------------------------------------- libsndfile

@contextlib.contextmanager
def sndfile(raw: BinaryIO) -> Iterator[Sound]:
    """Whatever libsndfile reads."""
    import soundfile

    class ForwardOnlyFile(soundfile.SoundFile):
        """Only ever read forwards: where the length is open, a seek after each piece fails."""

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


# ---------------------------------------------------------------------------------------------------- MP3

@contextlib.contextmanager
def mpeg(raw: BinaryIO) -> Iterator[Sound]:
    """MP3, by libsndfile in a process of its own; in this one where Python is frozen into a program."""
    if not sys.executable or getattr(sys, "frozen", False):
        with sndfile(raw) as sound:
            yield sound
        return
    code = Path(__file__).with_name("mp3_child.py").read_text(encoding="utf-8") + "\nmain()\n"
    # The same packages as here, and never those of the folder that the user stands in (-P).
    paths = os.pathsep.join(path for path in sys.path if path)
    raw.seek(0)
    with _as_file(raw) as given, subprocess.Popen(
            [sys.executable, "-P", "-c", code, str(PIECE // 2)], stdin=given, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": paths}) as child:
        assert child.stdout is not None
        try:
            head = json.loads(child.stdout.readline() or b"{}")
            if "rate" not in head:
                raise NoSoundError(head.get("error", "its decoder did not start"))
            yield Sound(head["rate"], head["frames"], _of_child(child.stdout, head["channels"]))
        finally:
            child.kill()


@contextlib.contextmanager
def _as_file(raw: BinaryIO) -> Iterator[IO[bytes]]:
    """The same bytes as a file that a process can be given."""
    if isinstance(getattr(raw, "raw", raw), io.FileIO):
        # The process reads from where the system stands in the file, not from where Python's buffer does.
        os.lseek(raw.fileno(), 0, os.SEEK_SET)
        yield raw
        return
    with tempfile.TemporaryFile() as file:
        shutil.copyfileobj(raw, file)
        file.seek(0)
        yield file


def _of_child(stream: IO[bytes], channels: int) -> Iterator[NDArray[np.float32]]:
    while True:
        count = int.from_bytes(stream.read(4), "little", signed=True)
        if count < 0:
            raise BrokenSoundError(stream.readline().decode("utf-8", "replace").strip(". \n"))
        if count == 0:
            return
        data = stream.read(4 * count * channels)
        if len(data) < 4 * count * channels:
            raise BrokenSoundError("the decoder stopped")
        yield np.frombuffer(data, dtype="<f4").reshape(count, channels)


# ---------------------------------------------------------------------------------------------------- containers

@contextlib.contextmanager
def container(raw: BinaryIO, kind: str, name: object) -> Iterator[Sound]:
    """The first sound in a container; kind: FFmpeg's name of the format, so that it guesses nothing.

    What begins late in the video begins late here. InputError where PyAV is not installed or there is no sound.
    """
    try:
        import av
    except ImportError:
        raise InputError(name, "is a video, or sound in a container, and what reads those (PyAV) is not installed",
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
        # Of a codec that FFmpeg does not know there is no context, and then no rate either.
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
                # Whatever the codec's type of number, floats, one row for each channel.
                planes = av.AudioResampler(format="fltp", layout=frame.layout, rate=rate)
            for part in planes.resample(frame):
                yield np.ascontiguousarray(part.to_ndarray().T, dtype=np.float32)
        for part in planes.resample(None) if planes is not None else ():
            yield np.ascontiguousarray(part.to_ndarray().T, dtype=np.float32)
    except (av.error.FFmpegError, ValueError) as error:
        raise BrokenSoundError(str(error).splitlines()[0][:120] if str(error) else type(error).__name__) from None
