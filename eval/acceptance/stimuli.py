"""The sounds of the acceptance, made of the voices that are at hand.

What is wanted of rest, of speech without pauses, of effort and of a second export cannot be found in every recording.
So each set of stimuli is made: voices with pauses set in and voices without any, a faint voice, noise and silence
alone; readings said again with another effort by Praat (Boersma and Weenink; PSOLA, Moulines and Charpentier 1990); the
same sound as a tool might export it again; the same sound with other words. All are mono float32 samples.

What fools it: rate alone makes strokes faster, so that lively readings are also judged by their amplitude.
"""

import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import soundfile
from numpy.typing import NDArray
from scipy.signal import resample_poly

from data_module.corpora.folder import SOUNDS
from data_module.motion.phases import runs
from data_module.speech.audio import SAMPLE_RATE, amplified, load_speech, resample
from data_module.speech.silence import FRAME, frame_levels, pauses, silent_frames
from data_module.types import Array, Speech, Word
from eval.clip.excerpts import excerpt_of_speech
from eval.metrics.eye import hear
from eval.metrics.eye.voice import TRACK_HZ
from eval.renderings import AcceptanceVoice

REAL_PAUSE = 1.0
"""Seconds: a shorter gap may be bridged by a movement."""
PAUSES = (1.2, 2.0, 3.5, 5.0, 1.2, 3.5)
"""Seconds of the pauses that are set in."""
FAINT_GAIN, FAINT_NOISE = -46.0, -75.0
"""Decibels of the faint voice, and level of the noise under it, dBFS."""
GAP, _BREATH, _FADE = 0.3, 0.08, 0.02
"""Seconds: gaps of this length are cut out of speech without pauses; the part of each that stays; a fade over the cut.
"""
READINGS = "speech"
"""Folder of GESTICULATOR_DATA."""
_LOWEST_PITCH, _HIGHEST_PITCH = 60.0, 500.0
"""Hertz: the range in which Praat looks for the voice."""
_TILT_FROM, _TILT_TO = 500.0, 4000.0
"""Hertz between which the spectrum is tilted."""
_LOUD = 25.0
"""Decibels under the loudest frame that count for the level."""
_STUDIO_RATE = 48000
"""Hertz of the second sampling rate."""
_MP3_LEVEL = 0.4
"""The compression of soundfile that gives 192 kbit/s at that rate."""
_EXPORT_NOISE = -60.0
"""Level of the noise of an export, dBFS."""


# ------------------------------------------------------------------------------------------------ pauses and silence

def noise(seconds: float, level: float, rate: int, seed: int = 0) -> Array:
    """White noise at a level in dBFS (a full-scale square wave is 0)."""
    return 10.0 ** (level / 20.0) * np.random.default_rng(seed).normal(size=round(seconds * rate))


def pauses_in(speech: Speech) -> Array:
    """[n, 2] seconds of pauses of `REAL_PAUSE` or longer, as the system finds them."""
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    spans = np.array(runs(quiet)).reshape(-1, 2) * FRAME
    return spans[spans[:, 1] - spans[:, 0] >= REAL_PAUSE]


