"""Parses bone names: side, body part and number, in the spellings of common tools.

A single name can mislead: Rigify numbers neck and head as joints of the spine, and an exported control rig has every
part three times. So `character_labels` also reads the whole set of names of a character, in which a known convention is
recognised by several names together, and the nodes that move a mesh.
"""

import re
import unicodedata
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gesticulator.characters.mapping import ancestors
from gesticulator.characters.rig import Character

_JAPANESE = {word: english for english, words in {
    "left": "左", "right": "右", "hips": "センター", "pelvis": "骨盤", "lower body": "下半身", "spine": "上半身 背骨",
    "waist": "腰", "belly": "腹", "chest": "胸", "neck": "首", "head": "頭", "shoulder": "肩", "clavicle": "鎖骨",
    "upperarm": "腕 上腕", "forearm": "前腕", "elbow": "ひじ 肘", "wrist": "手首", "hand": "手", "thumb": "親指",
    "index": "人指 人差指 人差し指", "middle": "中指", "ring": "薬指", "pinky": "小指", "thigh": "足 太もも",
    "shin": "すね", "knee": "ひざ 膝", "ankle": "足首", "toe": "つま先", "hair": "髪", "twist": "捩", "eye": "目",
    "helper": "キャンセル",
}.items() for word in words.split()}
"""Word in the bone names of MMD -> the English word."""
# The longest words first, so that a compound is not read as its first character.
_JAPANESE_WORD = re.compile("|".join(sorted(map(re.escape, _JAPANESE), key=len, reverse=True)))


def english(name: str) -> str:
    """The name with Japanese words replaced by English ones, and without accents.

    >>> english("左ひじ"), english("Épaule.G"), english("LeftArm")
    (' left  elbow ', 'Epaule.G', 'LeftArm')
    """
    if name.isascii():
        return name
    text = _JAPANESE_WORD.sub(lambda match: f" {_JAPANESE[match[0]]} ", unicodedata.normalize("NFKC", name))
    return "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))


_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_SIDES = {"l": "Left", "left": "Left", "lf": "Left", "lft": "Left", "r": "Right", "right": "Right", "rt": "Right",
          "rgt": "Right"}
_NOISE = {"mixamorig", "bip", "j", "c", "cc", "base", "def", "org", "character", "bone", "joint", "jnt", "jt", "bn",
          "b", "bind", "skin", "sk", "bend", "stretch", "x", "m", "valve", "biped", "reference", "armature"}
_AIDS = {word for line in (
    "twist roll ik ctrl ctl control pole target corrective helper attach attachment socket slot holder prop weapon",
    "sword gun shield share twistcor muscle mch tweak driver drv dummy guide widget collider physics jiggle spring sec",
    "hair bun braid ponytail bang bangs ribbon hat skirt cloth cape coat sleeve breast pectoral cancel tail ear ears",
    "wing wings") for word in line.split()}
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
           "foot": ("Foot", "ToeBase"), "forefoot": ("Foot", "ToeBase"), "hand": ("Hand",), "palm": ("Hand",)}
_FINGERS = {short: finger for finger, words in {
    "Thumb": "thumb thmb thb", "Index": "index indx idx pointer", "Middle": "middle mid mdl", "Ring": "ring rng",
    "Pinky": "pinky pnky pinkie little small"}.items() for short in words.split()}
# A finger's name beside words for hands and fingers; a letter behind it numbers the phalanges.
_FINGER = re.compile(rf"(?:in)?(?:hand|finger|fing|fng|f)?({'|'.join(_FINGERS)})(?:finger|fing|fng)?([a-d]?)")
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

    def is_a(self, *parts: str) -> bool:
        """Whether it is a joint that is one of these parts, as far as its name tells."""
        return self.parts[:1] != () and self.parts[0] in parts and not self.tip and not self.aid

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
    """The labels of all names of a character. A first word that most names share is the character's name and is
    ignored ("EthanLeftArm").

    >>> [entry.parts for entry in labels(["Bob_Hips", "Bob_Head", "BobLeftArm", "BobLeftHand", "BobNeck"])]
    [('Hips',), ('Head',), ('Arm', 'ForeArm'), ('Hand',), ('Neck',)]
    """
    firsts = Counter(parts[0] for parts in map(words, names) if parts)
    word, count = firsts.most_common(1)[0] if firsts else ("", 0)
    # A common first word that is itself a side or a part ("Left") is no name of a character.
    known = word in _SIDES or word in _PARTS or word in _DOUBLE or word in _FINGERS
    noise = frozenset() if known or count < max(4, _MOST * len(names)) else frozenset((word,))
    return tuple(label(name, noise) for name in names)


_MOST = 0.6
"""Share of the names that begin with a word above which it is the name of the character."""


