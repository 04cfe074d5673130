"""Balancers and TLS: the printed files, run by the programs themselves before servers, with nothing changed but ports
and the place of the certificate."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from live_double import served
from pipecat_gesticulator import Hello, Poses, ResumingStream, connect
from ports import free_port
from test_serve_process import served as served_process
from websockets.asyncio.client import connect as open_socket
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from data_module.speech.audio import SAMPLE_RATE, load_speech
from gesticulator.serve import server as server_module
from gesticulator.serve.server import ServerAddress
from gesticulator.serve.settings import ServerLimits

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
KINDS = ("nginx", "haproxy", "nginx-tls", "haproxy-tls", "caddy-tls", "nginx-tls haproxy")
"""The last one is TLS before a balancer: two files in a row."""
LIMITS = ServerLimits(drain_seconds=0.5)
GOOD, BAD, OTHER = "127.0.0.3", "127.0.0.2", "127.0.0.4"
"""Addresses of clients, none of them the proxy's, which is 127.0.0.1."""


@dataclass(frozen=True)
class Front:
    """What stands before the servers. port: of streams; secure: by TLS; plain: the port of http beside it, or 0."""

    port: int
    secure: bool = False
    plain: int = 0

    @property
    def stream(self) -> str:
        return f"{'wss' if self.secure else 'ws'}://localhost:{self.port}/stream"

    def get(self, path: str) -> tuple[int, bytes]:
        """The answer to a path that is sent as it stands."""
        kind = http.client.HTTPSConnection if self.secure else http.client.HTTPConnection
        asking = kind("localhost", self.port, timeout=20)
        try:
            asking.request("GET", path)
            answer = asking.getresponse()
            return answer.status, answer.read()
        finally:
            asking.close()


@contextmanager
def started(command: list[str], port: int) -> Iterator[None]:
    """A program that listens on a port."""
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        for _ in range(200):
            if process.poll() is not None:
                raise AssertionError(process.communicate()[1])
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        else:
            process.terminate()
            raise AssertionError(process.communicate(timeout=20)[1])
        yield
    finally:
        process.terminate()
        process.communicate(timeout=20)


def once(text: str, *changes: tuple[str, str]) -> str:
    """The text with each of these replaced, which it holds exactly once."""
    for before, after in changes:
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    return text


def before(text: str, servers: Sequence[int]) -> str:
    """A file with its two servers at these ports."""
    for printed, own in zip(("8771", "8772"), servers, strict=True):
        assert f"127.0.0.1:{printed}" in text
        text = re.sub(rf"(?m)^([^#\n]*)127\.0\.0\.1:{printed}\b", rf"\g<1>127.0.0.1:{own}", text)
    return text


Edit = Callable[[str], str]


def nginx(folder: Path, text: str) -> list[str]:
    """The command that runs nginx with a file, which it finds nothing wrong with."""
    for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"):
        text = text.replace("access_log off;", f"access_log off;\n    {kind}_temp_path {folder}/{kind};", 1)
    file = folder / "nginx.conf"
    file.write_text(text)
    common = ["nginx", "-p", str(folder), "-c", str(file), "-e", "stderr", "-g"]
    checked = subprocess.run([*common, f"pid {folder}/pid;", "-t"], capture_output=True, text=True)
    assert checked.returncode == 0 and "warn" not in checked.stderr, checked.stderr
    return [*common, f"daemon off; master_process off; pid {folder}/pid;"]


def plain_nginx(folder: Path, servers: Sequence[int], edit: Edit) -> tuple[list[str], Front]:
    front = Front(free_port())
    text = once((DEPLOY / "nginx.conf").read_text(), ("listen 8765;", f"listen 127.0.0.1:{front.port};"))
    return nginx(folder, edit(before(text, servers))), front


def tls_nginx(folder: Path, servers: Sequence[int], edit: Edit) -> tuple[list[str], Front]:
    front = Front(free_port(), True, free_port())
    text = once((DEPLOY / "tls" / "nginx.conf").read_text(), ("listen 80;", f"listen 127.0.0.1:{front.plain};"),
                ("listen 443 ssl;", f"listen 127.0.0.1:{front.port} ssl;"))
    text = text.replace("/etc/ssl/gestures.example.org", str(folder))
    return nginx(folder, edit(before(text, servers))), front


