"""Turn a recording into a VRM animation, which plays on every VRM character (three-vrm, UniVRM, VRM viewers).

    python examples/to_vrm.py examples/speech.flac talk.vrma
"""

from __future__ import annotations

import sys

from gesticulator import Gesticulator


def main(sound: str, output: str) -> None:
    """Gesture of the upper body: legs stay as the player has them."""
    print(Gesticulator.from_pretrained()(sound).save(output))


if __name__ == "__main__":
    main(*sys.argv[1:])