def label(name: str, noise: frozenset[str] = frozenset()) -> Label:
    """The label of a name; an empty `Label` if nothing is recognised. noise: words to ignore.

    >>> label("upperarm_l").parts, label("upperarm_l").side, label("Bip01 R Finger01").number
    (('Arm',), 'Left', '1')
    """
    tokens = [word for word in words(name) if word not in _NOISE and word not in noise]
    side = next((_SIDES[word] for word in tokens if word in _SIDES), "")
    tokens = [word for word in tokens if word not in _SIDES]
    if not side and tokens:
        side, tokens = _glued_side(tokens)
    tip = any(word in _TIPS for word in tokens)
    aid = any(word in _AIDS for word in tokens)
    # Unity and VRM name phalanges instead of numbering them.
    kind = next((_KINDS[word] for word in tokens if word in _KINDS), "")
    digits = [word for word in tokens if word.isdigit()]
    key = "".join(word for word in tokens if not word.isdigit() and word not in _TIPS | _AIDS and word not in _KINDS)
    number = kind or (digits[-1] if digits else "")
    if key in ("finger", "handfinger") and digits and side:  # Biped: finger 0 is the thumb, its joints 0, 01 and 02
        which = digits[-1]
        after = tokens[tokens.index("finger") + 1:] if "finger" in tokens else []
        if len(after) == 2 and after[0] in "12345":  # MakeHuman: the thumb is finger 1, its joints 1-1, 1-2 and 1-3
            which = str(int(after[0]) - 1) + after[1]
        return Label((tuple(dict.fromkeys(_FINGERS.values()))[min(int(which[0]), 4)],), side, which[1:], tip, aid)
    # A finger without a side is an ornament or part of a glove.
    if side and (finger := _FINGER.fullmatch(key)):
        return Label((_FINGERS[finger[1]],), side, number or finger[2], tip, aid)
    # Ambiguous names first: the search decides by bone lengths which meaning fits.
    parts = _DOUBLE.get(key, ()) if side else ()
    parts = parts or _PARTS.get(key, ())
    if parts and (parts[0] in ("Hips", "Spine", "Neck", "Head")) == bool(side):
        parts = ()  # a spine with a side is a muscle, an arm without a side is a prop
    return Label(parts, side, number, tip, aid)


def _glued_side(parts: list[str]) -> tuple[str, list[str]]:
    """The side prefixed to words such as "lthumb" and "leftarm", and the words without it."""
    for place, word in enumerate(parts):
        for prefix, side in (("left", "Left"), ("right", "Right"), ("l", "Left"), ("r", "Right")):
            rest = word.removeprefix(prefix)
            known = rest in _PARTS or rest in _DOUBLE or rest in _FINGERS
            if rest != word and known and word not in _PARTS and word not in _FINGERS:
                return side, [*parts[:place], rest, *parts[place + 1:]]
    return "", parts


_RIGIFY = re.compile(r"(DEF[-_]|ORG[-_]|)spine(?:[._]?(\d{3}))?", re.IGNORECASE)
"""Rigify's spine: its joints 0 to 3 are hips and trunk, the last one is the head, and those before it are the neck."""
_RIGIFY_TRUNK = 4
_RIGIFY_NAMES = {"upper_arm", "forearm", "thigh", "shin"}
"""Names that identify a rig with such a spine as Rigify's."""


def character_labels(character: Character) -> tuple[Label, ...]:
    """[N] the labels of a character's nodes."""
    entries = list(labels(character.names))
    for node, entry in _rigify_spine(character, entries).items():
        entries[node] = entry
    return tuple(_without_controls(character, entries))


def _rigify_spine(character: Character, entries: list[Label]) -> dict[int, Label]:
    """Node -> label of the spine of a Rigify character; empty for others, and if other nodes are named as the head."""
    stems = {re.sub(r"^(DEF|ORG)[-_]", "", name, flags=re.IGNORECASE).lower().split(".")[0].rstrip("_lr")
             for name in character.names}
    if not stems >= _RIGIFY_NAMES:
        return {}
    chains: dict[str, dict[int, int]] = {}
    for node, name in enumerate(character.names):
        match = _RIGIFY.fullmatch(name)
        if match:
            chains.setdefault(match[1].upper()[:3], {})[int(match[2] or 0)] = node
    chain = next((chains[prefix] for prefix in ("DEF", "", "ORG")
                  if len(chains.get(prefix, ())) > _RIGIFY_TRUNK and 0 in chains[prefix]), None)
    if chain is None:
        return {}
    # A bone named head on the spine, or one that moves the mesh, contradicts Rigify's layout.
    heads = [node for node, entry in enumerate(entries) if entry.is_a("Head")]
    if any(set(chain.values()) & set(ancestors(character.parents, node)) for node in heads) or (
            len(character.flesh) and np.isin(heads, character.flesh_nodes).any()):
        return {}  # the spine carries a head of that name
    out = {node: Label(("Hips" if number == 0 else "Spine" if number < _RIGIFY_TRUNK else "Neck",), "", str(number))
           for number, node in chain.items()}
    out[chain[max(chain)]] = Label(("Head",))
    return out | {node: Label() for node in heads}


def _without_controls(character: Character, entries: list[Label]) -> list[Label]:
    """The labels, without those of controls: nodes that move no vertex although another of the same name does."""
    if not len(character.flesh):
        return entries
    moves = np.zeros(len(character), dtype=bool)
    moves[np.unique(character.flesh_nodes)] = True
    # The parts that some node of the mesh's skin already has.
    moving = {(entry.parts[0], entry.side, entry.number) for node, entry in enumerate(entries)
              if entry.parts and moves[node] and not entry.aid and not entry.tip}
    return [replace(entry, parts=()) if entry.parts and not moves[node] and not character.skinned[node]
            and (entry.parts[0], entry.side, entry.number) in moving else entry for node, entry in enumerate(entries)]
