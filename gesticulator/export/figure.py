"""The figure in pictures and films: limbs of a 16-joint character as capsules, projected by a view.

A part is a group of limbs with one thin outline, such as the shirt; parts are drawn from back to front. Films use a
camera. Legs stand still, as the models generate nothing below the hips, unless the motion's own legs are requested.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.motion import kinematics, rotation, skeletons
from data_module.types import Array, Motion

INK, SOFT, FLOOR = "#262a31", "#8d8578", "#d9d0c2"
SHIRT, TROUSERS, SKIN, HAIR, NOSE = "#3d7a85", "#4a4f5c", "#dcb999", "#5b493d", "#c79d7a"
HANDS = {"Left": "#1f8a8a", "Right": "#c8553d"}
HALO = 0.009
"""Width of the outline around a part, metres."""
ROUND = 18
"""Vertices of each half of a limb's outline."""
_NOSE = np.array([0.0, 0.075, 0.125])
"""Position relative to the head joint, metres."""
Look = Callable[[Array], tuple[Array, Array, Array]]
"""Points [..., 3] in metres -> positions [..., 2], scale [...], and depth [...] in metres, larger towards the
viewer."""


def figure_points(motion: Motion, times: Array, legs: bool = False, fingers: bool = False) -> dict[str, Array]:
    """Positions to draw: joint (or "LeftHandTip", "HeadTip", "Nose") -> [len(times), 3] metres.

    Any upper body is converted to the 16-joint character, faces +Z, and stands at `skeletons.HIP_HEIGHT`. With `legs`,
    the motion's legs are used where they stand; InputError if it has none. With `fingers`, existing fingers are
    included ("LeftHandIndex1" ... "LeftHandIndex3Tip").
    """
    if legs and not skeletons.has_legs(motion):
        raise InputError("--legs", "are not in this motion", "generate it with infer --legs, or leave them out")
    frames = np.clip(np.asarray(times) * motion.fps, 0, len(motion) - 1)
    # Only the frames around the times are converted, as a take may last an hour.
    first = int(frames.min())
    near, frames = motion.crop(first, int(np.ceil(frames.max())) + 1), frames - first
    root = np.tile([0.0, skeletons.HIP_HEIGHT, 0.0], (len(frames), 1))
    if legs:
        near = skeletons.to_character(near, skeleton=skeletons.WHOLE_BODY)
        root = np.stack([np.interp(frames, np.arange(len(near)), axis) for axis in near.root_positions.T], -1)
    else:
        near = skeletons.facing(skeletons.to_character(
            near, skeleton=skeletons.FINGERED if fingers else skeletons.CHARACTER))
    rotations = rotation.interpolate(near.rotations, frames)
    skeleton = near.skeleton
    places = kinematics.joint_positions(skeleton, rotations, root)
    world = kinematics.global_rotations(skeleton, rotations)

    def beside(joint: str, offset: Array) -> Array:
        """[T, 3] a point that is fixed to a joint, metres from it."""
        at = skeleton.index(joint)
        return places[:, at] + rotation.rotate(world[:, at], offset)

    points = {name: places[:, joint] for joint, name in enumerate(skeleton.names)}
    points |= {skeleton.names[joint] + "Tip": beside(skeleton.names[joint], tip)
               for joint, tip in skeleton.end_sites.items()}
    # The hands of the character without fingers end in one tip; palms are drawn towards it.
    points |= {hand + "Tip": beside(hand, skeletons.CHARACTER.end_sites[skeleton.index(hand)])
               for hand in ("LeftHand", "RightHand")}
    if not fingers or set(skeletons.FINGER_JOINTS) & set(near.absent):
        points = {name: track for name, track in points.items()
                  if name.removesuffix("Tip") not in skeletons.FINGER_JOINTS}
    return points | {"Nose": beside("Head", _NOSE)}


class Limb(NamedTuple):
    """A capsule: end points [T, 3] and diameters in metres, and a colour."""

    start: Array
    end: Array
    wide: float
    narrow: float
    colour: str


