"""Characters for tests, drawn from a seed: names x rest pose x units x twist and extra bones x proportions.

A rig is built as a body in our axes (Y up, facing +Z, left +X, metres), posed, and only then given the axes, units,
rest rotations and names of a tool. `Rig.truth` tells which node is which of our joints, so the search can be judged.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gesticulator.characters.rig import Character
from tests.gltf_reader import glb, with_arrays

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
SIDES = ("Left", "Right")


@dataclass
class Rig:
    """A character, and what is true of it.

    truth: our joint -> node; spine and neck: their chains. axes: [3, 3] ours = axes @ file's. unit: metres per unit.
    bind: [N, 4, 4] the pose that the mesh was bound in, where it is not the rest pose.
    """

    character: Character
    truth: dict[str, int]
    spine: list[int]
    neck: list[int]
    axes: np.ndarray
    unit: float
    style: str
    pose: str
    size: float
    torso: tuple[float, float]
    bind: np.ndarray | None = None

    def bound(self) -> np.ndarray:
        """[N, 4, 4] the nodes in the pose that the mesh was bound in, where `axes` hold."""
        return self.character.world_matrices() if self.bind is None else self.bind


@dataclass
class _Node:
    key: str
    parent: str | None
    place: np.ndarray  # in the T-pose
    name: str = ""
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))  # of the pose, world
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))  # of the node in the T-pose, world


# ---------------------------------------------------------------------------------------------------- names

def _camel(prefix: str = "") -> Callable[[str], str]:
    return lambda key: prefix + key


def _sided(key: str) -> tuple[str, str]:
    side = next((side for side in SIDES if key.startswith(side)), "")
    return side, key.removeprefix(side)


def _finger(part: str) -> tuple[str, str] | None:
    found = next((finger for finger in FINGERS if part.startswith("Hand" + finger)), None)
    return None if found is None else (found, part.removeprefix("Hand" + found))


def _table(parts: dict[str, str], pattern: str, fingers: str, sides: Sequence[str] = SIDES,
           numbers: dict[str, str] | None = None) -> Callable[[str], str]:
    """Names by a table of parts; pattern and fingers: of sided parts and finger joints."""
    def name(key: str) -> str:
        side, part = _sided(key)
        theirs = sides[SIDES.index(side)] if side else ""
        finger = _finger(part) if side else None
        if finger is not None:
            place = (numbers or {}).get(finger[1], finger[1])
            return fingers.format(side=theirs, finger=parts.get(finger[0], finger[0]), place=place)
        return pattern.format(side=theirs, part=parts.get(part, part)) if side else parts.get(part, part)

    return name


_BIPED = {"Hips": "Bip01 Pelvis", "Head": "Bip01 Head", "Shoulder": "Clavicle", "Arm": "UpperArm",
          "ForeArm": "Forearm", "Hand": "Hand", "UpLeg": "Thigh", "Leg": "Calf", "Foot": "Foot", "ToeBase": "Toe0",
          **{f"Spine{i or ''}": f"Bip01 Spine{i or ''}" for i in range(6)},
          **{f"Neck{i or ''}": f"Bip01 Neck{i or ''}" for i in range(3)},
          **{f: str(i) for i, f in enumerate(FINGERS)}}
_SMPLX = {"Hips": "pelvis", "Head": "head", "Shoulder": "collar", "Arm": "shoulder", "ForeArm": "elbow",
          "Hand": "wrist", "UpLeg": "hip", "Leg": "knee", "Foot": "ankle", "ToeBase": "foot",
          **{f"Spine{i or ''}": f"spine{i + 1}" for i in range(6)}, "Neck": "neck", "Neck1": "neck2", "Neck2": "neck3",
          **{f: f.lower() for f in FINGERS}}
_SOMA = {"UpLeg": "Leg", "Leg": "Shin", "Neck": "Neck1", "Neck1": "Neck2", "Neck2": "Neck3"}
_VRM = {"Hips": "J_Bip_C_Hips", "Head": "J_Bip_C_Head", "Shoulder": "Shoulder", "Arm": "UpperArm",
        "ForeArm": "LowerArm", "Hand": "Hand", "UpLeg": "UpperLeg", "Leg": "LowerLeg", "Foot": "Foot",
        "ToeBase": "ToeBase", "Spine": "J_Bip_C_Spine", "Spine1": "J_Bip_C_Chest", "Spine2": "J_Bip_C_UpperChest",
        "Spine3": "J_Bip_C_UpperChest2", "Spine4": "J_Bip_C_UpperChest3", "Spine5": "J_Bip_C_UpperChest4",
        "Neck": "J_Bip_C_Neck", "Neck1": "J_Bip_C_Neck2", "Neck2": "J_Bip_C_Neck3", "Pinky": "Little"}
_CC = {"Hips": "CC_Base_Hip", "Head": "CC_Base_Head", "Shoulder": "Clavicle", "Arm": "Upperarm", "ForeArm": "Forearm",
       "UpLeg": "Thigh", "Leg": "Calf", "Spine": "CC_Base_Waist", "Spine1": "CC_Base_Spine01",
       "Spine2": "CC_Base_Spine02", "Spine3": "CC_Base_Spine03", "Spine4": "CC_Base_Spine04",
       "Spine5": "CC_Base_Spine05", "Middle": "Mid",
       **{f"Neck{i or ''}": f"CC_Base_NeckTwist{i + 1:02d}" for i in range(3)}}
_DAZ = {"Hips": "hip", "Head": "head", "Shoulder": "Collar", "Arm": "ShldrBend", "ForeArm": "ForearmBend",
        "UpLeg": "ThighBend", "Leg": "Shin", "ToeBase": "Toe", "Spine": "abdomenLower", "Spine1": "abdomenUpper",
        "Spine2": "chestLower", "Spine3": "chestUpper", "Spine4": "chestUpper2", "Spine5": "chestUpper3",
        "Neck": "neckLower", "Neck1": "neckUpper", "Neck2": "neckUpper2", "Middle": "Mid"}
_CMU = {"Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "Spine3": "Spine2", "Spine4": "Spine3",
        "Spine5": "Spine4"}


def _named(names: str, pattern: str, fingers: str, sides: Sequence[str] = SIDES, numbers: dict[str, str] | None = None
           ) -> Callable[[str], str]:
    """Names of a tool: hips, head, spine and neck (with a place for their number), shoulder, arm, forearm, hand, thigh,
    shin, foot, toes and the five fingers, in this order."""
    hips, head, spine, neck, *rest = names.split()
    parts = {"Hips": hips, "Head": head, **{f"Spine{i or ''}": spine.format(i + 1) for i in range(6)},
             **{f"Neck{i or ''}": neck.format(i + 1) for i in range(3)}}
    keys = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase", *FINGERS)
    return _table(parts | dict(zip(keys, rest, strict=True)), pattern, fingers, sides, numbers)


def _rigify(key: str) -> str:
    """Rigify's deforming bones: three joints of the trunk, two of the neck and the head are all named spine."""
    places = {"Hips": "", "Spine": ".001", "Spine1": ".002", "Spine2": ".003", "Neck": ".004", "Neck1": ".005",
              "Head": ".006"}
    if key in places:
        return "DEF-spine" + places[key]
    return STYLES["blender"](key)


