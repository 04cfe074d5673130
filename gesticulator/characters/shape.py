"""Identifies limbs, head, fingers and facing from the hierarchy and positions of a character's nodes."""

from collections.abc import Collection, Iterable, Mapping

import numpy as np

from data_module.motion.skeletons import FINGERS
from data_module.types import Array
from gesticulator.characters.bvh_rig import turns_of
from gesticulator.characters.mapping import ancestors
from gesticulator.characters.rig import Character

_HEAD = 0.075
"""Share of the height that separates a head bone (longer: 0.11 in an adult) from a neck bone (0.05)."""
_FLAT = 0.005
"""Share of the height by which feet must point anywhere, both together."""
_SOLES = 0.02
"""The same of their meshes: the middle of a shoe is 4 % of the height ahead of the ankle, that of the round end of a
robot's leg nowhere, give or take a few millimetres."""
_EVEN = 0.12
"""Largest asymmetry of two mirrored ends, as a share of the body's size."""


def bind_matrices(character: Character) -> Array:
    """[N, 4, 4] world matrices in the bind pose of the mesh; at rest if unknown."""
    return character.world_matrices() if character.bind is None else character.bind


def bind_turns(character: Character) -> Array:
    """[N, 3, 3] world rotations of the nodes in the bind pose of the mesh. A node that mirrors at rest alone has its
    rotation at rest: no rotation leads there from the bind pose."""
    rest = character.world_turns()
    if character.bind is None:
        return rest
    bound = turns_of(character.bind)
    return np.where((np.linalg.det(bound) * np.linalg.det(rest) < 0.0)[:, None, None], rest, bound)


def _children(character: Character) -> list[list[int]]:
    below: list[list[int]] = [[] for _ in character.names]
    for node, parent in enumerate(character.parents):
        if parent >= 0:
            below[parent].append(node)
    return below


def limb_ends(character: Character, places: Array, up: Array, aids: Collection[int] = ()) -> dict[str, int]:
    """The last nodes of both arms and legs; left and right assume that the character faces along the third axis.

    Feet are the lowest leaves on both sides of the middle, hands those farthest from the middle; only skin joints count
    if there is a skin. aids: nodes that are no joints by name, such as those of ears, wings and weapons.
    """
    below = _children(character)
    joints = np.flatnonzero(character.skinned)
    # Fewer joints than hips, head, two arms and two legs need: no body.
    if len(joints) < 8:
        return {}
    counts = character.skinned & ~np.isin(np.arange(len(character)), list(aids))
    leaves = [int(node) for node in np.flatnonzero(counts) if not any(counts[child] for child in below[node])]
    if not leaves:
        return {}
    across = _across(places[leaves], up)
    if across is None:
        return {}
    middle = float(np.median(places[joints] @ across))
    size = float(np.ptp(places[joints] @ up))
    height, side = places @ up, places @ across - middle
    floor = min(height[leaf] for leaf in leaves)
    out: dict[str, int] = {}
    for name, sign in (("Left", 1.0), ("Right", -1.0)):
        side_leaves = [leaf for leaf in leaves if sign * side[leaf] > 0.02 * size]
        if not side_leaves:
            return {}
        low = [leaf for leaf in side_leaves if height[leaf] < floor + 0.06 * size]
        if low:
            # The deepest of the low leaves is a toe; shallower ones may be IK targets on the floor.
            out[name + "Foot"] = max(low, key=lambda leaf: len(ancestors(character.parents, leaf)))
        hands = [leaf for leaf in side_leaves if height[leaf] > floor + 0.2 * size and leaf not in low]
        if hands:
            farthest = max(sign * side[leaf] for leaf in hands)
            # Several fingertips are about equally far: the deepest in the tree is a finger, not a prop.
            near = [leaf for leaf in hands if sign * side[leaf] > farthest - _EVEN * size]
            out[name + "Hand"] = max(near, key=lambda leaf: (len(ancestors(character.parents, leaf)),
                                                            sign * side[leaf]))
    return out


