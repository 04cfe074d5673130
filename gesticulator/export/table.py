"""`.csv`: one row per joint and frame, for spreadsheets, pandas or databases."""

import io
from pathlib import Path

import numpy as np

from data_module.files import write_text
from gesticulator.export.writers import Scene

COLUMNS = ("time", "joint", "parent", "x", "y", "z", "qw", "qx", "qy", "qz")
"""time: seconds. joint, parent: names of the joint and its parent ("" for the root). x, y, z: world position, metres, Y
up. qw, qx, qy, qz: rotation in the parent's frame, a unit quaternion; on the default skeleton the identity is the
T-pose."""


def write_csv(path: Path, scene: Scene) -> Path:
    """Write the motion as CSV with a header, atomically. Returns `path`."""
    motion = scene.nodes
    above = ["" if parent < 0 else motion.names[parent] for parent in motion.parents]
    labels = [f"{_quoted(joint)},{_quoted(parent)}" for joint, parent in zip(motion.names, above, strict=True)]
    # World places and local rotations: the first are what people plot, the second what they animate with.
    numbers = np.concatenate([motion.positions(), motion.turns], axis=-1)
    body = io.StringIO()
    body.write(",".join(COLUMNS) + "\n")
    # Adding 0.0 turns -0.0 into 0.0, so that equal motions give equal bytes.
    for time, frame in zip(motion.times.tolist(), (numbers + 0.0).tolist(), strict=True):
        body.writelines(f"{time:.6f},{label},{x:.6f},{y:.6f},{z:.6f},{qw:.7f},{qx:.7f},{qy:.7f},{qz:.7f}\n"
                        for label, (x, y, z, qw, qx, qy, qz) in zip(labels, frame, strict=True))
    write_text(path, body.getvalue())
    return path


def _quoted(name: str) -> str:
    """A name as a CSV cell, quoted if necessary."""
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\r\n') else name
