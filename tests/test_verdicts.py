"""The rule of verdicts: known answers on either side of each bound, and experiments that are as often right as said."""

import math

import numpy as np
import pytest

from eval.ablate.cells import Cells
from eval.ablate.rows import COLUMNS, CONTROLS, DOSED, DOSES, ELSEWHERE, REFERENCES, ROWS, TABLES, Claim, Elsewhere
from eval.ablate.verdicts import (
    HOLDS,
    INERT,
    NO_EFFECT,
    NO_TEST,
    REVERSED,
    UNDECIDED,
    beaten_by,
    claims_table,
    decide,
    margin_of,
    needed_for,
    present,
    reading,
    readings,
)
from eval.crossed import Components, components


def found(mean: float, error: float, seeds: int = 3) -> Components:
    """A difference with so many degrees of freedom that t is z: the intervals are 1.96 and 1.645 errors either way."""
    return Components(mean, 0.0, error ** 2 * 15, 0.0, error, 1e9, seeds, 15)


@pytest.mark.parametrize(("mean", "error", "above", "below"), [
    (3.0, 1.0, HOLDS, REVERSED), (-3.0, 1.0, REVERSED, HOLDS), (1.9, 1.0, UNDECIDED, UNDECIDED),
    (0.0, 1.0, NO_EFFECT, NO_EFFECT), (0.4, 1.0, UNDECIDED, UNDECIDED), (1.0, 0.4, NO_EFFECT, NO_EFFECT),
    (1.5, 0.4, HOLDS, REVERSED)])
def test_a_margin_of_two_and_every_side_of_the_bounds(mean: float, error: float, above: str, below: str) -> None:
    decision = decide(found(mean, error), ">", 2.0)
    assert (decision.word, decide(found(mean, error), "<", 2.0).word) == (above, below)
    assert bool(decision.reason) == (above == NO_EFFECT and mean > 0), "less than the margin"
    mirrored = decide(found(-mean, error), "<", 2.0)
    assert (mirrored.word, mirrored.reason) == (decision.word, decision.reason)


@pytest.mark.parametrize(("mean", "word"), [(3.0, HOLDS), (-3.0, REVERSED), (0.0, UNDECIDED), (1.9, UNDECIDED)])
def test_without_a_printed_effect_the_sign_alone_decides(mean: float, word: str) -> None:
    decision = decide(found(mean, 1.0), ">", math.nan)
    assert decision.word == word and decision.needed == ()


@pytest.mark.parametrize(("mean", "error", "word"), [
    (0.0, 1.0, HOLDS), (1.0, 0.5, HOLDS), (1.0, 1.0, UNDECIDED), (5.0, 1.0, REVERSED), (-5.0, 1.0, REVERSED),
    (3.5, 1.0, UNDECIDED)])
def test_alike_is_within_the_margin(mean: float, error: float, word: str) -> None:
    assert decide(found(mean, error), "=", 2.0).word == word


def test_two_seeds_decide_nothing_and_say_so() -> None:
    decision = decide(found(9.0, 1.0, seeds=2), ">", 2.0)
    assert (decision.word, decision.reason, decision.needed) == (UNDECIDED, "2 of 3 seeds", ())


def test_something_is_there_when_its_lowest_interval_is_above_zero() -> None:
    def of(*lowest: float) -> Elsewhere:
        return Elsewhere("RG Fig. 10", "hands follow", lowest=lowest, intervals=2)

    assert present(of(2, 1, 3, 9)).word == HOLDS and present(of(-2, -3, -1, 9)).word == REVERSED
    around = present(of(0.5, -1, 2, 9))
    assert around.word == UNDECIDED and around.needed == (1, math.ceil(9 * (2.8 * (3 / 3.92) / 0.5) ** 2))
    assert present(of(2, 1, 3, 2)).word == UNDECIDED, "two clips decide nothing"
    assert present(Elsewhere("RG Fig. 12", "people prefer ours", "people")).reason == "people"


