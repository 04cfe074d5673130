"""Style editing: features of movements worked out by hand, averages against an oracle, what a command may ask."""

import warnings

import numpy as np
import pytest
from bursts import blocks_of, turned
from hypothesis import given
from hypothesis import strategies as st

from data_module import controls
from data_module.controls import Curve, Levels
from data_module.errors import InputError
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion
from gesticulator.gesticulator import ControlWarning, hand_target

SHOULDER = np.array([-0.18, 0.49, -0.035])
"""The right shoulder joint over the hips at rest, added up from the table of the character's bones."""
ARM = 0.28 + 0.25
"""Metres from the shoulder to the wrist, the arm straight."""
LEFT_RADIUS = float(np.hypot(0.18 + ARM, 0.035))


def arm(angle: Array, fps: float, heading: Array | None = None) -> Motion:
    """The straight right arm turns about Z by `angle` [T]: the wrist goes round the shoulder; the left arm is level."""
    about = np.zeros(len(angle)) if heading is None else heading
    return turned(len(angle), fps, {"RightArm": np.outer(angle, [0, 0, 1]), "Hips": np.outer(about, [0, 1, 0])})


def levels() -> Levels:
    return Levels(np.array([[-0.1, 0.1, 0.4], [0.2, 0.5, 0.9], [0.2, 0.3, 0.45]]), np.array([0.12, 0.55, 0.31]),
                  np.array([0.2, 0.3, 0.1]))


# -------------------------------------------------------------------------------------------------- measured

@pytest.mark.parametrize("fps", [15.0, 20.0, 60.0])
@pytest.mark.parametrize("turns_per_second", [0.25, -0.5])
def test_a_hand_on_a_circle_has_the_features_of_the_circle(fps: float, turns_per_second: float) -> None:
    angle = 2 * np.pi * turns_per_second * np.arange(round(4 * fps)) / fps
    got = controls.per_frame(arm(angle, fps))
    hand = SHOULDER - ARM * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    assert np.allclose(got[:, 0], hand[:, 1], atol=1e-9)
    chord = 2 * ARM * np.sin(np.pi * abs(turns_per_second) / fps)  # what a straight line between frames makes of it
    assert np.allclose(got[:, 1], chord * fps / 2, atol=1e-9), "the other hand is still"
    assert np.isclose(got[0, 1], np.pi * abs(turns_per_second) * ARM, rtol=0.01)
    assert np.allclose(got[:, 2], (np.hypot(hand[:, 0], hand[:, 2]) + LEFT_RADIUS) / 2, atol=1e-9)


def test_neither_heading_nor_walking_nor_standing_height_matters() -> None:
    rng = np.random.default_rng(0)
    angle = np.cumsum(rng.normal(0, 0.05, 90))
    plain = controls.per_frame(arm(angle, 30.0))
    turned = arm(angle, 30.0, heading=np.linspace(0, 5, 90))
    path = np.array([3, 0.95, -2]) + np.cumsum(rng.normal(0, 0.02, (90, 3)), axis=0)
    walking = Motion(CHARACTER, turned.rotations, path, 30.0)
    assert np.allclose(controls.per_frame(walking), plain, atol=1e-9)


def test_one_frame_has_a_height_and_no_speed() -> None:
    got = controls.measure(arm(np.zeros(1), 20.0))
    assert got.shape == (1, 3) and np.allclose(got[0], [0.49, 0.0, LEFT_RADIUS])


@given(st.integers(1, 80), st.sampled_from([10.0, 15.0, 60.0]), st.floats(0, 12), st.integers(0, 2 ** 16))
def test_the_average_is_that_of_the_frames_in_the_window(frames: int, fps: float, window: float, seed: int) -> None:
    motion = arm(np.cumsum(np.random.default_rng(seed).normal(0, 0.3, frames)), fps)
    raw, got = controls.per_frame(motion), controls.measure(motion, window)
    half = round(window * fps / 2)
    expected = np.array([raw[max(0, t - half):t + half + 1].mean(axis=0) for t in range(frames)])
    assert np.allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("window", [-1.0, float("nan"), float("inf")])
def test_an_impossible_window_is_refused(window: float) -> None:
    with pytest.raises(InputError, match="window"):
        controls.measure(arm(np.zeros(5), 20.0), window)


def test_knots_are_read_on_the_recordings_own_clock() -> None:
    blocks = blocks_of([0.0, 0.2, 0.7, 1.0])
    values = np.outer(np.arange(31) / 30, [1.0, -2.0, 3.0])
    got = controls.at_knots(values, 30.0, blocks)
    assert got.shape == (3, 4, 3)
    assert np.allclose(got[0, :, 0], [0.05, 0.1, 0.15, 0.2]) and np.allclose(got[1, :, 1], [-0.65, -0.9, -1.15, -1.4])
    assert np.allclose(got[:, -1, 2], [0.6, 2.1, 3.0]), "the last frame of a block lies on its beat"
    assert np.allclose(controls.at_knots(values[:16], 30.0, blocks)[2, -1], [0.5, -1.0, 1.5]), "held past the end"


