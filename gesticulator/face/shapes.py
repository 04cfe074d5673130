"""A face in the names of the formats: ARKit's 52 blend shapes, Oculus visemes, VRM expressions, and those of tools.

`arkit`, `oculus` and `vrm` turn a `FaceMotion` into curves by name, each 0 to 1. `find_shapes` says which of the
shapes of a character stand for them, and `jaw_angles` is for a character with a jaw bone alone.
"""

import re
from collections.abc import Iterable, Mapping

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

# Words of MetaHuman, Meta and SRanipal for shapes of ARKit; a name or a curve without a side is for both.
_OF_ARKIT = {name: curve for curve, names in {
    "eyeLookOutLeft": "eyeLookLeftLeft", "eyeLookInLeft": "eyeLookRightLeft", "eyeLookInRight": "eyeLookLeftRight",
    "eyeLookOutRight": "eyeLookRightRight", "browInnerUp": "browRaiseIn innerBrowRaiser",
    "browOuterUp": "browRaiseOuter outerBrowRaiser", "browDown": "browLowerer", "eyeBlink": "eyeClosed",
    "jawOpen": "jawDrop", "mouthSmile": "mouthCornerPull lipCornerPuller", "mouthStretch": "lipStretcher",
    "mouthFrown": "mouthCornerDepress lipCornerDepressor", "mouthPress": "mouthLipsPress lipPressor",
    "mouthLowerDown": "mouthLowerLipDepress lowerLipDepressor", "mouthUpperUp": "mouthUpperLipRaise upperLipRaiser",
    "mouthRollUpper": "mouthUpperLipRollIn lipSuckUpper lipSuckLT lipSuckRT",
    "mouthRollLower": "mouthLowerLipRollIn lipSuckLower lipSuckLB lipSuckRB",
    "mouthPucker": "mouthLipsPurseD mouthLipsPurseU mouthPout lipPucker lipPuckerUpper lipPuckerLower",
    "mouthFunnel": "mouthFunnelD mouthFunnelU mouthOShape lipFunnel lipFunnelUpper lipFunnelLower lipFunnelerLB "
                   "lipFunnelerLT lipFunnelerRB lipFunnelerRT"}.items() for name in names.split()}
# Those of Reallusion's Character Creator, Mixamo (Fuse), VRChat, VRoid, Unity-chan, and Japanese ones.
_TOOLS = {name: curve for curve, names in {
    "viseme_aa": "vOpen", "viseme_PP": "vExplosive", "viseme_FF": "vDentalLip", "viseme_RR": "vTongueCurlU",
    "viseme_ou": "vTightO", "viseme_CH": "vAffricate", "viseme_ih": "vWide", "viseme_DD": "vLipOpen",
    "viseme_SS": "vTight", "opening": "mouthOpen", "mouthPucker": "mouthNarrow", "mouthSmile": "mouthSmile",
    "mouthSmileLeft": "smileLeft", "mouthSmileRight": "smileRight", "browInnerUp": "browRaiseInner",
    "browOuterUp": "browRaiseOuter browsUp", "vrm_blink": "eyeDefC まばたき",
    "eyeBlink": "blink eyeBlink eyesBlink eyeClose eyesClose eyesClosed"}.items() for name in names.split()}
_HALF = ("vtonguecurlu", "vtight")
"""Names of `_TOOLS` whose shape is twice as strong as its curve."""
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_a-zA-Z]+")
_SAME = {"mth": "mouth", "mouse": "mouth"}
"""Words of tools for another word."""


def _spelled(table: Mapping[str, str]) -> dict[str, str]:
    """Every spelling of the names of a table in lower case -> curve: their side in full or as a letter, before the name
    or behind it."""
    known = {*ARKIT, "opening", "vrm_blink", *(f"viseme_{name}" for name in VISEMES)}
    out: dict[str, str] = {}
    for name, curve in table.items():
        stem = re.sub("(Left|Right)$", "", name)
        for side in (name.removeprefix(stem),) if stem != name else ("", "Left", "Right"):
            other = "vrm_blink" if curve == "eyeBlink" else f"{curve}Left"
            sided = next(each for each in (curve, curve + side, other) if each in known)
            key, side = stem.lower(), side.lower()
            out |= dict.fromkeys((key + side, key + side[:1], side + key, side[:1] + key), sided)
    return out


_NAMES = {
    "arkit": _spelled(_OF_ARKIT | {name: name for name in ARKIT}),
    "visemes": {prefix + name.lower(): f"viseme_{name}" for name in VISEMES for prefix in ("viseme", "v")}
    | {"visemei": "viseme_ih", "visemeo": "viseme_oh", "visemeu": "viseme_ou"},
    "tools": _spelled(_TOOLS)}
"""Kind of shapes -> a name's last words in lower case, joined -> the curve."""
_KNOWN = {name for table in _NAMES.values() for name in table}
_VOWELS = {name: f"vrm_{vowel}" for vowel, names in {
    "aa": "a aa aah ah あ", "ih": "i ih い", "ou": "u ou ooh uu う", "ee": "e ee え", "oh": "o oh お"}.items()
           for name in names.split()}
_PHONES = {name: f"viseme_{viseme}" for viseme, names in {
    "PP": "pp mbp bmp m p", "FF": "ff fv f v", "TH": "th", "DD": "dd td d t", "kk": "kk k g", "CH": "ch sh",
    "SS": "ss s z", "nn": "nn n l", "RR": "rr er", "aa": "aa a ai ah aah", "E": "e eh uh", "ih": "ih i ee iy",
    "oh": "oh o ow", "ou": "ou u oo ooh uw wq w"}.items() for name in names.split()}
