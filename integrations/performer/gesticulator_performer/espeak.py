"""Voices of espeak-ng in many languages; the times of words and phones come from the library's events."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from data_module.errors import InputError
from data_module.types import Samples
from gesticulator_performer.espeak_child import NO_VOICE, PHONEME_EVENT, WORD_EVENT
from gesticulator_performer.sound import RATE, Phone, Sounded, trimmed, word_spans

# The first letter of espeak's mnemonics for vowels, in English, German and Spanish.
_VOWEL_LETTERS = frozenset("aAeEiIoOuUyYV0389@W&")
_TOKEN = re.compile(r"[^\W_]+(?:['’][^\W_]+)*")


@dataclass(frozen=True)
class Line:
    """A phrase for espeak-ng: voice ("en-us+f3"), text, words per minute, pitch and pitch range (0 to 99)."""

    voice: str
    text: str
    rate: int
    pitch: int
    range: int


_CHILD = "from gesticulator_performer.espeak_child import main; main()"
_Output = tuple[NDArray[np.int16], NDArray[np.int64], list[str], int]
"""Samples [n], events [e, 3] and their names, and the samples a second."""


def sound_phrases(lines: Sequence[Line]) -> list[Sounded]:
    """Speak all phrases in one subprocess; the same list gives the same samples. InputError if espeak-ng is missing or
    lacks a voice."""
    return [_sounded(line.text, *of_line) for line, of_line in zip(lines, _spoken(lines), strict=True)]


def _spoken(lines: Sequence[Line], *options: str) -> list[_Output]:
    """The output of the subprocess (`espeak_child`) for each line."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spoken.npz"
        done = subprocess.run([sys.executable, "-c", _CHILD, str(path), *options],
                              input=json.dumps([asdict(line) for line in lines]), capture_output=True, text=True,
                              timeout=600, cwd=Path(__file__).parents[1])
        if done.returncode == NO_VOICE:
            raise InputError("espeak-ng", f"lacks some of the voices {sorted({line.voice for line in lines})}",
                             "on Debian: apt install espeak-ng")
        if done.returncode != 0:
            raise InputError("espeak-ng", "its library cannot be used", "on Debian: apt install espeak-ng")
        with np.load(path) as spoken:
            return [(spoken[f"samples_{i}"], spoken[f"events_{i}"], spoken[f"names_{i}"].tolist(), int(spoken["rate"]))
                    for i in range(len(lines))]


def ipa_phrases(lines: Sequence[Line]) -> list[tuple[Samples, list[tuple[str, float, float]]]]:
    """Phrases in any language: samples at 16 kHz, and (IPA symbol, start, end) of each phone in seconds. Raises as
    `sound_phrases`."""
    out = []
    for samples, events, names, rate in _spoken(lines, "ipa"):
        ends = [*(events[1:, 2] / rate).tolist(), len(samples) / rate]
        phones = [(name, start / rate, end) for (kind, _, start), name, end in
                  zip(events.tolist(), names, ends, strict=True) if kind == PHONEME_EVENT]
        out.append((_resampled(samples, rate), phones))
    return out


def _resampled(samples: NDArray[np.int16], rate: int) -> Samples:
    common = np.gcd(RATE, rate)
    return resample_poly(samples.astype(np.float32) / 32768, RATE // common, rate // common).astype(np.float32)


def _sounded(text: str, samples: NDArray[np.int16], events: NDArray[np.int64], names: list[str], rate: int) -> Sounded:
    tokens = [(match.group(), match.start(), match.end()) for match in _TOKEN.finditer(text)]
    phones: list[Phone] = []
    word = -1
    ends = [*events[1:, 2].tolist(), len(samples)]
    for (kind, position, start), name, end in zip(events.tolist(), names, ends, strict=True):
        if kind == WORD_EVENT:
            word = max(word, _token_at(tokens, position - 1))
        elif kind == PHONEME_EVENT and name and name[0] not in "_|;" and end > start:
            vowel = name[0] in _VOWEL_LETTERS or name.endswith("-")
            phones.append(Phone(name, start / rate, end / rate, vowel, max(word, 0)))
    if not phones:
        raise InputError("espeak-ng", f"spoke nothing of {text!r}", "give it words")
    cut, moved = trimmed(_resampled(samples, rate), _shared_out(tuple(phones), [token for token, _, _ in tokens]))
    return Sounded(cut, word_spans([token for token, _, _ in tokens], moved), moved)


def _token_at(tokens: list[tuple[str, int, int]], position: int) -> int:
    """Index of the token at a position of the text, or of the next one after it."""
    return next((i for i, (_, _, end) in enumerate(tokens) if position < end), len(tokens) - 1)


def _shared_out(phones: tuple[Phone, ...], tokens: list[str]) -> tuple[Phone, ...]:
    """Share out the phones of words that espeak-ng runs together ("of the") by the number of letters."""
    owners = [phone.word for phone in phones]
    for first in range(len(tokens)):
        if first in owners and first + 1 < len(tokens) and first + 1 not in owners:
            last = first + 1
            while last + 1 < len(tokens) and last + 1 not in owners:
                last += 1
            members = [i for i, owner in enumerate(owners) if owner == first]
            letters = np.cumsum([len(token) for token in tokens[first:last + 1]])
            for rank, member in enumerate(members):
                owners[member] = first + int(np.searchsorted(letters, (rank + 0.5) / len(members) * letters[-1]))
    missing = set(range(len(tokens))) - set(owners)
    if missing:
        owners = [min(i * len(tokens) // len(phones), len(tokens) - 1) for i in range(len(phones))]
    return tuple(Phone(p.name, p.start, p.end, p.vowel, owner) for p, owner in zip(phones, owners, strict=True))