@pytest.mark.parametrize("sizes", [(0.3, 1.0, 1.0), (0.1, 3.0, 1.0)])
def test_as_many_seeds_and_clips_as_are_named_decide_in_four_of_five_experiments(sizes: tuple[float, float, float]
                                                                                 ) -> None:
    seed, clip, rest = sizes
    margin = 1.0
    seeds, clips = needed_for(Components(0.3, seed ** 2, clip ** 2, rest ** 2, 1.0, 3.0, 3, 15), margin)
    rng, right = np.random.default_rng(3), {0.0: 0, 2 * margin: 0}
    for truth in right:
        for _ in range(80):
            table = truth + seed * rng.normal(size=(seeds, 1)) + clip * rng.normal(size=clips) + rest * rng.normal(
                size=(seeds, clips))
            right[truth] += decide(components(table), ">", margin).word == (HOLDS if truth else NO_EFFECT)
    assert right[0.0] / 80 == pytest.approx(0.85, abs=0.1), "the number is whole, so power is 80 % or a little more"
    assert right[2 * margin] / 80 > 0.75


# ---------------------------------------------------------------------------------------------------------- readings

SEEDLESS = {*REFERENCES, *CONTROLS, *DOSED}
LOWER = Claim("RG Table 1", "fgd", "ours", "<", "no-style")
HIGHER = Claim("RG Table 1", "pmb", "ours", ">", "no-lexemes")


def cells_by(metric: str, **rows: list[list[float]]) -> Cells:
    """Cells with metric = rows[row][seed][clip]; the performer and the controls have no seed."""
    return {name.replace("_", "-"): {seed: {"clips": [{"name": f"clip {k}", metric: value}
                                                      for k, value in enumerate(clips)]}
                                     for seed, clips in enumerate(seeds, start=name.replace("_", "-") not in SEEDLESS)}
            for name, seeds in rows.items()}


def test_differences_are_paired_over_seeds_and_clips() -> None:
    rng = np.random.default_rng(0)
    hard = rng.normal(3, 0.1, size=(3, 1)) + rng.normal(10, 3, size=12)  # what clips and seeds differ by is far more
    better = hard - 2 + rng.normal(0, 0.3, size=(3, 12))
    right = reading(LOWER, cells_by("fgd", ours=better.tolist(), no_style=hard.tolist()), "fgd")
    assert right.word == HOLDS and right.over == (3, 12)
    assert right.value.mean == pytest.approx(-2, abs=0.2)
    assert right.margin == pytest.approx((12.53 - 10.78) / 12.53 / 2 * hard.mean(), rel=0.01), "as a share"
    other = reading(LOWER, cells_by("fgd", ours=hard.tolist(), no_style=better.tolist()), "fgd")
    assert other.word == REVERSED
    noise = rng.normal(10, 9, size=(3, 12)).tolist()
    other = reading(LOWER, cells_by("fgd", ours=better.tolist(), no_style=noise), "fgd")
    assert other.word == UNDECIDED and len(other.needed) == 2
    assert reading(LOWER, cells_by("fgd", ours=[[1.0]] * 3), "fgd").reason == "not run: no-style"
    empty = cells_by("fgd", ours=[[float("nan")] * 2] * 3, no_style=[[1.0] * 2] * 3)
    assert reading(LOWER, empty, "fgd").reason == "FGD was not measured of both"


def test_the_margin_is_half_of_the_papers_effect() -> None:
    cells = cells_by("fgd", ours=[[1.0, 2.0]] * 3, no_style=[[2.0, 6.0]] * 3)
    assert margin_of(LOWER, cells, "fgd") == pytest.approx((12.53 - 10.78) / 12.53 / 2 * 4.0)
    assert margin_of(HIGHER, {}, "pmb_above_chance") == pytest.approx((91.36 - 85.74) / 2)
    assert margin_of(Claim("RG Table 1", "pmb", "ours", "=", "no-style"), {}, "pmb") == 5.0
    assert math.isnan(margin_of(Claim("RG Fig. 18", "fgd", "size-100", "<", "size-10"), cells, "fgd"))
    # Of what the paper prints no figure the column's fixed margin decides.
    assert margin_of(Claim("RG Fig. 18", "pmb", "size-100", "=", "size-10"), {}, "pmb_above_chance") == 5.0
    assert margin_of(Claim("RG 6.4.1", "silence_speed", "ours", "<", "no-hint"), {}, "silence_speed") == 0.05


