"""Identifies the joints of a character: by the VRM table, names, hierarchy and positions of its nodes.

One search serves all tools. It first finds the ends (hands, feet, head), then chooses for each limb among the nodes
between trunk and end: a choice is scored by names and by plausible bone lengths, so that "LeftLeg" is a shin beside
"LeftUpLeg" and a thigh above "LeftShin", and a bone without a known name is still found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from data_module.motion.joint_map import NEEDED
from data_module.motion.skeletons import FINGERS
from data_module.types import Array
from gesticulator.characters import shape
from gesticulator.characters.mapping import ARM_PARTS, LACKS, LEG_PARTS, SIDES, SURE, RigMapping, ancestors
from gesticulator.characters.names import Label, character_labels
from gesticulator.characters.rig import UPS, Character, chosen, skeletons_of

_VRM_LIMBS = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toes")


def _vrm_bones() -> dict[str, str]:
    out = {"Hips": "hips", "Head": "head"}
    for side in SIDES:
        parts = zip((*ARM_PARTS, *LEG_PARTS), _VRM_LIMBS, strict=True)
        out |= {side + part: side.lower() + bone for part, bone in parts}
        for finger in FINGERS:
            places = ("Metacarpal", "Proximal") if finger == "Thumb" else ("Proximal", "Intermediate")
            name = side.lower() + ("Little" if finger == "Pinky" else finger)
            out |= {f"{side}Hand{finger}{number}": name + place
                    for number, place in enumerate((*places, "Distal"), start=1)}
    return out


VRM_BONES = _vrm_bones()
"""Our joint of one node -> bone of the humanoid of VRM 1.0."""
_OLDER_THUMBS = {"Metacarpal": "Proximal", "Proximal": "Intermediate", "Distal": "Distal"}
"""Joint of a thumb in VRM 1.0 -> its name in 0.x."""
_LONGEST_PATH = 14
"""Most nodes of a limb among which joints are chosen; of longer limbs the nodes nearest to the end."""
_METACARPAL = 0.45
"""A finger starts with a metacarpal if its first joint is nearer to the wrist than this share of the distance to its
second joint: knuckles are at 0.65 in hands, bases of metacarpals at 0.3 in rigs."""
_UNKNOWN, _FINGERED = 6, 9
"""Bones below a hand that are not known as fingers, above which they may be, unless so many are known."""
_BACKWARDS = 0.5
"""Cosine between feet and backwards above which the sides in names are taken for exchanged."""
_BY_NAME, _BY_SECOND_NAME, _BY_SHAPE = 1.0, 0.95, 0.7
"""Confidence of a joint with a matching name, a name that other tools give to its neighbour, or no known name."""


@dataclass(frozen=True)
class Search:
    """Input of the search: the hierarchy, labels and positions of N nodes."""

    character: Character
    labels: tuple[Label, ...]
    places: Array
    """[N, 3] positions in the bind pose, in the file's units and axes."""
    up: Array
    """[3] the up direction."""

    def named(self, side: str, *parts: str) -> list[int]:
        """The joints that are one of these parts on a side by their names."""
        return [node for node, entry in enumerate(self.labels) if entry.side == side and entry.is_a(*parts)]

    @property
    def aids(self) -> frozenset[int]:
        """The nodes that are not joints according to their names."""
        return frozenset(node for node, entry in enumerate(self.labels) if entry.aid)

    def path(self, top: int, node: int) -> list[int]:
        """The nodes from below `top` (-1: from the root) down to `node`."""
        line = [node, *ancestors(self.character.parents, node)]
        return (line[:line.index(top)] if top >= 0 else line)[::-1]

    def meeting(self, a: int, b: int) -> int:
        """The lowest common ancestor of two nodes (possibly one of them); -1 for none."""
        line = {a, *ancestors(self.character.parents, a)}
        return next((node for node in [b, *ancestors(self.character.parents, b)] if node in line), -1)

    def length(self, a: int, b: int) -> float:
        """Distance between two nodes in the file's units."""
        return float(np.linalg.norm(self.places[a] - self.places[b]))


