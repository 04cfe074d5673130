"""How bodies stand: known answers, the controls, and the bands of people."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_module.errors import InputError
from data_module.motion.bvh import write_bvh
from data_module.types import Array, Motion
from eval.clip.standing import FIGURES, PEOPLE, StandingSpan, bands, figures, outside, spans_of
from eval.probes.stance import CONTROLS
from gesticulator.body.stance import with_legs
from tests.test_stance import drawn

FPS = 30.0
TIMES = np.arange(round(30.0 * FPS)) / FPS


def body(across: Array | float = 0.0, yaw: Array | float = 0.0, bend: float = 20.0, seconds: float = 30.0
         ) -> StandingSpan:
    """Places of a puppet. across: metres that the hips are to the left; yaw: radians of the shoulders, of which the
    hips take half; bend: degrees of the right knee, the left one is straight."""
    ones = np.ones(round(seconds * FPS))
    across, yaw = (np.broadcast_to(value, len(ones)) for value in (across, yaw))

    def at(x: Array | float, y: float, z: Array | float = 0.0) -> Array:
        return np.stack([x * ones, y * ones, z * ones], axis=-1)

    half = math.radians(bend) / 2.0
    hips = at(across, 0.9)
    places = {"Hips": hips}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        places[side + "UpLeg"] = hips + at(sign * 0.09 * np.cos(yaw / 2.0), 0.0, -sign * 0.09 * np.sin(yaw / 2.0))
        places[side + "Arm"] = hips + at(sign * 0.18 * np.cos(yaw), 0.5, -sign * 0.18 * np.sin(yaw))
        places[side + "Hand"] = places[side + "Arm"]
        places[side + "Foot"] = at(sign * 0.1, 0.08)
        places[side + "ToeBase"] = at(sign * (0.1 + 0.14 * math.sin(0.2)), 0.02, 0.14 * math.cos(0.2))
        bent = half if side == "Right" else 0.0
        places[side + "Leg"] = places[side + "UpLeg"] + at(0.0, -0.4 * math.cos(bent), 0.4 * math.sin(bent))
        if bent:  # the ankle that this knee and a shin of 0.4 m lead to
            places["RightFoot"] = places["RightUpLeg"] + at(0.0, -0.8 * math.cos(bent))
    return StandingSpan(FPS, places)


def test_known_answers() -> None:
    found = body(across=0.0).figures()
    assert found["bent"] == pytest.approx(20.0, abs=1e-6) and found["straight"] < 3.0
    assert found["toes"] == pytest.approx(math.degrees(0.2), abs=3.5)
    assert found["shifts"] == 0.0 and found["knees"] < 1e-9
    turning = body(yaw=0.3 * np.sin(2.0 * np.pi * 0.2 * TIMES), bend=0.0).figures()
    assert turning["turns"] == pytest.approx(1.0, abs=1e-6) and turning["turned"] == pytest.approx(0.5, abs=1e-3)


def test_shifts_are_counted_where_the_hips_stay() -> None:
    steps = 0.05 * np.sign(np.sin(2.0 * np.pi * TIMES / 10.0 + 1e-9))  # every five seconds to the other side
    assert body(across=steps, bend=0.0).figures()["shifts"] == 5.0
    assert body(across=0.15 * steps, bend=0.0).figures()["shifts"] == 0.0, "1.5 cm do not count"
    sways = body(across=0.05 * np.sin(2.0 * np.pi * 0.5 * TIMES), bend=0.0).figures()
    assert sways["shifts"] == 0.0, "nor do hips that never stay"
    assert sways["rate"] == pytest.approx(0.5, abs=0.02)
    together = figures([body(across=steps, bend=0.0)] * 2)
    assert together["shifts"] == pytest.approx(60.0 * 5.0 / 26.0), "a minute in which one could be seen"


def test_walking_and_sitting_are_no_standing() -> None:
    motion = with_legs(drawn(1), 1)
    found = spans_of(motion)
    assert 30.0 < sum(span.seconds for span in found) <= 60.0 and min(span.seconds for span in found) >= 4.0
    walks = motion.root_positions + np.linspace(0.0, 30.0, len(motion))[:, None] * [0.0, 0.0, 1.0]
    assert spans_of(replace(motion, root_positions=walks)) == []
    assert math.isnan(figures([])["bent"])


def test_lengths_do_not_count() -> None:
    motion = with_legs(drawn(2), 2)
    child = replace(motion, root_positions=0.6 * motion.root_positions, skeleton=replace(
        motion.skeleton, offsets=0.6 * motion.skeleton.offsets))
    for key, value in figures(spans_of(motion)).items():
        assert figures(spans_of(child))[key] == pytest.approx(value, rel=1e-6, nan_ok=True), key


def marked(motions: list[Motion]) -> set[str]:
    found = figures([span for motion in motions for span in spans_of(motion)])
    return {key for key in FIGURES if outside(key, found[key])}


def test_stilts_and_statues_are_outside_and_ours_inside() -> None:
    motions = [with_legs(drawn(seed, seconds=90.0, size=0.4), seed) for seed in range(4)]
    # Feet, knees, pelvis and what follows the trunk; how much it moves is the drawn body's.
    assert not marked(motions) & {"straight", "bent", "knees", "drop", "over", "shifts", "turns", "turned", "width"}
    stilts, statues = ([CONTROLS[name](motion) for motion in motions] for name in ("stilts", "a statue"))
    assert {"straight", "bent", "knees", "shifts", "turns", "turned"} <= marked(stilts)
    assert {"knees", "shifts", "sway", "turns", "turned"} <= marked(statues)


def test_a_band_is_of_time() -> None:
    people = {"one": [body(bend=10.0, seconds=40.0), body(bend=50.0, seconds=4.0)], "two": [body(bend=20.0)] * 2}
    low, high = bands(people)["bent"]
    assert 10.0 <= low < 15.0 and 19.0 < high < 50.0
    assert set(bands(people)) == set(PEOPLE) == set(FIGURES)


def test_the_probe_measures_people_and_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"manifest\.csv"):
        _people(tmp_path)
    write_bvh(tmp_path / "a.bvh", with_legs(drawn(3), 3))
    for kind, count in (("talk", 1), ("dance", 0)):
        with (tmp_path / "manifest.csv").open("w", newline="") as lines:
            csv.writer(lines).writerows([("file", "person", "kind"), ("a.bvh", "her", kind)])
        assert len(_people(tmp_path)) == count


def _people(folder: Path) -> dict[str, list[StandingSpan]]:
    from eval.probes import stance

    return stance._people(folder)


def test_the_bands_are_those_of_the_people_at_hand(free_motion: Path) -> None:
    for key, (low, high) in bands(_people(free_motion)).items():
        assert PEOPLE[key] == pytest.approx((low, high), abs=0.06), key