_RHUBARB = {"a": "viseme_PP", "b": "viseme_SS", "c": "viseme_E", "d": "viseme_aa", "e": "viseme_oh", "f": "viseme_ou",
            "g": "viseme_FF", "h": "viseme_nn"}
"""The mouths of Preston Blair's series, which Rhubarb and 2-D animators call A to H."""
_LIPS = ("jaw", "mouth", "tongue", "viseme", "vrm", "opening", "cheekPuff")
SPEECH = tuple(name for name in ARKIT if re.sub("(Left|Right)$", "", name) in {
    shape for mouth in _MOUTHS.values() for shape in mouth if shape not in ("tongueOut", "mouthSmile")})
"""ARKit's shapes that speech moves."""


def curves(face: FaceMotion) -> dict[str, Array]:
    """All curves of a face by name: ARKit's, "viseme_aa", "vrm_aa" for VRM's presets, and "opening"."""
    return {**arkit(face), **oculus(face), **{f"vrm_{name}": curve for name, curve in vrm(face).items()},
            "opening": opening(face.visemes)}


def find_shapes(names: Iterable[str]) -> dict[str, tuple[str, float]]:
    """Shape of a character -> the curve of `curves` that drives it, and its share. One kind of mouth is chosen, the
    richest: ARKit's or MetaHuman's (with jawOpen), Oculus visemes, those of tools, vowels. Empty if none is known.

    A name counts by its last words, whatever their case, what separates them, and what is before them: a prefix is the
    mesh's or the tool's. Names of one or two letters count only as several with one prefix.
    """
    ways: dict[str, dict[str, tuple[str, float]]] = {kind: {} for kind in (*_NAMES, "vowels")}
    groups: dict[str, dict[str, str]] = {}
    for name in dict.fromkeys(names):
        words = [_SAME.get(word.lower(), word.lower()) for word in _WORD.findall(re.sub("_max$", "", name))]
        tails = ["".join(words[first:]) for first in range(len(words))]
        tail = next((tail for tail in tails if tail in _KNOWN), "")
        before = words[:tails.index(tail)] if tail else words[:-1]
        ends = range(len(before) + 1)
        if tail and any("".join(before[first:last]) in _KNOWN for last in ends for first in range(last)):
            continue  # a correction, of two shapes at once
        for kind, table in _NAMES.items():
            if tail in table:
                ways[kind][name] = table[tail], 0.5 if tail in _HALF else 1.0
        if words and not tail:
            groups.setdefault("".join(before), {}).setdefault(words[-1], name)
    for prefix, rows in groups.items():
        vowels = _RHUBARB if {"b", "c", "d"} <= rows.keys() else _VOWELS
        consonants = len(rows.keys() & (_PHONES.keys() - _VOWELS.keys() - {"ai", "eh"})) > 2
        table, kind = (_PHONES, "visemes") if consonants and vowels is _VOWELS else (vowels, "vowels")
        known = {table[word]: name for word, name in reversed(rows.items()) if word in table}
        if len(known) >= _FEWEST_LETTERS or not prefix:
            ways[kind] |= {name: (curve, 1.0) for curve, name in known.items()}
    # A character often has shapes of several kinds; driving two of them at once would open the mouth twice.
    lips = {way: {curve for curve, _ in rows.values() if is_lips(curve) and (curve not in ARKIT or curve in SPEECH)}
            for way, rows in ways.items()}
    mouth = next((way for way, least in _CHOICE if len(lips[way]) >= least
                  and (way != "arkit" or least == 1 or "jawOpen" in lips[way])), "arkit")
    chosen = {name: driver for name, driver in ways[mouth].items() if is_lips(driver[0])}
    # Lids and brows come from whatever kind has them: those do not add up with the mouth.
    for way in ways.values():
        chosen |= {name: driver for name, driver in way.items() if not is_lips(driver[0]) and name not in chosen}
    sided = any(curve == "eyeBlinkRight" for curve, _ in chosen.values())
    return {name: driver for name, driver in chosen.items() if not (sided and driver[0] == "vrm_blink")}


_CHOICE = (("arkit", 3), ("visemes", 3), ("tools", 3), ("vowels", 3), ("tools", 1), ("vowels", 1), ("arkit", 1))
"""Kinds of mouths in the order of their worth, and the least different curves that each takes of those that speech
moves."""
_FEWEST_LETTERS = 3
"""Least different names of one or two letters behind one prefix that are taken for sounds."""


def lacking(found: Iterable[str]) -> list[str]:
    """ARKit's shapes that speech moves and that are not among the curves of a mouth of ARKit's shapes; none of other
    mouths."""
    stems = {re.sub("(Left|Right)$", "", curve): curve in ARKIT for curve in found if is_lips(curve)}
    wanted = dict.fromkeys(re.sub("(Left|Right)$", "", curve) for curve in SPEECH)
    return [stem for stem in wanted if stem not in stems] if stems and all(stems.values()) else []


def is_lips(curve: str) -> bool:
    """True if a curve moves the mouth for speech; the others need the whole face."""
    return curve.startswith(_LIPS) and curve.partition("_")[2] not in VRM[5:]


def jaw_angles(face: FaceMotion) -> Array:
    """[T] turn of a jaw bone, radians downwards."""
    return np.asarray(JAW_OPEN * opening(face.visemes))