def _across(leaves: Array, up: Array) -> Array | None:
    """[3] the horizontal axis of the file along which the leaves are most symmetric; None if nothing has any width."""
    names = [axis for axis in np.eye(3) if abs(axis @ up) < 0.5]
    best, best_axis = np.inf, None
    for axis in names:
        along = leaves @ axis
        width = float(np.ptp(along))
        if width < 1e-9:
            continue
        other = np.stack([leaves @ up, leaves @ np.cross(axis, up), along - np.median(along)], axis=-1)
        # Mirror at the middle; a symmetric body then lies on itself.
        flipped = other * [1.0, 1.0, -1.0]
        gap = np.linalg.norm(other[:, None] - flipped[None], axis=-1).min(axis=1).mean() / width
        if gap < best:
            best, best_axis = float(gap), axis
    return best_axis


def head_above(character: Character, places: Array, up: Array, fork: int, taken: Iterable[int],
               aids: Collection[int] = ()) -> int | None:
    """The head by position: on the path from the fork of the arms to the highest node above it that is no aid."""
    if fork < 0:
        return None
    below = _children(character)
    inside = character.under([fork]) & ~character.under(taken)
    above = [node for node in map(int, np.flatnonzero(inside)) if node != fork and node not in aids]
    if not above:
        return None
    highest = max(above, key=lambda node: float(places[node] @ up))
    way = [node for node in reversed([highest, *ancestors(character.parents, highest)]) if node in above]
    # A leaf at the crown is the end of the head bone, which is longer than neck bones; the head is its parent.
    size = float(np.ptp(places[np.flatnonzero(character.skinned)] @ up))
    crown = len(way) >= 2 and not below[way[-1]] and np.linalg.norm(places[way[-1]] - places[way[-2]]) > _HEAD * size
    return way[-2] if crown else way[-1]


def finger_chains(character: Character, places: Array, hand: int) -> dict[str, list[int]]:
    """Finger -> the nodes of its chain, for a hand with five chains of at least two nodes. The thumb is the chain that
    points away from the others."""
    below = _children(character)
    chains = []
    for base in below[hand]:
        chain = [base]
        while len(below[chain[-1]]) == 1:
            chain.append(below[chain[-1]][0])
        if len(chain) >= 2:
            chains.append(chain)
    if len(chains) != 5:
        return {}
    ways = np.array([places[chain[-1]] - places[chain[0]] for chain in chains])
    ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
    # The thumb deviates most from the median direction of the chains.
    thumb = int(np.argmin(ways @ np.median(ways, axis=0)))
    # From the thumb, the knuckles are farther and farther.
    bases = np.array([places[chain[0]] for chain in chains])
    order = np.argsort(np.linalg.norm(bases - bases[thumb], axis=1))
    return {finger: chains[place][:4] for finger, place in zip(FINGERS, order, strict=True)}


def feet_ahead(character: Character, places: Array, up: Array, joints: Mapping[str, int]) -> float | None:
    """Cosine between the direction of the feet and forward as defined by left and right: of the toes and of the mesh of
    the feet, whichever is nearer to 0 (they contradict each other: 0); None without both feet or arms."""
    if any(side + part not in joints for side in ("Left", "Right") for part in ("Arm", "Foot")):
        return None
    left = places[joints["LeftArm"]] - places[joints["RightArm"]]
    # left x up = forward in right-handed axes.
    ahead = np.cross(left, up)
    ways: list[tuple[Array, float]] = []
    if all(side + "ToeBase" in joints for side in ("Left", "Right")):
        toes = [places[joints[side + "ToeBase"]] - places[joints[side + "Foot"]] for side in ("Left", "Right")]
        ways.append((toes[0] + toes[1], _FLAT))
    meshes = [_foot_mesh(character, places, up, joints[side + "Foot"]) for side in ("Left", "Right")]
    if meshes[0] is not None and meshes[1] is not None:
        ways.append((meshes[0] + meshes[1], _SOLES))
    level = [(way - (way @ up) * up, least) for way, least in ways]
    size = float(np.ptp(places @ up))
    cosines = [float(ahead @ way / np.linalg.norm(ahead) / np.linalg.norm(way)) for way, least in level
               if np.linalg.norm(ahead) > 1e-9 and np.linalg.norm(way) > least * size]
    if not cosines:
        return None
    if min(cosines) < 0.0 < max(cosines):
        return 0.0
    return min(cosines, key=abs)


def _foot_mesh(character: Character, places: Array, up: Array, foot: int) -> Array | None:
    """[3] from the ankle to the middle of the mesh of the foot and what is below it; None without a mesh."""
    of_foot = character.under([foot])[character.flesh_nodes]
    if of_foot.sum() < 8:
        return None
    points = character.flesh[of_foot]
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2.0 - places[foot])
