"""Checks a moved character: its skeleton and mesh must stand and gesture as a human body does.

A mapping is only a hypothesis. Here the character takes a few poses, and its nodes and mesh points are measured in the
world: a trunk upright on two legs, toes ahead, limbs of human proportions that point where those of the motion
point, a mesh that follows its bones and does not tear. A fault prevents output; a doubt is reported, so that the user
looks at the result.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from data_module.errors import InputError, shown
from data_module.motion import rotation
from data_module.motion.skeletons import WHOLE_BODY
from data_module.types import Array, Motion
from gesticulator.characters.frames import Body
from gesticulator.characters.mapping import ARM_PARTS, LEG_PARTS, SIDES, ancestors, node_keys
from gesticulator.characters.rig import UPS, CharacterMotion
from gesticulator.characters.shape import bind_matrices, feet_ahead
from gesticulator.contacts.limbs import pose_of

_ASTRAY, _LEGS_ASTRAY = 3.0, 10.0
"""Largest angle between a limb and that of the motion, degrees: in arms it is 0 but for the correction of contacts; of
legs, which bend so that feet stay on the floor."""
_BEHIND = -0.17
"""Cosine between the feet and forward below which the character faces elsewhere: 100 degrees."""
_LIES = 50.0
"""Angle of the trunk of the bind pose from the vertical, degrees, above which it lies."""
_ON_FOURS, _PARALLEL = 125.0, 45.0
"""Degrees between the trunk and the legs of the bind pose below which a body whose arms and legs are parallel, within
the second, stands on four legs; 180 is straight, and a horse has 90."""
_TO_LOWER, _TO_TRUNK = (0.4, 2.5), {"arm": (0.25, 2.5), "leg": (0.1, 4.0)}
"""Accepted ratios of the bones of a limb, and of a limb to the trunk, wide on purpose: toys have legs of a quarter of
the trunk, some robots arms of twice its length."""
_EVEN = (0.7, 1.43)
"""Range of the ratio of a bone's length on the left and on the right; outside it the two are different bones."""
_FAR = 1.5
"""Distance of the middle of a bone's mesh from the bone beyond that of the bind pose, as a share of its length."""
_APART = 0.2
"""The same in the bind pose itself, as a share of the height: if most bones exceed it, the mesh does not fit them."""
_STRETCH, _LONG, _TORN, _ROUGH = 4.0, 0.08, 0.01, 0.0005
"""An edge of the mesh is torn if it is this many times as long as in the bind pose, and by this share of the height; a
mesh is torn if this share of its edges (by number) is. A smaller share than the last is not worth a message: armpits of
rough skins stretch."""
_FEWEST = 8
"""Points of a mesh below which they do not tell where a limb is."""
_LIMBS = {"arm": ARM_PARTS[1:], "leg": LEG_PARTS[:3]}
_PLAIN = {"Arm": "upper arm", "ForeArm": "forearm", "Hand": "hand", "UpLeg": "thigh", "Leg": "shin", "Foot": "foot",
          "Head": "head"}

Remedy = str | tuple[str, ...]
"""Advice on a fault, or the joints to correct in a mapping."""
Check = Iterator[tuple[bool, str, Remedy]]
"""Of each problem: whether it is a fault, the reason, and the remedy."""


def probe_motion() -> Motion:
    """Five poses of the default body, for the checks: arms hanging, aside, ahead, one up; a turned trunk."""
    poses: list[dict[str, tuple[float, float, float]]] = [
        {"LeftArm": (0, 0, -78), "RightArm": (0, 0, 78)},
        {},
        {"LeftArm": (0, -70, -25), "RightArm": (0, 70, 25), "LeftForeArm": (0, -35, 0), "RightForeArm": (0, 35, 0)},
        {"LeftArm": (0, -20, 55), "RightArm": (0, 0, 75), "LeftForeArm": (0, -60, 0), "Head": (0, 15, 0)},
        {"LeftArm": (0, -30, -60), "RightArm": (0, 30, 60), "LeftForeArm": (0, -80, 0), "RightForeArm": (0, 80, 0),
         "Spine1": (0, 12, 0), "Head": (10, -10, 0)},
    ]
    turns = np.zeros((len(poses), len(WHOLE_BODY), 4))
    turns[..., 0] = 1.0
    for frame, pose in enumerate(poses):
        for name, angles in pose.items():
            turns[frame, WHOLE_BODY.index(name)] = rotation.from_euler(np.radians(angles[::-1]), "ZYX")
    # A frame a second: contacts, which are spread over parts of a second, see each pose by itself.
    return Motion(WHOLE_BODY, turns, np.zeros((len(poses), 3)), 1.0)


