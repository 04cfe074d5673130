"""The character, the joint names of other sources, and retargeting to the character.

It has three sizes, each with joints appended to the previous one: `CHARACTER`, the 16 upper-body joints of the papers
including the rotational root (RG 4.1.1; names as in the Trinity data set); `FINGERED`, 46 with three joints of each
finger; `WHOLE_BODY`, 54 with the legs, which is stored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from data_module.errors import InputError, shown
from data_module.motion import kinematics, rotation
from data_module.types import Array, Motion, Skeleton

__all__ = ["CHARACTER", "CHARACTERS", "FINGERED", "WHOLE_BODY", "from_vector", "to_character"]

SIDES = ("Left", "Right")
"""With which the names of joints of arms, hands and legs begin."""

# Name, parent, offset in metres at rest: a standing adult with level arms (T-pose) and a 25 cm forearm.
_CHARACTER = [
    ("Hips", None, (0.0, 0.0, 0.0)),
    ("Spine", "Hips", (0.0, 0.070, -0.015)),
    ("Spine1", "Spine", (0.0, 0.115, -0.012)),
    ("Spine2", "Spine1", (0.0, 0.115, -0.003)),
    ("Spine3", "Spine2", (0.0, 0.100, 0.005)),
    ("Neck", "Spine3", (0.0, 0.135, 0.005)),
    ("Neck1", "Neck", (0.0, 0.040, 0.008)),
    ("Head", "Neck1", (0.0, 0.040, 0.008)),
    ("RightShoulder", "Spine3", (-0.030, 0.090, 0.020)),
    ("RightArm", "RightShoulder", (-0.150, 0.0, -0.030)),
    ("RightForeArm", "RightArm", (-0.280, 0.0, 0.0)),
    ("RightHand", "RightForeArm", (-0.250, 0.0, 0.0)),
    ("LeftShoulder", "Spine3", (0.030, 0.090, 0.020)),
    ("LeftArm", "LeftShoulder", (0.150, 0.0, -0.030)),
    ("LeftForeArm", "LeftArm", (0.280, 0.0, 0.0)),
    ("LeftHand", "LeftForeArm", (0.250, 0.0, 0.0)),
]
_TIPS = {"Head": (0.0, 0.17, 0.02), "RightHand": (-0.16, 0.0, 0.0), "LeftHand": (0.16, 0.0, 0.0)}

FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")
# The left hand at rest, palm down and fingers straight: each finger's first joint from the wrist, its two other joints
# from the one before, and its tip. An adult's hand, 17 cm from the wrist to the tip of the middle finger.
_LEFT_FINGERS = {
    "Thumb": ((0.030, -0.010, 0.028), (0.030, -0.008, 0.022), (0.027, -0.004, 0.013), (0.022, -0.003, 0.009)),
    "Index": ((0.084, 0.002, 0.024), (0.039, 0.0, 0.001), (0.024, 0.0, 0.0), (0.019, 0.0, 0.0)),
    "Middle": ((0.086, 0.004, 0.003), (0.043, 0.0, 0.0), (0.027, 0.0, 0.0), (0.020, 0.0, 0.0)),
    "Ring": ((0.081, 0.002, -0.016), (0.039, 0.0, -0.001), (0.025, 0.0, 0.0), (0.019, 0.0, 0.0)),
    "Pinky": ((0.074, -0.003, -0.034), (0.031, 0.0, -0.002), (0.019, 0.0, 0.0), (0.016, 0.0, 0.0)),
}
# The left leg: 82.5 cm from its socket to the ankle, so that a standing character's knees bend a little.
_LEFT_LEG = (("UpLeg", "Hips", (0.090, -0.050, 0.0)), ("Leg", "LeftUpLeg", (0.0, -0.420, 0.0)),
             ("Foot", "LeftLeg", (0.0, -0.405, 0.0)), ("ToeBase", "LeftFoot", (0.0, -0.060, 0.130)))
_TOE = (0.0, 0.0, 0.070)
_SIDES = ("Right", "Left")
LEG_JOINTS = tuple(side + part for side in _SIDES for part, _, _ in _LEFT_LEG)
FINGER_JOINTS = tuple(f"{side}Hand{finger}{place}" for side in _SIDES for finger in FINGERS for place in (1, 2, 3))


def _mirror(offset: tuple[float, float, float], side: str) -> tuple[float, float, float]:
    return (-offset[0] if side == "Right" else offset[0], *offset[1:])


def _build(fingers: bool, legs: bool) -> Skeleton:
    rows: list[tuple[str, str | None, tuple[float, float, float]]] = list(_CHARACTER)
    tips = dict(_TIPS)
    if fingers:
        tips = {name: tip for name, tip in tips.items() if not name.endswith("Hand")}
        for side in _SIDES:
            for finger, (*places, tip) in _LEFT_FINGERS.items():
                above = side + "Hand"
                for number, place in enumerate(places, start=1):
                    name = f"{side}Hand{finger}{number}"
                    rows.append((name, above, _mirror(place, side)))
                    above = name
                tips[above] = _mirror(tip, side)
    if legs:
        for side in _SIDES:
            rows += [(side + part, above.replace("Left", side), _mirror(place, side))
                     for part, above, place in _LEFT_LEG]
            tips[side + "ToeBase"] = _TOE
    names = tuple(row[0] for row in rows)
    parents = tuple(-1 if row[1] is None else names.index(row[1]) for row in rows)
    return Skeleton(names, parents, np.array([row[2] for row in rows]),
                    {names.index(name): np.array(tip) for name, tip in tips.items()})


CHARACTER: Skeleton = _build(fingers=False, legs=False)
FINGERED: Skeleton = _build(fingers=True, legs=False)
WHOLE_BODY: Skeleton = _build(fingers=True, legs=True)
CHARACTERS: dict[int, Skeleton] = {len(skeleton): skeleton for skeleton in (CHARACTER, FINGERED, WHOLE_BODY)}
"""The sizes of the character by the number of joints."""
JOINTS = CHARACTER.names
HIP_HEIGHT = 0.95
"""Height of the root over the floor of a standing character, metres."""

# One row per source: joint of the character -> its name there, without joints that a source lacks.
_TRINITY = {name: name for name in WHOLE_BODY.names}


def _sided(pattern: str, arms: Sequence[str], legs: Sequence[str] = (), fingers: str = "",
           naming: tuple[Sequence[str], Sequence[str], Sequence[str]] = (_SIDES, FINGERS, "123")) -> dict[str, str]:
    """A table of the joints on both sides. pattern: of arms and legs; fingers: pattern of their joints ("" for none);
    naming: the source's names of the right and the left side, of the five fingers from the thumb on, and of the joints
    of a finger from the palm on."""
    sides, names, places = naming
    out: dict[str, str] = {}
    for side, word in zip(_SIDES, sides, strict=True):
        out |= {side + joint: pattern.format(side=word, part=part)
                for joint, part in zip(("Shoulder", "Arm", "ForeArm", "Hand"), arms, strict=True)}
        out |= {side + joint: pattern.format(side=word, part=part)
                for (joint, _, _), part in zip(_LEFT_LEG, legs, strict=False)}
        if fingers:
            out |= {f"{side}Hand{finger}{place + 1}": fingers.format(side=word, finger=name, place=number)
                    for finger, name in zip(FINGERS, names, strict=True) for place, number in enumerate(places)}
    return out


_LIMBS = (("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "ToeBase"))
NAME_TABLES: dict[str, dict[str, str]] = {
    "trinity": _TRINITY,  # also BEAT, ZeroEGGS and MOCCA
    "smartbody": {joint: name for joint, name in _TRINITY.items() if joint != "Spine3"},
    "mixamo": {"Hips": "Hips", "Spine": "Spine", "Spine1": "Spine1", "Spine2": "Spine2", "Neck": "Neck",
               "Head": "Head", **_sided("{side}{part}", *_LIMBS, fingers="{side}Hand{finger}{place}")},
    # The fingers and thumbs in CMU's files are single joints that were not measured.
    "cmu": {"Hips": "Hips", "Spine": "LowerBack", "Spine1": "Spine", "Spine2": "Spine1", "Neck": "Neck",
            "Neck1": "Neck1", "Head": "Head", **_sided("{side}{part}", *_LIMBS)},
    "rocketbox": {"Hips": "Bip01_Pelvis", "Spine": "Bip01_Spine", "Spine1": "Bip01_Spine1", "Spine2": "Bip01_Spine2",
                  "Neck": "Bip01_Neck", "Head": "Bip01_Head",
                  **_sided("Bip01_{side}_{part}", ("Clavicle", "UpperArm", "Forearm", "Hand"),
                           ("Thigh", "Calf", "Foot", "Toe0"), "Bip01_{side}_Finger{finger}{place}",
                           ("RL", "01234", ("", "1", "2")))},
    "smplx": {"Hips": "pelvis", "Spine": "spine1", "Spine1": "spine2", "Spine2": "spine3", "Neck": "neck",
              "Head": "head", **_sided("{side}_{part}", ("collar", "shoulder", "elbow", "wrist"),
                                       ("hip", "knee", "ankle", "foot"), "{side}_{finger}{place}",
                                       (("right", "left"), ("thumb", "index", "middle", "ring", "pinky"), "123"))},
    "unreal": {"Hips": "pelvis", "Spine": "spine_01", "Spine1": "spine_02", "Spine2": "spine_03", "Neck": "neck_01",
               "Head": "head", **_sided("{part}_{side}", ("clavicle", "upperarm", "lowerarm", "hand"),
                                        ("thigh", "calf", "foot", "ball"), "{finger}_0{place}_{side}",
                                        ("rl", ("thumb", "index", "middle", "ring", "pinky"), "123"))},
    "unity": {"Hips": "Hips", "Spine": "Spine", "Spine1": "Chest", "Spine2": "UpperChest", "Neck": "Neck",
              "Head": "Head", **_sided("{side}{part}", ("Shoulder", "UpperArm", "LowerArm", "Hand"),
                                       ("UpperLeg", "LowerLeg", "Foot", "Toes"), "{side}{finger}{place}",
                                       (_SIDES, ("Thumb", "Index", "Middle", "Ring", "Little"),
                                        ("Proximal", "Intermediate", "Distal")))},
    "vrm": {"Hips": "J_Bip_C_Hips", "Spine": "J_Bip_C_Spine", "Spine1": "J_Bip_C_Chest",
            "Spine2": "J_Bip_C_UpperChest", "Neck": "J_Bip_C_Neck", "Head": "J_Bip_C_Head",
            **_sided("J_Bip_{side}_{part}", ("Shoulder", "UpperArm", "LowerArm", "Hand"),
                     ("UpperLeg", "LowerLeg", "Foot", "ToeBase"), "J_Bip_{side}_{finger}{place}",
                     ("RL", ("Thumb", "Index", "Middle", "Ring", "Little"), "123"))},
    # Talking With Hands as the GENEA challenges gave it. Twist joints lie between the joints of an arm, and thumb0, a
    # bone of the wrist, before the thumb's three joints.
    "genea": {"Hips": "b_root", **{f"Spine{place or ''}": f"b_spine{place}" for place in range(4)},
              "Neck": "b_neck0", "Head": "b_head",
              **_sided("b_{side}_{part}", ("shoulder", "arm", "forearm", "wrist"), ("upleg", "leg", "foot"),
                       "b_{side}_{finger}{place}", ("rl", ("thumb", "index", "middle", "ring", "pinky"), "123"))},
}
"""The names of the character's joints in each family of skeletons; prefixes up to a colon ("mixamorig:") are ignored,
and a space in a name is the same as "_"."""

REQUIRED = ("Hips", "Spine", "Neck", "Head",
            *(side + part for side in _SIDES for part in ("Arm", "ForeArm", "Hand")))
"""The joints that every source must have; the others may be absent."""


def find_table(names: Sequence[str], given: Mapping[str, str] | None = None) -> Mapping[str, int]:
    """Joints of `WHOLE_BODY` -> index in `names`, by the table with the most joints of `CHARACTER` (and among
    equals the most fingers and legs); InputError if none covers `REQUIRED`. given: the user's own table
    (`data_module.motion.joint_map`) in place of all; InputError if `names` lacks one of its joints."""
    if given is not None:
        lacking = [theirs for theirs in given.values() if theirs not in names]
        if lacking:
            raise InputError("skeleton", f"has no joint {shown(', '.join(lacking), 100)}, which --joints names",
                             "correct that file")
        return {joint: names.index(theirs) for joint, theirs in given.items()}
    # Reversed, so that of two equal names the first counts.
    plain = {name.rsplit(":", 1)[-1].replace(" ", "_").lower(): index
             for index, name in reversed(list(enumerate(names)))}
    best: dict[str, int] = {}
    most = (0, 0)
    for table in NAME_TABLES.values():
        matches = {joint: plain[name.lower()] for joint, name in table.items() if name.lower() in plain}
        fit = (sum(joint in matches for joint in JOINTS), len(matches))
        if fit > most:
            best, most = matches, fit
    lacking = [joint for joint in REQUIRED if joint not in best]
    if lacking:
        unknown = [name for index, name in enumerate(names) if index not in best.values()]
        raise InputError("skeleton", f"has no joint known as {', '.join(lacking)}; its unknown names are "
                         f"{shown(', '.join(unknown), 100) or 'none'}",
                         "rename them, or name them in a file for build --joints")
    return best


def guess_unit(skeleton: Skeleton, table: Mapping[str, int]) -> float:
    """Metres per unit of the skeleton's offsets: 1, 0.01 or 0.001, for a distance from hips to head nearest to 0.6
    m."""
    ancestors, joint = [], table["Head"]
    while joint > 0 and joint != table["Hips"]:
        ancestors.append(joint)
        joint = skeleton.parents[joint]
    length = float(np.linalg.norm(skeleton.offsets[ancestors], axis=1).sum())
    if length <= 0:
        raise InputError("skeleton", "has no length from hips to head", "check its offsets")
    # Compared as logarithms, because units differ by factors.
    return min((1.0, 0.01, 0.001), key=lambda unit: abs(np.log(length * unit / 0.6)))


def scaled(motion: Motion, unit: float) -> Motion:
    """The motion with all lengths multiplied by `unit` (metres per unit)."""
    return replace(motion, skeleton=scaled_skeleton(motion.skeleton, unit),
                   root_positions=motion.root_positions * unit)


def scaled_skeleton(skeleton: Skeleton, unit: float) -> Skeleton:
    return replace(skeleton, offsets=skeleton.offsets * unit,
                   end_sites={joint: tip * unit for joint, tip in skeleton.end_sites.items()})


# Least distance of two joints, metres.
_EPS = 1e-9
_NEEDED_BONES = (("Hips", "Head"), ("RightArm", "LeftArm"), *((side + bone, side + tip) for side in _SIDES
                 for bone, tip in (("Arm", "ForeArm"), ("ForeArm", "Hand"))))


def rest_positions(skeleton: Skeleton) -> Array:
    """[J, 3] metres: the joints of the rest pose."""
    return kinematics.joint_positions(skeleton, np.tile([1.0, 0.0, 0.0, 0.0], (len(skeleton), 1)))


def nearest_axis(vector: Array) -> Array:
    """[3] the axis that a vector points along most."""
    axis = np.zeros(3)
    axis[np.argmax(np.abs(vector))] = np.sign(vector[np.argmax(np.abs(vector))])
    return axis


def axes_of(rest: Array, table: Mapping[str, int]) -> Array:
    """[4] the rotation from a source's axes to the character's (Y up, left +X), from its rest pose."""
    # Snapped to the nearest axis: rest poses lean a little, but files swap whole axes.
    up = nearest_axis(rest[table["Head"]] - rest[table["Hips"]])
    across = rest[table["LeftArm"]] - rest[table["RightArm"]]
    across = across - (across @ up) * up
    if np.linalg.norm(across) < _EPS:
        raise InputError("skeleton", "has one arm above the other", "check its offsets")
    left = nearest_axis(across)
    matrix = np.stack([left, up, np.cross(left, up)])
    return rotation.from_matrix(matrix)


def to_character(motion: Motion, table: Mapping[str, int] | None = None, skeleton: Skeleton = CHARACTER) -> Motion:
    """Retarget any upper body to the character by copying world rotations (RG 4.1.1).

    Each bone's world rotation relative to its rest is copied. For arms and fingers the shortest rotation between the
    source's rest bone and the character's is compensated, so that A-pose and T-pose agree. A joint that the source
    lacks follows its parent and is listed in `absent`. The position of the root is unchanged, in metres.

    skeleton: `CHARACTER`, `FINGERED` or `WHOLE_BODY`.
    """
    source, table = motion.skeleton, table or find_table(motion.skeleton.names)
    rest = rest_positions(source)
    for bone, tip in _NEEDED_BONES:
        if np.linalg.norm(rest[table[tip]] - rest[table[bone]]) < _EPS:
            raise InputError("skeleton", f"has {bone} and {tip} in one place", "check its offsets")
    change = axes_of(rest, table)
    world = kinematics.global_rotations(source, motion.rotations)
    frames = len(motion)
    out = np.zeros((frames, len(skeleton), 4))
    out[..., 0] = 1.0
    corrections = _corrections(source, rest, table, change, skeleton)
    for joint, name in enumerate(skeleton.names):
        if name in table:
            # Conjugation expresses the same turn in the character's axes.
            turned = rotation.multiply(rotation.multiply(change, world[:, table[name]]), rotation.conjugate(change))
            out[:, joint] = rotation.multiply(turned, corrections[name]) if name in corrections else turned
        else:
            out[:, joint] = out[:, skeleton.parents[joint]]
    local = rotation.normalise(kinematics.local_rotations(skeleton, out))
    local = rotation.continuous(local)
    root = rotation.rotate(change, kinematics.positions_of(motion)[:, table["Hips"]])
    gone, filled = ({name for name in skeleton.names if name in table and source.names[table[name]] in listed}
                    for listed in (motion.absent, motion.filled))
    return Motion(skeleton, local, root, motion.fps,
                  tuple(name for name in skeleton.names if name not in table or name in gone),
                  tuple(name for name in skeleton.names if name in filled))


def _corrections(source: Skeleton, rest: Array, table: Mapping[str, int], change: Array, skeleton: Skeleton
                 ) -> dict[str, Array]:
    """Joint -> [4] the rotation from the character's rest bone to the source's; rest: [J, 3] the source's joints."""
    target_rest = rest_positions(skeleton)
    out: dict[str, Array] = {}
    for side in _SIDES:
        for bone, tip in (("Arm", "ForeArm"), ("ForeArm", "Hand")):
            wanted = rotation.rotate(change, rest[table[side + tip]] - rest[table[side + bone]])
            resting = target_rest[skeleton.index(side + tip)] - target_rest[skeleton.index(side + bone)]
            out[side + bone] = rotation.between(resting, wanted)
        out[side + "Hand"] = out[side + "ForeArm"]
    for name in FINGER_JOINTS:
        if name not in skeleton.names or name not in table:
            continue
        below = name[:-1] + str(int(name[-1]) + 1)
        way = rest[table[below]] - rest[table[name]] if below in table else source.end_sites.get(table[name])
        if way is None or np.linalg.norm(way) < _EPS:
            # The last bone of a finger with unknown tip is parallel to the previous one.
            before = name[:-1] + str(int(name[-1]) - 1)
            out[name] = out.get(before, out[name[:name.index("Hand") + 4]])
            continue
        resting = skeleton.offsets[skeleton.index(below)] if below in skeleton.names \
            else skeleton.end_sites[skeleton.index(name)]
        # Relative to the correction of the hand: the shortest rotation from a T-pose could roll the finger.
        hand = out[name[:name.index("Hand") + 4]]
        straightened = rotation.between(rotation.rotate(hand, resting), rotation.rotate(change, way))
        out[name] = rotation.multiply(straightened, hand)
    return out


