"""Ports that another program is told to listen on."""

from __future__ import annotations

import itertools
import os
import random
import socket

_FIRST, _END = 16_000, 32_000
"""Below the ports that systems hand out to connections (from 32,768 on Linux, from 49,152 elsewhere): one of those may
be taken by any connection between the moment it is chosen and the moment the program listens on it."""
_candidates = itertools.cycle(random.Random(os.getpid()).sample(range(_FIRST, _END), 4_000))
"""Each process of a test run goes through ports in an order of its own."""


def free_port() -> int:
    """One that nothing listens on just now, and that this process does not hand out again soon."""
    for port in itertools.islice(_candidates, 1_000):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"no port between {_FIRST} and {_END} is free")
