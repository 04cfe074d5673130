"""The data types of the scripted performer; the records of its intentions are in `data_module.truth`."""

from __future__ import annotations

from dataclasses import dataclass

from data_module.truth import Phrase, PlayedStroke, Syllable
from data_module.types import Motion, Speech


@dataclass(frozen=True)
class Spoken:
    """Speech with everything that the performer uses; `speech.words` holds the words, `language` is ISO 639-1."""

    speech: Speech
    syllables: tuple[Syllable, ...]
    phrases: tuple[Phrase, ...]
    language: str


@dataclass(frozen=True)
class Played:
    """A finished performance: motion on the performer's own skeleton at 60 fps (fingers included), and its truth."""

    motion: Motion
    strokes: tuple[PlayedStroke, ...]
