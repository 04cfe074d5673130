"""Direct a performance: its words, the height of its hands, its liveliness.

    python examples/direct.py examples/speech.flac "Heavy bread rises slowly." calm.bvh rising.bvh
"""

from __future__ import annotations

import sys

from gesticulator import Curve, Gesticulator


def main(sound: str, said: str, calm_output: str, rising_output: str) -> None:
    """Two takes of one recording: calm and low, and with hands that rise from start to end."""
    gesticulator = Gesticulator.from_pretrained()
    calm = gesticulator(sound, text=said, hand_height="low", hand_speed="low", activity=0.6)
    # Metres of the right hand over the hips, against seconds.
    rise = Curve(times=(0.0, calm.duration), values=(0.0, 0.35))
    rising = gesticulator(sound, text=said, hand_height=rise, temperature=0.5, seed=7)
    for take, output in ((calm, calm_output), (rising, rising_output)):
        height = take.positions()[:, take.joints.index("RightHand"), 1] - take.positions()[:, 0, 1]
        half = len(height) // 2
        print(f"{take.save(output)}: right hand over the hips {height[:half].mean():.2f} m in the first half, "
              f"{height[half:].mean():.2f} m in the second")


if __name__ == "__main__":
    main(*sys.argv[1:])
