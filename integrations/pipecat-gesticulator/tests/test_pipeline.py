"""The processor in a real Pipecat pipeline, behind a synthesiser that runs offline."""

from __future__ import annotations

import asyncio
import io
import json
import shutil
import subprocess
import time
import wave
from collections.abc import AsyncGenerator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pipecat", reason="pipecat-ai is not installed")
if shutil.which("espeak-ng") is None:
    pytest.skip("espeak-ng is not installed", allow_module_level=True)

from pipecat.frames.frames import (
    ErrorFrame,
    Frame,
    InterruptionFrame,
    OutputTransportMessageUrgentFrame,
    TTSAudioRawFrame,
    TTSSpeakFrame,
)
from pipecat.pipeline.pipeline import Pipeline
from pipecat.services.settings import TTSSettings
from pipecat.services.tts_service import TTSService
from pipecat.tests.utils import SleepFrame, run_test
from pipecat_gesticulator.marks import spoken_text
from pipecat_gesticulator.messages import LONGEST
from pipecat_gesticulator.processor import GesticulatorProcessor, PoseFrame
from streamed import places_of

RATE = 22050
"""Hertz of espeak-ng."""


class EspeakService(TTSService):
    """espeak-ng as a synthesiser, which delivers much faster than it speaks."""

    def __init__(self) -> None:
        self.said: list[str] = []
        super().__init__(sample_rate=RATE, push_start_frame=True, push_stop_frames=True, stop_frame_timeout_s=1.0,
                         text_transforms=[("*", spoken_text)],
                         settings=TTSSettings(model=None, voice=None, language=None))

    def can_generate_metrics(self) -> bool:
        return False

    async def run_tts(self, text: str, context_id: str) -> AsyncGenerator[Frame | None, None]:
        self.said.append(text)
        done = await asyncio.to_thread(subprocess.run, ["espeak-ng", "--stdout", text], capture_output=True, check=True)
        with wave.open(io.BytesIO(done.stdout)) as sound:
            samples = sound.readframes(10**7)
        for start in range(0, len(samples), RATE // 5):
            yield TTSAudioRawFrame(samples[start:start + RATE // 5], RATE, 1, context_id=context_id)


class Clocked(GesticulatorProcessor):
    """Notes how long sound takes to pass."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.waits: list[float] = []
        self._since = 0.0

    async def process_frame(self, frame: Frame, direction: Any) -> None:
        self._since = time.perf_counter()
        await super().process_frame(frame, direction)

    async def push_frame(self, frame: Frame, *args: Any) -> None:
        if isinstance(frame, TTSAudioRawFrame):
            self.waits.append(time.perf_counter() - self._since)
        await super().push_frame(frame, *args)


def through(processor: GesticulatorProcessor, *frames: Frame, voice: EspeakService | None = None) -> list[Frame]:
    """What comes out of a pipeline of espeak-ng and the processor."""
    pipeline = Pipeline([voice or EspeakService(), processor])
    down, _ = asyncio.run(run_test(pipeline, frames_to_send=frames, start_timeout=10.0))
    return list(down)


def hand_speeds(frames: list[PoseFrame]) -> np.ndarray:
    """[T - 1] m/s of the right hand, of frames that replace each other as they say."""
    welcome = frames[0].welcome
    length = max(one.poses.first + len(one.poses) for one in frames)
    turns, root = np.zeros((length, len(welcome.joints), 4)), np.zeros((length, 3))
    for one in frames:
        end = one.poses.first + len(one.poses)
        turns[one.poses.first:end], root[one.poses.first:end] = one.poses.rotations, one.poses.root_positions
        length = end
    hand = [joint.name for joint in welcome.joints].index("RightHand")
    places = places_of(welcome.joints, turns[:length], root[:length])[:, hand]
    return np.linalg.norm(np.diff(places, axis=0), axis=1) * welcome.fps


def test_an_agents_speech_gets_gestures_and_waits_for_nothing(url: str) -> None:
    processor = Clocked(url, seed=3)
    text = "I never said that we should leave, but there is a better way, and a much bigger one."
    down = through(processor, TTSSpeakFrame(text), SleepFrame(6.0))
    sound = [frame for frame in down if isinstance(frame, TTSAudioRawFrame)]
    poses = [frame for frame in down if isinstance(frame, PoseFrame)]
    assert not any(isinstance(frame, ErrorFrame) for frame in down)
    seconds = sum(len(frame.audio) for frame in sound) / 2 / RATE
    assert seconds > 4
    numbers = np.concatenate([np.arange(one.poses.first, one.poses.first + len(one.poses)) for one in poses])
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)), "no frame lacks and none comes twice")
    # Idle time lies before, between and after.
    assert seconds <= len(numbers) / 60 < seconds + 8
    assert np.median(processor.waits) < 0.002, "sound goes on at once"
    speeds = hand_speeds(poses)
    assert speeds.max() > 0.3, "the hands move"
    assert speeds.max() < 8.0


def test_an_interruption_brings_the_hands_down(url: str) -> None:
    processor = GesticulatorProcessor(url, seed=3)
    long = "This is a long answer that nobody wants to hear to its end. " * 4
    down = through(processor, TTSSpeakFrame(long), SleepFrame(2.5), InterruptionFrame(), SleepFrame(2.0))
    poses = [frame for frame in down if isinstance(frame, PoseFrame)]
    firsts = [one.poses.first for one in poses]
    ends = [one.poses.first + len(one.poses) for one in poses]
    back = [k for k in range(1, len(poses)) if firsts[k] < ends[k - 1]]
    assert len(back) == 1, "the poses that were not heard are replaced, once"
    cut = firsts[back[0]] / 60
    assert 1.0 < cut < 4.0
    assert hand_speeds(poses)[int((cut + 1.2) * 60):].max() < 0.3


def test_the_client_gets_the_poses_by_the_transports_messages(url: str) -> None:
    processor = GesticulatorProcessor(url, seed=3, fps=30.0, messages=True)
    down = through(processor, TTSSpeakFrame("There is a better way, and a bigger one."), SleepFrame(3.0))
    poses = [frame.poses for frame in down if isinstance(frame, PoseFrame)]
    said = [frame.message for frame in down if isinstance(frame, OutputTransportMessageUrgentFrame)]
    assert {message["type"] for message in said} == {"server-message"}
    assert max(len(json.dumps(message)) for message in said) <= LONGEST
    # Urgent messages may be read before frames that were pushed earlier, but not before each other.
    firsts = [(message["data"]["first"], message["data"]["count"]) for message in said if "first" in message["data"]]
    assert [k for first, count in firsts for k in range(first, first + count)] == [
        k for one in poses for k in range(one.first, one.first + len(one))]
    played = [message["data"]["now"] for message in said if "now" in message["data"]]
    assert played == sorted(played) and played[-1] > 2.0


def test_without_a_server_the_agent_still_speaks() -> None:
    down = through(GesticulatorProcessor("ws://127.0.0.1:9/stream"), TTSSpeakFrame("Hello."), SleepFrame(1.0))
    assert any(isinstance(frame, TTSAudioRawFrame) for frame in down)
    assert not any(isinstance(frame, PoseFrame) for frame in down)


def shoulder_turns(frames: list[PoseFrame], state: str = "speaking") -> np.ndarray:
    """[T] degrees by which both shoulders are turned up at once, while the avatar is in a state."""
    names = [joint.name for joint in frames[0].welcome.joints]
    numbers = [names.index(f"{side}Shoulder") for side in ("Left", "Right")]
    turns = np.concatenate([one.poses.rotations[:, numbers] for one in frames if one.poses.state == state])
    degrees: np.ndarray = np.degrees(2 * np.arctan2(turns[..., 3], turns[..., 0])) * (1, -1)
    return degrees.min(axis=1)


def test_a_mark_makes_a_gesture_and_is_not_spoken(url: str) -> None:
    said, turns = [], []
    for mark in ("", "[shrug] ", "\N{SHRUG}"):
        voice = EspeakService()
        processor = GesticulatorProcessor(url, seed=3, options={"text": True})
        # Words that call for no gesture by themselves.
        text = f"Then the train went along the river, {mark}and the rain had stopped by the evening."
        down = through(processor, TTSSpeakFrame(text), SleepFrame(5.0), voice=voice)
        assert not any(isinstance(frame, ErrorFrame) for frame in down)
        said.append(" ".join(voice.said).split())
        turns.append(shoulder_turns([frame for frame in down if isinstance(frame, PoseFrame)]).max())
    assert said[0] == said[1] == said[2]
    assert turns[1] > turns[0] + 4 and turns[2] > turns[0] + 4, "both shoulders rise by 13 degrees in a shrug"