# ---------------------------------------------------------------------------------------------------- levels

def test_levels_are_the_15_50_and_85_per_cent_quantiles() -> None:
    steps = np.arange(101.0)
    fitted = Levels.fit(np.stack([steps / 100, steps * 2, -steps], axis=1)[np.random.default_rng(0).permutation(101)])
    assert np.allclose(fitted.table, [[0.15, 0.5, 0.85], [30, 100, 170], [-85, -50, -15]])
    assert np.allclose(fitted.mean, [0.5, 100, -50])
    assert np.allclose(fitted.spread, np.sqrt((101 ** 2 - 1) / 12) * np.array([0.01, 2, 1]))
    assert fitted.value("speed", "high") == pytest.approx(170) and fitted.value("height", "low") == pytest.approx(0.15)


def test_levels_need_values_and_unknown_levels_and_features_are_refused() -> None:
    for values in (np.zeros((0, 3)), np.zeros((5, 2)), np.full((5, 3), np.nan)):
        with pytest.raises(ValueError):
            Levels.fit(values)
    for feature, level in (("height", "top"), ("tempo", "low")):
        with pytest.raises(KeyError):
            levels().value(feature, level)
    good = levels()
    with pytest.raises(ValueError, match="fall"):
        Levels(good.table[:, ::-1], good.mean, good.spread)
    with pytest.raises(ValueError, match="positive"):
        Levels(good.table, good.mean, 0 * good.spread)


# -------------------------------------------------------------------------------------------------- controls

def test_free_constant_and_curve() -> None:
    asked = controls.Controls(height=0.3, radius=Curve((1.0, 3.0), (0.2, 0.6)))
    values, asked_for = asked.at(np.array([0.0, 1.0, 1.5, 3.0, 9.0]))
    assert asked_for.tolist() == [True, False, True]
    assert np.allclose(values[:, 0], 0.3) and (values[:, 1] == 0).all()
    assert np.allclose(values[:, 2], [0.2, 0.2, 0.3, 0.6, 0.6])
    nothing, none = controls.Controls().at(np.arange(4.0))
    assert (nothing == 0).all() and not none.any()
    assert controls.Controls() != asked and controls.Controls() == controls.Controls(None, None, None)
    assert controls.Controls(radius=Curve((1.0, 3.0), (0.2, 0.6)), height=0.3) == asked
    zero, told = controls.Controls(speed=0.0).at(np.zeros(1))
    assert zero[0, 1] == 0 and told.tolist() == [False, True, False], "zero is asked for, not free"


def test_impossible_controls_are_refused() -> None:
    for times, values in (((), ()), ((0.0, 0.0), (1.0, 1.0)), ((1.0, 0.0), (1.0, 1.0)), ((0.0,), (1.0, 2.0)),
                          ((0.0,), (float("nan"),))):
        with pytest.raises(ValueError):
            Curve(times, values)
    with pytest.raises(ValueError, match="speed"):
        controls.Controls(speed=float("inf"))


# --------------------------------------------------------------------------------------------------- parsing

@pytest.mark.parametrize(("text", "expected"), [("low", 0.2), ("mid", 0.5), (" HIGH ", 0.9), ("0.35", 0.35),
                                                ("6e-1", 0.6), ("0", 0.0)])
def test_levels_and_numbers(text: str, expected: float) -> None:
    assert hand_target("--hand-speed", text, "speed", levels()) == pytest.approx(expected)


@given(st.text(max_size=12))
def test_any_text_is_understood_or_refused_by_name(text: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ControlWarning)
        try:
            got = hand_target("--hand-radius", text, "radius", levels())
        except InputError as error:
            said = str(error)
        else:
            said, number = "", got
    assert "\n" not in said
    assert said or (isinstance(number, float) and 0 <= number <= 2)


@pytest.mark.parametrize("text", ["", "lowest", "nan", "inf", "-inf", "0,4", "0.4 m", "no_such_file.csv", "-0.1", "45",
                                  "0_4", "\0", "x" * 5000])
def test_nonsense_names_its_flag(text: str) -> None:
    with pytest.raises(InputError, match="--hand-radius"):
        hand_target("--hand-radius", text, "radius", levels())


def test_what_training_never_saw_is_said_and_used() -> None:
    with pytest.warns(ControlWarning, match=r"--hand-height 1\.1.*far from the training data.*high 0\.40"):
        assert hand_target("--hand-height", "1.1", "height", levels()) == 1.1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert hand_target("--hand-height", "0.5", "height", levels()) == 0.5