@dataclass(frozen=True)
class BodyPart:
    """Limbs with one outline. lift: metres by which it is moved towards the viewer in depth order; hand: side of the
    hand that it ends in, if any; shown: [T] the frames in which it is visible, None for all."""

    limbs: tuple[Limb, ...]
    lift: float
    hand: str = ""
    shown: NDArray[np.bool_] | None = None


_STANDS = {side + name: np.array([place]) for side, places in {
    "Left": ((0.087, 0.889, 0.0), (0.125, 0.477, 0.065), (0.122, 0.08, -0.02), (0.158, 0.02, 0.105),
             (0.176, 0.02, 0.172)),
    "Right": ((-0.093, 0.901, 0.0), (-0.080, 0.482, 0.010), (-0.057, 0.08, -0.035), (-0.082, 0.02, 0.088),
              (-0.096, 0.02, 0.156))}.items() for name, place in zip(
    ("UpLeg", "Leg", "Foot", "ToeBase", "ToeBaseTip"), places, strict=True)}
"""Places of legs that stand on the right one, under hips at the origin: drawn under motion without legs."""


def legs(now: Mapping[str, Array] | None = None) -> list[BodyPart]:
    """The legs of `figure_points`; without them one static pose, under hips at the origin."""
    if now is not None and "LeftUpLeg" in now:
        return [_leg(now, side) for side in ("Left", "Right")]
    both = [_leg(_STANDS, side) for side in ("Left", "Right")]
    return [BodyPart(tuple(limb for leg in both for limb in leg.limbs), 0.0)]


def _leg(now: Mapping[str, Array], side: str) -> BodyPart:
    # The sole is drawn from a heel behind the ankle, as the skeleton has no heel.
    hip, knee, ankle, ball, tip = (now[side + name] for name in ("UpLeg", "Leg", "Foot", "ToeBase", "ToeBaseTip"))
    heel = ankle + 0.62 * (ball - ankle) * [0.0, 1.0, 0.0] + 0.35 * (ankle - ball) * [1.0, 0.0, 1.0]
    return BodyPart((Limb(hip, knee, 0.17, 0.115, TROUSERS), Limb(knee, ankle, 0.115, 0.09, TROUSERS),
                     Limb(heel, ball, 0.085, 0.07, INK), Limb(ball, tip, 0.07, 0.05, INK)), -0.02)


def body(now: Mapping[str, Array], look: Look, trunk: float = 1.0) -> list[BodyPart]:
    """All parts above the legs, of `figure_points`. trunk: the trunk's thickness as a share of its width."""
    return [*_trunk(now, trunk), *_arm(now, "Left"), *_arm(now, "Right"), *_head(now, look)]


def _trunk(now: Mapping[str, Array], share: float) -> list[BodyPart]:
    collar = now["Spine3"] * 0.35 + now["Neck"] * 0.65
    line = [now["Hips"] + [0.0, 0.06, 0.0], *(now[name] for name in ("Spine", "Spine1", "Spine2", "Spine3")), collar]
    wide = [share * width for width in (0.29, 0.28, 0.28, 0.31, 0.32, 0.15)]
    shirt = [Limb(line[k], line[k + 1], wide[k], wide[k + 1], SHIRT) for k in range(len(line) - 1)]
    shirt += [Limb(now["Spine3"] * 0.4 + now[f"{side}Arm"] * 0.6, now[f"{side}Arm"], 0.16, 0.125, SHIRT)
              for side in ("Left", "Right")]
    return [BodyPart((Limb(now["Neck"], now["Head"], 0.11, 0.105, SKIN),), -0.05), BodyPart(tuple(shirt), 0.0)]


def _arm(now: Mapping[str, Array], side: str) -> list[BodyPart]:
    # Lifted towards the viewer, so that an arm at the side is not hidden by the trunk's width.
    shoulder, elbow, wrist, tip = (now[side + name] for name in ("Arm", "ForeArm", "Hand", "HandTip"))
    return [BodyPart((Limb(shoulder, elbow, 0.118, 0.09, SHIRT),), 0.04),
            BodyPart((Limb(elbow, wrist, 0.084, 0.054, SKIN), *(_hand(now, side) or (
                Limb(wrist, tip, 0.07, 0.044, SKIN),))), 0.06, side)]


