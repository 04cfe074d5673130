"""Arms as people's: known answers, and controls that each figure must refuse."""

import math
from pathlib import Path

import numpy as np
import pytest

from data_module.types import Array
from eval.acceptance.bounds import table
from eval.metrics.eye import arms
from eval.metrics.eye.body import HZ, SIDES, CommonBody
from gesticulator.sampling.candidates import swivel

SECONDS = 20.0
TIME = np.arange(round(SECONDS * HZ)) / HZ


def body_of(points: dict[str, Array]) -> CommonBody:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(points["Head"]), 1))
    return CommonBody(points, still, still)


def standing(**moves: Array) -> CommonBody:
    """Forearms level ahead, elbows bent by a right angle; moves: [T, 3] metres added to joints."""
    places = {"Chest": [0, 0.4, 0], "Neck": [0, 0.53, 0], "Head": [0, 0.61, 0]}
    for side, sign in zip(SIDES, (-1, 1), strict=True):
        places |= {side + "Arm": [0.18 * sign, 0.48, 0], side + "ForeArm": [0.22 * sign, 0.21, 0],
                   side + "Hand": [0.22 * sign, 0.21, 0.25]}
    return body_of({name: np.array(place) + moves.get(name, np.zeros((len(TIME), 3)))
                    for name, place in places.items()})


def step(seconds: float, at: float, size: float) -> Array:
    """[T, 3] a movement upwards of minimum jerk."""
    s = np.clip((TIME - at) / seconds, 0.0, 1.0)
    return np.stack([0 * s, size * (10 * s ** 3 - 15 * s ** 4 + 6 * s ** 5), 0 * s], axis=1)


def test_a_stroke_is_no_jump_and_the_same_way_in_a_sixth_of_the_time_is_a_strong_one() -> None:
    for seconds, jumps in ((0.6, 0), (0.1, 1)):
        found = arms.figures(standing(RightHand=step(seconds, 5.0, 0.3)))
        assert found["eye_jumps"] == pytest.approx(jumps * 60 / SECONDS), "one event, at both ends beyond a limit"
        assert found["eye_strong_jumps"] == found["eye_jumps"]


@pytest.mark.parametrize(("rate", "flips"), [(60.0, 0), (150.0, 0), (400.0, 1)])
def test_an_elbow_that_turns_round_while_the_hand_stays_is_a_flip(rate: float, flips: int) -> None:
    angle = np.radians(np.clip((TIME - 5.0) * rate, 0.0, 80.0))
    quiet = standing().points
    line = quiet["RightHand"][0] - quiet["RightArm"][0]
    upper, axis = quiet["RightForeArm"][0] - quiet["RightArm"][0], line / np.linalg.norm(line)
    turned = (np.cos(angle)[:, None] * upper + np.sin(angle)[:, None] * np.cross(axis, upper)
              + (1 - np.cos(angle))[:, None] * (axis @ upper) * axis)
    shoulder = quiet["RightArm"]
    turns, off = swivel(shoulder, shoulder + turned, quiet["RightHand"])
    assert np.abs(turns) == pytest.approx(np.diff(angle)) and off == pytest.approx(np.full(len(TIME), off[0]))
    found = arms.figures(standing(RightForeArm=turned - upper))
    assert found["eye_flips"] == pytest.approx(flips * 60 / SECONDS)


def test_arms_freeze_in_speech_alone_and_a_small_beat_thaws_them() -> None:
    moving = 0.1 * np.sin(2 * np.pi * TIME)[:, None] * [0.0, 1.0, 0.0]
    held = ((TIME < 8.0) | (TIME > 9.5))[:, None]
    speech = np.ones(len(TIME), bool)
    path = np.where(held, moving, 0.0)
    frozen = standing(RightHand=path, LeftHand=path)
    assert arms.frozen(frozen, speech) == pytest.approx(60 / SECONDS)
    assert arms.frozen(frozen, speech & ((TIME < 8) | (TIME > 9.5))) == 0, "in a pause"
    beat = path + 0.02 * np.exp(-0.5 * ((TIME - 8.75) / 0.08) ** 2)[:, None] * [0.0, 1.0, 0.0]
    assert arms.frozen(standing(RightHand=beat, LeftHand=path), speech) == 0, "of two centimetres"


def test_lean_tilt_and_a_still_neck_are_those_that_were_put_in() -> None:
    sway = np.radians(3.0) * np.sin(2 * np.pi * TIME / 4.0)
    moved = standing(Chest=0.4 * np.stack([np.sin(sway), np.cos(sway) - 1, 0 * sway], axis=1),
                     LeftArm=0.18 * np.stack([0 * sway, np.tan(sway), 0 * sway], axis=1),
                     RightArm=-0.18 * np.stack([0 * sway, np.tan(sway), 0 * sway], axis=1),
                     Neck=np.where(TIME < 5.0, 0.0, 0.05 * np.sin(2 * np.pi * TIME))[:, None] * [1.0, 0.0, 0.0])
    found = arms.figures(moved)
    assert found["eye_lean"] == pytest.approx(3.0 / math.sqrt(2), rel=0.02)
    assert found["eye_tilt"] == pytest.approx(3.0 / math.sqrt(2), rel=0.02)
    assert found["eye_neck_still"] == pytest.approx(25.0, abs=3.0)