def find_joints(character: Character) -> RigMapping:
    """The best mapping of the character's joints, with its confidence and doubts; `mapping.check` rejects it."""
    if character.humanoid:
        return _from_vrm(character)
    labels = character_labels(character)
    places = shape.bind_matrices(character)[:, :3, 3]
    # glTF and Blender define the up axis; BVH does not.
    ups = list(np.eye(3)[[1, 2, 0]])
    if character.kind in UPS:  # and those of a body that lies where the file places it
        ups = [UPS[character.kind], *(sign * axis for axis in character.space.T for sign in (1.0, -1.0))]
    candidates = []
    for up in ups:
        search = Search(character, labels, places, up)
        candidates.append(_found(search))
        # The first axis that gives a plausible body is up; the others are tried only for doubtful ones.
        if candidates[-1].confidence >= 0.9:
            break
    best = max(candidates, key=_worth)
    if character.skinless and best.confidence < _BY_SECOND_NAME:
        # A car has as many nodes as a body; without a skin, names alone tell joints from them.
        best = replace(best, confidence=_BY_SHAPE * best.confidence, doubts=(*best.doubts, "it has no skin"))
    whole = [mapping for name in _skeletons_mixed(character, best)
             if set(NEEDED) <= (mapping := find_joints(chosen(character, name))).joints.keys()]
    # If none of them is a body, they are disconnected parts of one; `check` reports that later.
    return max(whole, key=_worth) if whole else best


def _worth(mapping: RigMapping) -> tuple[bool, float, int]:
    """Sort key of mappings, the best the largest: confident with legs first, then the confidence, then the joints."""
    return mapping.legs and mapping.confidence >= SURE, round(mapping.confidence, 2), len(mapping.joints)


def _skeletons_mixed(character: Character, mapping: RigMapping) -> list[str]:
    """The file's skeletons, if the mapping mixes two that stand beside one another (a rider and a horse); else none."""
    skeletons = skeletons_of(character)
    inside = {top: character.under([top]) for top in skeletons.values()}
    used = [top for top, nodes in inside.items() if nodes[list(mapping.joints.values())].any()]
    beside = any(not inside[first][second] and not inside[second][first] for first in used for second in used
                 if first != second)
    return list(skeletons) if beside else []


# ---------------------------------------------------------------------------------------------------- by the table

def _from_vrm(character: Character) -> RigMapping:
    """The mapping given by the file's VRM table."""
    table = character.humanoid
    joints = {}
    for joint, bone in VRM_BONES.items():
        stem, thumb, place = bone.partition("Thumb")
        if thumb and character.vrm != "1.0":
            bone = stem + thumb + _OLDER_THUMBS[place]
        if bone in table:
            joints[joint] = table[bone]
    spine = tuple(table[bone] for bone in ("spine", "chest", "upperChest") if bone in table)
    neck = (table["neck"],) if "neck" in table else ()
    exchanged: list[str] = []
    up = UPS.get(character.kind, np.eye(3)[1])
    joints = _turned_round(Search(character, (), shape.bind_matrices(character)[:, :3, 3], up), joints, True, exchanged)
    missing = [name for name in NEEDED if name not in joints]
    doubts = (*exchanged, *((f"its VRM table lacks {', '.join(missing)}",) if missing else ()))
    return RigMapping(joints, spine, neck, 0.0 if missing else 1.0, doubts)


# ---------------------------------------------------------------------------------------------------- by all else

