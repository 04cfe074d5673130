"""Characters in glTF 2.0: GLB, VRM 0.x and 1.0, .gltf with embedded or separate buffers, and FBX made GLB by Blender.

Only the parts needed for a rig are read: nodes, skins, inverse bind matrices, the VRM table, skinned vertices, and a
sample of the skinned triangles with the weights of their corners. glTF uses metres and Y up; a VRM 0.x character faces
-Z, others +Z.
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError, shown
from data_module.types import Array
from gesticulator.characters.bvh_rig import turns_of
from gesticulator.characters.gltf_file import AGAIN, FARTHEST, GltfFile, read_gltf
from gesticulator.characters.mapping import ancestors
from gesticulator.characters.rig import Character, Skin, decomposed

MOST_POINTS = 20_000
"""Most vertices kept, evenly subsampled: enough to measure the width of a trunk."""
_MOST_PARTS = 1 << 16
"""Most mesh primitives in use: one mesh may be referenced by every node."""
_LONGEST_NAME = 1000
_MOST_CANDIDATES = 400
"""Most joints used to determine the place of the mesh."""
_MOST = 0.5
"""Least share of the joints that must rest in the bind pose for their majority to decide."""
_SAME_PLACE, _SAME_TURN = 1e-3, float(np.radians(0.5))
"""Share of the skeleton's size, and radians, within which a joint is where the bind pose has it."""
_LEVEL = float(np.radians(1.0))
"""An axis within this angle of the vertical is vertical."""
_AS_AT_REST = float(np.radians(60.0))
"""Largest median angle between trunk and legs at rest and in the bind pose: a stride turns them by 30 degrees."""
_AS_TURNED = float(np.radians(100.0))
"""The same for a body whose joints all rest in the bind pose but for one that turns the whole of it."""
_EQUAL = 1e-5
"""Numbers of matrices that differ by less are equal."""
_LEAST_NODES = 8
"""Hips, head, two arms and two legs of two bones are not fewer."""
_SKINNED = ("POSITION", "JOINTS_0", "WEIGHTS_0")
"""Attributes of a skinned mesh."""


def read_gltf_character(path: str | os.PathLike[str]) -> Character:
    """The rig of a .glb, .vrm or .gltf file. `InputError` for an invalid file or one without a skin."""
    file = read_gltf(path)
    try:
        return _character(file)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        # Invalid VRM tables and singular matrices.
        raise InputError(path, f"is a broken glTF file ({type(error).__name__}: {shown(str(error), 100)})",
                         AGAIN) from None


