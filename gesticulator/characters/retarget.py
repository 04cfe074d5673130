"""Retargeting: the motion of our character on the skeleton of any other.

What a viewer sees of a pose is where bones point and how they are rolled about themselves: an upper arm that points
ahead, a palm that faces up. Numbers in files are something else. Each tool chooses the axes of its joints, the pose in
which its rotations are zero, its units and which way is up, so copying rotations from one skeleton to another copies
accidents. What is copied here is geometry.

For each bone a *frame* is taken, three unit vectors that mean the same on every body: where the bone points, and a
direction across it (the palm's normal for hand, fingers and forearm; the axis of a bent hinge; for the rest what the
shortest turn from a T-pose makes of it). Let F be the frame of a bone of ours at rest, and f that of the same bone of
hers in the local axes of her own node: a constant of her rig, whatever her rest pose. Ours turns by the world rotation
R(t). Then hers must have the world rotation

    G(t) = R(t) C,   C = F f^T                                                                                    (1)

which puts her bone where ours is: G(t) f = R(t) F. One constant matrix per node is the whole of retargeting; what
follows only brings G(t) into her file. Her local rotation is that relative to whatever her parent node does,

    q(t) = P(t)^-1 G(t)                                                                                           (2)

so clavicles may hang on the neck, thighs on the spine, and helpers anywhere in between.

Trunk and neck are chains of another number of joints: R(t) is interpolated along ours, by the share of the way from
the hips to the chest (from chest to head). The hips move by the ratio of the legs' lengths, and two-bone inverse
kinematics keeps each foot where it stands, which bends knees by fractions of a degree. Hands that would enter a trunk
wider than ours are kept outside (`gesticulator.characters.contacts`), and twist bones of the forearm get their share of
the hand's roll (`gesticulator.characters.twist`).

Letters: T frames, J our joints, N her nodes. World axes are ours (Y up, facing +Z, left +X, metres) unless said.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from data_module.motion import rotation, skeletons
from data_module.types import Array, Motion
from gesticulator.characters.contacts import Pose, keep_hands_out, pose_of
from gesticulator.characters.frames import Body, measure
from gesticulator.characters.inverse_kinematics import bend
from gesticulator.characters.mapping import SIDES, RigMapping, check
from gesticulator.characters.rig import Character, CharacterMotion
from gesticulator.characters.twist import share_roll

_SOCKETS = 0.18
"""Metres between the sockets of our legs."""
_MOST_TILT = 1.3
"""Narrow hips are turned and tilted by at most this many times ours."""
_STANDS = 0.003
"""Metres, in the scale of her legs, that a foot may be off the place where it stands: nobody sees them."""
_FINGERED = len(skeletons.FINGERED)


class Retargeter:
    """Brings motions of our character (16, 46 or 54 joints) onto one other character.

    >>> character = read_character("rig.glb")
    >>> Retargeter(character)(performance.motion)          # doctest: +SKIP
    """

    def __init__(self, character: Character, mapping: RigMapping | None = None, *, contacts: bool = True,
                 legs: bool | None = None) -> None:
        """mapping: found by name, tree and geometry when not told. contacts: keep hands out of the trunk.

        legs: False leaves hips and legs as they are at rest (somebody who sits), True lets her stand; when not told she
        stands unless she sits in her file.
        `InputError` where the character has no body, or one that can only be guessed.
        """
        from gesticulator.characters.joints import find_joints

        self.character = character
        self.mapping = mapping or find_joints(character)
        check(self.mapping, character)
        self.body: Body = measure(character, self.mapping)
        self.contacts, self.legs = contacts, not self.body.sits if legs is None else legs

    def __call__(self, motion: Motion) -> CharacterMotion:
        """The motion on the character. ValueError for a motion that is not on one of our skeletons."""
        source = self._source(motion)
        stands = self.legs and self.mapping.legs
        ours = pose_of(source)
        turns = self._world(ours, set(source.absent))
        if not self.legs:
            turns.pop(self.mapping.joints["Hips"], None)
        turns = {node: turn for node, turn in turns.items() if stands or node not in self.body.leg_nodes}
        root = None
        if stands:
            root = self._stand(turns, ours)
        elif self.body.lift:
            hips = self.body.rest_places[self.mapping.joints["Hips"]] + [0.0, self.body.lift, 0.0]
            root = np.tile(hips, (len(motion), 1))
        if self.contacts:
            keep_hands_out(turns, self.body, ours)
        share_roll(turns, self.body)
        return self._finish(turns, root, len(motion), motion.fps)

    def _source(self, motion: Motion) -> Motion:
        """The motion with fingers, and with the legs that a standing character needs, where it has none of its own."""
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

    def _world(self, ours: Pose, absent: set[str]) -> dict[int, Array]:
        """Node -> [T, 3, 3] its world rotation G(t) (1). What is absent in ours moves nothing of hers."""
        turns = {}
        for segment in self.body.segments:
            if segment.joint in absent and segment.joint not in skeletons.JOINTS:
                continue
            own = ours.turns[segment.joint]
            if segment.share > 0.0:
                own = _between(own, ours.turns[segment.other], segment.share)
            turns[segment.node] = own @ segment.constant
        return turns

    def _stand(self, turns: dict[int, Array], ours: Pose) -> Array:
        """[T, 3] the hips' path; the legs in `turns` are bent so that feet stand where they do.

        Each ankle moves as ours does, by the ratio of the legs' lengths, about the place where it stands on average
        when the bones point as ours do. The hips go where both ankles are nearest to that.
        """
        joints, body = self.mapping.joints, self.body
        self._settle_hips(turns, ours.turns["Hips"])
        ankles = np.stack([ours.places[side + "Foot"] for side in SIDES], axis=1)
        travel = body.leg_ratio * (ankles - ankles.mean(axis=0))
        reached = np.stack([body.place(turns, joints[side + "Foot"]) for side in SIDES], axis=1)
        rest = np.stack([body.rest_places[joints[side + "Foot"]] for side in SIDES])
        start = body.rest_places[joints["Hips"]].copy()
        stance = (reached + start).mean(axis=0)  # over the place where she stands at rest
        stance[:, 1] = rest[:, 1] + body.lift
        wanted = stance + travel
        root = (wanted - reached).mean(axis=1)
        for place, side in enumerate(SIDES):
            # What is left over comes from legs of other proportions. A knee that is nearly straight would bend by
            # degrees for millimetres, so the first of them are let pass.
            miss = wanted[:, place] - root - reached[:, place]
            far = np.linalg.norm(miss, axis=-1, keepdims=True)
            share = np.maximum(0.0, 1.0 - _STANDS * body.leg_ratio / np.maximum(far, 1e-9))
            reach_with_leg(turns, body, self.mapping, side, reached[:, place] + share * miss)
        return root

    def _settle_hips(self, turns: dict[int, Array], ours: Array) -> None:
        """Turn and tilt hips of another width so that the legs' sockets move as ours do, in the scale of the legs.

        Wide hips that tilt as narrow ones do would lift a foot off the floor. What is scaled is the turn about up and
        ahead, against the mean over time, by less than a degree as a rule.
        """
        body = self.body
        sockets = [body.place(turns, self.mapping.joints[side + "UpLeg"]) for side in SIDES]
        width = float(np.linalg.norm(sockets[0] - sockets[1], axis=-1).mean())
        ratio = min(body.leg_ratio * _SOCKETS / max(width, 1e-6), _MOST_TILT)
        mean = Rotation.from_matrix(ours).mean().as_matrix()
        log = Rotation.from_matrix(mean.T @ ours).as_rotvec()
        settled = mean @ Rotation.from_rotvec(log * [1.0, ratio, ratio]).as_matrix()
        for segment in body.segments:
            if segment.joint == "Hips" and segment.share == 0.0:
                turns[segment.node] = settled @ segment.constant

    def _finish(self, turns: Mapping[int, Array], root: Array | None, frames: int, fps: float) -> CharacterMotion:
        """Local rotations of her file (2) and the hips' local translation."""
        character, body = self.character, self.body
        rotations = np.tile(character.rotations, (frames, 1, 1))
        world: dict[int, Array] = {}
        local: list[Array] = []
        for node, parent in enumerate(character.parents):
            above = world.get(parent, body.rest_turns[parent] if parent >= 0 else body.axes)
            if node in turns:
                world[node] = turns[node]
                local.append(np.swapaxes(above, -1, -2) @ turns[node])
            elif parent in world:
                world[node] = above @ body.local_turns[node]
        moved = tuple(sorted(turns))
        rotations[:, moved] = rotation.continuous(np.stack([
            Rotation.from_matrix(turn).as_quat(scalar_first=True) for turn in local], axis=1))
        translations = None
        if root is not None:
            hips = self.mapping.joints["Hips"]
            parent = character.parents[hips]
            matrix = character.world_matrices()[parent] if parent >= 0 else np.eye(4)
            places = root / body.unit @ body.axes
            translations = (places - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
        return CharacterMotion(character, rotations, translations, fps, self.mapping.named(),
                               moved, body.unit)


def _between(a: Array, b: Array, share: float) -> Array:
    """[T, 3, 3] the rotation `share` of the way from a to b, along the shortest arc."""
    turn = Rotation.from_matrix(np.swapaxes(a, -1, -2) @ b).as_rotvec()
    return a @ Rotation.from_rotvec(share * turn).as_matrix()


def reach_with_leg(turns: dict[int, Array], body: Body, mapping: RigMapping, side: str, ankle: Array) -> None:
    """Bend a leg in `turns` so that its ankle is at `ankle` [T, 3] from the hips; the foot keeps its world rotation."""
    thigh, shin, foot = (mapping.joints[side + part] for part in ("UpLeg", "Leg", "Foot"))
    bend(turns, body, (thigh, shin, foot), ankle, np.array([0.0, 0.0, 1.0]))


def retarget(motion: Motion, character: Character | str | os.PathLike[str],
             mapping: RigMapping | str | os.PathLike[str] | None = None, *, contacts: bool = True,
             legs: bool | None = None) -> CharacterMotion:
    """A motion on a character; see `Retargeter`.

    character: what `read_character` gives, or a file. mapping: a `RigMapping`, or a file as `save_mapping` writes it.
    """
    from gesticulator.characters.mapping import load_mapping
    from gesticulator.characters.reading import read_character

    rig = character if isinstance(character, Character) else read_character(character)
    told = mapping if mapping is None or isinstance(mapping, RigMapping) else load_mapping(mapping, rig)
    return Retargeter(rig, told, contacts=contacts, legs=legs)(motion)


__all__ = ["CharacterMotion", "Retargeter", "retarget"]
