"""Measures the bones of a character: the direction and roll of each bone in the axes of its node.

`measure` gives, for each moved node, the joint of the default skeleton that it follows and the constant C of
`gesticulator.characters.retarget` (1). It needs no particular rest pose: the direction of a bone in its node's axes is
the same in all poses. Below, `source` is the default skeleton (T-pose, Y up, facing +Z, left +X), whose motion the
character follows. Only the roll of a bone without a palm or a bent hinge is taken from the pose that the mesh was
bound in, by the shortest rotation from a T-pose.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data_module.errors import InputError
from data_module.motion import rotation, skeletons
from data_module.motion.skeletons import FINGERS, WHOLE_BODY, nearest_axis
from data_module.types import Array
from gesticulator.characters import shape
from gesticulator.characters.mapping import SIDES, RigMapping, ancestors
from gesticulator.characters.rig import UPS, Character
from gesticulator.contacts.limbs import swing

_UPRIGHT = np.radians(30.0)
"""An axis of the file within this angle of the direction from hips to head is up; otherwise the body lies or hangs."""
_LEVEL = np.radians(1.0)
"""An axis of the mesh within this angle of the format's up axis is up."""
_SQUARE = np.radians(8.0)
"""A body that faces within this angle of an axis of the file faces along it: shoulders are never exactly level."""
_BENT = np.radians(15.0)
"""A joint bent by more than this in the bind pose defines the axis of its hinge."""
_TURNED = np.radians(3.0)
"""Turn of hips or shoulders in the bind pose above which it is that of a movement."""
_LENGTH = 0.6
"""Distance from hips to head of an adult, metres."""
_SUNK = 0.2
"""Share of the height that the feet of a BVH character must be below 0 for the character to be lifted onto 0."""
_KNUCKLES = (("Index", "Pinky"), ("Index", "Ring"), ("Middle", "Pinky"), ("Index", "Middle"), ("Middle", "Ring"))
"""Pairs of fingers whose first joints give the direction across the palm, the best first."""


@dataclass(frozen=True)
class BoneSegment:
    """A moved node: G(t) = R(t) C, where R(t) is the world rotation of the default skeleton's `joint`, or interpolated
    by `share` towards that of `other`. constant: C, [3, 3], from the node's axes to those of the source."""

    node: int
    joint: str
    constant: Array
    other: str = ""
    share: float = 0.0


@dataclass(frozen=True)
class Body:
    """A character measured in the source's axes (Y up, facing +Z, left +X) and in metres.

    axes: [3, 3] rows are the character's left, up and forward in the file's axes: x_source = axes @ x_file * unit.
    bind_axes: [3, 3] the same in the bind pose, which differs if that lies or leans where the file places it.
    unit: metres per unit of the character's world. lift: metres that the character is lifted to stand on the floor.
    rest_places: [N, 3] positions of the nodes at rest; rest_turns: [N, 3, 3] from the nodes' axes to the source's at
    rest; local_turns: [N, 3, 3] the same to their parents' axes. offsets: [N, 3] metres from each node's parent, in the
    parent's axes. leg_ratio: length of the character's leg relative to the source's. ankles: [2] heights of the left
    and the right ankle of a character that stands, metres; empty without legs.
    """

    character: Character
    mapping: RigMapping
    axes: Array
    unit: float
    lift: float
    rest_places: Array
    rest_turns: Array
    local_turns: Array
    offsets: Array
    leg_ratio: float
    segments: tuple[BoneSegment, ...]
    leg_nodes: frozenset[int]
    bind_axes: Array
    ankles: Array

    def place(self, turns: Mapping[int, Array], node: int) -> Array:
        """[T, 3] position of a node below the hips, relative to the hips, metres; turns: node -> [T, 3, 3] its axes to
        the source's. Nodes not in `turns` keep their rest rotation relative to their parents."""
        hips = self.mapping.joints["Hips"]
        line = [node, *ancestors(self.character.parents, node)]
        turn = turns[hips] if hips in turns else self.rest_turns[hips][None]
        place = np.zeros((len(next(iter(turns.values()), turn)), 3))
        # Forward kinematics from the hips down, all frames at once.
        for at in reversed(line[:line.index(hips)]):
            place = place + turn @ self.offsets[at]
            turn = turns[at] if at in turns else turn @ self.local_turns[at]
        return place


