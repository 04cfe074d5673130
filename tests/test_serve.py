"""The server: its protocol, its limits, that no client is another's business; and the command.

A server's whole life is in `test_deploy.py`.
"""

import asyncio
import json
import logging
import socket
import time
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live_double import LOOK_AHEAD, TURN, TellingStream, figure, opener
from pipecat_gesticulator import Hello, PosePlayer, Poses, connect
from prometheus_client.parser import text_string_to_metric_families
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import ConnectionClosed, InvalidStatus

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.motion.smplx import smplx_arrays
from gesticulator.cli import Parser
from gesticulator.live.command import COMMAND, read_token
from gesticulator.live.limits import ServerAddress, ServerLimits
from gesticulator.live.protocol import CloseCode, StreamRequest, published
from gesticulator.live.server import LiveServer

RATE = 16000
LIMITS = ServerLimits(streams=8, stream_seconds=100.0, message_bytes=2**16, waiting_seconds=10.0,
                      unread_bytes=2**16, unread_seconds=1.0, hello_seconds=0.5, quiet_seconds=5.0, drain_seconds=0.5)


@dataclass
class Running:
    """A server in the test's own loop."""

    server: LiveServer
    port: int
    ended: asyncio.Task[None]

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}/stream"

    async def get(self, path: str, token: str = "", host: str = "") -> tuple[int, str]:
        headers = {"Authorization": f"Bearer {token}" if token else "", "Host": host or f"127.0.0.1:{self.port}"}
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", headers=headers)

        def fetch() -> tuple[int, str]:
            try:
                with urllib.request.urlopen(request, timeout=5) as answer:
                    return answer.status, answer.read().decode()
            except urllib.error.HTTPError as error:
                return error.code, error.read().decode()

        return await asyncio.to_thread(fetch)


@asynccontextmanager
async def running(limits: ServerLimits = LIMITS, work: float = 0.0, share: float = 0.0,
                  **address: Any) -> AsyncIterator[Running]:
    where = ServerAddress(port=0, **address)
    listening = where.listen()
    server = LiveServer(where, limits, opener(limits, work, share))
    ended = asyncio.create_task(server.run(listening))
    try:
        yield Running(server, listening.getsockname()[1], ended)
    finally:
        server.stop()
        await asyncio.wait_for(ended, 10)


