"""Speech from a sound file or from samples in any common format, converted to mono 16 kHz.

A recording is decoded piece by piece, so an hour of 48 kHz stereo is never in memory at its original rate.
"""

import contextlib
import io
import math
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import opened, write_bytes
from data_module.speech.sound_files import BrokenSoundError, NoSoundError, Sound, decoder
from data_module.types import Samples, Speech

__all__ = ["SoundWarning", "as_speech", "load_speech"]

SpeechInput: TypeAlias = "Speech | str | os.PathLike[str] | BinaryIO | NDArray[Any]"
"""A recording: a `Speech`, a sound file by its path or as a binary stream, or samples [n] or [n, channels]."""

SAMPLE_RATE = 16000
"""Sample rate of every `Speech` that this module returns, hertz."""
SHORTEST = 0.3
"""Shortest recording, seconds; anything shorter has no block."""
SOUNDS = (".flac", ".wav", ".mp3", ".ogg", ".opus", ".m4a", ".aac", ".webm", ".mp4", ".mkv", ".mov", ".aiff", ".aif",
          ".caf", ".wma", ".amr", ".3gp", ".avi")
"""Suffixes of sound files, and of videos with sound, in order of preference."""

# Range of sample rates, hertz: below the first there is no intelligible speech, and no sound card exceeds the second.
_LOWEST_RATE, _HIGHEST_RATE = 1000, 768_000
# Hertz of a telephone, below which consonants are lost: at 5.5 kHz the hands are 10 cm from those of the whole sound.
_TELEPHONE_RATE = 8000
# Largest sample in floating point, times full scale (24 dB), that is clipped; more indicates another unit.
_FULL_SCALE = 16.0
# Most channels; more indicate that samples and channels are swapped.
_MOST_CHANNELS = 1024
_USUAL_CHANNELS = 8  # (7.1) above which as few samples indicate the same
# Numbers of channels with a centre (5.1, 7.1), and its least power with speech, of the strongest's.
_WITH_CENTRE, _LEAST_CENTRE = (6, 8), 0.06
# Power of the mean of channels, of what it would be if they were unrelated, below which they cancel one another.
_CANCELLED = 0.25
# Speech over noise of a mean below which it is noisy, and by how much a channel must be clearer; power of no noise.
_NOISY, _CLEARER, _NO_NOISE = 3.0, 10.0, 1e-7
# Mean of the samples, as a share of their standard deviation, above which the zero line of a recorder is off: of 377
# real recordings 335 have less than a hundredth, and 25 more than this. At a sixth, hands are 8 cm out of place.
_OFF_ZERO = 0.05
# Levels that are told apart up to full scale; the share of samples at the loudest one above which a recording is
# clipped, and their part of the samples within a hundredth of it: a sine has a fifth there, a cut wave nearly all.
_LEVELS, _CLIPPED, _CUT_OFF = 2048, 0.002, 0.4
# Seconds that may be missing at the end, because of encoder padding and rounding.
_CUT = 0.25


class SoundWarning(UserWarning):
    """A recording that is not as a microphone gives it, and what was done about it."""


def load_speech(source: str | os.PathLike[str] | BinaryIO) -> Speech:
    """Read a recording (any rate, any number of channels) as mono speech at `SAMPLE_RATE`.

    source: a path, or a binary stream such as `sys.stdin.buffer` with a sound file: WAV, FLAC, OGG, MP3 and other
    formats of libsndfile, and with PyAV installed M4A, MP4, WebM and other containers. Channels are averaged; of 5.1
    the centre is taken, and where a mean would lose the speech, because channels cancel one another or one is noisy,
    the one with the speech. A zero line that is off is moved to 0. `SoundWarning` for a channel that is taken alone,
    for a low sample rate and for a clipped recording.

    `InputError` for anything that is not a recording of at least `SHORTEST` seconds, and for one with fewer samples
    than its header promises.
    """
    name = _name_of(source)

    def read(channel: int | None = None) -> tuple[Samples, _Survey]:
        with decoder(raw, name) as sound:
            _check_rate(sound.rate, name)
            survey = _Survey(sound.rate, sound.centre, sound.tracks)
            return np.concatenate(list(_mono(sound, name, survey, channel))), survey

    try:
        with _opened(source) as raw:
            samples, survey = read()
            if (channel := survey.channel()) is not None:
                # Once more from its beginning: all channels of an hour would not fit into memory.
                samples, _ = read(channel)
    except NoSoundError as error:
        raise InputError(name, "is not sound that can be decoded", "give a WAV, FLAC, OGG or MP3 file") from error
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror or error})", "check the path and its rights") from None
    survey.warn(name, channel)
    return Speech(_centred(samples), SAMPLE_RATE)


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
    survey, samples = _Survey(round(sample_rate)), _checked(np.asarray(given), sample_rate)
    survey.add(samples)
    channel = survey.channel()
    if len(samples) < SHORTEST * survey.rate:
        raise InputError("speech", f"lasts {len(samples) / survey.rate:.2f} s, too short for a gesture",
                         f"give {SHORTEST} s or more")
    survey.warn("speech", channel)
    return Speech(_centred(np.clip(_mixed(samples, channel), -1.0, 1.0)), survey.rate)


