"""Gestures for an agent that speaks by OpenAI's Realtime API, or by another one with its events.

    async with connect_resuming(url, Hello(24000, options={"keep_up": True})) as stream:
        gestures = RealtimeGestures(stream)
        async for event in agent:                        # the agent's WebSocket
            for answer in await gestures.take(json.loads(event)):
                await agent.send(json.dumps(answer))

Poses come from `stream`, as ever; `examples/realtime_agent.py` is a whole program. Only events are read and written
here; no package of the API is needed.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pipecat_gesticulator.resuming import ResumingStream

RATE = 24000
"""Hertz of the API's sound, 16-bit mono ("audio/pcm")."""
SOUND = {"response.output_audio.delta", "response.audio.delta"}
"""Events with sound; the second name is that of the API's preview."""
SOUND_ENDS = {"response.output_audio.done", "response.audio.done"}
Play = Callable[[bytes, float], None]
"""Takes sound to be played, and the media time at which it begins."""


@dataclass
class _Item:
    """What the agent says: its name, and the media times at which its sound begins and ends so far."""

    name: str
    index: int
    begin: float
    end: float


class RealtimeGestures:
    """Passes an agent's sound on to a stream, and what happens in the conversation.

    The API gives an answer faster than it is heard. When the user speaks meanwhile, the poses that were not played yet
    are taken back, and the answer of `take` says to the API how much was heard. While the user speaks the character
    listens, then it thinks until it is answered. `tick` must be called some times a second.
    """

    def __init__(self, stream: ResumingStream, play: Play | None = None,
                 clock: Callable[[], float] = time.monotonic, rate: int = RATE) -> None:
        """rate: of the sound of stream and events, hertz."""
        self._stream, self._play, self._clock, self._rate = stream, play, clock, rate
        self._sent, self._play_end = 0.0, clock()
        self._item: _Item | None = None
        self._response, self._dropped = "", ""
        self._user_speaks, self._waits = False, "idle"

    @property
    def time(self) -> float:
        """The media time that is played now, seconds."""
        return max(0.0, self._sent - max(0.0, self._play_end - self._clock()))

    @property
    def end(self) -> float:
        """The media time at which the sound ends that was taken so far, seconds."""
        return self._sent

    async def take(self, event: dict[str, Any]) -> list[dict[str, Any]]:
        """An event of the API's server; returns events to be sent back."""
        kind = event.get("type")
        if kind in SOUND:
            await self._speak(event)
        elif kind in SOUND_ENDS and event.get("response_id") != self._dropped:
            await self._stream.idle(0.0)  # the last poses wait for sound that does not come
        elif kind == "response.created":
            self._response = event["response"]["id"]
        elif kind == "input_audio_buffer.speech_started":
            return await self._listen()
        elif kind == "input_audio_buffer.speech_stopped":
            self._user_speaks, self._waits = False, "think"
            await self._stream.speak()
        return []

    async def user_sound(self, sound: bytes) -> None:
        """Sound of the user, as it is sent to the API: the character nods in its pauses."""
        if self._user_speaks and self._play_end <= self._clock():
            self._count(len(sound) / 2 / self._rate)
            await self._stream.send(sound)

    async def tick(self) -> None:
        """Media time goes on with the clock while nothing is said."""
        late = self._clock() - self._play_end
        if late > 0:
            self._count(late)
            await (self._stream.think(late) if self._waits == "think" else self._stream.idle(late))

    def _count(self, seconds: float) -> None:
        self._sent += seconds
        self._play_end = max(self._play_end, self._clock() - seconds) + seconds

    async def _speak(self, event: dict[str, Any]) -> None:
        if event.get("response_id") == self._dropped:
            return  # it was on its way when the user interrupted
        await self.tick()  # until now it was silent
        sound, self._waits = base64.b64decode(event["delta"]), "idle"
        if self._item is None or self._item.name != event["item_id"]:
            self._item = _Item(event["item_id"], event.get("content_index", 0), self._sent, self._sent)
        begin = self._sent
        self._sent += len(sound) / 2 / self._rate
        self._play_end = max(self._play_end, self._clock()) + len(sound) / 2 / self._rate
        self._item.end = self._sent
        if self._play is not None:
            self._play(sound, begin)
        await self._stream.send(sound)

    async def _listen(self) -> list[dict[str, Any]]:
        """The user speaks: what was not played yet never will be."""
        at, item, answers = self.time, self._item, list[dict[str, Any]]()
        self._user_speaks = True
        if item is not None and at < item.end:
            self._sent, self._play_end, self._dropped = at, self._clock(), self._response
            self._item = None
            await self._stream.interrupt(at)
            answers.append({"type": "conversation.item.truncate", "item_id": item.name, "content_index": item.index,
                            "audio_end_ms": round(1000 * max(0.0, at - item.begin))})
        await self._stream.listen()
        return answers
