"""The bounds of the acceptance: motion that is known to be wrong misses those that are there for it, and a person does
not."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from data_module.motion import kinematics, rotation
from data_module.motion.phases import runs
from data_module.motion.skeletons import find_table
from data_module.types import Array, Motion, Speech
from eval.acceptance import bounds, rest, stimuli, voices
from eval.acceptance.bounds import Measured, Verdict
from eval.acceptance.voices import FIRST_P, PITCH_P, Timed, coupling, timing_figures
from eval.baselines import controls as baselines
from eval.clip.excerpts import real_take
from eval.clip.foreign import read_motion
from eval.metrics import eye
from eval.metrics.eye import common_body
from eval.metrics.eye.body import HZ
from eval.metrics.eye.stability import difference
from eval.metrics.eye.units import Leads
from eval.renderings import TAKE, TEST, AcceptanceVoice
from eval.stats import Interval
from tests.test_eye import elbow, posed
from tests.test_eye_units import frozen_in_pauses

RATE = 16000
ROWS = {row.figure: row for row in bounds.table()["motion"] if row.bound != bounds.ANY and not row.over}
"""Figure -> its row, of the figures that have a bound of their own."""


def one_curl(clips: Sequence[Motion]) -> list[Motion]:
    """Every finger joint of a hand turned as the first joint of its index finger: a paddle that curls."""
    curled = []
    for clip in clips:
        rotations = clip.rotations.copy()
        for side in ("Left", "Right"):
            fingers = [joint for joint, name in enumerate(clip.skeleton.names)
                       if name.startswith(f"{side}Hand") and name[-1].isdigit()]
            rotations[:, fingers] = rotations[:, clip.skeleton.index(f"{side}HandIndex1")][:, None]
        curled.append(replace(clip, rotations=rotations))
    return curled


def rigid_wrists(clips: Sequence[Motion]) -> list[Motion]:
    """Hands in line with their forearms."""
    stiff = []
    for clip in clips:
        rotations = clip.rotations.copy()
        rotations[:, [clip.skeleton.index(side + "Hand") for side in ("Left", "Right")]] = (1.0, 0.0, 0.0, 0.0)
        stiff.append(replace(clip, rotations=rotations))
    return stiff


def splayed(clips: Sequence[Motion], degrees: float = 20.0) -> list[Motion]:
    """Both forearms turned outward about the vertical: the posture of a waiter with two trays."""
    out = []
    for clip in clips:
        skeleton, rotations = clip.skeleton, clip.rotations.copy()
        joints = find_table(skeleton.names)
        world = kinematics.global_rotations(skeleton, clip.rotations)
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            elbow = joints[side + "ForeArm"]
            turn = rotation.from_exponential_map(np.array([0.0, sign * math.radians(degrees), 0.0]))
            above = world[:, skeleton.parents[elbow]]
            # The turn is about the world's vertical, and rotations are told in the parent's frame.
            rotations[:, elbow] = rotation.multiply(
                rotation.conjugate(above), rotation.multiply(turn, world[:, elbow]))
        out.append(replace(clip, rotations=rotation.continuous(rotations)))
    return out


def judge(figures: Mapping[str, Interval]) -> dict[str, Verdict]:
    """Figure -> its verdict on the voice of the real take."""
    results = {(name, voices.ON_TAKE): Measured(figures.get(name, Interval.undefined())) for name in ROWS}
    return {name: row.judge(results)[0] for name, row in ROWS.items()}


# ---------------------------------------------------------------------------------------------------- one real person

@pytest.fixture(scope="module")
def scott(outside_data: Path) -> AcceptanceVoice:
    """The real take on its own rig."""
    take = real_take(HZ, own_rig=True)
    assert take is not None
    return AcceptanceVoice("take", take[1], TAKE, take[0])


@pytest.fixture(scope="module")
def character(outside_data: Path) -> Motion:
    """The same on the character with fingers."""
    return read_motion(next((outside_data / "takes" / "beat_scott").glob("*.bvh")), 15.0, fingers=True)


def missed(motion: Motion, said: AcceptanceVoice) -> set[str]:
    """The figures by which a motion is refused."""
    figures = {name: Interval.exact(value, 1) for name, value in eye.figures(motion, said.heard).items()}
    return {name for name, verdict in judge(figures).items() if verdict.holds is False}


def test_a_real_person_passes_most_of_the_table(scott: AcceptanceVoice) -> None:
    assert scott.own is not None
    refused = missed(scott.own, scott)
    # He hangs both arms for long stretches, and that is all that is held against him.
    assert refused == {"eye_both_hanging"}, refused
    decided = [verdict for verdict in judge(voices.own_motion([scott]).figures()).values()
               if verdict.holds is not None]
    assert len(decided) > 25 and sum(verdict.holds is True for verdict in decided) >= len(decided) - 1


@pytest.mark.parametrize(("wrong", "by"), [
    (splayed, {"eye_splay", "eye_splay_both", "eye_azimuth"}),
    (baselines.mean_pose, {"eye_chest_travel", "eye_head_travel", "eye_shoulder", "eye_fingers", "eye_head"}),
    (one_curl, {"eye_finger_between", "eye_thumb_index"}),
    (rigid_wrists, {"eye_wrist_95"}),
    (baselines.mirrored, {"eye_hand_height_correlation", "eye_one_handed"}),
    (partial(baselines.jittered, seed=0), {"eye_fast"})])
def test_every_control_is_refused_by_the_bounds_that_are_there_for_it(
        wrong: Callable[[list[Motion]], list[Motion]], by: set[str], scott: AcceptanceVoice, character: Motion) -> None:
    assert not by & missed(character, scott) - {"eye_finger_between"}, "the motion itself passes"
    assert by <= missed(wrong([character])[0], scott)


def test_motion_that_freezes_in_pauses_is_refused(scott: AcceptanceVoice, character: Motion) -> None:
    frozen = frozen_in_pauses(character, scott.heard.silent)
    assert "eye_pause_moving" in missed(frozen, scott) - missed(character, scott)


def test_an_unequal_take_of_a_quieter_sound_is_refused_and_the_same_take_is_not(character: Motion) -> None:
    other = baselines.jittered([character], 0, 0.05)[0]
    for motion, holds in ((character, True), (other, False)):
        apart = difference(common_body(character), common_body(motion))
        figures = {"hands_apart": apart.hands, "healed": apart.healed, "lexemes_apart": 0.0 if holds else 29.0}
        results = {(name, on): Measured(Interval.exact(value, 1)) for name, value in figures.items()
                   for on in stimuli.EXPORTS}
        verdicts = bounds.judge(bounds.table()["stability"], results)
        assert len(verdicts) == 15 and {verdict.holds for verdict in verdicts} - {None} == {holds}


def test_the_speeds_of_people_are_those_of_the_bands(outside_data: Path) -> None:
    import json

    held = json.loads((outside_data / "real_bands.json").read_text())
    for percent in (25, 50, 75, 95):
        speed, bound = held[f"v{percent}"]["all"]["mean"], ROWS[f"eye_speed_{percent}"].bound
        assert (bound.low, bound.high) == pytest.approx((0.75 * speed, 1.25 * speed), abs=0.0008)


# --------------------------------------------------------------------------------------------------------- the table

def table(**changed: float) -> dict[str, Verdict]:
    """Figures in the middle of their bounds but for these."""
    middle = {name: (max(row.bound.low, -99.0) + min(row.bound.high, 99.0)) / 2 for name, row in ROWS.items()}
    return judge({name: Interval.exact(value, 2) for name, value in (middle | changed).items()})


@pytest.mark.parametrize("name", ROWS)
def test_a_figure_beyond_its_bound_is_refused_alone(name: str) -> None:
    assert all(verdict.holds for verdict in table().values())
    bound = ROWS[name].bound
    for beyond in (bound.low - 0.001, bound.high + 0.001):
        if math.isfinite(beyond):
            verdicts = table(**{name: beyond})
            assert [figure for figure, verdict in verdicts.items() if verdict.holds is False] == [name]


def test_what_a_motion_or_a_voice_lacks_is_left_out_and_what_it_should_have_is_not() -> None:
    of_fingers = [name for name, row in ROWS.items() if row.needs == bounds.FINGERS]
    nothing = table(**dict.fromkeys(of_fingers, math.nan))
    assert len(of_fingers) == 5 and all(nothing[name].holds is None for name in of_fingers)
    # Fingers that never move have no correlation, which is no excuse.
    assert table(eye_thumb_index=math.nan)["eye_thumb_index"].holds is False
    assert table(eye_azimuth=math.nan)["eye_azimuth"].holds is False
    assert table(eye_pause_moving=math.nan)["eye_pause_moving"].holds is None


# ------------------------------------------------------------------------------------------------ pooled, with sound

def spoken(seed: int, seconds: float = 26.0) -> tuple[Speech, NDArray[np.float64], NDArray[np.float64]]:
    """A humming voice with pauses of 1.2 to 1.8 s, its log pitch [T] at 60 Hz, and seconds at which it returns."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    wave = sum(0.12 * np.sin(rng.uniform(2.0, 6.0) * time + rng.uniform(0, 6)) for _ in range(3))
    phase = 2 * np.pi * np.cumsum(140.0 * np.exp(wave)) / RATE
    voice = 0.1 * sum(np.sin(k * phase) / k for k in range(1, 8))
    # The first pause may come at any time, so that those of two voices do not fall together.
    ends = rng.uniform(2.0, 7.0) + np.cumsum(rng.uniform(2.5, 5.0, 12)) - 2.5
    ends = ends[ends < seconds - 4.0]
    begins = ends + rng.uniform(1.2, 1.8, len(ends))
    for end, begin in zip(ends, begins, strict=True):
        voice[round(end * RATE):round(begin * RATE)] = 0.0
    voice = voice + 1e-4 * rng.normal(size=len(time))
    return Speech(voice.astype(np.float32), RATE), np.interp(np.arange(0, seconds, 1 / HZ), time, wave), begins