WRONG = [[5.0, 6.0, 7.5]]
ALL_PASS = dict.fromkeys(COLUMNS["pmb"].controls, WRONG)


def test_a_control_takes_the_valid_verdict_and_leaves_the_published_one() -> None:
    rows = {"ours": [[50.0, 51.0, 52.0]] * 3, "no_lexemes": [[30.0, 31.0, 32.5]] * 3}
    passes = cells_by("pmb_above_chance", **rows, **ALL_PASS)
    plain, valid, fooled = readings(HIGHER, passes)
    assert (plain.word, valid.word, fooled) == (UNDECIDED, HOLDS, ""), "PMB at 0.2 s was not measured"
    for name in ("bobbing", "jitter"):
        _, valid, fooled = readings(HIGHER, passes | cells_by("pmb_above_chance", **{name: [[49.0, 51.5, 53.0]]}))
        assert valid.word == NO_TEST and fooled == name, "what nonsense does as well carries no claim"
    undefined = passes | cells_by("pmb_above_chance", still=[[math.nan] * 3])
    assert readings(HIGHER, undefined)[1].word == HOLDS, "what never moves has no timing"
    del passes["bobbing"]
    assert readings(HIGHER, passes)[1].word == NO_TEST, "a control that was not run was not passed"
    silent = Claim("RG 6.4.1", "silence_speed", "ours", "<", "no-hint")
    speeds = {"ours": [[1.0, 2.0, 3.0]] * 3, "no_hint": [[2.0, 3.5, 4.0]] * 3, "still": [[0.0, 1.1, 2.2]]}
    plain, valid, _ = readings(silent, cells_by("silence_speed", **speeds, jitter=[[9.0, 9.0, 9.0]]))
    assert plain.word == valid.word == HOLDS, "jitter raises a speed, and so it should"


def test_a_negative_stands_whatever_the_controls_do() -> None:
    fooled_by_all = {name: [[90.0, 91.0, 92.5]] for name in COLUMNS["pmb"].controls}
    for ours, word in ((10.0, REVERSED), (30.5, NO_EFFECT)):
        rows = {"ours": [[ours, ours + 1, ours + 2]] * 3, "no_lexemes": [[30.0, 31.0, 32.5]] * 3}
        _, valid, fooled = readings(HIGHER, cells_by("pmb_above_chance", **rows, **fooled_by_all))
        assert (valid.word, fooled) == (word, ", ".join(COLUMNS["pmb"].controls))


def doses(**instead: list[float]) -> dict[str, list[list[float]]]:
    """Distances of each dose, rising; instead: of some kinds of damage."""
    return {f"{kind}-{k + 1}": [[value, value + 0.1, value + 0.3]] for kind, count in DOSES.items()
            for k, value in enumerate(instead.get(kind.replace("-", "_"), [1.0, 2.0, 4.0][:count]))}


def test_a_distance_between_sets_must_order_doses_of_damage() -> None:
    rows = {"ours": [[1.0, 2.0, 3.1]] * 3, "no_style": [[5.0, 6.0, 7.0]] * 3, "performer": [[0.0, 0.0, 0.0]],
            "shuffled": [[0.0, 0.0, 0.0]]}
    plain, valid, fooled = readings(LOWER, cells_by("fgd", **rows, **doses()))
    assert (plain.word, valid.word, fooled) == (HOLDS, HOLDS, ""), "it cannot see the speech, which is not its task"
    for instead, which in (({"jitter": [1.0, 0.5, 4.0]}, "jitter"), ({"frozen_trunk": [0.0, 0.0]}, "frozen-trunk")):
        _, valid, fooled = readings(LOWER, cells_by("fgd", **rows, **doses(**instead)))
        assert (valid.word, fooled) == (NO_TEST, f"doses of {which}")
    assert beaten_by("fgd", cells_by("fgd", **rows)) == ["doses of damage (not run)"]