def _found(search: Search) -> RigMapping:
    ends = _ends(search)
    joints: dict[str, int] = {}
    # Confidence of each joint found.
    sure: dict[str, float] = {}
    doubts: list[str] = []
    joints |= _legs_without_feet(search, ends)
    for kind, parts in (("Hand", ARM_PARTS), ("Foot", LEG_PARTS)):
        pair = [ends.get(side + kind) for side in SIDES]
        if pair[0] is None or pair[1] is None:
            doubts.append(f"its {'arms' if kind == 'Hand' else 'legs'} cannot be identified")
            continue
        # Both limbs hang on this node, so everything below it belongs to one of them.
        top = search.meeting(pair[0], pair[1])
        for side, end in zip(SIDES, pair, strict=True):
            assert end is not None
            chosen, how = _limb(search, _below(search, top, end), side, parts)
            joints |= chosen
            sure |= how
    trunk = _trunk(search, joints, ends.get("Head"), doubts)
    if trunk is not None:
        hips, spine, neck, head, how = trunk
        joints, sure = {"Hips": hips, "Head": head, **joints}, {**sure, **how}
    else:  # not usable; joints known by name alone shorten the list of missing ones in the message
        spine = neck = ()
        for name in NEEDED:
            side = next((side for side in SIDES if name.startswith(side)), "")
            nodes = search.named(side, name.removeprefix(side))
            if len(nodes) == 1:
                joints.setdefault(name, nodes[0])
    for side in SIDES:
        if side + "Hand" in joints:
            joints |= (fingers := _fingers(search, side, joints[side + "Hand"]))
            bones = int((search.character.under([joints[side + "Hand"]]) & search.character.skinned).sum())
            if len(fingers) < min(bones - _UNKNOWN, _FINGERED):
                doubts.append(f"its {side.lower()} hand has {bones} bones, and {len(fingers)} are known as fingers")
    joints = _turned_round(search, joints, any(search.labels[node].side for name, node in ends.items()
                                               if name != "Head"), doubts)
    confidence = _confidence(search, joints, sure, doubts)
    return RigMapping(joints, spine, neck, confidence, tuple(doubts))


def _legs_without_feet(search: Search, ends: Mapping[str, int]) -> dict[str, int]:
    """Thighs and shins by name of legs whose feet hang elsewhere, as controls of inverse kinematics do."""
    out: dict[str, int] = {}
    for side in SIDES:
        for part in ("UpLeg", "Leg"):
            nodes = search.named(side, part)
            if len(nodes) != 1 or nodes[0] in ancestors(search.character.parents, ends.get(side + "Foot", -1)):
                return {}
            out[side + part] = nodes[0]
    return out


def _ends(search: Search) -> dict[str, int]:
    """Hands, feet (or toes) and head: by name, else by the shape of the tree."""
    out: dict[str, int] = {}
    parents = search.character.parents
    for side in SIDES:
        for kind, wanted in (("Hand", ("Hand",)), ("Foot", ("ToeBase", "Foot"))):
            def rank(node: int, side: str = side, kind: str = kind) -> tuple[int, int, int]:
                # The hand nearest to the arm (a palm below it is not the hand), the farthest part of the foot.
                limb = sum(bool(search.labels[above].parts) and search.labels[above].side == side
                           for above in ancestors(search.character.parents, node))
                return (limb, 0, -node) if kind == "Foot" else (min(limb, 3), parents.count(node), -node)

            if nodes := search.named(side, *wanted):
                out[side + kind] = max(nodes, key=rank)
    heads = search.named("", "Head")
    if heads:
        out["Head"] = min(heads, key=lambda node: (-_nearness(search, node, out), len(ancestors(parents, node)), node))
    # Names gave fewer than two hands, two feet and a head.
    if len(out) < 5:
        for name, node in _ends_by_shape(search).items():
            # Not the same node for one hand by name and the other by shape.
            taken = [out.get(side + kind) for side in SIDES for kind in ("Hand", "Foot") if name.endswith(kind)]
            if name not in out and node not in taken and not _ends_another(search, name, node, out):
                out[name] = node
    return out


