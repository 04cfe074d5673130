"""Do characters without a mapping move as ours does? python benchmarks/retarget.py [--rigs 200] [--seed 1] [--placed]

Rigs are drawn by `tests/rigs.py` (names x rest pose x units x twist and extra bones x proportions), their joints are
looked for, and a gesture of the shipped weights is brought onto each, on legs. What is told, by kind of names: how many
rigs have all joints found, and the worst of all frames and rigs: degrees by which bones, palms, fingers, feet and trunk
point elsewhere than ours, millimetres by which an ankle is off the place where ours is. With --seed the rigs are others
than those of `tests/test_retarget_rigs.py`, which run with the tests. With --placed each rig goes through a GLB file
that stands or is placed otherwise than its mesh was bound (posed, turned, lying, scaled, mirrored), with a mesh that is
checked, and the table is by these.
"""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from dataclasses import replace  # noqa: E402

from data_module.types import Motion  # noqa: E402
from eval.table import Column, Provenance, Table, publish  # noqa: E402
from gesticulator import Gesticulator  # noqa: E402
from gesticulator.characters.joints import find_joints  # noqa: E402
from gesticulator.characters.mapping import SURE  # noqa: E402
from gesticulator.characters.retarget import Retargeter  # noqa: E402
from tests.rig_errors import LIMITS, worst  # noqa: E402
from tests.rigs import PLACES, draw, placed  # noqa: E402

FRAMES = 40
"""Frames of the gesture that are compared, evenly over it."""
COLUMNS = {"rigs": Column("rigs"), "found": Column("all joints found"), **{
    name: Column(name, "degrees", 2, "low") for name in LIMITS if name != "slide"},
    "slide": Column("feet off their place", "mm", 2, "low"), "kept": Column("within the bounds")}


def gesture() -> Motion:
    """Some frames of what the shipped weights make of the example, on legs."""
    motion = Gesticulator.from_pretrained()(ROOT / "examples" / "speech.flac", fps=20.0, legs=True).motion
    kept = np.linspace(10, len(motion) - 10, FRAMES).astype(int)
    return replace(motion, rotations=motion.rotations[kept], root_positions=motion.root_positions[kept])


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rigs", type=int, default=200)
    p.add_argument("--seed", type=int, default=1, help="of the rigs' seeds")
    p.add_argument("--placed", action="store_true", help="through files that stand or are placed otherwise than bound")
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    a = p.parse_args()
    seeds = np.random.default_rng(a.seed).integers(1 << 30, size=a.rigs)
    motion = gesture()
    by_style: dict[str, list[dict[str, float]]] = {}
    for seed in seeds:
        rig, kind = draw(int(seed)), ""
        if a.placed:
            if rig.character.kind != "glb":
                continue
            rng = np.random.default_rng(int(seed))
            kind = str(rng.choice(PLACES))
            with tempfile.TemporaryDirectory() as folder:
                rig = placed(rig, kind, rng, Path(folder) / "rig.glb")
        found = find_joints(rig.character)
        right = (dict(found.joints) == rig.truth and list(found.spine) == rig.spine and list(found.neck) == rig.neck
                 and found.confidence >= SURE)
        errors = worst(rig, motion, Retargeter(rig.character, contacts=False)(motion)) if right else dict.fromkeys(
            LIMITS, np.inf)
        kept = all(value <= LIMITS[name] for name, value in errors.items())
        if not kept:
            print(f"not kept: seed {seed}, {rig.style}, {rig.pose}, {kind}", flush=True)
        by_style.setdefault(kind or rig.style, []).append({**errors, "found": right, "kept": kept})
    rows = {style: row(by_style[style]) for style in sorted(by_style)}
    rows["all"] = row([one for own in by_style.values() for one in own])
    bounds = ", ".join(f"{name} {1000 * value:g} mm" if name == "slide" else f"{name} {value:g}" for name, value
                       in LIMITS.items())
    publish([Table("Characters without a given mapping", COLUMNS, rows, "placed" if a.placed else "names like", notes=(
        f"The worst of {FRAMES} frames of a gesture and of all rigs of a kind. Bounds: {bounds}.",),
        facts={"rigs": sum(map(len, by_style.values())), "seed": a.seed, "frames": FRAMES})], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/retarget.py", *sys.argv[1:]])))


def row(of: list[dict[str, float]]) -> dict[str, float | str]:
    """The worst of some rigs, and how many are as they should be."""
    out: dict[str, float | str] = {"rigs": str(len(of))}
    out |= {name: max(one[name] for one in of) * (1000.0 if name == "slide" else 1.0) for name in LIMITS}
    return out | {name: f"{sum(bool(one[name]) for one in of)}" for name in ("found", "kept")}


if __name__ == "__main__":
    main()
