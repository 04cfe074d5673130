"""How words are pronounced, as visemes: by the dictionary of pocketsphinx in English, else by the program espeak-ng."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import TypeAlias

from data_module.text.alignment import aligner_installed, can_follow, dictionary_phones, spoken_words
from data_module.text.meaning import language_of
from data_module.visemes import of_arpabet, of_ipa

Pronunciation: TypeAlias = tuple[int, ...]
"""The visemes of a word in order, no two neighbours equal."""

_VOICES = {"en": "en-us", "de": "de", "es": "es"}
"""Language -> voice of espeak-ng."""
_LISTED = re.compile(r"[^\w'’ ]+|_+")
_ONCE = 200
"""Words of one call of the program."""


def pronunciations(words: Sequence[str]) -> list[tuple[Pronunciation, ...]] | None:
    """For each word the ways to say it, () for a word without any; None if no source knows their language.

    words: as they are written, in one language. The language is found by its commonest words.
    """
    language, text = language_of(words), " ".join(words)
    if language == "en" and not can_follow(text):
        return None
    if language == "en" and aligner_installed():
        return [_in_dictionary(word) for word in words]
    if shutil.which("espeak-ng") is None:
        return None
    known = dict(_by_espeak(tuple(dict.fromkeys(words)), _VOICES[language]))
    return [known[word] for word in words]


def _merged(visemes: Sequence[int]) -> Pronunciation:
    return tuple(one for place, one in enumerate(visemes) if place == 0 or one != visemes[place - 1])


@lru_cache(maxsize=20000)
def _in_dictionary(word: str) -> tuple[Pronunciation, ...]:
    """All ways to say an English word; a word of several parts ("real-time") has the first way of each."""
    parts = [dictionary_phones(plain) for _, plain in spoken_words(word)]
    if not parts:
        return ()
    ways = parts[0] if len(parts) == 1 else [[phone for part in parts for phone in part[0]]]
    said = (_merged([one for phone in way for one in of_arpabet(phone)]) for way in ways)
    return tuple(dict.fromkeys(way for way in said if way))


def _by_espeak(words: Sequence[str], voice: str) -> Iterator[tuple[str, tuple[Pronunciation, ...]]]:
    for first in range(0, len(words), _ONCE):
        some = words[first:first + _ONCE]
        plain = [" ".join(_LISTED.sub(" ", word).split()) for word in some]
        spoken = [word for word in plain if word]
        lines = _printed(spoken, voice)
        if len(lines) != len(spoken):  # the program took a word for several clauses
            lines = [" ".join(_printed([word], voice)) for word in spoken]
        phones = iter(lines)
        for word, there in zip(some, plain, strict=True):
            way = _merged([one for phone in next(phones).split() for one in of_ipa(phone)]) if there else ()
            yield word, (way,) if way else ()


def _printed(words: Sequence[str], voice: str) -> list[str]:
    """The IPA of each word, its phones separated by spaces."""
    done = subprocess.run(["espeak-ng", "-q", "--ipa", "--sep= ", "-v", voice, "--stdin"], capture_output=True,
                          input="\n\n".join(words) + "\n\n", text=True, timeout=120, encoding="utf-8")
    return [line.strip() for line in done.stdout.split("\n") if line.strip()] if done.returncode == 0 else []
