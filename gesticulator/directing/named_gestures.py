"""Named gestures, such as a wave, a shrug or a nod: procedural, and blended over the generated motion.

The lexicon has movements without meanings; no lexeme is a wave. So each gesture of `plan.GESTURES` is a short script:
positions of the hands (relative to the shoulders, in the frame of the chest), directions of the palms, bends of the
fingers, and rotations added to shoulders, neck and head. Two-bone inverse kinematics turns it into poses, and an
envelope blends them in and out along the shortest rotation, so that there is no jump. The stroke arrives at the cue's
time.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTERS, FINGER_JOINTS
from data_module.types import Array
from gesticulator.body.mirror import exchanged_joints
from gesticulator.directing.shaping import nearest_turn
from gesticulator.plan.plan import GestureCue

Vector = tuple[float, float, float]
_RISE, _FALL = 0.55, 0.7
"""Seconds in which a gesture is blended in before its stroke, and out after its hold."""
_NOD_RISE, _NOD_FALL = 0.2, 0.3
"""The same for gestures of the head alone."""
_STRETCHED = 0.97
"""Greatest distance of a hand from the shoulder, as a share of the arm's length: an elbow that locks would jump."""
_PRONATES = 0.6
"""Share of the hand's twist that the forearm takes over, as pronation does in a human forearm."""
_MOST_BEND = math.radians(60.0)
"""Greatest bend of the wrist, radians."""
_ELBOW = {"Left": np.array([0.45, -1.0, -0.25]), "Right": np.array([-0.45, -1.0, -0.25])}
"""Direction in which the elbow points: down, a little outwards and back."""
_CURL = {"Thumb": (8.0, 12.0, 12.0), "Index": (62.0, 80.0, 45.0), "Middle": (66.0, 84.0, 48.0),
         "Ring": (68.0, 84.0, 48.0), "Pinky": (68.0, 82.0, 46.0)}
"""Bends of the joints of a closed finger, degrees."""


@dataclass(frozen=True)
class HandScript:
    """Pose of a hand at the stroke. All directions are (outwards from the body's middle, up, forward).

    place: metres from the shoulder. fingers: direction in which they point; palm: direction in which it faces. curl: of
    thumb, index and the other fingers, 0 open to 1 closed. swing: amplitude to both sides, metres, at `rate` hertz.
    """

    place: Vector
    fingers: Vector
    palm: Vector
    curl: Vector = (0.1, 0.1, 0.15)
    swing: float = 0.0
    rate: float = 2.0


@dataclass(frozen=True)
class GestureScript:
    """A gesture. hands: side -> pose; adds: joint -> rotation to add, an exponential map in degrees; shakes: joint ->
    amplitude of its oscillation, the same, at `rate` hertz; hold: seconds after the stroke."""

    hands: Mapping[str, HandScript] = field(default_factory=dict)
    adds: Mapping[str, Vector] = field(default_factory=dict)
    shakes: Mapping[str, Vector] = field(default_factory=dict)
    rate: float = 1.6
    hold: float = 0.45


_BACKHAND = HandScript((0.40, 0.0, 0.22), (0.86, 0.05, 0.5), (0.0, -1.0, 0.1), (0.5, 0.0, 0.95))
_OPEN = HandScript((0.10, -0.24, 0.33), (0.45, 0.1, 0.9), (0.1, 1.0, -0.1))
_SHRUGGED = HandScript((0.20, -0.25, 0.22), (0.8, 0.1, 0.6), (0.1, 1.0, 0.1))
SCRIPTS: dict[str, GestureScript] = {
    "wave": GestureScript({"Right": HandScript((0.20, 0.12, 0.20), (0.0, 1.0, 0.05), (0.0, 0.0, 1.0), swing=0.085)},
                          hold=1.3),
    "point left": GestureScript({"Left": _BACKHAND}, {"Neck": (0.0, 8.0, 0.0), "Head": (0.0, 10.0, 0.0)}),
    "point right": GestureScript({"Right": _BACKHAND}, {"Neck": (0.0, -8.0, 0.0), "Head": (0.0, -10.0, 0.0)}),
    "point ahead": GestureScript({"Right": HandScript((-0.02, -0.06, 0.46), (-0.05, 0.05, 1.0), (-0.3, -1.0, 0.0),
                                                      (0.5, 0.0, 0.95))}),
    "me": GestureScript({"Right": HandScript((-0.08, -0.20, 0.20), (-1.0, 0.15, 0.15), (-0.1, 0.0, -1.0))}, hold=0.6),
    "stop": GestureScript({"Right": HandScript((0.04, 0.0, 0.36), (0.0, 1.0, 0.15), (0.0, -0.1, 1.0))}, hold=0.6),
    "shrug": GestureScript({"Left": _SHRUGGED, "Right": _SHRUGGED},
                           {"LeftShoulder": (0.0, 0.0, 13.0), "RightShoulder": (0.0, 0.0, -13.0),
                            "Head": (0.0, 0.0, 7.0), "Neck": (0.0, 0.0, 4.0)}, hold=0.5),
    "open palms": GestureScript({"Left": _OPEN, "Right": _OPEN}, hold=0.6),
    "nod": GestureScript(shakes={"Neck": (6.0, 0.0, 0.0), "Head": (9.0, 0.0, 0.0)}, rate=1.9, hold=0.75),
    "shake head": GestureScript(shakes={"Neck": (0.0, 8.0, 0.0), "Head": (0.0, 12.0, 0.0)}, rate=1.5, hold=1.0),
}


