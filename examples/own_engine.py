"""Rotations for your own engine: one JSON object per frame, ready to be put on the bones of a character.

    python examples/own_engine.py examples/speech.flac frames.jsonl

The rotations are local (in the parent's frame), relative to a T-pose; Y is up, the character faces +Z and its left is
+X. Quaternions are w first here; Unity, Unreal, three.js and glTF put w last, and so does the file.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from gesticulator import Gesticulator


def main(sound: str, output: str) -> None:
    """Write {"time": seconds, "bones": {name: [x, y, z, w]}} for each frame, at 30 frames per second."""
    gesture = Gesticulator.from_pretrained()(sound, fps=30)
    last = gesture.rotations[..., [1, 2, 3, 0]]  # [T, J, 4], w last
    with Path(output).open("w", encoding="utf-8") as file:
        for frame, pose in enumerate(last.round(6).tolist()):
            bones = dict(zip(gesture.joints, pose, strict=True))
            file.write(json.dumps({"time": frame / gesture.fps, "bones": bones}) + "\n")
    print(f"{len(last)} frames of {len(gesture.joints)} bones -> {output}")


if __name__ == "__main__":
    main(*sys.argv[1:])
