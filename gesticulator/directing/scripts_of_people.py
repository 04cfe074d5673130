"""Scripts of gestures between people: pointing, greeting, yes and no, and signs with a fixed meaning."""

from __future__ import annotations

from gesticulator.directing.gesture_parts import (
    AHEAD,
    DOWN,
    HEAD,
    IN,
    PALM,
    TIPS,
    GestureScript,
    HandKey,
    Repeat,
    both,
    hand,
)

# Parts that several gestures share, or that both of their takes do.
_SHRUGGED = hand((0.24, -0.24, 0.22), (0.8, 0.15, 0.6), (0.05, 1.0, 0.15), start=(-0.08, -0.05, 0.0))
_OPEN = hand((0.12, -0.24, 0.33), (0.45, 0.1, 0.9), (0.1, 1.0, -0.1), start=(-0.08, -0.05, -0.06))
_ASIDE = hand((0.36, 0.0, 0.28), (0.86, 0.05, 0.5), (-0.1, -1.0, 0.1), "point", (-0.1, -0.08, 0.0))
_WAVING = hand((0.22, 0.22, 0.22), (0.1, 1.0, 0.05), AHEAD, "spread", (-0.02, -0.1, 0.0),
               repeat=Repeat((0.11, -0.02, 0.0), tilt=(0.0, 0.0, -20.0), rate=2.0, count=3.0))
_SWEEP = hand((0.24, -0.25, 0.30), (0.15, 0.0, 1.0), DOWN, "flat", (-0.36, 0.02, 0.02),
              before={"fingers": (-0.75, 0.0, 0.65)})
_DISAGREES = {"Neck": (0.0, 5.0, 0.0), "Head": (0.0, 8.0, 0.0)}
_RAISED = ((0.05, 0.0, 0.30), (0.0, 1.0, 0.1), AHEAD)


def _count(shape: str) -> tuple[GestureScript, ...]:
    """A hand that is held up with some fingers straight."""
    return (GestureScript(hand((0.08, 0.0, 0.27), (0.0, 1.0, 0.12), (-0.1, 0.0, 1.0), shape, (0.0, -0.09, 0.0)),
                          hold=0.7),)