def require_sound(body: Body, moved: tuple[CharacterMotion, CharacterMotion], stands: bool
                  ) -> tuple[tuple[str, ...], float]:
    """The doubts about a sound character, and the share of the checks that found nothing; for a fault `InputError` with
    the line of the mapping to correct. moved: in the poses of `probe_motion`, without contacts and as it is written.
    stands: whether hips and legs are moved."""
    probed = _Probe(body, moved, stands)
    problems = [list(check()) for check in (
        probed.connected, probed.human, probed.facing, probed.proportions, probed.directions, probed.following,
        probed.tears)]
    for reason, remedy in ((reason, remedy) for some in problems for grave, reason, remedy in some if grave):
        if not isinstance(remedy, str):
            keys, joints = node_keys(body.character), body.mapping.joints
            quoted = {name: f'"{shown(keys[joints[name]], 60).strip(chr(39))}"' for name in remedy if name in joints}
            remedy = ("name the right nodes in a mapping: --save-mapping FILE.json, correct the line "
                      + ", ".join(f'"{name}": {quoted.get(name, "null")}' for name in remedy)
                      + ", then --mapping FILE.json")
        raise InputError(body.character.path, f"would come out wrong: {reason}", remedy)
    doubts = tuple(reason for some in problems for _, reason, _ in some)
    return doubts, sum(not some for some in problems) / len(problems)


