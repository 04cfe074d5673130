"""Posture, parts together, gesture units, stability: known answers, the definition's program, and what must fail."""

import math
import warnings
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from data_module.motion import bvh, rotation
from data_module.motion.phases import gesture_units
from data_module.motion.skeletons import FINGERED
from data_module.speech.audio import load_speech
from data_module.types import Array, Motion, Speech
from eval.baselines import controls
from eval.metrics.eye import pitch, posture, stability, together, units
from eval.metrics.eye.body import HZ, CommonBody, common_body
from eval.metrics.eye.voice import VoiceActivity, hear
from tests.test_eye import elbow, posed, wandering

JUDGE = {  # our figure -> the name that the definition's own program gives it
    "eye_splay": "splay", "eye_splay_both": "splay_both", "eye_azimuth": "azimuth", "eye_elbow": "elbow",
    "eye_hands_apart": "hands_apart", "eye_shoulder": "shoulder", "eye_wrist_95": "wrist95",
    "eye_finger_bend": "finger_bend", "eye_finger_between": "finger_apart", "eye_thumb_index": "thumb_index",
    "eye_head_with_hands": "head_hand", "eye_head_travel": "head_travel", "eye_chest_travel": "chest_travel",
    "eye_fast": "band3_6", "eye_held": "held", "eye_pause_moving": "pause_moving", "eye_pause_speed": "pause_slow",
    "eye_loud": "loud", "eye_variation_speech": "cv4"}


def every_figure(body: CommonBody, voice: VoiceActivity) -> dict[str, float]:
    return {**posture.figures(body), **together.figures(body), **units.figures(body, voice)}


