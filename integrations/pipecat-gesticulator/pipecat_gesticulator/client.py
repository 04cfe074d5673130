"""The reference client: sound in, poses and events out, over one WebSocket."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from typing import Any

from websockets.asyncio.client import ClientConnection
from websockets.asyncio.client import connect as open_socket

from pipecat_gesticulator.protocol import SUBPROTOCOL, Hello, Poses, Welcome

LONGEST_MESSAGE = 2**24
"""Bytes: a minute of 54 joints at 60 frames per second."""


class GestureStream:
    """One stream of one avatar. Iterating gives `Poses`, and events as dicts, until the server is done."""

    def __init__(self, socket: ClientConnection, welcome: Welcome) -> None:
        self._socket, self.welcome = socket, welcome

    async def send(self, sound: bytes) -> None:
        """Send mono sound in the format of the hello, as long a piece as one likes; long ones are cut."""
        # A multiple of the widest sample, so that no sample is cut.
        longest = int(self.welcome.limits["message_bytes"]) // 4 * 4
        for start in range(0, len(sound), longest):
            await self._socket.send(sound[start:start + longest])

    async def interrupt(self, time: float | None = None) -> None:
        """The voice was cut off. time: seconds of media time that were played; left out, all that was sent is."""
        await self._say({"type": "interrupt"} if time is None else {"type": "interrupt", "time": time})

    async def idle(self, seconds: float | None = None) -> None:
        """Ask for idle motion: for so many seconds, or until there is sound."""
        await self._say({"type": "idle"} if seconds is None else {"type": "idle", "seconds": seconds})

    async def think(self, seconds: float | None = None) -> None:
        """As `idle`, while an answer is thought of."""
        await self._say({"type": "think"} if seconds is None else {"type": "think", "seconds": seconds})

    async def add_words(self, words: Iterable[tuple[str, float, float]]) -> None:
        """What is said: text, start and end in seconds of media time; for a stream with the option text."""
        times = [{"text": text, "start": start, "end": end} for text, start, end in words]
        await self._say({"type": "words", "words": times})

    async def listen(self) -> None:
        """Sound that is sent from now on is another's voice."""
        await self._say({"type": "listen"})

    async def speak(self) -> None:
        """Sound that is sent from now on is the avatar's own voice, as at the beginning."""
        await self._say({"type": "speak"})

    async def finish(self) -> None:
        """No more sound comes; the rest of the poses does, and then iterating ends."""
        await self._say({"type": "finish"})

    async def _say(self, message: dict[str, Any]) -> None:
        await self._socket.send(json.dumps(message))

    async def __aiter__(self) -> AsyncIterator[Poses | dict[str, Any]]:
        async for message in self._socket:
            if isinstance(message, bytes):
                yield Poses.unpack(message)
                continue
            event = json.loads(message)
            yield event
            if event.get("type") == "done":
                return


@asynccontextmanager
async def connect(url: str, hello: Hello, **options: Any) -> AsyncIterator[GestureStream]:
    """Open a stream on a server.

    url: such as "ws://127.0.0.1:8765/stream". options: others of `websockets.asyncio.client.connect`, such as
    additional_headers or ssl. ConnectionError with the server's reason where it refuses.
    """
    async with open_socket(url, subprotocols=[SUBPROTOCOL], max_size=LONGEST_MESSAGE, compression=None,  # type: ignore[list-item]
                           **options) as socket:
        await socket.send(hello.text())
        answer = await socket.recv()
        text = answer if isinstance(answer, str) else answer.decode("utf-8", "replace")
        if json.loads(text).get("type") == "error":
            raise ConnectionError(json.loads(text)["message"])
        yield GestureStream(socket, Welcome.read(text))
