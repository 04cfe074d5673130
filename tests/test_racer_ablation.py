"""The ablation of RACER: what a row is, how each kind learns, and the whole command on networks of no size."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from data_module.errors import InputError
from data_module.store import Store
from eval import policies
from eval import racer_ablation as ablations
from eval.metrics import gesture_features
from eval.racer_ablation import OURS, ROWS, Bench
from gesticulator import bundle as bundles
from gesticulator.config import LITERAL, preset, to_dict, with_settings
from interpreters.actor_critic import ActorCritic
from interpreters.cql import ConservativeQ, QNetwork
from interpreters.episodes import BEHAVIOURS, Episode, Episodes

PRESET = ("cql.width=8", "cql.layers=3", "cql.heads=2", "cql.decisions=6", "cql.copy_every=2",
          "schedules.cql.steps=4", "schedules.cql.batch=4")


# ------------------------------------------------------------------------------------------------------------- rows

@pytest.mark.parametrize("name", ["default", "tiny"])
def test_every_row_is_another(name: str) -> None:
    base = preset(name)
    seen: dict[str, list[str]] = {}
    for row_name, row in ROWS.items():
        config = with_settings(base, row.settings)
        assert row_name == OURS or config != base or row.training != "offline" or "alpha" in row_name
        seen.setdefault(json.dumps([to_dict(config), row.training]), []).append(row_name)
        assert len(set(row.settings)) == len(row.settings)
    assert [own for own in seen.values() if len(own) > 1] == [
        ["cql", f"alpha={base.cql.conservative:g}"]], "one alpha is ours already"
    assert {row.training for row in ROWS.values()} == set(ablations.TRAININGS)


def test_rows_are_what_the_paper_says() -> None:
    base = preset("default")
    of = {name: with_settings(base, row.settings) for name, row in ROWS.items()}
    assert of["supervised"].cql == dataclasses.replace(base.cql, temporal=0.0)
    assert of["dqn"].cql == dataclasses.replace(base.cql, conservative=0.0, warm_up=0.0)
    assert of["distance"].episodes == dataclasses.replace(base.episodes, reward="distance")
    assert of["literal"].episodes.shares == LITERAL.shares
    assert of["alpha=10"].cql.conservative == 10.0 and isinstance(of["alpha=10"].cql.conservative, float)
    assert with_settings(base, ()) == base
    steps = {config.schedules.cql.steps for config in of.values()}
    assert len(steps) == 1, "all rows train equally long"
    assert set(ablations.PAPER) <= set(ROWS) and "return" not in ablations.PAPER["distance"]


def test_the_preset_of_the_command_fits_every_row() -> None:
    for row in ROWS.values():
        config = with_settings(preset("default"), (*ablations.PRESET, *row.settings))
        assert (config.cql.width, config.cql.layers, config.schedules.cql.batch) == (64, 4, 32)


def test_an_alpha_that_is_ours_is_run_once() -> None:
    same = ablations.twins(preset("default"))
    assert {name for name, first in same.items() if name != first} == {"alpha=1"} and same["alpha=1"] == OURS
    other = with_settings(preset("default"), ["cql.conservative=4"])
    assert ablations.twins(other)["alpha=4"] == OURS and ablations.twins(other)["alpha=1"] == "alpha=1"


# ---------------------------------------------------------------------------------------------------------- rewards

def test_another_reward_is_brought_to_the_scale_of_the_data() -> None:
    rng = np.random.default_rng(0)
    count, size = 40, 5
    actions = rng.integers(size, size=count)
    silent, terminal = np.zeros(count, bool), np.zeros(count, bool)
    one = Episode(0, 0, np.arange(count), actions, np.zeros(count, np.int8), np.zeros(count, np.float32),
                  rng.normal(0.6, 0.1, count).astype(np.float32), silent, terminal)
    table = torch.as_tensor(-rng.random((count, size)) * 30, dtype=torch.float32)
    scaled = ablations.rescaled(table, Episodes([one]))
    own = scaled.numpy()[np.arange(count), actions][1:]
    assert own.mean() == pytest.approx(one.reward[1:].mean(), abs=1e-5)
    assert own.std() == pytest.approx(one.reward[1:].std(), abs=1e-5)
    assert torch.equal(scaled.argsort(1), table.argsort(1)), "no order changes"
    known = ablations.Known(scaled)
    assert torch.equal(known.sequence_every(torch.zeros(3), torch.tensor([4, 5, 6])), scaled[4:7])
    assert torch.equal(known.every(torch.zeros(1, 2), torch.tensor([[2, 3, 9]]), torch.ones(1, 3)), scaled[9:10])


# -------------------------------------------------------------------------------------------------------- intervals

def test_an_interval_over_seeds_and_clips() -> None:
    nan = math.nan
    got = ablations.interval_over([[1.0, 3.0], [3.0, 5.0]], [1, 3])
    assert got.mean == pytest.approx((1 + 9 + 3 + 15) / 8) and got.clips == 2
    assert got.low == pytest.approx(1.0) and got.high == pytest.approx(5.0), "the worst and the best of both"
    assert ablations.interval_over([[2.0, 2.0, nan]], [1, 1, 1]).to_dict() == {
        "mean": 2.0, "low": 2.0, "high": 2.0, "clips": 2}
    assert math.isnan(ablations.interval_over([[nan], [nan]], [1]).mean)
    rng = np.random.default_rng(1)
    clips_alone = rng.normal(size=(1, 20))
    with_seeds = np.concatenate([clips_alone, clips_alone + 3.0, clips_alone - 3.0])
    wide, narrow = (ablations.interval_over(v, np.ones(20)) for v in (with_seeds, clips_alone))
    assert wide.high - wide.low > 2 * (narrow.high - narrow.low), "seeds that differ widen it"


def cell(row: str, seed: int, value: float) -> dict:
    figures = dict.fromkeys(ablations.COLUMNS, value)
    return {"row": row, "seed": seed, "steps": 3, "seconds": 1.0,
            "recordings": [{"name": "a", "decisions": 1, **figures},
                           {"name": "b", "decisions": 3, **dict.fromkeys(ablations.COLUMNS, value + 4)}]}


def test_the_table_pairs_seeds_and_marks_what_is_undecided() -> None:
    cells = {"supervised": {s: cell("supervised", s, s) for s in (1, 2)},
             OURS: {s: cell(OURS, s, s + 2.0) for s in (1, 2, 3)},
             "alpha=0.1": {s: cell(OURS, s, s + 2.0) for s in (1, 2, 3)}}
    result = ablations.tabled(cells)
    assert list(result["differences"]) == ["cql - supervised"], "not with itself, nor under another name"
    for key, column in ablations.COLUMNS.items():
        assert result["rows"][OURS]["figures"][key]["mean"] == (7.0 if column.by_blocks else 6.0)
        apart = result["differences"]["cql - supervised"]["figures"][key]
        assert (apart["low"], apart["mean"], apart["high"]) == (2.0, 2.0, 2.0)
    assert result["rows"][OURS]["decided"] and not result["rows"]["supervised"]["decided"]
    text = ablations.markdown({**result, "motion": {}, "settings": {"steps": 3, "copies": 1, "seeds": 3},
                               "store": {"test_recordings": 2, "decisions": 4}})
    assert "| supervised (undecided: 2 of 3 seeds) |" in text and "| alpha=0.1 = cql |" in text
    assert "| cql | 6.00 [" in text and "| 9.34 |" in text


# --------------------------------------------------------------------------------------------------------- learning

@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ablation")


@pytest.fixture(scope="module")
def bench(tiny_store: Path, tiny_bundle: Path, work: Path) -> Bench:
    return Bench.of(Store.open(tiny_store), bundles.load(tiny_bundle), work, PRESET, 2, progress=False)


def test_a_larger_choice_of_epsilon_tries_more() -> None:
    said = [ablations.epsilon_at(step, 100) for step in range(100)]
    assert said[0] == 1.0 and said[50:] == [ablations.LEAST_EPSILON] * 50 and said == sorted(said, reverse=True)


def test_all_rows_of_a_seed_begin_alike(bench: Bench) -> None:
    first = [weights(ablations.untrained(bench, name, 1)) for name in ("cql", "dqn", "literal")]
    for other in first[1:]:
        assert torch.equal(first[0], other)
    assert not torch.equal(first[0], weights(ablations.untrained(bench, "cql", 2)))


def weights(module: torch.nn.Module) -> Tensor:
    return torch.cat([parameter.detach().flatten() for parameter in module.parameters()])


def test_what_acts_keeps_to_the_silent_mask(bench: Bench) -> None:
    network = ablations.untrained(bench, "cql", 1).eval()
    actor = ActorCritic(ablations.untrained(bench, "cql", 1))
    blocks = torch.as_tensor(np.flatnonzero(~bench.corpus.silent)[:64])[:, None]
    for quiet in (False, True):
        seen = {"block": blocks, "previous": torch.zeros(len(blocks), 1, dtype=torch.int64),
                "silent": torch.full((len(blocks), 1), quiet), "speaker": torch.zeros(len(blocks), dtype=torch.int64)}
        rng = np.random.default_rng(0)
        for choose in (ablations.epsilon_greedy(network, bench.corpus, 1.0, rng),
                       ablations.epsilon_greedy(network, bench.corpus, 0.0, rng),
                       ablations.drawn(actor, bench.corpus, rng)):
            with torch.no_grad():
                chosen = choose(seen)
            assert chosen.shape == (len(blocks),)
            assert not quiet or np.isin(chosen.numpy(), bench.bundle.silent).all()
        with torch.no_grad():
            anything = ablations.epsilon_greedy(network, bench.corpus, 1.0, rng)(seen)
            best = ablations.epsilon_greedy(network, bench.corpus, 0.0, rng)(seen)
            values = ablations.latest(network, bench.corpus, seen)
        assert torch.equal(best, network.choose(values, seen["silent"][:, 0]))
        assert quiet or len(anything.unique()) > len(best.unique())


def test_each_kind_learns_from_its_own(bench: Bench) -> None:
    def batch_of(name: str) -> dict[str, Tensor]:
        row, config = ROWS[name], bench.config(name)
        learner = ablations.TRAININGS[row.training](bench, config, ablations.untrained(bench, name, 1), 1)
        assert isinstance(learner.model, ActorCritic if row.training == "actor-critic" else ConservativeQ)
        learner.before_step(0)
        got = learner.make_batch(np.random.default_rng(5))
        again = learner.make_batch(np.random.default_rng(5))
        assert all(torch.equal(value, again[key]) for key, value in got.items())
        return got

    drawn = {name: batch_of(name) for name in ("cql", "literal", "distance", "dqn", "actor-critic")}
    assert (drawn["literal"]["behaviour"] == 0).all()
    sampled = BEHAVIOURS.index("sampled")
    for name in ("dqn", "actor-critic"):
        assert (drawn[name]["behaviour"] == sampled).all() and (drawn[name]["cloned"] == 0).all()
    assert torch.equal(drawn["cql"]["action"], drawn["distance"]["action"]), "the same was done, it is paid otherwise"
    assert not torch.equal(drawn["cql"]["reward"], drawn["distance"]["reward"])
    mean, spread = (np.array([f(np.concatenate([e.reward[1:] for e in ablations.rewarded(bench, bench.config(n))[0]
                                                .episodes])) for n in ("cql", "distance")]) for f in (np.mean, np.std))
    assert mean[0] == pytest.approx(mean[1], abs=1e-4) and spread[0] == pytest.approx(spread[1], abs=1e-4)


def test_the_actor_begins_as_the_supervised_network(bench: Bench) -> None:
    supervised, _ = ablations.trained(bench, "supervised", 1)
    learner = ablations.actor_critic(bench, bench.config("actor-critic"), ablations.untrained(bench, "cql", 1), 1)
    assert isinstance(learner.model, ActorCritic) and isinstance(supervised, QNetwork)
    assert torch.equal(weights(learner.model.actor), weights(supervised))


@pytest.mark.parametrize("name", ["cql", "dqn", "actor-critic"])
def test_training_repeats_and_is_kept(bench: Bench, name: str) -> None:
    file = bench.run.work / f"racer-ablation-{bench.key(name, 1)}.safetensors"
    first = weights(ablations.trained(bench, name, 1)[0])
    kept = file.read_bytes()
    assert torch.equal(first, weights(ablations.trained(bench, name, 1)[0])), "as it was read"
    file.unlink()
    assert torch.equal(first, weights(ablations.trained(bench, name, 1)[0])), "as it was trained again"
    assert file.read_bytes() == kept
    assert not torch.equal(first, weights(ablations.trained(bench, name, 2)[0]))


def test_a_key_tells_what_shapes_a_row(bench: Bench) -> None:
    keys = {bench.key(name, seed) for name in set(ablations.twins(bench.run.config).values()) for seed in (1, 2)}
    assert len(keys) == 2 * len(set(ablations.twins(bench.run.config).values()))
    longer = dataclasses.replace(bench, run=ablations.with_config(bench.run, with_settings(
        bench.run.config, ["schedules.cql.steps=5"])))
    assert longer.key("cql", 1) not in keys


def test_only_values_are_calibrated(bench: Bench) -> None:
    assert ablations.values_of(bench, "supervised") is None is ablations.values_of(bench, "actor-critic")
    assert ablations.values_of(bench, "cql") is ablations.values_of(bench, "dqn")
    assert ablations.values_of(bench, "cql") is bench.taught(bench.run.config)
    assert ablations.values_of(bench, "literal") is bench.tables[""], "the paper's own reward is not centred"
    assert isinstance(ablations.values_of(bench, "distance"), ablations.Known)


# ------------------------------------------------------------------------------------------------------ the command

def test_the_command_goes_on_where_it_was_stopped(bench: Bench, tiny_store: Path, tiny_bundle: Path, work: Path,
                                                  tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    by = [gesture_features.RawFeatures(10, count=1)]
    monkeypatch.setattr(policies, "networks", lambda store, work: by)
    monkeypatch.setattr(ablations, "PRESET", PRESET)
    monkeypatch.setattr(ablations, "MOTION", 1)
    told = ["--data", str(tiny_store), "--work", str(work), "--bundle", str(tiny_bundle), "--out", str(tmp_path),
            "--limit", "2"]
    assert ablations.main([*told, "--only", "supervised", "alpha=0.1", "--seeds", "2"]) == 0
    assert {file.name for file in tmp_path.iterdir()} == {
        "supervised-1.json", "supervised-2.json", "cql-1.json", "cql-2.json", "table.json", "table.md"}
    before = (tmp_path / "cql-1.json").read_bytes()
    one = json.loads(before)
    assert one["steps"] == 4 and one["training"] == "offline" and len(one["recordings"]) == 2
    assert set(ablations.COLUMNS) <= set(one["recordings"][0]) and one["recordings"][0]["silent"] == 100.0

    def nothing(*given: object) -> None:
        raise AssertionError("finished rows are reused")

    with monkeypatch.context() as patched:
        patched.setattr(ablations, "trained", nothing)
        assert ablations.main([*told, "--only", "cql", "--seeds", "1"]) == 0
    assert (tmp_path / "cql-1.json").read_bytes() == before
    (tmp_path / "cql-1.json").write_text(before.decode()[:50])
    assert ablations.main([*told, "--only", "cql", "dqn", "--seeds", "1", "--motion"]) == 0
    again = json.loads((tmp_path / "cql-1.json").read_text())
    assert again["recordings"] == one["recordings"], "a file that was cut short is written again"
    assert len(again["motion"]["recordings"]) == 1
    assert not again["motion"]["recordings"][0]["pmb"] > 100, "a percentage"
    table = json.loads((tmp_path / "table.json").read_text())
    assert list(table["rows"]) == ["supervised", "dqn", "cql", "alpha=0.1"], "all that are finished"
    assert table["rows"]["alpha=0.1"]["run_as"] == "cql" and list(table["motion"]) == ["dqn", "cql", "alpha=0.1"]
    text = (tmp_path / "table.md").read_text()
    assert "| dqn (undecided: 1 of 3 seeds) |" in text and "| 76.63 |" in text and "| 15.46 |" in text
    assert text in capsys.readouterr().out


def test_what_cannot_be_run(tiny_store: Path, tiny_bundle: Path, tmp_path: Path,
                            capsys: pytest.CaptureFixture[str]) -> None:
    told = ["--data", str(tiny_store), "--work", str(tmp_path), "--bundle", str(tiny_bundle)]
    for wrong, word in ((["--only", "nothing"], "choose among"), (["--seeds", "0"], "--seeds 0")):
        with pytest.raises(SystemExit):
            ablations.main([*told, *wrong])
        assert word in capsys.readouterr().err
    with pytest.raises(SystemExit):
        ablations.main([])
    bundle = dataclasses.replace(bundles.load(tiny_bundle), reward_judge=None)
    with pytest.raises(InputError, match="reward models"):
        Bench.of(Store.open(tiny_store), bundle, tmp_path, PRESET)


def test_the_list_shows_every_row(capsys: pytest.CaptureFixture[str]) -> None:
    assert ablations.main(["--list"]) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in ROWS) and "episodes.reward=distance" in told
