"""Do hands enter the body of a character? python benchmarks/contacts.py [FILE ...] [--rigs 12] [--seed 1]

A performance of the shipped weights with the hands near the body (`--hand-radius .15`, `--hold-still`) is brought onto
characters in files (by default those of the zoo that are moved, `tests/zoo.py`) and onto generated rigs with a trunk
twice as deep as ours, with the correction of contacts and without. Shown are the share of time in which a wrist or
knuckle of the worse moment is inside the body, the depth, and the fastest hand; and how fast that is where each frame
is corrected by itself (`gesticulator.characters.trunk` without `gesticulator.characters.detours`), the control. Inside
of a file is what its skinned mesh without the arms encloses (its winding number is above one half), and the depth is
the distance from the mesh; of a rig, the column that its mesh was made of. A file without a mesh has no body to be
inside of, and is left out.

A second table goes through the knobs: the default figure, whose wrists and knuckles are held against its trunk (an
ellipse of 29 by 23 cm) and against the shirt that pages show, and the worst of a few bodies, the stoutest of the zoo
and one of the rigs. With `--sitting`, there is one table, of performances that sit, at the knobs that concern the
hands: wrists, knuckles and the last joints of the fingers are held against the thighs of the default figure as well
(cones with the radii of the page's), and the bodies sit.
"""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from data_module.errors import InputError  # noqa: E402
from data_module.speech.audio import load_speech  # noqa: E402
from data_module.types import Array, Motion, Skeleton  # noqa: E402
from eval.metrics.eye.body import common_body  # noqa: E402
from eval.metrics.eye.trunk import fastest_elbow  # noqa: E402
from eval.table import Column, Provenance, Table, publish  # noqa: E402
from gesticulator import Gesticulator  # noqa: E402
from gesticulator.characters import detours, gltf_skin, shape  # noqa: E402
from gesticulator.characters.contacts import OURS, plain_trunk, pose_of  # noqa: E402
from gesticulator.characters.mapping import SIDES, ancestors  # noqa: E402
from gesticulator.characters.reading import read_character  # noqa: E402
from gesticulator.characters.retarget import Retargeter  # noqa: E402
from gesticulator.characters.rig import CharacterMotion, Skin  # noqa: E402
from gesticulator.characters.thighs import FINGERTIPS, OUR_RADII  # noqa: E402
from gesticulator.plan.plan import GestureCue  # noqa: E402
from tests.rig_errors import inside, places_of  # noqa: E402
from tests.rigs import Rig, draw  # noqa: E402

STILL = ((3.2, 5.0), (12.0, 15.0))
KNOBS: dict[str, Any] = {"hand_radius": 0.15, "hold_still": STILL}
"""What brings the hands nearest to the body."""
SWEEP: dict[str, dict[str, Any]] = {
    "none": {}, "--intensity 2": {"intensity": 2.0}, "--intensity .5": {"intensity": 0.5},
    "--energy lively": {"energy": "lively"}, "--activity .3": {"activity": 0.3},
    "--hand-radius .15": {"hand_radius": 0.15}, "--hold-still": {"hold_still": STILL},
    "--hand-radius .15 --hold-still": KNOBS,
    "--hand-radius .15 --intensity 2 --hold-still": {**KNOBS, "intensity": 2.0},
    "--hand-height low": {"hand_height": "low"}, "--hand-height high": {"hand_height": "high"},
    "--hand-speed high": {"hand_speed": "high"}, "--handedness both": {"handedness": "both"},
    "--handedness left --mirror": {"handedness": "left", "mirror": True}, "--seated": {"seated": True, "legs": False},
    "--cue, six at the body": {"cues": tuple(GestureCue(gesture, time=2.0 + 5.0 * k) for k, gesture in enumerate(
        ("hands over heart", "point self", "brush off", "cut off", "receive", "prayer hands")))},
    "--fps 120": {"fps": 120.0}}
SITTING = ("none", "--activity .3", "--hand-height low", "--intensity 2",
           "--hand-radius .15 --intensity 2 --hold-still", "--handedness left --mirror")
