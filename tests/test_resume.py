"""Clients that come back: a connection that breaks and a server that is killed, in mid-sentence."""

import asyncio
import json
import time as clock
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from live_double import TURN, TellingStream, figure, opener
from pipecat_gesticulator import Hello, Joint, Poses, ResumingStream, SteadyPlayer, Welcome, connect_resuming
from pipecat_gesticulator.resuming import RefusedError
from test_serve import pcm
from websockets.asyncio.server import ServerConnection, serve

from data_module.motion import rotation
from data_module.speech.audio import SAMPLE_RATE
from gesticulator.live.limits import ServerAddress, ServerLimits
from gesticulator.live.server import LiveServer
from gesticulator.stream import StreamFrames

LIMITS = ServerLimits(streams=8, drain_seconds=0.2)
Opener = Callable[[ServerLimits], Any]


@asynccontextmanager
async def running(port: int = 0, limits: ServerLimits = LIMITS, make: Opener = opener, token: str = ""
                  ) -> AsyncIterator[tuple[LiveServer, int, asyncio.Task[None]]]:
    address = ServerAddress(port=port, token=token)
    listening = address.listen()
    server = LiveServer(address, limits, make(limits))
    ended = asyncio.create_task(server.run(listening))
    try:
        yield server, listening.getsockname()[1], ended
    finally:
        server.stop()
        server.stop()
        await asyncio.gather(ended, return_exceptions=True)
        listening.close()