def _nearness(search: Search, head: int, ends: Mapping[str, int]) -> int:
    """How far down the tree a head meets the trunk that the hands hang on: a bone or a mesh of that name beside the
    skeleton meets it nowhere. 0 while the hands are unknown."""
    hands = [ends[side + "Hand"] for side in SIDES if side + "Hand" in ends]
    if len(hands) < 2:
        return 0
    trunk = search.meeting(*hands)
    meeting = search.meeting(trunk, head) if trunk >= 0 else -1
    return -1 if meeting < 0 else len(ancestors(search.character.parents, meeting))


def _ends_by_shape(search: Search) -> dict[str, int]:
    """Hands and feet by position; left and right are those of the names, as positions do not tell."""
    ends = shape.limb_ends(search.character, search.places, search.up, search.aids)
    named = {name: next((search.labels[above].side for above in (node, *ancestors(search.character.parents, node))
                         if search.labels[above].side), "") for name, node in ends.items()}
    agree = [name.startswith(side) for name, side in named.items() if side]
    if agree.count(False) < 2 or agree.count(False) <= agree.count(True):
        return ends
    return _exchanged(ends)


def _ends_another(search: Search, name: str, node: int, ends: Mapping[str, int]) -> bool:
    """Whether the end of a limb by position, a hand or a foot, is by name in a limb of the other kind: in one whose end
    is known, or while the end on the other side is known by name. (Forelegs of animals may be named as legs.)"""
    parts, kind, other = (LEG_PARTS, "Hand", "Foot") if name.endswith("Hand") else (ARM_PARTS, "Foot", "Hand")
    limb = {above for above in (node, *ancestors(search.character.parents, node))
            if search.labels[above].parts[:1] in {(part,) for part in parts}}
    known = {above for side in SIDES for end in (ends.get(side + other, -1),)
             for above in (end, *ancestors(search.character.parents, end))}
    named = any(side + kind != name and side + kind in ends and kind in search.labels[ends[side + kind]].parts
                for side in SIDES)
    return bool(limb & known) or (bool(limb) and named)


def _below(search: Search, top: int, end: int) -> list[int]:
    """The nodes of a limb from below the trunk to its end, and on to the toes."""
    path = search.path(top, end)
    while len(toes := [node for node, parent in enumerate(search.character.parents)
                       if parent == (path or [end])[-1] and search.labels[node].is_a("ToeBase", "Foot")]) == 1:
        path += toes
    return path[-_LONGEST_PATH:]


def _limb(search: Search, path: Sequence[int], side: str, parts: Sequence[str]
          ) -> tuple[dict[str, int], dict[str, float]]:
    """The best choice of nodes on a path for the four parts of a limb, with the confidence of each.

    An arm may lack its clavicle (the first part), a leg its toes (the last). Helper nodes (twist bones) are chosen only
    if there is nothing else.
    """
    arm = parts is ARM_PARTS
    best = -np.inf
    chosen: tuple[int, ...] = ()
    used: tuple[str, ...] = ()
    shorter = parts[1:] if arm else parts[:-1]
    for wanted in (tuple(parts), tuple(shorter)):
        # At most C(14, 4) = 1001 choices, so all of them are scored.
        for nodes in combinations(path, len(wanted)):
            score = sum(_name_score(search.labels[node], part, side) for node, part in zip(nodes, wanted, strict=True))
            score += _shape_score(search, nodes, wanted, path)
            if score > best:
                best, chosen, used = score, nodes, wanted
    out = {side + part: node for part, node in zip(used, chosen, strict=True)}
    how = {side + part: _sureness(search.labels[node], part) for part, node in zip(used, chosen, strict=True)}
    return out, how


def _name_score(name_label: Label, part: str, side: str) -> float:
    """Score of a name for a part of a limb."""
    if name_label.aid or name_label.tip:
        return -4.0
    if not name_label.parts:
        return 0.0
    if name_label.side != side or part not in name_label.parts:
        return -3.0
    return 3.0 if name_label.parts[0] == part else 2.0


