"""The server side of the protocol, defined by the schema in the client's package."""

from __future__ import annotations

import functools
import json
import struct
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jsonschema import Draft202012Validator

from data_module.errors import InputError, shown
from data_module.files import parse_json, read_object

if TYPE_CHECKING:
    from data_module.types import Samples, Skeleton
    from gesticulator.stream import StreamFrames

VERSION = 1
_PLACES = (
    # A checkout; the wheel, which carries a copy of the file (pyproject.toml, force-include).
    Path(__file__).resolve().parents[2] / "integrations/pipecat-gesticulator/pipecat_gesticulator/protocol.json",
    Path(__file__).resolve().parent / "protocol.json",
)
_PCM16_FULL = 32768.0
"""Full scale of 16-bit audio."""
_LONGEST_REASON = 300
"""Characters of the description of an invalid message; its own text may be as long as the message."""
_MOST_SAMPLE = 1e4
"""Largest float sample: full scale is 1; 16-bit values sent as floats by mistake reach 32768."""


class CloseCode(IntEnum):
    """Reasons for closing a connection; described in the schema."""

    NORMAL = 1000
    GOING_AWAY = 1001
    TOO_BIG = 1009
    BAD_MESSAGE = 4400
    BAD_TOKEN = 4401
    TOO_QUIET = 4408
    UNREAD = 4409
    TOO_MUCH_SOUND = 4413
    TOO_MANY_STREAMS = 4429
    FAILED = 4500


class RefusedError(Exception):
    """Closes a connection with a code and a reason for the client."""

    def __init__(self, code: CloseCode, reason: str, retry_after: float | None = None) -> None:
        """retry_after: seconds after which the client may try again."""
        self.code, self.reason, self.retry_after = code, reason, retry_after
        super().__init__(reason)


@functools.cache
def published() -> dict[str, Any]:
    """The published schema of the protocol. `InputError` if it is missing or of another version."""
    for place in _PLACES:
        if place.is_file():
            document: dict[str, Any] = read_object(place, "install gesticulator again")
            if document["version"] != VERSION:
                raise InputError(place, f"is version {document['version']} of the protocol, and the server uses "
                                 f"{VERSION}", "install both from one release")
            return document
    raise InputError("protocol.json", "is missing", "install gesticulator again")


@dataclass(frozen=True)
class StreamRequest:
    """The request in a client's hello; see the schema."""

    sample_rate: int
    format: str = "pcm16"
    fps: float = 60.0
    seed: int = 0
    output: str = "joints"
    options: dict[str, Any] = field(default_factory=dict)
    token: str = ""

    @property
    def keeps_up(self) -> bool:
        """Whether late audio is processed at lower cost or skipped; by default only for low latency (microphones)."""
        return bool(self.options.get("keep_up", self.options.get("latency") == "low"))

    def samples(self, sound: bytes) -> Samples:
        """A binary message as float32 samples [n]; `RefusedError` for invalid audio."""
        if len(sound) % (2 if self.format == "pcm16" else 4):
            raise RefusedError(CloseCode.BAD_MESSAGE, f"{len(sound)} bytes are no whole number of "
                               f"{self.format} samples")
        if self.format == "pcm16":
            return (np.frombuffer(sound, "<i2") / _PCM16_FULL).astype(np.float32)
        samples = np.frombuffer(sound, "<f4").astype(np.float32)
        if not np.isfinite(samples).all():
            raise RefusedError(CloseCode.BAD_MESSAGE, "the sound holds samples that are not numbers (NaN or infinite)")
        # Refused rather than clipped: such a stream is scaled wrongly throughout.
        if np.abs(samples, out=np.empty_like(samples)).max(initial=0.0) > _MOST_SAMPLE:
            raise RefusedError(CloseCode.BAD_MESSAGE, "the sound holds samples far beyond full scale, which is 1")
        return samples


def read_message(text: str) -> dict[str, Any]:
    """Parse a client's text message; `RefusedError` if it does not match the schema."""
    try:
        message: dict[str, Any] = parse_json(text, "the message", "")
    except InputError as error:
        raise RefusedError(CloseCode.BAD_MESSAGE, str(error)) from None
    validators = _validators()
    kind = message.get("type") if isinstance(message, dict) else None
    if not isinstance(kind, str) or kind not in validators:
        known = ", ".join(validators)
        raise RefusedError(CloseCode.BAD_MESSAGE, f"the message's type is {shown(kind)}, none of {known}")
    # The first error alone: a list that is too long is refused before its entries are looked at.
    fault = next(validators[kind].iter_errors(message), None)
    if fault is not None:
        place = kind + fault.json_path.removeprefix("$")
        raise RefusedError(CloseCode.BAD_MESSAGE, shown(f"{place}: {fault.message}", _LONGEST_REASON))
    return message


@functools.cache
def _validators() -> dict[str, Draft202012Validator]:
    """Type of a client's message -> the validator of its schema."""
    schema = published()
    kinds = [entry["$ref"].removeprefix("#/$defs/") for entry in schema["client"]["oneOf"]]
    return {kind: Draft202012Validator({"$ref": f"#/$defs/{kind}", "$defs": schema["$defs"]}) for kind in kinds}


def read_hello(text: str) -> StreamRequest:
    """Parse a client's first message; `RefusedError` if it is not a hello."""
    message = read_message(text)
    if message.pop("type") != "hello":
        raise RefusedError(CloseCode.BAD_MESSAGE, "the first message must be a hello")
    del message["protocol"]
    # A whole number may be written as a float.
    message |= {name: int(message[name]) for name in ("sample_rate", "seed") if name in message}
    return StreamRequest(**message)


def pack(frames: StreamFrames, request: StreamRequest, state: str, received: float) -> bytes:
    """A packet of at least one pose: header and float32 values, as in the schema. received: seconds of audio
    received."""
    if request.output == "smplx":
        from data_module.motion.smplx import smplx_arrays

        # Through the writer of files, so that a stream and a file have the same conventions.
        arrays = smplx_arrays(frames.motion())
        rotations, root = arrays["poses"].reshape(len(frames), -1, 3), arrays["trans"]
    else:
        rotations, root = frames.rotations, frames.root_positions
    face = None if frames.face is None else frames.face.values().astype("<f4")
    header = json.dumps({
        "type": "poses", "first": frames.first, "count": len(frames), "time": round(frames.first / request.fps, 6),
        "fps": request.fps, "joints": rotations.shape[1], "state": state, "received": round(received, 6),
        **({} if face is None else {"face": face.shape[1]}),
    }, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 4)  # align the numbers for typed arrays
    return b"".join((struct.pack("<I", len(header)), header, rotations.astype("<f4").tobytes(),
                     root.astype("<f4").tobytes(), b"" if face is None else face.tobytes()))


def joints(skeleton: Skeleton) -> list[dict[str, Any]]:
    """The skeleton as in the server's hello."""
    out: list[dict[str, Any]] = [
        {"name": name, "parent": parent, "offset": np.round(offset, 6).tolist()}
        for name, parent, offset in zip(skeleton.names, skeleton.parents, skeleton.offsets, strict=True)]
    for joint, tip in skeleton.end_sites.items():
        out[joint]["tip"] = np.round(tip, 6).tolist()
    return out

