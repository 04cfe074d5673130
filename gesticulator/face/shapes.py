"""A face in the names of the formats: ARKit's 52 blend shapes, Oculus visemes, VRM expressions, and those of tools.

`arkit`, `oculus` and `vrm` turn a `FaceMotion` into curves by name, each 0 to 1. `find_shapes` says which of the
shapes of a character stand for them, and `jaw_angles` is for a character with a jaw bone alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from data_module.types import Array
from gesticulator.face.motion import FaceMotion
from gesticulator.face.visemes import VISEMES, opening

_SIDED = ("eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide")
_LEFT = [f"{name}Left" for name in _SIDED]
_RIGHT = [f"{name}Right" for name in _SIDED]
ARKIT = (
    *_LEFT, *_RIGHT, "jawForward", "jawLeft", "jawRight", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker",
    "mouthLeft", "mouthRight", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight",
    "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight", "mouthRollLower", "mouthRollUpper",
    "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft",
    "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp",
    "browOuterUpLeft", "browOuterUpRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft",
    "noseSneerRight", "tongueOut")
"""The 52 blend shapes of ARKit in the order of Live Link Face."""
_BOTH = ("mouthSmile", "mouthFrown", "mouthStretch", "mouthPress", "mouthLowerDown", "mouthUpperUp")
_MOUTHS: dict[str, dict[str, float]] = {
    "PP": {"mouthPress": 0.45, "mouthRollLower": 0.3, "mouthRollUpper": 0.3},
    "FF": {"jawOpen": 0.06, "mouthRollLower": 0.55, "mouthUpperUp": 0.3},
    "TH": {"jawOpen": 0.16, "tongueOut": 0.35, "mouthLowerDown": 0.2, "mouthUpperUp": 0.1},
    "DD": {"jawOpen": 0.13, "mouthLowerDown": 0.3, "mouthUpperUp": 0.15},
    "kk": {"jawOpen": 0.18, "mouthLowerDown": 0.2, "mouthStretch": 0.1},
    "CH": {"jawOpen": 0.12, "mouthFunnel": 0.5, "mouthPucker": 0.15},
    "SS": {"jawOpen": 0.06, "mouthStretch": 0.3, "mouthLowerDown": 0.35, "mouthUpperUp": 0.15},
    "nn": {"jawOpen": 0.14, "mouthLowerDown": 0.2},
    "RR": {"jawOpen": 0.14, "mouthFunnel": 0.35, "mouthPucker": 0.15},
    "aa": {"jawOpen": 0.65, "mouthLowerDown": 0.2, "mouthUpperUp": 0.1},
    "E": {"jawOpen": 0.4, "mouthStretch": 0.3, "mouthLowerDown": 0.15},
    "ih": {"jawOpen": 0.22, "mouthStretch": 0.4, "mouthSmile": 0.1},
    "oh": {"jawOpen": 0.45, "mouthFunnel": 0.45, "mouthPucker": 0.2},
    "ou": {"jawOpen": 0.2, "mouthPucker": 0.65, "mouthFunnel": 0.3},
}
"""Viseme -> shapes of ARKit; a name of `_BOTH` is for both sides."""
_VRM_MOUTHS: dict[str, dict[str, float]] = {
    "aa": {"aa": 1.0}, "E": {"ee": 1.0}, "ih": {"ih": 1.0}, "oh": {"oh": 1.0}, "ou": {"ou": 1.0},
    "FF": {"ih": 0.1}, "TH": {"ih": 0.3}, "DD": {"ih": 0.3}, "kk": {"ih": 0.15, "aa": 0.1}, "CH": {"ou": 0.45},
    "SS": {"ih": 0.3}, "nn": {"ih": 0.25}, "RR": {"oh": 0.3},
}
"""Viseme -> VRM's five vowels: the other shapes of a mouth are not in the format."""
VRM = ("aa", "ih", "ou", "ee", "oh", "blink", "happy", "sad", "lookLeft", "lookRight", "lookUp",
       "lookDown")
"""The presets of VRM 1.0 that a face may set; looks are for characters without eye bones."""
VRM_0 = {"aa": "a", "ih": "i", "ou": "u", "ee": "e", "oh": "o", "blink": "blink", "happy": "joy", "sad": "sorrow",
         "lookLeft": "lookleft", "lookRight": "lookright", "lookUp": "lookup", "lookDown": "lookdown"}
"""The same of VRM 0.x, in lower case."""
_FULL_LOOK = np.radians(30.0)
"""Turn of an eye at which ARKit's and VRM's looks are 1."""
JAW_OPEN = np.radians(16.0)
"""Turn of a jaw bone for the widest mouth."""
_MOOD = 0.6
"""Weight of VRM's emotions at a mood of 1: more changes the mouth too much to speak. Brows have no preset."""


