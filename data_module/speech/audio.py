"""Speech from a sound file or from samples in any common format, converted to mono 16 kHz.

A recording is decoded piece by piece, so an hour of 48 kHz stereo is never in memory at its original rate.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import opened, write_bytes
from data_module.speech.silence import (
    FAINTEST_SPEECH,
    MARGIN,
    TYPICAL_LEVEL,
    frame_levels,
    loudness,
)
from data_module.speech.sound_files import (
    BrokenSoundError,
    NoSoundError,
    Sound,
    decoder,
)
from data_module.types import Samples, Speech

__all__ = ["as_speech", "load_speech"]

SpeechInput: TypeAlias = "Speech | str | os.PathLike[str] | BinaryIO | NDArray[Any]"
"""A recording: a `Speech`, a sound file by its path or as a binary stream, or samples [n] or [n, channels]."""

SAMPLE_RATE = 16000
"""Sample rate of every `Speech` that this module returns, hertz."""
SHORTEST = 0.3
"""Shortest recording, seconds; anything shorter has no block."""
LONGEST = 3600.0
"""Longest recording without `any_length`, seconds: an hour takes 0.7 GB and some minutes."""
SOUNDS = (".flac", ".wav", ".mp3", ".ogg", ".opus", ".m4a", ".aac", ".webm", ".mp4", ".mkv", ".mov")
"""Suffixes of sound files, and of videos with sound, in order of preference."""
LOW_LEVEL = -45.0
"""Level of speech, dBFS, below which a recording is about 20 dB too low and quiet syllables get lost."""

# Range of sample rates, hertz: below the first there is no intelligible speech, and no sound card exceeds the second.
_LOWEST_RATE, _HIGHEST_RATE = 1000, 768_000
# Largest sample in floating point, times full scale (24 dB), that is clipped; more indicates another unit.
_FULL_SCALE = 16.0
# Most channels; more indicate that samples and channels are swapped.
_MOST_CHANNELS = 1024
# Channels (7.1) above which as few samples indicate the same.
_USUAL_CHANNELS = 8
# Seconds that may be missing at the end, because of encoder padding and rounding.
_CUT = 0.25
# Bytes that are read from a pipe at a time.
_STREAM_PIECE = 1 << 20


def load_speech(source: str | os.PathLike[str] | BinaryIO, any_length: bool = False) -> Speech:
    """Read a recording (any rate, any number of channels) as mono speech at `SAMPLE_RATE`.

    source: a path, or a binary stream such as `sys.stdin.buffer` with a sound file: WAV, FLAC, OGG, MP3 and other
    formats of libsndfile, and with PyAV installed M4A, MP4, WebM and other containers. any_length: accept more than
    `LONGEST` seconds. Channels are averaged.

    `InputError` for anything that is not a recording of at least `SHORTEST` seconds, and for one with fewer samples
    than its header promises.
    """
    name = _name_of(source)
    try:
        with _opened(source, any_length) as raw, decoder(raw, name) as sound:
            _check_sound(sound, name, any_length)
            return Speech(np.concatenate(list(_mono(sound, name, any_length))), SAMPLE_RATE)
    except NoSoundError as error:
        raise InputError(name, "is not sound that can be decoded", "give a WAV, FLAC, OGG or MP3 file") from error
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror or error})", "check the path and its rights") from None


def as_speech(given: SpeechInput, sample_rate: float | None = None) -> Speech:
    """Convert any `SpeechInput` to `Speech`. sample_rate: hertz, for samples only. Samples are [n] or [n, channels],
    which are averaged; floating-point ones lie in [-1, 1], integers are divided by the full scale of their type.
    `InputError` for anything else, and for less than `SHORTEST` seconds of samples."""
    if isinstance(given, Speech | str | os.PathLike) or hasattr(given, "read"):
        if sample_rate is not None:
            raise InputError("sample_rate", "is given with a recording that has a rate", "leave it out")
        return given if isinstance(given, Speech) else load_speech(cast("str | BinaryIO", given))
    if sample_rate is None:
        raise InputError("sample_rate", "is missing", "give it with the samples: g(samples, 16000)")
    _check_rate(sample_rate)
    samples = _as_mono(np.asarray(given))
    if len(samples) < SHORTEST * sample_rate:
        raise InputError("speech", f"lasts {len(samples) / sample_rate:.2f} s, too short for a gesture",
                         f"give {SHORTEST} s or more")
    return Speech(samples, round(sample_rate))


def _check_rate(rate: float) -> None:
    if not _LOWEST_RATE <= rate <= _HIGHEST_RATE or rate != round(rate):
        raise InputError(f"sample_rate {rate:g}", "is out of range",
                         f"give {_LOWEST_RATE} to {_HIGHEST_RATE} samples per second")


class SampleFeed:
    """Streamed samples to mono at `SAMPLE_RATE`: the same result as of `as_speech`, `amplified` and `resample` for all
    of them, whatever the pieces."""

    def __init__(self, sample_rate: float, gain: float = 0.0) -> None:
        _check_rate(sample_rate)
        self.rate, self._gain = round(sample_rate), gain
        self._taken = 0
        self._resampler = None
        if self.rate != SAMPLE_RATE:
            import soxr

            self._resampler = soxr.ResampleStream(self.rate, SAMPLE_RATE, 1, dtype="float32")

    @property
    def seconds(self) -> float:
        return self._taken / self.rate

    def take(self, samples: NDArray[Any]) -> Samples:
        """The output at `SAMPLE_RATE` after some more samples [n] or [n, channels]; `InputError` for invalid samples,
        which are not taken."""
        mono = _as_mono(np.asarray(samples))
        self._taken += len(mono)
        if self._gain:
            mono = np.clip(mono * 10.0 ** (self._gain / 20), -1.0, 1.0).astype(np.float32)
        return self.resampled(mono)

    def finish(self) -> Samples:
        return self.resampled(np.zeros(0, np.float32), last=True)

    def resampled(self, mono: Samples, last: bool = False) -> Samples:
        if self._resampler is None:
            return mono
        return np.clip(self._resampler.resample_chunk(mono, last=last), -1.0, 1.0).astype(np.float32)


def check_file(name: Path, any_length: bool = False) -> None:
    """`InputError` if a path cannot be a recording, or its header indicates more than `LONGEST`; without decoding."""
    with opened(name) as raw:
        _check_size(raw, name)
    seconds = 0.0 if any_length else header_seconds(name)
    if seconds > LONGEST:
        raise _too_long(name, f"its header indicates {_hours(seconds)}")


def _check_size(raw: BinaryIO, name: object) -> None:
    if not raw.seek(0, io.SEEK_END):
        raise InputError(name, "is empty", "record or copy it again")
    raw.seek(0)


def header_seconds(name: Path) -> float:
    """Length of a recording from its header, seconds; 0 if unknown."""
    with contextlib.suppress(OSError, NoSoundError, InputError), name.open("rb") as raw, decoder(raw, name) as sound:
        return sound.frames / sound.rate
    return 0.0


def level_note(speech: Speech) -> str | None:
    """A note for the user on a recording whose level is far too low, with the gain to apply; None for others."""
    frames = loudness(frame_levels(speech.samples, speech.sample_rate))
    levels = frames.levels
    if levels.max() <= FAINTEST_SPEECH:
        return f"all of it is silence (its loudest 10 ms are at {levels.max():.0f} dBFS); record it again"
    loud = levels > np.maximum(frames.floor + MARGIN, FAINTEST_SPEECH)
    level = float(levels[loud].mean() if loud.any() else levels.max())
    if level >= LOW_LEVEL:
        return None
    gain = round(TYPICAL_LEVEL - level)
    return f"its speech is at {level:.0f} dBFS, nearly silent; amplify it by {gain} dB (--gain {gain})"


def amplified(speech: Speech, decibels: float) -> Speech:
    """The speech amplified by some decibels, clipped at full scale; itself for 0."""
    if decibels == 0:
        return speech
    samples = np.clip(speech.samples * 10.0 ** (decibels / 20), -1.0, 1.0).astype(np.float32)
    return replace(speech, samples=samples)


def resample(speech: Speech, sample_rate: int) -> Speech:
    import soxr

    if speech.sample_rate == sample_rate:
        return speech
    samples = soxr.resample(speech.samples, speech.sample_rate, sample_rate)
    return replace(speech, samples=np.clip(samples, -1.0, 1.0).astype(np.float32), sample_rate=sample_rate)


def write_flac(path: str | os.PathLike[str], speech: Speech) -> None:
    """Write speech as 16-bit FLAC, atomically. Samples beyond [-1, 1] are clipped."""
    import soundfile

    memory = io.BytesIO()
    soundfile.write(memory, np.clip(speech.samples, -1.0, 1.0), speech.sample_rate, format="FLAC", subtype="PCM_16")
    write_bytes(path, memory.getvalue())


def _as_mono(samples: NDArray[Any]) -> Samples:
    """[n] or [n, channels] of any type of number to [n] in [-1, 1]."""
    if samples.ndim not in (1, 2) or samples.dtype.kind not in "fiu":
        raise InputError("speech", f"is an array of {samples.dtype} shaped {list(samples.shape)}",
                         "give samples [n] or [n, channels] as numbers")
    channels = samples.shape[1] if samples.ndim == 2 else 1
    if not 1 <= channels <= _MOST_CHANNELS or channels > _USUAL_CHANNELS >= len(samples) > 0:
        raise InputError("speech", f"is shaped {list(samples.shape)}, which is {channels} channels",
                         "give [n, channels]: samples first")
    if samples.dtype.kind in "iu":
        half = 2.0 ** (8 * samples.dtype.itemsize - 1)
        # Unsigned samples (8-bit WAV) are centred on half of their range.
        samples = (samples.astype(np.float64) - (half if samples.dtype.kind == "u" else 0.0)) / half
    if samples.ndim == 2:
        samples = samples.mean(axis=1, dtype=np.float64)
    if len(samples) and not np.abs(samples).max() <= _FULL_SCALE:  # also NaN
        raise InputError("speech", f"holds samples up to {np.abs(samples).max():.3g}, where full scale is 1",
                         "scale them to [-1, 1]")
    return np.clip(samples, -1.0, 1.0).astype(np.float32)


# ---------------------------------------------------------------------------------------------------- reading

def _name_of(source: str | os.PathLike[str] | BinaryIO) -> object:
    if isinstance(source, str | os.PathLike):
        return Path(source)
    name = getattr(source, "name", "")
    return name if isinstance(name, str) and name and not name.startswith("<") else "standard input"


@contextlib.contextmanager
def _opened(source: str | os.PathLike[str] | BinaryIO, any_length: bool) -> Iterator[BinaryIO]:
    """The sound file as a seekable stream, from its beginning."""
    with contextlib.ExitStack() as files:
        if isinstance(source, str | os.PathLike):
            raw = files.enter_context(opened(source))
        elif source.seekable():
            raw = source
        else:
            # Decoders seek, and a pipe cannot.
            raw = cast(BinaryIO, files.enter_context(tempfile.TemporaryFile()))
            _spool(source, raw, any_length)
        _check_size(raw, _name_of(source))
        yield raw


def _spool(source: BinaryIO, copy: BinaryIO, any_length: bool) -> None:
    most = math.inf if any_length else LONGEST * _HIGHEST_RATE  # bytes: an hour of 96 kHz stereo in floating point
    while data := source.read(_STREAM_PIECE):
        copy.write(data)
        if copy.tell() > most:
            raise _too_long("standard input", "it has more bytes than an hour of sound")


def _check_sound(sound: Sound, name: object, any_length: bool) -> None:
    rate = sound.rate
    if not _LOWEST_RATE <= rate <= _HIGHEST_RATE:
        raise InputError(name, f"has {rate} samples per second", "record at 8 kHz or more, or export it again")
    if not any_length and sound.frames > LONGEST * rate:
        raise _too_long(name, f"its header indicates {_hours(sound.frames / rate)}")


def _mono(sound: Sound, name: object, any_length: bool) -> Iterator[Samples]:
    """All samples as mono at `SAMPLE_RATE`, piece by piece; `InputError` for too few or too many."""
    rate, feed = sound.rate, SampleFeed(sound.rate)
    most = math.inf if any_length else LONGEST * rate
    frames = given = 0
    try:
        for piece in sound.pieces:
            frames += len(piece)
            if frames > most:
                raise _too_long(name, "it continues beyond that")
            mono = feed.resampled(_averaged(piece, name))
            given += len(mono)
            yield np.clip(mono, -1.0, 1.0)  # resampling overshoots a little at full scale
    except BrokenSoundError as error:
        raise InputError(name, f"breaks off: it cannot be decoded to its end ({error})",
                         "copy it again from its source") from None
    if frames == 0:
        raise InputError(name, "holds no samples", "record or copy it again")
    # The resampler holds back as much as its filter is long.
    rest = feed.finish()
    given += len(rest)
    yield rest
    if frames < sound.frames - _CUT * rate:
        raise InputError(name, f"is cut short: {frames / rate:.2f} s of the {sound.frames / rate:.2f} s that its "
                         "header promises", "copy it again from its source")
    if given < round(SHORTEST * SAMPLE_RATE):
        raise InputError(name, f"lasts {given / SAMPLE_RATE:.2f} s, too short for a gesture",
                         f"give {SHORTEST} s or more")


def _averaged(piece: np.ndarray, name: object) -> Samples:
    if not np.abs(piece).max() <= _FULL_SCALE:  # also NaN
        raise InputError(name, f"holds samples that are not numbers, or up to {np.abs(piece).max():.3g}, where full "
                         "scale is 1", "export it again, scaled to [-1, 1]")
    return np.ascontiguousarray(piece.mean(axis=1, dtype=np.float32))


def _too_long(name: object, why: str) -> InputError:
    return InputError(name, f"lasts longer than {_hours(LONGEST)} ({why})",
                      "cut it, or say any_length=True")


def _hours(seconds: float) -> str:
    return f"{seconds / 3600:.3g} hour{'' if seconds == 3600 else 's'}"