def in_loop(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Runs a test's coroutine, two minutes at most."""
    @wraps(test)
    def bounded(**arguments: Any) -> None:
        asyncio.run(asyncio.wait_for(test(**arguments), 120))

    return bounded


def pcm(seconds: float, rate: int = RATE) -> bytes:
    return (np.sin(np.arange(int(seconds * rate)) * 0.1) * 8000).astype("<i2").tobytes()


async def talk(url: str, sound: bytes, hello: Hello | None = None, step: int = 3200
               ) -> tuple[list[Poses], list[dict[str, Any]]]:
    """Send sound in pieces, finish, and give all that was answered."""
    poses, events = [], []
    async with connect(url, hello or Hello(RATE)) as stream:
        for start in range(0, len(sound), step):
            await stream.send(sound[start:start + step])
        await stream.finish()
        async for message in stream:
            (poses if isinstance(message, Poses) else events).append(message)
    return poses, events


async def closed_with(url: str, *messages: str | bytes, **options: Any) -> tuple[int, str]:
    """The code and the reason that the server closes with after these messages."""
    async with open_socket(url, **options) as ws:
        with suppress(ConnectionClosed):
            for message in messages:
                await ws.send(message)
            while True:
                await ws.recv()
        assert ws.close_code is not None
        return ws.close_code, ws.close_reason or ""


def assert_whole(poses: list[Poses], seconds: float, fps: float = 60.0) -> None:
    """The frames follow each other from 0 to the end and each is the one that it says."""
    numbers = np.concatenate([np.arange(one.first, one.first + len(one)) for one in poses])
    np.testing.assert_array_equal(numbers, np.arange(int(seconds * fps)))
    hips = np.concatenate([one.rotations[:, 0] for one in poses]).astype(np.float64)
    np.testing.assert_allclose(rotation.to_exponential_map(hips)[:, 1], numbers * TURN, atol=1e-6)
    root = np.concatenate([one.root_positions for one in poses])
    np.testing.assert_allclose(root, np.tile([0, 0.95, 0], (len(root), 1)), atol=1e-6)


# ---------------------------------------------------------------- what goes over the wire


@pytest.mark.parametrize("kind", ["pcm16", "float32"])
@in_loop
async def test_sound_in_poses_out(kind: str) -> None:
    sound = pcm(2.0) if kind == "pcm16" else (np.frombuffer(pcm(2.0), "<i2") / 32768).astype("<f4").tobytes()
    async with running() as at:
        poses, events = await talk(at.url, sound, Hello(RATE, kind))
        assert_whole(poses, 2.0)
        assert events[-1] == {"type": "done", "frames": 120}
        assert [event["state"] for event in events if event["type"] == "state"] == ["speaking"]


@in_loop
async def test_the_hello_tells_the_skeleton() -> None:
    async with running() as at, connect(at.url, Hello(RATE, fps=30, seed=7)) as stream:
        told = stream.welcome
        assert (told.fps, told.look_ahead) == (30, LOOK_AHEAD)
        assert tuple(joint.name for joint in told.joints) == CHARACTER.names
        assert tuple(joint.parent for joint in told.joints) == CHARACTER.parents
        np.testing.assert_allclose([joint.offset for joint in told.joints], CHARACTER.offsets, atol=1e-6)
        await stream.finish()


@in_loop
async def test_smplx_poses_are_those_of_an_smplx_file() -> None:
    async with running() as at:
        poses, _ = await talk(at.url, pcm(1.0), Hello(RATE, output="smplx"))
        double = TellingStream(StreamRequest(RATE))
        double.time = 1.0
        truth = smplx_arrays(double.finish().motion())
        got = np.concatenate([one.rotations for one in poses])
        assert got.shape == (60, 55, 3)
        np.testing.assert_allclose(got.reshape(60, -1), truth["poses"], atol=1e-6)
        np.testing.assert_allclose(np.concatenate([one.root_positions for one in poses]), truth["trans"], atol=1e-6)


@in_loop
async def test_every_message_fits_the_published_schema() -> None:
    """An independent validator reads the schema and what a server really sends."""
    told = published()
    jsonschema.Draft202012Validator.check_schema(told)
    async with running() as at, open_socket(at.url) as ws:
        await ws.send(Hello(RATE).text())
        await ws.send(pcm(1.0))
        await ws.send(json.dumps({"type": "finish"}))
        kinds = []
        async for message in ws:
            if isinstance(message, bytes):
                size = int.from_bytes(message[:4], "little")
                assert size % 4 == 0
                header = json.loads(message[4:4 + size])
                jsonschema.validate(header, {"$ref": "#/$defs/poses", "$defs": told["$defs"]})
            else:
                jsonschema.validate(json.loads(message), {"oneOf": told["server"]["oneOf"],
                                                          "$defs": told["$defs"]})
                kinds.append(json.loads(message)["type"])
        assert kinds[0] == "hello" and kinds[-1] == "done"


def test_codes_are_those_of_the_schema() -> None:
    assert {str(int(code)) for code in CloseCode} == set(published()["close_codes"])


# ---------------------------------------------------------------- commands


@in_loop
async def test_idle_listen_and_interrupt() -> None:
    async with running() as at, connect(at.url, Hello(RATE)) as stream:
        await stream.send(pcm(1.0))
        await stream.think(0.5)
        await stream.listen()
        await stream.send(pcm(0.5))
        said: list[Any] = []
        async for message in stream:
            said.append(message)
            if isinstance(message, Poses) and message.state == "listening":
                break
        await stream.interrupt()
        await stream.speak()
        await stream.send(pcm(1.0))
        await stream.finish()
        said += [message async for message in stream]
        assert_whole([one for one in said if isinstance(one, Poses)], 3.0)
        states = [event["state"] for event in said if isinstance(event, dict) and event["type"] == "state"]
        assert states == ["speaking", "thinking", "listening", "idle", "speaking"]


@in_loop
async def test_beats_lexemes_and_words_are_events() -> None:
    async with running() as at, connect(at.url, Hello(RATE, options={"text": True})) as stream:
        await stream.add_words([("there", 1.2, 1.5), ("hello", 0.1, 0.4), ("never", 50.0, 51.0)])
        await stream.send(pcm(2.0))
        await stream.finish()
        events = [message async for message in stream if isinstance(message, dict)]
        assert [event["time"] for event in events if event["type"] == "beat"] == [0.5, 1.0, 1.5, 2.0]
        assert [event["lexeme"] for event in events if event["type"] == "lexeme"] == [0, 1, 2, 3]
        assert [event["text"] for event in events if event["type"] == "word"] == ["hello", "there"]


@pytest.mark.parametrize("heard", [1.9, 1.0])
@in_loop
async def test_media_time_goes_on_from_where_the_voice_was_heard(heard: float) -> None:
    """Also where it was heard before there were poses of it, as of a voice that is played as it is sent."""
    async with running() as at, connect(at.url, Hello(RATE)) as stream:
        player = PosePlayer()
        await stream.send(pcm(2.0))
        async for message in stream:
            if isinstance(message, Poses):
                player.add(message)
                if player.end >= 1.5:
                    break
        await stream.interrupt(heard)
        await stream.idle(0.5)
        await stream.send(pcm(1.0))
        await stream.finish()
        async for message in stream:
            if isinstance(message, Poses):
                player.add(message)
        assert player.end == pytest.approx(heard + 0.5 + 1.0)


@in_loop
async def test_an_interruption_drops_the_sound_that_waits() -> None:
    async with running(work=0.1) as at, connect(at.url, Hello(RATE)) as stream:
        await stream.send(pcm(8.0))  # 16 pieces of work
        await asyncio.sleep(0.15)
        await stream.interrupt()
        await stream.finish()
        done = [message async for message in stream][-1]
        assert isinstance(done, dict) and 0 < done["frames"] < 60 * 3


# ---------------------------------------------------------------- limits


@pytest.mark.parametrize(("messages", "code"), [
    ((b"\0" * 10,), CloseCode.BAD_MESSAGE),
    (("{",), CloseCode.BAD_MESSAGE),
    (("[" * 20_000,), CloseCode.BAD_MESSAGE),
    (('{"type": "hello", "protocol": 1, "sample_rate": NaN}',), CloseCode.BAD_MESSAGE),
    (('{"type": "hello", "protocol": 2, "sample_rate": 16000}',), CloseCode.BAD_MESSAGE),
    (('{"type": "hello", "protocol": 1, "sample_rate": 100}',), CloseCode.BAD_MESSAGE),
    (('{"type": "hello", "protocol": 1, "sample_rate": 16000, "fps": 0}',), CloseCode.BAD_MESSAGE),
    (('{"type": "finish"}',), CloseCode.BAD_MESSAGE),
    ((Hello(RATE).text(), b"\0\0\0"), CloseCode.BAD_MESSAGE),
    ((Hello(RATE).text(), Hello(RATE).text()), CloseCode.BAD_MESSAGE),
    ((Hello(RATE).text(), '{"type": "words", "words": [{"text": "a", "start": 0, "end": 1}]}'), CloseCode.BAD_MESSAGE),
    ((Hello(RATE, "float32").text(), np.array([0, np.nan], "<f4").tobytes()), CloseCode.BAD_MESSAGE),
    ((Hello(RATE, "float32").text(), np.array([3e38], "<f4").tobytes()), CloseCode.BAD_MESSAGE),
    ((Hello(RATE).text(), b"\0" * (2**16 + 2)), CloseCode.TOO_BIG),
    ((), CloseCode.TOO_QUIET),
    ((Hello(RATE).text(), b"\xff\x7f" * 16000), CloseCode.FAILED),
], ids=lambda value: str(value)[:40])
@in_loop
async def test_what_is_wrong_is_closed_with_its_code_and_others_go_on(messages: tuple[str | bytes, ...], code: CloseCode
                                                               ) -> None:
    async with running() as at, connect(at.url, Hello(RATE)) as other:
        assert (await closed_with(at.url, *messages))[0] == code
        await other.send(pcm(1.0))
        await other.finish()
        assert_whole([one async for one in other if isinstance(one, Poses)], 1.0)


async def speak(url: str, seconds: float, options: dict[str, Any]) -> tuple[list[Poses], list[dict[str, Any]]]:
    """Sound in real time, 50 ms at a time; its poses and events."""
    poses: list[Poses] = []
    events: list[dict[str, Any]] = []
    step, piece = 0.05, pcm(0.05)
    async with connect(url, Hello(RATE, options=options)) as stream:
        begin = time.monotonic()

        async def send() -> None:
            for k in range(round(seconds / step)):
                await asyncio.sleep(max(0.0, begin + (k + 1) * step - time.monotonic()))
                await stream.send(piece)
            await stream.finish()

        sending = asyncio.create_task(send())
        async for message in stream:
            if isinstance(message, Poses):
                poses.append(message)
            else:
                events.append(message)
        await sending
    return poses, events


@in_loop
async def test_a_server_that_is_too_slow_passes_over_what_is_late() -> None:
    """Four seconds of work for a second of sound: all of it would be nine seconds late. How late it is then stands in
    `test_pace.py`, where time is counted and not measured."""
    async with running(share=4.0) as at:
        poses, events = await speak(at.url, 3.0, {"latency": "low"})
        assert_whole(poses, 3.0)
        passed = [event["passed"] for event in events if event["type"] == "pace" and event["effort"] == "none"]
        assert passed and 0.9 < passed[-1] < 3.0
        for event in events:
            jsonschema.validate(event, {"oneOf": published()["server"]["oneOf"], "$defs": published()["$defs"]})


@in_loop
async def test_too_much_sound_has_a_clear_code() -> None:
    async with running(work=0.2) as at:
        code, reason = await closed_with(at.url, Hello(RATE).text(), *[pcm(1.0)] * 15)
        assert code == CloseCode.TOO_MUCH_SOUND and "wait" in reason
    async with running(replace(LIMITS, stream_seconds=3.0)) as at:
        code, reason = await closed_with(at.url, Hello(RATE).text(), *[pcm(1.0)] * 5)
        assert code == CloseCode.TOO_MUCH_SOUND and "3 s" in reason


@in_loop
async def test_the_token_is_asked_for() -> None:
    async with running(token="open sesame") as at:
        assert (await closed_with(at.url, Hello(RATE).text()))[0] == CloseCode.BAD_TOKEN
        assert (await closed_with(at.url, Hello(RATE, token="open sesam\u00e9").text()))[0] == CloseCode.BAD_TOKEN
        assert_whole((await talk(at.url, pcm(1.0), Hello(RATE, token="open sesame")))[0], 1.0)
        assert (await at.get("/metrics"))[0] == 401 and (await at.get("/healthz"))[0] == 200
        assert (await at.get("/metrics", "open sesame"))[0] == 200
        assert (await at.get("/metrics", "sesame"))[0] == 401


@in_loop
async def test_streams_take_turns_whatever_one_of_them_asked_for() -> None:
    """Beside a stream that was sent eight seconds at once, one that speaks now waits for one turn of it at a time."""
    async with running(work=0.05) as at, connect(at.url, Hello(RATE)) as greedy, \
            connect(at.url, Hello(RATE)) as other:
        await greedy.send(pcm(8.0))  # 16 turns of 0.05 s
        await asyncio.sleep(0.02)
        begin = time.monotonic()
        await other.send(pcm(1.0))  # two turns
        await other.finish()
        assert_whole([message async for message in other if isinstance(message, Poses)], 1.0)
        assert time.monotonic() - begin < 0.5, "all turns of the first take 0.8 s"


@pytest.mark.parametrize(("origin", "allowed"), [
    (None, True), ("http://localhost:3000", True), ("http://127.0.0.1:8765", True), ("https://good.example", True),
    ("https://evil.example", False), ("null", False), ("http://localhost.evil.example", False), ("http://[", False)])
@in_loop
async def test_pages_of_other_origins_may_not_connect(origin: str | None, allowed: bool) -> None:
    async with running(origins=("https://good.example",)) as at:
        opening = open_socket(at.url, origin=origin)  # type: ignore[arg-type]
        if not allowed:
            with pytest.raises(InvalidStatus, match="403"):
                await opening
            return
        async with opening as ws:
            await ws.send(Hello(RATE).text())
            assert json.loads(await ws.recv())["type"] == "hello"


@pytest.mark.parametrize(("host", "allowed"), [
    ("localhost:8765", True), ("[::1]:8765", True), ("good.example", True), ("evil.example:8765", False),
    ("127.0.0.1.evil.example", False), ("[", False)])
@in_loop
async def test_a_page_whose_name_was_turned_to_this_machine_reads_nothing(host: str, allowed: bool) -> None:
    async with running(origins=("https://good.example",)) as at:
        for path in ("/healthz", "/readyz", "/metrics"):
            assert (await at.get(path, host=host))[0] == (200 if allowed else 403)


@in_loop
async def test_no_more_streams_than_the_limit() -> None:
    async with running(replace(LIMITS, streams=2)) as at:
        async with connect(at.url, Hello(RATE)), connect(at.url, Hello(RATE)):
            async with open_socket(at.url) as ws:
                await ws.send(Hello(RATE).text())
                told = json.loads(await ws.recv())
            assert told["code"] == CloseCode.TOO_MANY_STREAMS and "2 streams" in told["message"]
            assert 0 < told["retry_after"] < 60
            assert (await at.get("/readyz"))[0] == 503 and await at.get("/healthz") == (200, "ok\n")
        async with asyncio.timeout(60):
            while at.server.connections:
                await asyncio.sleep(0.01)
        assert_whole((await talk(at.url, pcm(1.0)))[0], 1.0)


@in_loop
async def test_a_flood_of_short_messages_waits() -> None:
    begin = time.monotonic()
    async with running() as at, open_socket(at.url) as ws:
        for text in (Hello(RATE).text(), *1600 * ['{"type": "speak"}'], '{"type": "finish"}'):
            await ws.send(text)
        assert json.loads([message async for message in ws][-1])["type"] == "done"
    assert time.monotonic() - begin > 1600 / 500 - 2.0


@in_loop
async def test_a_stalled_client_costs_its_bound_and_other_clients_nothing() -> None:
    """A client that sends and never reads: its queue stays under the limit, others are served, and it is cut off."""
    limits = replace(LIMITS, unread_bytes=2**17, waiting_seconds=60.0, unread_seconds=1.5)
    async with running(limits) as at:
        plain = socket.socket()
        plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        plain.connect(("127.0.0.1", at.port))
        stalled = await open_socket(at.url, sock=plain, max_queue=1, ping_interval=None)
        await stalled.send(Hello(RATE, fps=240).text())
        for _ in range(55):
            await stalled.send(pcm(1.0))
        highest, served = 0.0, 0
        for _ in range(8):
            assert_whole((await talk(at.url, pcm(1.0)))[0], 1.0)
            served += 1
            highest = max(highest, figure(at.server, "unread_bytes"))
            await asyncio.sleep(0.05)
        assert served == 8
        # One piece of work may go over the line: half a second at 240 frames per second.
        assert 2**17 <= highest <= 2**17 + 120 * (16 * 4 + 3) * 4 + 10_000
        async with asyncio.timeout(60):
            while at.server.connections:
                await asyncio.sleep(0.05)
        assert figure(at.server, "closed_total", code=str(int(CloseCode.UNREAD))) == 1
        stalled.transport.abort()


# ---------------------------------------------------------------- faults


@in_loop
async def test_a_failure_in_a_stream_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "gesticulator")
    async with running() as at:
        await closed_with(at.url, Hello(RATE).text(), b"\xff\x7f" * 1000)
    failures = [record.getMessage() for record in caplog.records if "a model failed" in record.getMessage()]
    assert len(failures) == 1 and "4500" in failures[0] and "\n" not in failures[0]


