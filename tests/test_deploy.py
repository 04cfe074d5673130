"""Containers: the files agree with the program, and the container's command gets ready, answers and drains."""

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
from importlib import resources
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from pipecat_gesticulator import Hello, Poses, connect

from gesticulator.live.command import COMMAND as SERVE

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
_LINES = re.sub(r"\\\n", " ", re.sub(r"(?m)^#.*\n", "", (DEPLOY / "Dockerfile").read_text())).splitlines()
INSTRUCTIONS = [(name, " ".join(rest.split())) for name, _, rest in (line.strip().partition(" ") for line in _LINES)]
"""Name and arguments of each instruction of the Dockerfile."""


def last(name: str) -> str:
    """The arguments of the last instruction of that name."""
    return [rest for instruction, rest in INSTRUCTIONS if instruction == name][-1]


def test_compose_accepts_the_file_and_every_argument_is_one_of_the_program() -> None:
    pytest.importorskip("check_jsonschema")
    schema = json.loads((resources.files("check_jsonschema") / "builtin_schemas/vendor/compose-spec.json").read_text())
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    jsonschema.validate(compose, schema)
    deployment, service = yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text())
    pod = deployment["spec"]["template"]["spec"]
    assert service["spec"]["selector"] == deployment["spec"]["selector"]["matchLabels"]
    assert pod["securityContext"]["runAsUser"] == int(last("USER").partition(":")[0]) > 0
    grace = {"compose": int(compose["services"]["server"]["stop_grace_period"].removesuffix("s")),
             "kubernetes": pod["terminationGracePeriodSeconds"] - 5}
    commands = {"compose": compose["services"]["server"]["command"], "kubernetes": pod["containers"][0]["args"],
                "image": json.loads(last("CMD"))}
    for place, (verb, *arguments) in commands.items():
        options: Any = SERVE.parser("gesticulator serve").parse_args(arguments)
        assert verb == "serve" and options.port == 8765 == int(last("EXPOSE"))
        assert grace.get(place, 1000) > 2 * options.drain_seconds


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_the_entry_point_gets_ready_answers_and_drains(tmp_path: Path) -> None:
    """The image's command with its environment, at another port and with a short drain."""
    variables = dict(re.findall(r"([A-Z_]+)=(\S+)", last("ENV")))
    del variables["PATH"]
    variables |= {name: value.replace("/tmp", str(tmp_path)) for name, value in variables.items() if "/tmp" in value}
    command = [sys.executable, "-m", *json.loads(last("ENTRYPOINT"))[2:], *json.loads(last("CMD"))]
    command[command.index("--port") + 1] = "0"
    command[command.index("--drain-seconds") + 1] = "30"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    refused = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert refused.returncode == 2 and "--token-file" in refused.stderr, "not open to everybody by mistake"
    process = subprocess.Popen(command, cwd=tmp_path, text=True, stderr=subprocess.PIPE,
                               env={**environment, "GESTICULATOR_TOKEN": "secret"})
    try:
        assert process.stderr is not None
        listening = re.search(r":(\d+)/stream", process.stderr.readline())
        assert listening is not None
        port = listening.group(1)
        health = [part.replace("8765", port) for part in json.loads(last("HEALTHCHECK").partition("CMD ")[2])]
        health[0] = sys.executable
        assert any("INFO ready" in line for line in iter(process.stderr.readline, ""))
        assert subprocess.run(health, capture_output=True).returncode == 0

        async def talk() -> tuple[int, str]:
            frames, kind, sound = 0, "", np.tile(np.int16([8000, -8000]), 8000).tobytes()
            async with connect(f"ws://127.0.0.1:{port}/stream", Hello(16000, token="secret")) as stream:
                await stream.send(sound * 2)
                process.send_signal(signal.SIGTERM)
                await asyncio.sleep(0.3)
                await stream.send(sound)  # streams that are open go on
                await stream.finish()
                async for message in stream:
                    frames += len(message) if isinstance(message, Poses) else 0
                    kind = "" if isinstance(message, Poses) else message["type"]
            return frames, kind

        assert asyncio.run(talk()) == (180, "done")
        rest = process.communicate(timeout=30)[1]
        assert process.returncode == 0 and rest.splitlines()[-1].endswith("stopped")
    finally:
        process.kill()