def _check_rate(rate: float, name: object = "") -> None:
    if not _LOWEST_RATE <= rate <= _HIGHEST_RATE or rate != round(rate):
        raise InputError(name or f"sample_rate {rate:g}", f"{rate:g} samples per second are out of range",
                         f"give {_LOWEST_RATE} to {_HIGHEST_RATE}")


class SampleFeed:
    """Streamed samples to mono at `SAMPLE_RATE`: the same result as of `as_speech`, `amplified` and `resample` for all
    of them, whatever the pieces. Channels are averaged always, and a zero line that is off stays so: which channel has
    the speech, and the mean of a sound, are not known at its start."""

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
        mono = np.clip(_mixed(_checked(np.asarray(samples), self.rate, self._taken)), -1.0, 1.0)
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


def _checked(samples: NDArray[Any], rate: float, before: int = 0) -> NDArray[np.floating[Any]]:
    """Samples of any type of number as [n, channels] in floating point. before: samples that came before these."""
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
    samples = samples.reshape(-1, channels)
    _check_scale(samples, "speech", rate, before)
    return samples


def _check_scale(samples: NDArray[np.floating[Any]], name: object, rate: float, before: int) -> None:
    """`InputError` for samples that are not numbers or far beyond full scale. before: samples before these."""
    if not len(samples) or (peak := np.abs(samples).max()) <= _FULL_SCALE:
        return
    if np.isfinite(peak):
        raise InputError(name, f"holds samples up to {peak:.3g}, where full scale is 1",
                         "export it again, scaled to [-1, 1]")
    at = (before + int(np.argmin(np.isfinite(samples).all(axis=1)))) / rate
    raise InputError(name, f"holds a sample that is not a number (NaN or infinite) at {at:.1f} s",
                     "export it again from its source")


def _mixed(samples: NDArray[np.floating[Any]], channel: int | None = None) -> Samples:
    """[n, channels] as [n]: the mean of the channels, or one of them."""
    only = 0 if samples.shape[1] == 1 else channel
    return np.ascontiguousarray(samples.mean(axis=1) if only is None else samples[:, only], dtype=np.float32)


def _centred(samples: Samples) -> Samples:
    """The samples about 0, changed in place, if a recorder's zero line was elsewhere: pauses would not be silent."""
    offset = float(samples.mean(dtype=np.float64))
    power = float(np.dot(samples, samples)) / len(samples) - offset ** 2
    if offset ** 2 > _OFF_ZERO ** 2 * max(power, 0.0):
        samples -= np.float32(offset)
    return samples


