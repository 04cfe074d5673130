"""The training loop: a run that was stopped and resumed is the run that was not."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise, repeat
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from gesticulator.training.fit import Batch, FitOptions, FitSettings, Task, fit, rate_factor


class Model(nn.Module):
    """Dropout, batch statistics and a sparse table: all the state that a resume can lose."""

    @property
    def weights(self) -> dict[str, float]:
        return {"error": 1.0, "ignored": 0.0}

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.net = nn.Sequential(nn.Linear(3, 16), nn.BatchNorm1d(16), nn.ReLU(), nn.Dropout(0.3), nn.Linear(16, 1))
        self.table = nn.Embedding(10, 1)

    def sparse_parameters(self) -> list[tuple[nn.Parameter, float]]:
        return [(self.table.weight, 0.05)]

    def losses(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        made = self.net(batch["x"]) + self.table(batch["row"])
        return {"error": (made - batch["y"]).pow(2).mean(), "ignored": made.sum() * progress}


def check_same(one: Model, other: Model) -> None:
    for (name, a), b in zip(one.state_dict().items(), other.state_dict().values(), strict=True):
        assert torch.equal(a, b), name


def make_batch(rng: np.random.Generator, size: int) -> Batch:
    x = torch.as_tensor(rng.normal(size=(size, 3)), dtype=torch.float32)
    return {"x": x, "y": x[:, :1] * 2 + 1, "row": torch.as_tensor(rng.integers(9, size=size))}


SETTINGS = FitSettings(steps=30, batch=16, rate=1e-2, schedule="cosine")


class Killed(Exception):
    """As a kill of the process would end it."""


def killed_at(stop: int | None) -> Callable[[np.random.Generator, int], Batch]:
    """`make_batch` of a process that is killed after `stop` more steps."""
    steps = iter(range(stop)) if stop is not None else repeat(0)

    def batch(rng: np.random.Generator, size: int) -> Batch:
        if next(steps, None) is None:
            raise Killed
        return make_batch(rng, size)

    return batch


def run(folder: Path, stops: tuple[int | None, ...] = (None,)) -> Model:
    folder.mkdir(exist_ok=True)
    for stop in stops:
        model = Model()  # as after a kill: nothing in memory survives
        task = Task(killed_at(stop), validate=lambda: {"figure": 1.0})
        with suppress(Killed):
            fit("stage", model, task, SETTINGS, folder, FitOptions(seed=3, progress=False, checkpoint_seconds=-1.0))
    return model


@pytest.mark.parametrize("stops", [(7, None), (1, 1, 27, None), (0, 15, 0, None)])
def test_stopped_and_resumed_is_bit_for_bit_unbroken(tmp_path: Path, stops: tuple[int | None, ...]) -> None:
    whole, broken = run(tmp_path / "a"), run(tmp_path / "b", stops)
    check_same(whole, broken)
    assert (tmp_path / "a/stage.jsonl").read_text() == (tmp_path / "b/stage.jsonl").read_text()


def test_it_learns_and_unweighted_terms_are_logged_but_not_followed(tmp_path: Path) -> None:
    model = run(tmp_path / "a")
    moved = model.table.weight != Model().table.weight
    assert moved[:9].all() and not moved[9], "a code of no batch stays"
    rows = [json.loads(line) for line in (tmp_path / "a/stage.jsonl").read_text().splitlines()]
    assert rows[-1]["loss"] < 0.5 * rows[0]["loss"]
    assert rows[5]["loss"] == pytest.approx(rows[5]["error"], rel=1e-4)


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
    # A quarter, half and three quarters of the way down: 0.01 + 0.99 (1 + cos(pi s)) / 2.
    assert [factors[20 + 245 * k] for k in (1, 2, 3)] == pytest.approx([0.855018, 0.505, 0.154982], abs=1e-6)
    assert rate_factor(FitSettings(steps=10, batch=1), 9) == 1.0


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"not a checkpoint", None])
def test_a_damaged_checkpoint_begins_the_stage_anew(tmp_path: Path, damage: bytes | None) -> None:
    whole = run(tmp_path / "a")
    run(tmp_path / "b", (7,))
    file = tmp_path / "b" / "stage.ckpt"
    data = file.read_bytes()
    file.write_bytes(data[:len(data) // 2] if damage is None else damage)
    again = run(tmp_path / "b")
    check_same(whole, again)


# ------------------------------------------------------------------------------------------------------ stopping early

def figure_of(model: Model) -> dict[str, float]:
    """How far the last bias is from where it stands at step 9 or so: less and less, then more and more."""
    return {"away": abs(float(model.net[4].bias.detach()) - 0.06), "other": -1.0}


def watched(folder: Path, patience: int, stops: tuple[int | None, ...] = (None,)) -> tuple[Model, dict[str, float]]:
    folder.mkdir(exist_ok=True)
    settings, figures = replace(SETTINGS, schedule="constant", validations=30, patience=patience), dict[str, float]()
    for stop in stops:
        model = Model()
        with torch.no_grad():
            model.net[4].bias.zero_()
        task = Task(killed_at(stop), validate=partial(figure_of, model), watch="away")
        with suppress(Killed):
            figures = fit("stage", model, task, settings, folder,
                          FitOptions(seed=3, progress=False, checkpoint_seconds=-1.0))
    return model, figures


def logged(folder: Path) -> list[float]:
    return [json.loads(line)["val_away"] for line in (folder / "stage.jsonl").read_text().splitlines()]


def test_the_best_weights_are_kept_and_training_stops_when_patience_ends(tmp_path: Path) -> None:
    watched(tmp_path / "whole", 0)
    every = logged(tmp_path / "whole")
    best = int(np.argmin(every))
    assert 2 < best < 24, "the known answer needs a figure that falls and rises again"
    model, figures = watched(tmp_path / "a", 4)
    assert logged(tmp_path / "a") == every[:best + 5]
    assert figures == {"away": figure_of(model)["away"], "other": -1.0, "best_step": best + 1}
    assert figures["away"] == pytest.approx(min(every), abs=1e-6)


def test_without_patience_or_a_figure_to_watch_the_last_weights_are_kept(tmp_path: Path) -> None:
    model, figures = watched(tmp_path / "a", 0)
    assert len(logged(tmp_path / "a")) == 30 and "best_step" not in figures
    assert figures["away"] == figure_of(model)["away"] > min(logged(tmp_path / "a"))


@pytest.mark.parametrize("stops", [(3, None), (9, 3, None), (14, 0, None)])
def test_stopping_early_is_the_same_when_it_was_resumed(tmp_path: Path, stops: tuple[int | None, ...]) -> None:
    whole, figures = watched(tmp_path / "a", 4)
    broken, again = watched(tmp_path / "b", 4, stops)
    assert again == figures
    check_same(whole, broken)
    assert (tmp_path / "a/stage.jsonl").read_text() == (tmp_path / "b/stage.jsonl").read_text()