def resized(motion: Motion, skeleton: Skeleton) -> Motion:
    """Convert a motion between sizes of the character: joints at the end are removed, or added at rest and listed in
    `absent`. ValueError for another skeleton."""
    there, wanted = len(motion.skeleton), len(skeleton)
    least = min(there, wanted)
    if motion.skeleton.names[:least] != skeleton.names[:least] \
            or motion.skeleton.parents[:least] != skeleton.parents[:least]:
        raise ValueError(f"the motion is not on the {wanted}-joint character")
    if there == wanted:
        return motion
    rotations = np.zeros((len(motion), wanted, 4))
    rotations[..., 0] = 1.0
    rotations[:, :least] = motion.rotations[:, :least]
    absent = (*(name for name in motion.absent if name in skeleton.names), *skeleton.names[there:])
    filled = tuple(name for name in motion.filled if name in skeleton.names)
    return Motion(skeleton, rotations, motion.root_positions, motion.fps, absent, filled)


def upper_body(motion: Motion) -> Motion:
    """The 16 joints of a motion of the character of any size; other motions are returned unchanged."""
    known = CHARACTERS.get(len(motion.skeleton))
    return resized(motion, CHARACTER) if known is not None and motion.skeleton.same_joints(known) else motion


def facing(motion: Motion) -> Motion:
    """The motion in its own facing frame: yaw of the root removed, the root at the origin (RG 4.1.1)."""
    rotations = motion.rotations.copy()
    rotations[:, 0] = rotation.remove_yaw(rotations[:, 0])
    return replace(motion, rotations=rotations, root_positions=np.zeros_like(motion.root_positions))


def has_legs(motion: Motion) -> bool:
    """Whether both legs are known or synthesised."""
    return all(name in motion.skeleton.names and name not in motion.absent for name in LEG_JOINTS)


def standing(motion: Motion) -> Motion:
    """The motion raised or lowered so that the median height of the root is `HIP_HEIGHT`, because models have the root
    at the origin and viewers the floor at zero. A motion with legs is returned unchanged."""
    if has_legs(motion):
        return motion
    lift = np.array([0.0, HIP_HEIGHT - float(np.median(motion.root_positions[:, 1])), 0.0])
    return replace(motion, root_positions=motion.root_positions + lift)


def from_vector(vectors: Array, fps: float) -> Motion:
    """A motion of the character from exponential maps [T, J * 3], without yaw and translation."""
    skeleton = CHARACTERS[vectors.shape[-1] // 3]
    frames = len(vectors)
    rotations = rotation.continuous(rotation.from_exponential_map(vectors.reshape(frames, len(skeleton), 3)))
    return Motion(skeleton, rotations, np.zeros((frames, 3)), fps)