class _Survey:
    """Where in the channels of a recording the speech is, and whether it is clipped; from its pieces, in order."""

    def __init__(self, rate: int, centre: int = 2, tracks: int = 1) -> None:
        self.rate, self._channels, self._centre, self._tracks = rate, 1, centre, tracks
        self._powers: list[NDArray[np.float32]] = []
        self._counts = np.zeros(_LEVELS + 1, np.int64)

    def add(self, piece: NDArray[np.floating[Any]]) -> None:
        heights = np.minimum(np.abs(piece), 1.0) * _LEVELS
        self._counts += np.bincount(heights.ravel().astype(np.intp), minlength=_LEVELS + 1)
        self._channels = piece.shape[1]
        if self._channels > 1 and len(piece):
            # Power in stretches of 10 ms of each channel, and of their mean.
            size = min(len(piece), max(1, self.rate // 100))
            count = len(piece) // size
            parts = piece[:count * size].reshape(count, size, -1)
            parts = np.concatenate([parts, parts.mean(axis=2, keepdims=True)], axis=2)
            self._powers.append((parts ** 2).mean(axis=1).astype(np.float32))

    def channel(self) -> int | None:
        """The channel that is to be taken; None for the mean of all."""
        if not self._powers:
            return None
        powers = np.concatenate(self._powers)
        # Speech comes and goes; hum and noise stay.
        noise = np.percentile(powers, 10, axis=0)
        *alone, mean = (powers.mean(axis=0) - noise).tolist()
        clear = (powers.mean(axis=0) - noise) / np.maximum(noise, _NO_NOISE)
        loudest = int(np.argmax(alone))
        if len(alone) in _WITH_CENTRE and alone[self._centre] > _LEAST_CENTRE * alone[loudest]:
            return self._centre
        if mean < _CANCELLED * sum(alone) / len(alone) ** 2:
            return loudest
        return int(np.argmax(clear)) if clear[-1] < min(_NOISY, clear.max() / _CLEARER) else None

    def warn(self, name: object, channel: int | None) -> None:
        if self._tracks > 1:
            _warn(name, f"has {self._tracks} tracks of sound, of which the first is taken")
        if channel is not None:
            why = "of which it is the centre" if self._channels in _WITH_CENTRE and channel == self._centre \
                else "as the speech is lost when they are mixed"
            _warn(name, f"channel {channel + 1} is taken of {self._channels}, {why}")
        if self.rate < _TELEPHONE_RATE:
            _warn(name, f"has {self.rate} samples per second and so lacks consonants; record it at 16 kHz or more")
        top = int(np.flatnonzero(self._counts)[-1]) if self._counts.any() else 0
        cut, near = self._counts[top] / max(1, self._counts.sum()), self._counts[math.ceil(0.99 * top):].sum()
        # What is never louder than a tenth of full scale is silence with a step.
        if top > 0.1 * _LEVELS and cut > _CLIPPED and self._counts[top] > _CUT_OFF * near:
            _warn(name, f"is clipped ({cut:.1%} of its samples), and strokes may follow that; record it less loudly")


def _warn(name: object, remark: str) -> None:
    warnings.warn(SoundWarning(f"{name}: {remark}"), stacklevel=4)


# ---------------------------------------------------------------------------------------------------- reading

def _name_of(source: str | os.PathLike[str] | BinaryIO) -> object:
    if isinstance(source, str | os.PathLike):
        return Path(source)
    name = getattr(source, "name", "")
    return name if isinstance(name, str) and name and not name.startswith("<") else "standard input"


@contextlib.contextmanager
def _opened(source: str | os.PathLike[str] | BinaryIO) -> Iterator[BinaryIO]:
    """The sound file as a seekable stream, from its beginning."""
    with contextlib.ExitStack() as files:
        if isinstance(source, str | os.PathLike):
            raw = files.enter_context(opened(source))
        elif source.seekable():
            raw = source
        else:
            # Decoders seek, and a pipe cannot.
            raw = cast(BinaryIO, files.enter_context(tempfile.TemporaryFile()))
            shutil.copyfileobj(source, raw)
        if not raw.seek(0, io.SEEK_END):
            raise InputError(_name_of(source), "is empty", "record or copy it again")
        raw.seek(0)
        yield raw


def _mono(sound: Sound, name: object, survey: _Survey, channel: int | None) -> Iterator[Samples]:
    """All samples as mono at `SAMPLE_RATE`, piece by piece; `InputError` for too few."""
    rate, feed = sound.rate, SampleFeed(sound.rate)
    frames = given = 0
    try:
        for piece in sound.pieces:
            frames += len(piece)
            _check_scale(piece, name, rate, frames - len(piece))
            survey.add(piece)
            mono = feed.resampled(_mixed(piece, channel))
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

