"""Process every recording of a folder, with its transcript if there is one; report and skip unreadable files.

    python examples/folder.py recordings/ out/
"""

from __future__ import annotations

import sys
from pathlib import Path

from gesticulator import Gesticulator, InputError


def main(recordings: str, out: str) -> None:
    """NAME.wav or NAME.flac, and NAME.txt beside it, become NAME.bvh."""
    gesticulator = Gesticulator.from_pretrained()  # once: loading takes longer than a short recording
    for sound in sorted(Path(recordings).iterdir()):
        if sound.suffix.lower() not in (".wav", ".flac"):
            continue
        transcript = sound.with_suffix(".txt")
        try:
            gesture = gesticulator(sound, text=transcript if transcript.exists() else None)
        except InputError as error:
            print(error, file=sys.stderr)
            continue
        print(gesture.save(Path(out) / f"{sound.stem}.bvh"))


if __name__ == "__main__":
    main(*sys.argv[1:])