def haproxy(folder: Path, text: str) -> list[str]:
    """The command that runs HAProxy with a file, which it finds nothing wrong with."""
    file = folder / "haproxy.cfg"
    file.write_text(text)
    checked = subprocess.run(["haproxy", "-c", "-f", str(file)], capture_output=True, text=True)
    assert checked.returncode == 0 and "WARNING" not in checked.stderr, checked.stderr
    return ["haproxy", "-db", "-f", str(file)]


def plain_haproxy(folder: Path, servers: Sequence[int], edit: Edit) -> tuple[list[str], Front]:
    """With servers that are listed in place of a name's addresses."""
    front = Front(free_port())
    text = once((DEPLOY / "haproxy.cfg").read_text(), ("bind :8765", f"bind 127.0.0.1:{front.port}"))
    text, count = re.subn(
        r"(?m)^ *server-template server 16 server:8765 (.*) resolvers containers init-addr none$",
        lambda found: "\n".join(f"    server s{k} 127.0.0.1:{own} {found[1]}" for k, own in enumerate(servers)), text)
    assert count == 2
    return haproxy(folder, edit(text)), front


def tls_haproxy(folder: Path, servers: Sequence[int], edit: Edit) -> tuple[list[str], Front]:
    front = Front(free_port(), True, free_port())
    text = once((DEPLOY / "tls" / "haproxy.cfg").read_text(), ("bind :80\n", f"bind 127.0.0.1:{front.plain}\n"),
                ("bind :443 ", f"bind 127.0.0.1:{front.port} "),
                ("crt /etc/ssl/gestures.example.org/", f"crt {folder}/"))
    return haproxy(folder, edit(before(text, servers))), front


def tls_caddy(folder: Path, servers: Sequence[int], edit: Edit) -> tuple[list[str], Front]:
    """With this machine's name and certificate."""
    front = Front(free_port(), True, free_port())
    printed = DEPLOY / "tls" / "Caddyfile"
    validated = subprocess.run(["caddy", "validate", "--adapter", "caddyfile", "--config", str(printed)],
                               capture_output=True, text=True)
    assert validated.returncode == 0, validated.stderr
    text = once(printed.read_text(), ("\ngestures.example.org {", f"\nlocalhost:{front.port} {{\n\ttls "
                                      f"{folder}/fullchain.pem {folder}/privkey.pem"))
    (folder / "Caddyfile").write_text(
        f"{{\n\tadmin off\n\thttp_port {front.plain}\n\thttps_port {front.port}\n}}\n{edit(before(text, servers))}")
    return ["caddy", "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")], front


FRONTS = {"nginx": plain_nginx, "haproxy": plain_haproxy, "nginx-tls": tls_nginx, "haproxy-tls": tls_haproxy,
          "caddy-tls": tls_caddy}
