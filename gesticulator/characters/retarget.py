"""Retargeting: the motion of the default skeleton (the source) on the skeleton of any character (the target).

Each tool chooses the axes of its joints, the pose in which its rotations are zero, its units and its up axis, so
copying rotations from one skeleton to another copies arbitrary conventions. This module copies what a viewer sees:
where bones point and how they are rolled about themselves.

Each bone has a *frame*, three unit vectors with the same meaning on every body: the direction of the bone, and a
direction across it (the palm's normal for hand, fingers and forearm; the axis of a bent hinge; for other bones the
result of the shortest rotation from a T-pose). Let F be the frame of a bone of the source at rest, and f that of the
same bone of the target in the local axes of its node: a constant of the target's rig, whatever its rest pose. The
source's bone has the world rotation R(t). Then the target's node must have the world rotation

    G(t) = R(t) C,   C = F f^T                                                                                    (1)

which aligns the two bones: G(t) f = R(t) F. The local rotation is relative to the world rotation P(t) of the parent
node, so clavicles may be attached to the neck, thighs to the spine, and helper nodes may lie anywhere in between:

    q(t) = P(t)^-1 G(t)                                                                                           (2)

Trunk and neck are chains with other numbers of joints: R(t) is interpolated along the source's, by the position between
hips and chest (chest and head). The hips move scaled by the ratio of leg lengths, and two-bone inverse kinematics keeps
each foot in place. Hands are kept out of the trunk (`gesticulator.contacts.other_bodies`), and twist bones of the
forearm share the roll of the hand (`gesticulator.characters.twist`).

Letters: T frames, J joints of the source, N nodes of the target. World axes are those of the source (Y up, facing +Z,
left +X, metres) unless stated otherwise.
"""

import os
from collections.abc import Mapping

import numpy as np

from data_module.motion import rotation, skeletons
from data_module.types import Array, Motion
from gesticulator.characters.body_surface import keep_hands_out
from gesticulator.characters.frames import Body, measure
from gesticulator.characters.mapping import SIDES, RigMapping, ancestors, check
from gesticulator.characters.rig import Character, CharacterMotion
from gesticulator.characters.twist import share_roll
from gesticulator.contacts.limbs import Pose, bend, pose_of

_SOCKETS = 0.18
"""Distance between the source's hip sockets, metres."""
_MOST_TILT = 1.3
"""Largest factor on the rotation of narrow hips."""
_STANDS = 0.003
"""Tolerated displacement of a planted foot, metres scaled by leg length: too small to see."""
_POLE_OF_KNEE = np.array([0.0, 0.0, 1.0])
"""Direction to which the knee of a straight leg bends."""
_FINGERED = len(skeletons.FINGERED)


