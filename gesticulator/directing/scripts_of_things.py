"""Scripts of gestures for ideas and things: time, size, change, comparison and stress; feelings, objects, actions."""

from __future__ import annotations

from dataclasses import replace

from gesticulator.directing.gesture_parts import (
    AHEAD,
    DOWN,
    HEAD,
    IN,
    PALM,
    TIPS,
    UP,
    GestureScript,
    HandKey,
    Repeat,
    both,
    hand,
    in_turn,
    one_or_both,
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


THINGS: dict[str, tuple[GestureScript, ...]] = {
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
    "flat surface": one_or_both(
        hand((0.28, -0.22, 0.32), (0.35, 0.0, 0.95), *_LEVEL[1:], (-0.40, 0.0, 0.02),
             before={"fingers": (-0.6, 0.0, 0.8)}), stroke=0.6, hold=0.4),
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
    # ------------------------------------------------------------------------------------------- feelings
    "cheer arms": (
        both(hand((0.16, 0.34, 0.14), (0.2, 1.0, 0.0), (-0.3, 0.0, 1.0), "fist", (0.0, -0.2, 0.06),
                  repeat=Repeat(circle=(0.02, -0.12, 0.04), rate=2.2, count=1.5)), preparation=0.85, stroke=0.35,
             hold=0.7, retraction=1.0, adds={"Head": (-8.0, 0.0, 0.0)}),),
    "fist pump": (
        GestureScript(hand((0.10, -0.17, 0.24), (-0.15, 0.8, 0.5), (-0.5, 0.2, -0.9), "fist", (-0.02, 0.14, 0.16)),
                      stroke=0.25, hold=0.6, nods={"Head": (5.0, 0.0, 0.0)}),),
    "fist resolve": (
        GestureScript(hand((0.04, -0.05, 0.30), (-0.05, 1.0, 0.15), (-0.8, 0.0, -0.6), "fist", (0.0, -0.1, 0.04),
                           repeat=Repeat(circle=(0.0, -0.05, 0.03), rate=2.2, count=2.0)), hold=0.7,
                      adds={"Head": (4.0, 0.0, 0.0)}),),
    "flex arm": (
        GestureScript(hand((0.26, 0.24, 0.03), (-0.35, 1.0, 0.0), (-1.0, -0.2, 0.0), "fist", (0.08, -0.12, 0.06),
                           lift=80.0), hold=0.9, preparation=0.75, retraction=1.0,
                           adds={"Neck": (0.0, -8.0, 0.0), "Head": (0.0, -12.0, 0.0)}),),
    "hug self": (
        GestureScript(hand((-0.27, -0.10, 0.15), (-1.0, 0.25, -0.05), (0.0, 0.0, -1.0), "open", (0.16, 0.0, 0.12),
                           point=PALM, touches=True),
                      hand((-0.27, -0.18, 0.17), (-1.0, 0.25, -0.05), (0.0, 0.0, -1.0), "open", (0.16, 0.0, 0.12),
                           point=PALM, touches=True),
                      adds={"Head": (6.0, 0.0, 8.0), "Neck": (3.0, 0.0, 4.0), "LeftShoulder": (0.0, 0.0, 6.0),
                            "RightShoulder": (0.0, 0.0, -6.0)}, stroke=0.4, hold=0.9, preparation=0.6),),
    "heart hands": (
        both(hand((-0.10, -0.06, 0.28), (-0.62, 0.8, 0.1), (-0.8, -0.6, 0.2), "heart", (0.1, -0.02, 0.0), touches=True),
             stroke=0.4, hold=1.0, adds={"Head": (0.0, 0.0, 6.0)}),),
    "arms crossed": (
        GestureScript(hand((-0.24, -0.24, 0.20), (-1.0, 0.15, -0.05), (0.0, -0.4, -1.0), "relaxed", (0.14, 0.0, 0.1),
                           point=PALM, touches=True),
                      hand((-0.22, -0.26, 0.24), (-1.0, 0.1, -0.05), (0.0, -0.4, -1.0), "fist", (0.14, 0.0, 0.1),
                           point=PALM, touches=True),
                      stroke=0.45, hold=1.2, preparation=0.6, retraction=0.7),),
    "hands on hips": (
        both(hand((0.02, -0.44, 0.05), (-0.45, -0.55, 0.65), (-0.8, -0.1, -0.6), "open", (0.1, 0.05, 0.04), point=0.04,
                  touches=True, lift=70.0), stroke=0.35, hold=1.1, preparation=0.6),),
    "rub hands": (
        in_turn(hand((-0.155, -0.2, 0.27), (-0.25, 0.2, 0.95), IN, "flat", (0.1, 0.0, 0.0), touches=True,
                     repeat=Repeat((0.0, 0.0, 0.045), rate=2.6, count=3.5))),),
    "facepalm": (
        GestureScript(hand((-0.17, 0.20, 0.185), (-0.35, 0.9, -0.15), (-0.15, -0.2, -1.0), "open", (0.02, -0.1, 0.1),
                           point=PALM, touches=True), **HEAD,
                      adds={"Neck": (8.0, 0.0, 0.0), "Head": (12.0, 0.0, 0.0)}, hold=0.9),),
    # ------------------------------------------------------------------------------------------- the head
    "chin think": (
        GestureScript(hand((-0.155, 0.065, 0.135), (-0.5, 0.85, -0.1), (-0.6, 0.2, -0.8), "pen", (0.03, -0.08, 0.08),
                           point=0.10, touches=True), **HEAD, adds={"Head": (2.0, 5.0, 5.0)}, hold=1.2),),
    "head scratch": (
        GestureScript(hand((-0.09, 0.27, 0.03), (-0.75, 0.6, -0.15), (-0.75, -0.6, 0.0), "claw", (0.06, -0.1, 0.1),
                           point=0.14, touches=True, lift=45.0,
                           repeat=Repeat((0.0, 0.015, 0.012), rate=3.2, count=3.0)), **HEAD,
                      adds={"Head": (5.0, 0.0, 6.0)}),),
    "tap temple": (
        GestureScript(hand((-0.09, 0.235, 0.075), (-0.72, 0.7, -0.05), (-0.5, -0.4, -0.7), "point", (0.05, -0.04, 0.05),
                           point=TIPS, touches=True, lift=25.0,
                           repeat=Repeat(circle=(0.035, 0.0, 0.01), rate=2.8, count=2.0)), **HEAD, hold=0.8),),
    "crazy circle": (
        GestureScript(hand((-0.05, 0.215, 0.08), (-0.7, 0.72, -0.05), (-0.5, -0.4, -0.7), "point", (0.04, -0.05, 0.04),
                           point=TIPS, touches=True, lift=25.0,
                           repeat=Repeat((0.0, 0.03, 0.0), circle=(0.0, 0.0, 0.06), rate=1.7, count=2.5)), **HEAD),),
    "hand to ear": (
        GestureScript(hand((-0.05, 0.2, 0.08), (-0.25, 1.0, -0.1), (-0.5, 0.0, 0.85), "cup", (0.06, -0.08, 0.06),
                           point=PALM, touches=True), **HEAD,
                      adds={"Spine2": (4.0, 0.0, 0.0), "Neck": (0.0, 8.0, 0.0), "Head": (2.0, 10.0, -5.0)}, hold=1.0),),
    "zip lips": (
        GestureScript(hand((-0.15, 0.12, 0.155), (-0.7, 0.5, -0.4), (-0.4, -0.3, -0.9), "pinch", (-0.065, 0.0, 0.0),
                           point=0.12, touches=True, lift=25.0), **HEAD, stroke=0.5, hold=0.5),),
    "phone hand": (
        GestureScript(hand((-0.075, 0.14, 0.11), (-0.3, 0.9, 0.25), (-0.95, -0.2, 0.1), "phone", (0.06, -0.08, 0.06),
                           point=0.06, touches=True), **HEAD, adds={"Head": (0.0, 0.0, 6.0)}, hold=1.0),),
    "eat drink": (
        GestureScript(hand((-0.09, 0.055, 0.22), (-0.75, 0.3, -0.1), (-0.6, 0.1, -0.8), "round", (0.03, -0.12, 0.08),
                           point=0.06, touches=True, lift=30.0), **HEAD, adds={"Head": (-9.0, 0.0, 0.0)}, hold=0.7,
                      stroke=0.4),),
    "sleep cheek": (
        GestureScript(hand((-0.105, 0.13, 0.12), (-0.3, 1.0, -0.1), (-0.95, -0.3, -0.1), "flat", (0.05, -0.06, 0.06),
                           point=PALM, touches=True),
                      hand((-0.235, 0.1, 0.14), (-0.55, 1.0, -0.15), (-0.9, 0.2, -0.4), "flat", (0.03, -0.1, 0.06),
                           point=PALM, touches=True), **HEAD,
                      adds={"Neck": (0.0, 0.0, -9.0), "Head": (3.0, 0.0, -14.0)}, hold=1.1, stroke=0.35),),
    # ------------------------------------------------------------------------------------------- objects, actions
    "check watch": (
        GestureScript(hand((-0.15, -0.12, 0.30), (-0.8, -0.2, 0.3), (0.1, -0.9, -0.4), "point", (0.02, 0.07, 0.0),
                           point=TIPS, touches=True, repeat=Repeat(circle=(0.0, 0.05, 0.0), rate=2.4, count=2.0)),
                      hand((-0.16, -0.16, 0.29), (-1.0, 0.05, 0.15), (0.0, -0.8, -0.6), "fist", (0.0, -0.04, 0.04),
                           touches=True, lift=20.0),
                      adds={"Neck": (7.0, 4.0, 0.0), "Head": (10.0, 5.0, 0.0)}, hold=0.9),),
    "typing": (
        in_turn(hand((-0.04, -0.29, 0.33), (-0.25, -0.1, 1.0), DOWN, "keys", (0.0, 0.05, 0.0),
                     repeat=Repeat((0.0, 0.012, 0.0), shape="round", rate=4.0, count=5.0)),
                     adds={"Neck": (4.0, 0.0, 0.0), "Head": (6.0, 0.0, 0.0)}),),
    "write air": (
        GestureScript(hand((-0.02, -0.08, 0.37), (-0.35, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", (-0.08, 0.0, 0.0),
                           then=(HandKey((0.03, -0.06, 0.37), (-0.35, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", 0.3),
                                 HandKey((0.09, -0.09, 0.36), (-0.3, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", 0.6),
                                 HandKey((0.16, -0.07, 0.35), (-0.2, 0.35, 0.85), (-0.4, -0.9, 0.2), "pen", 0.9)),
                           repeat=Repeat((0.0, 0.028, 0.0), rate=3.2, count=3.0))),),
    "money rub": (
        GestureScript(hand((0.06, -0.04, 0.32), (-0.2, 0.8, 0.6), (-0.3, 0.5, -0.75), "pinch", (0.0, -0.06, -0.03),
                           repeat=Repeat(shape="snap", rate=3.0, count=4.0))),),
    "drive wheel": (
        in_turn(hand((-0.01, -0.12, 0.38), (-0.2, 0.75, 0.6), (-0.7, -0.2, 0.7), "fist", (0.0, -0.05, -0.08),
                     repeat=Repeat((0.0, 0.09, 0.0), rate=1.1, count=2.0))),),
    "open door": (
        both(hand((0.24, -0.12, 0.35), (0.3, 0.5, 0.8), (0.4, 0.0, 1.0), "flat", (-0.36, 0.0, 0.03),
                  before={"fingers": (-0.15, 0.9, 0.4), "palm": (0.1, 0.0, 1.0)}), stroke=0.5, hold=0.5),),
    "close lid": (
        GestureScript(hand((-0.14, -0.20, 0.32), (-0.85, 0.0, 0.5), DOWN, "flat", (0.0, 0.2, 0.0), point=PALM,
                           touches=True),
                      hand((-0.16, -0.235, 0.32), (-0.85, 0.0, 0.5), UP, "flat", (0.0, -0.02, 0.0), point=PALM,
                           touches=True), stroke=0.35, hold=0.6),),
}
"""Name -> its takes."""
