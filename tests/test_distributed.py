"""Training in several processes started by torchrun: gradients of the whole batch, and the real command."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import ranks
import torch

from gesticulator.cli import main
from gesticulator.training.fit import Batch, Task, generator_for

SHORT = {"lexicon.steps": 20, "interpreter.steps": 4, "generator.steps": 6, "style.steps": 6}
NONE = ("gate", "planner", "reward", "cql", "cql_literal", "interpreter_text")


def torchrun(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Two processes of one command, each with one thread."""
    return subprocess.run([sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2",
                           *arguments], check=False, capture_output=True, text=True, timeout=600,
                          env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)})


def test_two_processes_have_the_gradients_of_the_whole_batch(tmp_path: Path) -> None:
    done = torchrun(str(Path(ranks.__file__)), str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert [(tmp_path / f"turn-{number}").read_text() for number in (0, 1)] == ["[]", "['turn-0']"], "one after another"
    steps = iter(range(ranks.STEPS))

    def both(rng: np.random.Generator, size: int) -> Batch:
        """The rows that the two processes draw."""
        step = next(steps)
        parts = [ranks.make_batch(generator_for(ranks.SEED, step, number), size // 2) for number in (0, 1)]
        return {key: torch.cat([part[key] for part in parts]) for key in parts[0]}

    alone = ranks.trained(tmp_path / "one", Task(both)).state_dict()
    two = [torch.load(tmp_path / f"weights-{number}.pt") for number in (0, 1)]
    for key, value in alone.items():
        torch.testing.assert_close(two[0][key], value, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(two[1][key], two[0][key], rtol=1e-6, atol=1e-6)


def test_torchrun_trains_stages_once_and_resumes(tiny_store: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    settings = [*(f"schedules.{name}={steps}" for name, steps in SHORT.items()),
                *(f"schedules.{stage}.steps=0" for stage in NONE)]
    command = ["-m", "gesticulator", "train", "--data", str(tiny_store), "--out", str(out), "--preset", "tiny",
               "--threads", "1", "--set", "front_end.name=mel", "--set", "text.encoder=",
               *(part for setting in settings for part in ("--set", setting))]
    done = torchrun(*command)
    assert done.returncode == 0, done.stderr
    work = out.with_name("bundle.work")
    for stage in ("lexicon", "generator", "style"):
        assert done.stderr.count(f": {stage}, {SHORT[f'{stage}.steps']} steps") == 1, "one process prints"
        (log,) = work.glob(f"{stage}-*/{stage}.jsonl")
        assert len(log.read_text().splitlines()) == SHORT[f"{stage}.steps"]
    assert not list(work.glob("*/*.ckpt")) and out.is_dir()
    assert main(command[2:]) == 0, "a single process uses what two have trained"
    assert len(list(work.glob("generator-*"))) == 1