def test_rows_that_differ_in_nothing_are_inert_and_do_not_count() -> None:
    alike_claim = Claim("RG Table 1", "pmb", "ours", "=", "no-style")
    rng = np.random.default_rng(0)

    def cells(better: float) -> Cells:
        """MAJE of `ours` lower by so much; PMB the same but for noise."""
        noise = {name: rng.normal(0, 0.1, size=(3, 12)) for name in ("ours", "no-style")}
        return {name: {seed: {"clips": [{"name": str(k), "pmb": 70 + value, "maje": value + (
            30.0 if name == "no-style" else 30.0 - better)} for k, value in enumerate(noise[name][seed - 1])]}
            for seed in (1, 2, 3)} for name in noise}

    assert reading(alike_claim, cells(0.0), "pmb").word == INERT, "nothing that the paper says of style is there"
    assert reading(alike_claim, cells(5.0), "pmb").word == HOLDS, "style does something, and not to timing"
    assert reading(alike_claim, cells(-5.0), "pmb").word == HOLDS
    no_other = Claim("RG Table 3", "pmb", "style-reads", "=", "ours")
    assert reading(no_other, cells_by("pmb", ours=[[1.0, 2.0]] * 3, style_reads=[[1.1, 2.1]] * 3), "pmb").word == INERT


def test_a_collapsed_policy_is_named_and_returns_are_judged_by_their_own_reward() -> None:
    claim = Claim("RACER Table 2", "return", "racer-cql", ">", "racer-dqn")

    def cells(random: float, nats: float) -> Cells:
        values = {"racer-cql": 12.0, "racer-dqn": 2.0, "racer-random": random, "racer-majority": 1.0}
        return {name: {seed: {"clips": [{"name": str(k), "return": value + 0.1 * k + 0.01 * seed * k, "longest_run": 55,
                                         "lexeme_diversity": nats if name == "racer-cql" else 2.0} for k in range(5)]}
                       for seed in (1, 2, 3)} for name, value in values.items()}

    plain, valid, fooled = readings(claim, cells(1.0, 2.0))
    assert (plain.word, valid.word, fooled, valid.reason) == (HOLDS, HOLDS, "", "")
    _, valid, fooled = readings(claim, cells(13.0, 0.4))
    assert (valid.word, fooled) == (NO_TEST, "racer-random")
    assert "racer-cql has collapsed: 55 blocks of one lexeme" in valid.reason and "dqn" not in valid.reason


def test_an_amount_is_less_in_a_still_body_and_not_more_in_noise() -> None:
    def fooling(still: float, jitter: float) -> list[str]:
        rows = {"ours": [[3.0, 3.1, 3.2]] * 3, "performer": [[4.0, 4.1, 4.2]], "still": [[still, still, still + 0.1]],
                "jitter": [[jitter, jitter + 0.1, jitter + 0.21]], "reversed": [[4.0, 4.1, 4.2]]}
        return beaten_by("diversity", cells_by("diversity", **rows))

    assert fooling(0.0, 4.0) == []
    assert fooling(3.2, 4.0) == ["still"] and fooling(0.0, 5.0) == ["jitter"]
    assert beaten_by("accuracy", {}) == []


def test_every_claim_is_of_rows_and_figures_that_there_are_and_the_papers_numbers_bear_it_out() -> None:
    """What is listed as a claim of the paper must be true of the paper's own figures."""
    claims = [claim for table in TABLES.values() for claim in table.claims]
    assert len(set(claims)) == len(claims) == 83 - len(ELSEWHERE)
    numbered = 0
    for claim in claims:
        table = TABLES[claim.where]
        assert {claim.first, claim.second} <= {line.row for line in table.lines} and claim.metric in table.columns
        assert len({ROWS[name].split for name in (claim.first, claim.second) if name in ROWS}) == 1, "of one split"
        for _, one, other in table.both(claim):
            numbered += 1
            within = COLUMNS[claim.metric].alike
            assert {"<": one < other, ">": one > other, "=": abs(one - other) < within}[claim.sign], claim
    assert numbered > 60
    first = next(claim for claim in claims if (claim.second, claim.metric) == ("no-lexemes", "fgd"))
    assert TABLES["RG Table 1"].both(first) == [("Trinity", 10.78, 29.75), ("TED", 2.04, 5.22)]
    reward = next(claim for claim in claims if (claim.second, claim.metric) == ("racer-dqn", "return"))
    assert TABLES["RACER Table 2"].both(reward) == [("Trinity", 9.34, 4.23)]
    count = claims_table({}).facts["count"]
    assert sum(count["valid"].values()) == sum(count["published"].values()) == 83
