"""The training loop: a run that was stopped and resumed is the run that was not."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gesticulator.fit import Batch, Checkpoint, FitOptions, FitSettings, Task, fit, rate_factor


class Model(nn.Module):
    """Dropout, batch statistics and a sparse table: all the state that a resume can lose."""

    @property
    def weights(self) -> dict[str, float]:
        return {"error": 1.0, "ignored": 0.0}

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.net = nn.Sequential(nn.Linear(3, 16), nn.BatchNorm1d(16), nn.ReLU(), nn.Dropout(0.3), nn.Linear(16, 1))
        self.table = nn.Embedding(10, 1, sparse=True)

    def sparse_parameters(self) -> list[tuple[nn.Parameter, float]]:
        return [(self.table.weight, 0.05)]

    def losses(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        made = self.net(batch["x"]) + self.table(batch["row"])
        return {"error": (made - batch["y"]).pow(2).mean(), "ignored": made.sum() * progress}


def make_batch(rng: np.random.Generator) -> Batch:
    x = torch.as_tensor(rng.normal(size=(16, 3)), dtype=torch.float32)
    return {"x": x, "y": x[:, :1] * 2 + 1, "row": torch.as_tensor(rng.integers(10, size=16))}


SETTINGS = FitSettings(steps=30, batch=16, rate=1e-2, schedule="cosine")


def run(folder: Path, stops: tuple[int | None, ...] = (None,)) -> Model:
    folder.mkdir(exist_ok=True)
    for stop in stops:
        model = Model()  # as after a kill: nothing in memory survives
        fit("stage", model, Task(make_batch, validate=lambda: {"figure": 1.0}), SETTINGS, folder,
            FitOptions(seed=3, progress=False, checkpoint_seconds=0.0, stop_after=stop))
    return model


@pytest.mark.parametrize("stops", [(7, None), (1, 2, 29, None), (0, 15, 15, None)])
def test_stopped_and_resumed_is_bit_for_bit_unbroken(tmp_path: Path, stops: tuple[int | None, ...]) -> None:
    whole, broken = run(tmp_path / "a"), run(tmp_path / "b", stops)
    for (name, a), b in zip(whole.state_dict().items(), broken.state_dict().values(), strict=True):
        assert torch.equal(a, b), name
    assert (tmp_path / "a/stage.jsonl").read_text() == (tmp_path / "b/stage.jsonl").read_text()


def test_a_log_line_cut_short_by_a_kill_is_dropped(tmp_path: Path) -> None:
    run(tmp_path / "a", (7,))
    log = tmp_path / "a/stage.jsonl"
    log.write_text(log.read_text() + '{"step": 7, "lo')
    run(tmp_path / "a")
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(30))
    assert {"loss", "error", "ignored", "gradient", "rate"} <= set(rows[0]) and "val_figure" in rows[-1]


def test_it_learns_and_unweighted_terms_are_logged_but_not_followed(tmp_path: Path) -> None:
    run(tmp_path / "a")
    rows = [json.loads(line) for line in (tmp_path / "a/stage.jsonl").read_text().splitlines()]
    assert rows[-1]["loss"] < 0.5 * rows[0]["loss"]
    assert rows[5]["loss"] == pytest.approx(rows[5]["error"], rel=1e-4)


def test_another_seed_is_another_run(tmp_path: Path) -> None:
    one = run(tmp_path / "a")
    two = Model()
    (tmp_path / "b").mkdir()
    fit("stage", two, Task(make_batch), SETTINGS, tmp_path / "b", FitOptions(seed=4, progress=False))
    assert not torch.equal(one.net[0].weight, two.net[0].weight)


def test_a_loss_that_is_no_number_stops_the_run_and_says_which(tmp_path: Path) -> None:
    model = Model()

    def losses(batch: Batch, progress: float) -> dict[str, Tensor]:
        terms = model.losses(batch, progress)
        return {**terms, "error": terms["error"] * (float("nan") if progress > 0.2 else 1.0)}

    with pytest.raises(FloatingPointError, match="error"):
        fit("stage", model, Task(make_batch, losses), SETTINGS, tmp_path, FitOptions(seed=0, progress=False))


def test_rate_schedule() -> None:
    cosine = FitSettings(steps=1000, batch=1, schedule="cosine")
    factors = [rate_factor(cosine, s) for s in range(1000)]
    assert factors[0] == pytest.approx(1 / 20) and max(factors) == pytest.approx(1)
    assert factors[-1] == pytest.approx(0.01, abs=1e-3)
    assert all(a >= b for a, b in pairwise(factors[20:]))
    assert rate_factor(FitSettings(steps=10, batch=1), 9) == 1.0


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"not a checkpoint", None])
def test_a_damaged_checkpoint_begins_the_stage_anew(tmp_path: Path, damage: bytes | None) -> None:
    whole = run(tmp_path / "a")
    run(tmp_path / "b", (7,))
    file = tmp_path / "b" / "stage.ckpt"
    data = file.read_bytes()
    file.write_bytes(data[:len(data) // 2] if damage is None else damage)
    again = run(tmp_path / "b")
    for (name, a), b in zip(whole.state_dict().items(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b), name


def test_a_checkpoint_of_another_model_leaves_the_model_as_it_was(tmp_path: Path) -> None:
    file, model = tmp_path / "stage.ckpt", Model()
    optimiser = torch.optim.Adam(model.net.parameters())
    Checkpoint(file).save(5, model, [])  # the model fits, the optimisers do not
    with torch.no_grad():
        model.net[0].bias.fill_(7.0)
    assert Checkpoint(file).load(model, [optimiser]) == 0
    assert (model.net[0].bias == 7.0).all()