def measure(character: Character, mapping: RigMapping) -> Body:
    """Measure a character; `InputError` if required bones have no length."""
    bind = shape.bind_matrices(character)
    bind_axes = _axes(character, mapping, bind[:, :3, 3])
    axes = _upright(character, bind_axes)
    rest, turns, local = character.world_matrices()[:, :3, 3], character.world_turns(), character.local_turns()
    unit = _unit(character, mapping, rest)
    places = rest @ axes.T * unit
    parents = np.maximum(character.parents, 0)
    # Row vectors: v @ M is the transpose of M times v.
    offsets = unit * np.einsum("ni,nij->nj", rest - rest[parents], turns[parents])
    rig = _Rig(character, mapping, bind_axes @ shape.bind_turns(character), (places, axes @ turns, offsets))
    segments = (*rig.trunk(), *rig.arms(), *rig.legs())
    legs = frozenset(mapping.joints[name] for name in skeletons.LEG_JOINTS if name in mapping.joints)
    lift, ratio = 0.0, 1.0
    if mapping.legs:
        # The hips travel in proportion to the legs, so that steps fit the character.
        bones = [places[mapping.joints[side + below]] - places[mapping.joints[side + above]]
                 for side in SIDES for above, below in (("UpLeg", "Leg"), ("Leg", "Foot"))]
        ratio = float(np.linalg.norm(bones, axis=1).sum()
                      / (2.0 * (np.linalg.norm(_SOURCE["LeftLeg"]) + np.linalg.norm(_SOURCE["LeftFoot"]))))
        lowest = min(float(places[node, 1]) for node in legs)
        height = float(places[mapping.joints["Head"], 1]) - lowest
        if character.kind == "bvh" and lowest < -_SUNK * height:
            ankle = float(np.mean([places[mapping.joints[side + "Foot"], 1] for side in SIDES]))
            # Without toes or tips the height of the ankle is unknown: use that of the default skeleton, scaled.
            lift = -min(lowest, ankle - _ANKLE * ratio)
    ankles = _ankles(character, mapping, (axes, bind_axes), places, unit) if mapping.legs else np.zeros(0)
    return Body(character, mapping, axes, unit, lift, places, axes @ turns, local, offsets, ratio, segments, legs,
                bind_axes, ankles + lift)


_SOURCE = {name: WHOLE_BODY.offsets[index] for index, name in enumerate(WHOLE_BODY.names)}
_LEFT = np.array([1.0, 0.0, 0.0])
_ANKLE = 0.08
"""Height of the default skeleton's ankle above the floor, metres."""


def _ankles(character: Character, mapping: RigMapping, axes: tuple[Array, Array], rest: Array, unit: float) -> Array:
    """[2] heights of the ankles of a character that stands, metres, without its lift.

    They are those at rest if its feet rest where the bind pose has them, else those of the bind pose: on the floor of
    the mesh, or on the floor of the file if the mesh does not stand upright there. axes: upright, and of the bind pose.
    """
    feet = [mapping.joints[side + "Foot"] for side in SIDES]
    if character.bind is None:
        return rest[feet, 1]
    upright, bind_axes = axes
    bound = character.bind[:, :3, 3] @ bind_axes.T * unit
    stands = upright is bind_axes
    if stands and np.abs(bound[feet] - rest[feet]).max() < _SAME_PLACE * float(np.ptp(bound[:, 1])):
        return rest[feet, 1]
    if stands:
        return bound[feet, 1]
    below = [bound[node, 1] for name, node in mapping.joints.items() if name in skeletons.LEG_JOINTS]
    flesh = character.flesh @ bind_axes[1] * unit
    return np.asarray(bound[feet, 1] - min(*below, *([float(flesh.min())] if len(flesh) else [])))


_SAME_PLACE = 0.01
"""Share of the height within which feet rest where the bind pose has them."""


