"""Voices of flite, phrase by phrase: samples, and the word that each phone belongs to.

flite prints the end time of each phone but not its word. The phones of each word are looked up once by speaking the
word alone; the phones of the phrase are then aligned with them at minimal edit cost, which tolerates sounds that merge
or change between words.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import soundfile

from data_module.errors import InputError
from data_module.types import Samples
from gesticulator_performer.sound import RATE, Phone, Sounded, trimmed, word_spans

_VOWEL_NAMES = "aa ae ah ao aw ax axr ay eh el em en er ey ih ix iy ow oy uh uw"
VOWELS = frozenset(_VOWEL_NAMES.split())
_PAUSE = "pau"
_PHONE = re.compile(r"([a-z]+):([0-9.]+)")
_WORD = re.compile(r"\w+(?:'\w+)*")


def sound_phrase(base: str, text: str, pitch: float, deviation: float, stretch: float) -> Sounded:
    """Speak a phrase with the voice `base`. pitch, deviation: Hz (target mean and standard deviation of F0);
    stretch: factor on the normal duration. InputError if flite is missing or lacks the voice."""
    samples, timed = timed_phrase(base, text, pitch, deviation, stretch)
    words = _WORD.findall(text)
    phones = _in_words(timed, words)
    if not phones:
        raise InputError(f"flite voice {base}", f"spoke nothing of {text!r}", "give it words")
    samples, phones = trimmed(samples, phones)
    return Sounded(samples, word_spans(words, phones), phones)


def timed_phrase(base: str, text: str, pitch: float, deviation: float, stretch: float
                 ) -> tuple[Samples, list[tuple[str, float, float]]]:
    """Samples at 16 kHz and (phone, start, end) of each phone in seconds, pauses ("pau") included; as `sound_phrase`,
    without the words of the phones."""
    with tempfile.TemporaryDirectory() as folder:
        wave = Path(folder) / "phrase.wav"
        printed = _call("-voice", base, "--setf", f"int_f0_target_mean={pitch:.3f}", "--setf",
                        f"int_f0_target_stddev={deviation:.3f}", "--setf", f"duration_stretch={stretch:.4f}",
                        "-psdur", "-t", text, "-o", str(wave))
        samples, rate = soundfile.read(wave, dtype="float32")
    if rate != RATE:
        raise InputError(f"flite voice {base}", f"speaks at {rate} Hz, not {RATE}", "use slt, rms, awb or kal16")
    return np.ascontiguousarray(samples), _timed(printed)


def _call(*arguments: str) -> str:
    try:
        return subprocess.run(["flite", *arguments], capture_output=True, check=True, text=True, timeout=120).stdout
    except FileNotFoundError:
        raise InputError("flite", "is not installed", "on Debian: apt install flite") from None
    except subprocess.CalledProcessError as error:
        raise InputError("flite", f"failed: {error.stderr.strip()[:200]}", "on Debian: apt install flite") from None


def _timed(printed: str) -> list[tuple[str, float, float]]:
    """(phone, start, end) of each phone; flite restarts its clock with each utterance it splits the text into."""
    timed: list[tuple[str, float, float]] = []
    for line in printed.splitlines():
        offset, before = (timed[-1][2] if timed else 0.0), 0.0
        for name, end in _PHONE.findall(line):
            timed.append((name, offset + before, offset + float(end)))
            before = float(end)
    return timed


@lru_cache(maxsize=20000)
def phones_of(word: str) -> tuple[str, ...]:
    printed = _call("-voice", "kal16", "-ps", "-t", word, "-o", "none")
    return tuple(name for name in printed.split() if name != _PAUSE)


def _in_words(timed: list[tuple[str, float, float]], words: list[str]) -> tuple[Phone, ...]:
    spoken = [entry for entry in timed if entry[0] != _PAUSE]
    if not words or len(spoken) < len(words):
        return ()
    owners = assigned([name for name, _, _ in spoken], [phones_of(word.lower()) for word in words])
    return tuple(Phone(name, start, end, name in VOWELS, owner)
                 for (name, start, end), owner in zip(spoken, owners, strict=True))


def assigned(phones: list[str], words: list[tuple[str, ...]]) -> list[int]:
    """The word index of each phone, by the monotone alignment with the phones of each word at minimal cost. A
    substitution costs 1 within vowels or within consonants and 3 across; an insertion or deletion costs 1.2. Every word
    gets a phone: a word without any takes the nearest one of its neighbour."""
    expected = [(name, index) for index, word in enumerate(words) for name in word]
    rows, columns = len(phones), len(expected)
    cost = np.full((rows + 1, columns + 1), np.inf)
    cost[0, :] = 1.2 * np.arange(columns + 1)
    cost[:, 0] = 1.2 * np.arange(rows + 1)
    step = np.zeros((rows + 1, columns + 1), dtype=np.int8)
    step[0, 1:], step[1:, 0] = 2, 1
    for i in range(1, rows + 1):
        for j in range(1, columns + 1):
            swap = _substitution(phones[i - 1], expected[j - 1][0])
            options = (cost[i - 1, j - 1] + swap, cost[i - 1, j] + 1.2, cost[i, j - 1] + 1.2)
            step[i, j] = int(np.argmin(options))
            cost[i, j] = options[step[i, j]]
    owners = [-1] * rows
    i, j = rows, columns
    while i > 0:
        if step[i, j] == 0:
            owners[i - 1] = expected[j - 1][1]
            i, j = i - 1, j - 1
        elif step[i, j] == 1:
            owners[i - 1] = expected[max(j - 1, 0)][1]
            i -= 1
        else:
            j -= 1
    return _every_word(owners, len(words))


def _substitution(one: str, other: str) -> float:
    if one == other:
        return 0.0
    return 1.0 if (one in VOWELS) == (other in VOWELS) else 3.0


def _every_word(owners: list[int], words: int) -> list[int]:
    """The same rising list, where a word without a phone takes one from the nearest word that has two."""
    counts = np.bincount(owners, minlength=words)
    while (counts == 0).any():
        empty = int(np.flatnonzero(counts == 0)[0])
        rich = np.flatnonzero(counts > 1)
        giver = int(rich[np.abs(rich - empty).argmin()])
        counts[giver] -= 1
        counts[empty] += 1
    return np.repeat(np.arange(words), counts).tolist()
