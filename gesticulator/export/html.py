"""The preview: a self-contained page that plays and edits performances, without network access.

The page's script is built from `viewer/` into `gesticulator/assets`. A content security policy allows only its own
script and style, by their hashes, and nothing from other hosts.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion import kinematics
from data_module.motion.skeletons import HIP_HEIGHT
from data_module.types import Motion, Skeleton
from gesticulator.export import sound
from gesticulator.export.gltf import open_gltf
from gesticulator.export.writers import Scene

if TYPE_CHECKING:
    from gesticulator.characters.rig import Character
    from gesticulator.face.motion import FaceMotion

__all__ = ["write_comparison", "write_preview"]

LONG = 600.0
"""Duration in seconds above which the page uses `LONG_FPS`, so that it still opens quickly: an hour is then about 40
MB, half of it audio."""
LONG_FPS = 30.0
"""Frames per second in the page of a long recording, which interpolates; the models' rate is 20."""
QUATERNION_STEPS = 32767
"""Quaternions are stored as int16 with this many steps per unit: 3e-5, about 0.003 degrees."""
PEAKS_PER_SECOND = 100
LARGEST_CHARACTER = 48 << 20
"""Largest character file in a page, bytes: base64 adds a third, and browsers open 100 MB slowly."""
_SAME = 0.05
"""Largest difference in duration of two takes of one recording, seconds: rounding to frames."""
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")


def write_preview(path: Path, scene: Scene) -> Path:
    """Write the preview page, atomically. Returns `path`."""
    write_text(path, page({"take": scene}, title_of(path)))
    return path


def write_comparison(path: Path, takes: Mapping[str, Scene]) -> Path:
    """Write one page with two performances of one recording side by side, atomically. Returns `path`. takes: name ->
    scene; `InputError` unless they are two of one recording."""
    write_text(path, page(takes, title_of(path), together=True))
    return path


def title_of(path: Path) -> str:
    """The title of a page: the file's name without its suffix, with bytes that are not text replaced."""
    return path.stem.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def page(takes: Mapping[str, Scene], title: str, *, together: bool = False,
         more: Mapping[str, Any] | None = None) -> str:
    """The self-contained page as text.

    takes: name -> scene, one or two of one recording; the audio is that of the first. together: show both at once.
    more: further members of the page's data, such as `live`, with which `gesticulator view` renders edited plans.
    """
    first = next(iter(takes.values()))
    if len(takes) > 2:
        raise InputError(f"{len(takes)} takes", "are too many for a page", "give one or two")
    if any(abs(other.speech.duration - first.speech.duration) > _SAME for other in takes.values()):
        raise InputError("two takes", "are of recordings of different length", "give two takes of one recording")
    if together and len(takes) < 2:
        raise InputError("one take", "cannot be compared", "give two")
    live = more is not None and more.get("live") is not None
    data = {
        "title": title,
        "duration": first.speech.duration,
        "sound": _base64(sound.compress(first.speech)),
        "soundType": sound.MEDIA_TYPE,
        "peaks": _base64(sound.peaks(first.speech, PEAKS_PER_SECOND).tobytes()),
        "peaksPerSecond": PEAKS_PER_SECOND,
        "takes": [{"name": name, **describe(scene)} for name, scene in takes.items()],
        "together": together,
        **_character(first),
        **(more or {}),
    }
    return _fill(title, f'<script type="application/json" id="performance">{embedded(data)}</script>', live)


def describe(scene: Scene) -> dict[str, Any]:
    """The data of a take for the page: times in seconds, lengths in metres, arrays as base64 of little-endian numbers.

    `rotations` is int16 [T, J, 4], w first, in steps of 1 / `QUATERNION_STEPS`; `root` is float32 [T, 3], or [1, 3] for
    a still root; `plan` is the gesture plan; `face`, for a scene with one, is int16 [T, 20], `FaceMotion.values` in the
    same steps.
    """
    motion = kinematics.resample(scene.standing, page_fps(scene.speech.duration, scene.motion.fps))
    face = None if scene.face is None else np.clip(scene.face.at(np.arange(len(motion)) / motion.fps), -1.0, 1.0)
    return {
        **describe_shape(motion, scene.speech.duration),
        "rotations": _base64(np.round(motion.rotations * QUATERNION_STEPS).astype("<i2").tobytes()),
        "root": _base64(root_path(motion)),
        **({} if face is None else {"face": _base64(np.round(face * QUATERNION_STEPS).astype("<i2").tobytes())}),
        "plan": scene.plan.to_dict(),
    }


