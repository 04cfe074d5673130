"""Training in several processes: the losses of one, from whatever rows each of them has."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch
from ports import free_port
from torch import Tensor, nn
from torch.nn import functional

from data_module.errors import InputError
from data_module.layers import BatchNorm
from data_module.parallel import batch_mean, batch_moments, batch_ratio, draws_along, own_rows, sharing
from gesticulator.training import command as train
from gesticulator.training.distributed import BatchDraws, joined, lead, lead_first
from tests import ranks

STEPS = 4
TINY = ("speech", "contrast", "lexicon", "interpreter", "interpreter_text", "gate", "planner", "reward", "reward_judge",
        "q_network", "advantage", "generator", "style", "style_text")
MOVING = ("reward", "generator")
"""Of the movements' stages those whose losses are others."""


def together(count: int, orders: list[tuple[str, dict[str, Any]]], folder: Path) -> list[str]:
    """What the processes say on standard error that follow these orders; each ends well."""
    file = folder / "orders.json"
    ports = [free_port() for _ in orders]
    file.write_text(json.dumps([(port, name, {key: str(value) if isinstance(value, Path) else value
                                              for key, value in order.items()})
                                for port, (name, order) in zip(ports, orders, strict=True)]))
    common = {**os.environ, "MASTER_ADDR": "127.0.0.1", "WORLD_SIZE": str(count), "LOCAL_WORLD_SIZE": str(count),
              "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    started = [subprocess.Popen([sys.executable, ranks.__file__, str(file)], stderr=subprocess.PIPE, text=True,
                                env={**common, "RANK": str(rank), "LOCAL_RANK": str(rank)}) for rank in range(count)]
    with ThreadPoolExecutor(count) as pool:
        ends = [pool.submit(process.communicate, None, 1500) for process in started]
        while any(end.running() for end in ends) and not any(process.poll() for process in started):
            time.sleep(0.2)
        if any(process.poll() for process in started):
            time.sleep(10)  # to say why; the others of one that failed would wait for it for ever
            for process in started:
                process.kill()
        said = [end.result()[1] for end in ends]
    assert [process.returncode for process in started] == [0] * count, "\n".join(said)
    return said


def gate_command(store: Path, out: Path) -> list[str]:
    """The arguments that train the gate of the tiny preset."""
    return ["--data", str(store), "--out", str(out), "--preset", "tiny", "--threads", "1", "--stage", "gate"]


@pytest.fixture(scope="module")
def two(tiny_store: Path, tiny_bundle: Path, tiny_movement_bundle: Path, tmp_path_factory: pytest.TempPathFactory
        ) -> Path:
    """What two processes left that trained every stage for its first steps, and the gate to its third; and that were
    asked for what cannot be."""
    out = tmp_path_factory.mktemp("two")
    said = together(2, [
        ("first_steps", {"store": tiny_store, "bundle": tiny_bundle, "out": out / "tiny", "steps": STEPS}),
        ("first_steps", {"store": tiny_store, "bundle": tiny_movement_bundle, "out": out / "moving", "steps": STEPS,
                         "only": MOVING}),
        ("first_steps", {"store": tiny_store, "bundle": tiny_bundle, "out": out / "resumed", "steps": 3,
                         "only": ["gate"]}),
        ("codebooks", {"out": out / "codebooks", "steps": 100}),
        ("train", {"arguments": [*gate_command(tiny_store, out / "none"), "--set", "schedules.gate.batch=7"],
                   "code": 2})], out)
    for rank, text in enumerate(said):
        (out / f"said-{rank}").write_text(text)
    return out


def rows(folder: Path, stage: str) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / f"{stage}.jsonl").read_text().splitlines()]


def assert_same_losses(ours: list[dict[str, float]], alone: list[dict[str, float]]) -> None:
    for one, other in zip(ours, alone, strict=True):
        terms = [key for key in one if not key.startswith("val_") and key != "gradient"]
        assert {key: one[key] for key in terms} == pytest.approx({key: other[key] for key in terms}, abs=1e-4, rel=0)
        # A norm of thousands of numbers gathers more of the rounding than any loss does.
        if "gradient" in one:
            assert one["gradient"] == pytest.approx(other["gradient"], abs=1e-4, rel=1e-2)


