"""What a lost stream needs to go on: the last messages that were sent, and a name that cannot be guessed."""

from __future__ import annotations

import secrets
from collections import deque


class SentMessages:
    """The last messages of a stream that were sent, by their number; at most so many bytes."""

    def __init__(self, most_bytes: int) -> None:
        self._most, self._bytes = most_bytes, 0
        self._kept: deque[bytes | str] = deque()
        self.count = 0
        """Messages that were sent."""

    def add(self, message: bytes | str) -> None:
        """A message was sent."""
        self.count += 1
        self._kept.append(message)
        self._bytes += len(message)
        while self._bytes > self._most:
            self._bytes -= len(self._kept.popleft())

    def since(self, number: int) -> list[bytes | str] | None:
        """Take back the messages from a number on, to be sent again; None if they are not all here."""
        lost = self.count - number
        if not 0 <= lost <= len(self._kept):
            return None
        again = [self._kept.pop() for _ in range(lost)][::-1]
        self._bytes -= sum(map(len, again))
        self.count = number
        return again


def new_session(worker: str) -> str:
    """A name for a session: the worker that has it, and 128 random bits."""
    return f"{worker}-{secrets.token_urlsafe(16)}"