JSON = st.recursive(st.none() | st.booleans() | st.integers(-3, 200_000) | st.floats() | st.text(max_size=5),
                    lambda own: st.lists(own, max_size=3) | st.dictionaries(st.text(max_size=5), own, max_size=3),
                    max_leaves=5)
MESSAGES = st.lists(st.one_of(
    st.binary(max_size=50),
    st.text(max_size=20),
    JSON.map(json.dumps),
    st.sampled_from([Hello(RATE).text(), '{"type":"finish"}', '{"type":"idle","seconds":0.1}', '{"type":"interrupt"}',
                     '{"type":"listen"}', '{"type":"speak"}', '{"type":"idle"}', '{"type":"idle","seconds":-1}']),
    st.dictionaries(st.sampled_from(["type", "protocol", "sample_rate", "format", "fps", "seed", "options", "time"]),
                    JSON | st.sampled_from(["hello", "interrupt", "idle", "float32"]), max_size=5).map(json.dumps),
), max_size=8)


def test_no_message_ends_the_server() -> None:
    """Whatever is sent, after a hello or not, the server closes with a code of its own and serves the next."""
    async def test() -> None:
        async with running(replace(LIMITS, quiet_seconds=0.2, hello_seconds=0.2)) as at:
            loop = asyncio.get_running_loop()

            async def attack(messages: list[str | bytes], greet: bool) -> None:
                try:
                    async with asyncio.timeout(60):
                        code, _ = await closed_with(at.url, *([Hello(RATE).text()] if greet else []), *messages)
                    assert str(code) in published()["close_codes"]
                except UnicodeEncodeError:
                    pass  # text that cannot be sent

            @given(MESSAGES, st.booleans())
            def fuzz(messages: list[str | bytes], greet: bool) -> None:
                asyncio.run_coroutine_threadsafe(attack(messages, greet), loop).result()

            await asyncio.to_thread(fuzz)
            assert_whole((await talk(at.url, pcm(1.0)))[0], 1.0)
            assert figure(at.server, "closed_total", code=str(int(CloseCode.FAILED))) == 0

    asyncio.run(test())


