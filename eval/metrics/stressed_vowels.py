"""Where the stressed vowels of read English are: phones by forced alignment (pocketsphinx), stress by espeak-ng.

This asks neither loudness nor pitch, so that it can judge what was found by them. Words whose vowels the two programs
count differently are left out.
"""

from __future__ import annotations

import functools
import itertools
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from data_module.speech.audio import resample
from data_module.text.alignment import ALIGNER_RATE
from data_module.types import Speech, Word

__all__ = ["available", "stressed_vowels"]

_VOWELS = frozenset(["AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW"])
_IPA_VOWELS = frozenset("aɐɑɒæʌəɚɜɝeɛiɪoɔuʊʉyøœɨɵɘᵻ")
_FRAME = 0.01
_PAUSE, _LONGEST, _MARGIN = 0.15, 8.0, 0.1
"""Seconds: a pause at which the sound is cut, the longest piece, and what is added at its ends."""


def available() -> bool:
    """Whether both programs are installed."""
    from data_module.text.alignment import aligner_installed

    return aligner_installed() and shutil.which("espeak-ng") is not None


def stressed_vowels(speech: Speech) -> dict[int, float]:
    """Index of a word -> seconds at which its stressed vowel begins, for the words at which it is known."""
    sound = resample(speech, ALIGNER_RATE).samples
    samples = np.round(np.clip(sound, -1.0, 1.0) * 32767.0).astype(np.int16)
    decoder = _decoder()
    out: dict[int, float] = {}
    for piece in _pieces(speech.words or ()):
        begin = max(piece[0][1].start - _MARGIN, 0.0)
        part = samples[round(begin * ALIGNER_RATE):round((piece[-1][1].end + _MARGIN) * ALIGNER_RATE)]
        texts = [re.sub("[^a-z']", "", word.text.lower()) for _, word in piece]
        for (number, _), text, vowels in zip(piece, texts, _vowels(decoder, part.tobytes(), texts), strict=False):
            stressed, count = _stress(text)
            if len(vowels) == 1:
                stressed, count = 0, 1
            if stressed is not None and len(vowels) == count:
                out[number] = begin + vowels[stressed]
    return out


def _pieces(words: Sequence[Word]) -> Iterator[list[tuple[int, Word]]]:
    """The words with their numbers, cut at pauses."""
    piece: list[tuple[int, Word]] = []
    for number, word in enumerate(words):
        if not word.text.strip():
            continue
        if piece and (word.start - piece[-1][1].end > _PAUSE or word.end - piece[0][1].start > _LONGEST):
            yield piece
            piece = []
        piece.append((number, word))
    if piece:
        yield piece


def _vowels(decoder: Any, samples: bytes, texts: Sequence[str]) -> list[list[float]]:
    """For each word: seconds at which its vowels begin; nothing where the words cannot be aligned."""
    if any(not text or decoder.lookup_word(text) is None for text in texts):
        return []
    try:
        decoder.set_align_text(" ".join(texts))
        _decode(decoder, samples)
        if decoder.hyp() is None:
            return []
        decoder.set_alignment()
        _decode(decoder, samples)
        found = [(word.name, [_FRAME * phone.start for phone in word if phone.name in _VOWELS])
                 for word in decoder.get_alignment()]
    except RuntimeError:
        return []
    spoken = [vowels for name, vowels in found if name[0] not in "<[+"]
    return spoken if len(spoken) == len(texts) else []


def _decode(decoder: Any, samples: bytes) -> None:
    decoder.start_utt()
    decoder.process_raw(samples, full_utt=True)
    decoder.end_utt()


def _decoder() -> Any:
    from pocketsphinx import Decoder

    return Decoder(samprate=ALIGNER_RATE, loglevel="FATAL")


@functools.cache
def _stress(word: str) -> tuple[int | None, int]:
    """Which vowel of an English word bears the main stress, None if none is marked, and how many it has."""
    ipa = subprocess.run(["espeak-ng", "-q", "--ipa", "-v", "en-us", "--", word], capture_output=True, text=True,
                         check=True, timeout=60).stdout.strip()
    count, stressed, marked = 0, None, False
    for is_vowel, run in itertools.groupby(ipa, key=lambda sign: sign in _IPA_VOWELS):
        if not is_vowel:
            marked = marked or "ˈ" in "".join(run)
            continue
        if marked and stressed is None:
            stressed = count
        marked, count = False, count + 1
    return stressed, count