def _sureness(name_label: Label, part: str) -> float:
    if part not in name_label.parts:
        return _BY_SHAPE
    return _BY_NAME if name_label.parts[0] == part else _BY_SECOND_NAME


def _shape_score(search: Search, nodes: Sequence[int], parts: Sequence[str], path: Sequence[int]) -> float:
    """Score of a limb's shape: two long bones of similar length, the rest short."""
    at = dict(zip(parts, nodes, strict=True))
    upper, lower, end = (at[part] for part in (ARM_PARTS[1:] if "Hand" in at else LEG_PARTS[:3]))
    first, second = search.length(upper, lower), search.length(lower, end)
    whole = sum(search.length(a, b) for a, b in zip(path, path[1:], strict=False)) or 1.0
    # A bone of almost no length is a helper at the joint, not a limb.
    if min(first, second) < 0.02 * whole:
        return -6.0
    # Upper and lower arm, thigh and shin differ in length by less than a fifth in people.
    score = -abs(float(np.log(first / second))) + 2.0 * (first + second) / whole
    if "Hand" in at:
        branches = sum(parent == end for parent in search.character.parents)
        score += 0.5 * min(branches, 4) + (0.3 if "Shoulder" in at else 0.0)
    else:
        # The ankle is at the lower end of the leg; toes are near the floor and ahead of it.
        score += 0.3 if "ToeBase" in at else 0.0
        score -= 2.0 * abs(float((search.places[end] - search.places[path[-1]]) @ search.up)) / whole
    return score


def _trunk(search: Search, joints: Mapping[str, int], head: int | None, doubts: list[str]
           ) -> tuple[int, tuple[int, ...], tuple[int, ...], int, dict[str, float]] | None:
    """Hips, spine, neck and head, with the confidence of hips and head; None without a head."""
    arms = [joints[side + "Arm"] for side in SIDES if side + "Arm" in joints]
    legs = [joints[side + "UpLeg"] for side in SIDES if side + "UpLeg" in joints]
    if not arms:
        return None
    fork = search.meeting(arms[0], arms[-1])
    head_sure = _BY_NAME
    if head is not None and not search.character.skinned[head] and any(
            search.labels[node].parts[:1] == ("Spine",) for node in search.path(search.meeting(fork, head), fork)):
        head = None  # a mesh or a control of this name beside the spine
    if head is None:
        head = shape.head_above(search.character, search.places, search.up, fork, joints.values(), search.aids)
        head_sure = _BY_SHAPE
        if head is None:
            doubts.append("its head cannot be identified")
            return None
    fork = search.meeting(fork, head)
    # Hips join the legs and the trunk.
    meeting = search.meeting(search.meeting(legs[0], legs[-1]), fork) if legs else fork
    line = [meeting, *ancestors(search.character.parents, meeting)] if meeting >= 0 else []
    named = [node for node in line if search.labels[node].parts[:1] == ("Hips",) and not search.labels[node].aid]
    if named:
        hips, hips_sure = named[0], _BY_NAME
    elif legs and meeting >= 0:
        hips, hips_sure = meeting, _BY_SHAPE if search.labels[meeting].parts[:1] != ("Spine",) else _BY_SECOND_NAME
    elif line:  # an upper body only: its first node carries it
        hips, hips_sure = next((node for node in reversed(line) if search.character.skinned[node]), line[-1]), _BY_SHAPE
    else:
        doubts.append("its arms and its head have no node in common")
        return None
    way = [node for node in search.path(hips, head) if node != head]
    # Where names tell, the neck begins at its first named joint.
    first_neck = next((place for place, node in enumerate(way) if search.labels[node].parts[:1] == ("Neck",)), None)
    if first_neck is None:
        # Without names the neck begins above the fork of the arms; arms attached to the neck are below the fork.
        first_neck = way.index(fork) + 1 if fork in way else len(way)
        over = np.mean([search.places[arm] @ search.up for arm in arms]) < search.places[fork] @ search.up
        if over and first_neck > 1:
            first_neck -= 1
    spine, neck = (tuple(_distinct(search, [hips, *part])) for part in (way[:first_neck], way[first_neck:]))
    return hips, spine[1:], neck[1:], head, {"Hips": hips_sure, "Head": head_sure}


