"""A client that comes back to another worker than the one that has its stream is passed on to it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from live_double import opener
from pipecat_gesticulator import Hello, Poses, connect_resuming
from test_resume import LIMITS, assert_whole, pcm, run, spoken
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import ConnectionClosed

from data_module.speech.audio import SAMPLE_RATE
from gesticulator.serve.relay import CAN_RELAY, inner_socket, worker_of
from gesticulator.serve.server import LiveServer, ServerAddress
from gesticulator.serve.settings import ServerLimits

pytestmark = pytest.mark.skipif(not CAN_RELAY,
                                reason="no Unix sockets, as on Windows: clients replay their sound there")


class Workers:
    """Two workers, and one port whose connections go to one of them after the other."""

    def __init__(self, servers: list[LiveServer], ports: list[int]) -> None:
        self.servers, self.ports = servers, ports
        self.port = 0
        self.visits: list[int] = []
        """The worker of each connection."""
        self.only: int | None = None
        """The one worker that takes connections, or None for both."""
        self._open: set[asyncio.StreamWriter] = set()

    def break_connections(self) -> None:
        for writer in list(self._open):
            writer.transport.abort()

    def sum(self, name: str) -> float:
        return sum(server.metrics.numbers[name] for server in self.servers)

    async def take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        number = len(self.visits) % 2 if self.only is None else self.only
        self.visits.append(number)
        with suppress(OSError):
            theirs, ours = await asyncio.open_connection("127.0.0.1", self.ports[number])
            self._open |= {writer, ours}
            await asyncio.gather(_pump(reader, ours), _pump(theirs, writer))
        self._open -= {writer}
        writer.close()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    writer.close()


@asynccontextmanager
async def workers(folder: Path, limits: ServerLimits = LIMITS, token: str = "") -> AsyncIterator[Workers]:
    async with AsyncExitStack() as opened:
        servers, ports, ended = [], [], []
        for number in range(2):
            address = ServerAddress(port=0, token=token)
            listening = opened.enter_context(address.listen())
            servers.append(LiveServer(address, limits, opener(limits), folder=folder, worker=number))
            ports.append(listening.getsockname()[1])
            ended.append(asyncio.create_task(servers[-1].run(listening)))
        both = Workers(servers, ports)
        front = await asyncio.start_server(both.take, "127.0.0.1", 0)
        both.port = front.sockets[0].getsockname()[1]
        while not all(inner_socket(folder, number).exists() for number in range(2)):
            await asyncio.sleep(0.01)
        try:
            yield both
        finally:
            front.close()
            both.break_connections()
            for server in servers:
                server.stop()
                server.stop()
            await asyncio.gather(*ended)


@pytest.mark.parametrize("breaks", [1, 6])
def test_every_session_goes_on_whichever_worker_is_reached(tmp_path: Path, breaks: int) -> None:
    """Where clients would replay what the other worker has, frames would come from another session."""
    async def test() -> None:
        async with workers(tmp_path) as both, \
                connect_resuming(f"ws://127.0.0.1:{both.port}/stream", Hello(SAMPLE_RATE)) as stream:
            poses, events = await spoken(stream, 12.0, breaks, both.break_connections)
            assert_whole(poses, 12.0)
            backs = [event["resumed"] for event in events if event["type"] == "back"]
            assert backs and all(backs)
            assert {one.source for one in poses} == {0}
            assert set(both.visits) == {0, 1}
            assert 1 <= both.servers[1].metrics.numbers["relayed_total"] <= both.visits.count(1)
            assert both.servers[0].metrics.numbers["resumed_total"] >= len(backs)
            assert both.sum("streams_total") == 1
        assert both.sum("streams") == both.sum("parked") == both.sum("guests") == 0

    run(test)


def test_a_client_that_takes_its_leave_ends_its_stream(tmp_path: Path) -> None:
    """Its close frame reaches the other worker, which keeps nothing for it."""
    async def test() -> None:
        async with workers(tmp_path) as both, \
                connect_resuming(f"ws://127.0.0.1:{both.port}/stream", Hello(SAMPLE_RATE)) as stream:
            await stream.send(pcm(1.0))
            both.only = 1
            both.break_connections()
            async for message in stream:
                if isinstance(message, dict) and message["type"] == "back":
                    break
            assert both.sum("streams") == 1 and len(both.servers[1].relayed) == 1
            await stream.close()
            async with asyncio.timeout(20):
                while both.sum("streams") or both.servers[1].relayed:
                    await asyncio.sleep(0.01)
            assert set(both.servers[0].metrics.coded["closed_total"]) == {"1000"}

    run(test)


def test_what_the_other_worker_says_at_the_end_reaches_the_client(tmp_path: Path) -> None:
    """Its code, and the error before it."""
    async def test() -> None:
        async with workers(tmp_path) as both:
            first = await open_socket(f"ws://127.0.0.1:{both.ports[0]}/stream")
            await first.send(json.dumps({**json.loads(Hello(SAMPLE_RATE).text()), "resumable": True}))
            session = json.loads(await first.recv())["session"]
            assert worker_of(session) == 0
            first.transport.abort()
            again = await come_back(both.ports[1], session)
            assert json.loads(await again.recv())["resumed"] is True
            await again.send(b"odd")  # half a sample
            assert json.loads(await again.recv())["code"] == 4400
            with pytest.raises(ConnectionClosed):
                await again.recv()
            assert again.close_code == 4400

    run(test)


async def come_back(port: int, session: str, token: str = "") -> Any:
    """A connection with a hello that asks for a session."""
    ws = await open_socket(f"ws://127.0.0.1:{port}/stream")
    await ws.send(json.dumps({**json.loads(Hello(SAMPLE_RATE, token=token).text()), "resumable": True,
                              "resume": {"session": session, "messages": 0}}))
    return ws


@pytest.mark.parametrize("session", ["0-lost", "7-of-no-worker", "999-x", "../0-x", "0", ""])
def test_a_session_that_no_worker_has_is_a_new_stream_here(tmp_path: Path, session: str) -> None:
    async def test() -> None:
        async with workers(tmp_path) as both:
            ws = await come_back(both.ports[1], session)
            assert json.loads(await ws.recv())["resumed"] is False
            assert [server.metrics.numbers["streams"] for server in both.servers] == [0, 1]
            assert both.sum("relayed_total") == 0
            await ws.close()

    run(test)


def test_a_full_worker_takes_no_stranger_from_another_one(tmp_path: Path) -> None:
    """Whose session is gone gets a new stream where the client is, though the worker that had it has no room."""
    async def test() -> None:
        async with workers(tmp_path, replace(LIMITS, streams=1)) as both:
            full = await open_socket(f"ws://127.0.0.1:{both.ports[0]}/stream")
            await full.send(Hello(SAMPLE_RATE).text())
            assert json.loads(await full.recv())["type"] == "hello"
            ws = await come_back(both.ports[1], "0-lost")
            assert json.loads(await ws.recv())["resumed"] is False
            assert [server.metrics.numbers["streams"] for server in both.servers] == [1, 1]
            await ws.close()
            await full.close()

    run(test)


def test_a_wrong_token_is_passed_on_to_no_worker(tmp_path: Path) -> None:
    async def test() -> None:
        async with workers(tmp_path, token="open sesame") as both:
            ws = await come_back(both.ports[1], "0-guessed", "sesame")
            assert json.loads(await ws.recv())["code"] == 4401
            assert [server.metrics.numbers["wrong_tokens_total"] for server in both.servers] == [0, 1]

    run(test)


def test_a_worker_that_stops_ends_what_it_passed_on_after_its_stream(tmp_path: Path) -> None:
    """Both are told to stop: the client gets what it sent answered."""
    async def test() -> None:
        async with workers(tmp_path) as both, \
                connect_resuming(f"ws://127.0.0.1:{both.port}/stream", Hello(SAMPLE_RATE), patience=0.1) as stream:
            await stream.send(pcm(1.0))
            both.only = 1
            both.break_connections()
            poses: list[Poses] = []

            async def talk() -> None:
                async for message in stream:
                    if isinstance(message, Poses):
                        poses.append(message)
                    elif message["type"] == "back":
                        await stream.send(pcm(4.0))
                        for server in both.servers:
                            server.stop()

            with suppress(ConnectionError):  # the server does not come back
                await talk()
            numbers = [number for one in poses for number in range(one.first, one.first + len(one))]
            assert numbers == list(range(300))

    run(test)
