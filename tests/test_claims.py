"""Claims: what an interval says of one, what pairs with what, and that each is of rows and figures that there are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from eval import claims, racer_ablation
from eval.ablation_tables import COLUMNS, Cells
from eval.ablations import REFERENCES, ROWS, TABLES
from eval.bootstrap import Interval
from eval.claims import CLAIMS, FAILS, HOLDS, UNDECIDED, Claim

LOWER = Claim("RG Table 1", "ours", "no-style", "fgd", "below")


def cells(**rows: list[list[float]]) -> Cells:
    """Cells with fgd = rows[row][seed][clip]; a row of one seed named "performer" has none."""
    return {name.replace("_", "-"): {seed: {"clips": [{"name": f"clip {k}", "fgd": value}
                                                      for k, value in enumerate(clips)]}
                                     for seed, clips in enumerate(seeds, start=name != "performer")}
            for name, seeds in rows.items()}


# ----------------------------------------------------------------------------------------------------------- verdicts

@pytest.mark.parametrize(("low", "high", "above", "below", "alike"), [
    (1.0, 2.0, HOLDS, FAILS, HOLDS), (-2.0, -1.0, FAILS, HOLDS, HOLDS), (-1.0, 1.0, UNDECIDED, UNDECIDED, HOLDS),
    (-9.0, 9.0, UNDECIDED, UNDECIDED, UNDECIDED), (6.0, 9.0, HOLDS, FAILS, FAILS), (4.0, 9.0, HOLDS, FAILS, UNDECIDED)])
def test_an_interval_decides(low: float, high: float, above: str, below: str, alike: str) -> None:
    own = Interval((low + high) / 2, low, high, 10)
    assert [claims.decided(own, says) for says in ("above", "below", "alike")] == [above, below, alike]


def test_differences_are_paired_over_seeds_and_clips() -> None:
    rng = np.random.default_rng(0)
    hard = rng.normal(0, 100, size=(3, 12))  # what clips and seeds differ by is far more than what rows do
    better = hard - 1 + rng.normal(0, 0.3, size=(3, 12))
    found = claims.judged(LOWER, cells(ours=better.tolist(), no_style=hard.tolist()))
    assert found.verdict == HOLDS and (found.seeds, found.clips) == (3, 12)
    assert found.difference is not None and found.difference.mean == pytest.approx(-1, abs=0.2)
    turned = claims.judged(LOWER, cells(ours=hard.tolist(), no_style=better.tolist()))
    assert turned.verdict == FAILS
    unpaired = claims.judged(LOWER, cells(ours=better.tolist(), no_style=rng.normal(0, 100, size=(3, 12)).tolist()))
    assert unpaired.verdict == UNDECIDED and unpaired.reason == ""


def test_fewer_than_three_seeds_decide_nothing() -> None:
    found = claims.judged(LOWER, cells(ours=[[1.0] * 9] * 2, no_style=[[2.0] * 9] * 3))
    assert found.verdict == UNDECIDED and found.reason == "2 of 3 seeds"
    assert found.difference is not None and found.difference.mean == -1.0, "it is shown all the same"


def test_what_was_not_run_is_named() -> None:
    assert claims.judged(LOWER, cells(ours=[[1.0]] * 3)).reason == "not run: no-style"
    empty = cells(ours=[[float("nan")] * 2] * 3, no_style=[[1.0] * 2] * 3)
    assert claims.judged(LOWER, empty).reason == "no figure of a clip that both have"


def test_only_clips_that_both_have_are_compared() -> None:
    own = cells(ours=[[1.0, 2.0, 3.0]] * 3, no_style=[[5.0, 5.0]] * 3)
    assert claims.paired(own["ours"], own["no-style"], "fgd").tolist() == [[-4.0, -3.0]] * 3


def test_the_performer_has_no_seed_and_pairs_with_all() -> None:
    own = cells(performer=[[5.0, 6.0]], ours=[[1.0, 2.0], [2.0, 3.0], [3.0, 4.0]])
    assert claims.paired(own["performer"], own["ours"], "fgd").tolist() == [[4.0, 4.0], [3.0, 3.0], [2.0, 2.0]]
    assert claims.judged(Claim("RG Table 5", "performer", "ours", "fgd"), own).verdict == HOLDS


# -------------------------------------------------------------------------------------------------------- the claims

def test_every_claim_is_of_rows_and_figures_that_there_are() -> None:
    assert len({(claim.where, claim.first, claim.second, claim.metric) for claim in CLAIMS}) == len(CLAIMS)
    for claim in CLAIMS:
        if claim.needs:
            continue
        assert claim.says in ("above", "below", "alike")
        if claim.where == claims.RACER_TABLE:
            assert {claim.first, claim.second} <= set(racer_ablation.ROWS)
            assert claim.metric in {*racer_ablation.COLUMNS, *racer_ablation.MOTION_COLUMNS, "fgd"}
            continue
        assert {claim.first, claim.second} <= {*ROWS, *REFERENCES} and claim.metric in COLUMNS
        assert {claim.first, claim.second} <= {line.row for line in TABLES[claim.where].lines}
        splits = {ROWS[name].split for name in (claim.first, claim.second) if name in ROWS}
        assert len(splits) == 1, "of one split"


def test_the_papers_numbers_bear_their_claims_out() -> None:
    """What is listed as a claim of the paper must be true of the paper's own figures."""
    numbered = 0
    for claim in CLAIMS:
        text = "" if claim.needs else claims.papers_numbers(claim)
        for place in filter(None, text.split("; ")):
            one, other = (float(part) for part in place.split(" ", 1)[1].split(" and "))
            numbered += 1
            if claim.says == "alike":
                assert abs(one - other) < claims.ALIKE, claim
            else:
                assert (one > other) == (claim.says == "above") and one != other, claim
    assert numbered > 60
    first = next(c for c in CLAIMS if (c.where, c.second, c.metric) == ("RG Table 1", "no-lexemes", "fgd"))
    assert claims.papers_numbers(first) == "Trinity 10.78 and 29.75; TED 2.04 and 5.22"
    reward = next(c for c in CLAIMS if (c.second, c.metric) == ("dqn", "return"))
    assert claims.papers_numbers(reward) == "Trinity 9.34 and 4.23"


