"""The preview: one page that shows, plays and edits performances, with everything inside it and no network.

The page's script is built from `viewer/` into `gesticulator/assets`. What it may load is fixed by a policy in the page:
its own script and style by their hashes, and nothing from another host.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from data_module.errors import InputError
from data_module.files import write_text
from data_module.motion import kinematics
from data_module.motion.skeletons import HIP_HEIGHT
from data_module.types import Skeleton
from gesticulator.export import sound
from gesticulator.export.gltf import open_gltf
from gesticulator.export.scene import Scene

if TYPE_CHECKING:
    from gesticulator.characters.rig import CharacterMotion


class HasScene(Protocol):
    """What can give its scene, as a performance does."""

    def scene(self) -> Scene:
        """What writers are given."""
        ...


__all__ = ["write_comparison", "write_preview"]

LONG = 600.0
"""Seconds of sound above which the page holds `LONG_FPS` frames of motion a second, so that it still opens well: an
hour is then about 40 MB, of which half is the sound."""
LONG_FPS = 30.0
"""Frames per second of a long recording's page, which interpolates between them; the models' own rate is 20."""
QUATERNION_STEPS = 32767
"""Quaternions travel as int16 of this many steps per unit: 3e-5, about 0.003 degrees."""
PEAKS_PER_SECOND = 100
LARGEST_CHARACTER = 48 << 20
"""Bytes of a character's file that a page holds: in a page they are a third more, and browsers open 100 MB slowly."""
_SAME = 0.05
"""Seconds by which two takes of one recording may differ: a cut on the frame grid."""
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")


def write_preview(path: Path, scene: Scene) -> Path:
    """Write the preview page, whole or not at all. Returns `path`."""
    write_text(path, page({"take": scene}, title_of(path)))
    return path


def write_comparison(path: Path, takes: Mapping[str, Scene | HasScene]) -> Path:
    """Write one page with two performances of one recording, side by side, whole or not at all. Returns `path`.

    takes: what each is called -> a performance, or its scene. `InputError` unless they are two of one recording.
    """
    write_text(path, page({name: take if isinstance(take, Scene) else take.scene() for name, take in takes.items()},
                          title_of(path), together=True))
    return path


def title_of(path: Path) -> str:
    """What a page is called: the file's name without its suffix, which may hold bytes that are no text."""
    return path.stem.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def page(takes: Mapping[str, Scene], title: str, *, together: bool = False,
         more: Mapping[str, Any] | None = None) -> str:
    """The self-contained page as text.

    takes: what each is called -> its scene, one or two of one recording; the sound is the first one's.
    together: both are on the stage at once. more: members of its data beside those that are made here, such as `live`,
    where `gesticulator view` renders edited plans for it.
    """
    first = next(iter(takes.values()))
    if len(takes) > 2:
        raise InputError(f"{len(takes)} takes", "are too many for a page", "give one or two")
    if any(abs(other.duration - first.duration) > _SAME for other in takes.values()):
        raise InputError("two takes", "are of recordings of different length", "give two takes of one recording")
    if together and len(takes) < 2:
        raise InputError("one take", "stands beside none", "give two")
    live = more is not None and more.get("live") is not None
    data = {
        "title": title,
        "duration": first.duration,
        "sound": _base64(sound.compress(first.speech)),
        "soundType": sound.MEDIA_TYPE,
        "peaks": _base64(sound.peaks(first.speech, PEAKS_PER_SECOND).tobytes()),
        "peaksPerSecond": PEAKS_PER_SECOND,
        "takes": [{"name": name, **describe(scene)} for name, scene in takes.items()],
        "together": together,
        **_character(first.character),
        **(more or {}),
    }
    return _fill(title, f'<script type="application/json" id="performance">{embedded(data)}</script>', live)


def describe(scene: Scene) -> dict[str, Any]:
    """What the page is told of a take: times in seconds, lengths in metres, arrays as base64 of little-endian numbers.

    `rotations` is int16 [T, J, 4], w first, in steps of 1 / `QUATERNION_STEPS`; `root` is float32 [T, 3], or [1, 3]
    where the root does not move; `plan` is the gesture plan.
    """
    return {**describe_motion(scene), "plan": scene.plan.to_dict()}


def describe_motion(scene: Scene) -> dict[str, Any]:
    """`describe` without the plan."""
    motion = scene.standing
    if scene.duration > LONG and motion.fps > LONG_FPS:
        motion = kinematics.resample(motion, LONG_FPS)
    root = motion.root_positions
    if np.ptp(root, axis=0).max() < 1e-6:
        root = root[:1]
    return {
        "duration": scene.duration,
        "fps": motion.fps,
        "frames": len(motion),
        "skeleton": _skeleton(motion.skeleton),
        "rotations": _base64(np.round(motion.rotations * QUATERNION_STEPS).astype("<i2").tobytes()),
        "steps": QUATERNION_STEPS,
        "root": _base64(root.astype("<f4").tobytes()),
    }


def _character(moved: CharacterMotion | None) -> dict[str, Any]:
    """The members of the page's data about the user's character; none where she cannot be shown in a page."""
    if moved is None or moved.character.kind != "glb":
        return {}
    rig = moved.character
    return character_data(rig.path, {joint: rig.node_ids[node] for joint, node in moved.joints.items()})


def character_data(path: Path, joints: Mapping[str, int]) -> dict[str, Any]:
    """A character as the page takes it: her file as GLB, and our joint -> its node in the file.

    A file of more than `LARGEST_CHARACTER` bytes is left out, and the page says so.
    """
    name = title_of(path) + path.suffix
    file = open_gltf(path).to_bytes() if path.suffix.lower() == ".gltf" else path.read_bytes()
    if len(file) > LARGEST_CHARACTER:
        return {"notice": f"{name} is too large to be kept in the page. Drop the file here to see it."}
    return {"character": {"name": name, "data": _base64(file), "joints": dict(joints)}}


def _skeleton(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "names": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": np.round(skeleton.offsets, 6).tolist(),
        "tips": {skeleton.names[joint]: np.round(tip, 6).tolist() for joint, tip in skeleton.end_sites.items()},
        "height": HIP_HEIGHT,
    }


def _fill(title: str, data: str, live: bool) -> str:
    script, style = _asset("viewer.min.js"), _asset("viewer.css")
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
    # One pass: what is put in is not searched again.
    return _SLOT.sub(lambda found: parts[found.group(1)], _asset("viewer.html"))


def policy(script: str, style: str, live: bool) -> str:
    """What the page may load (Content Security Policy, level 3): the script and the style that have these hashes, its
    own sound and the user's pictures, and, with `live`, answers of the server that it came from."""
    own = "'self' " if live else ""
    return ("default-src 'none'; base-uri 'none'; form-action 'none'; "
            f"script-src {_hash(script)}; style-src {_hash(style)}; media-src blob:; img-src data: blob:; "
            # Pictures of a character's file are read from its bytes by way of blob:.
            f"connect-src {own}blob: data:")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _asset(name: str) -> str:
    return (resources.files("gesticulator") / "assets" / name).read_text(encoding="utf-8")


def embedded(data: Mapping[str, Any]) -> str:
    """JSON that can stand in an element: "</script>" in a name would end that; "\\u003c" is the same to JSON."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
