"""Gestures for an agent of LiveKit Agents: its voice goes to a gesticulator server, too, and its model may call them.

    stream = await stack.enter_async_context(connect_resuming(url, Hello(RATE, options={"text": True})))
    await session.start(GesturingAgent(stream, instructions="..."), room=room)

`RATE` is that of the agent's synthesiser. Poses come from `stream`; show them by `agent.gestures.time`, or send them to
the room: `messages.pose_messages(poses, agent.gestures.time)` by `room.local_participant.publish_data`.
"""

from __future__ import annotations

import asyncio
import base64
import re
from collections.abc import AsyncIterable, AsyncIterator
from typing import Any

from livekit.agents import Agent, function_tool
from livekit.agents.llm import RawFunctionTool

from pipecat_gesticulator.marks import LETTER_SECONDS, timed_words, without_marks
from pipecat_gesticulator.realtime import RealtimeGestures
from pipecat_gesticulator.resuming import ResumingStream
from pipecat_gesticulator.tools import TOOLS, GestureCalls, parameters

TICK_SECONDS = 0.05
_SENTENCE = re.compile(r"[.!?。！？][\"'”’)]*\s")


def livekit_tools(calls: GestureCalls) -> list[RawFunctionTool[Any, Any]]:
    """make_gesture and set_mood as tools of an agent."""
    def tool_of(name: str, schema: dict[str, Any]) -> RawFunctionTool[Any, Any]:
        async def carry_out(raw_arguments: dict[str, object]) -> str:
            return calls.call(name, raw_arguments)

        return function_tool(carry_out, raw_schema={"name": name, **schema})

    return [tool_of(tool["name"], {"description": tool["description"], "parameters": parameters(tool)})
            for tool in TOOLS]


class GesturingAgent(Agent):
    """An agent that gestures. stream: of a server, at the synthesiser's rate, with the option "text"."""

    def __init__(self, stream: ResumingStream, rate: int, **options: Any) -> None:
        self.calls, self._stream, self._tasks = GestureCalls(), stream, set[asyncio.Task[Any]]()
        self.gestures = RealtimeGestures(stream, rate=rate)
        super().__init__(tools=[*options.pop("tools", ()), *livekit_tools(self.calls)], **options)

    async def on_enter(self) -> None:
        """Follow the user's turns, and let media time go on while nothing is said."""
        self._keep(self._go_on())
        self.session.on("user_state_changed", lambda event: self._keep(self._turn(event.new_state)))

    async def on_exit(self) -> None:
        """No more poses are asked for."""
        for task in self._tasks:
            task.cancel()
        await self._stream.finish()

    async def tts_node(self, text: AsyncIterable[str], model_settings: Any) -> AsyncIterator[Any]:
        """The voice as it is, without marks; its sound and words go to the server."""
        waiting: list[str] = []

        async def spoken() -> AsyncIterator[str]:
            async for sentence in _sentences(text):
                waiting.append(self.calls.marked(sentence))
                yield without_marks(waiting[-1])

        item, end = f"answer {id(waiting)}", 0.0
        async for frame in Agent.default.tts_node(self, spoken(), model_settings):
            await self.gestures.take({"type": "response.output_audio.delta", "item_id": item, "response_id": item,
                                      "delta": base64.b64encode(bytes(frame.data)).decode()})
            begin = self.gestures.end - frame.duration
            while waiting:
                words = timed_words(waiting.pop(0), max(begin, end), LETTER_SECONDS)
                end = words[-1][2] if words else end
                await self._stream.add_words(words)
            yield frame
        await self.gestures.take({"type": "response.output_audio.done", "response_id": item})

    async def _turn(self, state: str) -> None:
        """What the user does: an answer that is still heard is broken off."""
        if state == "speaking":
            self.calls.forget()
            await self.gestures.take({"type": "input_audio_buffer.speech_started"})
        elif state == "listening":
            await self.gestures.take({"type": "input_audio_buffer.speech_stopped"})

    async def _go_on(self) -> None:
        while True:
            await self.gestures.tick()
            await asyncio.sleep(TICK_SECONDS)

    def _keep(self, work: Any) -> None:
        """A task that the loop alone would forget."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


async def _sentences(text: AsyncIterable[str]) -> AsyncIterator[str]:
    """A text as whole sentences, so that a mark finds its word."""
    rest = ""
    async for part in text:
        rest += part
        while (end := _SENTENCE.search(rest)) is not None:
            yield rest[:end.end()]
            rest = rest[end.end():]
    if rest.strip():
        yield rest
