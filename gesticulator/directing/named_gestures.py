"""Named gestures, such as a wave, a shrug or a nod: scripts that are blended over the generated motion.

The lexicon has movements without meanings; no lexeme is a wave. So each gesture of the repertoire
(`gesticulator.plan.gestures`) is a script of key poses (`gesticulator.directing.gesture_phases`), which inverse
kinematics turns into poses of arms and fingers. An envelope blends them in and out along the shortest rotation, so that
there is no jump, and hands that would pass through the trunk are led around it. The apex is at the cue's time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTERS, FINGERS, SIDES
from data_module.types import Array, Motion
from gesticulator.body.clips import exchanged_joints
from gesticulator.contacts.columns import HEAD, TRUNK
from gesticulator.contacts.limbs import MARGIN, pose_of
from gesticulator.directing.gesture_phases import GestureDraw, drawn_gesture, hand_turns, longest
from gesticulator.directing.gesture_scripts import GestureScript
from gesticulator.plan.plan import GestureCue

_FLIP = np.array([1.0, -1.0, -1.0])
"""A reflection keeps the x component of an exponential map and negates y and z."""
_ARM = ("Arm", "ForeArm", "Hand")
_HEAD = ("Neck", "Neck1", "Head")
_TOUCH = 0.012
"""Metres from the trunk at which a hand that lies on it stays."""
_WHOLE = 0.5
"""Intensity from which on a gesture is made whole; below, it is blended in by so much less, and not at all at 0."""


def span_of_gesture(name: str) -> tuple[float, float]:
    """Seconds from the start of a gesture to its apex, and from its apex to its end, at most."""
    phases = longest(name)
    return phases.before, phases.after


def laid_over(poses: Array, times: Array, cues: Sequence[tuple[GestureCue, float]], seed: int = 0) -> Array:
    """Poses [M, 3 J] (exponential maps, radians) at seconds [M], with each gesture blended in at its time; all other
    poses stay the same bit for bit. seed: with another one, each gesture varies in another way."""
    # One after the other: a gesture that begins while another ends is blended over what that one left.
    out = poses.copy()
    for cue, at in cues:
        before, after = span_of_gesture(cue.gesture)
        near = np.flatnonzero((times > at - before) & (times < at + after))
        if len(near):
            out[near] = _with_gesture(out[near], times[near] - at, cue, drawn_gesture(cue, at, seed))
    return out


def _with_gesture(poses: Array, seconds: Array, cue: GestureCue, draw: GestureDraw) -> Array:
    """Poses [M, 3 J] with one gesture blended in; seconds: [M] relative to its apex."""
    weight = min(cue.intensity / _WHOLE, 1.0) * draw.phases.weight(seconds)
    script, flipped = draw.script, (draw.script.side == "Left") != cue.mirror
    names = CHARACTERS[poses.shape[1] // 3].names
    swapped = exchanged_joints(names)
    vectors = poses.reshape(len(poses), -1, 3).copy()
    targets = _targets(draw, seconds)
    # Scripts are right-handed: a flipped gesture goes to the joints of the other side, as its mirror image.
    for name, turns in (_added(draw, seconds, weight) | targets).items():
        if name in names:
            joint, turns = names.index(name), turns * _FLIP if flipped else turns
            joint = int(swapped[joint]) if flipped else joint
            vectors[:, joint] = _blended(vectors[:, joint], turns, weight) if name in targets \
                else vectors[:, joint] + turns
    moved = [side for side, part in zip(SIDES if flipped else SIDES[::-1], (script.main, script.other), strict=True)
             if part is not None]
    return _led_around(vectors.reshape(poses.shape), poses, weight, moved, script)


def _targets(draw: GestureDraw, seconds: Array) -> dict[str, Array]:
    """Joint -> [M, 3] exponential maps that a right-handed gesture leads to: arms and fingers, and the head if a hand
    touches it."""
    def held(name: str, factor: float) -> Array:
        return np.repeat(factor * np.radians(script.adds.get(name, (0.0, 0.0, 0.0)))[None], len(seconds), axis=0)

    out: dict[str, Array] = {}
    script = draw.script
    for which, (side, part) in enumerate((("Right", script.main), ("Left", script.other))):
        if part is None:
            continue
        arm, fingers = hand_turns(draw, which, seconds)
        if side == "Right":
            arm, fingers = arm * _FLIP, fingers * _FLIP
        out[side + "Shoulder"] = shoulder = held(side + "Shoulder", draw.turns)
        # The hand is placed in the frame of the chest, whatever the shoulder does.
        arm[:, 0] = (Rotation.from_rotvec(shoulder).inv() * Rotation.from_rotvec(arm[:, 0])).as_rotvec()
        out |= {side + name: arm[:, at] for at, name in enumerate(_ARM)}
        out |= {f"{side}Hand{finger}{place + 1}": fingers[:, 3 * at + place]
                for at, finger in enumerate(FINGERS) for place in range(3)}
    return out | ({name: held(name, 1.0) for name in _HEAD} if script.faces else {})


def _added(draw: GestureDraw, seconds: Array, weight: Array) -> dict[str, Array]:
    """Joint -> [M, 3] what is added to its exponential maps."""
    script = draw.script
    # At its far end at the apex, whatever the rate.
    wave = weight * np.cos(2.0 * np.pi * script.rate * draw.pace * seconds)
    out: dict[str, Array] = {}
    for turns, level in ((script.adds, weight), (script.nods, wave)):
        for name, degrees in turns.items():
            out[name] = out.get(name, np.zeros((len(seconds), 3))) + draw.turns * level[:, None] * np.radians(degrees)
    return out


def _blended(now: Array, target: Array, share: Array) -> Array:
    """[M, 3] rotations a share [M] of the way from `now` to `target`, along the shortest turn, as the exponential maps
    nearest to `now`."""
    begin = Rotation.from_rotvec(now)
    # The shortest turn from where the joint is: blending exponential maps would bend the way.
    turn = (begin.inv() * Rotation.from_rotvec(target)).as_rotvec()
    return nearest_turn((begin * Rotation.from_rotvec(share[:, None] * turn)).as_rotvec(), now)


def nearest_turn(vectors: Array, reference: Array) -> Array:
    """Exponential maps [..., 3] of the same rotations that are nearest to a reference [..., 3], by full turns."""
    return rotation.unroll(np.stack([reference, vectors]))[1]


def _led_around(poses: Array, before: Array, weight: Array, moved: Sequence[str], script: GestureScript
                ) -> Array:
    """Poses [M, 3 J] with the hands of the sides `moved` kept as far from trunk and head as in the poses `before`, and
    in a gesture at `MARGIN`, or on the body if it touches it. Where nothing has to move, nothing changes."""
    if not moved:
        return poses
    freed, first = _motion_of(poses), pose_of(_motion_of(before))
    rotations, touches = freed.rotations, any(part.touches for part in script.hands)
    for part, gap in ((TRUNK, _TOUCH if touches else MARGIN), (HEAD, 0.0 if script.faces else MARGIN)):
        now = part.distances(first)
        freed = part.kept_out(freed, {side: (1.0 - weight) * np.minimum(now[side], MARGIN) + weight * gap
                                      if side in moved else np.full(len(poses), -np.inf) for side in SIDES})
    # Joints that did not have to move keep their bits: exponential maps of the same rotation may differ.
    changed = (freed.rotations != rotations).any(axis=-1, keepdims=True)
    reference = poses.reshape(len(poses), -1, 3)
    turned = nearest_turn(rotation.to_exponential_map(freed.rotations), reference)
    out: Array = np.where(changed, turned, reference).reshape(poses.shape)
    return out


def _motion_of(poses: Array) -> Motion:
    rotations = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    return Motion(CHARACTERS[rotations.shape[1]], rotations, np.zeros((len(poses), 3)), 60.0)
