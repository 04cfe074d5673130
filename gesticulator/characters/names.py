"""Parses bone names: side, body part and number, in the spellings of common tools."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from gesticulator.characters.languages import LEFT, RIGHT, WORDS, english, split

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_SIDES = {"l": "Left", "left": "Left", "lf": "Left", "lft": "Left", "r": "Right", "right": "Right", "rt": "Right",
          "rgt": "Right", **dict.fromkeys(LEFT, "Left"), **dict.fromkeys(RIGHT, "Right")}
_FRENCH = {"g": "left", "d": "right"}
_NOISE = {"mixamorig", "bip", "j", "c", "cc", "base", "def", "org", "character", "bone", "joint", "jnt", "jt", "bn",
          "b", "bind", "skin", "sk", "bend", "stretch", "x", "m", "valve", "biped", "reference", "armature"}
_AIDS = split("twist roll ik ctrl ctl control pole target corrective helper attach attachment socket slot holder prop",
              "weapon sword gun shield share twistcor muscle mch tweak driver drv dummy guide widget collider physics",
              "jiggle spring sec hair bun braid ponytail bang bangs ribbon hat skirt cloth cape coat sleeve breast",
              "pectoral cancel tail ear ears wing wings")
"""Words in the names of helpers, controls, hair, clothes, things, and limbs that a human lacks: none is a joint."""
_TIPS = {"end", "nub", "tip", "site", "effector", "top"}

# Part -> unambiguous names.
_CLEAR = {
    "Hips": ("hips", "pelvis", "hip", "cog", "lowertorso"),
    "Spine": ("spine", "chest", "upperchest", "torso", "abdomen", "waist", "lowerback", "upperback", "abdomenlower",
              "abdomenupper", "chestlower", "chestupper", "spinelower", "spinemid", "spineupper", "thorax", "belly",
              "lumbar", "back", "ribcage", "uppertorso"),
    "Neck": ("neck", "necklower", "neckupper", "upperneck", "lowerneck"),
    "Head": ("head", "skull"),
    "Shoulder": ("clavicle", "collar", "collarbone", "clav", "scapula"),
    "Arm": ("upperarm", "uparm", "shldr", "humerus", "armupper", "upperarmbone"),
    "ForeArm": ("forearm", "lowerarm", "elbow", "loarm", "lowarm", "farm", "armlower", "ulna"),
    "Hand": ("hand", "wrist"),
    "UpLeg": ("upleg", "upperleg", "thigh", "femur", "legupper"),
    "Leg": ("shin", "calf", "lowerleg", "knee", "loleg", "lowleg", "tibia", "leglower"),
    "Foot": ("ankle", "foot"),
    "ToeBase": ("toe", "toes", "toebase", "ball"),
}
# Names that mean different parts in different tools: SMPL-X's shoulder is Mixamo's arm.
_DOUBLE = {"shoulder": ("Shoulder", "Arm"), "arm": ("Arm", "ForeArm"), "leg": ("Leg", "UpLeg"),
           "hip": ("HipJoint", "UpLeg"),  # a node above the thigh in some tools
           "ude": ("Arm", "Hand"), "ashi": ("UpLeg", "Foot"),  # the arm in Japanese is the wrist in Chinese
           "foot": ("Foot", "ToeBase"), "forefoot": ("Foot", "ToeBase"), "hand": ("Hand",), "palm": ("Hand",)}
_FINGERS = {"thumb": "Thumb", "index": "Index", "pointer": "Index", "mid": "Middle", "middle": "Middle",
            "ring": "Ring", "pinky": "Pinky", "little": "Pinky", "pinkie": "Pinky", "small": "Pinky"}
_PARTS = {spelling: (part,) for part, spellings in _CLEAR.items() for spelling in spellings}
_KINDS = {"meta": "Metacarpal", "metacarpal": "Metacarpal", "proximal": "1", "intermediate": "2", "distal": "3",
          "carpal": "Metacarpal"}


@dataclass(frozen=True)
class Label:
    """The information in the name of a node.

    parts: the possible body parts, the likeliest first ("Arm", "Hips", "Index"); empty if unknown.
    side: "Left", "Right" or "". number: the significant digits of the name ("2", "01"; "Metacarpal"), or "".
    tip: an end effector that does not rotate. aid: a twist bone, a control or a prop.
    """

    parts: tuple[str, ...] = ()
    side: str = ""
    number: str = ""
    tip: bool = False
    aid: bool = False

    @property
    def finger(self) -> str:
        """Our name of its finger, or ""."""
        return self.parts[0] if self.parts and self.parts[0] in _FINGERS.values() else ""


def words(name: str) -> list[str]:
    """The words and numbers of a name in lower case, without a namespace before a colon or a bar.

    >>> words("mixamorig:LeftUpLeg"), words("LHipJoint"), words("DEF-upper_arm.L.001")
    (['mixamorig', 'left', 'up', 'leg'], ['l', 'hip', 'joint'], ['def', 'upper', 'arm', 'l', '001'])
    """
    plain = re.split(r"[:|]", english(name))
    # "LHipJoint": a capital before a capitalised word is a word of its own.
    spaced = re.sub(r"([A-Z])(?=[A-Z][a-z])", r"\1 ", plain[-1])
    parts = [word.lower() for word in _WORD.findall(spaced)]
    if len(plain) > 1 and plain[-2]:
        parts = [*_WORD.findall(plain[-2].lower())[:1], *parts]
    return parts


def labels(names: Sequence[str]) -> tuple[Label, ...]:
    """The labels of all names of a character. A word that most names begin with says nothing ("EthanLeftArm").

    >>> [entry.parts for entry in labels(["Bob_Hips", "Bob_Head", "BobLeftArm", "BobLeftHand", "BobNeck"])]
    [('Hips',), ('Head',), ('Arm', 'ForeArm'), ('Hand',), ('Neck',)]
    """
    firsts = Counter(found[0] for found in map(words, names) if found)
    word, count = firsts.most_common(1)[0] if firsts else ("", 0)
    known = word in _SIDES or word in _PARTS or word in _DOUBLE or word in _FINGERS or word in WORDS
    noise = frozenset() if known or count < max(4, _MOST * len(names)) else frozenset((word,))
    sided = [set(found) for found in map(words, names) if set(found) & set(_FRENCH)]
    french = sum(bool(found & set(WORDS)) for found in sided) >= _FEW
    return tuple(label(name, noise, french) for name in names)


_FEW = 3
"""Names with a word that is not English beside a "g" or "d" that make these the French sides."""
_MOST = 0.6
"""Share of the names that begin with a word above which it is the name of the character."""


def label(name: str, noise: frozenset[str] = frozenset(), french: bool = False) -> Label:
    """The label of a name; an empty `Label` if nothing is recognised.

    noise: words that say nothing. french: whether "g" and "d" are sides.

    >>> label("upperarm_l").parts, label("upperarm_l").side, label("Bip01 R Finger01").number
    (('Arm',), 'Left', '1')
    """
    tokens = [word for word in words(name) if word not in _NOISE and word not in noise]
    tokens = _in_english([_FRENCH.get(word, word) for word in tokens] if french else tokens)
    side = next((_SIDES[word] for word in tokens if word in _SIDES), "")
    tokens = [word for word in tokens if word not in _SIDES]
    if not side and tokens:
        side, tokens = _glued_side(tokens)
    tip = any(word in _TIPS for word in tokens)
    aid = any(word in _AIDS for word in tokens)
    kind = next((_KINDS[word] for word in tokens if word in _KINDS), "")
    digits = [word for word in tokens if _is_number(word)]
    key = "".join(word for word in tokens if not _is_number(word) and word not in _TIPS | _AIDS and word not in _KINDS)
    number = kind or (digits[-1] if digits else "")
    if key in ("finger", "handfinger") and digits and side:  # Biped: finger 0 is the thumb, its joints 0, 01 and 02
        which = digits[-1]
        after = tokens[tokens.index("finger") + 1:] if "finger" in tokens else []
        if len(after) == 2 and after[0] in "12345":  # MakeHuman: the thumb is finger 1, its joints 1-1, 1-2 and 1-3
            which = str(int(after[0]) - 1) + after[1]
        return Label((tuple(dict.fromkeys(_FINGERS.values()))[min(int(which[0]), 4)],), side, which[1:], tip, aid)
    for short, finger in _FINGERS.items():
        if side and key in (short, "hand" + short, short + "finger", "finger" + short, "f" + short, "in" + short):
            return Label((finger,), side, number, tip, aid)
    parts = _DOUBLE.get(key, ()) if side else ()
    parts = parts or _PARTS.get(key, ())
    if parts and (parts[0] in ("Hips", "Spine", "Neck", "Head")) == bool(side):
        parts = ()  # a spine with a side is a muscle, an arm without a side is a prop
    return Label(parts, side, number, tip, aid)


def _in_english(tokens: list[str]) -> list[str]:
    """Words in other languages of the Latin alphabet replaced, also those of two parts ("avant bras")."""
    out: list[str] = []
    for word in tokens:
        if out and out[-1] + word in WORDS:
            out[-1] = WORDS[out[-1] + word]
        else:
            out.append(WORDS.get(word, word))
    return out


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdigit()  # "\u00b2".isdigit(), but int() does not read it


def _glued_side(parts: list[str]) -> tuple[str, list[str]]:
    """The side prefixed to words such as "lthumb" and "leftarm", and the words without it."""
    for place, word in enumerate(parts):
        for prefix, side in (("left", "Left"), ("right", "Right"), ("l", "Left"), ("r", "Right")):
            rest = word.removeprefix(prefix)
            known = rest in _PARTS or rest in _DOUBLE or rest in _FINGERS
            if rest != word and known and word not in _PARTS and word not in _FINGERS:
                return side, [*parts[:place], rest, *parts[place + 1:]]
    return "", parts
