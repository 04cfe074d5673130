"""Checks a moved character: its skeleton and mesh must stand and gesture as a human body does.

A mapping is only a hypothesis. Here the character takes a few poses, and its nodes and mesh points are measured in the
world: the head over the hips, the feet lowest and on the floor, toes and eyes ahead, left on the left, limbs
of human proportions that point where those of the motion point, a mesh that follows its bones and does not tear. A
fault prevents output; a doubt is reported, so that the user looks at the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_module.errors import InputError, shown
from data_module.motion.skeletons import WHOLE_BODY
from data_module.types import Array, Motion
from gesticulator.characters.frames import Body
from gesticulator.characters.mapping import SIDES, RigMapping, ancestors, node_keys
from gesticulator.characters.names import label, words
from gesticulator.characters.rig import UPS, Character, CharacterMotion
from gesticulator.characters.shape import bind_matrices
from gesticulator.contacts.limbs import pose_of


class Mover(Protocol):
    """A function that moves one character, such as a `Retargeter`. legs: whether it moves hips and legs."""

    character: Character
    mapping: RigMapping
    body: Body
    legs: bool

    def __call__(self, motion: Motion) -> CharacterMotion:
        """The motion on the character."""


_FPS = 30.0
_LEANS = 40.0
"""Largest angle of the line from hips to head from the vertical, degrees: hunched monsters reach 35."""
_ASTRAY = 3.0
"""Largest angle between a limb and that of the motion, degrees: it is 0 but for the correction of contacts."""
_BEHIND = 100.0
"""Smallest angle between feet, or eyes, and forward that counts as facing elsewhere, degrees."""
_FLOOR = 0.06
"""Largest height of the soles over the floor of the bind pose, and of anything below them, as a share of the height."""
_LIES = 50.0
"""Angle of the trunk of the bind pose from the vertical, degrees, above which it lies."""
_ON_FOURS = 125.0
"""Degrees between the trunk and the legs of the bind pose below which a body whose arms and legs are parallel stands on
four legs; 180 is straight, and a horse has 90."""
_RATIOS = {"upper arm to forearm": (0.4, 2.5), "thigh to shin": (0.4, 2.5), "arm to trunk": (0.25, 2.5),
           "leg to trunk": (0.1, 4.0), "left to right": (0.8, 1.25)}
"""Accepted ranges of human proportions, wide on purpose: toys have legs of a quarter of the trunk, some robots arms of
twice its length."""
_EVEN = (0.7, 1.43)
"""Range of the ratio of a bone's length on the left and on the right; outside it the two are different bones."""
_FAR = 1.5
"""Distance of the middle of a bone's mesh from the bone beyond that of the bind pose, as a share of its length."""
_APART = 0.2
"""The same in the bind pose itself, as a share of the height: if most bones exceed it, the mesh does not fit them."""
_STRETCH, _LONG, _TORN = 4.0, 0.08, 0.01
"""An edge of the mesh is torn if it is this many times as long as in the bind pose, and by this share of the height; a
mesh is torn if this share of its edges (by number) is."""


Remedy = str | tuple[str, ...]
"""Advice on a fault, or the joints to correct in a mapping."""
Check = Iterable[tuple[bool, str, Remedy]]
_ANOTHER = "give a human character"


@dataclass(frozen=True)
class Findings:
    """Problems of a moved character. faults: (reason, advice or the joints to correct); doubts: reasons; share:
    fraction of the checks that found nothing."""

    faults: tuple[tuple[str, Remedy], ...] = ()
    doubts: tuple[str, ...] = ()
    share: float = 1.0


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
            turns[frame, WHOLE_BODY.index(name)] = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_quat(
                scalar_first=True)
    return Motion(WHOLE_BODY, turns, np.zeros((len(poses), 3)), _FPS)


def require_sound(retargeter: Mover) -> Findings:
    """The findings for a sound character; `InputError` with the reason and the line of the mapping to correct, for a
    fault."""
    findings = examine(retargeter)
    if findings.faults:
        reason, remedy = findings.faults[0]
        if not isinstance(remedy, str):
            keys, joints = node_keys(retargeter.character), retargeter.mapping.joints
            lines = [f'"{name}": {_quoted(keys[joints[name]]) if name in joints else "null"}' for name in remedy]
            remedy = ("name the right nodes in a mapping: --save-mapping FILE.json, correct the line "
                      f"{', '.join(lines)}, then --mapping FILE.json")
        raise InputError(retargeter.character.path, f"would come out wrong: {reason}", remedy)
    return findings


def _quoted(key: str) -> str:
    return f'"{shown(key, 60).strip(chr(39))}"'


