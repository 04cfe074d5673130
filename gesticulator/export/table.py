"""`.csv` and `.parquet`: one row per joint and frame, for spreadsheets, pandas or databases."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from data_module.files import write_bytes, write_text
from gesticulator.export.nodes import NodeMotion
from gesticulator.export.writers import Scene

COLUMNS = ("time", "joint", "parent", "x", "y", "z", "qw", "qx", "qy", "qz")
"""time: seconds. joint, parent: names of the joint and its parent ("" for the root). x, y, z: world position, metres, Y
up. qw, qx, qy, qz: rotation in the parent's frame, a unit quaternion; on the default skeleton the identity is the
T-pose."""


def write_csv(path: Path, scene: Scene) -> Path:
    """Write the motion as CSV with a header, atomically. Returns `path`."""
    times, joints, parents, numbers = _cells(scene.nodes)
    labels = [f"{_quoted(joint)},{_quoted(parent)}" for joint, parent in zip(joints, parents, strict=True)]
    body = io.StringIO()
    body.write(",".join(COLUMNS) + "\n")
    # Adding 0.0 turns -0.0 into 0.0, so that equal motions give equal bytes.
    for time, frame in zip(times.tolist(), (numbers + 0.0).tolist(), strict=True):
        body.writelines(f"{time:.6f},{label},{x:.6f},{y:.6f},{z:.6f},{qw:.7f},{qx:.7f},{qy:.7f},{qz:.7f}\n"
                        for label, (x, y, z, qw, qx, qy, qz) in zip(labels, frame, strict=True))
    write_text(path, body.getvalue())
    return path


def write_parquet(path: Path, scene: Scene) -> Path:
    """Write the motion as Apache Parquet (float32), atomically; the metadata hold `frames_per_second` and `generator`.
    Returns `path`."""
    import pyarrow
    from pyarrow import parquet

    from gesticulator.version import __version__

    motion = scene.nodes
    times, joints, parents, numbers = _cells(motion)
    repeated: dict[str, Any] = {"time": np.repeat(times, len(joints))}
    for column, names in (("joint", joints), ("parent", parents)):
        # Names as indices into a dictionary, expanded by Arrow: no Python string for each row.
        codes = pyarrow.array(np.tile(np.arange(len(names), dtype=np.int32), len(times)))
        repeated[column] = pyarrow.DictionaryArray.from_arrays(codes, pyarrow.array(names)).cast(pyarrow.string())
    flat = numbers.reshape(-1, numbers.shape[-1]).astype(np.float32)
    repeated |= {name: flat[:, index] for index, name in enumerate(COLUMNS[3:])}
    table = pyarrow.table(repeated).replace_schema_metadata(
        {"frames_per_second": f"{motion.fps:g}", "generator": f"gesticulator {__version__}"})
    out = io.BytesIO()
    parquet.write_table(table, out, compression="zstd")
    write_bytes(path, out.getvalue())
    return path


def _cells(motion: NodeMotion) -> tuple[np.ndarray, list[str], list[str], np.ndarray]:
    """Times [T], names of joints and parents (N each), and positions with rotations [T, N, 7]."""
    # World places and local rotations: the first are what people plot, the second what they animate with.
    above = ["" if parent < 0 else motion.names[parent] for parent in motion.parents]
    return motion.times, list(motion.names), above, np.concatenate([motion.positions(), motion.turns], axis=-1)


def _quoted(name: str) -> str:
    """A name as a CSV cell, quoted if necessary."""
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\r\n') else name