def _character(file: GltfFile) -> Character:
    nodes = file.rows("nodes")
    parent_of = {child: node for node, entry in enumerate(nodes) for child in entry.get("children", [])}
    order = _parents_first(file, len(nodes), parent_of)
    place = {node: index for index, node in enumerate(order)}
    translations, rotations, scales = (np.array(column) for column in zip(
        *(_transform(nodes[node]) for node in order), strict=True))
    skinned = np.zeros(len(order), dtype=bool)
    for skin in file.rows("skins"):
        skinned[[place[node] for node in skin["joints"]]] = True
    version, humanoid = _vrm(file, place)
    # An armature in an FBX file without a mesh has no skin in GLB.
    skinless = not skinned.any() and file.path.suffix.lower() != ".fbx"
    if not skinned.any():
        if len(order) < _LEAST_NODES and not humanoid:
            raise InputError(file.path, "has no skin, and too few nodes for a body", "export the armature, too")
        # A VRM file without a mesh still says which nodes are bones; in others any node may be one.
        skinned[list(humanoid.values()) or slice(None)] = True
    character = Character(
        tuple(str(nodes[node].get("name", ""))[:_LONGEST_NAME] for node in order),
        tuple(place[parent_of[node]] if node in parent_of else -1 for node in order),
        translations, rotations, scales, file.path, "glb", skinned, humanoid=humanoid, vrm=version, unit=1.0,
        node_ids=tuple(order), skinless=skinless and not humanoid)
    with np.errstate(over="ignore", invalid="ignore"):
        rest = character.world_matrices()
    if not (np.abs(rest) <= FARTHEST).all():
        raise InputError(file.path, f"has nodes farther away, or larger, than {FARTHEST:g}", AGAIN)
    matrices = _inverse_matrices(file)
    inverse = _inverse_bind(file, place, matrices)
    # Matrices that are all equal hold no pose: the mesh is in the axes of its joints, wherever they rest.
    meshes = [place[node] for node, entry in enumerate(nodes) if "mesh" in entry and "skin" in entry]
    bind, to_world = _bind(character, inverse, meshes) if inverse else (rest, np.eye(4))
    parts = _listed(file, _skinned_parts(file, place, _to_world(file, place, matrices, bind, to_world)))
    flesh, flesh_nodes = _flesh(file, parts)
    rigid = _listed(file, _rigid_parts(file, character, bind, set(flesh_nodes.tolist())))
    if rigid:
        (more, more_nodes), parts = _flesh(file, rigid), parts + rigid
        flesh, flesh_nodes = np.concatenate([flesh, more]), np.concatenate([flesh_nodes, more_nodes])
    return replace(character, bind=bind if matrices else None, space=turns_of(to_world), flesh=flesh,
                   flesh_nodes=flesh_nodes, skin=read_skin(file, parts))


def _parents_first(file: GltfFile, count: int, parent_of: Mapping[int, int]) -> list[int]:
    """The nodes in the order of the file, but each after its parent."""
    children: dict[int, list[int]] = {}
    for child, parent in sorted(parent_of.items()):
        children.setdefault(parent, []).append(child)
    order: list[int] = []
    todo = [node for node in reversed(range(count)) if node not in parent_of]
    while todo:
        node = todo.pop()
        order.append(node)
        todo += reversed(children.get(node, []))
    if len(order) != count:
        raise InputError(file.path, "has nodes that are their own ancestors", AGAIN)
    return order


