"""A temporary file for numbers that do not fit into memory, later copied into the output file."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np
from numpy.typing import NDArray

_COPIED = 1 << 20


class NumberFile:
    """Rows of float32 [n, *shape], little-endian, appended in pieces. The system deletes the file with the process."""

    def __init__(self, folder: Path, shape: tuple[int, ...] = ()) -> None:
        """folder: where to create it, preferably that of the final file; shape: of a row."""
        self.shape = shape
        self.lowest = np.full(max(1, int(np.prod(shape))), np.inf)
        """The lowest value of each column."""
        self.highest = -self.lowest
        """The highest value of each column."""
        self._rows = 0
        self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by `close`

    def __len__(self) -> int:
        return self._rows

    @property
    def size(self) -> int:
        return 4 * self._rows * len(self.lowest)

    def add(self, values: NDArray[np.floating]) -> None:
        """Append rows [n, *shape], at least one."""
        data = np.ascontiguousarray(values, dtype="<f4").reshape(len(values), -1)
        self._file.write(data.tobytes())
        self._rows += len(data)
        self.lowest, self.highest = np.minimum(self.lowest, data.min(0)), np.maximum(self.highest, data.max(0))

    def copy_to(self, out: BinaryIO) -> None:
        """Write all rows to another file."""
        self._file.seek(0)
        shutil.copyfileobj(self._file, out, _COPIED)

    def close(self) -> None:
        self._file.close()