def answering(pitch: Array, begins: Array, early: float = 0.25) -> Motion:
    """A trunk that turns as fast as the pitch is high, and a hand that starts so early before the voice returns."""
    def move(time: Array) -> dict[str, Array]:
        since = time[:, None] - (begins - early)
        swing = np.where((since > 0) & (since < 1), 0.6 * (1 - np.cos(2 * np.pi * since)), 0.0).sum(axis=1)
        speed = 0.3 + pitch[:len(time)]
        turn = np.cumsum(speed * np.sign(np.sin(2 * np.pi * time / 9.0))) / HZ
        return {"RightForeArm": elbow("Right", swing), "Spine1": turn[:, None] * np.array([0.0, 1.0, 0.0])}

    return posed(len(pitch) / HZ, move)


@cache
def recordings() -> list[tuple[AcceptanceVoice, Motion]]:
    out = []
    for seed in range(6):
        speech, pitch, begins = spoken(seed)
        out.append((AcceptanceVoice(str(seed), speech, TEST), answering(pitch, begins)))
    return out


def test_who_answers_the_voice_is_beyond_chance_and_under_anothers_sound_is_not() -> None:
    voices, motions = zip(*recordings(), strict=True)
    right = [Timed.of(motion, said) for said, motion in zip(voices, motions, strict=True)]
    wrong = [Timed.of(motion, said) for said, motion in zip((*voices[1:], voices[0]), motions, strict=True)]
    answers, deaf = ({name: measured.value for name, measured in timing_figures(timed).items()}
                     for timed in (right, wrong))
    coupled = coupling(right)
    assert coupled is not None and coupled.best > 0.5
    assert Leads.pooled([clip.first for clip in right]).before == 100.0
    for name in (PITCH_P, FIRST_P):
        assert judge(answers)[name].holds is True and judge(deaf)[name].holds is False, name