# ---------------------------------------------------------------- health, figures, the end


@in_loop
async def test_metrics_are_on_the_same_port() -> None:
    async with running() as at:
        await talk(at.url, pcm(2.0))
        assert await at.get("/healthz") == (200, "ok\n")
        assert (await at.get("/elsewhere"))[0] == 404
        status, text = await at.get("/metrics")
        assert status == 200
        values = {sample.name: sample.value for family in text_string_to_metric_families(text)
                  for sample in family.samples if set(sample.labels) <= {"code"}}
        assert values["gesticulator_frames_total"] == 120
        assert values["gesticulator_sound_seconds_total"] == pytest.approx(2)
        assert values["gesticulator_streams"] == values["gesticulator_unread_bytes"] == 0
        assert values["gesticulator_waiting_seconds"] == pytest.approx(0, abs=1e-9)
        assert values["gesticulator_closed_total"] == 1
        assert values["gesticulator_compute_seconds_count"] >= 5


@in_loop
async def test_a_server_that_is_told_to_stop_answers_what_it_received() -> None:
    async with running() as at, connect(at.url, Hello(RATE)) as stream:
        await stream.send(pcm(2.0))
        at.server.stop()
        came = [one async for one in stream]
        assert_whole([one for one in came if isinstance(one, Poses)], 2.0)
        # A client that comes back would take it as the end.
        assert not any(isinstance(one, dict) and one["type"] == "done" for one in came)
        with pytest.raises(ConnectionClosed, match="1001"):
            await stream._socket.recv()
        await asyncio.wait_for(at.ended, 5)
        with pytest.raises(OSError, match=r".*"):
            await open_socket(at.url)