def test_one_hand_that_flings_while_the_other_hangs_in_the_air_leaves_it_behind() -> None:
    wave = 0.15 * np.sin(2 * np.pi * TIME)[:, None] * [0.0, 1.0, 0.0]
    assert arms.left_behind(standing(RightHand=wave)) == pytest.approx(100.0)
    assert arms.left_behind(standing(RightHand=wave, LeftHand=0.5 * wave)) < 20.0
    assert arms.left_behind(standing(RightHand=wave, LeftHand=0 * wave - [0.0, 0.2, 0.0])) == 0.0, "it hangs"
    assert math.isnan(arms.left_behind(standing()))


def test_strokes_are_prepared_and_units_retracted_forwards_alone() -> None:
    """Up in .7 s, ahead in .35 s, and after a hold home in .8 s."""
    path = sum((step(0.7, at, 0.25) + step(0.35, at + 0.7, 0.2)[:, [0, 2, 1]]
                - step(0.8, at + 1.6, 0.25) - step(0.8, at + 1.6, 0.2)[:, [0, 2, 1]] for at in (1.0, 6.0, 11.0)),
               np.zeros((len(TIME), 3)))
    hands = dict.fromkeys((side + "Hand" for side in SIDES), path - [0.0, 0.1, 0.0])
    found, back = (arms.figures(body_of({name: place[::way] for name, place in standing(**hands).points.items()}))
                   for way in (1, -1))
    assert found["eye_prepared"] == found["eye_retracted"] == 100.0 and back["eye_prepared"] < 50.0


def test_first_places_are_apart_by_their_mean_distance() -> None:
    first = [np.zeros((2, 3)), np.array([[0.1, 0, 0], [0, 0.3, 0]]), np.zeros((2, 3))]
    assert arms.first_spread(first) == pytest.approx(100 * (0.2 + 0.0 + 0.2) / 3)
    assert math.isnan(arms.first_spread(first[:1]))


def test_trunks_are_alike_by_their_correlation_at_the_same_second() -> None:
    rng = np.random.default_rng(3)
    paths = np.cumsum(rng.normal(size=(12, 1200, 2)), axis=1)
    assert arms.alike([paths[0], 3.0 * paths[0, :900] + 5.0]) == pytest.approx(1.0)
    assert arms.alike([paths[0], -paths[0]]) == pytest.approx(-1.0)
    shared = np.cumsum(rng.normal(size=(1200, 2)), axis=0)
    apart, mixed = arms.alike(list(paths)), arms.alike([path + 2.0 * shared for path in paths])
    assert abs(apart) < 0.15 < 0.5 < mixed
    assert math.isnan(arms.alike([paths[0], paths[1, :300]])), "too short"


def test_real_people_keep_the_bounds_and_each_control_breaks_one(outside_data: Path) -> None:
    """Two minutes of one person, in points."""
    files = sorted((outside_data / "genea2020" / "points" / "N").glob("*.npz"))
    if not files:
        pytest.skip("genea2020 is not in GESTICULATOR_DATA")
    clips = [{name: place.astype(float) for name, place in np.load(file).items()} for file in files]
    bounds = {row.figure: row.bound for row in table()["motion"]}

    def broken(made: list[dict[str, Array]]) -> set[str]:
        found = [arms.figures(body_of(points)) for points in made]
        means = {name: float(np.nanmean([one[name] for one in found])) for name in found[0]}
        return {name for name, mean in means.items() if not bounds[name].keeps(mean)}

    assert broken(clips) == set()
    other = [{name: (clips[k - 1] if name.startswith("Left") and name != "LeftArm" else points)[name]
              [:min(len(points["Head"]), len(clips[k - 1]["Head"]))] for name in points}
             for k, points in enumerate(clips)]
    assert "eye_left_behind" in broken(other), "the left arm of another clip"
    still = [{name: place + 0 * place if "Hand" in name or "ForeArm" in name else np.repeat(place[:1], len(place), 0)
              for name, place in points.items()} for points in clips]
    assert {"eye_lean", "eye_tilt", "eye_neck_still"} <= broken(still), "a trunk that does not move"
    rng = np.random.default_rng(1)
    noisy = [{name: place + 0.01 * rng.normal(size=place.shape) for name, place in points.items()} for points in clips]
    assert {"eye_jumps", "eye_strong_jumps"} <= broken(noisy), "a centimetre of noise"
    assert "eye_prepared" not in broken([{name: place[::-1] for name, place in points.items()} for points in clips]), \
        "played backwards a stroke's end looks like its preparation: the figure is no judge of direction"
