"""Inference for recordings of any length in bounded memory: audio is read in pieces, fed to a stream, and frames are
written as they come. The output is byte-identical to processing the recording at once.

Only the lexeme of each block is kept: about 70 KB per hour.
"""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

import numpy as np

from data_module.files import new_file
from data_module.motion.bvh import BvhWriter
from data_module.motion.skeletons import standing
from data_module.speech.audio import SAMPLE_RATE, LevelMeter, SpeechPieces
from data_module.types import Motion, Skeleton
from gesticulator.export.writers import UNITS
from gesticulator.options import InferenceArguments

if TYPE_CHECKING:
    from gesticulator.bundle.bundle import Bundle
    from gesticulator.export.clip import ClipLayout
    from gesticulator.pipeline import Gesticulator

_COPIED = 1 << 20
"""Bytes copied at a time."""


class FrameWriter(Protocol):
    """Writes a motion whose frames arrive in pieces."""

    def expect(self, frames: int) -> None:
        """`InputError` if the file cannot hold this many frames."""

    def add(self, motion: Motion) -> None:
        """Append frames."""

    def finish(self) -> None:
        """Complete the file; no frames follow."""

    def close(self) -> None:
        """Delete temporary files; a file that was not finished is discarded."""


class BvhFile:
    """A .bvh file. Its header holds the number of frames, so frames are kept in a temporary file until it is known."""

    def __init__(self, path: Path, skeleton: Skeleton, fps: float, unit: str = "cm",
                 _clip: ClipLayout | None = None) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._text = path, BvhWriter(skeleton, fps, UNITS[unit])
        self._rows: IO[bytes] = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115 - closed by `close`

    def expect(self, frames: int) -> None:
        """A BVH file holds any number of frames."""

    def add(self, motion: Motion) -> None:
        self._rows.write(self._text.rows(standing(motion)).encode("ascii"))

    def finish(self) -> None:
        self._rows.seek(0)
        with new_file(self._path) as out:
            out.write(self._text.head().encode("utf-8"))
            shutil.copyfileobj(self._rows, out, _COPIED)

    def close(self) -> None:
        self._rows.close()


@dataclass(frozen=True)
class LongPerformance:
    """The result for a long recording. seconds: duration of the audio; lexemes: [N] of its blocks; frames: of its
    motion; note: a warning about its level, if any."""

    seconds: float
    lexemes: tuple[int, ...]
    frames: int
    note: str | None


def _glb(path: Path, skeleton: Skeleton, fps: float, unit: str, clip: ClipLayout | None) -> FrameWriter:
    from gesticulator.export.clip import ClipLayout
    from gesticulator.export.glb_pieces import GlbFile

    return GlbFile(path, skeleton, fps, clip or ClipLayout())


WRITERS: dict[str, Callable[[Path, Skeleton, float, str, ClipLayout | None], FrameWriter]] = {
    ".bvh": BvhFile, ".glb": _glb}
"""Suffix -> writer that takes frames in pieces: (path, skeleton, frames per second, unit of a BVH file, clip)."""


def can_be_done(bundle: Bundle) -> bool:
    """Whether the bundle can generate motion in pieces: it rests between phrases and represents joints as rotations."""
    return bundle.rests_by_phrase and bundle.config.motion.representation == "rotations"


def perform_long(system: Gesticulator, sound: SpeechPieces, targets: Sequence[Path], options: InferenceArguments,
                 unit: str = "cm", on_sound: Callable[[float], None] | None = None, clip: ClipLayout | None = None
                 ) -> LongPerformance:
    """Write the gestures for a recording, atomically.

    targets: files with a suffix in `WRITERS`. unit: of a BVH file. on_sound(seconds) is called after each piece. clip:
    name and keys of the animation.
    `InputError` if the recording cannot be processed or has more frames than a file can hold; OSError for disk errors.
    """
    stream = system.stream(SAMPLE_RATE, **options)
    lexemes: list[int] = []
    meter, gain = LevelMeter(), 10.0 ** (options.get("gain", 0.0) / 20)
    with ExitStack() as open_files:
        writers = [WRITERS[target.suffix.lower()](target, stream.skeleton, stream.fps, unit, clip)
                   for target in targets]
        for writer in writers:
            open_files.callback(writer.close)
        for writer in writers:
            writer.expect(math.ceil(sound.seconds * stream.fps))
        for piece in sound.pieces:
            meter.add(np.clip(piece * gain, -1.0, 1.0).astype(np.float32))
            given = stream.feed(piece)
            lexemes += [block.lexeme for block in given.blocks if block.lexeme is not None]
            if len(given):
                for writer in writers:
                    writer.add(given.motion())
            if on_sound is not None:
                on_sound(stream.time)
        seconds, rest = stream.time, stream.finish()
        lexemes += [block.lexeme for block in rest.blocks if block.lexeme is not None]
        for writer in writers:
            if len(rest):
                writer.add(rest.motion())
            writer.finish()
    return LongPerformance(seconds, tuple(lexemes), stream.made, meter.finish())