def with_pauses(speech: Speech, lengths: Sequence[float] = PAUSES) -> Speech:
    """A voice with silences of these lengths (s) set in evenly, each at the quietest moment nearby.

    They hold noise at the voice's own quiet level (the 5th percentile of its frames), and the words are dropped.
    """
    rate = speech.sample_rate
    levels = frame_levels(speech.samples, rate)
    # Over 15 frames, so that the gap between two syllables is preferred to one quiet frame within a word.
    smooth = np.convolve(levels, np.ones(15) / 15, mode="same")
    # Digital silence would be a louder change than a pause of a room, and speech without a pause has no quiet level.
    quiet = float(np.clip(np.percentile(levels, 5), -90.0, -50.0))
    around = max(1, len(levels) // (2 * (len(lengths) + 1)))
    pieces, start = [], 0
    for index, length in enumerate(lengths):
        middle = len(levels) * (index + 1) // (len(lengths) + 1)
        first = max(middle - around // 2, 0)
        at = round((first + int(smooth[first:middle + around // 2 + 1].argmin()) + 0.5) * FRAME * rate)
        pieces += [speech.samples[start:at], noise(length, quiet, rate, index)]
        start = at
    # Words are dropped: their times would no longer be those of the sound.
    samples = np.concatenate([*pieces, speech.samples[start:]])
    return Speech(samples.astype(np.float32), rate, None, speech.speaker)


def unbroken(speech: Speech) -> Speech:
    """A voice without pauses: of each of `GAP` seconds or more a short breath of `_BREATH` seconds is left. What is all
    silence stays as it is."""
    rate, pieces, begun = speech.sample_rate, [], 0
    # By the judge's silences, not by the system's: speech without pauses must have none to either.
    quiet = np.array(runs(hear(speech).silent)).reshape(-1, 2) / TRACK_HZ
    for start, stop in quiet[quiet[:, 1] - quiet[:, 0] >= GAP].tolist():
        pieces.append(speech.samples[begun:round((start + _BREATH / 2) * rate)])
        begun = round((stop - _BREATH / 2) * rate)
    pieces = [piece for piece in (*pieces, speech.samples[begun:]) if len(piece) > 2 * round(_FADE * rate)]
    return replace(speech, samples=_spliced(pieces, round(_FADE * rate)), words=None) if pieces else speech


def _spliced(pieces: Sequence[NDArray[np.float32]], fade: int) -> NDArray[np.float32]:
    """Pieces one after the other, each faded into the next over so many samples."""
    # A linear fade: a hard cut would be an onset, which the figures count.
    rise, out = np.linspace(0.0, 1.0, fade), pieces[0].astype(np.float64)
    for piece in pieces[1:]:
        out[-fade:] = out[-fade:] * (1.0 - rise) + piece[:fade] * rise
        out = np.concatenate([out, piece[fade:]])
    return out.astype(np.float32)


def in_noise(speech: Speech, level: float) -> Speech:
    """A voice with white noise of that level, dBFS, and without its words."""
    background = noise(speech.duration, level, speech.sample_rate)[:len(speech.samples)]
    return replace(speech, samples=np.clip(speech.samples + background, -1.0, 1.0).astype(np.float32), words=None)


def faint(speech: Speech) -> Speech:
    """A voice 46 dB too low, in noise."""
    return in_noise(amplified(speech, FAINT_GAIN), FAINT_NOISE)


def derived(voice: AcceptanceVoice, name: str, speech: Speech) -> AcceptanceVoice:
    """A sound made of a voice, as a voice of its own; without words."""
    return AcceptanceVoice(f"{voice.name} {name}", replace(speech, words=None), group=voice.group or voice.name)


def middle_of(voice: AcceptanceVoice, seconds: float) -> Speech:
    """The middle `seconds` of a voice at the models' sampling rate, with its words."""
    return excerpt_of_speech(resample(voice.speech, SAMPLE_RATE), seconds)


# ------------------------------------------------------------------------------------------------------------- effort

@dataclass(frozen=True)
class VocalEffort:
    """pitch: factor on the distance from the median pitch, in semitones; tilt: dB an octave over 500 Hz; rate: factor
    on the rate of speech."""

    pitch: float
    tilt: float
    rate: float


LIVELY, SUBDUED = VocalEffort(1.8, 3.0, 1.15), VocalEffort(0.5, -3.0, 0.87)


def said_with(speech: Speech, effort: VocalEffort) -> Speech:
    """A reading with another effort at its own level, without its words. ImportError without praat-parselmouth."""
    import parselmouth
    from parselmouth.praat import call

    sound = parselmouth.Sound(speech.samples.astype(np.float64), speech.sample_rate)
    manipulation = call(sound, "To Manipulation", 0.01, _LOWEST_PITCH, _HIGHEST_PITCH)
    pitch = call(manipulation, "Extract pitch tier")
    if call(pitch, "Get number of points"):
        median = float(np.median([call(pitch, "Get value at index", k + 1)
                                  for k in range(call(pitch, "Get number of points"))]))
        call(pitch, "Formula", f"{median} * exp({effort.pitch} * ln(self / {median}))")
        call([pitch, manipulation], "Replace pitch tier")
    # Praat stretches durations, the inverse of the rate.
    lasting = call("Create DurationTier", "rate", 0, speech.duration)
    call(lasting, "Add point", 0, 1.0 / effort.rate)
    call([lasting, manipulation], "Replace duration tier")
    samples = np.asarray(call(manipulation, "Get resynthesis (overlap-add)").values[0], dtype=np.float64)
    samples = tilted(samples, speech.sample_rate, effort.tilt)
    # The tilt and the resynthesis change the level, and effort is to be heard without it.
    level = loudness(speech.samples.astype(np.float64), speech.sample_rate)
    gain = level / max(loudness(samples, speech.sample_rate), 1e-9)
    return replace(speech, samples=(gain * samples).astype(np.float32), words=None)


def tilted(samples: Array, rate: int, decibels: float) -> Array:
    """Samples [n] whose spectrum rises by so many dB an octave from 500 to 4000 Hz."""
    # In the frequency domain: linear phase, so no onset moves.
    spectrum, frequencies = np.fft.rfft(samples), np.fft.rfftfreq(len(samples), 1.0 / rate)
    octaves = np.log2(np.clip(frequencies, _TILT_FROM, _TILT_TO) / _TILT_FROM)
    return np.asarray(np.fft.irfft(spectrum * 10.0 ** (decibels * octaves / 20.0), len(samples)))


def loudness(samples: Array, rate: int) -> float:
    """Root mean square of the frames of 20 ms that are within 25 dB of the loudest one."""
    size = round(0.02 * rate)
    power = (samples[:len(samples) // size * size].reshape(-1, size) ** 2).mean(axis=1)
    return float(np.sqrt(power[power >= power.max() * 10.0 ** (-_LOUD / 10.0)].mean()))


def readings() -> list[tuple[str, Speech]]:
    """Name and sound of the readings in GESTICULATOR_DATA, at the models' sampling rate; none without it."""
    place = os.environ.get("GESTICULATOR_DATA")
    files = sorted((Path(place) / READINGS).glob("*")) if place else []
    return [(file.stem, resample(load_speech(file), SAMPLE_RATE)) for file in files if file.suffix.lower() in SOUNDS]


# ----------------------------------------------------------------------------------------------------- second exports

def _at_studio_rate(speech: Speech, mp3: bool = False) -> Speech:
    """At 48 kHz and back, by a polyphase filter that the product does not use; there as an MP3 of 192 kbit/s or not."""
    # In double precision there and back, so that what is left is the filter and no rounding.
    ratio, file = _STUDIO_RATE // SAMPLE_RATE, io.BytesIO()
    samples = resample_poly(speech.samples.astype(np.float64), ratio, 1)
    if mp3:
        soundfile.write(file, np.clip(samples, -1.0, 1.0), _STUDIO_RATE, format="MP3", bitrate_mode="CONSTANT",
                        compression_level=_MP3_LEVEL)
        file.seek(0)
        # libsndfile takes the delay of the encoder off.
        samples = soundfile.read(file)[0]
    return replace(speech, samples=resample_poly(samples, 1, ratio).astype(np.float32))


EXPORTS: Mapping[str, Callable[[Speech], Speech]] = {
    "0.1 dB quieter": lambda speech: amplified(speech, -0.1), "1 dB quieter": lambda speech: amplified(speech, -1.0),
    "6 dB quieter": lambda speech: amplified(speech, -6.0), "resampled from 48 kHz": _at_studio_rate,
    "MP3, 192 kbit/s": lambda speech: _at_studio_rate(speech, mp3=True),
    "noise at -60 dB": lambda speech: in_noise(speech, _EXPORT_NOISE)}
"""Changes that a tool may make to a sound that it exports again."""


# -------------------------------------------------------------------------------------------------------------- words

def word_changed(speech: Speech) -> tuple[Speech, float]:
    """The longest word in the middle third becomes the longest other word of the transcript, at its time; and when it
    begins, seconds. ValueError if there are not two words."""
    words = [word for word in speech.words or () if word.text.strip()]
    # Neither the first nor the last gesture units, which have nothing before or after them to compare.
    middle = words[len(words) // 3:max(2 * len(words) // 3, len(words) // 3 + 1)]
    chosen = max(middle, key=lambda word: len(word.text), default=None)
    others = [word.text for word in words if chosen is not None and word.text.lower() != chosen.text.lower()]
    if chosen is None or not others:
        raise ValueError("fewer than two words")
    longest = max(others, key=len)
    changed = tuple(replace(word, text=longest) if word is chosen else word for word in speech.words or ())
    return replace(speech, words=changed), chosen.start


def other_words(speech: Speech, others: Sequence[Word]) -> Speech:
    """The same speech whose words, in their own times, are another's; ValueError where either has none."""
    texts = [word.text for word in others if word.text.strip()]
    if not texts or not speech.words:
        raise ValueError("both must have words")
    changed = tuple(replace(word, text=texts[k % len(texts)]) if word.text.strip() else word
                    for k, word in enumerate(speech.words))
    return replace(speech, words=changed)
