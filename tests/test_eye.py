"""The figures for the eye: known answers, the definition's own program where it is at hand, and what fools them."""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from bursts import turned

from data_module.errors import InputError
from data_module.motion import bvh, rotation
from data_module.motion.kinematics import resample
from data_module.motion.skeletons import CHARACTER
from data_module.speech.audio import load_speech
from data_module.types import Array, Motion, Speech
from eval.baselines import controls as baselines
from eval.metrics import EYE_METRICS, eye
from eval.metrics.eye import frechet, hands, strokes, trunk, voice
from eval.metrics.eye.body import HZ, common_body
from eval.metrics.eye.sample import EyeSample

RATE = 16000
SIGNS = {"Left": -1.0, "Right": 1.0}
JUDGE = {  # our figure -> the name that the definition's own program gives it
    "eye_hand_speed_correlation": "lr_speed", "eye_hand_height_correlation": "lr_height",
    "eye_one_handed": "one_handed", "eye_one_hanging": "one_hanging",
    "eye_both_hanging": "both_hanging", "eye_head": "head", "eye_chest": "chest",
    **{f"eye_speed_{k}": f"v{k}" for k in hands.PERCENTILES}, "eye_stroke_amplitude": "stroke_cm",
    "eye_stroke_amplitude_90": "stroke_cm90", "eye_repetition": "repeat", "eye_seam": "seam",
    "eye_fingers": "fingers"}
JUDGE_SOUND = {"eye_speech_speed": "v_speech", "eye_silence_speed": "v_silence", "eye_speech_over_silence": "v_ratio",
               "eye_above_1": "above1_0.1", "eye_above_2": "above2_0.1"}


def posed(seconds: float, move: Callable[[Array], dict[str, Array]], fps: float = 60.0) -> Motion:
    """A character whose arms hang; `move` gives the exponential maps [T, 3] of some joints for times [T]."""
    time = np.arange(round(seconds * fps)) / fps
    hanging = {side + "Arm": np.array([0.0, 0.0, 1.3 * sign]) for side, sign in SIGNS.items()}
    return turned(len(time), fps, {**hanging, **move(time)})


def elbow(side: str, angle: Array) -> Array:
    """[T, 3] the forearm swung about the vertical of the level arm, radians."""
    out = np.zeros((len(angle), 3))
    out[:, 1] = (-1.0 if side == "Left" else 1.0) * angle
    return out


def wandering(seconds: float = 40.0, seed: int = 0) -> Motion:
    """Both arms and the head on paths of their own."""
    rng = np.random.default_rng(seed)

    def path(time: Array, size: float) -> Array:
        turns = rng.uniform(0.5, 4.0, (6, 3)), rng.uniform(0, 6.28, (6, 3)), rng.normal(0, size / 2.4, (6, 3))
        return np.asarray((turns[2] * np.sin(turns[0] * time[:, None, None] + turns[1])).sum(axis=1))

    return posed(seconds, lambda time: {
        **{side + "Arm": path(time, 0.35) + np.array([0, 0, 1.1 * sign]) for side, sign in SIGNS.items()},
        **{side + "ForeArm": path(time, 0.4) + np.array([0, sign, 0]) for side, sign in SIGNS.items()},
        "Head": path(time, 0.15), "Spine1": path(time, 0.05)})


def clicks(times: Array, seconds: float) -> Speech:
    """Bursts of noise at these seconds, on faint noise."""
    rng = np.random.default_rng(1)
    samples = 1e-4 * rng.normal(size=round(seconds * RATE))
    fade = np.exp(-np.arange(2400) / 600.0)
    for time in times:
        at = int(time * RATE)
        piece = samples[at:at + 2400]
        piece += 0.2 * rng.normal(size=len(piece)) * fade[:len(piece)]
    return Speech(samples.astype(np.float32), RATE)


@pytest.fixture(scope="module")
def take(outside_data: Path) -> tuple[Motion, Speech]:
    """The real take with its sound, at its own 15 fps and with its own bones."""
    folder = outside_data / "takes" / "beat_scott"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", bvh.BvhWarning)
        return (bvh.read_bvh(next(folder.glob("*.bvh")), fps=15.0), load_speech(next(folder.glob("*.wav"))))


@pytest.fixture(scope="module")
def space(outside_data: Path) -> frechet.ReferenceSpace:
    """The frozen space."""
    if not (outside_data / frechet.REFERENCE).is_file():
        pytest.skip(f"{frechet.REFERENCE} is not in the outside data")
    return frechet.ReferenceSpace.load(outside_data / frechet.REFERENCE)


