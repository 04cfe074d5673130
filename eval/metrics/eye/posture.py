"""Posture: where arms, wrists, fingers and shoulders are held.

Theory: a gesture keeps the forearms in front of the chest. Distances between distributions of whole windows hardly move
when both forearms are turned outward by 20 degrees, so these figures look at single body parts. With a = elbow -
shoulder and b = wrist - elbow of an arm, and l the unit vector to the left of the chest:

- splay: percentage of time and arms in which the wrist is more than 8 cm outside its own elbow along l; splay of both:
  in which both are.
- azimuth of the forearm: degrees outward from straight ahead of the chest, seen from above; the median over arms that
  hang within 40 degrees of vertical with an elbow bent by 40 to 120 degrees.
- elbow bend: mean angle between a and b, degrees, 0 for a straight arm.
- before the face: percentage of time in which an arm, from the elbow to the middle of the hand, comes within 18 cm of
  the middle of the face.
- hands apart: mean distance between the wrists, cm.
- shoulder lift: standard deviation over time of the shoulder's height along the chest's own up axis, cm. Rigid
  clavicles give 0, however the trunk leans.
- wrist bend: 95th percentile of the angle between the forearm and the line from the wrist to the first joint of the
  middle finger, degrees.
- finger bend: mean angle at the joints of the four fingers, degrees; its standard deviation between joints, mean of
  times; and the correlation of the thumb's with the index finger's.

Good: real speakers have splay 6 to 12 %, azimuth -22 to -3 degrees, an elbow bend of 58 to 81 degrees, an arm before
the face in at most 1 % of the time (BEAT 0, CMU .9, Rocketbox .6), hands 53 to 69 cm apart, .6 to 1.1 cm of shoulder
lift, fingers bent by 26 to 28 degrees that differ by 10 to 20.

What fools them: none of them knows the speech or the order of frames, so a motion played backwards or mirrored has all
of them, and jitter changes none but the shoulder lift. A single posture held constant can satisfy splay, azimuth and
elbow; read the shoulder lift beside them.

A forearm at right angles to its upper arm:

    >>> bend(np.array([[0.0, -1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
    array([90.])
"""

import math

import numpy as np

from data_module.motion import rotation
from data_module.types import Array
from eval.metrics.eye.body import HZ, SIDES, CommonBody, bend, chest_left, unit
from eval.metrics.eye.hands import correlation
from eval.metrics.eye.trunk import off_line

OUTSIDE = 0.08
"""Metres of a wrist outside its elbow from which a forearm is splayed: the depth of a forearm."""
_HANGING_ARM, _BENT = 40.0, (40.0, 120.0)
"""Degrees: an upper arm this near to vertical, with an elbow bent within this range, has a forearm azimuth. A forearm
that hangs or points up has none."""
_FACE, _FACE_AT, _HAND = 0.18, np.array([0.0, 0.09, 0.08]), 0.36
"""Metres from the middle of the face, its place in the frame of the head, and how far the middle of a hand is beyond
the wrist, as a share of the forearm."""
_FEWEST = HZ / 2
"""Frames without which an azimuth is not defined."""


def _arms(body: CommonBody) -> dict[str, float]:
    left, points = chest_left(body), body.points
    # Seen from above, so that a chest that leans does not turn the forearms outward.
    across = unit(left * np.array([1.0, 0.0, 1.0]))
    ahead = np.cross(across, np.array([0.0, 1.0, 0.0]))
    splayed, azimuths, bends = [], [], []
    for side, sign in zip(SIDES, (-1.0, 1.0), strict=True):
        upper = points[side + "ForeArm"] - points[side + "Arm"]
        fore = points[side + "Hand"] - points[side + "ForeArm"]
        splayed.append(sign * (fore * left).sum(axis=1) > OUTSIDE)
        angle, direction = bend(upper, fore), unit(fore)
        # Only arms in the posture of a gesture: an azimuth of a forearm that hangs or points up is noise.
        counts = (unit(upper)[:, 1] < -math.cos(math.radians(_HANGING_ARM))) \
            & (angle > _BENT[0]) & (angle < _BENT[1])
        outward = np.arctan2(sign * (direction * across).sum(axis=1), (direction * ahead).sum(axis=1))
        azimuths.append(np.degrees(outward[counts]))
        bends.append(angle)
    azimuth = np.concatenate(azimuths)
    # In space, not across the chest: hands one above the other are apart, too.
    apart = np.linalg.norm(points["LeftHand"] - points["RightHand"], axis=1)
    return {"eye_splay": 100.0 * float(np.mean(splayed)), "eye_splay_both": 100.0 * float(np.all(splayed, 0).mean()),
            "eye_azimuth": float(np.median(azimuth)) if len(azimuth) >= _FEWEST else math.nan,
            "eye_elbow": float(np.mean(bends)), "eye_hands_apart": 100.0 * float(apart.mean())}


def _before_face(body: CommonBody) -> float:
    """Percentage of frames with an arm before the face."""
    face = body.points["Head"] + rotation.rotate(body.head, np.broadcast_to(_FACE_AT, (len(body), 3)))
    near = np.zeros(len(body), bool)
    for side in SIDES:
        elbow = body.points[side + "ForeArm"]
        # The common body has no hand, so the forearm is made longer, to the middle of where one would be.
        arm = (1.0 + _HAND) * (body.points[side + "Hand"] - elbow)
        near |= off_line(face, elbow, arm) < _FACE
    return 100.0 * float(near.mean())


def _shoulders(body: CommonBody) -> float:
    """Centimetres of lift along the chest's own up axis: square to its left, as near to the trunk as can be."""
    left, points = chest_left(body), body.points
    # The lift is along the trunk, or leaning would raise a shoulder.
    trunk = points["Neck"] - points["Chest"]
    up = unit(trunk - (trunk * left).sum(axis=1, keepdims=True) * left)
    return 100.0 * float(np.mean([((points[side + "Arm"] - points["Chest"]) * up).sum(axis=1).std()
                                  for side in SIDES]))


def _fingers(bends: dict[tuple[str, str], Array]) -> dict[str, float]:
    out = {}
    # The thumb bends about other axes than the four fingers.
    joints = [angles for (_, finger), angles in bends.items() if finger != "thumb"]
    if joints:
        angles = np.concatenate(joints, axis=1)
        out = {"eye_finger_bend": float(angles.mean()), "eye_finger_between": float(angles.std(axis=1).mean())}
    pairs = [np.stack([bends[side, finger].sum(axis=1) for finger in ("thumb", "index")], axis=1)
             for side in SIDES if (side, "thumb") in bends and (side, "index") in bends]
    # A hand whose fingers stay as they are has no correlation; the other one still counts.
    defined = [value for value in map(correlation, pairs) if math.isfinite(value)]
    return out | ({"eye_thumb_index": float(np.mean(defined))} if defined else {})


def figures(body: CommonBody) -> dict[str, float]:
    """Every figure of this chapter; those of wrists and fingers only where the skeleton has them."""
    wrists = {} if body.wrists is None else {"eye_wrist_95": float(np.percentile(body.wrists, 95))}
    return {**_arms(body), "eye_face": _before_face(body), "eye_shoulder": _shoulders(body), **wrists,
            **_fingers(body.finger_bends)}