def _hand(now: Mapping[str, Array], side: str) -> tuple[Limb, ...]:
    """A palm and its fingers, if `figure_points` has them; the last two finger bones are drawn as one."""
    if f"{side}HandIndex1" not in now:
        return ()
    wrist = now[side + "Hand"]
    limbs = [Limb(wrist, now[f"{side}Hand{finger}1"], 0.046, 0.034, SKIN) for finger in ("Index", "Middle", "Pinky")]
    for finger in skeletons.FINGERS:
        knuckle, joint, tip = (now[f"{side}Hand{finger}{place}"] for place in ("1", "2", "3Tip"))
        limbs += [Limb(knuckle, joint, 0.02, 0.018, SKIN), Limb(joint, tip, 0.018, 0.013, SKIN)]
    return tuple(limbs)


def _head(now: Mapping[str, Array], look: Look) -> list[BodyPart]:
    """Hair is a ball, the face a smaller one towards the nose, so that the gaze direction is visible."""
    up = now["HeadTip"] - now["Head"]
    centre = now["Head"] + 0.52 * up
    gaze = now["Nose"] - centre
    face = centre + 0.22 * gaze - 0.15 * up
    # The face is hidden once the nose points clearly away from the viewer.
    ahead = look(now["Nose"])[2] - look(centre)[2] > -0.04
    hair = Limb(centre, centre, 0.216, 0.216, HAIR)
    front = (Limb(face, face, 0.2, 0.2, SKIN), Limb(now["Nose"], now["Nose"], 0.034, 0.034, NOSE))
    return [BodyPart((hair,), 0.05, shown=~ahead), BodyPart((hair, *front), 0.05, shown=ahead)]


class FlatPart(NamedTuple):
    """A projected part: depth [T], visible frames, side of the hand that it ends in, and its polygons [T, K, 2] with
    their colours, from back to front."""

    near: Array
    shown: NDArray[np.bool_] | None
    hand: str
    polygons: list[tuple[Array, str]]


def flattened(part: BodyPart, look: Look, paper: str) -> FlatPart:
    """Project a part; its depth is the mean of its limbs' midpoints. paper: the colour of its outline."""
    halos, limbs, depths = [], [], []
    for limb in part.limbs:
        (start, first, _), (end, last, _) = look(limb.start), look(limb.end)
        wide, narrow = limb.wide / 2 * first, limb.narrow / 2 * last
        halos.append((outlines(start, end, wide + HALO * first, narrow + HALO * last), paper))
        limbs.append((outlines(start, end, wide, narrow), limb.colour))
        depths.append(look((limb.start + limb.end) / 2)[2])
    # All outlines first: they separate the part from what lies behind it, not its limbs from each other.
    return FlatPart(np.mean(depths, axis=0) + part.lift, part.shown, part.hand, halos + limbs)


def outlines(start: Array, end: Array, r0: Array, r1: Array) -> Array:
    """[T, 2 * ROUND, 2] outlines of the convex hulls of two discs: centres [T, 2], radii [T].

    The sides are tangent to both circles, at asin((r0 - r1) / distance) to the axis. If one disc contains the other,
    its circle is the outline.
    """
    way = end - start
    heading = np.arctan2(way[:, 1], way[:, 0])[:, None]
    # Angle between the axis and the radius to the tangent point, equal on both circles.
    touch = np.arccos(np.clip((r0 - r1) / np.maximum(np.hypot(*way.T), 1e-9), -1.0, 1.0))[:, None]
    share = np.linspace(0.0, 1.0, ROUND)
    far = heading - touch + 2 * touch * share
    back = heading + touch + 2 * (np.pi - touch) * share
    halves = [centre[:, None] + radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
              for centre, radius, angle in ((end, r1, far), (start, r0, back))]
    return np.concatenate(halves, axis=1)
