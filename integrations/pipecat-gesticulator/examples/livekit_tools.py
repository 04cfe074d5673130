"""A LiveKit agent whose language model calls gestures. The model is scripted and the voice is espeak-ng: no key.

    gesticulator serve
    python livekit_tools.py answer.wav answer.npz

Writes what is said and the poses on one time line. In a room, give `session.start` the room and put your own model and
synthesiser in place of the first two classes.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import json
import subprocess
import wave
from typing import Any

from livekit import rtc
from livekit.agents import AgentSession, llm, tts
from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities
from pipecat_gesticulator import Hello, Poses, connect_resuming
from pipecat_gesticulator.livekit import GesturingAgent
from realtime_agent import Recorder, add_outputs

RATE = 22050
"""Hertz of espeak-ng."""
CALLS = (("make_gesture", {"name": "shrug", "when": "rain"}), ("set_mood", {"style": "sad"}))
ANSWER = "Then the train went along the river, and the rain had stopped by the evening."
OPTIONS = {"text": True, "face": "full"}
"""Of the stream: marks come with the text, and moods show in the face."""


class ScriptedModel(llm.LLM):
    """Calls two tools, and speaks when it has their answers."""

    def chat(self, *, chat_ctx: llm.ChatContext, tools: Any = None, conn_options: Any = None, **_: Any) -> Any:
        """The answer to a context."""
        return _Answer(self, chat_ctx=chat_ctx, tools=tools or [], conn_options=conn_options)


class _Answer(llm.LLMStream):
    async def _run(self) -> None:
        answered = any(item.type == "function_call_output" for item in self._chat_ctx.items)
        delta = llm.ChoiceDelta(role="assistant", content=ANSWER) if answered else llm.ChoiceDelta(
            role="assistant", tool_calls=[llm.FunctionToolCall(name=name, arguments=json.dumps(given), call_id=f"{at}")
                                          for at, (name, given) in enumerate(CALLS)])
        self._event_ch.send_nowait(llm.ChatChunk(id="scripted", delta=delta))


class EspeakVoice(tts.TTS):
    """espeak-ng."""

    def __init__(self) -> None:
        super().__init__(capabilities=tts.TTSCapabilities(streaming=False), sample_rate=RATE, num_channels=1)

    def synthesize(self, text: str, *, conn_options: Any = None) -> tts.ChunkedStream:
        """A sentence."""
        return _Sentence(tts=self, input_text=text, conn_options=conn_options)


class _Sentence(tts.ChunkedStream):
    async def _run(self, output_emitter: tts.AudioEmitter) -> None:
        done = await asyncio.to_thread(subprocess.run, ["espeak-ng", "--stdout", self.input_text], capture_output=True,
                                       check=True)
        with wave.open(io.BytesIO(done.stdout)) as sound:
            output_emitter.initialize(request_id="espeak", sample_rate=RATE, num_channels=1, mime_type="audio/pcm")
            output_emitter.push(sound.readframes(10**7))


class Speaker(AudioOutput):
    """In place of a room: sound is recorded, and counts as played at once."""

    def __init__(self, recorder: Recorder, agent: GesturingAgent) -> None:
        super().__init__(label="recorder", capabilities=AudioOutputCapabilities(pause=False), sample_rate=RATE)
        self._recorder, self._agent, self._seconds = recorder, agent, 0.0

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        """A piece of the voice."""
        await super().capture_frame(frame)
        self._recorder.play(bytes(frame.data), self._agent.gestures.end - frame.duration)
        self._seconds += frame.duration

    def flush(self) -> None:
        """The end of an answer."""
        super().flush()
        self.on_playback_finished(playback_position=self._seconds, interrupted=False)

    def clear_buffer(self) -> None:
        """Nothing waits to be played."""


async def answer(url: str, recorder: Recorder) -> None:
    """One question and its answer, with poses."""
    async with connect_resuming(url, Hello(RATE, fps=30, options=OPTIONS)) as stream:
        agent = GesturingAgent(stream, RATE, instructions="Answer in one sentence.")
        session: AgentSession[None] = AgentSession(llm=ScriptedModel(), tts=EspeakVoice())
        session.output.audio = Speaker(recorder, agent)
        await session.start(agent)
        await session.run(user_input="What happened then?")
        await asyncio.sleep(1.0)  # idle for a moment
        await session.aclose()
        async for message in stream:
            if isinstance(message, Poses):
                recorder.show(message)


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_outputs(p)
    a = p.parse_args(arguments)
    recorder = Recorder(RATE)
    asyncio.run(answer(a.gestures, recorder))
    recorder.write(a.sound, a.poses, 30.0)
    print(f"{len(recorder.poses)} frames, {len(recorder.sound) / RATE:.1f} s of sound")


if __name__ == "__main__":
    main()