def examine(retargeter: Mover) -> Findings:
    """Check the character in the poses of `probe_motion`; returns its problems."""
    probed = _ProbedCharacter(retargeter)
    faults: list[tuple[str, Remedy]] = []
    doubts: list[str] = []
    checks: tuple[Callable[[], Check], ...] = (
        probed.connected, probed.on_four_legs, probed.upright, probed.sides, probed.facing, probed.proportions,
        probed.directions, probed.feet, probed.following, probed.tears)
    silent = 0
    for check in checks:
        issues = list(check())
        silent += not issues
        for grave, reason, remedy in issues:
            if grave:
                faults.append((reason, remedy))
            else:
                doubts.append(reason)
    return Findings(tuple(faults), tuple(doubts), silent / len(checks))


class _ProbedCharacter:
    """A character in the poses of the probe, measured with Y up, facing +Z, in metres.

    Each check yields (whether it is a fault, the reason, advice or the joints to correct).
    """

    def __init__(self, retargeter: Mover) -> None:
        self.body, self.character = retargeter.body, retargeter.character
        self.mapping, self.joints = retargeter.mapping, retargeter.mapping.joints
        self.stands = retargeter.legs and retargeter.mapping.legs
        motion = probe_motion()
        moved = retargeter(motion)
        self.world = moved.world_matrices()
        self.places = self.world[..., :3, 3] @ self.body.axes.T * self.body.unit
        bound = bind_matrices(self.character)
        self.bound = bound[:, :3, 3] @ self.body.bind_axes.T * self.body.unit
        trunk = float(np.linalg.norm(self.bound[self.joints["Head"]] - self.bound[self.joints["Hips"]]))
        self.height = max(float(np.ptp(self.bound[list(self.joints.values()), 1])), trunk, 1e-9)
        self.skin = self.character.skin
        self.mesh = self.skin.posed(bound, self.world) @ self.body.axes.T * self.body.unit
        self.mesh_bound = self.skin.points @ self.body.bind_axes.T * self.body.unit
        self.motion = motion

    def place(self, name: str) -> Array:
        """[T, 3] a joint."""
        return self.places[:, self.joints[name]]

    def length(self, above: str, below: str) -> float:
        return float(np.linalg.norm(self.place(below) - self.place(above), axis=-1).mean())

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

    def on_four_legs(self) -> Check:
        """Arms and legs of the bind pose that are parallel, and square to the trunk, or a trunk that lies."""
        bound, at = self.bound, self.joints
        pairs = [("Arm", "Hand"), ("UpLeg", "Foot")] if self.mapping.legs else [("Arm", "Hand")]
        arms, *legs = (np.mean([bound[at[side + low]] - bound[at[side + top]] for side in SIDES], axis=0)
                       for top, low in pairs)
        shoulders = np.mean([bound[at[side + "Arm"]] for side in SIDES], axis=0)
        if legs:
            trunk = shoulders - np.mean([bound[at[side + "UpLeg"]] for side in SIDES], axis=0)
            if _degrees(trunk, legs[0]) < _ON_FOURS and _degrees(arms, legs[0]) < 45.0:
                yield True, "it stands on four legs", _ANOTHER
            return
        up = self.body.bind_axes @ UPS.get(self.character.kind, self.body.bind_axes[1])
        lies = _degrees(shoulders - bound[at["Hips"]], up) > _LIES
        # Without legs the file's up axis is the only reference.
        if lies and _degrees(arms, -up) < 45.0:
            yield True, "its trunk lies and its arms reach the floor: it stands on four legs", _ANOTHER
        elif not self.mapping.given and (lies or _degrees(bound[at["Head"]] - bound[at["Hips"]], up) > _LIES):
            yield (True, "its trunk lies and no legs are found, as in a bird, whose wings are no arms",
                   f"{_ANOTHER}, or stand it upright before the export")

    def upright(self) -> Check:
        """The head is over the hips."""
        way = self.place("Head") - self.place("Hips")
        angle = max(_degrees(direction, np.array([0.0, 1.0, 0.0])) for direction in way[:2])
        if angle > _LEANS:
            yield True, f"its head is {angle:.0f} degrees from straight above its hips", ("Hips", "Head")
        elif self.mapping.legs and self.stands:
            sockets = np.mean([self.place(side + "UpLeg") for side in SIDES], axis=0)
            if (self.place("Head")[:, 1] < sockets[:, 1] + 0.15 * self.height).any():
                yield True, "its head is not above its legs", ("Hips", "Head")

    def sides(self) -> Check:
        """Left is on the left, when the arms are stretched out."""
        for part in ("Arm", "Hand", "UpLeg", "Foot"):
            if "Left" + part in self.joints and "Right" + part in self.joints and (
                    part in ("Arm", "Hand") or self.stands):
                gap = self.place("Left" + part)[1, 0] - self.place("Right" + part)[1, 0]
                if gap < 0.0:
                    yield True, f"its left {_PLAIN[part]} is on the right", ("Left" + part, "Right" + part)
                    return

    def facing(self) -> Check:
        """Feet and eyes point ahead."""
        ahead = np.array([0.0, 0.0, 1.0])
        toes = [self.place(side + "ToeBase")[1] - self.place(side + "Foot")[1] for side in SIDES
                if self.stands and side + "ToeBase" in self.joints and side + "Foot" in self.joints]
        toes = [way * [1.0, 0.0, 1.0] for way in toes if np.linalg.norm(way * [1.0, 0.0, 1.0]) > 0.005 * self.height]
        if toes and all(_degrees(way, ahead) > _BEHIND for way in toes):
            yield True, "its toes point backwards", ("LeftFoot", "LeftToeBase")
        head = self.joints["Head"]
        eyes = [node for node, name in enumerate(self.character.names) if _is_eye(name)
                and head in ancestors(self.character.parents, node)]
        # Both eyes: their mean lies in the middle, ahead of the head joint.
        if len(eyes) >= 2:
            way = (self.places[1, eyes].mean(axis=0) - self.places[1, head]) * [1.0, 0.0, 1.0]
            if np.linalg.norm(way) > 0.01 * self.height and _degrees(way, ahead) > _BEHIND:
                yield True, "its eyes look backwards", ("LeftArm", "RightArm")

    def proportions(self) -> Check:
        """The ratios of limb lengths are those of a human or a toy."""
        ratios: list[tuple[str, float, tuple[str, ...]]] = []
        trunk = self.length("Hips", "Head")
        arms = {side: self.length(side + "Arm", side + "ForeArm") + self.length(side + "ForeArm", side + "Hand")
                for side in SIDES}
        ratios += [("upper arm to forearm", self.length(side + "Arm", side + "ForeArm")
                   / max(self.length(side + "ForeArm", side + "Hand"), 1e-9),
                   (side + "Arm", side + "ForeArm", side + "Hand")) for side in SIDES]
        ratios += [("arm to trunk", arms[side] / max(trunk, 1e-9), (side + "Arm", side + "Hand")) for side in SIDES]
        ratios.append(("left to right", arms["Left"] / max(arms["Right"], 1e-9), ("LeftArm", "RightArm")))
        if self.mapping.legs:
            legs = {side: (self.length(side + "UpLeg", side + "Leg"), self.length(side + "Leg", side + "Foot"))
                    for side in SIDES}
            ratios += [("thigh to shin", upper / max(lower, 1e-9), (side + "UpLeg", side + "Leg", side + "Foot"))
                      for side, (upper, lower) in legs.items()]
            ratios += [("leg to trunk", sum(both) / max(trunk, 1e-9), (side + "UpLeg", side + "Foot"))
                      for side, both in legs.items()]
            ratios.append(("left to right", sum(legs["Left"]) / max(sum(legs["Right"]), 1e-9),
                          ("LeftUpLeg", "RightUpLeg")))
        for above, below in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot")):
            if all(side + name in self.joints for side in SIDES for name in (above, below)):
                left, right = (self.length(side + above, side + below) for side in SIDES)
                share = left / max(right, 1e-9)
                if not _EVEN[0] < share < _EVEN[1]:
                    joints = tuple(side + name for side in SIDES for name in (above, below))
                    yield (not self.mapping.given,
                           f"its {_PLAIN[above]} is {share:.2f} times as long on the left as on the right", joints)
        for what, ratio, joints in ratios:
            low, high = _RATIOS[what]
            if not low < ratio < high:
                # Squared limits separate odd from impossible; a mapping that the user checked is never rejected here.
                grave = not self.mapping.given and not low ** 2 < ratio < high ** 2
                yield grave, f"its {_SIDE.get(joints[0][:4], '')}{what} is {ratio:.2f}, not {low:g} to {high:g}", joints

    def directions(self) -> Check:
        """Arms and legs point where those of the motion point."""
        source = pose_of(self.motion)
        for above, below in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot")):
            if "Leg" in above and not self.stands:
                continue
            for side in SIDES:
                if side + above not in self.joints or side + below not in self.joints:
                    continue
                bone = self.place(side + below) - self.place(side + above)
                wanted = source.places[side + below] - source.places[side + above]
                # Only the poses in which no hand comes near the trunk: contacts bend the others on purpose.
                angle = max(_degrees(a, b) for a, b in zip(bone[1:3], wanted[1:3], strict=True))
                if angle > (_ASTRAY if "Leg" not in above else 10.0):
                    yield (True, f"its {_SIDE[side[:4]]}{_PLAIN[above]} points {angle:.0f} degrees elsewhere",
                           (side + above, side + below))

    def feet(self) -> Check:
        """The feet are lowest, and on the floor."""
        if not self.stands:
            return
        ankles = np.mean([self.place(side + "Foot") for side in SIDES], axis=0)
        if (self.place("Hips")[:, 1] - ankles[:, 1] < 0.05 * self.height).any():
            yield True, "its feet are not below its hips", ("Hips", "LeftFoot", "RightFoot")
            return
        if not len(self.skin.points):
            return
        feet = [node for node in range(len(self.character)) if any(
            self.joints[side + "Foot"] in (node, *ancestors(self.character.parents, node)) for side in SIDES)]
        of_feet = np.isin(self._movers(), feet)
        if of_feet.sum() < 8:
            return
        # Compared with the bind pose, where a skirt or a tail may already hang lower.
        soles, lowest = self.mesh[0][of_feet, 1].min(), self.mesh[0][:, 1].min()
        before = self.mesh_bound[of_feet, 1].min() - self.mesh_bound[:, 1].min()
        if soles - lowest > before + _FLOOR * self.height:
            yield (True, f"a part of its mesh hangs {100 * (soles - lowest) / self.height:.0f} % of its height below "
                   "its feet", ("LeftFoot", "RightFoot", "Hips"))

    def following(self) -> Check:
        """The mesh of each limb is where its bone is."""
        if not len(self.skin.points):
            return
        movers = self._movers()
        apart: list[bool] = []
        for top, low in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot"), ("Head", "Head")):
            for side in SIDES if top != "Head" else ("",):
                if side + top not in self.joints or side + low not in self.joints:
                    continue
                of_limb = np.isin(movers, self._between(side + top, side + low))
                if not of_limb.any():
                    yield (top == "Head" and not self.mapping.given,
                           f"its mesh has nothing that follows the {_SIDE.get(side[:4], '')}{_PLAIN[top]}",
                           (side + top,))
                if of_limb.sum() < 8:  # too few to tell where they are
                    continue
                before = self._gap(self.mesh_bound[of_limb], self.bound, side + top, side + low)
                apart.append(before > _APART * self.height)
                after = max(self._gap(self.mesh[frame][of_limb], self.places[frame], side + top, side + low)
                            for frame in range(len(self.mesh)))
                length = max(self.length(side + top, side + low) if top != "Head" else 0.1 * self.height, 1e-9)
                if after - before > _FAR * length:
                    yield (True, f"the mesh of its {_SIDE.get(side[:4], '')}{_PLAIN[top]} is not where the bone is",
                           (side + top, side + low))
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
        torn, where = 0.0, 0
        for frame in self.mesh:
            after = np.linalg.norm(frame[a] - frame[b], axis=-1)
            split = (after > _STRETCH * before) & (after - before > _LONG * self.height)
            if split.mean() > torn:
                torn = float(split.mean())
                where = int(np.bincount(self._movers()[a[split]]).argmax())
        # A few stretched edges, as in the armpits of rough skins, are not worth a message.
        if torn > 0.0005:
            name = shown(self.character.names[where])
            yield torn > _TORN, f"its mesh tears: {100 * torn:.1f} % of its edges, most at {name}", self._nearest(where)

    # ------------------------------------------------------------------------------------------------ the mesh

    def _movers(self) -> NDArray[np.int64]:
        """[V] the node with the largest weight of each point of the mesh."""
        largest = self.skin.weights.argmax(axis=1)[:, None]
        return np.asarray(np.take_along_axis(self.skin.joints, largest, axis=1)[:, 0])

    def _between(self, top: str, low: str) -> list[int]:
        """The nodes that move with a bone: below its joint, but not below another joint."""
        taken = {node for name, node in self.joints.items() if name != top}
        out = [self.joints[top]]
        for node, parent in enumerate(self.character.parents):
            if parent in out and node not in taken:
                out.append(node)
        return out

    def _gap(self, points: Array, places: Array, top: str, low: str) -> float:
        """Metres from the middle of some points to a bone."""
        start, end = places[self.joints[top]], places[self.joints[low]]
        way = end - start
        share = np.clip((points.mean(axis=0) - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        return float(np.linalg.norm(points.mean(axis=0) - start - share * way))

    def _nearest(self, node: int) -> tuple[str, ...]:
        """The mapped joint at a node or above it."""
        back = {mapped: name for name, mapped in self.joints.items()}
        line = node, *ancestors(self.character.parents, node)
        return next(((back[above],) for above in line if above in back), ("Hips",))


_PLAIN = {"Arm": "upper arm", "ForeArm": "forearm", "Hand": "hand", "UpLeg": "thigh", "Leg": "shin", "Foot": "foot",
          "Head": "head"}
_SIDE = {"Left": "left ", "Righ": "right "}


def _degrees(a: Array, b: Array) -> float:
    """Angle between two vectors [3], degrees."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(a @ b / size, -1.0, 1.0)))) if size > 1e-12 else 180.0


def _is_eye(name: str) -> bool:
    return "eye" in words(name) and bool(label(name).side)
