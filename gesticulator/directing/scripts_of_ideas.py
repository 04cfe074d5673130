"""Scripts of gestures for ideas: time, size, change, comparison and stress."""

from __future__ import annotations

from dataclasses import replace

from gesticulator.directing.gesture_parts import (
    AHEAD,
    DOWN,
    IN,
    PALM,
    UP,
    GestureScript,
    HandKey,
    Repeat,
    both,
    hand,
    in_turn,
)

_LEVEL = ((-0.1, 0.0, 1.0), DOWN, "flat")
_SWAPS = hand((-0.05, -0.18, 0.32), (-0.5, 0.0, 0.9), UP, "flat", touches=True,
              repeat=Repeat((0.0, 0.0, 0.09), (0.0, 0.06, 0.0), rate=1.2))
_FACING = ((-0.05, 0.1, 1.0), IN, "flat")


def _stair(at: float, count: int, step: float) -> tuple[HandKey, ...]:
    """The edge of a hand set down further and further along."""
    keys = []
    for number in range(1, count):
        place, begin = at + step * number, 0.42 * (number - 1)
        for time, up, share in ((begin + 0.2, 0.10, 0.6), (begin + 0.38, 0.0, 1.0)):
            keys.append(HandKey((place - step * (1.0 - share), -0.24 + up, 0.36), (-0.1, 0.05, 1.0), IN, "flat", time))
    return tuple(keys)