def run(test: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(300):  # a broken loop ends; a slow machine does not
            await test()

    asyncio.run(bounded())


def break_connections(server: LiveServer) -> None:
    for connection in server.connections:
        connection.socket.transport.abort()


async def spoken(stream: ResumingStream, seconds: float, breaks: int, break_it: Callable[[], None],
                 idle: float | None = None) -> tuple[list[Poses], list[dict[str, Any]]]:
    """The poses and events of sound in pieces of 0.1 s, while the connection breaks so many times; idle: seconds of
    waiting after it."""
    poses: list[Poses] = []
    events: list[dict[str, Any]] = []
    count = round(seconds * 10)

    async def speak() -> None:
        for number in range(count):
            if number % (count // breaks) == 10:
                break_it()
            await stream.send(pcm(0.1))
            await asyncio.sleep(0.005)
        if idle is not None:
            await stream.idle(idle)
        await stream.finish()

    speaking = asyncio.create_task(speak())
    async for message in stream:
        poses.append(message) if isinstance(message, Poses) else events.append(message)
    await speaking
    return poses, events


@pytest.mark.parametrize("breaks", [1, 5])
def test_a_broken_connection_costs_no_frame_and_no_sound(breaks: int) -> None:
    """Each frame is that of its sound: a connection begins at the message whose poses did not all come."""
    async def test() -> None:
        async with running() as (server, port, _), \
                connect_resuming(f"ws://127.0.0.1:{port}/stream", Hello(SAMPLE_RATE)) as stream:
            poses, events = await spoken(stream, 10.0, breaks, lambda: break_connections(server), 0.5)
            numbers = np.concatenate([np.arange(packet.first, packet.first + len(packet)) for packet in poses])
            assert sorted(set(numbers)) == list(range(630)) and len(numbers) < 630 + 10 * breaks
            assert np.diff(numbers).max() == 1, "none is missing between others"
            begins = {source: min(packet.first for packet in poses if packet.source == source)
                      for source in {packet.source for packet in poses}}
            for packet in poses:  # the double tells the number of its frame, counted from where its stream began
                turns = rotation.to_exponential_map(packet.rotations[:, 0].astype(np.float64))[:, 1] / TURN
                expected = np.arange(len(packet)) + packet.first - begins[packet.source]
                np.testing.assert_allclose(turns, expected, atol=1e-3)
            backs = [event for event in events if event["type"] == "back"]
            assert backs and len(backs) == max(begins)
            assert events[-1]["type"] == "done"
        assert figure(server, "streams") == 0

    run(test)


def test_what_is_wrong_is_not_tried_again() -> None:
    async def test() -> None:
        async with running(token="sesame") as (server, port, _):
            url = f"ws://127.0.0.1:{port}/stream"
            with pytest.raises(RefusedError, match="token") as refused:
                await ResumingStream(url, Hello(SAMPLE_RATE, token="wrong")).open()
            assert refused.value.code == 4401
            stream = ResumingStream(url, Hello(SAMPLE_RATE, token="sesame"))
            await stream.open()
            await stream.add_words([("not", 0, 1)])  # without the option text
            with pytest.raises(RefusedError, match="text"):
                async for _ in stream:
                    pass
            await stream.close()
            while server.connections:
                await asyncio.sleep(0.01)

    run(test)


def test_a_server_that_does_not_come_back_is_given_up() -> None:
    async def test() -> None:
        async with running() as (_, port, _):
            stream = ResumingStream(f"ws://127.0.0.1:{port}/stream", Hello(SAMPLE_RATE), patience=0.3)
            await stream.open()
        with pytest.raises(ConnectionError, match="did not come back"):
            async for _ in stream:
                pass

    run(test)


async def _waits(break_it: Callable[[ServerConnection], Awaitable[None]]) -> list[float]:
    """The waits of a client before its visits to a server that greets and breaks each connection."""
    waits: list[float] = []

    async def greet_and_break(socket: ServerConnection) -> None:
        await socket.recv()
        await socket.send(json.dumps(GREETING))
        await asyncio.sleep(0.01)
        await break_it(socket)
        socket.transport.abort()

    async def pause(seconds: float) -> None:
        waits.append(seconds)

    async with serve(greet_and_break, "127.0.0.1", 0) as server:
        port = next(iter(server.sockets)).getsockname()[1]
        stream = ResumingStream(f"ws://127.0.0.1:{port}/stream", Hello(SAMPLE_RATE), 60.0, pause)
        await stream.open()
        with pytest.raises(ConnectionError, match="did not come back"):
            async for _ in stream:
                pass
        await stream.close()
    return waits


def test_a_server_that_greets_and_breaks_is_visited_ever_less_often_and_given_up() -> None:
    async def test() -> None:
        async def at_once(socket: ServerConnection) -> None:
            pass

        waits = np.array(await _waits(at_once))
        rule = np.minimum(np.concatenate([[0.0], 0.25 * 2.0 ** np.arange(len(waits) - 1)]), 10.0)
        assert (0.5 * rule <= waits).all() and (waits <= rule).all() and 45 < waits.sum() <= 60

    run(test)


def test_no_client_is_back_before_the_server_asks_for_it() -> None:
    async def busy(socket: ServerConnection) -> None:
        await socket.send(json.dumps({"type": "error", "code": 4429, "message": "full", "retry_after": 7.0}))
        await socket.close(4429)

    async def test() -> None:
        waits = await _waits(busy)
        assert min(waits) >= 7.0 and len(waits) >= 4

    run(test)


GREETING = {"type": "hello", "protocol": 1, "stream": "a", "fps": 60.0, "output": "joints", "look_ahead": 0.0,
            "joints": [], "limits": {"message_bytes": 1e6}}


@pytest.mark.parametrize("seed", range(12))
def test_interruptions_and_losses_in_any_order_leave_no_gap(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sound, waits and interruptions, while connections break: at the end there is each frame of the media time that
    was asked for, and neither a command nor the end is lost. Server and reader take their time, so that packets are on
    their way when an interruption is sent."""
    rng, slow = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    feed = TellingStream.feed

    def slowly(self: TellingStream, samples: np.ndarray) -> StreamFrames:
        clock.sleep(float(slow.choice([0.0, 0.0, 0.0, 0.004, 0.015])))
        return feed(self, samples)

    monkeypatch.setattr(TellingStream, "feed", slowly)

    async def test() -> None:
        async with running() as (server, port, _):
            stream = ResumingStream(f"ws://127.0.0.1:{port}/stream", Hello(SAMPLE_RATE),
                                    pause=lambda _: asyncio.sleep(0.001))
            await stream.open()
            frames: list[int] = []

            async def read() -> None:
                async for message in stream:
                    if isinstance(message, Poses):  # it replaces that frame and all later ones
                        assert message.first <= len(frames)
                        frames[message.first:] = range(message.first, message.first + len(message))
                    await asyncio.sleep(float(slow.choice([0.0, 0.0, 0.003, 0.02])))

            reading = asyncio.create_task(read())
            time = 0.0
            for _ in range(60):
                op = str(rng.choice(["send", "send", "send", "idle", "interrupt", "break", "wait"]))
                seconds = float(rng.choice([0.0, rng.uniform(0.0, 0.5)]))
                if op == "send":
                    await stream.send(sound := pcm(seconds))
                    time += len(sound) / 2 / SAMPLE_RATE
                elif op == "idle":
                    await stream.idle(seconds)
                    time += seconds
                elif op == "interrupt":
                    time = float(rng.uniform(0.0, min(time, len(frames) / 60)))
                    await stream.interrupt(time)
                elif op == "break":
                    break_connections(server)
                else:
                    await asyncio.sleep(float(rng.choice([0.0, 0.02])))
            await stream.idle(0.2)
            await stream.finish()
            await reading
            assert abs(len(frames) - (time + 0.2) * 60) <= 1.5
            await stream.close()

    run(test)


def test_a_time_is_the_same_frame_on_every_connection() -> None:
    """A connection that begins between two frames: later interruptions begin where the client says."""
    async def test() -> None:
        async with running() as (server, port, _), \
                connect_resuming(f"ws://127.0.0.1:{port}/stream", Hello(SAMPLE_RATE)) as stream:
            messages = aiter(stream)

            async def poses(until: int) -> Poses:
                while not isinstance(message := await anext(messages), Poses) or message.first + len(message) < until:
                    pass
                return message

            await stream.idle(0.2)
            await poses(12)
            await stream.interrupt(0.11)  # in the seventh frame
            await stream.idle(0.1)
            await poses(12)
            break_connections(server)
            while await anext(messages) != {"type": "back"}:
                pass
            await poses(12)
            await stream.interrupt(0.2)
            await stream.idle(0.1)
            assert (await poses(14)).first == 12

    run(test)


# ---------------------------------------------------------------- on screen


def _walk(seed: int, joints: int, count: int) -> np.ndarray:
    """[count, joints, 4] of a smooth wandering."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) / 60
    waves = sum(rng.normal(0, 0.3, (1, joints, 3)) * np.sin(2 * np.pi * f * t[:, None, None] + rng.uniform(0, 6, 3))
                for f in (0.2, 0.5, 0.9))
    return rotation.from_exponential_map(waves)


def _packets(turns: np.ndarray, first: int, source: int) -> Iterator[Poses]:
    for at in range(0, len(turns), 20):
        piece = turns[at:at + 20].astype(np.float32)
        yield Poses(first + at, 60.0, piece, np.zeros((len(piece), 3), np.float32), "speaking", 0.0, source)


@pytest.mark.parametrize(("gap", "seed"), [(0, 1), (30, 2), (120, 3)])
def test_the_steady_player_shows_the_stream_and_joins_its_parts(gap: int, seed: int) -> None:
    """Before the break it is the stream to the last bit of a float32; around it, no joint jumps; a while after, it is
    the stream again."""
    joints = tuple(Joint(f"{k}", k - 1, (0, 0, 0)) for k in range(6))
    player = SteadyPlayer(Welcome("", 60.0, "joints", 0.0, joints, {}))
    one, other = _walk(seed, 4, 200), _walk(seed + 10, 4, 300)
    for packet in _packets(one, 0, 0):
        player.add(packet)
    shown = []
    for picture in range(200 + gap + 250):
        if picture == 200 + gap:
            for packet in _packets(other, 200 + gap, 1):
                player.add(packet)
        pose = player.pose_at(picture / 60 + 1e-4)
        assert pose is not None
        shown.append(pose[0])
    turns = np.stack(shown)
    np.testing.assert_allclose(turns[:200], one, atol=1e-6)
    steps = rotation.to_exponential_map(_relative(turns))
    natural = max(np.abs(rotation.to_exponential_map(_relative(walk))).max() for walk in (one, other))
    assert np.abs(steps).max() < 3.0 * natural + 0.02, "no jump"
    assert np.abs(np.diff(steps, axis=0)).max() * 3600 < 80, "rad/s^2"
    near = rotation.to_exponential_map(_between(turns[200 + gap + 200:200 + gap + 250], other[200:250]))
    assert np.abs(near).max() < 1e-3


def _relative(turns: np.ndarray) -> np.ndarray:
    return _between(turns[1:], turns[:-1])


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    found = rotation.multiply(a, b * [1, -1, -1, -1])
    return np.where(found[..., :1] < 0, -found, found)