@pytest.fixture(scope="module")
def take(outside_data: Path) -> tuple[Path, Motion, Path]:
    """The BEAT take, whose header has the wrong frame rate."""
    folder = outside_data / "takes" / "beat_scott"
    file = next(folder.glob("*.bvh"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return file, bvh.read_bvh(file, fps=15.0), next(folder.glob("*.wav"))


def test_the_program_that_defines_them_agrees(judge: ModuleType, take: tuple[Path, Motion, Path]) -> None:
    file, motion, sound = take
    theirs = judge.load(str(file) + ":15")
    told = {**judge.together_measures(theirs), **judge.together_sound(theirs, judge.read_sound(str(sound)))}
    found = every_figure(common_body(motion), hear(load_speech(sound)))
    first = units.leads(common_body(motion), hear(load_speech(sound)), 50)
    assert [float(np.median(first.seconds)), first.before, first.chance] == pytest.approx(
        [told["lead"], told["lead_before"], told["lead_chance"]])
    # That program has no figure for frozen arms, and the take has too few pauses for their speed.
    assert {*found} | {"eye_pause_speed"} == {*JUDGE, "eye_face", "eye_frozen"}
    for name, key in JUDGE.items():
        value = math.nan if told[key] is None else told[key]
        assert found.get(name, math.nan) == pytest.approx(value, rel=1e-6, abs=1e-9, nan_ok=True), name


def test_two_takes_differ_as_that_program_says(judge: ModuleType, take: tuple[Path, Motion, Path],
                                               tmp_path: Path) -> None:
    motion = take[1]
    other = controls.jittered([motion], 0, 0.01)[0]
    for name, one in (("a", motion), ("b", other)):
        bvh.write_bvh(tmp_path / f"{name}.bvh", one)
    first, second = (common_body(bvh.read_bvh(tmp_path / f"{name}.bvh")) for name in "ab")
    ours = stability.difference(first, second)
    theirs = judge.same(*(judge.load(str(tmp_path / f"{name}.bvh")) for name in "ab"))
    assert ours.hands == pytest.approx(theirs["hands_cm"], rel=1e-5)


# -------------------------------------------------------------------------------------------------- known answers

def arms_ahead(outward: float = 0.0, seconds: float = 4.0) -> Motion:
    """Upper arms that hang, forearms level, turned outward by so many degrees from straight ahead."""
    def move(time: Array) -> dict[str, Array]:
        out = {}
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            hang = rotation.from_exponential_map(np.array([0.0, 0.0, -sign * math.pi / 2]))
            ahead = np.array([math.sin(math.radians(outward)) * sign, 0.0, math.cos(math.radians(outward))])
            # In the frame of the hanging arm the forearm lies along the arm's own axis at rest.
            goal = rotation.rotate(rotation.conjugate(hang), ahead)
            axis = np.cross([sign, 0.0, 0.0], goal)
            angle = math.acos(float(np.clip(goal @ np.array([sign, 0.0, 0.0]), -1, 1)))
            bent = axis / np.linalg.norm(axis) * angle
            out[side + "Arm"] = np.tile([0.0, 0.0, -sign * math.pi / 2], (len(time), 1))
            out[side + "ForeArm"] = np.tile(bent, (len(time), 1))
        return out

    return posed(seconds, move)


@pytest.mark.parametrize("degrees", [-20.0, 0.0, 15.0, 40.0])
def test_the_azimuth_of_a_level_forearm_is_its_angle(degrees: float) -> None:
    found = posture.figures(common_body(arms_ahead(degrees)))
    assert found["eye_azimuth"] == pytest.approx(degrees, abs=0.5)
    assert found["eye_elbow"] == pytest.approx(90.0, abs=0.5)
    # A forearm is 25 cm long, so the wrist is 8 cm outside from asin(8 / 25) = 18.7 degrees on.
    assert found["eye_splay"] == found["eye_splay_both"] == (100.0 if degrees > 18.7 else 0.0)


def test_an_arm_is_before_the_face_where_its_hand_covers_it() -> None:
    hanging, ahead = posed(2.0, lambda time: {}), arms_ahead(0.0)
    body = common_body(ahead)
    assert posture.figures(common_body(hanging))["eye_face"] == posture.figures(body)["eye_face"] == 0.0
    # The right forearm stands upright before the chest; its wrist is at the height of the mouth, in half of the time.
    face = body.points["Head"] + np.array([0.0, 0.09, 0.08])
    points, half = dict(body.points), len(body) // 2
    points["RightForeArm"], points["RightHand"] = body.points["RightForeArm"].copy(), body.points["RightHand"].copy()
    points["RightHand"][:half] = (face + np.array([0.0, -0.05, 0.12]))[:half]
    points["RightForeArm"][:half] = (face + np.array([0.0, -0.30, 0.12]))[:half]
    assert posture.figures(replace(body, points=points))["eye_face"] == pytest.approx(50.0, abs=1.0)


def test_fingers_that_bend_alike_have_no_difference_between_them() -> None:
    rng = np.random.default_rng(0)
    motion = posed(3.0, lambda time: {})
    rotations = np.zeros((len(motion), len(FINGERED), 4))
    rotations[..., 0] = 1.0
    curl = 0.5 + 0.3 * np.sin(np.arange(len(motion)) / 20.0)
    fingers = [joint for joint, name in enumerate(FINGERED.names)
               if any(finger in name for finger in ("Index", "Middle", "Ring", "Pinky", "Thumb"))]
    for joint in fingers:
        axis = np.array([0.0, 0.0, 1.0])
        rotations[:, joint] = rotation.from_exponential_map(curl[:, None] * axis)
    alike = posture.figures(common_body(Motion(FINGERED, rotations, np.zeros((len(motion), 3)), 60.0)))
    assert alike["eye_finger_between"] < 3.0 and alike["eye_thumb_index"] > 0.99
    assert alike["eye_finger_bend"] == pytest.approx(math.degrees(curl.mean()), rel=0.05)
    for joint in fingers:
        axis = np.array([0.0, 0.0, 1.0]) * rng.uniform(0.2, 1.8)
        rotations[:, joint] = rotation.from_exponential_map(curl[:, None] * axis)
    apart = posture.figures(common_body(Motion(FINGERED, rotations, np.zeros((len(motion), 3)), 60.0)))
    assert apart["eye_finger_between"] > 5.0


def test_units_are_counted_from_rest_to_rest() -> None:
    def move(time: Array) -> dict[str, Array]:
        # Two units of two seconds, each out and back twice, a second and more of rest about them.
        active = ((time > 2) & (time < 4)) | ((time > 7) & (time < 9))
        swing = np.where(active, 0.7 * (1 - np.cos(2 * np.pi * (time - np.where(time < 5, 2, 7)))), 0.0)
        return {"RightForeArm": elbow("Right", swing)}

    body = common_body(posed(12.0, move))
    found = gesture_units(body.hands[:, 0, 1], together.hand_speeds(body)[:, 0], HZ)
    assert [(stop - begin) / HZ for begin, stop in found] == pytest.approx([2.0, 2.0], abs=0.3)


def voice_of(silent: NDArray[np.bool_]) -> VoiceActivity:
    """A voice that is silent in these frames of 10 ms."""
    return VoiceActivity(len(silent) / 100, (np.zeros(0), np.zeros(0)), np.where(silent, -60.0, -20.0), silent)


def talk(early: float, seconds: float = 90.0) -> tuple[Motion, VoiceActivity]:
    """Speech and silence of random lengths in turn; the hand swings for a second, from so many seconds before each
    speech on, and rests otherwise."""
    rng = np.random.default_rng(4)
    begins = np.cumsum(rng.uniform(3.0, 6.0, 40))
    begins = begins[begins < seconds - 4]
    ends = begins + rng.uniform(1.2, 1.8, len(begins))

    def move(time: Array) -> dict[str, Array]:
        since = time[:, None] - (begins - early)
        swings = np.where((since > 0) & (since < 1), 0.6 * (1 - np.cos(2 * np.pi * since)), 0.0).sum(axis=1)
        return {"RightForeArm": elbow("Right", swings)}

    at = np.arange(round(seconds * 100))[:, None] / 100
    return posed(seconds, move), voice_of(np.asarray(~((at >= begins) & (at < ends)).any(axis=1)))


@pytest.mark.parametrize(("early", "before"), [(0.5, 100.0), (-0.3, 0.0)])
def test_a_hand_that_starts_before_the_voice_is_early_and_one_that_follows_is_not(early: float, before: float) -> None:
    motion, voice = talk(early)
    first = units.leads(common_body(motion), voice, 50)
    assert first.before == before
    # The swing passes 0.3 m/s a little after it begins.
    assert np.median(first.seconds) == pytest.approx(-early + 0.08, abs=0.06)
    # A small shift keeps the hand early, so one recording alone cannot reach a lower p.
    assert (first.p < 0.1) == (before > 50)
    pooled = units.Leads.pooled([first, first])
    assert len(pooled.seconds) == 2 * len(first.seconds) and pooled.before == first.before


def frozen_in_pauses(clip: Motion, quiet: NDArray[np.bool_]) -> Motion:
    """A clip with its pose held through every silence, [F] at 100 Hz: a person prepares the next phrase there."""
    # A clip may be a frame longer than its sound.
    at = np.minimum((np.arange(len(clip)) / clip.fps * 100).astype(int), len(quiet) - 1)
    last = np.maximum.accumulate(np.where(quiet[at], 0, np.arange(len(clip))))
    return replace(clip, rotations=clip.rotations[last], root_positions=clip.root_positions[last])


def test_motion_that_is_frozen_in_pauses_is_seen() -> None:
    motion, voice = wandering(60.0), voice_of(np.arange(6000) / 100 % 3.0 >= 2.0)
    free = units.figures(common_body(motion), voice)
    frozen = units.figures(common_body(frozen_in_pauses(motion, voice.silent)), voice)
    assert free["eye_pause_moving"] > 60 > 15 > frozen["eye_pause_moving"]
    assert free["eye_pause_speed"] > 0.7 and frozen["eye_pause_speed"] < 0.3


# ------------------------------------------------------------------------------------------------------ stability

def test_a_take_equals_itself_and_one_that_parts_for_good_does_not() -> None:
    motion = wandering(20.0)
    body = common_body(motion)
    same = stability.difference(body, body)
    assert same.hands == 0.0 and math.isnan(same.healed)
    points = {name: place.copy() for name, place in body.points.items()}
    points["RightHand"][600:] += 0.1
    apart = stability.difference(body, replace(body, points=points))
    assert apart.hands == pytest.approx(100 * 0.1 * math.sqrt(3) / 4) and apart.healed == 0.0


def test_partings_heal_where_the_hands_come_together_soon() -> None:
    apart = np.zeros(1200, bool)
    apart[60:120] = apart[600:1000] = True
    assert stability.healed(apart, 5.0) == 50.0 and stability.healed(apart, 7.0) == 100.0
    assert math.isnan(stability.healed(np.zeros(100, bool), 5.0))


def test_other_lexemes_are_a_share_of_the_time_whatever_the_number_of_blocks() -> None:
    one = np.array([0.0, 0.5, 1.0, 2.0, 2.5]), np.array([1, 2, 3, 4])
    assert stability.other_lexemes(one, one) == 0.0
    assert stability.other_lexemes(one, (one[0], np.array([1, 2, 9, 4]))) == pytest.approx(40.0)
    cut = np.array([0.0, 0.3, 0.5, 1.0, 2.0, 2.5]), np.array([1, 7, 2, 3, 4])  # a beat more, and all the rest the same
    assert stability.other_lexemes(one, cut) == stability.other_lexemes(cut, one) == pytest.approx(8.0)
    late = np.array([0.5, 1.1, 2.0, 3.0]), np.array([2, 3, 5])
    assert stability.other_lexemes(one, late) == pytest.approx(100.0 * (0.1 + 0.5) / 2.0)
    assert math.isnan(stability.other_lexemes(one, (np.array([2.5, 3.0]), np.array([1]))))


# ---------------------------------------------------------------------------------------------------------- pitch

def gliding(seconds: float, seed: int) -> tuple[Speech, Array]:
    """A tone with a harmonic whose pitch wanders, and [T] its frequency at 100 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * 16000)) / 16000
    turns, phases = rng.uniform(0.8, 3.0, 4), rng.uniform(0, 6.28, 4)
    frequency = 150 * np.exp(0.1 * np.sin(turns[:, None] * time + phases[:, None]).sum(axis=0))
    phase = 2 * np.pi * np.cumsum(frequency) / 16000
    return Speech((0.3 * np.sin(phase) + 0.2 * np.sin(2 * phase)).astype(np.float32), 16000), frequency[::160]


def test_pitch_is_followed_and_the_trunk_that_goes_with_it_is_found() -> None:
    recordings = [gliding(5.0, seed) for seed in range(6)]
    tracks = [pitch.pitch_track(speech) for speech, _ in recordings]
    for track, (_, frequency) in zip(tracks, recordings, strict=True):
        logs = np.log(frequency[::5][:len(track)])
        voiced = np.isfinite(track[:len(logs)])
        assert voiced.mean() > 0.9
        assert np.corrcoef(track[:len(logs)][voiced], logs[voiced])[0, 1] > 0.97
    speeds = [20 + 10 * np.nan_to_num(track) / 0.1 for track in tracks]
    at_once = pitch.coupling(tracks, speeds)
    assert at_once.best > 0.9 and at_once.p < 0.05
    late = pitch.coupling(tracks, [np.roll(speed, 9) for speed in speeds])
    assert late.best < 0.8
    assert len(pitch.coupling(tracks[:1], speeds[:1]).chance) == 0


def test_trunk_speed_is_in_degrees_a_second() -> None:
    def move(time: Array) -> dict[str, Array]:
        return {"Spine1": np.stack([0 * time, math.radians(30) * time, 0 * time], 1)}

    speed = pitch.trunk_speed(common_body(posed(4.0, move)))
    assert speed[10:-10] == pytest.approx(30.0, rel=1e-3) and len(speed) == pytest.approx(4 * HZ / 3, abs=2)
