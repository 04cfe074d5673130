"""Limits of a server."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from data_module.settings import Count, Positive, SettingRange, check

Seconds = Annotated[float, SettingRange(0.0, 7 * 24 * 3600.0, above=True)]
"""A duration up to a week."""
MessageBytes = Annotated[int, SettingRange(1024, 2**26)]
"""From 30 ms of audio at 16 kHz to more than any client should send at once."""
QueueBytes = Annotated[int, SettingRange(2**16, 2**32)]


@dataclass(frozen=True)
class ServerLimits:
    """Limits of a server. Together they bound the memory per client."""

    streams: Count = 12
    """Streams at the same time; another client is refused with the code 4429. Twelve low-latency microphones take 0.83
    of one core of the measured machine (docs/serve.md, "How fast")."""
    stream_seconds: Seconds = 4 * 3600.0
    """Audio per stream."""
    message_bytes: MessageBytes = 2**20
    """Longest message: half a minute of 16-bit audio at 16 kHz."""
    waiting_seconds: Seconds = 120.0
    """Audio waiting to be processed. A synthesiser may deliver a long answer at once."""
    unread_bytes: QueueBytes = 2**22
    """Poses waiting to be read, more than a minute of 54 joints at 60 frames per second; above it the stream pauses."""
    unread_seconds: Positive = 30.0
    """Time that a client may leave that many poses unread."""
    hello_seconds: Seconds = 10.0
    """Time for a client to send its hello."""
    quiet_seconds: Seconds = 1800.0
    """Time that a client may send nothing."""
    drain_seconds: Seconds = 10.0
    """Time for open streams after the server is asked to stop."""

    def __post_init__(self) -> None:
        check(self, "limits")
