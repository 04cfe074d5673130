"""`.usda` and `.usdc`: OpenUSD (UsdSkel) as text and binary: a skeleton, a plain figure bound to it, an animation.

One time code is one frame; metres, Y up. Joints are paths of names ("Hips/Spine"); characters not allowed in USD names
become "_".
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from data_module.files import write_bytes
from gesticulator.export.clip import NAME, ClipLayout
from gesticulator.export.glb import figure
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.writers import Scene

ROOT = "/Character"


def write_usd(path: Path, scene: Scene) -> Path:
    """Write the motion as USD, atomically. Returns `path`."""
    from pxr import Usd

    suffix = path.suffix.lower()
    with tempfile.TemporaryDirectory() as folder:
        # OpenUSD writes to a path of its own: the result is moved at the end, atomically.
        target = Path(folder) / f"motion{suffix}"
        stage = Usd.Stage.CreateNew(str(target))
        _fill(stage, scene.nodes, scene.clip)
        stage.GetRootLayer().Save()
        write_bytes(path, target.read_bytes())
    return path


def _fill(stage: Any, motion: NodeMotion, clip: ClipLayout) -> None:
    """Write skeleton, figure and animation."""
    from pxr import Gf, UsdGeom, UsdSkel

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(motion.fps)
    stage.SetFramesPerSecond(motion.fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(motion) - 1)
    root = UsdSkel.Root.Define(stage, ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    joints = joint_paths(motion)
    rest = motion.rest_matrices()
    skeleton = UsdSkel.Skeleton.Define(stage, f"{ROOT}/Skeleton")
    skeleton.CreateJointsAttr(joints)
    # USD uses row vectors: its matrices are the transposes of ours.
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(*matrix.T.ravel().tolist()) for matrix in rest])
    local = [matrix if parent < 0 else np.linalg.inv(rest[parent]) @ matrix
             for matrix, parent in zip(rest, motion.parents, strict=True)]
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(*matrix.T.ravel().tolist()) for matrix in local])
    name = "Gesture" if clip.name == NAME else _valid_name(clip.name)
    animation = UsdSkel.Animation.Define(stage, f"{ROOT}/Skeleton/{name}")
    animation.CreateJointsAttr(joints)
    _animate(animation, motion)
    binding = UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    _dress(stage, skeleton, motion)


def _animate(animation: Any, motion: NodeMotion) -> None:
    from pxr import Gf, Usd, Vt

    # Scales are half floats in UsdSkel.
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 1.0, 1.0)] * len(motion.names)))
    turns, places = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    # One array for all frames: only the nodes with a path change between them.
    moved = motion.translations.astype(np.float32)
    for frame, pose in enumerate(motion.turns.tolist()):
        time = Usd.TimeCode(frame)
        turns.Set(Vt.QuatfArray([Gf.Quatf(*turn) for turn in pose]), time)
        for node, track in motion.shifts.items():
            moved[node] = track[frame]
        places.Set(Vt.Vec3fArray.FromNumpy(moved), time)


def _dress(stage: Any, skeleton: Any, motion: NodeMotion) -> None:
    """Bind a plain figure to the skeleton."""
    from pxr import Gf, UsdGeom, UsdSkel, Vt

    mesh = UsdGeom.Mesh.Define(stage, f"{ROOT}/Figure")
    positions, normals, owners = figure(motion)
    count = len(positions)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(positions.astype(np.float32)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * (count // 3)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(list(range(count))))
    # Without this, viewers smooth the mesh as a subdivision surface.
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(0.24, 0.45, 0.47)])
    if count:
        mesh.CreateExtentAttr([Gf.Vec3f(*edge.tolist()) for edge in (positions.min(0), positions.max(0))])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 1).Set(Vt.IntArray(owners.tolist()))
    binding.CreateJointWeightsPrimvar(False, 1).Set(Vt.FloatArray([1.0] * count))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))


def joint_paths(motion: NodeMotion) -> list[str]:
    """The nodes as paths of valid USD names: "Hips/Spine"."""
    paths: list[str] = []
    for name, parent in zip(motion.names, motion.parents, strict=True):
        plain = _valid_name(name)
        path = plain if parent < 0 else f"{paths[parent]}/{plain}"
        # Two names may become equal when invalid characters are replaced.
        while path in paths:
            path += "_"
        paths.append(path)
    return paths


def _valid_name(name: str) -> str:
    plain = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in name)
    return f"_{plain}" if not plain or plain[0].isdigit() else plain