DEBIAN = {"nginx": "nginx-light", "haproxy": "haproxy", "caddy": "caddy"}
"""Program -> Debian's package of it."""


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a certificate of localhost, its key, and both in one file."""
    folder = tmp_path_factory.mktemp("certificate")
    whole, key = folder / "fullchain.pem", folder / "privkey.pem"
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "2",
                    "-out", str(whole), "-keyout", str(key)], check=True, capture_output=True)
    (folder / "haproxy.pem").write_bytes(whole.read_bytes() + key.read_bytes())
    return folder


@pytest.fixture
def fronted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
            ) -> Iterator[Callable[..., Front]]:
    """Starts what a kind names before servers at two ports; skips the test where a program is missing."""
    with ExitStack() as opened:
        def start(kind: str, servers: Sequence[int], edit: Edit = str) -> Front:
            programs = re.findall(r"nginx|haproxy|caddy", kind)
            for program in programs:
                if shutil.which(program) is None:
                    pytest.skip(f"{program} is not installed (apt-get install {DEBIAN[program]})")
            if shutil.which("openssl") is None:
                pytest.skip("openssl is not installed (apt-get install openssl)")
            whole = request.getfixturevalue("certificate")
            monkeypatch.setenv("SSL_CERT_FILE", str(whole / "fullchain.pem"))
            monkeypatch.setenv("HOME", str(tmp_path))
            front = Front(0)
            for number, one in enumerate(reversed(kind.split())):  # the last one stands before the servers
                folder = tmp_path / f"{number}-{one}"
                shutil.copytree(whole, folder)
                command, front = FRONTS[one](folder, servers, edit)
                opened.enter_context(started(command, front.port))
                servers = [front.port, free_port()]
            if "haproxy" in programs:
                time.sleep(0.5)  # it looks after its servers first
            return front

        yield start


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def buzz(length: float) -> bytes:
    """Syllables, five a second, of 16 bits at 16 kHz."""
    t = np.arange(int(length * 16000)) / 16000
    return (8000 * np.clip(np.sin(31 * t), 0, 1) * np.sign(np.sin(754 * t))).astype("<i2").tobytes()


async def numbers(url: str, pause: float = 0.0, token: str = "") -> list[int]:
    """The frames that a client gets for two seconds of sound."""
    found: list[int] = []
    async with connect(url, Hello(16000, token=token)) as stream:
        for _ in range(20):
            await stream.send(buzz(0.1))
            await asyncio.sleep(pause / 20)
        await stream.finish()
        async for message in stream:
            if isinstance(message, Poses):
                found += range(message.first, message.first + len(message))
    return found


async def ask(url: str, source: str, token: str, **headers: str) -> dict[str, Any] | int:
    """The answer to a hello from an address: the server's, or the status of HTTP."""
    try:
        async with open_socket(url, local_addr=(source, 0), additional_headers=headers) as ws:
            await ws.send(Hello(16000, token=token).text())
            answer: dict[str, Any] = json.loads(await ws.recv())
            return answer
    except InvalidStatus as refused:
        return refused.response.status_code


def test_streams_stay_with_their_server(kind: str, fronted: Callable[..., Front]) -> None:
    """Half of them with each, and frames without a gap: had a message gone to the other server, it would have refused
    it, since it knows no such stream. One and the same certificate is verified each time."""
    with ExitStack() as opened:
        servers = [opened.enter_context(served(LIMITS, {})) for _ in range(2)]
        front = fronted(kind, [port for _, port in servers])

        async def several() -> list[list[int]]:
            return await asyncio.gather(*(numbers(front.stream, pause=1.0) for _ in range(6)))

        assert asyncio.run(several()) == [list(range(120))] * 6
        assert [server.metrics.numbers["streams_total"] for server, _ in servers] == [3, 3]


def test_connections_that_say_nothing_do_not_keep_others_out(kind: str, fronted: Callable[..., Front]) -> None:
    """Sixty of them, from six addresses: more than two servers have places for streams."""
    with ExitStack() as opened:
        address = ServerAddress(port=0, proxies=("127.0.0.1",))
        servers = [opened.enter_context(served(LIMITS, {}, address=address)) for _ in range(2)]
        front = fronted(kind, [port for _, port in servers])

        async def crowd() -> list[int]:
            silent = []
            for number in range(60):
                with suppress(InvalidHandshake, ConnectionClosed):  # the proxy's own bound
                    silent.append(await open_socket(front.stream, local_addr=(f"127.0.1.{number % 6 + 1}", 0)))
            assert len(silent) > 2 * LIMITS.streams
            found = await numbers(front.stream)
            for ws in silent:
                ws.transport.abort()
            return found

        assert asyncio.run(crowd()) == list(range(120))


