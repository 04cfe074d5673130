"""Ports that another program is told to listen on."""

from __future__ import annotations

_FIRST, _END = 16_000, 32_000
"""Below the ports that systems hand out to connections (from 32,768 on Linux, from 49,152 elsewhere): one of those may
be taken by any connection between the moment it is chosen and the moment the program listens on it."""
