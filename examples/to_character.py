"""Animate your own character with a recording, from Mixamo, VRM or elsewhere: its file with one more animation.

    python examples/to_character.py examples/speech.flac character.glb talk.glb
"""

from __future__ import annotations

import sys

from gesticulator import Gesticulator


def main(sound: str, character: str, output: str) -> None:
    """Gesture on a character that stands on her legs, saved in the format of the output's suffix."""
    gesture = Gesticulator.from_pretrained()(sound, legs=True)
    print(gesture.on(character).save(output))


if __name__ == "__main__":
    main(*sys.argv[1:])
