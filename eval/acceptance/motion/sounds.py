"""The sounds of the acceptance: voices with pauses, without any, faint, and noise alone.

What is asked of rest, of speech without pauses and of effort cannot be found in every recording, so it is made of the
voices that are at hand. Each is a voice of its own with the same performer, and has no words.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from data_module.speech.audio import SAMPLE_RATE, amplified, resample
from data_module.speech.silence import FRAME, frame_levels, pauses, silent_frames
from data_module.types import Array, Speech
from eval import stats
from eval.clip.excerpts import excerpt_of_speech
from eval.metrics.eye import hear
from eval.metrics.eye.voice import TRACK_HZ
from eval.renderings import AcceptanceVoice

REAL_PAUSE = 1.0
"""Seconds: a shorter gap may be played through."""
LENGTHS = (1.2, 2.0, 3.5, 5.0, 1.2, 3.5)
"""Seconds of the pauses that are set in."""
GAIN, HISS = -46.0, -75.0
"""Decibels of the faint voice, and level of the noise under it, dBFS."""
GAP, _LEFT, _FADE = 0.3, 0.08, 0.02
"""Seconds: gaps of this length are cut out of speech without pauses; what is left of each; and a fade over the cut."""


def noise(seconds: float, level: float, rate: int, seed: int = 0) -> Array:
    """White noise at a level in dBFS (a full-scale square wave is 0)."""
    return 10.0 ** (level / 20.0) * np.random.default_rng(seed).normal(size=round(seconds * rate))


def pauses_in(speech: Speech, shortest: float = REAL_PAUSE) -> Array:
    """[n, 2] seconds of pauses of `shortest` or longer, as the system finds them."""
    quiet = pauses(silent_frames(speech.samples, speech.sample_rate))
    spans = (stats.runs(quiet) * FRAME).astype(np.float64)
    return spans[spans[:, 1] - spans[:, 0] >= shortest]


def with_pauses(speech: Speech, lengths: Sequence[float] = LENGTHS) -> Speech:
    """A voice with silences of these lengths (s) set in evenly, each at the quietest moment nearby.

    They hold noise at the voice's own quiet level (the 5th percentile of its frames), and the words are dropped.
    """
    rate = speech.sample_rate
    levels = frame_levels(speech.samples, rate)
    smooth = np.convolve(levels, np.ones(15) / 15, mode="same")
    quiet = float(np.clip(np.percentile(levels, 5), -90.0, -50.0))
    around = max(1, len(levels) // (2 * (len(lengths) + 1)))
    pieces, begun = [], 0
    for index, length in enumerate(lengths):
        middle = len(levels) * (index + 1) // (len(lengths) + 1)
        first = max(middle - around // 2, 0)
        at = round((first + int(smooth[first:middle + around // 2 + 1].argmin()) + 0.5) * FRAME * rate)
        pieces += [speech.samples[begun:at], noise(length, quiet, rate, index)]
        begun = at
    samples = np.concatenate([*pieces, speech.samples[begun:]])
    return Speech(samples.astype(np.float32), rate, None, speech.speaker)


def unbroken(speech: Speech) -> Speech:
    """A voice without pauses: of each of `GAP` seconds or more a short breath of `_LEFT` seconds is left. What is all
    silence stays as it is."""
    rate, pieces, begun = speech.sample_rate, [], 0
    quiet = stats.runs(hear(speech).silent) / TRACK_HZ
    for start, stop in quiet[quiet[:, 1] - quiet[:, 0] >= GAP].tolist():
        pieces.append(speech.samples[begun:round((start + _LEFT / 2) * rate)])
        begun = round((stop - _LEFT / 2) * rate)
    pieces = [piece for piece in (*pieces, speech.samples[begun:]) if len(piece) > 2 * round(_FADE * rate)]
    return replace(speech, samples=_spliced(pieces, round(_FADE * rate)), words=None) if pieces else speech


def _spliced(pieces: Sequence[NDArray[np.float32]], fade: int) -> NDArray[np.float32]:
    """Pieces one after the other, each faded into the next over so many samples."""
    rise, out = np.linspace(0.0, 1.0, fade), pieces[0].astype(np.float64)
    for piece in pieces[1:]:
        out[-fade:] = out[-fade:] * (1.0 - rise) + piece[:fade] * rise
        out = np.concatenate([out, piece[fade:]])
    return out.astype(np.float32)


def faint(speech: Speech) -> Speech:
    """A voice 46 dB too low, in noise."""
    low = amplified(speech, GAIN)
    hiss = noise(low.duration, HISS, low.sample_rate)[:len(low.samples)]
    return replace(low, samples=(low.samples + hiss).astype(np.float32), words=None)


def made(voice: AcceptanceVoice, name: str, speech: Speech) -> AcceptanceVoice:
    """A voice of its own, in the habits of another's performer."""
    return AcceptanceVoice(f"{voice.name} {name}", replace(speech, words=None), "made", None, voice.performer,
                           voice.group or voice.name)


def spread_out(voices: Sequence[AcceptanceVoice], count: int) -> list[AcceptanceVoice]:
    """That many of the voices, the first one and others evenly chosen."""
    at = np.unique(np.linspace(0, len(voices) - 1, min(count, len(voices))).round().astype(int))
    return [voices[k] for k in at]


def heard_of(voice: AcceptanceVoice, seconds: float) -> Speech:
    """The middle of what is said, at the models' rate."""
    return excerpt_of_speech(resample(voice.speech, SAMPLE_RATE), seconds)