_JAPANESE = _named("センター 頭 上半身{} 首{} 肩 腕 ひじ 手首 足 ひざ 足首 つま先 親指 人指 中指 薬指 小指",
                   "{side}{part}", "{side}{finger}{place}", "左右")
_TOOLS = {
    "rigify": _rigify,
    "auto-rig": _named("root.x head.x spine_{:02d}.x neck_{:02d}.x shoulder arm_stretch forearm_stretch hand "
                       "thigh_stretch leg_stretch foot toes_01 thumb index middle ring pinky", "{part}.{side}",
                       "{finger}{place}.{side}", "lr"),
    "second life": _named("mPelvis mHead mSpine{} mNeck{} Collar Shoulder Elbow Wrist Hip Knee Ankle Foot Thumb Index "
                          "Middle Ring Pinky", "m{part}{side}", "mHand{finger}{place}{side}"),
    "source": _named("ValveBiped.Bip01_Pelvis ValveBiped.Bip01_Head1 ValveBiped.Bip01_Spine{} ValveBiped.Bip01_Neck{} "
                     "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0 0 1 2 3 4", "ValveBiped.Bip01_{side}_{part}",
                     "ValveBiped.Bip01_{side}_Finger{finger}{place}", "LR", {"1": "", "2": "1", "3": "2"}),
    "r15": _named("LowerTorso Head UpperTorso{} Neck{} Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes "
                  "Thumb Index Middle Ring Little", "{side}{part}", "{side}{finger}{place}"),
    "makehuman": _named("pelvis head spine{:02d} neck{:02d} clavicle upperarm01 lowerarm01 wrist upperleg01 lowerleg01 "
                        "foot toe1-1 1 2 3 4 5", "{part}.{side}", "finger{finger}-{place}.{side}", "LR"),
    "daz 9": _named("hip head spine{} neck{} shoulder upperarm forearm hand thigh shin foot toes thumb index mid ring "
                    "pinky", "{side}_{part}", "{side}_{finger}{place}", "lr"),
    "kaykit": _named("hips head spine{} neck{} shoulder upperarm lowerarm wrist upperleg lowerleg foot toes thumb "
                     "index middle ring pinky", "{part}.{side}", "{finger}{place}.{side}", "lr"),
    "quaternius": _named("Hips Head Torso{} Neck{} Shoulder UpperArm LowerArm Wrist UpperLeg LowerLeg Foot Toes Thumb "
                         "Index Middle Ring Pinky", "{part}{side}", "{finger}{place}{side}", "LR"),
    "unity": _named("Hips Head Spine{} Neck{} Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes Thumb Index "
                    "Middle Ring Pinky", "{side}_{part}", "{side}_{finger}{place}",
                    numbers={"1": "Proximal", "2": "Intermediate", "3": "Distal"}),
    "ethan": lambda key: "Ethan" + key,
}

