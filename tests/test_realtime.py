"""Agents that speak by OpenAI's Realtime API, played by a server that speaks the documented format, beside our server
with its models."""

import asyncio
import base64
import importlib.util
import json
import sys
import wave
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from pipecat_gesticulator.realtime import RATE
from websockets.asyncio.server import ServerConnection, serve

from data_module.speech.audio import load_speech, resample
from gesticulator.gesticulator import Gesticulator
from gesticulator.live.limits import ServerAddress, ServerLimits
from gesticulator.live.server import LiveServer
from gesticulator.live.session import session_opener

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "integrations" / "pipecat-gesticulator" / "examples"


def example(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


def speech(seconds: float) -> bytes:
    samples = resample(load_speech(ROOT / "examples" / "speech.flac"), RATE).samples[:round(seconds * RATE)]
    return bytes((samples * 32767).astype("<i2").tobytes())


@asynccontextmanager
async def gestures() -> AsyncIterator[str]:
    """The URL of our server, with its models."""
    address, limits = ServerAddress(port=0), ServerLimits(drain_seconds=0.5)
    listening = address.listen()
    server = LiveServer(address, limits, session_opener(Gesticulator.from_pretrained(), limits))
    running = asyncio.create_task(server.run(listening))
    try:
        yield f"ws://127.0.0.1:{listening.getsockname()[1]}/stream"
    finally:
        server.stop()
        await running


class Agent:
    """The server's side of the Realtime API, as its reference describes the events: voice activity is found in the
    sound that is sent, and each question gets an answer, faster than it is heard."""

    def __init__(self, answer: bytes, barges_in: bool = False) -> None:
        self.answer, self.barges_in = answer, barges_in
        self.got: list[dict[str, Any]] = []
        self.heard = bytearray()

    async def __call__(self, ws: ServerConnection) -> None:
        await self.say(ws, "session.created", session={"type": "realtime"})
        speaks = answered = False
        async for text in ws:
            event = json.loads(text)
            self.got.append(event)
            if event["type"] == "session.update":
                audio = event["session"]["audio"]
                if audio["output"]["format"] != {"type": "audio/pcm", "rate": 24000}:
                    await self.say(ws, "error", error={"type": "invalid_request_error", "message": "no such format"})
                await self.say(ws, "session.updated", session=event["session"])
            elif event["type"] == "input_audio_buffer.append":
                sound = base64.b64decode(event["audio"])
                self.heard += sound
                loud = np.abs(np.frombuffer(sound, "<i2")).max(initial=0) > 500
                if loud and not speaks and not answered:
                    speaks = True
                    await self.say(ws, "input_audio_buffer.speech_started", audio_start_ms=0, item_id="item_user")
                elif speaks and not loud:
                    speaks, answered = False, True
                    await self.say(ws, "input_audio_buffer.speech_stopped", audio_end_ms=1, item_id="item_user")
                    await self.say(ws, "input_audio_buffer.committed", item_id="item_user")
                    await self.reply(ws, 1, whole=not self.barges_in)
            elif event["type"] == "conversation.item.truncate":
                await self.say(ws, "response.output_audio.delta", response_id="resp_1", item_id="item_1",
                               output_index=0, content_index=0, delta=base64.b64encode(bytes(9600)).decode())
                await self.say(ws, "response.done", response={"id": "resp_1", "status": "cancelled"})
                await self.say(ws, "input_audio_buffer.speech_stopped", audio_end_ms=1, item_id="item_user2")
                await self.reply(ws, 2, whole=True)

    async def reply(self, ws: ServerConnection, number: int, whole: bool) -> None:
        names = {"response_id": f"resp_{number}", "item_id": f"item_{number}", "output_index": 0, "content_index": 0}
        await self.say(ws, "response.created", response={"id": f"resp_{number}", "status": "in_progress"})
        for at in range(0, len(self.answer), 9600):
            delta = base64.b64encode(self.answer[at:at + 9600]).decode()
            await self.say(ws, "response.output_audio.delta", delta=delta, **names)
        if whole:
            await self.say(ws, "response.output_audio.done", **names)
            await self.say(ws, "response.done", response={"id": f"resp_{number}", "status": "completed"})
        else:
            await asyncio.sleep(0.6)
            await self.say(ws, "input_audio_buffer.speech_started", audio_start_ms=1, item_id="item_user2")

    async def say(self, ws: ServerConnection, kind: str, **values: Any) -> None:
        await ws.send(json.dumps({"event_id": "event_1", "type": kind, **values}))


def read_wav(path: Path) -> np.ndarray:
    with wave.open(str(path), "rb") as file:
        return np.frombuffer(file.readframes(file.getnframes()), "<i2")


@pytest.mark.parametrize("barges_in", [False, True])
def test_an_agents_answer_gets_gestures_and_an_interruption_is_told_to_both(
        barges_in: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = example("realtime_agent", monkeypatch)
    question, answer = tmp_path / "question.wav", speech(2.5)
    with wave.open(str(question), "wb") as file:
        file.setparams((1, 2, RATE, 0, "NONE", ""))
        file.writeframes(speech(0.6))
    agent, recorder = Agent(answer, barges_in), program.Recorder()

    async def talk() -> float:
        async with asyncio.timeout(120), gestures() as url, serve(agent, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            return float(await program.converse(f"ws://127.0.0.1:{port}/v1/realtime?model=x", url,
                                                program.read_question(question), recorder))

    fps = asyncio.run(talk())
    recorder.write(tmp_path / "a.wav", tmp_path / "a.npz", fps)
    sound, poses = read_wav(tmp_path / "a.wav"), np.load(tmp_path / "a.npz")
    assert bytes(agent.heard).startswith(speech(0.6)), "the question went to the agent"
    numbers = sorted(recorder.poses)
    assert numbers == list(range(len(numbers))), "no frame is missing"
    assert len(numbers) == pytest.approx(len(sound) / RATE * fps, abs=2), "sound and poses are on one time line"
    np.testing.assert_allclose(np.linalg.norm(poses["rotations"], axis=-1), 1.0, atol=1e-5)
    np.testing.assert_array_equal(sound[-len(answer) // 2:], np.frombuffer(answer, "<i2"), "the whole answer, last")
    speaking = poses["rotations"][-round(2.5 * fps):]
    assert np.abs(np.diff(speaking, axis=0)).max() > 1e-3, "it gestures"
    cut = [event for event in agent.got if event["type"] == "conversation.item.truncate"]
    assert len(cut) == barges_in
    if barges_in:
        assert (cut[0]["item_id"], cut[0]["content_index"]) == ("item_1", 0)
        heard = cut[0]["audio_end_ms"]
        assert 300 <= heard < 2500
        begin = len(sound) - len(answer) // 2
        # What was heard of the first answer stands before the second one, and nothing of it after.
        first = np.frombuffer(answer, "<i2")[:round(heard * RATE / 1000) - 48]
        places = [at for at in np.flatnonzero(sound[:begin] == first[1000]) - 1000
                  if at >= 0 and np.array_equal(sound[at:at + len(first)], first)]
        assert len(places) == 1