# ---------------------------------------------------------------- the client's player


def test_the_player_shows_the_frame_of_the_sound_that_is_heard() -> None:
    def poses(first: int, value: float, count: int = 60) -> Poses:
        turns = np.full((count, 1, 4), value, np.float32)
        return Poses(first, 60.0, turns, np.zeros((count, 3), np.float32), "idle", 0.0)

    player = PosePlayer()
    assert player.pose_at(0.0) is None and player.end == 0.0
    player.add(poses(0, 1.0))
    player.add(poses(60, 2.0))

    def at(time: float) -> float:
        found = player.pose_at(time)
        assert found is not None
        return float(found[0][0, 0])

    assert at(0.5) == 1.0 and player.end == 2.0
    player.add(poses(45, 3.0, 30))  # an interruption at 0.75 s
    assert player.end == 1.25
    assert [at(time) for time in (0.74, 0.75, 1.2, 9.0)] == [1.0, 3.0, 3.0, 3.0]


# ---------------------------------------------------------------- the command


@pytest.mark.parametrize(("arguments", "wrong"), [
    (["--port", "99999"], "port 99999"), (["--host", "no.such.host.invalid"], "no.such.host.invalid"),
    (["--host", "0.0.0.0"], "--token-file"), (["--streams", "0"], "limits.streams"),
    (["--vmc", "nowhere"], "HOST:PORT"),
    (["--bundle", "/no/such/folder"], "is not a bundle"), (["--drain-seconds", "nan"], "limits.drain_seconds"),
    (["--threads", "0"], "--threads")])
def test_what_cannot_be_served_is_told_in_one_line(arguments: list[str], wrong: str,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        COMMAND.main("gesticulator serve", ["--port", "0", *arguments])
    assert ended.value.code == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "listening" not in line]
    assert len(lines) == 1 and wrong in lines[0]


def test_the_token_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parser = Parser()
    COMMAND.arguments(parser)
    file = tmp_path / "token"
    file.write_text("sesame\n")
    assert read_token(parser.parse_args(["--token-file", str(file)])) == "sesame"
    assert read_token(parser.parse_args([])) == ""
    monkeypatch.setenv("GESTICULATOR_TOKEN", "other")
    assert read_token(parser.parse_args(["--host", "0.0.0.0"])) == "other"
