"""Compare another system's motion with the speakers' own and with ours, on the same recordings, in one table.

    python examples/score.py recordings/ their_output/ score.json

recordings/ holds NAME.bvh and NAME.wav of people who speak; their_output/ holds what the other system made for the same
sounds, as NAME.bvh, or SMPL-X as NAME.npz. The rigs need not be alike.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from gesticulator import Gesticulator
from gesticulator.cli import main as command


def main(recordings: str, theirs: str, output: str, *options: str) -> None:
    """Gesture for the same sounds, and score both; options: anything else that `gesticulator score` takes."""
    gesticulator = Gesticulator.from_pretrained()
    with tempfile.TemporaryDirectory() as ours:
        for sound in sorted(Path(recordings).iterdir()):
            if sound.suffix.lower() in (".wav", ".flac"):
                gesticulator(sound).save(Path(ours) / f"{sound.stem}.bvh")
        step = ["score", "--truth", recordings, "--system", f"theirs={theirs}", "--system", f"ours={ours}",
                "--out", output, *options]
        if command(step):
            raise SystemExit(f"stopped at: gesticulator {' '.join(step)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
