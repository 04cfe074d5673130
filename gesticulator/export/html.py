"""The preview: one page that shows and plays a performance, with everything inside it and no network."""

from __future__ import annotations

import base64
import html
import json
import re
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.files import write_text
from data_module.motion import kinematics
from data_module.motion.skeletons import standing
from data_module.types import BeatFlag, Skeleton
from gesticulator.export import sound

if TYPE_CHECKING:
    from gesticulator.performance import Performance

LONG = 600.0
"""Seconds of sound above which the page holds `LONG_FPS` frames of motion a second, so that it still opens well: an
hour is then about 40 MB, of which half is the sound."""
LONG_FPS = 30.0
"""Frames per second of a long recording's page, which interpolates between them; the models' own rate is 20."""
THREE_VERSION = "0.170.0"
QUATERNION_STEPS = 32767
"""Quaternions travel as int16 of this many steps per unit: 3e-5, about 0.003 degrees."""
PEAKS_PER_SECOND = 100
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")


def write_preview(path: Path, performance: Performance) -> Path:
    """Write the preview page, whole or not at all. Returns `path`."""
    # A file's name may hold bytes that are no text.
    title = path.stem.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    write_text(path, page(performance, title))
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
    if performance.duration > LONG and motion.fps > LONG_FPS:
        motion = kinematics.resample(motion, LONG_FPS)
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
        "scoreIs": performance.score_is,
        "worth": _worth(performance),
        "words": [[word.text, round(word.start, 3), round(word.end, 3)] for word in words if word.text],
    }


def _worth(performance: Performance) -> dict[str, Any] | None:
    """What the candidates and, last, the played lexeme were worth, and the runner-up with what it was worth more."""
    worth = performance.weighed
    if worth is None:
        return None
    others = [worth.runner_up(best, int(played), block)
              for block, (best, played) in enumerate(zip(performance.best, performance.lexemes, strict=True))]
    return {"prior": np.round(worth.prior, 4).tolist(), "advantage": np.round(worth.advantage, 3).tolist(),
            "runnerUp": [[other["id"], round(other["worth_more"], 3)] for other in others]}


def _skeleton(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "names": list(skeleton.names),
        "parents": list(skeleton.parents),
        "offsets": np.round(skeleton.offsets, 6).tolist(),
        "tips": {skeleton.names[joint]: np.round(tip, 6).tolist() for joint, tip in skeleton.end_sites.items()},
    }


def _fill(title: str, data: str) -> str:
    parts = {
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