def _transform(node: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Translation, rotation (w first) and scale of a node."""
    if "matrix" in node:
        # glTF stores matrices column by column.
        return decomposed(np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T)
    x, y, z, w = map(float, node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    turn = np.array([w, x, y, z])
    length = float(np.linalg.norm(turn))
    turn = turn / length if length > 1e-9 else np.array([1.0, 0.0, 0.0, 0.0])
    place = np.array(node.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64).reshape(3)
    return place, turn, np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64).reshape(3)


def _vrm(file: GltfFile, place: Mapping[int, int]) -> tuple[str, dict[str, int]]:
    """Version and humanoid table (bone -> node) of the VRM extension; "" and empty without it."""
    extensions = file.document.get("extensions", {})
    if "VRMC_vrm" in extensions:
        bones = extensions["VRMC_vrm"]["humanoid"]["humanBones"]
        return "1.0", {bone: place[entry["node"]] for bone, entry in bones.items() if entry.get("node") in place}
    if "VRM" in extensions:
        bones = extensions["VRM"]["humanoid"]["humanBones"]
        return "0.x", {entry["bone"]: place[entry["node"]] for entry in bones if entry.get("node") in place}
    return "", {}


def _inverse_matrices(file: GltfFile) -> dict[int, Array]:
    """Skin -> [J, 4, 4] its inverse bind matrices: the identity for each joint if it has none, as glTF defines."""
    out = {}
    for number, skin in enumerate(file.rows("skins")):
        count = len(skin["joints"])
        matrices = np.tile(np.eye(4), (count, 1, 1))
        if "inverseBindMatrices" in skin:
            numbers = file.array(skin["inverseBindMatrices"], slice(count))
            if not (np.abs(numbers) <= FARTHEST).all():
                raise InputError(file.path, "has inverse bind matrices that are not finite numbers", AGAIN)
            matrices[:len(numbers)] = numbers.reshape(-1, 4, 4).transpose(0, 2, 1)
        if count:
            out[number] = matrices
    return out


def _inverse_bind(file: GltfFile, place: Mapping[int, int], matrices: Mapping[int, Array]) -> dict[int, Array]:
    """Node -> [4, 4] inverse bind matrix, in the space of the skin with the most joints; other skins are aligned to it
    by a shared joint, or omitted without one. So are those of several joints that all have the same matrix."""
    skins = file.rows("skins")
    telling = [number for number, rows in matrices.items() if len(rows) == 1 or np.ptp(rows, axis=0).max() > _EQUAL]
    out: dict[int, Array] = {}
    # The skin with the most joints first: it is the body, the others are clothes and hair.
    for number in sorted(telling, key=lambda number: -len(matrices[number])):
        rows = matrices[number]
        inverse = {place[node]: matrix for node, matrix, size in zip(skins[number]["joints"], rows,
                                                                 np.linalg.det(rows), strict=True) if abs(size) > 1e-15}
        shared = next((node for node in inverse if node in out), None)
        if out and shared is None:
            continue
        # Both give the place of the same joint, each in the space of its own mesh.
        change = np.eye(4) if shared is None else np.linalg.inv(inverse[shared]) @ out[shared]
        out |= {node: matrix @ change for node, matrix in inverse.items() if node not in out}
    return out


def _to_world(file: GltfFile, place: Mapping[int, int], matrices: Mapping[int, Array], bind: Array, to_world: Array
              ) -> dict[int, Array]:
    """Skin -> [J, 4, 4] the transform of its mesh into the world of the bind pose, by joint; usually all `to_world`."""
    out = {}
    for number, rows in matrices.items():
        moves = bind[[place[node] for node in file.rows("skins")[number]["joints"]]] @ rows
        same = np.abs(moves - to_world).max() <= _EQUAL * max(1.0, np.abs(to_world).max())
        out[number] = np.broadcast_to(to_world, moves.shape) if same else moves
    return out


def _bind(character: Character, inverse: Mapping[int, Array], meshes: Sequence[int]) -> tuple[Array, Array]:
    """[N, 4, 4] world matrices of the bind pose, and [4, 4] from mesh space to the world.

    Inverse bind matrices give each joint's place in mesh space. The place of mesh space in the world is that which
    explains most of them: each joint that rests in its bind pose determines it, and all of those agree. If most joints
    rest in another pose, the nodes that carry the meshes determine it, or else the joint nearest to the root.
    """
    rest = character.world_matrices()
    joints = list(inverse)
    there = np.array([np.linalg.inv(inverse[node]) for node in joints])
    candidates = np.array([rest[node] @ inverse[node] for node in joints])[::max(1, len(joints) // _MOST_CANDIDATES)]
    # Each joint proposes a transform; the one that most joints agree with wins (as in RANSAC).
    counts = [int(_explained(candidate @ there, rest[joints]).sum()) for candidate in candidates]
    to_world = candidates[int(np.argmax(counts))]  # the first of equals, which is nearest to the root of the skin
    agree = max(counts) >= _MOST * len(joints)
    if not (agree and _is_level(to_world)):
        better = _placed_by_nodes(character, joints, there, meshes, _AS_TURNED if agree else _AS_AT_REST)
        if better is not None:
            to_world = better
        elif not agree:
            depth = [len(ancestors(character.parents, node)) for node in joints]
            first = int(np.argmin(depth))
            to_world = rest[joints[first]] @ inverse[joints[first]]
    bind = rest.copy()
    local = character.local_matrices()
    for node, parent in enumerate(character.parents):
        if node in inverse:
            bind[node] = to_world @ np.linalg.inv(inverse[node])
        elif parent >= 0:
            bind[node] = bind[parent] @ local[node]
    return bind, to_world


def _explained(there: Array, rest: Array) -> NDArray[np.bool_]:
    """[J] which joints are at rest where the bind pose has them: both [J, 4, 4] in the world."""
    size = max(float(np.ptp(rest[:, :3, 3], axis=0).max()), 1e-9)
    # Both place and rotation must agree: many rigs have several joints in one place.
    near = np.linalg.norm(there[:, :3, 3] - rest[:, :3, 3], axis=-1) < _SAME_PLACE * size
    return np.asarray(near & (_angles(there, rest) < _SAME_TURN))


def _angles(a: Array, b: Array) -> Array:
    """[J] radians between the rotations of matrices [J, 4, 4]; pi if one is mirrored and the other is not."""
    apart = np.swapaxes(turns_of(a), -1, -2) @ turns_of(b)
    # The trace of a rotation matrix is 1 + 2 cos(angle).
    cosine = (np.trace(apart, axis1=-2, axis2=-1) - 1.0) / 2.0
    return np.where(np.linalg.det(apart) > 0.0, np.arccos(np.clip(cosine, -1.0, 1.0)), np.pi)


def _is_level(to_world: Array) -> bool:
    """Whether one of the axes of mesh space is vertical in the world."""
    return bool(np.abs(turns_of(to_world)[1]).max() > np.cos(_LEVEL))


def _placed_by_nodes(character: Character, joints: Sequence[int], there: Array, meshes: Sequence[int], most: float
                     ) -> Array | None:
    """[4, 4] from mesh space to the world by the nodes that carry the meshes or the skeleton; None if none of
    them has the size of the skeleton and leaves the trunk within `most` radians of its rest pose (in the median)."""
    rest = character.world_matrices()
    place = {node: index for index, node in enumerate(joints)}
    bones = [(place[node], place[character.parents[node]]) for node in joints if character.parents[node] in place]
    if not bones:
        return None
    below, above = np.array(bones).T
    here, bound = (np.linalg.norm(m[below, :3, 3] - m[above, :3, 3], axis=-1) for m in (rest[joints], there))
    long = bound > 0.1 * bound.max()
    # The size of the skeleton at rest relative to mesh space must be that of the node's matrix.
    scale = float(np.median(here[long] / bound[long]))
    tops = [character.parents[node] for node in joints if character.parents[node] not in place]
    depth = [len(ancestors(character.parents, node)) for node in joints]
    trunk = np.argsort(depth, kind="stable")[:max(3, len(joints) // 3)]  # the others are mostly fingers
    best, best_angle = None, most
    for node in dict.fromkeys([*meshes, *tops]):
        to_world = rest[node] if node >= 0 else np.eye(4)
        size = float(np.cbrt(abs(np.linalg.det(to_world[:3, :3]))))
        if not (size > 0.0 and abs(np.log(size / scale)) < 0.02 and _is_level(to_world)):
            continue
        angle = float(np.median(_angles(to_world @ there[trunk], rest[joints][trunk])))
        if angle < best_angle - 1e-6:
            best, best_angle = to_world, angle
    return best


@dataclass(frozen=True)
class _Part:
    """A primitive of a mesh that bones move. joints: [J] the nodes that its corners name; moves: [J, 4, 4] from its
    space to the world of the bind pose, by joint. A rigid part has one joint and no weights."""

    primitive: dict[str, Any]
    joints: NDArray[np.int64]
    moves: Array

    def points(self, file: GltfFile, rows: Any) -> tuple[Array, NDArray[np.int64], Array]:
        """[V, 3] some of its vertices, in its space, [V, K] their joints (places in `joints`) and [V, K] weights, all 0
        where the file has one that is not a number."""
        attributes = self.primitive["attributes"]
        where = file.array(attributes["POSITION"], rows)
        if where.shape[1] != 3:
            raise InputError(file.path, "has a mesh whose positions have not three numbers", AGAIN)
        if not set(_SKINNED) <= set(attributes):
            return where, np.zeros((len(where), 1), np.int64), np.ones((len(where), 1))
        which, weights = (file.array(attributes[name], rows) for name in _SKINNED[1:])
        if which.shape != weights.shape or len(where) != len(which) or not which.shape[1]:
            raise InputError(file.path, "has a mesh whose positions, joints and weights do not match", AGAIN)
        weights = np.where(np.isfinite(weights).all(axis=1, keepdims=True), np.maximum(weights, 0.0), 0.0)
        # An index out of range becomes the last joint, NaN the first.
        return where, np.clip(np.nan_to_num(which), 0, len(self.joints) - 1).astype(np.int64), weights


def _skinned_parts(file: GltfFile, place: Mapping[int, int], moves: Mapping[int, Array]) -> Iterator[_Part]:
    """The parts of all skinned meshes. moves: skin -> [J, 4, 4] from the space of its mesh."""
    joints = {skin: np.array([place[node] for node in file.rows("skins")[skin]["joints"]]) for skin in moves}
    return (_Part(primitive, joints[node["skin"]], moves[node["skin"]]) for node in file.rows("nodes")
            if "mesh" in node and node.get("skin") in moves
            for primitive in file.rows("meshes")[node["mesh"]]["primitives"]
            if set(_SKINNED) <= set(primitive.get("attributes", {})))


def _rigid_parts(file: GltfFile, character: Character, bind: Array, moved: Collection[int]) -> Iterator[_Part]:
    """The parts of the meshes that hang on joints without a skin, as the head of many a robot does. moved: the nodes
    that a skin moves, whose rigid parts are hats, hair and weapons."""
    for node, number in enumerate(character.node_ids):
        entry = file.rows("nodes")[number]
        if "mesh" in entry and "skin" not in entry:
            line = (node, *ancestors(character.parents, node))
            joint = next((above for above in line if character.skinned[above]), -1)
            if joint >= 0 and joint not in moved:
                yield from (_Part(primitive, np.array([joint]), bind[node][None])
                            for primitive in file.rows("meshes")[entry["mesh"]]["primitives"]
                            if "POSITION" in primitive.get("attributes", {}))


def _listed(file: GltfFile, parts: Iterator[_Part]) -> list[_Part]:
    out = list(islice(parts, _MOST_PARTS + 1))
    if len(out) > _MOST_PARTS:
        raise InputError(file.path, f"draws more than {_MOST_PARTS:,} parts of meshes", "join them")
    return out


def _flesh(file: GltfFile, parts: Sequence[_Part]) -> tuple[Array, NDArray[np.int64]]:
    """[V, 3] vertices of the meshes in the bind pose's world, and [V] the node with the largest weight of each."""
    counts = [file.count(part.primitive["attributes"]["POSITION"]) for part in parts]
    # One step over all meshes, so that each keeps its share of the points.
    step = -(-sum(counts) // MOST_POINTS) or 1
    points: list[Array] = [np.zeros((0, 3))]
    movers: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    before = 0
    for part, count in zip(parts, counts, strict=True):
        # Continue the pattern of every `step`-th vertex across the boundaries of the parts.
        first, before = -before % step, before + count
        if first >= count:
            continue
        where, which, weights = part.points(file, slice(first, None, step))
        mover = np.take_along_axis(which, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        good = (np.abs(where) <= FARTHEST).all(axis=1)  # also not NaN
        move = part.moves[mover[good]]
        points.append(np.einsum("vij,vj->vi", move[:, :3, :3], where[good]) + move[:, :3, 3])
        movers.append(part.joints[mover[good]])
    return np.concatenate(points), np.concatenate(movers)


MOST_TRIANGLES = 6000
"""Most triangles kept, evenly over each mesh: enough to see a tear of a hundredth of the surface."""
_MOST_VERTICES = 1 << 22
"""Largest mesh that is sampled, vertices: film characters have some hundred thousand."""
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
"""glTF's modes of primitives with triangles."""


def read_skin(file: GltfFile, parts: Sequence[_Part]) -> Skin:
    """A sample of the triangles of the parts."""
    parts = [part for part in parts if part.primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)]
    sizes = [file.count(part.primitive.get("indices", part.primitive["attributes"]["POSITION"])) for part in parts]
    sizes = [size // 3 if part.primitive.get("mode", _TRIANGLES) == _TRIANGLES else max(size - 2, 0)
             for part, size in zip(parts, sizes, strict=True)]
    # As for the vertices: one step over all parts.
    step = max(1, -(-sum(sizes) // MOST_TRIANGLES))
    points, joints, weights, triangles = [], [], [], []
    before = 0
    for part, size in zip(parts, sizes, strict=True):
        vertices = file.count(part.primitive["attributes"]["POSITION"])
        if not size or vertices > _MOST_VERTICES or 3 * size > 4 * _MOST_VERTICES:
            continue
        chosen = _triangles(file, part.primitive, vertices)[::step]
        chosen = chosen[(chosen < vertices).all(axis=1)]
        # Only the corners of the sampled triangles are kept, renumbered.
        used, back = np.unique(chosen, return_inverse=True)
        where, which, shares = part.points(file, used)
        points.append(_bound_points(where, part.moves, which, shares))
        joints.append(np.pad(part.joints[which], ((0, 0), (0, _MOST_INFLUENCES - which.shape[1]))))
        weights.append(np.pad(shares, ((0, 0), (0, _MOST_INFLUENCES - which.shape[1]))))
        triangles.append(back.reshape(-1, 3) + before)
        before += len(used)
    if not points:
        return Skin()
    return _without_bad_triangles(np.concatenate(points), np.concatenate(joints), np.concatenate(weights),
                                  np.concatenate(triangles))


_MOST_INFLUENCES = 4
"""Joints of a vertex in one pair of attributes."""


def _triangles(file: GltfFile, primitive: Mapping[str, Any], vertices: int) -> NDArray[np.int64]:
    """[F, 3] corners of the triangles of a primitive: separate ones, a strip or a fan."""
    corners = np.arange(vertices) if "indices" not in primitive else np.nan_to_num(
        file.array(primitive["indices"])[:, 0]).astype(np.int64)
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _TRIANGLES:
        return corners[:len(corners) // 3 * 3].reshape(-1, 3)
    first = corners[:-2] if mode == _STRIP else np.repeat(corners[:1], max(len(corners) - 2, 0))
    return np.stack([first, corners[1:-1], corners[2:]], axis=-1)


def _bound_points(points: Array, moves: Array, which: NDArray[np.int64], shares: Array) -> Array:
    """[V, 3] vertices in the world of the bind pose, each moved by [J, 4, 4] of its joints [V, 4], by their shares."""
    shares = shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-9)
    with np.errstate(invalid="ignore", over="ignore"):  # those far away or not finite are left out afterwards
        # The usual case, all joints with one matrix, needs no matrix per vertex.
        if (moves == moves[:1]).all():
            return np.asarray(points @ moves[0, :3, :3].T + moves[0, :3, 3])
        move = np.einsum("vk,vkij->vij", shares, moves[which])
        return np.asarray(np.einsum("vij,vj->vi", move[:, :3, :3], points) + move[:, :3, 3])


def _without_bad_triangles(points: Array, joints: NDArray[np.int64], weights: Array, triangles: NDArray[np.int64]
                           ) -> Skin:
    """The skin without the triangles that have a corner at no finite place or without weight."""
    # Weights are normalised here, since files store them rounded to 8 or 16 bits.
    whole = weights.sum(axis=1)
    good = (np.abs(points) <= FARTHEST).all(axis=1) & (whole > 0.0)
    return Skin(np.where(good[:, None], points, 0.0), joints, weights / np.where(good, whole, 1.0)[:, None],
                triangles[good[triangles].all(axis=1)], float((whole == 0.0).mean()))