def arkit(face: FaceMotion) -> dict[str, Array]:
    """[T] curves of ARKit's blend shapes, all 52."""
    out = {name: np.zeros(len(face)) for name in ARKIT}
    for number, viseme in enumerate(VISEMES):
        for shape, share in _MOUTHS.get(viseme, {}).items():
            for name in (f"{shape}Left", f"{shape}Right") if shape in _BOTH else (shape,):
                out[name] += share * face.visemes[:, number]
    smiles, frowns = np.maximum(face.smile, 0.0), np.maximum(-face.smile, 0.0)
    raised, drawn = np.maximum(face.brows, 0.0), np.maximum(-face.brows, 0.0)
    # Each eye has four looks, relative to the nose: looking to the left is out for the left eye and in for the right.
    left, up = (face.gaze / _FULL_LOOK).T
    for side, outward in (("Left", left), ("Right", -left)):
        out[f"mouthSmile{side}"] += 0.7 * smiles
        out[f"cheekSquint{side}"] += 0.3 * smiles
        out[f"mouthFrown{side}"] += 0.6 * frowns
        out[f"browOuterUp{side}"] += 0.45 * raised
        out[f"browDown{side}"] += 0.6 * drawn
        out[f"eyeBlink{side}"] += face.blink
        out[f"eyeLookOut{side}"] += np.maximum(outward, 0.0)
        out[f"eyeLookIn{side}"] += np.maximum(-outward, 0.0)
        out[f"eyeLookUp{side}"] += np.maximum(up, 0.0)
        out[f"eyeLookDown{side}"] += np.maximum(-up, 0.0)
    out["browInnerUp"] += 0.5 * raised + 0.3 * frowns
    return {name: np.clip(curve, 0.0, 1.0) for name, curve in out.items()}


def oculus(face: FaceMotion) -> dict[str, Array]:
    """[T] curves of the Oculus visemes ("viseme_aa")."""
    return {f"viseme_{name}": face.visemes[:, number].copy() for number, name in enumerate(VISEMES)}


def vrm(face: FaceMotion) -> dict[str, Array]:
    """[T] curves of the presets of VRM 1.0 (`VRM`)."""
    out = {name: np.zeros(len(face)) for name in VRM}
    for number, viseme in enumerate(VISEMES):
        for name, share in _VRM_MOUTHS.get(viseme, {}).items():
            out[name] += share * face.visemes[:, number]
    left, up = (face.gaze / _FULL_LOOK).T
    for name, curve in (("lookLeft", left), ("lookRight", -left), ("lookUp", up), ("lookDown", -up),
                        ("blink", face.blink), ("happy", _MOOD * face.smile), ("sad", -_MOOD * face.smile)):
        out[name] += np.maximum(curve, 0.0)
    return {name: np.clip(curve, 0.0, 1.0) for name, curve in out.items()}


# --------------------------------------------------------------------------------------------------- finding shapes

def _plain(name: str) -> str:
    """A name without case, separators, and the prefixes that tools put before it."""
    name = re.sub(r"^.*[.:]", "", name)
    return re.sub(r"[^a-z0-9]", "", re.sub(r"^(ctrl_expressions_|bs_|blendshape\d*_|morph_)", "", name.lower()))


def _sided(name: str) -> str:
    """ARKit's name with the sides of other spellings: browDown_L, eyeBlinkL."""
    return re.sub(r"(left|right)$", lambda side: side[0][0], _plain(name))


_ARKIT_NAMES = {_plain(name): name for name in ARKIT} | {_sided(name): name for name in ARKIT if name != _sided(name)}
# The controls of MetaHuman are ARKit's in other words.
_METAHUMAN = {
    "eyeblinkl": "eyeBlinkLeft", "eyeblinkr": "eyeBlinkRight", "eyelookleftl": "eyeLookOutLeft",
    "eyelookrightl": "eyeLookInLeft", "eyelookleftr": "eyeLookInRight", "eyelookrightr": "eyeLookOutRight",
    "browraiseinl": "browInnerUp", "browraiseinr": "browInnerUp", "browraiseouterl": "browOuterUpLeft",
    "browraiseouterr": "browOuterUpRight", "mouthcornerpulll": "mouthSmileLeft", "mouthcornerpullr": "mouthSmileRight",
    "mouthcornerdepressl": "mouthFrownLeft", "mouthcornerdepressr": "mouthFrownRight",
    "mouthstretchl": "mouthStretchLeft",
    "mouthstretchr": "mouthStretchRight", "mouthlowerlipdepressl": "mouthLowerDownLeft",
    "mouthlowerlipdepressr": "mouthLowerDownRight", "mouthupperlipraisel": "mouthUpperUpLeft",
    "mouthupperlipraiser": "mouthUpperUpRight", "mouthfunneldl": "mouthFunnel", "mouthfunneldr": "mouthFunnel",
    "mouthfunnelul": "mouthFunnel", "mouthfunnelur": "mouthFunnel", "mouthlipspursedl": "mouthPucker",
    "mouthlipspursedr": "mouthPucker", "mouthlipspurseul": "mouthPucker", "mouthlipspurseur": "mouthPucker",
    "mouthlipspressl": "mouthPressLeft", "mouthlipspressr": "mouthPressRight"}