def test_one_voice_alone_proves_nothing() -> None:
    said, motion = recordings()[0]
    one = Timed.of(motion, said)
    figures = {name: measured.value for name, measured in timing_figures([one] * 3).items()}
    assert math.isnan(figures[PITCH_P].mean) and math.isnan(figures[FIRST_P].mean)
    verdicts = judge(figures)
    assert verdicts[PITCH_P].holds is None and verdicts[FIRST_P].holds is None
    few = timing_figures([replace(one, name=str(k)) for k in range(voices.FEWEST - 1)])
    assert math.isnan(few[PITCH_P].value.mean) and math.isfinite(few[FIRST_P].value.mean)
    silent = AcceptanceVoice("s", Speech(np.zeros(20 * RATE, np.float32), RATE), TEST)
    assert coupling([Timed.of(motion, silent)]) is None


# ------------------------------------------------------------------------------------------------- speech on and on

def test_pauses_are_cut_out_and_the_speech_stays() -> None:
    speech, _, begins = spoken(3)
    whole = stimuli.unbroken(speech)
    assert len(begins) > 3
    # Frames of 10 ms that hold no voice: 40 ms about each cut are left.
    loud, left = (np.abs(own.samples[:len(own.samples) // 160 * 160].reshape(-1, 160)).max(axis=1) > 0.01
                  for own in (speech, whole))
    assert left.sum() == pytest.approx(loud.sum(), abs=20) and whole.duration < speech.duration - 3.0
    assert max(stop - start for start, stop in runs(~left)) < 20
    # No step where two pieces meet is larger than those of the voice itself.
    assert np.abs(np.diff(whole.samples)).max() <= 1.05 * np.abs(np.diff(speech.samples)).max()
    silence = Speech(np.zeros(RATE, np.float32), RATE)
    assert stimuli.unbroken(silence) is silence


def test_who_goes_on_at_one_pace_does_not_wax_and_wane() -> None:
    def swinging(size: Callable[[Array], Array]) -> eye.CommonBody:
        return common_body(posed(40.0, lambda time: {"RightForeArm": elbow("Right", 1.0 + size(time) * np.sin(
            5.0 * time))}))

    even, rising = swinging(lambda time: 0.5 + 0 * time), swinging(lambda time: 0.5 + 0.25 * np.sin(time / 3.0))
    for body, holds in ((even, False), (rising, True)):
        results = {("variation", rest.UNBROKEN): Measured(rest.variation([body], ["a"]))}
        assert [verdict.holds for verdict in bounds.judge(bounds.table()["rest"], results)] == [holds]
