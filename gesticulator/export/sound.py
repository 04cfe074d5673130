"""The speech in a page: Ogg Vorbis with reproducible bytes, and the envelope that is drawn."""

import io
import struct
import zlib

import numpy as np
import soundfile

from data_module.types import Speech

MEDIA_TYPE = "audio/ogg"
# About 35 kbit/s for 16 kHz speech.
_COMPRESSION = 0.7
_SERIAL = 0x67657374
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def compress(speech: Speech) -> bytes:
    """The speech as an Ogg Vorbis file at its sampling rate, without encoder delay; at most a sample longer."""
    out, samples = io.BytesIO(), np.clip(speech.samples, -1.0, 1.0)
    # A stream that ends with a block of the encoder may have an empty last packet, which Chromium takes for an error
    # ("PTS is not defined") and then plays nothing: 17 of 288 such lengths, and none with a sample more.
    if len(samples) % 64 == 0:
        samples = np.append(samples, samples[-1:])
    with soundfile.SoundFile(out, "w", speech.sample_rate, 1, "VORBIS", format="OGG",
                             compression_level=_COMPRESSION) as file:
        # A second at a time: long writes overflow the encoder's stack.
        for start in range(0, len(samples), speech.sample_rate):
            file.write(samples[start:start + speech.sample_rate])
    return with_serial(out.getvalue(), _SERIAL)


def with_serial(ogg: bytes, serial: int) -> bytes:
    """The Ogg stream with its serial number replaced.

    The encoder chooses that number at random, so two runs would differ. Each page (RFC 3533) holds it at byte 14, and a
    checksum over the page at byte 22.
    """
    out, at = bytearray(ogg), 0
    while at < len(out):
        if out[at:at + 4] != b"OggS":
            raise ValueError("not an Ogg stream")
        segments = out[at + 26]
        size = 27 + segments + sum(out[at + 27:at + 27 + segments])
        # The sum is computed with zeros in its own place.
        out[at + 14:at + 18], out[at + 22:at + 26] = struct.pack("<I", serial), bytes(4)
        out[at + 22:at + 26] = struct.pack("<I", _checksum(bytes(out[at:at + size])))
        at += size
    return bytes(out)


def _checksum(page: bytes) -> int:
    """Ogg's CRC-32 of a page: polynomial 0x04c11db7, most significant bit first, start 0, no final inversion."""
    # zlib's CRC is the same polynomial read least significant bit first: mirrored bytes give the mirrored sum.
    mirrored = zlib.crc32(page.translate(_REVERSED), 0xFFFFFFFF) ^ 0xFFFFFFFF
    return int(f"{mirrored:032b}"[::-1], 2)


def peaks(speech: Speech, per_second: int) -> np.ndarray:
    """Envelope of the waveform for plotting: [P, 2] int8, minimum and maximum of each 1 / per_second seconds, scaled so
    that the loudest sample of the recording is 127."""
    count = max(1, int(np.ceil(speech.duration * per_second)))
    starts = np.minimum(np.arange(count) * speech.sample_rate // per_second, len(speech.samples) - 1)
    outline = np.stack([np.minimum.reduceat(speech.samples, starts), np.maximum.reduceat(speech.samples, starts)], 1)
    loudest = float(np.abs(outline).max()) or 1.0
    return np.round(outline * (127.0 / loudest)).astype(np.int8)