PEOPLE: dict[str, tuple[GestureScript, ...]] = {
    # ------------------------------------------------------------------------------------------- pointing
    "point self": (
        GestureScript(hand((-0.13, -0.13, 0.135), (-0.9, 0.3, 0.05), (-0.1, 0.0, -1.0), "flat", (0.05, -0.02, 0.1),
                           point=PALM, touches=True), hold=0.6),
        both(hand((-0.08, -0.13, 0.145), (-0.85, 0.4, 0.0), (-0.1, 0.0, -1.0), "open", (0.06, -0.03, 0.1), point=PALM,
                  touches=True), hold=0.6)),
    "point you": (
        GestureScript(hand((0.0, -0.1, 0.45), (-0.1, 0.2, 1.0), (-0.9, 0.5, 0.0), "open", (0.02, -0.12, -0.14)),
                      hold=0.55),
        both(hand((0.06, -0.12, 0.42), (0.05, 0.2, 1.0), (-0.9, 0.5, 0.0), "open", (0.0, -0.12, -0.14)), hold=0.55)),
    "we all": (
        both(hand((-0.08, -0.2, 0.26), (-0.5, 0.1, 0.85), (-0.4, 1.0, -0.5), "open", (0.30, 0.0, 0.12),
                  before={"fingers": (0.25, 0.1, 1.0), "palm": (-1.0, 0.5, 0.0)}), stroke=0.55, hold=0.5),),
    "they over there": (
        GestureScript(hand((0.34, -0.1, 0.26), (0.9, 0.15, 0.4), (-0.1, 1.0, 0.25), "open", (-0.24, 0.0, 0.05)),
                      adds={"Neck": (0.0, -8.0, 0.0), "Head": (0.0, -9.0, 0.0)}, stroke=0.32),),
    "point here": (
        GestureScript(hand((0.0, -0.26, 0.36), (-0.1, -1.0, 0.2), (-0.4, 0.0, -1.0), "point", (0.0, 0.1, 0.0),
                           repeat=Repeat(circle=(0.0, 0.06, 0.0), rate=2.2, count=1.0)),
                      adds={"Neck": (4.0, 0.0, 0.0), "Head": (6.0, 0.0, 0.0)}),),
    "point there": (
        GestureScript(hand((0.18, 0.02, 0.45), (0.35, 0.08, 0.95), (-0.2, -1.0, 0.0), "point", (-0.06, -0.1, -0.16)),
                      adds={"Neck": (0.0, -5.0, 0.0), "Head": (0.0, -6.0, 0.0)}, hold=0.6),),
    "point left": (GestureScript(_ASIDE, adds={"Neck": (0.0, -8.0, 0.0), "Head": (0.0, -10.0, 0.0)}, side="Left"),),
    "point right": (GestureScript(_ASIDE, adds={"Neck": (0.0, -8.0, 0.0), "Head": (0.0, -10.0, 0.0)}),),
    "point up": (
        GestureScript(hand((0.08, 0.16, 0.24), (0.0, 1.0, 0.12), (-0.5, 0.0, 1.0), "point", (0.0, -0.14, 0.02)),
                      adds={"Neck": (-3.0, 0.0, 0.0), "Head": (-6.0, 0.0, 0.0)}, hold=0.6, preparation=0.65,
                      retraction=0.9),),
    "point down": (
        GestureScript(hand((0.16, -0.42, 0.2), (0.1, -1.0, 0.2), (-0.3, 0.0, -1.0), "point", (0.0, 0.12, 0.03)),
                      adds={"Neck": (6.0, -3.0, 0.0), "Head": (8.0, -3.0, 0.0)}, hold=0.6),),
    "point back": (
        GestureScript(hand((0.12, 0.0, 0.14), (0.0, 1.0, -0.15), IN, "thumb", (0.02, -0.05, 0.1),
                           repeat=Repeat(circle=(0.0, 0.0, 0.05), rate=2.2, count=1.0)), hold=0.5),),
    "point ahead": (
        GestureScript(hand((-0.02, -0.1, 0.46), (-0.05, 0.05, 1.0), (-1.0, 0.0, 0.0), "flat", (0.04, -0.06, -0.26),
                           before={"fingers": (-0.2, 0.5, 0.8)}), stroke=0.38, hold=0.5),),
    "look at this": (
        GestureScript(hand((0.27, -0.13, 0.34), (0.55, 0.1, 0.85), (-0.25, 1.0, 0.1), "open", (-0.16, -0.04, -0.04)),
                      adds={"Neck": (2.0, -6.0, 0.0), "Head": (3.0, -8.0, 0.0)}, hold=0.8),),
    # ------------------------------------------------------------------------------------------- offers, questions
    "open offer": (
        GestureScript(hand((0.08, -0.22, 0.38), (0.1, 0.08, 1.0), (-0.2, 1.0, -0.1), "open", (-0.02, -0.04, -0.14)),
                      hold=0.6),
        both(hand((0.04, -0.22, 0.36), (0.1, 0.08, 1.0), (-0.2, 1.0, -0.1), "open", (0.0, -0.04, -0.14)), hold=0.6)),
    "receive": (
        both(hand((-0.02, -0.18, 0.22), (-0.4, 0.1, 0.9), (-0.2, 1.0, -0.5), "cup", (0.06, -0.02, 0.2)), stroke=0.45),),
    "palms question": (
        both(_OPEN, hold=0.7, adds={"Head": (-3.0, 0.0, 4.0)}),),
    "shrug": (
        both(_SHRUGGED, adds={"LeftShoulder": (0.0, 0.0, 15.0), "RightShoulder": (0.0, 0.0, -15.0),
                              "Head": (0.0, 0.0, 7.0), "Neck": (0.0, 0.0, 4.0)}, hold=0.55),
        both(hand((0.20, -0.16, 0.20), (0.85, 0.45, 0.4), (0.1, 1.0, 0.35), "open", (-0.06, -0.08, 0.03)),
             adds={"LeftShoulder": (0.0, 0.0, 17.0), "RightShoulder": (0.0, 0.0, -17.0), "Head": (0.0, 0.0, -6.0),
                   "Neck": (0.0, 0.0, -4.0)}, hold=0.5)),
    "plea": (
        both(hand((-0.02, -0.16, 0.43), (0.0, 0.12, 1.0), (-0.3, 1.0, 0.0), "cup", (0.02, -0.04, -0.16)), hold=0.9,
             adds={"Spine1": (4.0, 0.0, 0.0), "Spine2": (4.0, 0.0, 0.0), "Head": (-3.0, 0.0, 8.0)}),),
    "empty hands": (
        both(hand((0.14, -0.34, 0.33), (0.25, -0.25, 0.95), (0.0, 1.0, 0.35), "spread", (-0.06, 0.06, -0.03)), hold=0.8,
             adds={"Neck": (3.0, 0.0, 0.0), "Head": (4.0, 0.0, 0.0)}),),
    # ------------------------------------------------------------------------------------------- no and stop
    "sweep no": (both(_SWEEP, nods=_DISAGREES, stroke=0.4, hold=0.45),
                 GestureScript(_SWEEP, nods=_DISAGREES, stroke=0.4, hold=0.45)),
    "finger wag no": (
        GestureScript(hand((0.10, 0.02, 0.30), (0.0, 1.0, 0.1), AHEAD, "point", (0.0, -0.1, 0.0),
                           repeat=Repeat((0.05, 0.0, 0.0), tilt=(0.0, 0.0, -20.0), rate=2.4, count=3.0)),
                      nods={"Head": (0.0, 6.0, 0.0)}, rate=2.4),),
    "cut off": (
        both(hand((0.22, -0.33, 0.27), (0.25, -0.1, 1.0), DOWN, "flat", (-0.38, 0.02, 0.05),
                  before={"fingers": (-0.75, -0.1, 0.65)}), stroke=0.34, hold=0.45,
             nods={"Head": (0.0, 6.0, 0.0)}),),
    "stop palm": (
        GestureScript(hand((0.03, -0.02, 0.38), (0.0, 1.0, 0.1), AHEAD, "flat", (0.0, -0.05, -0.14)), hold=0.7),
        both(hand((0.03, -0.04, 0.36), (0.0, 1.0, 0.1), AHEAD, "flat", (0.0, -0.05, -0.14)), hold=0.7)),
    "push away": (
        both(hand((0.0, -0.06, 0.42), (0.0, 1.0, 0.2), AHEAD, "open", (0.0, -0.03, -0.2)), stroke=0.35, hold=0.5,
             adds={"Spine2": (-3.0, 0.0, 0.0), "Neck": (0.0, 10.0, 0.0), "Head": (2.0, 14.0, 0.0)}),),
    "calm down": (
        both(hand((0.06, -0.24, 0.37), (-0.1, 0.2, 1.0), (0.0, -1.0, 0.25), "open", (0.0, 0.13, 0.0),
                  repeat=Repeat(circle=(0.0, 0.10, 0.0), rate=1.1, count=2.0)), stroke=0.4),),
    "throw away": (
        GestureScript(hand((0.30, -0.12, 0.28), (0.8, -0.25, 0.55), (0.2, -0.8, 0.6), "open", (-0.26, 0.04, -0.06),
                           before={"shape": "fist", "fingers": (-0.5, 0.4, 0.6), "palm": (-0.3, -0.5, -0.8)}),
                      adds={"Head": (0.0, 5.0, 0.0)}, stroke=0.28, hold=0.35),),
    "shoo": (
        GestureScript(hand((0.10, -0.12, 0.38), (0.1, 0.1, 1.0), (0.0, -1.0, 0.1), "open", (0.0, 0.0, -0.05),
                           before={"fingers": (0.1, -0.9, 0.5)},
                           repeat=Repeat(tilt=(35.0, 0.0, 0.0), rate=2.6, count=2.5)), stroke=0.22),),
    "brush off": (
        GestureScript(hand((-0.33, 0.035, 0.155), (-0.95, 0.0, -0.2), (0.0, -0.9, -0.5), "flat", (0.12, 0.02, 0.06),
                           point=TIPS, touches=True,
                           repeat=Repeat((-0.04, 0.0, 0.0), circle=(0.0, 0.02, 0.0), rate=1.9, count=2.0)),
                           preparation=0.7, retraction=1.0,
                      adds={"Neck": (3.0, 10.0, 0.0), "Head": (5.0, 14.0, 0.0)}),),
    # ------------------------------------------------------------------------------------------- signs
    "wait finger": (
        GestureScript(hand((0.10, 0.03, 0.29), (0.0, 1.0, 0.1), (-0.2, 0.0, 1.0), "point", (0.0, -0.1, 0.0)), hold=0.8,
                      adds={"Head": (2.0, 0.0, 3.0)}),),
    "idea finger": (
        GestureScript(hand((0.08, 0.14, 0.22), (0.0, 1.0, 0.05), (-0.8, 0.0, 0.6), "point", (0.0, -0.16, 0.0)),
                      adds={"Neck": (-3.0, 0.0, 0.0), "Head": (-5.0, 0.0, 0.0)}, stroke=0.25, hold=0.6, preparation=0.6,
                      retraction=0.7),),
    "thumbs up": (
        GestureScript(hand((0.03, -0.10, 0.36), (-0.45, 0.0, 0.9), (-1.0, 0.0, -0.3), "thumb", (0.0, -0.05, -0.09)),
                      hold=0.7, nods={"Head": (4.0, 0.0, 0.0)}, rate=1.4),
        both(hand((0.06, -0.10, 0.34), (-0.45, 0.0, 0.9), (-1.0, 0.0, -0.3), "thumb", (0.0, -0.05, -0.09)), hold=0.7)),
    "thumbs down": (
        GestureScript(hand((0.08, -0.06, 0.36), (-0.9, -0.1, 0.5), (0.45, 0.0, 1.0), "thumb", (0.0, 0.1, -0.02),
                           lift=60.0), hold=0.7, preparation=0.65, nods={"Head": (0.0, 5.0, 0.0)}),),
    "ok ring": (
        GestureScript(hand((0.08, -0.01, 0.31), (-0.15, 1.0, 0.15), (-0.8, 0.0, 0.7), "ring", (0.0, -0.08, -0.03)),
                      hold=0.7),),
    "zero ring": (
        GestureScript(hand((0.08, -0.05, 0.31), (-0.25, 1.0, 0.15), (-1.0, -0.2, 0.2), "zero", (0.0, -0.08, -0.03)),
                      hold=0.7),),
    "fingers crossed": (GestureScript(hand((0.10, 0.05, 0.24), *_RAISED[1:], "crossed"), hold=0.8,
                                      adds={"Head": (0.0, 0.0, 5.0)}),),
    "victory v": (GestureScript(hand((0.12, 0.06, 0.26), *_RAISED[1:], "victory"), hold=0.7),),
    "nod": (GestureScript(nods={"Neck": (6.0, 0.0, 0.0), "Head": (9.0, 0.0, 0.0)}, rate=1.9, preparation=0.1,
                          stroke=0.2, hold=0.8, retraction=0.3),),
    "head shake": (GestureScript(nods={"Neck": (0.0, 8.0, 0.0), "Head": (0.0, 12.0, 0.0)}, rate=1.5, preparation=0.1,
                                 stroke=0.2, hold=1.1, retraction=0.35),),
    "so so": (
        GestureScript(hand((0.05, -0.16, 0.36), (-0.15, 0.0, 1.0), DOWN, "spread", (0.0, -0.06, -0.08),
                           repeat=Repeat((0.015, 0.0, 0.0), roll=28.0, rate=2.2, count=3.0)),
                      adds={"Head": (0.0, 0.0, 6.0)}),),
    "wave hello": (GestureScript(_WAVING, preparation=0.6, retraction=0.7),),
    "wave goodbye": (
        GestureScript(hand((0.22, 0.2, 0.22), (0.05, 1.0, 0.1), AHEAD, "open", (-0.02, -0.1, 0.0),
                           repeat=Repeat(tilt=(28.0, 0.0, 0.0), shape="round", rate=2.4, count=3.0)),
                      adds={"Head": (0.0, 0.0, 4.0)}, preparation=0.7, retraction=0.9),),
    "beckon": (
        GestureScript(hand((0.08, -0.12, 0.36), (-0.1, 0.55, 0.85), (-0.1, 0.8, -0.6), "open", (0.0, -0.06, 0.0),
                           repeat=Repeat(circle=(0.0, 0.05, -0.13), tilt=(-12.0, 0.0, 0.0), shape="round", rate=1.8,
                                         count=2.0)), adds={"Head": (-3.0, 0.0, 0.0)}),),
    "usher": (
        GestureScript(hand((0.38, -0.2, 0.22), (0.9, -0.05, 0.45), (-0.2, 1.0, 0.15), "open", (-0.38, 0.06, 0.1),
                           before={"fingers": (-0.3, 0.1, 0.95), "palm": (-0.4, 0.9, -0.3)}),
                      adds={"Spine2": (2.0, -5.0, 0.0), "Neck": (2.0, -6.0, 0.0), "Head": (4.0, -8.0, 0.0)},
                      stroke=0.55, hold=0.7),),
    "hands over heart": (
        both(hand((-0.17, -0.12, 0.145), (-0.8, 0.55, 0.05), (-0.1, 0.0, -1.0), "flat", (0.06, -0.04, 0.1), point=PALM,
                  touches=True), adds={"Neck": (3.0, 0.0, 0.0), "Head": (5.0, 0.0, 4.0)}, hold=0.9, stroke=0.35),),
    "prayer hands": (
        both(hand((-0.162, -0.17, 0.2), (0.0, 0.95, 0.3), IN, "flat", (0.1, -0.02, 0.0), touches=True),
             adds={"Neck": (5.0, 0.0, 0.0), "Head": (6.0, 0.0, 0.0)}, hold=0.9, stroke=0.35),),
    "bow": (
        GestureScript(adds={"Spine": (7.0, 0.0, 0.0), "Spine1": (8.0, 0.0, 0.0), "Spine2": (7.0, 0.0, 0.0),
                            "Neck": (8.0, 0.0, 0.0), "Head": (10.0, 0.0, 0.0)}, preparation=0.35, stroke=0.35,
                      hold=0.35, retraction=0.7),),
    "clap": (
        both(hand((-0.155, -0.12, 0.29), (-0.15, 0.5, 0.85), IN, "flat", (0.14, 0.0, 0.0), touches=True,
                  repeat=Repeat(circle=(0.11, 0.0, 0.0), rate=2.7, count=4.0)), stroke=0.25),),
    "oath hand": (
        GestureScript(hand((0.17, 0.04, 0.16), (0.0, 1.0, 0.05), AHEAD, "flat", (0.0, -0.1, 0.02)), hold=0.9),),
    "salute": (
        GestureScript(hand((-0.085, 0.215, 0.115), (-0.85, 0.5, 0.1), (-0.2, -0.75, 0.6), "flat", (0.05, -0.1, 0.1),
                           point=TIPS, touches=True, lift=55.0), **HEAD, hold=0.6, stroke=0.3),),
    "hush finger": (
        GestureScript(hand((-0.18, 0.14, 0.15), (-0.05, 1.0, 0.05), (-0.9, 0.0, -0.4), "point", (0.03, -0.08, 0.08),
                           point=0.15, touches=True, lift=20.0), **HEAD, hold=0.8),),
    # ------------------------------------------------------------------------------------------- numbers
    "number one": _count("point"),
    "number two": _count("two"),
    "number three": _count("three"),
    "number four": _count("four"),
    "number five": _count("spread"),
    "count off": (
        GestureScript(hand((-0.13, -0.08, 0.36), (-0.7, 0.3, 0.55), (-0.3, -0.7, -0.6), "point", (0.05, 0.05, 0.0),
                           point=TIPS, touches=True,
                           then=(HandKey((-0.11, -0.03, 0.36), (-0.7, 0.3, 0.55), (-0.3, -0.7, -0.6), "point", 0.22),
                                 HandKey((-0.14, -0.10, 0.38), (-0.7, 0.2, 0.55), (-0.3, -0.7, -0.6), "point", 0.45),
                                 HandKey((-0.11, -0.05, 0.37), (-0.7, 0.2, 0.55), (-0.3, -0.7, -0.6), "point", 0.67),
                                 HandKey((-0.14, -0.12, 0.40), (-0.7, 0.1, 0.55), (-0.3, -0.7, -0.6), "point", 0.9))),
                      hand((-0.13, -0.2, 0.34), (-0.25, 0.75, 0.45), (-0.5, 0.3, -0.7), "spread", touches=True)),),
}
"""Name -> its takes."""
