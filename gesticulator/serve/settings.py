"""Limits of a server."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from data_module.settings import Count, Natural, Positive, SettingRange, check

Seconds = Annotated[float, SettingRange(0.0, 7 * 24 * 3600.0, above=True)]
"""A duration up to a week."""
MessageBytes = Annotated[int, SettingRange(1024, 2**26)]
"""From 30 ms of audio at 16 kHz to more than any client should send at once."""
WaitingBytes = Annotated[int, SettingRange(2**16, 2**32)]

STREAMS_PER_CORE = 12
"""Low-latency microphones that one core of the measured machine carries (docs/serve.md, "How fast")."""
OPENS_AT_ONCE = 24
"""Streams that one address may open at once: all that reconnect after a restart, twice."""
SOCKET_BYTES = 2**17
"""The system's buffer of a connection in each direction (Linux doubles it). By default it grows to megabytes; this size
carries 1.3 MB/s to a client 0.1 s away, 25 times what the poses need."""


@dataclass(frozen=True)
class ServerLimits:
    """Limits of one process. Together they bound the memory per client: see `memory`."""

    streams: Count = STREAMS_PER_CORE
    """Streams at most; fewer are admitted where the measured cost says so, see `core_share`."""
    address_streams: Natural = 0
    """Streams of one address, or of a tenant whose key says no other number; 0 for no limit of its own."""
    core_share: Positive = 0.85
    """Computing time per second of the clock that may be promised to streams (`Governor`). The rest is for catching
    up; a large number admits streams whatever they cost."""
    address_opens: Positive = 2.0
    """New streams of one address or tenant per second, after `OPENS_AT_ONCE` at once; opening one takes as much
    computing as a quarter of a second of speech."""
    guests: Count = 64
    """Connections that have not sent a valid hello."""
    address_guests: Count = 16
    """The same, of one address."""
    stream_seconds: Seconds = 4 * 3600.0
    """Audio per stream."""
    message_bytes: MessageBytes = 2**20
    """Longest message: half a minute of 16-bit audio at 16 kHz."""
    waiting_seconds: Seconds = 120.0
    """Audio waiting to be processed. A synthesiser may deliver a long answer at once."""
    unread_bytes: WaitingBytes = 2**22
    """Poses waiting to be read, more than a minute of 54 joints at 60 frames per second; above it the stream pauses."""
    unread_seconds: Seconds = 30.0
    """Time that a client may leave that many poses unread."""
    hello_seconds: Seconds = 10.0
    """Time for a client to send its hello."""
    resume_seconds: Seconds = 60.0
    """Time for which the state of a lost stream is kept, for a client that asked for it."""
    resume_bytes: WaitingBytes = 2**20
    """Messages that such a client may have missed: 20 s of poses."""
    quiet_seconds: Seconds = 1800.0
    """Time that a client may send nothing."""
    drain_seconds: Seconds = 10.0
    """Time for open streams after the server is asked to stop."""

    def __post_init__(self) -> None:
        check(self, "limits")

    @property
    def memory(self) -> int:
        """Largest memory that a client can fill, bytes, at the highest sampling rate, 192 kHz: queued audio as float32,
        queued and remembered poses, messages read ahead, and the system's buffers."""
        return int(self.waiting_seconds * 192_000 * 4) + self.unread_bytes + self.resume_bytes \
            + 6 * self.message_bytes + 4 * SOCKET_BYTES
