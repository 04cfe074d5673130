"""The face of a character in a page: its morph targets, eyes and jaw as functions of the numbers of a face.

Every curve of `shapes.curves` is a sum of the numbers of `FaceMotion.values`, or of their negative parts, times
constants, limited to 0 to 1. The constants are read off `curves`, so that the page needs no formulas.
"""

from typing import Any

import numpy as np

from gesticulator.characters.rig import Character
from gesticulator.face.motion import FaceMotion
from gesticulator.face.rig import FaceRig, find_face
from gesticulator.face.shapes import JAW_OPEN, curves, is_lips

NUMBERS = 20
"""Numbers of a face: 15 visemes, blink, brows, smile, gaze."""
_STEP = 0.1
"""Of a number, small enough that no curve reaches 1."""


def page_face(character: Character, lips_only: bool = False) -> dict[str, Any]:
    """The face of a glTF character as JSON; empty for a VRM, which has its own way, and for one without anything.

    morphs: [[node of the file, target, [[curve, share], ...]], ...]; curves: name -> {place: constant}, places from
    `NUMBERS` on for numbers below zero, turned positive; eyes: nodes of the file that turn with the gaze; jaw: the node
    that turns by `open` radians times the curve "opening", or null. lips_only: without lids, brows and eyes.
    """
    if character.vrm:
        return {}
    rig = find_face(character)
    morphs = [(node, target, drivers) for node in rig.morphs for target, drivers in _by_target(rig, node, lips_only)]
    eyes = [] if lips_only else [character.node_ids[node] for node in rig.eyes]
    if not (morphs or eyes or rig.jaw is not None):
        return {}
    # Only what this character has: all constants of all formats would be ten times as many.
    used = {curve for _, _, drivers in morphs for curve, _ in drivers} | ({"opening"} if rig.jaw is not None else set())
    known = curve_constants()
    return {"morphs": morphs, "curves": {name: known[name] for name in sorted(used)}, "eyes": eyes,
            "jaw": None if rig.jaw is None else character.node_ids[rig.jaw], "open": JAW_OPEN}


def _by_target(rig: FaceRig, node: int, lips_only: bool) -> list[tuple[int, list[tuple[str, float]]]]:
    out: dict[int, list[tuple[str, float]]] = {}
    for target, curve, share in rig.morphs[node]:
        if is_lips(curve) or not lips_only:
            out.setdefault(target, []).append((curve, share))
    return sorted(out.items())


def curve_constants() -> dict[str, dict[int, float]]:
    """Curve -> place in the numbers of a face, or `NUMBERS` more for what they are below zero -> constant."""
    # One face for each number, and one for its negative: what a curve gives is its constant.
    values = _STEP * np.concatenate([np.eye(NUMBERS), -np.eye(NUMBERS)])
    values[NUMBERS:NUMBERS + 16] = 0.0  # visemes and blinks are never below zero
    face = FaceMotion(values[:, :15], values[:, 15], values[:, 16], values[:, 17], values[:, 18:], 1.0)
    return {name: {place: round(float(value) / _STEP, 6) for place, value in enumerate(curve) if value}
            for name, curve in curves(face).items()}
