"""Do hands enter the body of a character? python benchmarks/contacts.py [FILE ...] [--rigs 12] [--seed 1]

A performance of the shipped weights with the hands near the body (`--hand-radius .15`, `--hold-still`) is brought onto
characters in files (by default those of the zoo that are moved, `tests/zoo.py`) and onto generated rigs with a trunk
twice as deep as ours, with the correction of contacts and without. Shown are the share of time in which a wrist or
knuckle of the worse moment is inside the body, the depth, and the fastest hand; and how fast that is where each frame
is corrected by itself (`gesticulator.characters.trunk` without `gesticulator.characters.detours`), the control. Inside
of a file is what its skinned mesh without the arms encloses (its winding number is above one half), and the depth is
the distance from the mesh; of a rig, the column that its mesh was made of. A file without a mesh has no body to be
inside of, and is left out.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from data_module.errors import InputError  # noqa: E402
from data_module.speech.audio import load_speech  # noqa: E402
from data_module.types import Array, Motion  # noqa: E402
from eval.table import Column, Provenance, Table, publish  # noqa: E402
from gesticulator import Gesticulator  # noqa: E402
from gesticulator.characters import detours, gltf_skin, shape  # noqa: E402
from gesticulator.characters.mapping import SIDES, ancestors  # noqa: E402
from gesticulator.characters.reading import read_character  # noqa: E402
from gesticulator.characters.retarget import Retargeter  # noqa: E402
from gesticulator.characters.rig import CharacterMotion, Skin  # noqa: E402
from tests.rig_errors import inside, places_of  # noqa: E402
from tests.rigs import Rig, draw  # noqa: E402

KNOBS = {"hand_radius": 0.15, "hold_still": ((3.2, 5.0), (12.0, 15.0))}
FPS, EVERY = 30.0, 3
"""Frames per second of the motion; every third is held against a mesh."""
DEEP = 0.01
"""Metres that a hand may be inside for half of a percent of the time."""
NEAREST = 60
"""Triangles, by their middles, among which the nearest is looked for."""
COLUMNS = {"free": Column("inside, uncorrected", "%", 1, "low"), "free_deep": Column("deepest", "mm", 1, "low"),
           "free_speed": Column("fastest hand", "m/s", 2), "kept": Column("inside", "%", 1, "low"),
           "kept_over": Column("over 1 cm inside", "%", 1, "low"),
           "kept_deep": Column("deepest, corrected", "mm", 1, "low"),
           "kept_speed": Column("fastest hand, corrected", "m/s", 2, "low"),
           "framed_speed": Column("corrected frame by frame", "m/s", 2, "low")}


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
    bind, world = shape.bind_matrices(retargeter.character), moved.world_matrices()[::EVERY]
    nodes = [joints[side + part] for side in SIDES for part in ("Hand", "HandMiddle1") if side + part in joints]
    out = np.zeros(len(world))
    for frame, matrices in enumerate(world):
        points = skin.posed(bind, matrices[None])[0] * unit
        low, high = points.min(axis=0), points.max(axis=0)
        for hand in matrices[nodes][:, :3, 3] * unit:
            if (hand > low).all() and (hand < high).all():
                corners = points[skin.triangles]
                if winding(corners, hand) > 0.5:
                    out[frame] = max(out[frame], distance(corners, hand))
    return out


def fastest(hands: Array) -> float:
    """m/s of hands [T, 2, 3], metres."""
    return float(np.linalg.norm(np.diff(hands, axis=0), axis=-1).max()) * FPS


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


def of_file(path: Path, motion: Motion) -> dict[str, float]:
    """The row of a character's file."""
    retargeter = Retargeter(read_character(path))
    if not len(retargeter.character.skin.triangles):
        raise InputError(path, "holds no mesh", "give a file with a mesh")
    unit = retargeter.body.unit
    skin, hands, found = body_skin(retargeter), [retargeter.mapping.joints[side + "Hand"] for side in SIDES], []
    for contacts in (False, True):
        retargeter.contacts = contacts
        moved = retargeter(motion)
        found.append((depths(retargeter, skin, moved), fastest(moved.world_matrices()[:, hands, :3, 3] * unit)))
    with frame_by_frame():
        return row(*found, fastest(retargeter(motion).world_matrices()[:, hands, :3, 3] * unit))


def of_rig(rig: Rig, motion: Motion) -> dict[str, float]:
    """The row of a generated rig, whose trunk is known."""
    found, hands = [], [rig.truth[side + "Hand"] for side in SIDES]
    for contacts in (False, True):
        moved = Retargeter(rig.character, contacts=contacts)(motion)
        found.append((inside(rig, moved, rig.torso) * min(rig.torso), fastest(places_of(rig, moved)[:, hands])))
    with frame_by_frame():
        return row(*found, fastest(places_of(rig, Retargeter(rig.character)(motion))[:, hands]))


def rigs(seed: int, count: int) -> Iterator[Rig]:
    """Stout rigs with knuckles."""
    for number in np.random.default_rng(seed).integers(1 << 30, size=20 * count):
        rig = draw(int(number), stout=True)
        if count and {"LeftHandMiddle1", "RightHandMiddle1"} <= rig.truth.keys():
            count -= 1
            yield rig


def zoo() -> list[Path]:
    """The characters of the zoo that are moved, as far as this machine has them."""
    from tests.zoo import ANIMALS, Unavailable, character_file

    out = []
    for animal in ANIMALS:
        if not animal.refused:
            try:
                out.append(character_file(animal))
            except Unavailable as lacking:
                print(f"left out: {animal.name} ({lacking})", flush=True)
    return out


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("files", nargs="*", type=Path, metavar="FILE", help="characters (default: those of the zoo)")
    p.add_argument("--rigs", type=int, default=12, help="generated rigs")
    p.add_argument("--seed", type=int, default=1, help="of the rigs' seeds")
    p.add_argument("--speech", type=Path, default=ROOT / "examples" / "speech.flac")
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    a = p.parse_args()
    gltf_skin.MOST_TRIANGLES = 1 << 22  # the whole mesh: a sample is not closed
    speech = load_speech(a.speech)
    motion = Gesticulator.from_pretrained()(speech.samples, speech.sample_rate, fps=FPS, legs=True, **KNOBS).motion
    rows: dict[str, dict[str, float]] = {}
    for path in a.files or zoo():
        try:
            rows[path.stem.replace("_", " ")] = of_file(path, motion)
        except InputError as error:
            print(f"left out: {error}", flush=True)
    for place, rig in enumerate(rigs(a.seed, a.rigs)):
        rows[f"rig {place + 1}: {rig.style}, {rig.size:g}"] = of_rig(rig, motion)
    worst = {name: max(one[name] for one in rows.values()) for name in COLUMNS}
    publish([Table("Hands inside the bodies of characters", COLUMNS, {**rows, "worst": worst}, "character", notes=(
        f"{len(motion) / FPS:.0f} s with --hand-radius .15 and --hold-still; stout rigs have a trunk of 48 by 50 cm at "
        "size 1.",), facts={"seed": a.seed})], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/contacts.py", *sys.argv[1:]])))


if __name__ == "__main__":
    main()