def _unit(character: Character, mapping: RigMapping, rest: Array) -> float:
    """Metres per unit, by the file's format; if it defines none, or the body is ten times too large or too small by it,
    whichever power of ten brings the distance from hips to head nearest to an adult's."""
    chain = [mapping.joints["Hips"], *mapping.spine, *mapping.neck, mapping.joints["Head"]]
    length = float(np.linalg.norm(np.diff(rest[chain], axis=0), axis=1).sum())
    if length <= 0:
        return 1.0
    if character.unit is None:
        return min((1.0, 0.01, 0.001), key=lambda unit: abs(float(np.log(length * unit / _LENGTH))))
    # Powers of ten by which the body is too small or too large.
    off = float(np.log10(_LENGTH / (length * character.unit)))
    # Exports with the wrong unit are off by a power of ten; other sizes may be meant (a child, a giant).
    return character.unit * 10.0 ** round(off) if abs(off) > 1.0 else character.unit


def _axes(character: Character, mapping: RigMapping, places: Array) -> Array:
    """[3, 3] the character's left, up and forward in the file's axes, from its joints in the bind pose."""
    joints = mapping.joints
    up = _unit_vector(character, places[joints["Head"]] - places[joints["Hips"]], "hips and head")
    axis = nearest_axis(up)
    known = UPS.get(character.kind)
    modelled = character.space @ nearest_axis(character.space.T @ up)  # along an axis of the mesh
    # In order of trust: an axis of the mesh, the format's up axis, any axis of the file that is near.
    if known is not None and up @ modelled > np.cos(_UPRIGHT) and modelled @ known < np.cos(_LEVEL):
        up = modelled
    elif known is not None and up @ known > 0.5:
        up = known
    elif up @ axis > np.cos(_UPRIGHT):
        up = axis
    left = np.zeros(3)
    for part in ("Arm", "UpLeg"):
        if "Left" + part in joints and "Right" + part in joints:
            across = places[joints["Left" + part]] - places[joints["Right" + part]]
            # Shoulders and hips together: their sum is less sensitive to one raised shoulder or a weight shift.
            left = left + (across - (across @ up) * up)
    left = _unit_vector(character, left, "both shoulders")
    # A mesh is modelled along its axes, whatever the turn that the file gives it.
    axis = nearest_axis(left) if known is None else character.space @ nearest_axis(character.space.T @ left)
    axis = axis - (axis @ up) * up if known is not None else axis
    if left @ axis > np.cos(_SQUARE) and abs(axis @ up) < 1e-9:
        left = axis / np.linalg.norm(axis)
    return np.stack([left, up, np.cross(left, up)])


def _upright(character: Character, axes: Array) -> Array:
    """[3, 3] the axes of the bind pose, set upright where the format defines what is up (and forward, if it lies)."""
    known = UPS.get(character.kind)
    if known is None or axes[1] @ known > 1.0 - 1e-12:
        return axes
    if axes[1] @ known > 0.5:
        return np.asarray(axes @ swing(axes[1], known).T)
    # VRM 0.x characters face -Z, all others +Z, so their left is -X.
    left = np.array([-1.0 if character.vrm == "0.x" else 1.0, 0.0, 0.0])
    return np.stack([left, known, np.cross(left, known)])


def _unit_vector(character: Character, vector: Array, what: str) -> Array:
    length = float(np.linalg.norm(vector))
    if length < 1e-12:
        raise InputError(character.path, f"has {what} in one place", "check the mapping and the file's rest pose")
    return vector / length


def frame(along: Array, across: Array) -> Array:
    """[3, 3] columns: the direction of `along`, of the part of `across` orthogonal to it, and their cross product."""
    # Gram-Schmidt: `along` exactly, `across` as near as orthogonality allows.
    first = along / np.linalg.norm(along)
    second = across - (across @ first) * first
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _angle(a: Array, b: Array) -> float:
    return float(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0)))


