"""The audio output for LiveKit agents, driven as a session drives it: capture, flush and clear, against our server. The
classes are LiveKit's; its server is not needed, since the output behind is one that plays nothing."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest
from live_double import served

pytest.importorskip("livekit.agents", reason="livekit-agents is not installed")

from livekit import rtc
from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities
from pipecat_gesticulator import Poses
from pipecat_gesticulator.livekit import GestureAudioOutput

from gesticulator.live.limits import ServerLimits

RATE = 24000


class Silent(AudioOutput):
    """The end of a chain: takes sound and says that it was played."""

    def __init__(self) -> None:
        super().__init__(label="silent", capabilities=AudioOutputCapabilities(pause=False), sample_rate=RATE)
        self.taken: list[rtc.AudioFrame] = []
        self.cleared = 0

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        await super().capture_frame(frame)
        self.taken.append(frame)

    def flush(self) -> None:
        super().flush()
        self.on_playback_finished(playback_position=sum(one.duration for one in self.taken), interrupted=False)

    def clear_buffer(self) -> None:
        self.cleared += 1
        super().flush()
        self.on_playback_finished(playback_position=0.0, interrupted=True)


def frame(seconds: float) -> rtc.AudioFrame:
    count = round(seconds * RATE)
    samples = (8000 * np.sin(np.arange(count) * 0.1)).astype(np.int16)
    return rtc.AudioFrame(samples.tobytes(), RATE, 1, count)


def test_sound_passes_poses_come_and_an_interruption_takes_them_back() -> None:
    shown: list[Poses] = []

    async def drive(url: str) -> tuple[Silent, GestureAudioOutput]:
        async def show(poses: Poses, welcome: Any) -> None:
            shown.append(poses)

        async with asyncio.timeout(60):
            silent = Silent()
            output = GestureAudioOutput(silent, show, url)
            output.on_attached()
            for _ in range(20):
                await output.capture_frame(frame(0.1))
            output.flush()
            finished = await output.wait_for_playout()
            assert not finished.interrupted and finished.playback_position == pytest.approx(2.0)
            while not shown or shown[-1].first + len(shown[-1]) < 120:
                await asyncio.sleep(0.01)
            first = [number for one in shown for number in range(one.first, one.first + len(one))]
            assert first == list(range(len(first))), "every frame once, up to the flush"
            for _ in range(40):
                await output.capture_frame(frame(0.1))
            output.clear_buffer()
            at = output.media_time()
            assert (await output.wait_for_playout()).interrupted and silent.cleared == 1
            before = len(shown)
            while not any(one.first <= round(at * 60) + 1 for one in shown[before:]):
                await asyncio.sleep(0.01)
            assert output.problem is None
            output.on_detached()
            return silent, output

    with served(ServerLimits(), {}) as (_, port):
        silent, _ = asyncio.run(drive(f"ws://127.0.0.1:{port}/stream"))
        assert len(silent.taken) == 60, "sound passes, whatever the server does"


def test_without_a_server_the_agent_speaks() -> None:
    async def drive() -> None:
        async def show(poses: Poses, welcome: Any) -> None:
            raise AssertionError

        silent = Silent()
        output = GestureAudioOutput(silent, show, "ws://127.0.0.1:9/stream")
        output.on_attached()
        await output.capture_frame(frame(0.1))
        while output.problem is None:
            await asyncio.sleep(0.01)
        await output.capture_frame(frame(0.1))
        output.flush()
        assert len(silent.taken) == 2 and (await output.wait_for_playout()).playback_position > 0
        output.on_detached()

    asyncio.run(drive())
