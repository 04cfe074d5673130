"""Limits of a server, and where it listens and to whom."""

import errno
import socket
from dataclasses import dataclass
from hmac import compare_digest
from typing import Annotated
from urllib.parse import urlsplit

from data_module.errors import InputError
from data_module.settings import Count, Positive, SettingRange, check

Seconds = Annotated[float, SettingRange(0.0, 7 * 24 * 3600.0, above=True)]
"""A duration up to a week."""
MessageBytes = Annotated[int, SettingRange(1024, 2**26)]
"""From 30 ms of audio at 16 kHz to more than any client should send at once."""
QueueBytes = Annotated[int, SettingRange(2**16, 2**32)]
SOCKET_BYTES = 2**17
"""The system's buffer of a connection in each direction (Linux doubles it). By default it grows to megabytes, which
would not count as unread; this size carries 1.3 MB/s to a client 0.1 s away, 25 times what the poses need."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


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


@dataclass(frozen=True)
class ServerAddress:
    """Where to listen, and who may connect.

    port: 0 for any free one. origins: web pages that may connect, such as "https://example.org"; pages of this machine
    and clients other than browsers always may. token: required in a client's hello, and for `/metrics`; "" for none.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    origins: tuple[str, ...] = ()
    token: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise InputError(f"port {self.port}", "is not a port", "choose 0 (any free one) to 65535")

    @property
    def local(self) -> bool:
        """Whether only this machine can connect."""
        return self.host in _LOOPBACK

    def accepts(self, token: str) -> bool:
        """Whether it is the token; takes as long for a wrong one as for the right one."""
        # compare_digest takes equal time wherever two texts first differ, but only for bytes or ASCII.
        given, expected = (text.encode("utf-8", "surrogatepass") for text in (token, self.token))
        return not expected or compare_digest(given, expected)

    def admits(self, origin: str) -> bool:
        """Whether a web page of that origin may connect.

        The page's host is compared with names of this machine, not with the request's Host, which a page whose name was
        re-resolved to 127.0.0.1 would match.
        """
        if "*" in self.origins or origin in self.origins:
            return True
        return self.local and _host_of(origin) in _LOOPBACK

    def is_host(self, host: str) -> bool:
        """Whether a request's Host is a name of this server. A page whose name was re-resolved to 127.0.0.1 is of the
        same origin as what it asks for there, and could read it, but sends its own name."""
        return not self.local or _host_of(f"//{host}") in (*_LOOPBACK, *filter(None, map(_host_of, self.origins)))

    def listen(self) -> socket.socket:
        """Open a listening socket; `InputError` if that fails."""
        try:
            family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
            listening = socket.create_server((self.host, self.port), family=family)
        except (OSError, UnicodeError) as error:
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            raise InputError(f"{self.host}:{self.port}", "is taken" if taken else f"cannot be listened on ({error})",
                             "choose another --port" if taken else "choose another --host or --port") from None
        for direction in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            listening.setsockopt(socket.SOL_SOCKET, direction, SOCKET_BYTES)  # connections inherit it
        # asyncio sets it only for sockets with an explicit protocol; without it, every other packet waits 40 ms.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listening


def _host_of(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None