def span_of_gesture(name: str) -> tuple[float, float]:
    """Seconds from the start of a gesture to its stroke, and from its stroke to its end."""
    script = SCRIPTS[name]
    return (_RISE, script.hold + _FALL) if script.hands else (_NOD_RISE, script.hold + _NOD_FALL)


def laid_over(poses: Array, times: Array, cues: Sequence[tuple[GestureCue, float]]) -> Array:
    """Poses [M, 3 J] (exponential maps, radians) at seconds [M], with each gesture blended in at its time; all other
    poses stay the same bit for bit."""
    out = poses.copy()
    for cue, at in cues:
        before, after = span_of_gesture(cue.gesture)
        near = np.flatnonzero((times > at - before) & (times < at + after))
        if len(near):
            out[near] = _with_gesture(out[near], times[near] - at, cue)
    return out


def _with_gesture(poses: Array, seconds: Array, cue: GestureCue) -> Array:
    """Poses [M, 3 J] with one gesture blended in; seconds: [M] relative to its stroke."""
    script = SCRIPTS[cue.gesture]
    before, after = span_of_gesture(cue.gesture)
    names = CHARACTERS[poses.shape[1] // 3].names
    size = min(cue.intensity, 1.0) if script.hands else cue.intensity
    weight = size * _smooth((seconds + before) / before) * _smooth((after - seconds) / (after - script.hold))
    targets = {name: turns for side, hand in script.hands.items()
               for name, turns in _hand_turns(side, hand, seconds, cue.intensity).items() if name in names}
    wave = np.sin(2.0 * np.pi * script.rate * np.clip(seconds + before, 0.0, None))
    added = {name: weight[:, None] * np.radians(vector) for name, vector in script.adds.items()}
    added |= {name: (weight * wave)[:, None] * np.radians(vector) for name, vector in script.shakes.items()}
    vectors = poses.reshape(len(poses), -1, 3).copy()
    flipped = exchanged_joints(names)
    flip = np.array([1.0, -1.0, -1.0])
    for name, turns in targets.items():
        joint = names.index(name)
        if cue.mirror:
            joint, turns = int(flipped[joint]), turns * flip
        vectors[:, joint] = _blended(vectors[:, joint], turns, weight)
    for name, vector in added.items():
        joint = names.index(name)
        if cue.mirror:
            joint, vector = int(flipped[joint]), vector * flip
        vectors[:, joint] += vector
    return vectors.reshape(poses.shape)


def _smooth(s: Array) -> Array:
    u: Array = np.clip(s, 0.0, 1.0)
    return u ** 3 * (10.0 - 15.0 * u + 6.0 * u * u)


def _blended(now: Array, target: Array, share: Array) -> Array:
    """[M, 3] rotations a share [M] of the way from `now` to `target`, along the shortest turn, as the exponential maps
    nearest to `now`."""
    begin = Rotation.from_rotvec(now)
    turn = (begin.inv() * Rotation.from_rotvec(target)).as_rotvec()
    return nearest_turn((begin * Rotation.from_rotvec(share[:, None] * turn)).as_rotvec(), now)


# ---------------------------------------------------------------------------------------------------- the arms

def _hand_turns(side: str, script: HandScript, seconds: Array, size: float) -> dict[str, Array]:
    """Joint -> [M, 3] exponential maps of an arm and its fingers for a script. seconds: [M] relative to the stroke;
    size: factor on the swing."""
    outwards = 1.0 if side == "Left" else -1.0
    flip = np.array([outwards, 1.0, 1.0])
    swing = script.swing * size * np.sin(2.0 * np.pi * script.rate * seconds)
    places = np.array(script.place) + swing[:, None] * np.array([1.0, 0.0, 0.0])
    # A waving hand tilts with its forearm.
    tilt = np.array(script.fingers) + 3.0 * swing[:, None] * np.array([1.0, 0.0, 0.0])
    arm, forearm, hand = _arm(side, places * flip, tilt * flip, np.broadcast_to(np.array(script.palm) * flip,
                                                                               places.shape))
    out = {f"{side}Arm": arm, f"{side}ForeArm": forearm, f"{side}Hand": hand}
    count = len(seconds)
    thumb, index, others = script.curl
    for name, axis, degrees in _finger_axes(side):
        share = thumb if "Thumb" in name else index if "Index" in name else others
        out[name] = np.repeat((math.radians(degrees * share) * axis)[None], count, axis=0)
    return out


def _arm(side: str, places: Array, fingers: Array, palms: Array) -> tuple[Array, Array, Array]:
    """Inverse kinematics of an arm: exponential maps [M, 3] of upper arm, forearm and hand that bring the wrist to
    `places` [M, 3], metres from the shoulder, with fingers and palm in the directions `fingers` and `palms` [M, 3] as
    far as the wrist bends. The chest is assumed upright."""
    skeleton = CHARACTERS[16]
    bone = np.array([1.0 if side == "Left" else -1.0, 0.0, 0.0])
    hinge = _hinge(side)
    upper, fore = (abs(float(skeleton.offsets[skeleton.index(side + part)][0])) for part in ("ForeArm", "Hand"))
    far = np.clip(np.linalg.norm(places, axis=-1, keepdims=True), 0.12, _STRETCHED * (upper + fore))
    along = places / np.linalg.norm(places, axis=-1, keepdims=True)
    share = (upper ** 2 + far ** 2 - fore ** 2) / (2.0 * far)
    aside = _ELBOW[side] - np.sum(_ELBOW[side] * along, axis=-1, keepdims=True) * along
    aside = aside / np.linalg.norm(aside, axis=-1, keepdims=True)
    elbow = share * along + np.sqrt(np.maximum(upper ** 2 - share ** 2, 1e-6)) * aside
    first, second = elbow / upper, (along * far - elbow) / fore
    axis = np.cross(first, second)
    axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-9)
    arm, forearm = _frames(bone, hinge, first, axis), _frames(bone, hinge, second, axis)
    fingers = fingers / np.linalg.norm(fingers, axis=-1, keepdims=True)
    palms = palms - np.sum(palms * fingers, axis=-1, keepdims=True) * fingers
    hand = _frames(bone, np.array([0.0, -1.0, 0.0]), fingers, palms / np.linalg.norm(palms, axis=-1, keepdims=True))
    wrist = forearm.inv() * hand
    quaternion = wrist.as_quat(scalar_first=True)
    twist = rotation.unroll(rotation.to_exponential_map(rotation.yaw_of(quaternion, axis=0)))
    turned = Rotation.from_rotvec(_PRONATES * twist)
    bend = Rotation.from_rotvec(twist).inv() * wrist  # the hand turns first, then bends
    left = (Rotation.from_rotvec((1.0 - _PRONATES) * twist) * _limited(bend)).as_rotvec()
    return arm.as_rotvec(), (arm.inv() * forearm * turned).as_rotvec(), left