class Retargeter:
    """Transfers motions of the default skeleton (16, 46 or 54 joints) to one character.

    >>> character = read_character("rig.glb")
    >>> Retargeter(character)(performance.motion)          # doctest: +SKIP
    """

    def __init__(self, character: Character, mapping: RigMapping | None = None, *, contacts: bool = True,
                 legs: bool = True) -> None:
        """mapping: detected if None. contacts: keep hands out of the trunk. legs: False keeps hips and legs at rest (a
        seated character).

        `InputError` if the joints cannot be identified reliably, or if the moved character is not sound
        (`gesticulator.characters.soundness`). Attributes: doubts, its oddities in words; confidence, that of the
        mapping, or the share of the checks that found nothing if that is less.
        """
        from gesticulator.characters.joints import find_joints
        from gesticulator.characters.soundness import probe_motion, require_sound

        self.character = character
        self.mapping = mapping or find_joints(character)
        check(self.mapping, character)
        self.body: Body = measure(character, self.mapping)
        # If the feet are not below the legs in the tree, or these not below the hips, moving hips would tear them off.
        thighs = [self.mapping.joints[side + "UpLeg"] for side in SIDES if side + "UpLeg" in self.mapping.joints]
        hang = all(self.mapping.joints["Hips"] in ancestors(character.parents, thigh) for thigh in thighs)
        self.legs = legs and hang and (self.mapping.legs or not thighs)
        self.contacts = False  # contacts bend arms on purpose, so their directions are checked without
        plain = self(probe_motion())
        self.contacts = contacts
        doubts, share = require_sound(self.body, (plain, self(probe_motion())), self.legs and self.mapping.legs)
        self.doubts = (*self.mapping.doubts, *doubts)
        self.confidence = min(self.mapping.confidence, share)

    @classmethod
    def of(cls, character: Character | str | os.PathLike[str],
           mapping: RigMapping | str | os.PathLike[str] | None = None, *, contacts: bool, legs: bool) -> "Retargeter":
        """character: from `read_character`, or a file. mapping: a `RigMapping`, or a file written by `save_mapping`."""
        from gesticulator.characters.mapping import load_mapping
        from gesticulator.characters.reading import read_character

        rig = character if isinstance(character, Character) else read_character(character)
        joints = mapping if mapping is None or isinstance(mapping, RigMapping) else load_mapping(mapping, rig)
        return cls(rig, joints, contacts=contacts, legs=legs)

    def __call__(self, motion: Motion) -> CharacterMotion:
        """The motion on the character. ValueError if the motion is not on one of our skeletons."""
        source = self._source(motion)
        stands = self.legs and self.mapping.legs
        pose = pose_of(source)
        turns = self._world(pose, set(source.absent))
        if not self.legs:
            turns.pop(self.mapping.joints["Hips"], None)
        turns = {node: turn for node, turn in turns.items() if stands or node not in self.body.leg_nodes}
        root = None
        if stands:
            root = self._stand(turns, pose)
        elif self.body.lift:
            hips = self.body.rest_places[self.mapping.joints["Hips"]] + [0.0, self.body.lift, 0.0]
            root = np.tile(hips, (len(motion), 1))
        if self.contacts:
            keep_hands_out(turns, self.body, pose, motion.fps)
        share_roll(turns, self.body)
        return self._finish(turns, root, len(motion), motion.fps)

    def _source(self, motion: Motion) -> Motion:
        """The motion with fingers, and with standing legs if the character needs them, where the motion lacks them."""
        size = len(motion.skeleton)
        if size not in skeletons.CHARACTERS or not motion.skeleton.same_joints(skeletons.CHARACTERS[size]):
            raise ValueError("the motion is not on one of our skeletons: bring it onto one with to_character")
        lacks_legs = size < len(skeletons.WHOLE_BODY) or set(skeletons.LEG_JOINTS) & set(motion.absent)
        if size == len(skeletons.CHARACTER) or set(skeletons.FINGER_JOINTS) & set(motion.absent):
            from data_module.motion.relaxed_hands import with_relaxed_hands

            motion = with_relaxed_hands(skeletons.resized(motion, skeletons.CHARACTERS[max(size, _FINGERED)]))
        if self.legs and self.mapping.legs and lacks_legs:
            from data_module.motion.standing_legs import with_standing_legs

            return with_standing_legs(motion)
        return skeletons.resized(motion, skeletons.WHOLE_BODY)

    def _world(self, pose: Pose, absent: set[str]) -> dict[int, Array]:
        """Node -> [T, 3, 3] its world rotation G(t) (1). Joints absent from the motion move nothing."""
        turns = {}
        for segment in self.body.segments:
            if segment.joint in absent and segment.joint not in skeletons.JOINTS:
                continue
            turn = pose.turns[segment.joint]
            if segment.share > 0.0:
                ends = rotation.from_matrix(turn), rotation.from_matrix(pose.turns[segment.other])
                turn = rotation.to_matrix(rotation.partway(*ends, segment.share))
            turns[segment.node] = turn @ segment.constant
        return turns

    def _stand(self, turns: dict[int, Array], pose: Pose) -> Array:
        """[T, 3] path of the hips; bends the legs in `turns` so that feet stay in place.

        Each ankle moves as the source's does, scaled by the ratio of leg lengths, about its mean place under the
        source's bone directions. The hips go where both ankles are nearest to that.
        """
        joints, body = self.mapping.joints, self.body
        self._scale_hips(turns, pose.turns["Hips"])
        ankles = np.stack([pose.places[side + "Foot"] for side in SIDES], axis=1)
        travel = body.leg_ratio * (ankles - ankles.mean(axis=0))
        reached = np.stack([body.place(turns, joints[side + "Foot"]) for side in SIDES], axis=1)
        start = body.rest_places[joints["Hips"]].copy()
        stance = (reached + start).mean(axis=0)  # over the place where the character stands at rest
        stance[:, 1] = body.ankles
        wanted = stance + travel
        root = (wanted - reached).mean(axis=1)
        for place, side in enumerate(SIDES):
            # The remaining error comes from different leg proportions. A nearly straight knee would bend by degrees
            # to correct millimetres, so the first few are tolerated.
            miss = wanted[:, place] - root - reached[:, place]
            far = np.linalg.norm(miss, axis=-1, keepdims=True)
            share = np.maximum(0.0, 1.0 - _STANDS * body.leg_ratio / np.maximum(far, 1e-9))
            chain = joints[side + "UpLeg"], joints[side + "Leg"], joints[side + "Foot"]
            bend(turns, body, chain, reached[:, place] + share * miss, _POLE_OF_KNEE)
        return root

    def _scale_hips(self, turns: dict[int, Array], hips_turns: Array) -> None:
        """Rotate hips of another width so that the hip sockets move as the source's do, scaled by the legs.

        Wide hips that tilt like narrow ones would lift a foot off the floor. The rotation about the up and forward axes
        is scaled, relative to its mean over time, usually by less than a degree.
        """
        body = self.body
        sockets = [body.place(turns, self.mapping.joints[side + "UpLeg"]) for side in SIDES]
        width = float(np.linalg.norm(sockets[0] - sockets[1], axis=-1).mean())
        ratio = min(body.leg_ratio * _SOCKETS / max(width, 1e-6), _MOST_TILT)
        mean = rotation.to_matrix(rotation.mean(rotation.from_matrix(hips_turns)))
        # About the mean, so that a constant lean stays as it is.
        log = rotation.to_exponential_map(rotation.from_matrix(mean.T @ hips_turns))
        scaled = mean @ rotation.to_matrix(rotation.from_exponential_map(log * [1.0, ratio, ratio]))
        for segment in body.segments:
            if segment.joint == "Hips" and segment.share == 0.0:
                turns[segment.node] = scaled @ segment.constant

    def _finish(self, turns: Mapping[int, Array], root: Array | None, frames: int, fps: float) -> CharacterMotion:
        """Local rotations in the file (2) and the local translation of the hips."""
        character, body = self.character, self.body
        rotations = np.tile(character.rotations, (frames, 1, 1))
        world: dict[int, Array] = {}
        local: list[Array] = []
        for node, parent in enumerate(character.parents):
            above = world.get(parent, body.rest_turns[parent] if parent >= 0 else body.axes)
            if node in turns:
                world[node] = turns[node]
                # The file's negative scale already mirrors this node, so it is divided out of the rotation.
                mirror = np.where(character.scales[node] < 0.0, -1.0, 1.0)
                local.append(np.swapaxes(above, -1, -2) @ turns[node] * mirror)
            elif parent in world:
                world[node] = above @ body.local_turns[node]
        moved = tuple(sorted(turns))
        # q and -q are the same rotation; a sign that flips between frames would spin under interpolation.
        rotations[:, moved] = rotation.continuous(rotation.from_matrix(np.stack(local, axis=1)))
        translations = None
        if root is not None:
            hips = self.mapping.joints["Hips"]
            parent = character.parents[hips]
            matrix = character.world_matrices()[parent] if parent >= 0 else np.eye(4)
            # The hips in the file's axes and units, then in the frame of their parent.
            places = root / body.unit @ body.axes
            translations = (places - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
        return CharacterMotion(character, rotations, translations, fps, self.mapping.named(), moved, body.unit)


def retarget(motion: Motion, character: Character | str | os.PathLike[str],
             mapping: RigMapping | str | os.PathLike[str] | None = None, *, contacts: bool = True,
             legs: bool = True) -> CharacterMotion:
    """A motion on a character; see `Retargeter.of` for the arguments."""
    return Retargeter.of(character, mapping, contacts=contacts, legs=legs)(motion)


__all__ = ["CharacterMotion", "Retargeter", "retarget"]