def _distinct(search: Search, chain: Sequence[int]) -> list[int]:
    """A chain without nodes that coincide with their predecessor; the first is always kept."""
    out = list(chain[:1])
    # Some exporters double a joint in the same place, for a constraint.
    small = 1e-4 * float(np.ptp(search.places @ search.up))
    out += [node for above, node in zip(chain, chain[1:], strict=False) if search.length(above, node) > small]
    return out


def _fingers(search: Search, side: str, hand: int) -> dict[str, int]:
    """The finger joints under a hand: by name, else by position."""
    chains: dict[str, list[int]] = {finger: [] for finger in FINGERS}
    for node in map(int, np.flatnonzero(search.character.under([hand]))):
        entry = search.labels[node]
        if entry.finger and not entry.tip and not entry.aid and entry.side in ("", side):
            chains[entry.finger].append(node)
    if not any(chains.values()):
        chains = shape.finger_chains(search.character, search.places, hand)
    out: dict[str, int] = {}
    for finger, chain in chains.items():
        line = _one_line(search, chain)
        if finger != "Thumb":
            line = [node for node in line if search.labels[node].number != "Metacarpal"]
            if len(line) >= 4 and search.length(hand, line[0]) < _METACARPAL * search.length(hand, line[1]):
                line = line[1:]
        if len(line) >= 2:  # skip single joints: placeholders without motion data
            out |= {f"{side}Hand{finger}{place}": node for place, node in enumerate(line[:3], start=1)}
    return out


def _one_line(search: Search, nodes: Sequence[int]) -> list[int]:
    """The longest chain of descendants among the nodes."""
    best: list[int] = []
    for node in nodes:
        line = [above for above in reversed(ancestors(search.character.parents, node)) if above in nodes] + [node]
        best = max(best, line, key=len)
    return best


def _turned_round(search: Search, joints: dict[str, int], named: bool, doubts: list[str]) -> dict[str, int]:
    """Exchanges left and right if the feet show that it faces backwards. named: whether the names give sides."""
    if not named:
        doubts.append("its names do not distinguish left from right")
    ahead = shape.feet_ahead(search.character, search.places, search.up, joints)
    if ahead is None or ahead > (-_BACKWARDS if named else 0.0):
        return joints
    if named:
        doubts.append("its names have left and right exchanged, as its feet show")
    return _exchanged(joints)


def _exchanged(joints: Mapping[str, int]) -> dict[str, int]:
    """The joints with left and right in each other's place."""
    other = {"Left": "Right", "Right": "Left"}
    return {next((other[side] + name.removeprefix(side) for side in SIDES if name.startswith(side)), name): node
            for name, node in joints.items()}


def _confidence(search: Search, joints: Mapping[str, int], sure: Mapping[str, float], doubts: list[str]) -> float:
    """Confidence, 0 to 1: the mean over the joints found, reduced for each implausible proportion."""
    if any(name not in joints for name in NEEDED):
        doubts.append(f"{LACKS}{', '.join(name for name in NEEDED if name not in joints)}")
        return 0.0
    value = float(np.mean([sure[name] for name in sure if name in joints]))
    arm, trunk = (search.length(joints["LeftArm"], joints["LeftForeArm"]),
                  abs(float((search.places[joints["Head"]] - search.places[joints["Hips"]]) @ search.up)))
    # About a half in an adult; the range leaves room for stylised proportions.
    if not 0.15 < arm / max(trunk, 1e-9) < 1.2:
        doubts.append(f"an upper arm is {arm / trunk:.2f} of the height from hips to head" if trunk > 0.1 * arm else
                      "its head is no higher than its hips")
        value *= 0.7
    return value
