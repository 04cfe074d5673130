"""`.fbx`: the GLB converted by Blender; a character from FBX keeps the meshes and materials of its file."""

import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_module.errors import shown
from data_module.files import write_bytes
from gesticulator.characters.blender import SCRIPT, BlenderWarning, run_in_blender, say
from gesticulator.export.glb import document_of
from gesticulator.export.writers import Scene


def _without_other_shading(document: dict[str, Any]) -> None:
    """Give materials that FBX has no word for the plain colours that they have: else Blender drops their textures, and
    takes what they do not say for metal."""
    for material in filter(lambda entry: isinstance(entry, dict), document.get("materials", [])):
        extensions = material.get("extensions") or {}
        unlit, glossy = (extensions.pop(f"KHR_materials_{kind}", None) for kind in ("unlit", "pbrSpecularGlossiness"))
        plain = material.setdefault("pbrMetallicRoughness", {})
        if isinstance(glossy, dict):
            plain |= {name: glossy[other] for other, name in (
                ("diffuseFactor", "baseColorFactor"), ("diffuseTexture", "baseColorTexture")) if other in glossy}
        if unlit is not None or glossy is not None:
            plain["metallicFactor"] = 0.0
    document.pop("extensionsRequired", None)


def write_fbx(path: Path, scene: Scene) -> Path:
    """Write the motion as binary FBX, atomically. Returns `path`. `InputError` without Blender or if it fails.

    It holds one animation: those of a character's own file are left out, with a `BlenderWarning`.
    """
    clip, moved = scene.clip, scene.character
    # All frames: the keys are reduced once, by Blender's exporter, within the same bound.
    gltf = document_of(scene=replace(scene, layout=replace(clip, keys=0.0)))
    *others, gesture = gltf.document["animations"]
    # Blender makes the first of several animations the one that it writes.
    gltf.document["animations"] = [gesture]
    _without_other_shading(gltf.document)
    if others:
        names = ", ".join(shown(entry.get("name", "unnamed")) for entry in others[:5])
        warnings.warn(BlenderWarning(f"{path.name}: holds {clip.name} alone, not the {len(others)} clips of the "
                                     f"character's file ({names}); a .glb holds all"), stacklevel=3)
    original = [] if moved is None or moved.character.path.suffix.lower() != ".fbx" else [moved.character.path]
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "motion.glb", Path(folder) / "motion.fbx"
        source.write_bytes(gltf.to_bytes())
        say(path, run_in_blender(path, SCRIPT, str(source), str(target), repr(scene.motion.fps), repr(clip.keys),
                                 clip.name, *(str(file.resolve()) for file in original)))
        write_bytes(path, target.read_bytes())
    return path