STYLES: dict[str, Callable[[str], str]] = {
    "mixamo": _camel("mixamorig:"), "mixamo plain": _camel(), "mixamo 7": _camel("mixamorig7:"),
    "ready player me": _camel(), "trinity": _camel(), "beat": _camel(), "zeroeggs": _camel(), "ours": _camel(),
    "cmu": _table(_CMU, "{side}{part}", "{side}Hand{finger}{place}"),
    "soma": _table(_SOMA, "{side}{part}", "{side}Hand{finger}{place}"),
    **dict.fromkeys(("manny", "metahuman"), _named(
        "pelvis head spine_{:02d} neck_{:02d} clavicle upperarm lowerarm hand thigh calf foot ball thumb index middle "
        "ring pinky", "{part}_{side}", "{finger}_{place}_{side}", "lr",
        {"1": "01", "2": "02", "3": "03", "Meta": "metacarpal"})),
    "rocketbox": _table(_BIPED, "Bip01 {side} {part}", "Bip01 {side} Finger{finger}{place}", "LR",
                        {"1": "", "2": "1", "3": "2"}),
    "rocketbox _": lambda key: STYLES["rocketbox"](key).replace(" ", "_"),
    "smplx": _table(_SMPLX, "{side}_{part}", "{side}_{finger}{place}", ("left", "right")),
    "vrm": _table(_VRM, "J_Bip_{side}_{part}", "J_Bip_{side}_{finger}{place}", "LR"),
    "vrm table": lambda key: "",
    "cc": _table(_CC, "CC_Base_{side}_{part}", "CC_Base_{side}_{finger}{place}", "LR"),
    "daz": _table(_DAZ, "{side}{part}", "{side}{finger}{place}", "lr"),
    "blender": _named("hips head spine.{:03d} neck.{:03d} shoulder upper_arm forearm hand thigh shin foot toe thumb "
                      "index middle ring pinky", "DEF-{part}.{side}", "DEF-f_{finger}.0{place}.{side}", "LR"),
    "unknown": lambda key: "",
    **_TOOLS, "japanese": _JAPANESE,
}
"""Tool -> name of each of our joints there."""
_VRM_BONES = {"Shoulder": "Shoulder", "Arm": "UpperArm", "ForeArm": "LowerArm", "Hand": "Hand", "UpLeg": "UpperLeg",
              "Leg": "LowerLeg", "Foot": "Foot", "ToeBase": "Toes"}
POSES = ("T", "A", "down", "forward", "bent", "twisted")
def draw(seed: int, style: str | None = None, pose: str | None = None, stout: bool = False,
         size: float | None = None, arch: float = 0.0) -> Rig:
    """The rig of a seed; what is told is not drawn. arch: metres by which the knuckles of middle and ring finger lie
    above the plane of the others, at size 1."""
    rng = np.random.default_rng(seed)
    style = str(rng.choice(list(STYLES))) if style is None else style
    pose = str(rng.choice(POSES)) if pose is None else pose
    size = float(rng.choice([0.55, 0.7, 0.9, 1.0, 1.1, 1.25])) if size is None else size
    body = _Builder(rng, style, size, stout)
    body.arch = arch
    body.build()
    body.pose(pose)
    return body.finish(pose)


