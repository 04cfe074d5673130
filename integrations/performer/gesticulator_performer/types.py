"""The data types of the scripted performer."""

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
class PlayedStroke:
    """The plan of one stroke and its clip. Seconds from the start.

    lexeme: the clip's lexeme name ("BeatMid"); clip: the clip's file stem; hand: "left", "right", "both", or "none" if
    head and trunk alone move.
    beat: the planned motion beat (the syllable plus a random deviation); syllable: its vowel onset. start, hold_end,
    end: start of the movement, end of the hold, end of the retraction as played. gain: factor on the clip's excursion.
    held_out: the clip is one of the strokes for test. meaning: label of the gesture that a word calls for and the
    clip shows ("point_there"), "" for a beat; word: index of the word that it falls on, -1 if unknown.
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
    meaning: str = ""
    word: int = -1


SCRIPTED = "script_"
"""Beginning of the name of a clip that was drawn from a script; all others were captured from people."""


@dataclass(frozen=True)
class Spoken:
    """Speech with everything that the performer uses; `speech.words` holds the words, `language` is ISO 639-1."""

    speech: Speech
    syllables: tuple[Syllable, ...]
    phrases: tuple[Phrase, ...]
    language: str


@dataclass(frozen=True)
class Played:
    """A finished performance: motion on the performer's own skeleton at 60 fps (fingers included), and its strokes."""

    motion: Motion
    strokes: tuple[PlayedStroke, ...]