@pytest.mark.parametrize(("of", "stage"), [*(("tiny", stage) for stage in TINY), *(("moving", s) for s in MOVING)])
def test_every_stage_has_the_losses_of_one_process(two: Path, tiny_bundle: Path, tiny_movement_bundle: Path, of: str,
                                                   stage: str) -> None:
    bundle = tiny_bundle if of == "tiny" else tiny_movement_bundle
    alone = rows(ranks.first_trained(bundle, stage), stage)
    ours = rows(two / of / stage, stage)
    assert len(ours) == STEPS
    assert_same_losses(ours, alone[:STEPS])
    assert (two / of / stage / "weights-0").read_text() == (two / of / stage / "weights-1").read_text()


@pytest.fixture(scope="module")
def codebooks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one process leaves that trains the codebooks."""
    out = tmp_path_factory.mktemp("codebooks")
    ranks.codebooks(out, 100)
    return out


@pytest.mark.parametrize("name", ["lexicon", "codec", "movements"])
def test_codebooks_follow_the_whole_batch_for_a_hundred_steps(two: Path, codebooks: Path, name: str) -> None:
    ours, alone = rows(two / "codebooks" / name, name), rows(codebooks / name, name)
    assert len(ours) == 100 and alone[-1]["loss"] < 0.9 * alone[0]["loss"]
    assert_same_losses(ours, alone)


def test_one_process_goes_on_where_two_stopped(two: Path, tiny_store: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    shutil.copytree(two / "resumed" / "gate", tmp_path / "gate")
    assert len(rows(tmp_path / "gate", "gate")) == 3
    ranks.first_steps(tiny_store, tiny_bundle, tmp_path, only=["gate"])
    alone = ranks.first_trained(tiny_bundle, "gate")
    assert_same_losses(rows(tmp_path / "gate", "gate"), rows(alone, "gate"))


def test_torchrun_goes_on_with_two_processes_where_one_stopped(two: Path, tiny_store: Path, tiny_bundle: Path,
                                                               tmp_path: Path) -> None:
    alone, work = ranks.first_trained(tiny_bundle, "gate"), tmp_path / "command.work"
    shutil.copytree(alone.parent, work, ignore=shutil.ignore_patterns("gate-*"))
    ranks.first_steps(tiny_store, tiny_bundle, tmp_path, steps=3, only=["gate"])
    (tmp_path / "gate").rename(work / alone.name)
    assert len(rows(work / alone.name, "gate")) == 3
    done = subprocess.run([sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node", "2", "-m",
                           "gesticulator", "train", *gate_command(tiny_store, tmp_path / "command")], check=False,
                          env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
                          capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("gate, 40 steps") == 1, "one process speaks"
    assert_same_losses(rows(work / alone.name, "gate"), rows(alone, "gate"))
    assert not list((work / alone.name).glob("*.ckpt")) and not (tmp_path / "command").exists()
    first, second = ((two / f"said-{rank}").read_text() for rank in (0, 1))
    assert first.count("schedules.gate.batch=7") == 1 and "cannot be divided among 2 processes" in first
    assert "gate" not in second


# ---------------------------------------------------------------------------------------------- draws, without a group

def wide(x: Tensor) -> Tensor:
    """The same numbers, laid out in memory as a transposed tensor."""
    return x.transpose(1, 2).contiguous().transpose(1, 2)


def attention(x: Tensor) -> Tensor:
    return functional.scaled_dot_product_attention(x, x, x, dropout_p=0.4)


DRAWS: dict[str, Callable[[Tensor], Tensor]] = {
    "rand": lambda x: torch.rand(len(x), 5), "randn": lambda x: torch.randn(*x.shape),
    "randint": lambda x: torch.randint(7, (len(x), 3)), "randint_low": lambda x: torch.randint(3, 9, (len(x), 3)),
    "rand_like": torch.rand_like, "randn_like": torch.randn_like,
    "rand_like_of_integers": lambda x: torch.rand_like(x.long(), dtype=torch.float32),
    "randint_like": lambda x: torch.randint_like(x, 50), "dropout": lambda x: functional.dropout(x, 0.3),
    "dropout_transposed": lambda x: functional.dropout(wide(x), 0.3), "flattened": lambda x: torch.randn_like(
        x.flatten(0, 1)), "gumbel": lambda x: functional.gumbel_softmax(x, hard=True),
    "categorical": lambda x: torch.distributions.Categorical(logits=x).sample(), "attention": attention,
    "normal": lambda x: torch.empty_like(x).normal_(), "uniform": lambda x: torch.empty_like(x).uniform_(2, 3)}


COMPUTED = {"attention": 1e-6}
"""What is computed of a draw, and by how much it may differ. The sums of a matrix product over 17 numbers about 1 are
taken in an order that depends on the processor and on how many rows there are: a few units of the last of 24 binary
digits, 2e-7 where it was seen. Other noise would differ by a tenth."""


@pytest.mark.parametrize("draw", DRAWS)
@pytest.mark.parametrize("count", [2, 3])
def test_a_row_has_the_noise_that_one_process_would_have_drawn(draw: str, count: int) -> None:
    x = torch.randn(6, 17, 5, generator=torch.Generator().manual_seed(1))

    def drawn(own: Tensor) -> tuple[Tensor, Tensor]:
        torch.manual_seed(4)
        return DRAWS[draw](own), torch.rand(())  # what comes next must be the same too

    whole, after = drawn(x)
    parts = []
    for rank in range(count):
        with sharing(rank, count):
            own = x[own_rows(len(x))]
            with BatchDraws():
                torch.manual_seed(4)
                parts.append(DRAWS[draw](own))
            torch.testing.assert_close(torch.rand(()), after, rtol=0, atol=0)
    torch.testing.assert_close(torch.cat(parts), whole, rtol=0, atol=COMPUTED.get(draw, 0.0))


def test_draws_may_have_their_rows_elsewhere_or_none() -> None:
    torch.manual_seed(4)
    whole, shared = torch.rand(3, 6), torch.rand(4)
    with sharing(1, 2), BatchDraws():
        torch.manual_seed(4)
        with draws_along(1):
            own = torch.rand(3, 3)
        with draws_along(None):
            same = torch.rand(4)
        with pytest.raises(ValueError, match="no rows"):
            torch.rand(())
    assert torch.equal(own, whole[:, 3:]) and torch.equal(same, shared)


# ------------------------------------------------------------------------------------------------------- alone, and not

def test_alone_sums_are_plain_and_a_batch_is_divided_evenly_or_not_at_all() -> None:
    values = torch.tensor([[1.0, 2.0], [5.0, 4.0]])
    assert float(batch_mean(values)) == 3.0 and float(batch_ratio(torch.tensor(6.0), torch.tensor(0.0))) == 6.0
    mean, variance, count = batch_moments(values)
    assert mean.tolist() == [3.0, 3.0] and variance.tolist() == [4.0, 1.0] and count == 2
    assert own_rows(7) == slice(0, 7)
    with sharing(2, 3):
        assert own_rows(6) == slice(4, 6)
        with pytest.raises(InputError, match="a batch of 7: cannot be divided among 3"):
            own_rows(7)
    with joined("cpu") as device:
        assert device == "cpu" and lead(lambda: 3) == lead_first(lambda: 3) == 3


def test_every_batch_norm_of_ours_knows_of_the_whole_batch() -> None:
    torch.manual_seed(0)
    ours, theirs = BatchNorm(4), nn.BatchNorm1d(4)
    x = torch.randn(8, 4, 3) * 2 + 1
    torch.testing.assert_close(ours(x), theirs(x), rtol=0, atol=0)
    for package in ("data_module", "lexicon", "interpreters", "generator", "gesticulator"):
        for file in (Path(ranks.__file__).parents[1] / package).rglob("*.py"):
            assert "nn.BatchNorm" not in file.read_text().replace("class BatchNorm(nn.BatchNorm1d)", ""), file


def test_half_precision_is_for_gpus_and_keeps_the_losses(tiny_store: Path, tiny_bundle: Path,
                                                         tiny_movement_bundle: Path, tmp_path: Path,
                                                         capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        train.main(["--data", str(tiny_store), "--out", str(tmp_path / "b"), "--precision", "bfloat16"])
    assert "is for GPUs" in capsys.readouterr().err
    for number, bundle in enumerate((tiny_bundle, tiny_movement_bundle)):
        out = tmp_path / str(number)
        only = None if bundle is tiny_bundle else list(MOVING)
        ranks.first_steps(tiny_store, bundle, out, steps=2, precision="bfloat16", only=only)
        for file in out.glob("*/*.jsonl"):
            alone = rows(ranks.first_trained(bundle, file.stem), file.stem)
            ours = rows(file.parent, file.stem)
            assert ours[0]["loss"] == pytest.approx(alone[0]["loss"], rel=0.02), file.stem
            assert ours != alone[:2], f"{file.stem}: computed in single precision"
