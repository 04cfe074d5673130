"""`.usda` and `.usdc`: OpenUSD (UsdSkel) as text and binary: a skeleton, a plain figure bound to it, an animation; with
a face, blend shapes in ARKit's names.

One time code is one frame; metres, Y up. Joints are paths of names ("Hips/Spine"); characters not allowed in USD names
become "_".
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.files import write_bytes
from gesticulator.export.clip import NAME, ClipLayout
from gesticulator.export.glb import FigureMesh, figure
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.writers import Scene
from gesticulator.face.shapes import ARKIT, arkit

if TYPE_CHECKING:
    from gesticulator.face.motion import FaceMotion

ROOT = "/Character"


def write_usd(path: Path, scene: Scene) -> Path:
    """Write the motion as USD, atomically. Returns `path`."""
    from pxr import Usd

    suffix = path.suffix.lower()
    with tempfile.TemporaryDirectory() as folder:
        # OpenUSD writes to a path of its own: the result is moved at the end, atomically.
        target = Path(folder) / f"motion{suffix}"
        stage = Usd.Stage.CreateNew(str(target))
        animation = _fill(stage, scene.nodes, scene.clip)
        if scene.face is not None:
            _express(animation, scene.face)
        if scene.clip.sound:
            _refer_to_sound(stage, path.with_suffix(".wav").name)
        stage.GetRootLayer().Save()
        write_bytes(path, target.read_bytes())
    return path


def _fill(stage: Any, motion: NodeMotion, clip: ClipLayout) -> Any:
    """Write skeleton, figure and animation; returns the animation."""
    from pxr import Gf, UsdGeom, UsdSkel

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, motion.unit)
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
    _dress(stage, skeleton, figure(motion))
    return animation


def _express(animation: Any, face: FaceMotion) -> None:
    """Add the weights of ARKit's 52 blend shapes to an animation, for meshes with such shapes."""
    from pxr import Usd, Vt

    curves = arkit(face)
    if face.lips_only:
        curves |= {name: np.zeros(len(face)) for name in ARKIT if name.startswith(("eye", "brow"))}
    animation.CreateBlendShapesAttr(list(ARKIT))
    track = animation.CreateBlendShapeWeightsAttr()
    for frame, values in enumerate(np.stack([curves[name] for name in ARKIT], axis=1).astype(np.float32)):
        track.Set(Vt.FloatArray.FromNumpy(values), Usd.TimeCode(frame))


def _refer_to_sound(stage: Any, name: str) -> None:
    """Name the sound file that lies beside the motion, to be played from the first frame on, from everywhere."""
    from pxr import Sdf, UsdMedia

    sound = UsdMedia.SpatialAudio.Define(stage, f"{ROOT}/Speech")
    # Relative, so that the two files can be moved together.
    sound.CreateFilePathAttr(Sdf.AssetPath(f"./{name}"))
    sound.CreateAuralModeAttr(UsdMedia.Tokens.nonSpatial)
    sound.CreatePlaybackModeAttr(UsdMedia.Tokens.onceFromStart)
    sound.CreateStartTimeAttr(Sdf.TimeCode(0.0))


def _animate(animation: Any, motion: NodeMotion) -> None:
    from pxr import Gf, Usd, Vt

    # Scales are half floats in UsdSkel.
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(*scale) for scale in motion.scales.tolist()]))
    turns, places = animation.CreateRotationsAttr(), animation.CreateTranslationsAttr()
    # One array for all frames: only the nodes with a path change between them.
    moved = motion.translations.astype(np.float32)
    for frame, pose in enumerate(motion.turns.tolist()):
        time = Usd.TimeCode(frame)
        turns.Set(Vt.QuatfArray([Gf.Quatf(*turn) for turn in pose]), time)
        for node, track in motion.shifts.items():
            moved[node] = track[frame]
        places.Set(Vt.Vec3fArray.FromNumpy(moved), time)


def _dress(stage: Any, skeleton: Any, body: FigureMesh) -> None:
    from pxr import Gf, UsdGeom, UsdSkel, Vt

    mesh = UsdGeom.Mesh.Define(stage, f"{ROOT}/Figure")
    count = len(body.positions)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(body.positions.astype(np.float32)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(body.normals.astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * (count // 3)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(list(range(count))))
    # Without this, viewers smooth the mesh as a subdivision surface.
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(0.24, 0.45, 0.47)])
    if count:
        mesh.CreateExtentAttr([Gf.Vec3f(*edge.tolist()) for edge in (body.positions.min(0), body.positions.max(0))])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(False, 1).Set(Vt.IntArray(body.joints.tolist()))
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