# Reallusion's Character Creator, Mixamo (Fuse), VRChat and Japanese names -> a shape of ARKit or a viseme, and a share.
_TOOLS: dict[str, tuple[str, float]] = {
    "vopen": ("viseme_aa", 1.0), "vexplosive": ("viseme_PP", 1.0), "vdentallip": ("viseme_FF", 1.0),
    "vtonguecurlu": ("viseme_RR", 0.5), "vtighto": ("viseme_ou", 1.0), "vaffricate": ("viseme_CH", 1.0),
    "vwide": ("viseme_ih", 1.0), "vlipopen": ("viseme_DD", 1.0), "vtight": ("viseme_SS", 0.5),
    "eyeblinkl": ("eyeBlinkLeft", 1.0), "eyeblinkr": ("eyeBlinkRight", 1.0), "eyeblink": ("eyeBlinkLeft", 1.0),
    "browraiseinnerl": ("browInnerUp", 1.0), "browraiseinnerr": ("browInnerUp", 1.0),
    "browraiseouterl": ("browOuterUpLeft", 1.0), "browraiseouterr": ("browOuterUpRight", 1.0),
    "mouthsmilel": ("mouthSmileLeft", 1.0), "mouthsmiler": ("mouthSmileRight", 1.0),
    "blinkleft": ("eyeBlinkLeft", 1.0), "blinkright": ("eyeBlinkRight", 1.0), "blink": ("eyeBlinkLeft", 1.0),
    "mouthopen": ("opening", 1.0), "browsupleft": ("browOuterUpLeft", 1.0), "browsupright": ("browOuterUpRight", 1.0),
    "smileleft": ("mouthSmileLeft", 1.0), "smileright": ("mouthSmileRight", 1.0),
    "mouthnarrowleft": ("mouthPucker", 1.0), "mouthnarrowright": ("mouthPucker", 1.0),
    "a": ("vrm_aa", 1.0), "i": ("vrm_ih", 1.0), "u": ("vrm_ou", 1.0), "e": ("vrm_ee", 1.0), "o": ("vrm_oh", 1.0),
    "あ": ("vrm_aa", 1.0), "い": ("vrm_ih", 1.0), "う": ("vrm_ou", 1.0), "え": ("vrm_ee", 1.0), "お": ("vrm_oh", 1.0),
    "まばたき": ("eyeBlinkLeft", 1.0)}
_OCULUS_NAMES = {_plain(f"{prefix}{name}"): f"viseme_{name}" for name in VISEMES for prefix in ("viseme_", "v_")} | {
    "visemei": "viseme_ih", "visemeo": "viseme_oh", "visemeu": "viseme_ou"}
_LIPS = ("jaw", "mouth", "tongue", "viseme", "vrm", "opening", "cheekPuff")


def curves(face: FaceMotion) -> dict[str, Array]:
    """All curves of a face by name: ARKit's, "viseme_aa", "vrm_aa" for VRM's presets, and "opening"."""
    return {**arkit(face), **oculus(face), **{f"vrm_{name}": curve for name, curve in vrm(face).items()},
            "opening": opening(face.visemes)}


def find_shapes(names: Iterable[str]) -> dict[str, tuple[str, float]]:
    """Shape of a character -> the curve of `curves` that drives it, and its share. One kind of mouth is chosen, the
    richest: ARKit's or MetaHuman's (with jawOpen), Oculus visemes, those of tools, VRM's vowels. Empty if none is
    known."""
    known = list(dict.fromkeys(names))
    ways = {
        "arkit": {name: (curve, 1.0) for name in known
                  if (curve := _ARKIT_NAMES.get(_plain(name)) or _METAHUMAN.get(_plain(name)))},
        "oculus": {name: (curve, 1.0) for name in known if (curve := _OCULUS_NAMES.get(_plain(name)))},
        "tools": {name: tool for name in known if (tool := _TOOLS.get(_plain(name) or name.lower()))}}
    # A character often has shapes of several kinds; driving two of them at once would open the mouth twice.
    mouth = next((way for way, least in (("arkit", 3), ("oculus", 5), ("tools", 1))
                  if sum(is_lips(curve) for curve, _ in ways[way].values()) >= least
                  and (way != "arkit" or any(curve == "jawOpen" for curve, _ in ways[way].values()))), "")
    chosen = {name: driver for name, driver in ways.get(mouth, {}).items() if is_lips(driver[0])}
    # Lids and brows come from whatever kind has them: those do not add up with the mouth.
    for way in ways.values():
        chosen |= {name: driver for name, driver in way.items() if not is_lips(driver[0]) and name not in chosen}
    return chosen


def is_lips(curve: str) -> bool:
    """True if a curve moves the mouth for speech; the others need the whole face."""
    return curve.startswith(_LIPS) and curve.partition("_")[2] not in VRM[5:]


def jaw_angles(face: FaceMotion) -> Array:
    """[T] turn of a jaw bone, radians downwards."""
    return np.asarray(JAW_OPEN * opening(face.visemes))