class _Builder:
    """Builds one rig, step by step."""

    def __init__(self, rng: np.random.Generator, style: str, size: float, stout: bool) -> None:
        self.rng, self.style, self.size, self.stout = rng, style, size, stout
        self.nodes: dict[str, _Node] = {}
        self.spine: list[str] = []
        self.neck: list[str] = []
        self._below: dict[str | None, list[str]] | None = None
        self.arch = 0.0

    def add(self, key: str, parent: str | None, place: Sequence[float], name: str | None = None) -> None:
        """A node at a place of the T-pose, metres."""
        assert key not in self.nodes
        told = STYLES[self.style](key) if name is None else name
        self.nodes[key] = _Node(key, parent, np.asarray(place, dtype=float), told)

    def build(self) -> None:
        """The T-pose."""
        rng, s = self.rng, self.size
        leg, arm, wide, hip = (float(rng.uniform(low, high)) for low, high in
                               ((0.85, 1.15), (0.88, 1.12), (0.85, 1.2), (0.8, 1.25)))
        child = s < 0.8
        trunk = float(rng.uniform(0.95, 1.1)) * (1.1 if child else 1.0)
        heights = np.array([0.42, 0.405]) * leg * s
        floor = 0.08 * s
        hips = np.array([0.0, floor + heights.sum() * 0.995 + 0.05 * s, 0.0])
        top = [None, "root"][int(rng.integers(2))]
        if top:
            self.add("root", None, [0.0, 0.0, 0.0], "root" if self.style != "unknown" else "")
        if self.style.startswith("rocketbox"):
            self.add("com", top, hips, "Bip01")
            top = "com"
        self.add("Hips", top, hips)
        fewest = 2 if self.style.startswith("rocketbox") else 1  # of its spine's joints the first carries the legs
        count = {"cmu": 3, "smplx": 3, "vrm": 3, "soma": 3, "beat": 4, "trinity": 4, "ours": 4, "zeroeggs": 4,
                 "manny": 5, "metahuman": 5, "mixamo": 3, "vrm table": 3, "rigify": 3}.get(
                     self.style, int(rng.integers(fewest, 6)))
        necks = {"cmu": 2, "smplx": 1, "vrm": 1, "vrm table": 1, "mixamo": 1, "soma": 2, "manny": 2, "metahuman": 2,
                 "beat": 2, "trinity": 2, "ours": 2, "zeroeggs": 2, "rigify": 2}.get(
                     self.style, int(rng.integers(1, 4)))
        chest = hips + np.array([0.0, 0.40, -0.02]) * trunk * s
        neck = chest + np.array([0.0, 0.13, 0.01]) * trunk * s
        head = neck + np.array([0.0, 0.08, 0.015]) * s
        above = "Hips"
        for i in range(count):
            key = f"Spine{i or ''}"
            self.add(key, above, hips + (chest - hips) * (0.15 + 0.85 * i / max(count - 1, 1)))
            self.spine.append(key)
            above = key
        trunk_top = above
        for i in range(necks):
            key = f"Neck{i or ''}"
            self.add(key, above, neck + (head - neck) * i / necks)
            self.neck.append(key)
            above = key
        self.add("Head", above, head)
        if rng.random() < 0.6:
            self.add("HeadEnd", "Head", head + np.array([0.0, 0.18, 0.0]) * s, "HeadTop_End")
            if self.style != "unknown":
                self.add("jaw", "Head", head + np.array([0.0, 0.02, 0.05]) * s, "jaw")
                self.add("LeftEye", "Head", head + np.array([0.03, 0.08, 0.08]) * s, "LeftEye")
                self.add("RightEye", "Head", head + np.array([-0.03, 0.08, 0.08]) * s, "RightEye")
        collar_on = self.neck[0] if self.style.startswith("rocketbox") or rng.random() < 0.15 else trunk_top
        leg_on = self.spine[0] if self.style.startswith("rocketbox") else "Hips"
        tips, meta = bool(rng.random() < 0.6), self.style in ("manny", "metahuman", "soma", "beat")
        fingers = self.style != "cmu" and rng.random() < 0.9
        thumb_turn = Rotation.from_euler("XYZ", rng.uniform(-12, 12, 3), degrees=True).as_matrix()
        helpers = bool(rng.random() < 0.5)
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            m = np.array([sign, 1.0, 1.0])
            self._arm(side, m, (chest + np.array([0.03, 0.09, 0.01]) * s * m, collar_on), (arm, wide), helpers)
            if fingers:
                self._hand(side, m, tips or self.style == "beat", meta, thumb_turn)
            elif self.style == "cmu":
                wrist = self.nodes[side + "Hand"].place
                self.add(side + "FingerBase", side + "Hand", wrist, side + "FingerBase")
                self.add(side + "HandIndex1x", side + "FingerBase", wrist + np.array([sign * 0.08, 0.0, 0.0]) * s,
                         side + "HandIndex1")
                self.add(side + "Thumbx", side + "Hand", wrist, side[0] + "Thumb")
            self._leg(side, m, hips, hip, heights, leg_on)

    def _arm(self, side: str, m: np.ndarray, collar: tuple[np.ndarray, str], build: tuple[float, float],
             helpers: bool) -> None:
        s, (arm, wide) = self.size, build
        place, on = collar
        if self.style in ("daz",) or self.rng.random() < 0.95:
            self.add(side + "Shoulder", on, place)
            on = side + "Shoulder"
        shoulder = place + np.array([0.14 * wide, 0.0, -0.02]) * s * m
        elbow = shoulder + np.array([0.28 * arm, 0.0, 0.0]) * s * m
        wrist = elbow + np.array([0.25 * arm, 0.0, 0.0]) * s * m
        self.add(side + "Arm", on, shoulder)
        above = side + "Arm"
        named = STYLES[self.style]
        if self.style == "daz":
            self.add(side + "ArmTwist", above, (shoulder + elbow) / 2, f"{side[0].lower()}ShldrTwist")
            above = side + "ArmTwist"
        elif self.style in ("manny", "metahuman", "cc") and helpers:
            for i, share in ((1, 0.0), (2, 0.5)):
                self.add(f"{side}ArmTwist{i}", above, shoulder + (elbow - shoulder) * share,
                         named(side + "Arm").replace("upperarm", f"upperarm_twist_0{i}").replace(
                             "Upperarm", f"UpperarmTwist0{i}"))
        self.add(side + "ForeArm", above, elbow)
        above = side + "ForeArm"
        if self.style in ("daz", "blender"):
            self.add(side + "ForeTwist", above, (wrist + elbow) / 2, f"{side[0].lower()}ForearmTwist"
                     if self.style == "daz" else f"DEF-forearm.{side[0]}.001")
            above = side + "ForeTwist"
        elif self.style in ("manny", "metahuman") and helpers:
            self.add(f"{side}ForeTwist", above, (wrist + elbow) / 2, f"lowerarm_twist_01_{side[0].lower()}")
            if self.style == "metahuman":
                self.add(f"{side}ForeFix", above, elbow, f"lowerarm_correctiveRoot_{side[0].lower()}")
        self.add(side + "Hand", above, wrist)

    def _hand(self, side: str, m: np.ndarray, tips: bool, meta: bool, thumb_turn: np.ndarray) -> None:
        from data_module.motion.skeletons import _LEFT_FINGERS

        s, wrist = self.size, self.nodes[side + "Hand"].place
        for finger, steps in _LEFT_FINGERS.items():
            place, above = wrist.copy(), side + "Hand"
            if meta and finger != "Thumb":
                base = np.array(steps[0]) * 0.3
                key = {"soma": "1", "beat": ""}.get(self.style, "Meta")
                if not (self.style == "beat" and finger in ("Thumb", "Middle")):
                    name = STYLES[self.style](f"{side}Hand{finger}{key}")
                    self.add(f"{side}Meta{finger}", above, wrist + base * s * m, name)
                    above = f"{side}Meta{finger}"
            for number, step in enumerate(steps[:3], start=1):
                vector = np.array(step)
                if finger == "Thumb" and number > 1:
                    vector = thumb_turn @ vector
                place = place + vector * s * m
                if number == 1 and finger in ("Middle", "Ring"):
                    place = place + np.array([0.0, self.arch, 0.0]) * s
                shifted = number + 1 if self.style == "soma" and finger != "Thumb" else number
                key = f"{side}Hand{finger}{number}"
                self.add(key, above, place, STYLES[self.style](f"{side}Hand{finger}{shifted}"))
                above = key
            if tips:
                named = STYLES[self.style](f"{side}Hand{finger}{'End' if self.style == 'soma' else 4}")
                if self.style not in ("rocketbox", "rocketbox _", "manny", "metahuman", "smplx"):
                    self.add(f"{side}Tip{finger}", above, place + np.array(steps[3]) * s * m, named)

    def _leg(self, side: str, m: np.ndarray, hips: np.ndarray, hip: float, heights: np.ndarray, on: str) -> None:
        s = self.size
        socket = hips + np.array([0.09 * hip, -0.05, 0.0]) * s * m
        if self.style == "cmu":
            self.add(side + "HipJoint", on, hips, side[0] + "HipJoint")
            on = side + "HipJoint"
        self.add(side + "UpLeg", on, socket)
        knee = socket - [0.0, heights[0], -0.01 * s]
        ankle = np.array([socket[0], 0.08 * s, socket[2] - 0.0])
        self.add(side + "Leg", side + "UpLeg", knee)
        self.add(side + "Foot", side + "Leg", ankle)
        turned = Rotation.from_euler("Y", float(m[0]) * 12.0, degrees=True).as_matrix()
        toe = ankle + turned @ (np.array([0.0, -0.06, 0.13]) * s)
        self.add(side + "ToeBase", side + "Foot", toe)
        if self.style in ("mixamo", "ready player me", "beat"):
            self.add(side + "ToeEnd", side + "ToeBase", toe + np.array([0.0, 0.0, 0.06]) * s,
                     STYLES[self.style](side + "Toe_End"))

    # ------------------------------------------------------------------------------------------------ the pose

    def pose(self, pose: str) -> None:
        """Turn limbs about their own joints, and roll bones where the pose is a twisted one."""
        rng = self.rng
        out, fore, bend = {
            "T": (0.0, 0.0, 0.0), "A": (45.0, 5.0, 8.0), "down": (82.0, 4.0, 10.0), "forward": (10.0, 75.0, 5.0),
            "bent": (60.0, 20.0, 80.0), "twisted": (35.0, 15.0, 30.0)}[pose]
        jitter = rng.uniform(-4, 4, 3)
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            def turn(axis: str, degrees: float, sign: float = sign) -> np.ndarray:
                return Rotation.from_euler(axis, degrees * (sign if axis in "YZ" else 1.0), degrees=True).as_matrix()

            arm = turn("Z", -out + jitter[0]) @ turn("Y", -fore + jitter[1])
            self._rotate(side + "Arm", arm)
            self._rotate(side + "ForeArm", arm @ turn("Y", -bend + jitter[2]))
            if pose == "twisted":
                for key in ("ForeArm", "Hand"):
                    along = self._place(side + "Hand") - self._place(side + "ForeArm")
                    roll = Rotation.from_rotvec(along / np.linalg.norm(along) * np.radians(
                        float(rng.uniform(-70, 70)))).as_matrix()
                    self._rotate(side + key, roll @ self.nodes[side + key].turn)
                self._rotate(side + "UpLeg", turn("Z", 8.0) @ turn("X", -6.0))
                self._rotate(side + "Leg", turn("Z", 8.0) @ turn("X", 4.0))
                self._rotate(side + "Foot", np.eye(3))
            curl = float(rng.uniform(0, 25)) if pose in ("A", "down", "twisted", "bent") else 0.0
            if side + "HandIndex1" in self.nodes:
                hand = self.nodes[side + "Hand"].turn
                for finger in FINGERS[1:]:
                    for place in (1, 2, 3):
                        self._rotate(f"{side}Hand{finger}{place}", hand @ turn("Z", -curl * place))

    def _under(self, key: str) -> list[str]:
        if self._below is None:
            self._below = {}
            for node in self.nodes.values():
                self._below.setdefault(node.parent, []).append(node.key)
        out = [key]
        for one in out:
            out += self._below.get(one, [])
        return out

    def _rotate(self, key: str, turn: np.ndarray) -> None:
        """Give a node and all under it a world turn of the pose."""
        for under in self._under(key):
            self.nodes[under].turn = turn

    def _place(self, key: str) -> np.ndarray:
        """Where a node is in the pose."""
        node = self.nodes[key]
        if node.parent is None:
            return node.place
        above = self.nodes[node.parent]
        return self._place(node.parent) + above.turn @ (node.place - above.place)

    # ------------------------------------------------------------------------------------------------ the file

    def finish(self, pose: str) -> Rig:
        """The tool's axes, units and rest rotations, twigs, and the character."""
        rng = self.rng
        kind = "bvh" if self.style in ("cmu", "beat", "trinity", "zeroeggs", "ours") and rng.random() < 0.6 else "glb"
        facing = Rotation.from_euler("Y", 180.0 if self.style == "vrm table" and rng.random() < 0.5 else 0.0,
                                     degrees=True).as_matrix()
        z_up = kind == "bvh" and rng.random() < 0.3
        to_file = (Rotation.from_euler("X", 90.0, degrees=True).as_matrix() if z_up else np.eye(3)) @ facing
        metres = float(rng.choice([1.0, 0.01, 0.001])) if kind == "bvh" else 1.0
        manner = str(rng.choice(["identity", "bone", "random"]))
        for node in self.nodes.values():
            node.axes = self._rest_axes(node, manner)
        armature = kind == "glb" and rng.random() < 0.6
        keys = self._order()
        names = [self.nodes[key].name for key in keys]
        if self.style in ("unknown", "vrm table"):
            names = [f"bone_{place:03d}" for place in range(len(keys))]
        world = np.zeros((len(keys), 4, 4))
        for place, key in enumerate(keys):
            node = self.nodes[key]
            world[place, :3, :3] = to_file @ node.turn @ node.axes
            world[place, :3, 3] = to_file @ self._place(key) / metres
            world[place, 3, 3] = 1.0
        parents = [keys.index(self.nodes[key].parent) if self.nodes[key].parent else -1 for key in keys]
        if armature:  # a node above all: turned, and a hundred times smaller
            above = np.eye(4)
            above[:3, :3] = Rotation.from_euler("X", -90.0, degrees=True).as_matrix() * 0.01
            world = np.concatenate([above[None], world * np.array([0.01, 0.01, 0.01, 1.0])[None, None, :]])
            names, parents, keys = ["Armature", *names], [-1, *(parent + 1 for parent in parents)], ["", *keys]
        return self._rig(pose, kind, (keys, names, parents), world, (facing.T if not z_up else to_file.T, metres))

    def _rest_axes(self, node: _Node, manner: str) -> np.ndarray:
        if manner == "identity" or not node.key:
            return np.eye(3)
        if manner == "random":
            return Rotation.random(random_state=int(self.rng.integers(1 << 30))).as_matrix()
        below = [other for other in self.nodes.values() if other.parent == node.key
                 and np.linalg.norm(other.place - node.place) > 1e-6]
        along = below[0].place - node.place if below else np.array([0.0, 1.0, 0.0])
        y = along / np.linalg.norm(along)
        x = np.cross(y, [0.0, 0.0, 1.0] if abs(y[2]) < 0.9 else [1.0, 0.0, 0.0])
        x = x / np.linalg.norm(x)
        return np.stack([x, y, np.cross(x, y)], axis=-1)

    def _order(self) -> list[str]:
        roots = [key for key, node in self.nodes.items() if node.parent is None]
        out: list[str] = []
        todo = roots[::-1]
        while todo:
            key = todo.pop()
            out.append(key)
            below = [other.key for other in self.nodes.values() if other.parent == key]
            self.rng.shuffle(below)
            todo += below
        return out

    def _flesh(self, torso: tuple[float, float], at: dict[str, int], space: tuple[np.ndarray, float]
               ) -> tuple[np.ndarray, np.ndarray]:
        """Points of an elliptic column from hips to neck, in the file's axes and units, and the node of each."""
        hips, neck = self._place("Hips"), self._place(self.neck[0])
        share, angle = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 1.0, 25), np.arange(40) * np.pi / 20))
        ring = np.stack([torso[0] * np.cos(angle), np.zeros_like(angle), torso[1] * np.sin(angle)], axis=-1)
        points = hips + share[:, None] * (neck - hips) + ring
        chain = ["Hips", *self.spine]
        movers = np.array([at[chain[int(value * (len(chain) - 1e-9))]] for value in share * 0.999])
        return points @ space[0] / space[1], movers

    def _rig(self, pose: str, kind: str, tree: tuple[list[str], list[str], list[int]], world: np.ndarray,
             space: tuple[np.ndarray, float]) -> Rig:
        keys, names, parents = tree
        n = len(keys)
        translations, rotations, scales = np.zeros((n, 3)), np.zeros((n, 4)), np.ones((n, 3))
        for node, parent in enumerate(parents):
            local = (np.linalg.inv(world[parent]) if parent >= 0 else np.eye(4)) @ world[node]
            scale = np.linalg.norm(local[:3, :3], axis=0)
            translations[node], scales[node] = local[:3, 3], scale
            rotations[node] = Rotation.from_matrix(local[:3, :3] / scale).as_quat(scalar_first=True)
        at = {key: place for place, key in enumerate(keys)}
        truth = {key: at[key] for key in self.nodes if _is_ours(key)}
        humanoid: dict[str, int] = {}
        if self.style == "vrm table":
            humanoid = _vrm_table(truth, [at[key] for key in self.spine], [at[key] for key in self.neck])
        kind_is_bvh = kind == "bvh"
        if kind_is_bvh:  # its rest has no rotations: the pose is in the offsets, or in the first frame
            straight = np.zeros((n, 4))
            straight[:, 0] = 1.0
            translations = np.array([world[node, :3, 3] - (world[parent, :3, 3] if parent >= 0 else 0.0)
                                     for node, parent in enumerate(parents)])
            rotations, scales = straight, np.ones((n, 3))
        skinned = np.array([bool(key) and key != "root" for key in keys])
        # What a mesh is like: a column around the trunk.
        torso = ((0.24, 0.25) if self.stout else (0.145, 0.115))
        torso = (torso[0] * self.size, torso[1] * self.size)
        flesh, movers = self._flesh(torso, at, space)
        character = Character(
            tuple(names), tuple(parents), translations, rotations, scales, Path(f"{self.style}.{kind}"), kind, skinned,
            humanoid=humanoid, vrm="1.0" if humanoid else "", unit=None if kind_is_bvh else 1.0,
            channels=tuple([("Zrotation", "Yrotation", "Xrotation")] * n) if kind_is_bvh else (),
            **({} if kind_is_bvh else {"flesh": flesh, "flesh_nodes": movers}))
        return Rig(character, truth, [at[key] for key in self.spine], [at[key] for key in self.neck], *space,
                   self.style, pose, self.size, torso)