# ------------------------------------------------------------------------------------------------------ known answers

def test_the_program_that_defines_them_agrees_on_files_of_ours(judge: ModuleType, space: frechet.ReferenceSpace,
                                                               outside_data: Path, tmp_path: Path) -> None:
    for seed, motion in enumerate((wandering(), wandering(12.5, 1), resample(wandering(9.0, 2), 25.0))):
        file = tmp_path / f"{seed}.bvh"
        bvh.write_bvh(file, motion)
        edges = np.arange(0.0, motion.duration, 0.37)
        theirs = judge.body_of(judge.read_bvh(str(file)))
        told = judge.motion_measures(theirs, edges)
        own = common_body(bvh.read_bvh(file))
        assert len(own) == len(theirs)
        for point, places in theirs.points.items():
            if point in own.points:
                np.testing.assert_allclose(own.points[point], places, atol=1e-9)
        found = eye.of_body(own, None, edges)
        for name, theirs_name in JUDGE.items():
            value = math.nan if told[theirs_name] is None else told[theirs_name]
            assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-9, nan_ok=True), name
        reference = judge.Judge.read(str(outside_data / frechet.REFERENCE))
        together = EyeSample()
        together.add(bvh.read_bvh(file))
        assert together.pooled(space).mean == pytest.approx(reference.distance(theirs), rel=1e-6)


def test_the_program_that_defines_them_agrees_on_sound(judge: ModuleType, take: tuple[Motion, Speech],
                                                       outside_data: Path) -> None:
    folder = outside_data / "takes" / "beat_scott"
    theirs = judge.load(str(next(folder.glob("*.bvh"))) + ":15")
    told = judge.sound_measures(theirs, judge.read_sound(str(next(folder.glob("*.wav")))))
    found = eye.figures(take[0], eye.hear(take[1]))
    for name, theirs_name in JUDGE_SOUND.items():
        assert found[name] == pytest.approx(told[theirs_name], rel=1e-6), name


# -------------------------------------------------------------------------------------------------- synthetic answers

def test_one_hand_alone_is_one_handed_and_the_other_hangs() -> None:
    motion = posed(20.0, lambda time: {"RightArm": np.stack([0 * time, 0 * time, 0.4 * np.sin(3 * time) - 0.2], 1)})
    found = eye.figures(motion)
    assert found["eye_one_handed"] == 100.0 and found["eye_one_hanging"] == 100.0
    assert math.isnan(found["eye_hand_speed_correlation"])


def test_a_frozen_pose_is_dead_by_every_figure_of_life() -> None:
    found = eye.figures(posed(20.0, lambda time: {}))
    assert found["eye_head"] == pytest.approx(0.0, abs=1e-6) and found["eye_chest"] == pytest.approx(0.0, abs=1e-6)
    assert found["eye_speed_95"] == pytest.approx(0.0, abs=1e-9)
    for name in ("eye_stroke_amplitude", "eye_repetition", "eye_one_handed"):
        assert math.isnan(found[name])


@pytest.mark.parametrize(("degrees", "period"), [(40.0, 1.0), (60.0, 1.6)])
def test_sinusoidal_strokes_have_the_amplitude_they_were_given(degrees: float, period: float) -> None:
    half = math.radians(degrees) / 2
    motion = posed(20.0, lambda time: {"RightForeArm": elbow("Right", 1.0 + half * np.cos(2 * np.pi * time / period))})
    found = eye.figures(motion)
    # The wrist swings on a circle of the forearm's length; the chord is smoothed over 50 ms where speed is taken only.
    assert found["eye_stroke_amplitude"] == pytest.approx(2 * 25.0 * math.sin(half), rel=0.02)
    wrist = common_body(motion).hands[:, 0]
    assert np.median(strokes.strokes(wrist)[:, 0]) == pytest.approx(period / 2, abs=0.02)
    # What comes again after each period has an equal elsewhere, where the period fits the 10 Hz grid.
    assert found["eye_repetition"] == pytest.approx(0.0, abs=0.02)


def test_turns_of_head_and_chest_are_told_in_degrees() -> None:
    def move(time: Array) -> dict[str, Array]:
        swing = np.sin(2 * np.pi * time / 4.0)
        zero = np.zeros_like(time)
        return {"Spine1": np.stack([math.radians(10) * swing, zero, zero], 1),
                "Head": np.stack([zero, math.radians(30) * swing, zero], 1)}

    found = eye.figures(posed(40.0, move))
    assert found["eye_chest"] == pytest.approx(10 / math.sqrt(2), rel=0.01)
    assert found["eye_head"] == pytest.approx(30 / math.sqrt(2), rel=0.01)


