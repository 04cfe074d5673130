"""What a server allows its clients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from data_module.settings import Count, SettingRange, check

Seconds = Annotated[float, SettingRange(0.0, 7 * 24 * 3600.0, above=True)]
"""Up to a week."""
MessageBytes = Annotated[int, SettingRange(1024, 2**26)]
"""From 30 ms of sound at 16 kHz to an amount that no client means to send at once."""
WaitingBytes = Annotated[int, SettingRange(2**16, 2**32)]

SOCKET_BYTES = 2**17
"""The system's own buffer of a connection, each way (Linux takes twice of it). Left to itself it grows to megabytes;
this much carries 1.3 MB/s to a client 0.1 s away, 25 times what the poses need."""


@dataclass(frozen=True)
class ServerLimits:
    """Bounds of one process. Together they bound what a client can cost: see `memory`."""

    streams: Count = 32
    """Connections that are open at a time. One core does about as many; see docs/serve.md."""
    stream_seconds: Seconds = 4 * 3600.0
    """Sound that one stream takes."""
    message_bytes: MessageBytes = 2**20
    """Longest message: half a minute of 16 bit sound at 16 kHz."""
    waiting_seconds: Seconds = 120.0
    """Sound that waits to be worked on. A synthesiser may deliver a long answer at once."""
    unread_bytes: WaitingBytes = 2**23
    """Poses that wait to be read; about 2.5 minutes of 54 joints at 60 frames per second. Then work on the stream
    stops."""
    unread_seconds: Seconds = 30.0
    """How long a client may leave poses unread once that many wait."""
    hello_seconds: Seconds = 10.0
    """How long a client may take to say what it wants."""
    quiet_seconds: Seconds = 1800.0
    """How long a client may send nothing."""
    drain_seconds: Seconds = 10.0
    """How long streams may go on after the server was told to stop."""

    def __post_init__(self) -> None:
        check(self, "limits")

    @property
    def memory(self) -> int:
        """Bytes of queues that a client can fill at most, at 192 kHz, the highest rate that is taken.

        Sound that waits, as float32; poses that wait; the messages that are read ahead; the system's buffers.
        """
        return int(self.waiting_seconds * 192_000 * 4) + self.unread_bytes + 6 * self.message_bytes + 4 * SOCKET_BYTES