def describe_shape(motion: Motion, duration: float) -> dict[str, Any]:
    """What the page needs to know of a motion, apart from its numbers."""
    return {"duration": duration, "fps": motion.fps, "frames": len(motion), "skeleton": _skeleton(motion.skeleton),
            "steps": QUATERNION_STEPS}


def page_fps(duration: float, fps: float) -> float:
    """The frames per second of the page of a motion of this duration (seconds) and rate."""
    return min(fps, LONG_FPS) if duration > LONG else fps


def root_path(motion: Motion) -> bytes:
    """float32 [T, 3] positions of the root, or [1, 3] for a still one."""
    # Most performers stand still: one row instead of one per frame.
    root = motion.root_positions
    if np.ptp(root, axis=0).max() < 1e-6:
        root = root[:1]
    return root.astype("<f4").tobytes()


def _character(scene: Scene) -> dict[str, Any]:
    """The page's data about the user's character; empty if its format cannot be shown."""
    moved = scene.character
    return {} if moved is None or moved.character.kind != "glb" else character_data(moved.character, {
        joint: moved.character.node_ids[node] for joint, node in moved.joints.items()}, scene.face)


def character_data(rig: Character, joints: Mapping[str, int], face: FaceMotion | None = None) -> dict[str, Any]:
    """The page's data of a character: its file as GLB, our joint -> its node in the file and, if faces are shown like
    `face`, `gesticulator.face.page`. A file of more than `LARGEST_CHARACTER` bytes is omitted, and the page says
    so."""
    # A .gltf keeps its buffers beside it, and a page reads no FBX.
    path = rig.path
    name = title_of(path) + path.suffix
    file = open_gltf(path).to_bytes() if path.suffix.lower() in (".gltf", ".fbx") else path.read_bytes()
    if len(file) > LARGEST_CHARACTER:
        return {"notice": f"{name} is too large to be kept in the page. Drop the file here to see it."}
    data: dict[str, Any] = {"name": name, "data": _base64(file), "joints": dict(joints)}
    if face is not None and rig.kind == "glb":
        from gesticulator.face.page import page_face

        shapes = page_face(rig, face.lips_only)
        data |= {"face": shapes} if shapes else {}
    return {"character": data}


def _skeleton(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "names": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": np.round(skeleton.offsets, 6).tolist(),
        "tips": {skeleton.names[joint]: np.round(tip, 6).tolist() for joint, tip in skeleton.end_sites.items()},
        "height": HIP_HEIGHT,
    }


def _fill(title: str, data: str, live: bool) -> str:
    script, style = _asset("viewer.min.js.gz"), _asset("viewer.css")
    notices = _asset("viewer.licences.txt").strip()
    parts = {
        "title": html.escape(title),
        "data": data,
        "style": style,
        "script": script,
        "policy": policy(script, style, live),
        "libraries": html.escape(", ".join(re.findall(r"^(\S+ \d+\.\d+\.\d+)$", notices, re.MULTILINE))),
        "notices": html.escape(notices),
    }
    # A single pass: inserted text is not searched again.
    return _SLOT.sub(lambda found: parts[found.group(1)], _asset("viewer.html"))


def policy(script: str, style: str, live: bool) -> str:
    """The page's content security policy (level 3): the script and style with these hashes, its own audio and the
    user's images, and, with `live`, responses of its server."""
    own = "'self' " if live else ""
    return ("default-src 'none'; base-uri 'none'; form-action 'none'; "
            f"script-src {_hash(script)}; style-src {_hash(style)}; media-src blob:; img-src data: blob:; "
            # Images in a character's file are loaded through blob:.
            f"connect-src {own}blob: data:")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _asset(name: str) -> str:
    data = (resources.files("gesticulator") / "assets" / name).read_bytes()
    return (gzip.decompress(data) if name.endswith(".gz") else data).decode("utf-8")


def embedded(data: Mapping[str, Any]) -> str:
    """JSON safe for embedding in a script element: "<" is escaped, so that "</script>" in a name cannot end it."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
