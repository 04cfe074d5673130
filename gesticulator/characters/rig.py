"""A character as in its file: a tree of nodes at rest, in the file's units and axes.

A file may hold several characters; `file.glb#name` selects one of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.motion import rotation
from data_module.types import Array

__all__ = ["Character", "CharacterMotion", "Skin", "decomposed"]

UPS = {"glb": np.array([0.0, 1.0, 0.0])}
"""The up direction of each format, where the format defines it (BVH does not)."""


@dataclass(frozen=True)
class Skin:
    """Triangles of the meshes of a character, in the world of its bind pose.

    points: [V, 3]; joints: [V, K] the nodes that move each, and weights: [V, K] their shares, which add up to 1;
    triangles: [F, 3] their corners. loose: the share of the corners that have no usable weights.
    """

    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    joints: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 1), np.int64))
    weights: Array = field(default_factory=lambda: np.zeros((0, 1)))
    triangles: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    loose: float = 0.0

    def posed(self, bind: Array, world: Array) -> Array:
        """[T, V, 3] where the points are when the nodes, bound at `bind` [N, 4, 4], are at `world` [T, N, 4, 4]."""
        # Only the joints that move a vertex: a rig has many more nodes.
        used = np.unique(self.joints)
        moves = np.zeros((len(world), world.shape[1], 4, 4))
        # A joint may be flat, as a hidden prop is.
        moves[:, used] = world[:, used] @ np.linalg.pinv(bind[used])
        out = np.zeros((len(world), len(self.points), 3))
        for column in range(self.joints.shape[1]):
            move = moves[:, self.joints[:, column]]
            out += self.weights[:, column, None] * (
                np.einsum("tvij,vj->tvi", move[..., :3, :3], self.points) + move[..., :3, 3])
        return out


@dataclass(frozen=True)
class Character:
    """The rig of a character: N nodes, parents before children, as in the file.

    names: N names as the file spells them; in glTF they may be empty or repeat, so nodes are identified by their index.
    parents: N indices, -1 for a root (there may be several: cameras, props, the mesh beside the armature).
    translations: [N, 3], rotations: [N, 4] (unit quaternions, w first), scales: [N, 3]: the local transform of each
        node at rest, in its parent's frame: x_parent = translation + rotation * (scale * x), in the file's unit.
    path: the file. kind: its format, "bvh" or "glb" (also VRM, .gltf, and FBX, which Blender makes GLB).
    skinned: [N] which nodes are joints of a skin; all of them if the format has no skins (BVH).
    skinless: whether the format has skins but the file none, so that it does not say which nodes are joints.
    bind: [N, 4, 4] the world matrix of each node in the pose that the mesh was bound in (from glTF's inverse bind
        matrices), in the world of the rest pose; None if unknown. space: [3, 3] columns are the axes of the mesh in
        that world: a mesh is modelled upright along one of them, however the file places it.
    humanoid: bone of the VRM humanoid ("leftUpperArm") -> node, if the file has that table.
    vrm: version of the VRM extension, "0.x", "1.0" or "" (a VRM 0.x character faces -Z).
    unit: metres per unit of length, if defined by the format (1.0 for glTF); None: estimated during retargeting.
    node_ids: N indices of the nodes in the file (glTF's `nodes`); 0..N-1 if the format has none.
    tips: node -> [3] the end of its bone in its frame, if given (End Site of BVH).
    channels: N tuples of BVH channel names in the file's order ("Zrotation"); empty for other formats.
    flesh: [V, 3] vertices in the bind pose's world, and flesh_nodes: [V] the node with the largest weight of each; both
        empty without a mesh. skin: a sample of the triangles of the meshes.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    translations: Array
    rotations: Array
    scales: Array
    path: Path
    kind: str
    skinned: NDArray[np.bool_]
    bind: Array | None = None
    space: Array = field(default_factory=lambda: np.eye(3))
    humanoid: Mapping[str, int] = field(default_factory=dict)
    vrm: str = ""
    unit: float | None = None
    node_ids: tuple[int, ...] = ()
    tips: Mapping[int, Array] = field(default_factory=dict)
    channels: tuple[tuple[str, ...], ...] = ()
    flesh: Array = field(default_factory=lambda: np.zeros((0, 3)))
    flesh_nodes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    skin: Skin = field(default_factory=Skin)
    skinless: bool = False

    def __post_init__(self) -> None:
        if not self.node_ids:
            object.__setattr__(self, "node_ids", tuple(range(len(self.names))))

    def __len__(self) -> int:
        return len(self.names)

    def under(self, tops: Iterable[int], others: Collection[int] = ()) -> NDArray[np.bool_]:
        """[N] the nodes `tops` and those below them that are not `others` or below these."""
        inside = np.zeros(len(self), dtype=bool)
        inside[list(tops)] = True
        for node, parent in enumerate(self.parents):
            inside[node] |= parent >= 0 and bool(inside[parent]) and node not in others
        return inside

    def local_matrices(self, rotations: Array | None = None) -> Array:
        """[..., N, 4, 4] the nodes' local matrices for local rotations [..., N, 4]; default: at rest."""
        q = self.rotations if rotations is None else rotations
        out = np.zeros((*q.shape[:-1], 4, 4))
        out[..., :3, :3] = rotation.to_matrix(q) * self.scales[:, None, :]
        out[..., :3, 3] = self.translations
        out[..., 3, 3] = 1.0
        return out

    def local_turns(self) -> Array:
        """[N, 3, 3] the nodes' local rotations at rest, as matrices; a node with a negative scale mirrors, too."""
        return np.asarray(rotation.to_matrix(self.rotations) * np.where(self.scales < 0.0, -1.0, 1.0)[:, None, :])

    def world_turns(self) -> Array:
        """[N, 3, 3] the nodes' world rotations at rest, in the file's axes, without scales but for their signs: below
        a mirrored node the matrices are rotations with a reflection (determinant -1)."""
        world = self.local_turns()
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                world[node] = world[parent] @ world[node]
        return world

    def world_matrices(self, rotations: Array | None = None, translations: Mapping[int, Array] | None = None) -> Array:
        """[..., N, 4, 4] the nodes' world matrices, in the file's units and axes.

        rotations: local [..., N, 4]; default: at rest. translations: node -> local translation [..., 3] replacing that
        at rest.
        """
        local = self.local_matrices(rotations)
        for node, place in (translations or {}).items():
            local[..., node, :3, 3] = place
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                local[..., node, :, :] = local[..., parent, :, :] @ local[..., node, :, :]
        return local


def decomposed(matrices: Array) -> tuple[Array, Array, Array]:
    """Translations [..., 3], rotations [..., 4] and scales [..., 3] of matrices [..., 4, 4].

    The first scale of a mirrored matrix (determinant below 0) is negative.
    """
    scales = np.linalg.norm(matrices[..., :3, :3], axis=-2)
    # A reflection has no rotation; moving it into one scale keeps the rest a proper rotation.
    scales[..., 0] *= np.where(np.linalg.det(matrices[..., :3, :3]) < 0.0, -1.0, 1.0)
    # The polar decomposition: the nearest rotation to a matrix that may be sheared, or flat.
    left, _, right = np.linalg.svd(matrices[..., :3, :3] * np.where(scales < 0.0, -1.0, 1.0)[..., None, :])
    left[..., -1] *= np.sign(np.linalg.det(left @ right))[..., None]
    return matrices[..., :3, 3], rotation.from_matrix(left @ right), scales


@dataclass(frozen=True)
class CharacterMotion:
    """A motion of a character's nodes, in the units and axes of its file.

    character: N nodes.
    rotations: [T, N, 4] local rotations of all nodes, unit quaternions, w first, continuous over time; unmoved nodes
        keep their rotation at rest.
    translations: [T, 3] local translation of the node `hips`, in the character's units and its parent's frame; None if
        it stays at rest.
    fps: frames per second; frame t is the pose at t / fps seconds.
    joints: our joint (a name of `data_module.motion.skeletons.WHOLE_BODY`) -> node.
    moved: the nodes whose rotations are written (an animation need not hold the others), ascending.
    unit: metres per unit of the character's world.
    """

    character: Character
    rotations: Array
    translations: Array | None
    fps: float
    joints: Mapping[str, int]
    moved: tuple[int, ...]
    unit: float

    def __post_init__(self) -> None:
        if not np.isfinite(self.rotations).all():
            raise ValueError("rotations must be finite")

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def hips(self) -> int:
        """The node that carries the body."""
        return self.joints["Hips"]

    def world_matrices(self) -> Array:
        """[T, N, 4, 4] the nodes' world matrices, in the file's units and axes."""
        moved = {} if self.translations is None else {self.hips: self.translations}
        return self.character.world_matrices(self.rotations, moved)

    def added_to_rest(self, rest: CharacterMotion) -> CharacterMotion:
        """The motion with local rotations R D, where R is the node's rotation at rest in the file and pose = (resting
        pose) D. rest: the resting pose, one frame.

        Tools that make clips additive take D relative to the rest of the file, and multiply the local rotations of the
        clip below by it from the right: over arms that hang, the character gestures as it does without that clip.
        """
        delta = rotation.multiply(rotation.conjugate(rest.rotations), self.rotations)
        rotations = rotation.multiply(self.character.rotations, delta)
        return replace(self, rotations=rotation.continuous(rotation.normalise(rotations)), translations=None)


_LEAST_JOINTS = 12
"""Joints of a skeleton that may be a character: hips, spine, head and two arms and legs take 15; a prop has fewer."""


def split_name(path: str) -> tuple[str, str]:
    """A path and the name of a character after #; "" without one. A file whose own name has a # is taken as it is."""
    if "#" not in path or Path(path).exists():
        return path, ""
    file, _, name = path.rpartition("#")
    return file, name


def skeletons_of(character: Character) -> dict[str, int]:
    """Name -> top node of every skeleton that may be a character, in the order of the file. The name is that of the
    node above the skeleton if it carries no other, else that of its top joint; repeated names get the node's index."""
    skinned = character.skinned
    top = list(range(len(character)))  # the highest joint of the unbroken line of joints above a node
    for node, parent in enumerate(character.parents):
        if parent >= 0:
            top[node] = top[parent] if skinned[top[parent]] else node
    sizes = np.bincount([top[node] for node in np.flatnonzero(skinned)], minlength=len(character))
    skeletons: dict[str, int] = {}
    tops = [int(node) for node in np.flatnonzero(sizes >= _LEAST_JOINTS)]
    above = [character.parents[node] for node in tops]
    for node, parent in zip(tops, above, strict=True):
        name = character.names[parent] if parent >= 0 and above.count(parent) == 1 else character.names[node]
        name = name or f"node {character.node_ids[node]}"
        skeletons[name if name not in skeletons else f"{name}:{character.node_ids[node]}"] = node
    return skeletons


def chosen(character: Character, name: str) -> Character:
    """The character with the joints and the mesh of one skeleton alone. `InputError` that lists the names."""
    skeletons = skeletons_of(character)
    if name not in skeletons:
        raise InputError(f"{character.path}#{shown(name)}", "is not a character of the file",
                         f"choose among {', '.join(map(shown, skeletons))}" if skeletons else "leave the name out")
    inside = character.under([skeletons[name]])
    # Widths are measured on the mesh, so that of the other characters must go.
    near = inside[character.flesh_nodes]
    table = {bone: node for bone, node in character.humanoid.items() if inside[node]}
    # Joints are found by their names, too: those of the others must not be read.
    names = tuple(node_name if here else "" for node_name, here in zip(character.names, inside, strict=True))
    return replace(character, names=names, skinned=character.skinned & inside, humanoid=table,
                   flesh=character.flesh[near], flesh_nodes=character.flesh_nodes[near])


def note_of(character: Character, hips: int) -> str:
    """A line on a file with several characters, of which the one with the node `hips` is used; "" for one alone."""
    skeletons = skeletons_of(character)
    if len(skeletons) < 2:
        return ""
    used = next((name for name, node in skeletons.items() if character.under([node])[hips]), "")
    others = ", ".join(f"{character.path.name}#{name}" for name in skeletons if name != used)
    return f"holds {len(skeletons)} skeletons, of which {shown(used)} is used; for another give {others}"
