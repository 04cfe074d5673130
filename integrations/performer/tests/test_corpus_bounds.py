"""The bounds that a corpus must keep: a wrong corpus misses the bound that is there for it, and no other hides it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer.acceptance import bounds as corpus_bounds
from gesticulator_performer.acceptance import by_source
from gesticulator_performer.acceptance.bounds import CLAIMS, FREEZE, MEAN, SEAM, MeasuredTalk, TalkClaim
from gesticulator_performer.plan import rests_of
from gesticulator_performer.talks import with_life
from gesticulator_performer.types import Spoken

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, RecordingInfo, Split, StoreWriter
from data_module.truth import JOIN, REST, Mark, Phrase, StyleKnot, Truth
from data_module.types import Array, Motion, Speech
from eval.acceptance.bounds import Verdict
from eval.baselines import controls as baselines
from eval.commands import PROBE
from eval.metrics import EYE_METRICS
from eval.metrics.eye import common_body
from eval.table import load

GOOD = {"eye_hand_height_correlation": 0.4, "eye_one_handed": 30.0, "eye_one_hanging": 25.0, "eye_head": 13.0,
        "eye_chest": 7.0, "eye_stroke_amplitude": 26.0,
        SEAM: 1.1, "eye_hand_in_torso": 0.1, "eye_elbow_in_torso": 0.2, "eye_head_yaw": 20.0, FREEZE: 0.3}


def _talks(parts: str = "motion talk", figures: dict[str, float] | None = None) -> list[MeasuredTalk]:
    return [MeasuredTalk(f"{part}{k}", part, 60.0, GOOD | (figures or {})) for part in parts.split() for k in range(3)]


def _verdicts(talks: list[MeasuredTalk]) -> dict[str, Verdict]:
    return {verdict.figure: verdict.pooled for verdict in corpus_bounds.judge(talks)}


def test_a_corpus_within_all_bounds_is_told_so() -> None:
    assert set(GOOD) == {claim.figure for claim in CLAIMS}
    assert all(verdict.holds for verdict in _verdicts(_talks()).values())


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.figure)
def test_every_bound_is_missed_beyond_either_end_and_held_on_it(claim: TalkClaim) -> None:
    for edge, beyond in ((claim.bound.low, -0.01), (claim.bound.high, 0.01)):
        if math.isfinite(edge):
            assert _verdicts(_talks(figures={claim.figure: edge}))[claim.figure].holds is True
            missed = [name for name, own in _verdicts(_talks(figures={claim.figure: edge + beyond})).items()
                      if own.holds is False]
            assert missed == [claim.figure]
    assert _verdicts(_talks(figures={claim.figure: math.nan}))[claim.figure].holds is None


def test_means_weigh_by_seconds_and_rules_take_the_worst_talk() -> None:
    short, long = (MeasuredTalk(name, "talk", seconds, GOOD | {"eye_one_handed": share, FREEZE: freeze})
                   for name, seconds, share, freeze in (("a", 30.0, 20.0, 1.2), ("b", 90.0, 40.0, 0.0)))
    verdicts = _verdicts([short, long])
    assert verdicts["eye_one_handed"].value.mean == pytest.approx(35.0)
    spread = next(one for one in corpus_bounds.judge([short, long]) if one.figure == "eye_one_handed")
    assert (spread.least, spread.most) == (20.0, 40.0)
    assert verdicts[FREEZE].value.mean == 1.2 and not verdicts[FREEZE].holds
    assert all(claim.how == MEAN for claim in CLAIMS if claim.figure not in (SEAM, FREEZE))


def test_styles_and_readings_do_not_count_among_the_talks() -> None:
    talks = _talks("motion talk") + _talks("style reading", {"eye_one_handed": 99.0})
    verdict = next(one for one in corpus_bounds.judge(talks) if one.figure == "eye_one_handed")
    assert verdict.pooled.holds
    assert verdict.parts["style"].value.mean == 99.0


# --- By source

MIDDLE = {"eye_splay": 5.0, "eye_azimuth": -15.0, "eye_elbow": 70.0}


def _source(name: str, **changed: float) -> list[MeasuredTalk]:
    """Two talks of a source whose figures lie in the middle of their bounds but for these."""
    return [MeasuredTalk(f"{name}{k}", "talk", 60.0, MIDDLE | changed, name) for k in range(2)]


def _refused(talks: list[MeasuredTalk]) -> set[tuple[str, str]]:
    return {key for key, verdict in by_source.verdicts(talks).items() if verdict.holds is False}


@pytest.mark.parametrize(("figure", "value"), [
    ("eye_splay", 30.0), ("eye_azimuth", 21.0), ("eye_azimuth", -40.0), ("eye_elbow", 44.0), ("eye_elbow", 101.0)])
def test_a_source_is_refused_though_all_together_are_not(figure: str, value: float) -> None:
    good = [talk for k in range(9) for talk in _source(f"good{k}")]
    assert _refused(good) == set()
    talks = good + _source("bad", **{figure: value})
    assert _refused(talks) == {(figure, "bad")}
    shown = by_source.table(talks).rows[EYE_METRICS[figure].heading]
    assert str(shown["bad"]).endswith(" NO") and not str(shown["good0"]).endswith(" NO")
    assert _refused([replace(talk, part="style") for talk in talks]) == set(), "styles are not judged"


# --- From motion


def _motion(seconds: float = 30.0, seed: int = 0) -> Motion:
    """Arms and head on paths of their own, arms down by the sides at first."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * 60)) / 60
    maps = np.zeros((len(time), len(CHARACTER), 3))
    for name, size in (("LeftArm", 0.35), ("RightArm", 0.35), ("LeftForeArm", 0.4), ("RightForeArm", 0.4),
                       ("Head", 0.15), ("Spine1", 0.05)):
        speed, phase, part = (rng.uniform(low, high, (6, 3)) for low, high in ((0.5, 4.0), (0, 6.28), (-size, size)))
        maps[:, CHARACTER.index(name)] = (part * np.sin(speed * time[:, None, None] + phase)).sum(axis=1)
    for side, sign in (("Left", -1.0), ("Right", 1.0)):
        maps[:, CHARACTER.index(side + "Arm"), 2] += 1.1 * sign
        maps[:, CHARACTER.index(side + "ForeArm"), 1] += sign
    return Motion(CHARACTER, rotation.continuous(rotation.from_exponential_map(maps)), np.zeros((len(time), 3)), 60.0)


