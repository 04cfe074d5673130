"""Make a calmer second take: the same plan with smaller and fewer gestures, its first second unchanged.

    python examples/calmer_take.py examples/speech.flac first.bvh calm.bvh
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from gesticulator import Gesticulator


def main(sound: str, first_output: str, calm_output: str) -> None:
    """Two takes and the mean speed of their hands."""
    gesticulator = Gesticulator.from_pretrained()
    first = gesticulator(sound)
    plan = first.plan()
    # What is locked stays as it was drawn, whatever knobs are turned.
    plan = replace(plan, blocks=tuple(replace(block, locked=block.end <= 1.0) for block in plan.blocks))
    calm = gesticulator(sound, plan=plan, energy="calm")
    for take, output in ((first, first_output), (calm, calm_output)):
        hands = take.positions()[:, [take.joints.index("LeftHand"), take.joints.index("RightHand")]]
        speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean() * take.fps
        print(f"{take.save(output)}: {speed:.2f} m/s")


if __name__ == "__main__":
    main(*sys.argv[1:])