"""Settings of `SWEEP` at which somebody sits."""
FPS, CHECKED = 30.0, 10.0
"""Frames per second of the motion, and how many a second are held against a mesh."""
DEEP = 0.01
"""Metres that a hand may be inside for half of a percent of the time."""
NEAREST = 60
"""Triangles, by their middles, among which the nearest is looked for."""
AROUND = 40
"""Points of a ring of the shirt."""
COLUMNS = {"free": Column("inside, uncorrected", "%", 1, "low"), "free_deep": Column("deepest", "mm", 1, "low"),
           "free_speed": Column("fastest hand", "m/s", 2), "kept": Column("inside", "%", 1, "low"),
           "kept_over": Column("over 1 cm inside", "%", 1, "low"),
           "kept_deep": Column("deepest, corrected", "mm", 1, "low"),
           "kept_speed": Column("fastest hand, corrected", "m/s", 2, "low"),
           "framed_speed": Column("corrected frame by frame", "m/s", 2, "low")}


AT_KNOBS = {"over": Column("over 1 cm inside", "%", 2, "low"), "deep": Column("deepest", "mm", 1, "low"),
            "shirt": Column("over 1 cm in the shirt", "%", 2, "low"),
            "shirt_deep": Column("deepest", "mm", 1, "low"),
            "hand": Column("fastest hand", "m/s", 2, "low"), "elbow": Column("fastest elbow", "m/s", 2, "low"),
            "bodies_over": Column("bodies: over 1 cm inside", "%", 2, "low"),
            "bodies_deep": Column("bodies: deepest", "mm", 1, "low"),
            "bodies_hand": Column("bodies: fastest hand", "m/s", 2, "low"),
            "bodies_free": Column("bodies: uncorrected", "m/s", 2)}
ON_A_SEAT = {"thigh": Column("over 1 cm in a thigh", "%", 2, "low"), "thigh_deep": Column("deepest", "mm", 1, "low"),
             **AT_KNOBS}
STOUT = ("Mixamo, heavy man", "game engine, heavy man", "Mixamo, child", "Rigged Figure")
SEATED_BODIES = ("Rigged Figure",)


def winding(corners: Array, point: Array) -> float:
    """How often triangles [F, 3, 3] wind about a point [3]: 1 inside of a closed mesh, 0 outside (Van Oosterom and
    Strackee's solid angles)."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    beside = la * lb * lc + sum(np.einsum("ij,ij->i", p, q) * r for p, q, r in ((a, b, lc), (b, c, la), (c, a, lb)))
    return float(np.arctan2(volume, beside).sum() / (2.0 * np.pi))


def distance(corners: Array, point: Array) -> float:
    """Metres from a point [3] to the nearest of triangles [F, 3, 3]."""
    near = corners[np.argsort(np.linalg.norm(corners.mean(axis=1) - point, axis=1))[:NEAREST]]
    a, b, c = np.moveaxis(near, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    height = np.einsum("ij,ij->i", point - a, normal)
    foot, within, best = point - height[:, None] * normal, np.ones(len(near), bool), np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        within &= np.einsum("ij,ij->i", np.cross(edge, foot - start), normal) >= 0.0
        along = np.einsum("ij,ij->i", point - start, edge) / np.maximum(np.einsum("ij,ij->i", edge, edge), 1e-12)
        nearest = start + np.clip(along, 0.0, 1.0)[:, None] * edge
        best = min(best, float(np.linalg.norm(nearest - point, axis=1).min()))
    return min(best, float(np.abs(height[within]).min(initial=np.inf)))


def body_skin(retargeter: Retargeter) -> Skin:
    """The triangles of a character's mesh that no node of an arm moves most."""
    character, joints = retargeter.character, retargeter.mapping.joints
    tops = {joints[side + "Arm"] for side in SIDES}
    arms = np.array([bool(tops & {node, *ancestors(character.parents, node)}) for node in range(len(character))])
    skin = character.skin
    main = skin.joints[np.arange(len(skin.points)), skin.weights.argmax(axis=1)]
    used, corners = np.unique(skin.triangles[~arms[main][skin.triangles].any(axis=1)], return_inverse=True)
    return replace(skin, points=skin.points[used], joints=skin.joints[used], weights=skin.weights[used],
                   triangles=corners.reshape(-1, 3))


def depths(retargeter: Retargeter, skin: Skin, moved: CharacterMotion) -> Array:
    """[T] metres that the deepest of wrists and knuckles is inside of the posed skin."""
    joints, unit = retargeter.mapping.joints, retargeter.body.unit
    bind, world = shape.bind_matrices(retargeter.character), moved.world_matrices()[::every(moved.fps)]
    nodes = [joints[side + part] for side in SIDES for part in ("Hand", "HandMiddle1") if side + part in joints]
    out = np.zeros(len(world))
    for frame, matrices in enumerate(world):
        out[frame] = deepest(skin.posed(bind, matrices[None])[0] * unit, skin, matrices[nodes][:, :3, 3] * unit)
    return out