def _recording(motion: Motion, truth: Truth | None = None, part: str = "talk", name: str = "a",
               split: Split = "train") -> Recording:
    noise = np.random.default_rng(1).normal(0.0, 0.05, round(motion.duration * 16000)).astype(np.float32)
    return Recording(RecordingInfo(name, split, "ann", "tone", "en", part=part), Speech(noise, 16000), motion, truth)


def _measured(motion: Motion, truth: Truth | None = None) -> MeasuredTalk:
    return corpus_bounds.measure(_recording(motion, truth), common_body(motion))


def test_stillness_counts_only_where_no_rest_is_marked() -> None:
    motion = _motion(20.0)
    frozen = motion.rotations.copy()
    frozen[600:780] = frozen[600]
    motion = replace(motion, rotations=frozen)
    longest = _measured(motion).figures[FREEZE]
    assert 2.5 < longest < 3.0
    assert _measured(motion, Truth(marks=(Mark(REST, 10.0, 13.0),))).figures[FREEZE] < 0.2
    assert 1.3 < _measured(motion, Truth(marks=(Mark(REST, 10.0, 11.5),))).figures[FREEZE] < 1.6
    assert _measured(motion, Truth(marks=(Mark(JOIN, 10.0, 13.0),))).figures[FREEZE] == longest