def test_limits_of_an_address_are_those_of_the_client(kind: str, fronted: Callable[..., Front]) -> None:
    """A client that guesses tokens is kept out, whatever address it claims; others beside it are served."""
    address = ServerAddress(port=0, token="open sesame", proxies=("127.0.0.1",))
    with served(LIMITS, {}, address=address) as (server, port):
        front = fronted(kind, [port, free_port()])

        async def guess() -> None:
            for _ in range(5):
                answer = await ask(front.stream, BAD, "sesame")
                assert isinstance(answer, dict) and answer["code"] == 4401
            assert server.metrics.coded["refused_total"] == {}
            for headers in ({}, {"X-Forwarded-For": OTHER}, {"X-Forwarded-For": "127.0.0.1"}):
                assert await ask(front.stream, BAD, "open sesame", **headers) == 429
            # By the server, not by the proxy.
            assert server.metrics.coded["refused_total"] == {"429": 3}
            for headers in ({}, {"X-Forwarded-For": BAD}):
                answer = await ask(front.stream, GOOD, "open sesame", **headers)
                assert isinstance(answer, dict) and answer["type"] == "hello"

        asyncio.run(guess())


def test_nothing_but_streams_and_health_is_passed_on(kind: str, fronted: Callable[..., Front]) -> None:
    """Even of a server whose metrics need no token and are at the port of streams."""
    with served(LIMITS, {}) as (_, port):
        front = fronted(kind, [port, free_port()])
        assert Front(port).get("/metrics")[0] == Front(port).get("/readyz")[0] == 200
        for path in ("/metrics", "/metrics?x=1", "//metrics", "/%6detrics", "/metrics/", "/stream/../metrics",
                     "/healthz/../metrics", "/readyz", "/", "/index.html"):
            status, body = front.get(path)
            assert status in (400, 404) and b"gesticulator_" not in body, path
        assert front.get("/healthz") == (200, b"ok\n")
        assert front.get("/stream")[0] in (400, 426)
        if front.plain:
            asking = http.client.HTTPConnection("localhost", front.plain, timeout=20)
            asking.request("GET", "/stream")
            answer = asking.getresponse()
            assert answer.status in (301, 308) and str(answer.getheader("Location")).startswith("https://")


