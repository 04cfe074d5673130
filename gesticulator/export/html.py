"""The preview: one page that shows and plays a performance, with everything inside it and no network.

Above `LONGEST_PAGE` seconds of sound the page would be too large to open well, and becomes a folder of the same name:
`index.html`, the sound, and the motion as a script (a page opened from a disk may load scripts, but not fetch files).
"""

from __future__ import annotations

import base64
import html
import json
import os
import re
import shutil
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from data_module.errors import InputError
from data_module.files import write_text
from data_module.types import BeatFlag, Skeleton
from gesticulator.export import sound
from gesticulator.export.bvh import standing
from gesticulator.performance import Performance

LONGEST_PAGE = 600.0
"""Seconds of sound that one page holds."""
THREE_VERSION = "0.170.0"
QUATERNION_STEPS = 32767
"""Quaternions travel as int16 of this many steps per unit: 3e-5, about 0.003 degrees."""
PEAKS_PER_SECOND = 100
_MARK = '<meta name="generator" content="gesticulator preview">'
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")
_SOUND_FILE, _MOTION_FILE, _INDEX = "speech.ogg", "motion.js", "index.html"


def write_preview(path: Path, performance: Performance) -> Path:
    """Write the preview page; returns the file to open.

    That is `path`, or `STEM/index.html` beside it where the sound is longer than `LONGEST_PAGE`. InputError where a
    folder of that name exists and is not a preview of ours; nothing is left half-written.
    """
    if performance.duration > LONGEST_PAGE:
        return _write_folder(path.with_suffix(""), performance)
    write_text(path, page(performance, path.stem))
    return path


def page(performance: Performance, title: str) -> str:
    """The self-contained page as text."""
    data = {**describe(performance), "sound": _base64(sound.compress(performance.speech))}
    return _fill(title, f'<script type="application/json" id="performance">{_json(data)}</script>')


def describe(performance: Performance) -> dict[str, Any]:
    """What the page is told: times in seconds, lengths in metres, arrays as base64 of little-endian numbers.

    `rotations` is int16 [T, J, 4], w first, in steps of 1 / `QUATERNION_STEPS`; `root` is float32 [T, 3], or [1, 3]
    where the root does not move; `peaks` is int8 [P, 2].
    """
    motion = standing(performance.motion)
    root = motion.root_positions
    if np.ptp(root, axis=0).max() < 1e-6:
        root = root[:1]
    blocks = performance.blocks
    words = performance.speech.words or ()
    return {
        "duration": performance.duration,
        "fps": motion.fps,
        "frames": len(motion),
        "skeleton": _skeleton(motion.skeleton),
        "rotations": _base64(np.round(motion.rotations * QUATERNION_STEPS).astype("<i2").tobytes()),
        "steps": QUATERNION_STEPS,
        "root": _base64(root.astype("<f4").tobytes()),
        "peaks": _base64(sound.peaks(performance.speech, PEAKS_PER_SECOND).tobytes()),
        "peaksPerSecond": PEAKS_PER_SECOND,
        "soundType": sound.MEDIA_TYPE,
        "flagNames": {int(flag): flag.name.lower() for flag in BeatFlag},
        "blocks": {
            "edges": [round(edge, 5) for edge in blocks.edges.tolist()],
            "flags": blocks.flags.tolist(),
            "silent": blocks.silent.astype(int).tolist(),
            "lexemes": performance.lexemes.tolist(),
            "best": performance.best.tolist(),
            "scores": [[float(f"{score:.4g}") for score in row] for row in performance.scores.tolist()],
        },
        "words": [[word.text, round(word.start, 3), round(word.end, 3)] for word in words if word.text],
    }


def _skeleton(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "names": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": np.round(skeleton.offsets, 6).tolist(),
        "tips": {skeleton.names[joint]: np.round(tip, 6).tolist() for joint, tip in skeleton.end_sites.items()},
    }


def _write_folder(folder: Path, performance: Performance) -> Path:
    if folder.exists() and not _is_ours(folder):
        raise InputError(folder, "exists and is not a preview", "give another name")
    data = {**describe(performance), "soundFile": _SOUND_FILE}
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        (temporary / _SOUND_FILE).write_bytes(sound.compress(performance.speech))
        write_text(temporary / _MOTION_FILE, f"window.PERFORMANCE = {_json(data)};\n")
        write_text(temporary / _INDEX, _fill(folder.name, f'<script src="{_MOTION_FILE}"></script>'))
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o777 & ~mask)
        (temporary / _SOUND_FILE).chmod(0o666 & ~mask)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(temporary, folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return folder / _INDEX


def _is_ours(folder: Path) -> bool:
    index = folder / _INDEX
    return index.is_file() and _MARK in index.read_text(encoding="utf-8", errors="replace")[:4000]


def _fill(title: str, data: str) -> str:
    parts = {
        "mark": _MARK,
        "title": html.escape(title),
        "data": data,
        "style": _asset("preview.css"),
        "script": _asset("preview.js"),
        "three": _asset("three.module.min.js"),
        "three_version": THREE_VERSION,
        "three_notice": html.escape(_asset("three.LICENSE.txt").strip()),
    }
    # One pass: what is put in is not searched again.
    return _SLOT.sub(lambda found: parts[found.group(1)], _asset("preview.html"))


def _asset(name: str) -> str:
    return (resources.files("gesticulator") / "assets" / name).read_text(encoding="utf-8")


def _json(data: dict[str, Any]) -> str:
    # "</script>" in a word or a name would end the element; "<\u002f" is the same string to JSON.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("</", "<\\u002f").replace("<!--", "<\\u0021--")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
