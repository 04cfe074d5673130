"""Place gestures at words.

    python examples/gestures_at_words.py examples/speech.flac examples/speech.txt "bread=wave,slowly=shrug" o.bvh
"""

from __future__ import annotations

import sys

from gesticulator import Gesticulator
from gesticulator.plan.gestures import GESTURES
from gesticulator.plan.plan import GestureCue


def main(sound: str, said: str, wanted: str, output: str) -> None:
    """A gesture for each WORD=GESTURE; the others are left to the models."""
    cues = []
    for one in wanted.split(","):
        word, _, gesture = one.partition("=")
        cues.append(GestureCue(gesture, word))
    made = Gesticulator.from_pretrained()(sound, text=said, cues=tuple(cues))
    print(f"{made.save(output)}: {wanted}; there are {len(GESTURES)} names (gesticulator gestures), and those of the "
          f"lexicon, such as {made.plan().lexicon[0].name}")


if __name__ == "__main__":
    main(*sys.argv[1:])
