"""Turn a recording into motion and a page that plays it.

    python examples/file_to_bvh.py examples/speech.flac gesture.bvh gesture.html
"""

from __future__ import annotations

import sys

from gesticulator import Gesticulator


def main(sound: str, *outputs: str) -> None:
    """Gesture for one recording, saved in the format of each output's suffix."""
    gesticulator = Gesticulator.from_pretrained()
    gesture = gesticulator(sound, seed=1)
    for output in outputs:
        print(gesture.save(output))


if __name__ == "__main__":
    main(*sys.argv[1:])
