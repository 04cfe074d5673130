"""The data types of the scripted performer."""

from __future__ import annotations

from dataclasses import dataclass

from data_module.types import Speech


@dataclass(frozen=True)
class Syllable:
    """A spoken syllable, seconds. `vowel` is the onset of its vowel, where a gesture's beat belongs.

    word: index into the words of the speech. loudness: dB against the recording's median syllable. pitch: semitones
    against the recording's median (0 where unvoiced). prominence: z-score, the weighted sum of loudness, duration and
    pitch with a bonus for content words.
    """

    start: float
    vowel: float
    end: float
    word: int
    loudness: float
    pitch: float
    prominence: float


@dataclass(frozen=True)
class Phrase:
    """A stretch of speech between pauses, seconds, with the effort (-1 to 1) it was spoken with."""

    start: float
    end: float
    effort: float


SCRIPTED = "script_"
"""Beginning of the name of a clip that was drawn from a script; all others were captured from people."""


@dataclass(frozen=True)
class Spoken:
    """Speech with everything that the performer uses; `speech.words` holds the words, `language` is ISO 639-1."""

    speech: Speech
    syllables: tuple[Syllable, ...]
    phrases: tuple[Phrase, ...]
    language: str