class _Probe:
    """A character in the poses of the probe, measured with Y up, facing +Z, in metres."""

    def __init__(self, body: Body, moved: tuple[CharacterMotion, CharacterMotion], stands: bool) -> None:
        self.body, self.character, self.stands = body, body.character, stands
        self.mapping, self.joints = body.mapping, body.mapping.joints
        bound, to_posed, to_bound = bind_matrices(self.character), self.body.axes.T, self.body.bind_axes.T
        plain, world = (each.world_matrices() for each in moved)
        self.plain, self.places = (each[..., :3, 3] @ to_posed * self.body.unit for each in (plain, world))
        self.bound = bound[:, :3, 3] @ to_bound * self.body.unit
        trunk = float(np.linalg.norm(self.bound[self.joints["Head"]] - self.bound[self.joints["Hips"]]))
        self.height = max(float(np.ptp(self.bound[list(self.joints.values()), 1])), trunk, 1e-9)
        self.skin = self.character.skin
        self.mesh = self.skin.posed(bound, world) @ to_posed * self.body.unit
        self.mesh_bound = self.skin.points @ to_bound * self.body.unit
        # The node with the largest weight of each point.
        self.movers = np.take_along_axis(self.skin.joints, self.skin.weights.argmax(axis=1)[:, None], axis=1)[:, 0]

    def place(self, name: str) -> Array:
        """[T, 3] a joint."""
        return self.places[:, self.joints[name]]

    def length(self, above: str, below: str) -> float:
        return float(np.linalg.norm(self.place(below) - self.place(above), axis=-1).mean())

    def bones(self, limbs: tuple[str, ...] = ("arm", "leg")) -> Iterator[tuple[str, str, str]]:
        """The bones of the limbs that are mapped: side, part, and part below it."""
        for limb in limbs:
            for above, below in pairwise(_LIMBS[limb]):
                yield from ((side, above, below) for side in SIDES
                            if side + above in self.joints and side + below in self.joints)

    # ------------------------------------------------------------------------------------------------ the checks

    def connected(self) -> Check:
        """The arms hang on the spine."""
        for side in SIDES:
            arm = self.joints[side + "Arm"]
            if self.mapping.spine and not set(self.mapping.spine) & set(ancestors(self.character.parents, arm)):
                chest, name = (shown(self.character.names[node]) for node in (self.mapping.spine[-1], arm))
                yield (True, f"{name} does not hang on its spine, and would stay behind",
                       f"put the bones into one tree before the export: make {chest} the parent of the shoulders, and "
                       "the hips that of the thighs")
                return

    def human(self) -> Check:
        """The trunk of the bind pose is upright on two legs; without legs, in the file."""
        def middle(part: str) -> Array:
            return np.mean([self.bound[self.joints[side + part]] for side in SIDES], axis=0)

        arms = middle("Hand") - middle("Arm")
        if self.mapping.legs:
            legs = middle("Foot") - middle("UpLeg")
            animal = _degrees(middle("Arm") - middle("UpLeg"), legs) < _ON_FOURS and _degrees(arms, legs) < _PARALLEL
        else:  # the file's up axis is the only reference
            up, hips = self.body.bind_axes @ UPS.get(self.character.kind, self.body.bind_axes[1]), self.joints["Hips"]
            lies = _degrees(middle("Arm") - self.bound[hips], up) > _LIES
            leans = _degrees(self.bound[self.joints["Head"]] - self.bound[hips], up) > _LIES
            animal = (lies and _degrees(arms, -up) < _PARALLEL) or (not self.mapping.given and (lies or leans))
        if animal:
            yield (True, "its trunk is not upright on two legs: it stands on four legs, or lies as a bird does",
                   "give a human character, or stand it upright before the export")

    def facing(self) -> Check:
        """The feet point ahead, given left and right."""
        bound = bind_matrices(self.character)[:, :3, 3]
        ahead = feet_ahead(self.character, bound, self.body.bind_axes[1], self.joints)
        if self.stands and ahead is not None and ahead < _BEHIND:
            yield True, "its toes point backwards", ("LeftFoot", "LeftToeBase")

    def proportions(self) -> Check:
        """The ratios of limb lengths are those of a human or a toy."""
        bones = list(self.bones())
        for side, above, below in bones:
            if side == "Left" and ("Right", above, below) in bones:
                share = self.length("Left" + above, "Left" + below) / max(
                    self.length("Right" + above, "Right" + below), 1e-9)
                if not _EVEN[0] < share < _EVEN[1]:
                    joints = tuple(side + part for side in SIDES for part in (above, below))
                    yield (not self.mapping.given,
                           f"its {_PLAIN[above]} is {share:.2f} times as long on the left as on the right", joints)
        trunk = max(self.length("Hips", "Head"), 1e-9)
        for side in SIDES:
            for limb in ("arm", *(("leg",) if self.mapping.legs else ())):
                joints = tuple(side + part for part in _LIMBS[limb])
                upper, lower = (self.length(above, below) for above, below in pairwise(joints))
                for ratio, value, (low, high) in (("upper to lower", upper / max(lower, 1e-9), _TO_LOWER),
                                                  ("to trunk", (upper + lower) / trunk, _TO_TRUNK[limb])):
                    if not low < value < high:
                        # Squared limits separate odd from impossible; a mapping that the user checked is never
                        # rejected here.
                        grave = not self.mapping.given and not low ** 2 < value < high ** 2
                        yield (grave, f"its {side.lower()} {limb} {ratio} is {value:.2f}, not {low:g} to {high:g}",
                               joints)

    def directions(self) -> Check:
        """Arms and legs point where those of the motion point."""
        source = pose_of(probe_motion())
        for side, above, below in self.bones(("arm", "leg") if self.stands else ("arm",)):
            bone = self.plain[:, self.joints[side + below]] - self.plain[:, self.joints[side + above]]
            wanted = source.places[side + below] - source.places[side + above]
            angle = max(_degrees(a, b) for a, b in zip(bone[1:3], wanted[1:3], strict=True))
            if angle > (_LEGS_ASTRAY if "Leg" in above else _ASTRAY):
                yield (True, f"its {side.lower()} {_PLAIN[above]} points {angle:.0f} degrees elsewhere",
                       (side + above, side + below))

    def following(self) -> Check:
        """The mesh of each limb is where its bone is."""
        if not len(self.skin.points):
            return
        if self.skin.loose > _TORN:
            yield (False, f"{self.skin.loose:.0%} of the corners of its mesh have skin weights that are 0 or not "
                   "numbers: players show them elsewhere, or not at all", "weight them and export it again")
        apart: list[bool] = []
        for side, above, below in (*self.bones(), ("", "Head", "Head")):
            top, low, head = side + above, side + below, not side
            name = f"{side.lower()} {_PLAIN[above]}".strip()
            of_limb = self.character.under([self.joints[top]], set(self.joints.values()))[self.movers]
            if not of_limb.any():
                yield head and not self.mapping.given, f"its mesh has nothing that follows the {name}", (top,)
            if of_limb.sum() < _FEWEST:
                continue
            before = self._gap(self.mesh_bound[of_limb], self.bound, top, low)
            apart.append(before > _APART * self.height)
            after = max(self._gap(points[of_limb], places, top, low)
                        for points, places in zip(self.mesh, self.places, strict=True))
            length = max(0.1 * self.height if head else self.length(top, low), 1e-9)
            if after - before > _FAR * length:
                yield True, f"the mesh of its {name} is not where the bone is", (top, low)
        if 2 * sum(apart) > len(apart):
            yield (True, "its mesh is not where its bones are in the pose that it was bound in: its inverse bind "
                   "matrices are missing or of another skeleton", "export it again, with its skin")

    def tears(self) -> Check:
        """Edges of the mesh do not become much longer."""
        if not len(self.skin.triangles):
            return
        # Both ends of the three edges of each triangle.
        a, b = self.skin.triangles[:, [0, 1, 2]].ravel(), self.skin.triangles[:, [1, 2, 0]].ravel()
        before = np.linalg.norm(self.mesh_bound[a] - self.mesh_bound[b], axis=-1)
        after = np.linalg.norm(self.mesh[:, a] - self.mesh[:, b], axis=-1)
        split = (after > _STRETCH * before) & (after - before > _LONG * self.height)
        worst = split[split.mean(axis=1).argmax()]
        torn = float(worst.mean())
        if torn > _ROUGH:
            where = int(np.bincount(self.movers[a[worst]]).argmax())
            back = {node: name for name, node in self.joints.items()}
            line = where, *ancestors(self.character.parents, where)
            yield (torn > _TORN, f"its mesh tears: {100 * torn:.1f} % of its edges, most at "
                   f"{shown(self.character.names[where])}",
                   (next((back[node] for node in line if node in back), "Hips"),))

    def _gap(self, points: Array, places: Array, top: str, low: str) -> float:
        """Metres from the middle of some points to a bone."""
        start, end = places[self.joints[top]], places[self.joints[low]]
        way, middle = end - start, points.mean(axis=0)
        share = np.clip((middle - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        return float(np.linalg.norm(middle - start - share * way))


def _degrees(a: Array, b: Array) -> float:
    """Angle between two vectors [3], degrees."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(a @ b / size, -1.0, 1.0)))) if size > 1e-12 else 180.0