def deepest(points: Array, skin: Skin, hands: Array) -> float:
    """Metres that the deepest of `hands` [H, 3] is inside of a skin with its points at `points` [V, 3]."""
    within = [hand for hand in hands if (hand > points.min(axis=0)).all() and (hand < points.max(axis=0)).all()]
    corners = points[skin.triangles]
    return max([distance(corners, hand) for hand in within if winding(corners, hand) > 0.5], default=0.0)


def fastest(hands: Array, fps: float = FPS) -> float:
    """m/s of hands [T, 2, 3], metres."""
    return float(np.linalg.norm(np.diff(hands, axis=0), axis=-1).max()) * fps


def every(fps: float) -> int:
    """Of how many frames one is held against a mesh."""
    return max(1, round(fps / CHECKED))


def shirt(skeleton: Skeleton) -> tuple[Skin, Array]:
    """The shirt of the figure in pages, closed at its ends, and [J, 4, 4] the joints at which it is bound: the rings of
    `viewer/src/body_shape.js`, each hung on the two joints of the spine between which it lies."""
    source = (ROOT / "viewer" / "src" / "body_shape.js").read_text(encoding="utf-8")
    rings = np.array([[float(number) for number in re.findall(r"-?[\d.]+", row)] for row in re.findall(
        r"row\(([^)]*)\)", source[source.index('"trousers"'):source.index('"shirt"')])])
    bind = np.tile(np.eye(4), (len(skeleton), 1, 1))
    for joint, parent in enumerate(skeleton.parents):
        bind[joint, :3, 3] = skeleton.offsets[joint] + (bind[parent, :3, 3] if parent >= 0 else 0.0)
    chain = [skeleton.index(name) for name in ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Neck")]
    heights = bind[chain, 1, 3]
    y = heights[0] + rings[:, 0] * (heights[-1] - heights[0])
    below = np.clip(np.searchsorted(heights, y) - 1, 0, len(chain) - 2)
    share = np.clip((y - heights[below]) / np.diff(heights)[below], 0.0, 1.0)
    angle = np.arange(AROUND) * (2.0 * np.pi / AROUND)
    wide, deep = (np.sign(way) * np.abs(way) ** 0.86 for way in (np.cos(angle), np.sin(angle)))
    middle = rings[:, 3] + 0.4 * bind[chain[4], 2, 3]
    points = np.stack([rings[:, 1, None] * wide, np.broadcast_to(y[:, None], (len(y), AROUND)),
                       middle[:, None] + rings[:, 2, None] * deep], axis=-1)
    a = np.arange((len(rings) - 1) * AROUND).reshape(-1, AROUND)
    b, last = np.roll(a, -1, axis=1), (len(rings) - 1) * AROUND
    fan = np.stack([np.zeros(AROUND - 2, int), np.arange(1, AROUND - 1), np.arange(2, AROUND)], axis=1)
    triangles = np.concatenate([np.stack([a, a + AROUND, b], -1).reshape(-1, 3),
                                np.stack([b, a + AROUND, b + AROUND], -1).reshape(-1, 3), fan, last + fan[:, ::-1]])
    joints = np.stack([np.array(chain)[below], np.array(chain)[below + 1]], axis=1)
    return Skin(points.reshape(-1, 3), np.repeat(joints, AROUND, axis=0),
                np.repeat(np.stack([1.0 - share, share], axis=1), AROUND, axis=0), triangles), bind


def of_figure(motion: Motion) -> dict[str, float]:
    """The figures of the default character: in its trunk, in its shirt, and speeds."""
    pose = pose_of(motion)
    hands = [side + part for side in SIDES for part in ("Hand", "HandMiddle1") if side + part in pose.places]
    column = pose.places["Hips"], pose.places["Neck"], pose.turns["Spine3"]
    depth = np.max([-plain_trunk(*OURS).distance(pose.places[hand], *column)[0] for hand in hands], axis=0)
    skin, bind = shirt(motion.skeleton)
    world = np.tile(np.eye(4), (len(motion), len(motion.skeleton), 1, 1))
    for joint, name in enumerate(motion.skeleton.names):
        world[:, joint, :3, :3], world[:, joint, :3, 3] = pose.turns[name], pose.places[name]
    worn = np.array([deepest(skin.posed(bind, matrices[None])[0], skin,
                             np.stack([pose.places[hand][frame] for hand in hands]))
                     for frame, matrices in enumerate(world)])
    return {"over": 100.0 * float((depth > DEEP).mean()), "deep": 1000.0 * max(float(depth.max()), 0.0),
            "shirt": 100.0 * float((worn > DEEP).mean()), "shirt_deep": 1000.0 * float(worn.max()),
            "hand": fastest(np.stack([pose.places[side + "Hand"] for side in SIDES], axis=1), motion.fps),
            "elbow": fastest_elbow(common_body(motion))}


def in_thighs(motion: Motion) -> dict[str, float]:
    """How far the hands of the default character are in its thighs, by the distance from the line of the bone."""
    pose = pose_of(motion)
    parts = ("Hand", "HandMiddle1", *FINGERTIPS)
    hands = [side + part for side in SIDES for part in parts if side + part in pose.places]
    depths = []
    for side in SIDES:
        hip, knee = pose.places[side + "UpLeg"], pose.places[side + "Leg"]
        bone = knee - hip
        for hand in hands:
            way = pose.places[hand] - hip
            share = np.clip(np.sum(way * bone, axis=-1) / np.sum(bone * bone, axis=-1), 0.0, 1.0)
            depths.append(np.interp(share, [0.0, 1.0], OUR_RADII)
                          - np.linalg.norm(way - share[:, None] * bone, axis=-1))
    depth = np.max(depths, axis=0)
    return {"thigh": 100.0 * float((depth > DEEP).mean()), "thigh_deep": 1000.0 * max(float(depth.max()), 0.0)}


def of_bodies(motion: Motion, paths: list[Path], rig: Rig) -> dict[str, float]:
    """The worst figures of characters in files and of a rig."""
    rows = [of_rig(rig, motion, controls=False), *(of_file(path, motion, controls=False) for path in paths)]
    return {name: max(row[column] for row in rows) for name, column in (
        ("bodies_over", "kept_over"), ("bodies_deep", "kept_deep"), ("bodies_hand", "kept_speed"),
        ("bodies_free", "free_speed"))}


@contextmanager
def frame_by_frame() -> Iterator[None]:
    """Corrections are not spread over time."""
    spread = detours.spread
    detours.spread = lambda push, *_: push
    try:
        yield
    finally:
        detours.spread = spread


def row(bare: tuple[Array, float], kept: tuple[Array, float], framed: float) -> dict[str, float]:
    """Depths [T] and the fastest hand, without and with the correction; and with that of each frame by itself."""
    return {"free": 100.0 * float((bare[0] > 0.0).mean()), "free_deep": 1000.0 * float(bare[0].max()),
            "free_speed": bare[1], "kept": 100.0 * float((kept[0] > 0.0).mean()),
            "kept_over": 100.0 * float((kept[0] > DEEP).mean()), "kept_deep": 1000.0 * float(kept[0].max()),
            "kept_speed": kept[1], "framed_speed": framed}


def of_file(path: Path, motion: Motion, controls: bool = True) -> dict[str, float]:
    """The row of a character's file. controls: with the depth without correction, and corrected frame by frame."""
    retargeter = Retargeter(read_character(path))
    if not len(retargeter.character.skin.triangles):
        raise InputError(path, "holds no mesh", "give a file with a mesh")
    unit = retargeter.body.unit
    skin, hands, found = body_skin(retargeter), [retargeter.mapping.joints[side + "Hand"] for side in SIDES], []

    def speed(moved: CharacterMotion) -> float:
        return fastest(moved.world_matrices()[:, hands][..., :3, 3] * unit, motion.fps)

    for contacts in (False, True):
        retargeter.contacts = contacts
        moved = retargeter(motion)
        found.append((depths(retargeter, skin, moved) if contacts or controls else np.zeros(1), speed(moved)))
    with frame_by_frame():
        return row(*found, speed(retargeter(motion)) if controls else 0.0)


def of_rig(rig: Rig, motion: Motion, controls: bool = True) -> dict[str, float]:
    """The row of a generated rig, whose trunk is known. controls: with that corrected frame by frame."""
    found, hands = [], [rig.truth[side + "Hand"] for side in SIDES]

    def speed(moved: CharacterMotion) -> float:
        return fastest(places_of(rig, moved)[:, hands], motion.fps)

    for contacts in (False, True):
        moved = Retargeter(rig.character, contacts=contacts)(motion)
        found.append((inside(rig, moved, rig.torso) * min(rig.torso), speed(moved)))
    with frame_by_frame():
        return row(*found, speed(Retargeter(rig.character)(motion)) if controls else 0.0)


def rigs(seed: int, count: int) -> Iterator[Rig]:
    """Stout rigs with knuckles."""
    for number in np.random.default_rng(seed).integers(1 << 30, size=20 * count):
        rig = draw(int(number), stout=True)
        if count and {"LeftHandMiddle1", "RightHandMiddle1"} <= rig.truth.keys():
            count -= 1
            yield rig


def zoo(only: tuple[str, ...] = ()) -> list[Path]:
    """The characters of the zoo that are moved, as far as this machine has them, or those of some names."""
    from tests.zoo import ANIMALS, Unavailable, character_file

    out, lacking = [], set(only) - {animal.name.removeprefix("MakeHuman ") for animal in ANIMALS}
    if lacking:
        raise ValueError(f"the zoo has no {', '.join(sorted(lacking))}")
    for animal in ANIMALS:
        if not animal.refused and (not only or animal.name.removeprefix("MakeHuman ") in only):
            try:
                out.append(character_file(animal))
            except Unavailable as why:
                print(f"left out: {animal.name} ({why})", flush=True)
    return out


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("files", nargs="*", type=Path, metavar="FILE", help="characters (default: those of the zoo)")
    p.add_argument("--rigs", type=int, default=12, help="generated rigs")
    p.add_argument("--seed", type=int, default=1, help="of the rigs' seeds")
    p.add_argument("--sitting", action="store_true", help="those who sit, alone")
    p.add_argument("--speech", type=Path, default=ROOT / "examples" / "speech.flac")
    p.add_argument("--bundle", default="default", help="the weights: default, paper, or a folder")
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    a = p.parse_args()
    gltf_skin.MOST_TRIANGLES = 1 << 22  # the whole mesh: a sample is not closed
    speech, system = load_speech(a.speech), Gesticulator.from_pretrained(a.bundle)

    def motion_of(**options: Any) -> Motion:
        return system(speech.samples, speech.sample_rate, **{"fps": FPS, "legs": True, **options}).motion

    stout = list(rigs(a.seed, a.rigs))
    names = SEATED_BODIES if a.sitting else STOUT
    chosen, largest = zoo(names), max(stout, key=lambda rig: rig.size, default=None)

    def row_of(name: str, motion: Motion) -> dict[str, float]:
        out = {**of_figure(motion), **(of_bodies(motion, chosen, largest) if chosen and largest else {})}
        print(name, {column: round(value, 2) for column, value in out.items()}, flush=True)
        return out

    bodies = f"Bodies: {'; '.join(names)}; the largest of the rigs."
    if a.sitting:
        swept = {}
        for name in SITTING:
            moved = motion_of(**{**SWEEP[name], "seated": True, "legs": False})
            swept[name] = {**in_thighs(moved), **row_of(name, moved)}
        tables = [Table("Hands of those who sit, at each knob", ON_A_SEAT, {**swept, "worst": worst(swept)}, "knobs",
                        notes=(bodies,))]
    else:
        motion, rows = motion_of(**KNOBS), dict[str, dict[str, float]]()
        for path in a.files or zoo():
            try:
                rows[path.stem.replace("_", " ")] = of_file(path, motion)
            except InputError as error:
                print(f"left out: {error}", flush=True)
        for place, rig in enumerate(stout):
            rows[f"rig {place + 1}: {rig.style}, {rig.size:g}"] = of_rig(rig, motion)
        swept = {name: row_of(name, motion_of(**knobs)) for name, knobs in SWEEP.items()}
        tables = [Table("Hands inside the bodies of characters", COLUMNS, {**rows, "worst": worst(rows)}, "character",
                        notes=(f"{len(motion) / FPS:.0f} s with --hand-radius .15 and --hold-still; stout rigs have a "
                               "trunk of 48 by 50 cm at size 1.",), facts={"seed": a.seed}),
                  Table("Hands inside the default figure and the stoutest bodies, at each knob", AT_KNOBS,
                        {**swept, "worst": worst(swept)}, "knobs", notes=(bodies,))]
    publish(tables, a.out, Provenance.now(shlex.join(["python", "benchmarks/contacts.py", *sys.argv[1:]])))


def worst(rows: dict[str, dict[str, float]]) -> dict[str, float]:
    """The largest of each figure."""
    return {name: max(row[name] for row in rows.values()) for name in next(iter(rows.values()))}


if __name__ == "__main__":
    main()
