"""Subprocess that decodes MP3 from standard input to pieces of samples on standard output.

mpg123, which decodes MP3 for libsndfile, writes warnings directly to the standard error of the process, and libsndfile
cannot suppress them. Redirecting that descriptor would affect all other threads, so a subprocess is used.

`main` takes PIECE from the command line, the samples per channel that are sent at a time. The output is a line of JSON,
{"rate", "channels", "frames"} or {"error"}; then pieces, each a count of samples (int32, little-endian) and so many x
channels float32; then the count 0, or -1 and a line with the error.
"""

from __future__ import annotations

import json
import sys


def main() -> None:
    import numpy as np
    import soundfile

    class ForwardOnlyStream(soundfile.SoundFile):
        """Without seeks, which are slow in MP3."""

        def seekable(self) -> bool:
            return False

    out = sys.stdout.buffer
    try:
        file = ForwardOnlyStream(sys.stdin.buffer)
    except (soundfile.SoundFileError, TypeError, ValueError) as error:
        out.write(json.dumps({"error": str(error)}).encode() + b"\n")
        return
    with file:
        head = {"rate": int(file.samplerate), "channels": int(file.channels), "frames": int(file.frames)}
        out.write(json.dumps(head).encode() + b"\n")
        while True:
            try:
                piece = file.read(int(sys.argv[1]), dtype="float32", always_2d=True)
            except soundfile.SoundFileError as error:
                text = getattr(error, "error_string", None) or str(error)
                out.write(np.int32(-1).astype("<i4").tobytes() + " ".join(str(text).split()).encode() + b"\n")
                return
            out.write(np.int32(len(piece)).astype("<i4").tobytes() + piece.astype("<f4").tobytes())
            if len(piece) == 0:
                return