def as_glb(rig: Rig, turned: dict[int, np.ndarray] | None = None, above: np.ndarray | None = None,
           mesh: np.ndarray | None = None, tubes: bool = False) -> bytes:
    """The rig as a GLB with a skin, its inverse bind matrices, a mesh of points and, where it has one, the VRM table.

    turned: node -> [4] local rotation, w first, that the file stands in, other than the pose of the inverse matrices.
    above: [4, 4] matrix of a node that holds all others. mesh: [4, 4] from the mesh's space to that node's. tubes: a
    mesh of triangles around trunk and limbs instead of points around the trunk.
    """
    character = rig.character
    joints = np.flatnonzero(character.skinned).tolist()
    mesh = np.eye(4) if mesh is None else mesh
    inverse = (np.linalg.inv(character.world_matrices()[joints]) @ mesh).transpose(0, 2, 1).astype("<f4")
    points, which, weights = (character.flesh, np.zeros((len(character.flesh), 4), "<u2"),
                              np.zeros((len(character.flesh), 4), "<f4"))
    weights[:, 0] = 1.0
    which[:, 0] = [joints.index(int(node)) for node in character.flesh_nodes]
    corners = np.zeros(0, "<u2")
    if tubes:
        points, which, weights, corners = _tubes(rig, joints)
    points = (points - mesh[:3, 3]) @ np.linalg.inv(mesh[:3, :3]).T
    parts: list[tuple[np.ndarray, str]] = [(inverse.reshape(-1, 16), "MAT4"), (points.astype("<f4"), "VEC3"),
                                           (which, "VEC4"), (weights, "VEC4")]
    parts += [(corners, "SCALAR")] if tubes else []
    nodes: list[dict[str, Any]] = []
    for node, name in enumerate(character.names):
        w, x, y, z = (turned or {}).get(node, character.rotations[node]).tolist()
        nodes.append({"name": name, "translation": character.translations[node].tolist(), "rotation": [x, y, z, w],
                      "scale": character.scales[node].tolist()})
        below = [child for child, parent in enumerate(character.parents) if parent == node]
        nodes[-1] |= {"children": below} if below else {}
    nodes.append({"name": "mesh", "mesh": 0, "skin": 0, "matrix": mesh.T.ravel().tolist()})
    if above is not None:
        tops = [node for node, parent in enumerate(character.parents) if parent < 0]
        nodes.append({"name": "Scene", "matrix": above.T.ravel().tolist(), "children": [*tops, len(character)]})
    document: dict[str, Any] = {
        "asset": {"version": "2.0"}, "nodes": nodes, "skins": [{"joints": joints, "inverseBindMatrices": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1, "JOINTS_0": 2, "WEIGHTS_0": 3},
                                    **({"indices": 4} if tubes else {"mode": 0})}]}]}
    if character.humanoid:
        bones = {bone: {"node": node} for bone, node in character.humanoid.items()}
        document["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    return glb(*with_arrays(document, parts))


def _tubes(rig: Rig, joints: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points [V, 3], joints and weights [V, 4] and corners of triangles of tubes along trunk, arms and legs."""
    world = rig.character.world_matrices()[:, :3, 3]
    chains = [[rig.truth["Hips"], *rig.spine, *rig.neck, rig.truth["Head"]]]
    for side in SIDES:
        names = ("Arm", "ForeArm", "Hand", "HandMiddle1"), ("UpLeg", "Leg", "Foot", "ToeBase")
        chains += [[rig.truth[side + name] for name in limb if side + name in rig.truth] for limb in names]
    points, which, shares, corners = [], [], [], []
    for chain in chains:
        width = 0.04 * rig.size / rig.unit
        for place, (node, below) in enumerate(zip(chain, [*chain[1:], chain[-1]], strict=True)):
            way = world[below] - world[node] if below != node else world[node] - world[chain[place - 1]]
            x = np.cross(way, [0.3, 0.5, 0.8]) / np.linalg.norm(np.cross(way, [0.3, 0.5, 0.8])) * width
            y = np.cross(way, x) / np.linalg.norm(np.cross(way, x)) * width
            for step in range(4):
                first, before = len(points), chain[place - 1] if place and step == 0 else node
                points += [world[node] + way * step / 4 * (0.5 if below == node else 1.0) + a for a in (x, y, -x, -y)]
                which += [[joints.index(node), joints.index(before), 0, 0]] * 4
                shares += [[0.5, 0.5, 0.0, 0.0] if before != node else [1.0, 0.0, 0.0, 0.0]] * 4
                if place or step:
                    corners += [row for i in range(4) for row in (
                        first + i, first + (i + 1) % 4, first + i - 4, first + (i + 1) % 4, first + (i + 1) % 4 - 4,
                        first + i - 4)]
    return np.array(points), np.array(which, "<u2"), np.array(shares, "<f4"), np.array(corners, "<u2")


PLACES = ("as bound", "everywhere", "one limb", "hips turned", "turned", "leaning", "lying", "small", "large",
          "mirrored", "mesh in centimetres, Z up")
"""How a file may stand other than in the pose that its mesh was bound in, or place it."""


def placed(rig: Rig, place: str, rng: np.random.Generator, path: Path, tubes: bool = True) -> Rig:
    """The rig as it is read from a GLB that stands or is placed as one of `PLACES` says, and what is true of it."""
    above, mesh, turned = np.eye(4), np.eye(4), {}
    axes, bound = rig.axes, rig.character.world_matrices()
    if place in ("everywhere", "one limb", "hips turned"):
        turned = _posed(rig, place, rng)
    elif place in ("turned", "leaning", "lying"):
        turn = {"turned": Rotation.from_euler("Y", float(rng.uniform(-180, 180)), degrees=True),
                "leaning": Rotation.from_euler("X", float(rng.choice([-35, -20, 25, 40])), degrees=True),
                "lying": Rotation.from_euler(str(rng.choice(["X", "Z"])), float(rng.choice([-90, 90])), degrees=True)}[
                    place].as_matrix()
        above[:3, :3] = turn
        if place == "turned":
            axes, bound = axes @ turn.T, above @ bound
        elif place == "lying":  # set upright, facing as the format defines it
            bound[:, :3, :3] = axes @ bound[:, :3, :3]
            axes = np.eye(3)
    elif place in ("small", "large"):
        above[:3, :3] *= 0.01 if place == "small" else 100.0
    elif place == "mirrored":
        above[0, 0] = -1.0
        bound, axes = above @ bound, axes @ np.diag([-1.0, 1.0, 1.0]) * np.array([[-1.0], [1.0], [1.0]])
    elif place != "as bound":
        mesh[:3, :3] = Rotation.from_euler("X", -90.0, degrees=True).as_matrix() * 0.01
        if rng.random() < 0.5:
            turned = _posed(rig, "everywhere", rng)
    path.write_bytes(as_glb(rig, turned, above, mesh, tubes))
    return _read_again(rig, path, axes, bound, {"small": 100.0, "large": 0.01}.get(place, 1.0), place == "mirrored")


def _posed(rig: Rig, place: str, rng: np.random.Generator) -> dict[int, np.ndarray]:
    """Node -> local rotation of another pose: of all joints, of those of one arm, or of the hips."""
    most = {"Arm": 70, "ForeArm": 60, "Hand": 30, "UpLeg": 35, "Leg": 40, "Foot": 20}
    joints = rig.truth | {f"Spine{i}": node for i, node in enumerate([*rig.spine, *rig.neck])}
    if place != "everywhere":
        side = str(rng.choice(SIDES))
        kept = ("Hips",) if place == "hips turned" else tuple(side + part for part in ("Arm", "ForeArm", "Hand"))
        joints = {name: node for name, node in rig.truth.items() if name.startswith(kept)}
    out = {}
    for name, node in joints.items():
        largest = 90 if place == "hips turned" else most.get(_sided(name)[1], 12)
        turn = Rotation.from_rotvec(rng.uniform(-1, 1, 3) / np.sqrt(3) * np.radians(largest))
        out[node] = (Rotation.from_quat(rig.character.rotations[node], scalar_first=True) * turn).as_quat(
            scalar_first=True)
    return out


def _read_again(rig: Rig, path: Path, axes: np.ndarray, bound: np.ndarray, unit: float, swapped: bool) -> Rig:
    """The rig with the character of the file, its nodes in the order in which they are read."""
    from gesticulator.characters.reading import read_character

    character = read_character(path)
    at = {number: node for node, number in enumerate(character.node_ids)}
    other = {"Left": "Right", "Right": "Left"} if swapped else {side: side for side in SIDES}
    truth = {other.get(_sided(name)[0], "") + _sided(name)[1]: at[node] for name, node in rig.truth.items()}
    whole = character.world_matrices()
    for node in range(len(rig.character)):
        whole[at[node]] = bound[node]
    return Rig(character, truth, [at[node] for node in rig.spine], [at[node] for node in rig.neck], axes, unit,
               rig.style, rig.pose, rig.size, rig.torso, whole)


def _is_ours(key: str) -> bool:
    from data_module.motion.joint_map import SINGLE

    return key in SINGLE


def _vrm_table(truth: dict[str, int], spine: list[int], neck: list[int]) -> dict[str, int]:
    out = {"hips": truth["Hips"], "head": truth["Head"], "neck": neck[0]}
    out |= dict(zip(("spine", "chest", "upperChest"), spine, strict=False))
    for side in SIDES:
        out |= {side.lower() + bone: truth[side + part] for part, bone in _VRM_BONES.items() if side + part in truth}
        for finger in FINGERS:
            kinds = ("Metacarpal", "Proximal", "Distal") if finger == "Thumb" else (
                "Proximal", "Intermediate", "Distal")
            theirs = "Little" if finger == "Pinky" else finger
            out |= {f"{side.lower()}{theirs}{kind}": truth[f"{side}Hand{finger}{place}"]
                    for place, kind in enumerate(kinds, start=1) if f"{side}Hand{finger}{place}" in truth}
    return out