def test_a_kick_at_each_edge_is_a_seam_and_elsewhere_is_none() -> None:
    edges = np.arange(0.0, 30.1, 0.5)
    path = wandering(30.0)
    kicked = path.rotations.copy()
    for edge in edges[1:-1]:
        frame = round(edge * HZ)
        kicked[frame:, CHARACTER.index("RightArm")] = rotation.multiply(
            kicked[frame:, CHARACTER.index("RightArm")],
            rotation.from_exponential_map(np.array([0.0, 0.05 * (-1) ** frame, 0.0])))
    assert eye.figures(path, edges=edges)["eye_seam"] == pytest.approx(1.0, abs=0.15)
    assert eye.figures(replace(path, rotations=kicked), edges=edges)["eye_seam"] > 2.0
    moved = np.concatenate([[0.0], edges[1:-1] + 0.25, [30.0]])
    assert eye.figures(replace(path, rotations=kicked), edges=moved)["eye_seam"] < 0.8


def test_hands_through_the_belly_are_seen() -> None:
    straight = eye.figures(posed(5.0, lambda time: {}))
    assert straight["eye_hand_in_torso"] == 0.0
    sunk = common_body(posed(5.0, lambda time: {}))
    sunk.points["RightHand"][:150] = sunk.points["Waist"][:150] + np.array([0.0, 0.0, 0.11])
    found = eye.of_body(sunk)
    assert found["eye_hand_in_torso"] == pytest.approx(50.0)
    above, line = np.array([[0.0, 0.6, 0.0]]), np.array([[0.0, 0.4, 0.0]])
    assert trunk.off_line(above, 0.0 * line, line) == pytest.approx(0.2), "above the chest it is outside"


def test_drift_is_told_in_centimetres() -> None:
    motion = posed(60.0, lambda time: {"RightForeArm": elbow("Right", np.where(time < 30, 0.0, math.pi / 2))})
    # A right angle of the forearm moves the wrist by 25 cm times root two, the other one not at all.
    assert eye.figures(motion)["eye_drift"] == pytest.approx(25.0 * math.sqrt(2) / 2, rel=0.01)
    assert math.isnan(eye.figures(motion.crop(0, 60 * 25))["eye_drift"])


def test_beats_on_onsets_are_far_above_chance_and_shifted_ones_are_not() -> None:
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.35, 1.4, 60))
    times = times[times < 39]
    sound = eye.hear(clicks(times, 40.0))
    for own in sound.onsets:
        assert np.abs(own[:, None] - times[None]).min(axis=0).max() < 0.05
    still = posed(40.0, lambda time: {})
    bobbing = eye.figures(baselines.bobbing([still], [times])[0], sound)
    assert bobbing["eye_above_1"] > 80 and bobbing["eye_above_2"] > 60
    late = eye.figures(baselines.bobbing([still], [times + 0.2])[0], sound)
    assert late["eye_above_1"] < 30 and late["eye_above_2"] < 30
    np.testing.assert_allclose(voice.hand_beats(common_body(baselines.bobbing([still], [times])[0]).hands)[:20],
                               times[:20], atol=0.06)


def test_frame_rate_size_and_heading_do_not_count() -> None:
    motion = wandering(20.0)
    found = eye.figures(motion)
    small = replace(motion.skeleton, offsets=0.7 * motion.skeleton.offsets)
    turn = rotation.from_exponential_map(np.array([0.0, 1.1, 0.0]))
    turned = motion.rotations.copy()
    turned[:, 0] = rotation.multiply(turn, turned[:, 0])
    other = eye.figures(Motion(small, turned, motion.root_positions + 2.0, 60.0))
    slow = eye.figures(resample(motion, 30.0))
    for name in EYE_METRICS:
        assert other[name] == pytest.approx(found[name], rel=1e-6, abs=1e-6, nan_ok=True), name
        if not math.isnan(found[name]) and "torso" not in name:
            assert slow[name] == pytest.approx(found[name], rel=0.05, abs=0.05), name


def test_too_short_or_unknown_bodies_are_told() -> None:
    assert all(math.isnan(value) for value in eye.figures(wandering(1.5)).values())
    names = tuple(f"bone{k}" for k in range(len(CHARACTER)))
    with pytest.raises(InputError, match="no joint known"):
        eye.figures(replace(wandering(3.0), skeleton=replace(CHARACTER, names=names)))
