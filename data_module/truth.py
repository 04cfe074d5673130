"""The intentions of a scripted performance, the ground truth of a corpus: flat records of text, numbers and booleans,
so that a store can keep them as columns."""

from __future__ import annotations

from dataclasses import dataclass


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
JOIN, REST = "join", "rest"


@dataclass(frozen=True)
class Mark:
    """A place in the motion, seconds. what: `JOIN`, where two stretches of real motion were joined (start is end), or
    `REST`, a pause in which the arms are meant to be still."""

    what: str
    start: float
    end: float


@dataclass(frozen=True)
class StyleKnot:
    """The style at a time, seconds; linear between knots. 0 is neutral, 1 is strong."""

    time: float
    amplitude: float
    tempo: float


@dataclass(frozen=True)
class PhaseSpan:
    """A phase of a gesture unit of one hand, seconds, measured on the finished motion (`motion.phases`).

    hand: "left" or "right"; phase: "preparation", "stroke", "hold" or "retraction"; unit: the number of its unit among
    those of the hand. apex: hardest deceleration of a stroke (its end in other phases). size: metres from the start of
    a stroke to its end, 0 elsewhere. Between units the hand rests.
    """

    hand: str
    phase: str
    unit: int
    start: float
    end: float
    apex: float
    size: float


@dataclass(frozen=True)
class Truth:
    """The strokes, syllables, phrases, marks, style and phases of one recording, each in order of time."""

    strokes: tuple[PlayedStroke, ...] = ()
    syllables: tuple[Syllable, ...] = ()
    phrases: tuple[Phrase, ...] = ()
    marks: tuple[Mark, ...] = ()
    style: tuple[StyleKnot, ...] = ()
    phases: tuple[PhaseSpan, ...] = ()


TABLES: dict[str, type] = {"strokes": PlayedStroke, "syllables": Syllable, "phrases": Phrase, "marks": Mark,
                           "style": StyleKnot, "phases": PhaseSpan}
"""Field of `Truth` -> type of its records."""
