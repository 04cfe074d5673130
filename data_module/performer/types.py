"""The nouns of the scripted performer."""

from __future__ import annotations

from dataclasses import dataclass

from data_module.types import Motion, Speech


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


@dataclass(frozen=True)
class Spoken:
    """Speech with everything a performer hears in it. `speech.words` holds the words; `language` is ISO 639-1."""

    name: str
    speech: Speech
    syllables: tuple[Syllable, ...]
    phrases: tuple[Phrase, ...]
    voice: str
    language: str


@dataclass(frozen=True)
class PlayedStroke:
    """What was planned for one stroke, and on which clip: the truth of the corpus. Seconds from the start.

    lexeme: the clip's lexeme name ("BeatMid"); clip: the clip's file stem; hand: "left", "right" or "both".
    beat: where its motion beat was planned (syllable plus human looseness); syllable: the vowel onset it belongs to.
    start, hold_end, end: move start, end of the hold, end of the retraction as played. gain: excursion over the clip's.
    held_out: True when the clip belongs to the strokes kept for test.
    """

    lexeme: str
    clip: str
    hand: str
    start: float
    beat: float
    hold_end: float
    end: float
    syllable: float
    gain: float
    held_out: bool


@dataclass(frozen=True)
class Played:
    """A finished performance: motion on the performer's own skeleton at 60 fps (fingers included), and its truth."""

    motion: Motion
    strokes: tuple[PlayedStroke, ...]
    performer: str
