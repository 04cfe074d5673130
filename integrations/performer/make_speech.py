"""Speak the example recording: `python integrations/performer/make_speech.py [examples/speech.flac]` (needs flite).

Our own words in a voice that the shipped weights were not trained on, with a pause to show that the character rests.
"""

from __future__ import annotations

import sys

import numpy as np
from gesticulator_performer.text import Part, Utterance
from gesticulator_performer.voices import speak

from data_module.speech.audio import write_flac

VOICE = "awb"
TEXT = [
    [("hello, and welcome", 0.4, 0.25), ("this is a voice that nobody has recorded", 0.1, 0.8)],
    [("I speak,", 0.2, 0.2), ("and the person on your screen finds the gestures for it", 0.5, 0.7)],
    [("sometimes I am quiet,", -0.8, 0.3), ("and hardly anything needs to move", -0.9, 0.9)],
    [("and sometimes I want you to look right here,", 0.9, 0.2), ("because this is the important part", 1.0, 3.2)],
    [("you see, in a pause the arms come to rest", 0.0, 0.6)],
    [("then we go on,", 0.3, 0.25), ("first slowly,", -0.3, 0.3), ("then faster,", 0.3, 0.2),
     ("and then with everything I have got", 1.0, 0.7)],
    [("thank you for listening", 0.1, 1.5)],
]


def main() -> None:
    """Entry point."""
    utterances = [Utterance(tuple(Part(*part) for part in parts), "statement") for parts in TEXT]
    spoken = speak(utterances, VOICE, np.random.default_rng(3))
    target = sys.argv[1] if len(sys.argv) > 1 else "examples/speech.flac"
    write_flac(target, spoken.speech)
    print(f"{target}: {spoken.speech.duration:.1f} s")


if __name__ == "__main__":
    main()
