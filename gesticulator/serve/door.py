"""Who may come in: connections that have not said who they are, keys of tenants, and guesses of keys.

A connection that has not sent a valid hello takes no place of a stream. There is a bound on how many of them there may
be, in all and of one address; the newest gets in and the oldest is cut off, since a client that means it needs
milliseconds, and one that says nothing is the oldest before long.
"""

from __future__ import annotations

import ipaddress
import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from hmac import compare_digest
from pathlib import Path
from typing import Protocol

from data_module.errors import InputError
from data_module.files import read_text
from data_module.settings import whole_number

LOG = logging.getLogger("gesticulator.serve")
GUESSES = 5
"""Wrong tokens of an address in a row that are answered at once."""
GUESS_SECONDS = 10.0
"""Time after which an address is allowed one more."""
_MOST_ADDRESSES = 4096
"""Addresses whose wrong tokens are remembered: 0.5 MB."""
_CHECK_SECONDS = 1.0
"""Interval at which a file of keys is looked at, seconds."""
_LONGEST_KEYS = 1 << 20
_SHORTEST_KEY = 8
"""Characters of a key, at least."""


class Guest(Protocol):
    """A connection."""

    def cut(self) -> None:
        """End it at once."""


def network_of(address: str) -> str:
    """An address as it is counted: IPv4 as it is, IPv6 by its network of 64 bits, which one machine has all of."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv6Address):
        if found.ipv4_mapped is not None:
            return str(found.ipv4_mapped)
        return str(ipaddress.ip_network((found, 64), strict=False))
    return str(found)


def bare_address(text: str) -> str:
    """An address without the port that some proxies write with it (1.2.3.4:5678, [2001:db8::1]:5678), which is another
    one for each connection."""
    text = text.strip().strip('"')
    if text.startswith("["):
        return text[1:].partition("]")[0]
    return text.partition(":")[0] if text.count(":") == 1 else text


class Door:
    """Connections before their hello. most: in all; most_of: of one address."""

    def __init__(self, most: int, most_of: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.most, self.most_of, self._clock = most, most_of, clock
        self._guests: OrderedDict[Guest, str] = OrderedDict()
        self._opened: OrderedDict[str, tuple[float, float]] = OrderedDict()
        """Client -> streams that it opened lately, and when they were counted."""
        self._wrong: OrderedDict[str, tuple[float, float]] = OrderedDict()
        """Address -> wrong tokens that are remembered, and when they were counted."""

    def __len__(self) -> int:
        return len(self._guests)

    def enter(self, guest: Guest, address: str) -> int:
        """A connection comes, or its address becomes known; returns how many were cut off for it."""
        self._guests.pop(guest, None)
        cut = 0
        same = [one for one, where in self._guests.items() if address and where == address]
        while len(same) >= self.most_of or len(self._guests) >= self.most:
            oldest = same.pop(0) if len(same) >= self.most_of else next(iter(self._guests))
            self._guests.pop(oldest, None)
            same = [one for one in same if one is not oldest]
            oldest.cut()
            cut += 1
        self._guests[guest] = address
        return cut

    def open_wait(self, name: str, per_second: float, at_once: int) -> float:
        """Seconds after which a client may open another stream; 0 if it may now, which is counted."""
        now = self._clock()
        count, since = self._opened.pop(name, (0.0, now))
        count = max(0.0, count - (now - since) * per_second)
        wait = max(0.0, (count - at_once + 1) / per_second) if count > at_once - 1 else 0.0
        self._opened[name] = count + (wait == 0.0), now
        while len(self._opened) > _MOST_ADDRESSES:
            self._opened.popitem(last=False)
        return wait

    def leave(self, guest: Guest) -> None:
        """A connection was admitted or ended."""
        self._guests.pop(guest, None)

    def wait(self, address: str) -> float:
        """Seconds for which an address may not try a token; 0 if it may."""
        count, since = self._wrong.get(address, (0.0, 0.0))
        count -= (self._clock() - since) / GUESS_SECONDS
        return max(0.0, count - (GUESSES - 1)) * GUESS_SECONDS

    def wrong(self, address: str) -> None:
        """A token was wrong."""
        now = self._clock()
        count, since = self._wrong.pop(address, (0.0, now))
        self._wrong[address] = max(0.0, count - (now - since) / GUESS_SECONDS) + 1, now
        while len(self._wrong) > _MOST_ADDRESSES:
            self._wrong.popitem(last=False)


@dataclass(frozen=True)
class Tenant:
    """Who a key belongs to. streams: at most, 0 for no limit of its own; priority: see `Governor`."""

    name: str = ""
    streams: int = 0
    priority: int = 0


class TenantKeys:
    """Tokens that are accepted: one, or a file of keys that is read again when it changes.

    A line of the file is `TENANT KEY [streams=N] [priority=N]`; empty lines and those that begin with # are skipped. A
    tenant may have several keys: to rotate one, add the new key, wait until clients use it, and remove the old one.
    """

    def __init__(self, token: str = "", file: Path | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """`InputError` with the line for an invalid file."""
        self._token, self._file, self._clock = token, file, clock
        self._state: tuple[int, int, int] | None = None
        self._checked = clock()
        self._keys: list[tuple[bytes, Tenant]] = []
        if file is not None:
            self._state = self._stamp()
            self._keys = read_keys(file)

    def __bool__(self) -> bool:
        return bool(self._token) or self._file is not None

    def tenant(self, token: str) -> Tenant | None:
        """Whose token it is; None if it is nobody's. Takes as long for a wrong one as for any other."""
        if not self:
            return Tenant()
        self._refresh()
        given, found = token.encode("utf-8", "surrogatepass"), None
        if self._token and compare_digest(given, self._token.encode("utf-8", "surrogatepass")):
            found = Tenant()
        for key, tenant in self._keys:
            if compare_digest(given, key):
                found = tenant
        return found

    def _stamp(self) -> tuple[int, int, int] | None:
        assert self._file is not None
        try:
            found = self._file.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino

    def _refresh(self) -> None:
        if self._file is None or self._clock() - self._checked < _CHECK_SECONDS:
            return
        self._checked = self._clock()
        state = self._stamp()
        if state == self._state:
            return
        self._state = state
        try:
            self._keys = read_keys(self._file)
            LOG.info("read %d keys from %s", len(self._keys), self._file)
        except InputError as error:
            LOG.warning("the earlier keys stay: %s", error)


def read_keys(file: Path) -> list[tuple[bytes, Tenant]]:
    """The keys of a file with their tenants; `InputError` with the line if one is invalid."""
    keys: list[tuple[bytes, Tenant]] = []
    for number, line in enumerate(read_text(file, "write lines of TENANT KEY into it", _LONGEST_KEYS).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        place = f"{file}:{number}"
        if len(words) < 2:
            raise InputError(place, "has no key", "write TENANT KEY")
        if len(words[1]) < _SHORTEST_KEY:
            raise InputError(place, f"has a key shorter than {_SHORTEST_KEY} characters", "use a longer one")
        numbers = {"streams": 0, "priority": 0}
        for word in words[2:]:
            name, _, value = word.partition("=")
            found = whole_number(value, 10**6)
            if name not in numbers or found is None:
                raise InputError(place, "has an unknown setting", "write streams=N or priority=N")
            numbers[name] = found
        if any(key == words[1].encode() for key, _ in keys):
            raise InputError(place, "has a key for the second time", "give each key to one tenant")
        keys.append((words[1].encode(), Tenant(words[0], **numbers)))
    if not keys:
        raise InputError(file, "holds no keys", "write lines of TENANT KEY into it")
    return keys