def _limited(bend: Rotation) -> Rotation:
    """Bends of the wrist, limited to `_MOST_BEND`."""
    vectors = bend.as_rotvec()
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return Rotation.from_rotvec(vectors * np.minimum(1.0, _MOST_BEND / np.maximum(length, 1e-9)))


def _hinge(side: str) -> Array:
    """[3] axis of the elbow of a level arm: bending moves the forearm forward and a little up."""
    angle = math.radians(12.0)
    down = np.array([0.0, -math.cos(angle), -math.sin(angle)])
    return down if side == "Left" else -down


def _frames(rest_along: Array, rest_across: Array, along: Array, across: Array) -> Rotation:
    """Rotations that map the orthogonal unit vectors `rest_along` and `rest_across` to `along` and `across` [M, 3]."""
    now = np.stack([along, across, np.cross(along, across)], axis=-1)
    rest = np.stack([rest_along, rest_across, np.cross(rest_along, rest_across)], axis=-1)
    return Rotation.from_matrix(now @ rest.T)


@functools.cache
def _finger_axes(side: str) -> tuple[tuple[str, Array, float], ...]:
    """(joint of a finger, [3] its bending axis, its bend in a closed hand, degrees); at rest the palm faces down."""
    skeleton, out = CHARACTERS[46], []
    for name in FINGER_JOINTS:
        if name.startswith(side):
            finger, place = name[len(side) + 4:-1], int(name[-1]) - 1
            along = skeleton.offsets[skeleton.index(f"{side}Hand{finger}2")]
            sign = 1.0 if side == "Left" else -1.0
            goal = np.array([0.75 * sign, -0.55, -0.35]) if finger == "Thumb" else np.array([0.0, -1.0, 0.0])
            axis = np.cross(along, goal)
            out.append((name, axis / np.linalg.norm(axis), _CURL[finger][place]))
    return tuple(out)