def test_a_certificate_of_another_authority_is_refused(fronted: Callable[..., Front],
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    """So the other tests verify it."""
    with served(LIMITS, {}) as (_, port):
        front = fronted("nginx-tls", [port, free_port()])
        monkeypatch.delenv("SSL_CERT_FILE")
        with pytest.raises(ssl.SSLCertVerificationError):
            asyncio.run(numbers(front.stream))


@pytest.mark.parametrize(("kind", "pings"), [
    *((kind, True) for kind in KINDS), *((kind, False) for kind in KINDS if "caddy" not in kind)])
def test_a_stream_that_is_silent_for_minutes_is_not_cut_off(
        kind: str, pings: bool, fronted: Callable[..., Front], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the proxy's time limit (90 s) and the server's interval of pings (20 s) forty times as short. Without pings,
    the limit holds; Caddy has none for an open WebSocket."""
    monkeypatch.setattr(server_module, "_PING_SECONDS", 0.5 if pings else 1000.0)

    def shorter(text: str) -> str:
        assert "90s" in text or "reverse_proxy" in text
        return text.replace("90s", "2250ms")

    async def silent(url: str) -> list[int]:
        found: list[int] = []
        async with connect(url, Hello(16000)) as stream:
            await stream.send(buzz(1.0))
            await asyncio.sleep(7.0)
            await stream.send(buzz(1.0))
            await stream.finish()
            async for message in stream:
                if isinstance(message, Poses):
                    found += range(message.first, message.first + len(message))
        return found

    with served(LIMITS, {}) as (_, port):
        front = fronted(kind, [port, free_port()], shorter)
        if pings:
            assert asyncio.run(silent(front.stream)) == list(range(120))
        else:
            with pytest.raises(ConnectionClosed):
                asyncio.run(silent(front.stream))


def test_every_time_limit_is_longer_than_what_the_server_needs() -> None:
    """Two pings: the second one is how a client that vanished is noticed."""
    least = 2 * server_module._PING_SECONDS
    found = {}
    for name in ("nginx.conf", "tls/nginx.conf"):
        found[name] = re.findall(r"proxy_(?:read|send)_timeout (\d+)s;", (DEPLOY / name).read_text())
    for name in ("haproxy.cfg", "tls/haproxy.cfg"):
        found[name] = re.findall(r"timeout tunnel (\d+)s", (DEPLOY / name).read_text())
    ingress = yaml.safe_load((DEPLOY / "kubernetes" / "ingress.yaml").read_text())["metadata"]["annotations"]
    found["ingress.yaml"] = [value for name, value in ingress.items() if name.endswith("-timeout")]
    assert [len(one) for one in found.values()] == [2, 2, 1, 1, 2]
    assert all(float(value) > least for values in found.values() for value in values), found


def test_a_client_comes_back_by_way_of_the_balancer(kind: str, fronted: Callable[..., Front]) -> None:
    """Its server stops in mid-stream, and the other one goes on: no frame is missing, and none comes twice."""
    with ExitStack() as opened:
        servers = [opened.enter_context(served(ServerLimits(drain_seconds=0.1), {})) for _ in range(2)]
        front = fronted(kind, [port for _, port in servers])

        async def talk() -> tuple[list[int], int]:
            found: list[int] = []
            backs, lost = 0, asyncio.Event()
            stream = ResumingStream(front.stream, Hello(16000))
            await stream.open()

            async def speak() -> None:
                for number in range(30):
                    await stream.send(buzz(0.1))
                    await asyncio.sleep(0.02)
                    if number == 15:
                        (mine,) = [server for server, _ in servers if server.metrics.numbers["streams"]]
                        (connection,) = mine.connections
                        connection.socket.loop.call_soon_threadsafe(mine.stop)
                        await lost.wait()
                await stream.finish()

            speaking = asyncio.create_task(speak())
            async for message in stream:
                if isinstance(message, Poses):
                    found += range(message.first, message.first + len(message))
                elif message["type"] == "lost":
                    lost.set()
                else:
                    backs += message["type"] == "back"
            await speaking
            return found, backs

        assert asyncio.run(asyncio.wait_for(talk(), 120)) == (list(range(180)), 1)


# ---------------------------------------------------------------------------------------------------- the real server

@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The port of `gesticulator serve`, as the TLS files ask for it."""
    token = tmp_path_factory.mktemp("token") / "token.txt"
    token.write_text("open sesame\n")
    with served_process("--token-file", str(token), "--trusted-proxy", "127.0.0.1", "--metrics-port", "0") as at:
        at.await_line("is ready")
        yield at.port
        at.end()


async def motion(url: str, sound: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    """Rotations, positions and events of a stream of speech, which is sent a fifth of a second at a time."""
    data = (sound * 32767).astype("<i2").tobytes()
    poses: list[Poses] = []
    events: list[Any] = []
    async with connect(url, Hello(SAMPLE_RATE, seed=3, token="open sesame")) as stream:
        for start in range(0, len(data), 6400):
            await stream.send(data[start:start + 6400])
        await stream.finish()
        async for message in stream:
            poses.append(message) if isinstance(message, Poses) else events.append(message)
    assert [one.first for one in poses] == np.cumsum([0, *map(len, poses[:-1])]).tolist()
    return (np.concatenate([one.rotations for one in poses]), np.concatenate([one.root_positions for one in poses]),
            events)


def test_speech_gets_the_same_gestures_through_a_proxy(kind: str, fronted: Callable[..., Front], real: int) -> None:
    """Of the real server, bit for bit; the second server of the file is not there."""
    front = fronted(kind, [real, free_port()])
    sound = load_speech(ROOT / "examples" / "speech.flac").samples[:5 * SAMPLE_RATE]
    direct = asyncio.run(motion(f"ws://127.0.0.1:{real}/stream", sound))
    through = asyncio.run(motion(front.stream, sound))
    np.testing.assert_array_equal(direct[0], through[0])
    np.testing.assert_array_equal(direct[1], through[1])
    assert len(direct[0]) == 300 and direct[2] == through[2]
    turned = np.abs(direct[0][1:] - direct[0][:-1]).max()
    assert turned > 0.01, "it gestures"
