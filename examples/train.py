"""Train on your own recordings and gesture with the result: a folder of NAME.bvh (any rig) beside NAME.wav.

    python examples/train.py recordings/ bundle/ examples/speech.flac talk.bvh
    python examples/train.py recordings/ bundle/ examples/speech.flac talk.bvh --preset tiny     # a first try
"""

from __future__ import annotations

import sys
from pathlib import Path

from gesticulator import Gesticulator
from gesticulator.cli import main as command


def main(recordings: str, bundle: str, sound: str, output: str, *settings: str) -> None:
    """Build a store of the recordings, train on it, and gesture with the result.

    settings: anything else that `gesticulator train` takes. What is there already is not made again, so a run that was
    stopped goes on.
    """
    store = Path(bundle).with_name(Path(bundle).name + ".store")
    for step in (["build", "folder", "--source", recordings, "--out", str(store), "--no-dataset"],
                 ["train", "--data", str(store), "--out", bundle, *settings]):
        if command(step):
            raise SystemExit(f"stopped at: gesticulator {' '.join(step)}")
    print(Gesticulator.from_pretrained(bundle)(sound).save(output))


if __name__ == "__main__":
    main(*sys.argv[1:])
