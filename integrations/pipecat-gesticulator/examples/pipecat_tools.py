"""A Pipecat agent whose language model calls gestures. The model is scripted and the voice is espeak-ng: no key.

    gesticulator serve
    python pipecat_tools.py answer.wav answer.npz

Writes what is said and the poses on one time line. Put your own model and synthesiser in place of the two classes.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import subprocess
import wave
from collections.abc import AsyncGenerator

from pipecat.frames.frames import (
    Frame,
    FunctionCallFromLLM,
    LLMContextFrame,
    LLMFullResponseEndFrame,
    LLMFullResponseStartFrame,
    LLMTextFrame,
    TTSAudioRawFrame,
)
from pipecat.pipeline.pipeline import Pipeline
from pipecat.processors.aggregators.llm_context import LLMContext
from pipecat.processors.aggregators.llm_response_universal import LLMContextAggregatorPair
from pipecat.processors.frame_processor import FrameDirection
from pipecat.services.llm_service import LLMService
from pipecat.services.settings import LLMSettings, TTSSettings
from pipecat.services.tts_service import TTSService
from pipecat.tests.utils import SleepFrame, run_test
from pipecat_gesticulator.marks import spoken_text
from pipecat_gesticulator.processor import GesticulatorProcessor, PoseFrame
from realtime_agent import Recorder, add_outputs

RATE = 22050
"""Hertz of espeak-ng."""
CALLS = (("make_gesture", {"name": "shrug", "when": "rain"}), ("set_mood", {"style": "sad"}))
ANSWER = "Then the train went along the river, and the rain had stopped by the evening."
OPTIONS = {"text": True, "face": "full"}
"""Of the stream: marks come with the text, and moods show in the face."""


class ScriptedModel(LLMService):
    """Calls two tools, and speaks when it has their answers."""

    def __init__(self) -> None:
        fields = [name for name in LLMSettings.__dataclass_fields__ if name not in ("extra", "_aliases")]
        super().__init__(settings=LLMSettings(**dict.fromkeys(fields)))

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Answer a context."""
        await super().process_frame(frame, direction)
        if not isinstance(frame, LLMContextFrame):
            await self.push_frame(frame, direction)
            return
        await self.push_frame(LLMFullResponseStartFrame())
        if any(message.get("role") == "tool" for message in frame.context.messages):
            await self.push_frame(LLMTextFrame(ANSWER))
        else:
            await self.run_function_calls([FunctionCallFromLLM(
                function_name=name, tool_call_id=f"call {at}", arguments=arguments, context=frame.context)
                for at, (name, arguments) in enumerate(CALLS)])
        await self.push_frame(LLMFullResponseEndFrame())


class EspeakVoice(TTSService):
    """espeak-ng."""

    def __init__(self) -> None:
        super().__init__(sample_rate=RATE, push_start_frame=True, push_stop_frames=True,
                         text_transforms=[("*", spoken_text)],
                         settings=TTSSettings(model=None, voice=None, language=None))

    async def run_tts(self, text: str, context_id: str) -> AsyncGenerator[Frame | None, None]:
        """A sentence, in one piece."""
        done = await asyncio.to_thread(subprocess.run, ["espeak-ng", "--stdout", text], capture_output=True, check=True)
        with wave.open(io.BytesIO(done.stdout)) as sound:
            yield TTSAudioRawFrame(sound.readframes(10**7), RATE, 1, context_id=context_id)


async def answer(url: str) -> list[Frame]:
    """What comes out of the pipeline for one question."""
    body = GesticulatorProcessor(url, fps=30, options=OPTIONS)
    model = ScriptedModel()
    tools = body.register_tools(model)
    context = LLMContext([{"role": "user", "content": "What happened then?"}], tools=tools)
    memory = LLMContextAggregatorPair(context)
    pipeline = Pipeline([model, EspeakVoice(), body, memory.assistant()])
    frames, _ = await run_test(pipeline, frames_to_send=[LLMContextFrame(context), SleepFrame(8.0)], start_timeout=10.0)
    return list(frames)


def main(arguments: list[str] | None = None) -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_outputs(p)
    a = p.parse_args(arguments)
    recorder, at = Recorder(RATE), 0.0
    for frame in asyncio.run(answer(a.gestures)):
        if isinstance(frame, TTSAudioRawFrame):
            recorder.play(frame.audio, at)
            at += len(frame.audio) / 2 / RATE
        elif isinstance(frame, PoseFrame):
            recorder.show(frame.poses)
    recorder.write(a.sound, a.poses, 30.0)
    print(f"{len(recorder.poses)} frames, {len(recorder.sound) / RATE:.1f} s of sound")


if __name__ == "__main__":
    main()