IDEAS: dict[str, tuple[GestureScript, ...]] = {
    "now press": (
        both(hand((0.02, -0.31, 0.35), *_LEVEL, (0.0, 0.13, 0.0),
                  repeat=Repeat(circle=(0.0, 0.05, 0.0), rate=2.2, count=1.0)), hold=0.55,
             adds={"Head": (5.0, 0.0, 0.0)}),),
    # ------------------------------------------------------------------------------------------- size and shape
    "big spread": (
        both(hand((0.32, -0.10, 0.32), (0.3, 0.35, 0.9), (-1.0, 0.1, 0.25), "open", (-0.26, -0.04, 0.0)), stroke=0.4,
             hold=0.7, adds={"Spine2": (-3.0, 0.0, 0.0), "Head": (-3.0, 0.0, 0.0)}),),
    "small pinch": (
        GestureScript(hand((0.06, -0.02, 0.33), (-0.45, 0.75, 0.45), (-0.9, -0.5, 0.1), "gap", (0.0, -0.07, -0.05)),
                      hold=0.8, adds={"Neck": (3.0, 0.0, 0.0), "Head": (3.0, 0.0, 5.0)}),),
    "tall hand": (
        GestureScript(hand((0.26, 0.23, 0.26), (0.1, 0.0, 1.0), DOWN, "flat", (0.0, -0.24, 0.04)), stroke=0.5,
                      preparation=0.6, retraction=0.9,
                      hold=0.7, adds={"Neck": (-4.0, -5.0, 0.0), "Head": (-8.0, -6.0, 0.0)}),),
    "low hand": (
        GestureScript(hand((0.20, -0.40, 0.2), (0.2, -0.1, 1.0), DOWN, "flat", (0.0, 0.18, 0.04)), stroke=0.4,
                      hold=0.7, adds={"Neck": (6.0, -6.0, 0.0), "Head": (9.0, -7.0, 0.0)}),),
    "long stretch": (
        both(hand((0.30, -0.17, 0.30), (-0.1, 0.25, 0.9), (-1.0, -0.2, 0.0), "pinch", (-0.42, 0.0, 0.04)), stroke=0.7,
             hold=0.5),),
    "narrow": (
        both(hand((-0.13, -0.16, 0.36), *_FACING, (0.22, 0.0, 0.0)), stroke=0.5, hold=0.6),),
    "round shape": (
        both(hand((-0.03, -0.16, 0.33), (-0.45, 0.2, 0.85), (-1.0, 0.0, -0.5), "round", (0.0, 0.0, -0.04),
                  repeat=Repeat((0.0, 0.05, 0.0), circle=(0.05, 0.0, 0.0), rate=1.0, count=1.0)), hold=0.6),),
    "box frame": (
        both(hand((-0.03, -0.2, 0.37), *_FACING, (0.0, 0.12, 0.0),
                  repeat=Repeat(circle=(0.0, 0.06, 0.0), rate=2.0, count=1.0)), hold=0.7),),
    "flat surface": (
        GestureScript(hand((0.28, -0.22, 0.32), (0.35, 0.0, 0.95), *_LEVEL[1:], (-0.40, 0.0, 0.02),
                           before={"fingers": (-0.6, 0.0, 0.8)}), stroke=0.6, hold=0.4),
        both(hand((0.28, -0.22, 0.32), (0.35, 0.0, 0.95), *_LEVEL[1:], (-0.40, 0.0, 0.02),
                  before={"fingers": (-0.6, 0.0, 0.8)}), stroke=0.6, hold=0.4)),
    "surround": (
        both(hand((0.36, -0.06, 0.26), (0.55, 0.3, 0.8), (-1.0, 0.2, 0.5), "open", (-0.44, 0.16, 0.08),
                  then=(HandKey((-0.06, -0.28, 0.36), (-0.3, 0.1, 1.0), (-0.5, 1.0, 0.0), "open", 0.6),),
                  before={"fingers": (-0.3, 0.6, 0.8), "palm": (-0.4, -0.9, 0.2)}),
             preparation=0.5, stroke=0.45, hold=0.8),),
    # ------------------------------------------------------------------------------------------- change
    "increase": (
        GestureScript(hand((0.22, 0.06, 0.36), (0.2, 0.35, 0.9), (0.1, -1.0, 0.3), "flat", (-0.22, -0.36, 0.02)),
                      stroke=0.6, hold=0.5, adds={"Head": (-4.0, -3.0, 0.0)}),),
    "decrease": (
        GestureScript(hand((0.18, -0.32, 0.32), (0.2, -0.3, 0.95), (0.1, -1.0, -0.3), "flat", (-0.22, 0.36, 0.04)),
                      stroke=0.6, hold=0.5, adds={"Head": (5.0, -3.0, 0.0)}),),
    "up and down": (
        GestureScript(hand((-0.02, -0.12, 0.38), (-0.1, 0.1, 1.0), DOWN, "flat", (-0.1, -0.1, 0.0),
                           then=(HandKey((0.05, -0.28, 0.38), (0.0, -0.1, 1.0), DOWN, "flat", 0.3),
                                 HandKey((0.12, -0.12, 0.37), (0.05, 0.1, 1.0), DOWN, "flat", 0.6),
                                 HandKey((0.20, -0.28, 0.36), (0.1, -0.1, 1.0), DOWN, "flat", 0.9),
                                 HandKey((0.27, -0.14, 0.34), (0.15, 0.1, 1.0), DOWN, "flat", 1.2)))),),
    "explode": (
        both(hand((0.20, 0.02, 0.33), (0.4, 0.9, 0.4), (-0.3, 0.0, 1.0), "spread", (-0.30, -0.16, 0.0),
                  before={"shape": "fist", "fingers": (-0.3, 0.4, 0.9), "palm": (-0.8, -0.5, 0.0)}), stroke=0.32,
             hold=0.5, adds={"Head": (-4.0, 0.0, 0.0)}),),
    "roll hands": (
        in_turn(hand((-0.12, -0.16, 0.34), (-0.9, 0.05, 0.4), (0.0, -0.3, -1.0), "relaxed", touches=True,
                     repeat=Repeat((0.0, 0.075, 0.0), circle=(0.0, 0.0, 0.14), rate=1.7, count=2.5))),),
    "turn back": (
        GestureScript(hand((0.10, -0.02, 0.32), (-0.2, 0.9, 0.5), (-0.9, 0.0, 0.3), "point",
                           repeat=Repeat((0.0, 0.06, 0.0), circle=(0.0, 0.0, -0.13), tilt=(-12.0, 0.0, 0.0), rate=1.5,
                                         count=2.0))),),
    "quick snap": (
        GestureScript(hand((0.14, 0.04, 0.28), (-0.3, 1.0, 0.35), (-0.8, 0.0, -0.3), "point", (0.0, -0.04, -0.02),
                           before={"shape": "snap"}), stroke=0.16, hold=0.5, nods={"Head": (4.0, 0.0, 0.0)}),),
    # ------------------------------------------------------------------------------------------- together, apart
    "join hands": (
        both(hand((-0.155, -0.2, 0.30), (-0.55, 0.1, 0.8), (-1.0, 0.0, -0.3), "cup", (0.30, 0.03, 0.0), touches=True),
             stroke=0.5, hold=0.6),),
    "interlock": (
        GestureScript(hand((-0.16, -0.18, 0.34), (-1.0, 0.3, 0.35), (0.2, 0.2, -1.0), "claw", (0.2, 0.02, 0.0),
                           point=PALM, touches=True),
                      hand((-0.16, -0.18, 0.30), (-1.0, 0.3, 0.35), (0.2, 0.2, -1.0), "claw", (0.2, 0.02, 0.0),
                           point=PALM, touches=True), stroke=0.4, hold=0.8),),
    "split apart": (
        both(hand((0.20, -0.2, 0.33), (0.1, 0.1, 1.0), (1.0, 0.1, 0.0), "flat", (-0.34, 0.0, -0.01),
                  before={"fingers": (-0.1, 0.1, 1.0)}), stroke=0.35, hold=0.5),),
    "weigh options": (
        in_turn(hand((0.10, -0.24, 0.35), (0.1, 0.05, 1.0), UP, "cup",
                     repeat=Repeat((0.0, 0.085, 0.0), rate=1.0, count=2.0)), adds={"Head": (3.0, 0.0, 5.0)}),),
    "contrast flip": (
        GestureScript(hand((0.26, -0.22, 0.32), (0.5, 0.05, 0.9), UP, "open", (-0.2, 0.03, 0.02),
                           before={"palm": DOWN, "fingers": (-0.3, 0.0, 1.0)}),
                      adds={"Head": (0.0, -3.0, -7.0), "Neck": (0.0, 0.0, -4.0)}, stroke=0.36),),
    "add beside": (
        GestureScript(hand((0.22, -0.24, 0.34), (0.1, 0.05, 1.0), IN, "flat", (-0.14, 0.1, 0.0),
                           before={"palm": IN}), stroke=0.34, hold=0.6, adds={"Head": (3.0, -5.0, 0.0)}),),
    "exchange": (
        GestureScript(_SWAPS, replace(_SWAPS, keys=tuple(replace(key, palm=DOWN) for key in _SWAPS.keys),
                                      repeat=Repeat((0.0, 0.0, 0.09), (0.0, -0.06, 0.0), rate=1.2, phase=0.5))),),
    "equal level": (
        both(hand((0.08, -0.14, 0.36), *_LEVEL, (0.0, 0.05, -0.06),
                  repeat=Repeat(circle=(0.0, -0.04, 0.0), rate=2.0, count=1.0)), hold=0.8),),
    "step by step": (
        GestureScript(hand((-0.10, -0.24, 0.36), (-0.1, 0.05, 1.0), IN, "flat", (0.0, 0.12, 0.0),
                           then=_stair(-0.10, 4, 0.12))),),
    # ------------------------------------------------------------------------------------------- stress
    "chop point": (
        GestureScript(hand((0.04, -0.26, 0.37), (-0.1, 0.05, 1.0), IN, "flat", (0.0, 0.19, -0.05),
                           before={"fingers": (-0.1, 0.7, 0.7)}), stroke=0.255, hold=0.5,
                           nods={"Head": (5.0, 0.0, 0.0)}),
        both(hand((0.02, -0.26, 0.37), (-0.1, 0.05, 1.0), IN, "flat", (0.0, 0.19, -0.05),
                  before={"fingers": (-0.1, 0.7, 0.7)}), stroke=0.255, hold=0.5, nods={"Head": (5.0, 0.0, 0.0)})),
    "precision pinch": (
        GestureScript(hand((0.03, -0.1, 0.36), (-0.3, 0.6, 0.8), (-0.5, -0.4, 0.7), "pinch", (0.0, 0.08, -0.02),
                           repeat=Repeat(circle=(0.0, 0.05, 0.0), rate=2.2, count=2.0)), hold=0.6,
                      adds={"Head": (4.0, 0.0, 0.0)}),),
    "purse hand": (
        GestureScript(hand((0.05, -0.12, 0.33), (-0.1, 1.0, 0.1), (-0.2, 0.0, -1.0), "bunch", (0.0, -0.08, 0.0),
                           repeat=Repeat(circle=(0.0, 0.05, -0.03), tilt=(-10.0, 0.0, 0.0), rate=2.4, count=3.0))),),
    "air quotes": (
        both(hand((0.13, 0.04, 0.28), (-0.05, 1.0, 0.12), AHEAD, "quotes", (0.0, -0.1, 0.0),
                  repeat=Repeat(circle=(0.0, -0.015, 0.0), shape="hooked", rate=2.5, count=2.0)), hold=0.9,
             adds={"Head": (3.0, 0.0, 4.0)}),),
}
"""Name -> its takes."""