# ------------------------------------------------------------------------------------------------------- the command

def test_the_command_reads_what_the_other_two_have_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ablation, racer = tmp_path / "ablation", tmp_path / "racer"
    for folder in (ablation, racer):
        folder.mkdir()
    for seed in (1, 2, 3):
        for row, value in (("ours", 1.0), ("no-style", 2.0)):
            (ablation / f"{row}-{seed}.json").write_text(json.dumps({
                "row": row, "seed": seed, "shared": "x",
                "clips": [{"name": str(k), **dict.fromkeys(COLUMNS, value + 0.1 * k)} for k in range(5)]}))
        for row, value in (("cql", 9.0), ("dqn", 4.0)):
            (racer / f"{row}-{seed}.json").write_text(json.dumps({
                "row": row, "seed": seed, "recordings": [{"name": str(k), "return": value, "judge_return": -value}
                                                         for k in range(5)],
                **({"motion": {"recordings": [{"pmb_above_chance": value}]}} if seed == 1 else {})}))
    (racer / "distance-1.json").write_text("{")
    step, flat = ({"mean": mean, "low": mean - 1, "high": mean + 1, "clips": 5} for mean in (2.0, 0.5))
    (tmp_path / "style_editing.json").write_text(json.dumps({
        "spread": {"height": 1.0, "speed": 0.5},
        "editing": {"height": {"low_to_mid": step, "mid_to_high": step},
                    "speed": {"low_to_mid": step, "mid_to_high": {**step, "low": 0.2}}}}))
    (tmp_path / "languages.json").write_text(json.dumps({"systems": {"shipped": {"groups": {
        "English, real": {"above_chance": flat}, "German, real": {"above_chance": {**step, "clips": 2}}}}}}))
    (tmp_path / "speech_levels.json").write_text(json.dumps({"figure_14": {"generated": {"gain_differences": {
        "high - low": {**step, "low": -9.0, "mean": -8.0, "high": -7.0}}}}}))
    told = ["--results", str(tmp_path), "--out", str(tmp_path / "claims.json")]
    assert claims.main(told) == 0
    found = {(row["where"], row["metric"], row["first"], row["second"]): row
             for row in json.loads((tmp_path / "claims.json").read_text())["claims"]}
    assert len(found) == len(CLAIMS)
    assert found["RG Table 1", "fgd", "ours", "no-style"]["verdict"] == HOLDS
    assert found["RG Table 1", "fgd", "ours", "no-lexemes"]["reason"] == "not run: no-lexemes"
    assert found["RACER Table 2", "return", "cql", "dqn"]["verdict"] == HOLDS
    assert found["RACER Table 2", "judge_return", "cql", "dqn"]["verdict"] == FAILS
    motion = found["RACER Table 2", "pmb_above_chance", "cql", "dqn"]
    assert (motion["verdict"], motion["reason"], motion["seeds"]) == (UNDECIDED, "1 of 3 seeds", 1)
    capsys.readouterr()
    assert claims.main(["--results", str(tmp_path), "--differences"]) == 0
    assert "| no-style | -1.0 [-1.0, -1.0] | -1.00 [-1.00, -1.00] | -1.00 [-1.00, -1.00] | +0.0; -1.8 |" in (
        capsys.readouterr().out)
    by_place = {row["where"]: row for row in found.values()}
    assert by_place["RG Fig. 10"]["verdict"] == HOLDS and by_place["RG Fig. 10"]["difference"]["low"] == 0.4
    assert by_place["RG Fig. 13"]["verdict"] == UNDECIDED and "less than 3 clips" in by_place["RG Fig. 13"]["reason"]
    assert by_place["RG Fig. 14"]["verdict"] == FAILS
    text = (tmp_path / "claims.md").read_text()
    assert "| FGD: ours lower than no-style | Trinity 10.78 and 12.53; TED 2.04 and 2.47 | -1.00 [-1.00, " in text
    assert claims.main(told) == 0
    assert text in capsys.readouterr().out