def _jumping(times: Array) -> Motion:
    """A motion whose arm is thrown 6 degrees at each of `times` (seconds)."""
    motion = _motion(40.0)
    thrown = motion.rotations.copy()
    joint = CHARACTER.index("RightArm")
    turn = rotation.from_exponential_map(np.array([0.0, 0.1, 0.0]))
    for time in times:
        thrown[round(time * 60):, joint] = rotation.multiply(thrown[round(time * 60):, joint], turn)
        turn = rotation.conjugate(turn)
    return replace(motion, rotations=thrown)


def test_joins_that_jump_are_seams_and_smooth_ones_are_none() -> None:
    times = np.arange(4.0, 38.0, 4.3)
    truth = Truth(marks=tuple(Mark(JOIN, time, time) for time in times.tolist()))
    assert _measured(_jumping(times), truth).figures[SEAM] > 3.0
    assert 0.6 < _measured(_motion(40.0), truth).figures[SEAM] < 1.35
    assert _measured(_jumping(times + 1.0), truth).figures[SEAM] < 1.35
    assert math.isnan(_measured(_jumping(times)).figures[SEAM])
    assert math.isnan(_measured(_motion(40.0), Truth(marks=truth.marks[:2])).figures[SEAM])


def test_a_held_pose_of_a_real_take_does_not_freeze() -> None:
    held = np.zeros((1200, len(CHARACTER), 3))
    silence = Spoken("s", Speech(np.zeros(320000, dtype=np.float32), 16000), (), (), "nobody", "en")
    for logs, still in ((held, True), (with_life(held, silence, np.random.default_rng(0)), False)):
        motion = Motion(CHARACTER, rotation.continuous(rotation.from_exponential_map(logs)), np.zeros((1200, 3)), 60.0)
        assert (_measured(motion).figures[FREEZE] > 1.0) == still


# --- What the truth tells


def test_pauses_that_are_long_enough_are_marked_as_rest() -> None:
    phrases = [Phrase(6.0, 9.0, 0.0), Phrase(1.0, 3.0, 0.0), Phrase(3.5, 4.0, 0.0)]
    assert rests_of(phrases, 11.0) == (Mark(REST, 4.0, 6.0), Mark(REST, 9.0, 11.0))
    assert rests_of(phrases, 10.0) == (Mark(REST, 4.0, 6.0),)
    assert rests_of([], 10.0) == (Mark(REST, 0.0, 10.0),)


# --- The command


def test_the_command_names_what_is_no_store(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for told, says in ((["--data", str(tmp_path)], "is not a store"),
                       (["--data", str(tmp_path), "--talks", "0"], "1 or more")):
        with pytest.raises(SystemExit) as stop:
            PROBE.main("gesticulator probe", ["corpus", *told, "--out", str(tmp_path / "out.json")])
        assert stop.value.code == 2
        assert says in capsys.readouterr().err
    assert not (tmp_path / "out.json").exists()


def test_a_store_is_measured_and_judged(tmp_path: Path) -> None:
    writer = StoreWriter(tmp_path / "s", "test", {}, 0, "none")
    style = (StyleKnot(0.0, 0.5, -1.0), StyleKnot(30.0, -0.5, 1.0))
    names = []
    for k, part in enumerate(("motion", "talk", "talk", "style", "style", "style", "style")):
        names.append(f"{part}{k}")
        motion = baselines.mirrored([_motion(seed=k)])[0]
        writer.add(_recording(motion, Truth(style=style if part == "style" else ()), part, names[-1]))
    writer.finish(names)
    out = tmp_path / "corpus.json"
    assert PROBE.main("gesticulator probe", ["corpus", "--data", str(tmp_path / "s"), "--out", str(out)]) == 0
    bounds, sources = load(out)
    assert list(sources.columns) == ["bound", "ann"] and len(sources.facts["clauses"]) == len(by_source.EVERY)
    assert bounds.rows["L/R hand height correlation"]["holds"] == "NO"
    assert "L/R hand height correlation" in bounds.notes[1] and "acceleration at seams" in bounds.notes[1]
    assert out.with_suffix(".md").read_text().count("| L/R hand height correlation | 0.25 to 0.55 |") == 1