class _Rig:
    """The bones of a character in the bind pose, in our axes, compared with the default skeleton at rest."""

    def __init__(self, character: Character, mapping: RigMapping, bind: Array, rest: tuple[Array, Array, Array]
                 ) -> None:
        """bind: [N, 3, 3] from the nodes' axes to ours; rest: `rest_places`, `rest_turns` and `offsets` of a `Body`."""
        self.character, self.mapping, self.joints, self.bind = character, mapping, mapping.joints, bind
        self._rest_places, self._rest_turns, self._offsets = rest

    def way(self, above: int, below: int) -> Array | None:
        """[3] metres from a node to a descendant, in the axes of the first; None if it is not a descendant."""
        if above not in (below, *ancestors(self.character.parents, below)):
            return None
        return np.asarray(self._rest_turns[above].T @ (self._rest_places[below] - self._rest_places[above]))

    def bone(self, name: str, below: str) -> Array:
        """[3] metres from joint to joint in the bind pose, in our axes."""
        node = self.joints[name]
        way = self.way(node, self.joints[below])
        if way is None or np.linalg.norm(way) < 1e-6:
            raise InputError(self.character.path, f"has {name} and {below} in one place, or one is not above the other",
                             "check the mapping")
        return self.bind[node] @ way

    def _segment(self, name: str, change: Array) -> BoneSegment:
        """change: [3, 3] rotation of this bone from the character's bind pose to our rest pose."""
        return BoneSegment(self.joints[name], name, change @ self.bind[self.joints[name]])

    # ------------------------------------------------------------------------------------------------ the trunk

    def trunk(self) -> list[BoneSegment]:
        """Hips, spine, neck and head, by their position between hips, chest and head."""
        joints, bind = self.joints, self.bind
        chain = [joints["Hips"], *self.mapping.spine]
        low, high = self._straightening(chain[0], "UpLeg"), self._straightening(chain[-1], "Shoulder")
        out = [BoneSegment(joints["Hips"], "Hips", rotation.to_matrix(low) @ bind[joints["Hips"]])]
        # By length, not by number: some rigs have a short first spine bone.
        shares = self._shares(chain)
        source = ("Hips", "Spine", "Spine1", "Spine2", "Spine3")
        steps = np.cumsum([0.0, *(np.linalg.norm(_SOURCE[name]) for name in source[1:])])
        for node, share in zip(self.mapping.spine, shares[1:], strict=True):
            if node != self.mapping.spine[-1] and self._carries_legs(node):
                share = 0.0  # a node that carries the legs moves with the hips
            straight = rotation.to_matrix(rotation.partway(low, high, share)) @ bind[node]
            out.append(BoneSegment(node, *_place_among(source, steps / steps[-1], share, straight)))
        shares = self._shares([*self.mapping.neck, joints["Head"]])
        for node, begin, end in zip(self.mapping.neck, shares, shares[1:], strict=False):
            # A neck of one joint bends like the average of our two, taken at the middle of its bone.
            out.append(BoneSegment(node, *_place_among(("Neck", "Neck1"), np.array([0.25, 0.75]), (begin + end) / 2.0,
                                                   bind[node])))
        return [*out, BoneSegment(joints["Head"], "Head", bind[joints["Head"]])]

    def _straightening(self, node: int, part: str) -> Array:
        """[4] rotation that makes a node of the trunk face ahead whose line between both sides' `part` turns in the
        bind pose, as in a frame of a walk: limbs are at mirrored places of such a node. Else the identity."""
        ways = [self.way(node, self.joints[side + part]) for side in SIDES if side + part in self.joints]
        still = np.array([1.0, 0.0, 0.0, 0.0])
        if len(ways) < 2 or ways[0] is None or ways[1] is None or np.allclose(ways[0], ways[1]):
            return still
        turn = rotation.between(self.bind[node] @ (ways[0] - ways[1]), _LEFT)
        return turn if rotation.angle_between(turn, still) > _TURNED else still

    def _carries_legs(self, node: int) -> bool:
        return any(self.way(node, self.joints[side + "UpLeg"]) is not None for side in SIDES
                   if side + "UpLeg" in self.joints)

    def _shares(self, chain: Sequence[int]) -> list[float]:
        """Position of each node along a chain, 0 to 1."""
        ways = [self.way(above, below) for above, below in zip(chain, chain[1:], strict=False)]
        lengths = [0.0 if way is None else float(np.linalg.norm(way)) for way in ways]
        steps = np.cumsum([0.0, *lengths])
        return [float(step / steps[-1]) if steps[-1] > 0 else place / max(len(chain) - 1, 1)
                for place, step in enumerate(steps)]

    # ------------------------------------------------------------------------------------------------ arms

    def arms(self) -> list[BoneSegment]:
        """Clavicles, arms, hands and fingers."""
        out: list[BoneSegment] = []
        # Mirrored rotations: `sign` flips the axes that point sideways.
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            if side + "Shoulder" in self.joints:
                self.bone(side + "Shoulder", side + "Arm")
                out.append(self._segment(side + "Shoulder", np.eye(3)))
            upper, lower = self.bone(side + "Arm", side + "ForeArm"), self.bone(side + "ForeArm", side + "Hand")
            source_upper, source_lower = _SOURCE[side + "ForeArm"], _SOURCE[side + "Hand"]
            hinge = np.cross(upper, lower) if _angle(upper, lower) > _BENT else None
            down = np.array([0.0, -sign, 0.0])  # the axis about which our straight arm would bend forward
            out.append(self._segment(side + "Arm", _change(upper, hinge, source_upper, down)))
            along, back, source_along, source_back = self._palm(side, sign, lower)
            if back is not None:
                fore = _change(lower, back, source_lower, source_back)
                hand = frame(source_along, source_back) @ frame(along, back).T
            else:
                fore = _change(lower, hinge, source_lower, down)
                # A hand without fingers has the roll of its forearm.
                hand = swing(fore @ along, source_along) @ fore
            out += [self._segment(side + "ForeArm", fore), self._segment(side + "Hand", hand)]
            out += self._fingers(side, along, back, source_back, hand)
        return out

    def _palm(self, side: str, sign: float, forearm: Array) -> tuple[Array, Array | None, Array, Array]:
        """Directions along the hand and out of its back (None without fingers), and those of the source."""
        fingers = [finger for finger in FINGERS[1:] if f"{side}Hand{finger}1" in self.joints]
        # Two knuckles far apart give the palm's plane best.
        pair = next((pair for pair in _KNUCKLES if set(pair) <= set(fingers)), None)
        hand, source_back = self.joints[side + "Hand"], np.array([0.0, 1.0, 0.0])
        if not fingers:
            tips = [self.way(hand, node) for node, parent in enumerate(self.character.parents) if parent == hand]
            tips += [tip * self._tip_unit(hand) for node, tip in self.character.tips.items() if node == hand]
            # A single child or tip in the direction of the forearm is the end of the hand; several are fingers or
            # props.
            long = [self.bind[hand] @ tip for tip in tips if tip is not None and np.linalg.norm(tip) > 1e-3]
            along = long[0] if len(long) == 1 and _angle(long[0], forearm) < np.radians(60.0) else forearm
            return along, None, np.array([sign, 0.0, 0.0]), source_back
        middle = "Middle" if "Middle" in fingers else fingers[0]
        along = self.bone(side + "Hand", f"{side}Hand{middle}1")
        source_along = _SOURCE[f"{side}Hand{middle}1"]
        if pair is None:
            return along, None, source_along, source_back
        # The plane through the wrist and two knuckles: those between them are higher or lower than these in many hands.
        first, last = (f"{side}Hand{finger}1" for finger in pair)
        knuckles = self.bone(side + "Hand", first), self.bone(side + "Hand", last)
        return (knuckles[0] + knuckles[1], sign * np.cross(*knuckles), _SOURCE[first] + _SOURCE[last],
                sign * np.cross(_SOURCE[first], _SOURCE[last]))

    def _tip_unit(self, node: int) -> float:
        """Metres per unit of a node's local coordinates (BVH, where nothing is scaled)."""
        length = float(np.linalg.norm(self.character.translations[node]))
        return float(np.linalg.norm(self._offsets[node])) / length if length > 1e-9 else 1.0

    def _fingers(self, side: str, along: Array, back: Array | None, source_back: Array, hand: Array
                 ) -> list[BoneSegment]:
        """The finger joints; each bone points like the source's, its back towards the back of the hand."""
        out = []
        for finger in FINGERS:
            before: Array | None = None
            for place in (1, 2, 3):
                name = f"{side}Hand{finger}{place}"
                if name not in self.joints:
                    break
                way = self._phalanx(name, before)
                # A last phalanx without a tip continues in the direction of the one before.
                before = way if way is not None else before
                index = WHOLE_BODY.index(name)
                source = WHOLE_BODY.end_sites[index] if place == 3 else _SOURCE[f"{side}Hand{finger}{place + 1}"]
                if way is None:
                    out.append(self._segment(name, hand))
                elif back is None:
                    out.append(self._segment(name, swing(hand @ way, source) @ hand))
                else:
                    out.append(self._segment(name, _change(way, back, source, source_back)))
        return out

    def _phalanx(self, name: str, before: Array | None) -> Array | None:
        """[3] direction of a finger bone: to the next joint or its tip, else that of the bone before."""
        node, following = self.joints[name], name[:-1] + str(int(name[-1]) + 1)
        # A finger's last joint may have several children (nail, tip); the farthest shows the direction.
        ways = [self.way(node, self.joints[following])] if following in self.joints else [
            self.way(node, child) for child, parent in enumerate(self.character.parents) if parent == node]
        if node in self.character.tips and following not in self.joints:
            ways.append(self.character.tips[node] * self._tip_unit(node))
        long = [way for way in ways if way is not None and np.linalg.norm(way) > 1e-4]
        return self.bind[node] @ max(long, key=lambda way: float(np.linalg.norm(way))) if long else before

    # ------------------------------------------------------------------------------------------------ legs

    def legs(self) -> list[BoneSegment]:
        """Thighs, shins, feet and toes; a foot is flat in the bind pose, whatever the height of its heel."""
        out: list[BoneSegment] = []
        for side in SIDES:
            if any(side + part not in self.joints for part in ("UpLeg", "Leg", "Foot")):
                continue
            upper, lower = self.bone(side + "UpLeg", side + "Leg"), self.bone(side + "Leg", side + "Foot")
            hinge = np.cross(upper, lower) if _angle(upper, lower) > _BENT else None
            # Knees bend backwards, about the character's left.
            out += [self._segment(side + "UpLeg", _change(upper, hinge, _SOURCE[side + "Leg"], _LEFT)),
                    self._segment(side + "Leg", _change(lower, hinge, _SOURCE[side + "Foot"], _LEFT))]
            turn = np.eye(3)
            if side + "ToeBase" in self.joints:
                toes = self.bone(side + "Foot", side + "ToeBase")
                # Only the horizontal part: heels of shoes raise the ankle, and the foot is flat all the same.
                level = toes * [1.0, 0.0, 1.0]
                # The foot turns about the vertical alone; on a very high heel the toes point down and give no
                # direction.
                if np.linalg.norm(level) > 0.3 * np.linalg.norm(toes) and level[2] > 0.0:
                    turn = swing(level, _SOURCE[side + "ToeBase"] * [1.0, 0.0, 1.0])
            out.append(self._segment(side + "Foot", turn))
            if side + "ToeBase" in self.joints:
                out.append(self._segment(side + "ToeBase", turn))
        return out


def _change(bone: Array, across: Array | None, source: Array, source_across: Array) -> Array:
    """[3, 3] rotation from a bone in the bind pose to the source at rest that maps bone to bone and `across` to
    `source_across`; the shortest rotation if `across` is None or parallel to the bone."""
    # A hinge nearly parallel to the bone (cosine above 0.95) does not define its roll.
    if across is None or np.linalg.norm(across) < 1e-9 or abs(np.cos(_angle(bone, across))) > 0.95 \
            or abs(np.cos(_angle(source, source_across))) > 0.95:
        return swing(bone, source)
    return frame(source, source_across) @ frame(bone, across).T


def _place_among(source: Sequence[str], steps: Array, share: float, constant: Array) -> tuple[str, Array, str, float]:
    """The fields (joint, C, other, share) of a `BoneSegment` at position `share` among our joints at `steps`."""
    place = int(np.clip(np.searchsorted(steps, share, side="right") - 1, 0, len(source) - 1))
    if place == len(source) - 1:
        return source[place], constant, "", 0.0
    part = float(np.clip((share - steps[place]) / (steps[place + 1] - steps[place]), 0.0, 1.0))
    return source[place], constant, source[place + 1], part
