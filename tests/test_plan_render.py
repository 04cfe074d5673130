"""A plan rendered: untouched stretches come back bit for bit, edits do what they say, knobs keep to the body."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from performances import example, write_example

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.types import Array, Speech, Word
from gesticulator import Gesticulator, infer
from gesticulator.body.clips import mirrored_motion
from gesticulator.bundle.features import representation_of
from gesticulator.contacts.columns import TRUNK
from gesticulator.contacts.limbs import pose_of
from gesticulator.directing import shaping
from gesticulator.directing.cues import cues_at
from gesticulator.directing.named_gestures import span_of_gesture
from gesticulator.directing.strokes import FINE, LARGE, REMEMBERED, StrokeMemory
from gesticulator.editing.render import BLEND
from gesticulator.page.session import EditSession
from gesticulator.performance import Performance
from gesticulator.plan.plan import GestureCue, GesturePlan
from interpreters.base import BlockFeatures

SECONDS, SEED = 7.0, 1
REACH = 0.27
"""Seconds: the smoothing's kernel and two frames of a block to either side of what was changed."""


@pytest.fixture(scope="module")
def speech() -> Speech:
    return example(SECONDS)


@pytest.fixture(scope="module")
def drawn(system: Gesticulator, speech: Speech) -> Performance:
    return system(speech, seed=SEED)


@pytest.fixture(scope="module")
def plan(drawn: Performance) -> GesturePlan:
    return drawn.plan()


@pytest.fixture(scope="module")
def plans(system: Gesticulator, drawn: Performance) -> EditSession:
    return EditSession(system, drawn)


def changed(one: Performance, other: Performance) -> tuple[float, float]:
    """From and to which second two performances differ at all."""
    frames = np.flatnonzero((one.rotations != other.rotations).any(axis=(1, 2)))
    assert len(frames), "nothing differs"
    return frames[0] / one.fps, frames[-1] / one.fps


def with_block(plan: GesturePlan, at: int, **edits: object) -> GesturePlan:
    blocks = list(plan.blocks)
    blocks[at] = replace(blocks[at], **edits)  # type: ignore[arg-type]
    return replace(plan, blocks=tuple(blocks))


def hand_speeds(made: Performance) -> Array:
    """[T - 1, 2] m/s, the right hand first."""
    hands = made.positions()[:, [made.joints.index(side + "Hand") for side in ("Right", "Left")]]
    return np.linalg.norm(np.diff(hands, axis=0), axis=-1) * made.fps


def test_a_plan_without_edits_gives_the_same_bytes_with_any_seed(
        system: Gesticulator, speech: Speech, drawn: Performance, plan: GesturePlan) -> None:
    again = system(speech, plan=plan, seed=99)
    np.testing.assert_array_equal(again.rotations, drawn.rotations)
    assert again.plan() == plan


@pytest.mark.parametrize("what", ["lexeme", "silence", "draw", "intensity", "none", "mirror", "moved", "deleted"])
def test_an_edit_changes_its_block_and_the_blend_alone(what: str, plans: EditSession, drawn: Performance,
                                                       plan: GesturePlan) -> None:
    at = 8
    block, after = plan.blocks[at], plan.blocks[at + 1]
    begin, end, blend = block.start, block.end, BLEND
    if what == "lexeme":
        edited = with_block(plan, at, lexeme=next(one.lexeme for one in block.alternatives
                                                  if one.lexeme != block.lexeme))
    elif what == "silence":
        edited = with_block(plan, at, silent=True)
    elif what == "draw":
        edited = with_block(plan, at, draw=replace(block.draw, variation=5))
    elif what in ("intensity", "none", "mirror"):
        fade, edit = {"intensity": (shaping.FADE, {"intensity": 1.7}), "none": (shaping.REST_FADE, {"intensity": 0.0}),
                      "mirror": (shaping.MIRROR_FADE, {"mirror": True})}[what]
        edited, blend, begin, end = with_block(plan, at, **edit), 0.0, begin - fade, end + fade
    else:
        end = after.end
        middle = block.end + 0.04
        two = [replace(block, end=middle), replace(after, start=middle)] if what == "moved" \
            else [replace(block, end=after.end)]
        edited = replace(plan, blocks=(*plan.blocks[:at], *two, *plan.blocks[at + 2:]))
    made = plans.perform(edited)
    first, last = changed(made, drawn)
    assert begin - REACH <= first < block.end and first < last <= end + blend + REACH
    # A hand that was fast is faster by the intensity, and by the way there and back.
    fastest = (2.1 if what == "intensity" else 1.1) * max(hand_speeds(drawn).max(), 3.2)
    assert hand_speeds(made).max() < fastest, "no jump"
    if what == "silence":
        inside = slice(round((block.start + 0.3) * 60), round(block.end * 60))
        assert hand_speeds(made)[inside].mean() < 0.6 * hand_speeds(drawn)[inside].mean()
    # What was made can be written and made again.
    np.testing.assert_array_equal(plans.perform(made.plan()).rotations, made.rotations)


def test_locked_blocks_stay_whatever_knob_is_turned(system: Gesticulator, speech: Speech, drawn: Performance,
                                                    plan: GesturePlan) -> None:
    locked = replace(plan, blocks=tuple(replace(block, locked=block.end <= 4.0) for block in plan.blocks))
    until = max(block.end for block in locked.blocks if block.locked)
    calm = system(speech, plan=locked, energy="calm", mirror=True, hold_still=((1.0, 3.0),))
    assert changed(calm, drawn)[0] >= until - REACH
    assert np.abs(calm.rotations - drawn.rotations)[round((until + 0.5) * 60):].max() > 0.1


def test_the_mirror_exchanges_the_sides_exactly(system: Gesticulator, speech: Speech, drawn: Performance) -> None:
    mirror = system(speech, seed=SEED, mirror=True)
    np.testing.assert_array_equal(mirrored_motion(mirror.motion).rotations, drawn.rotations)
    places, theirs = drawn.positions(), mirror.positions()
    for side, other in (("Left", "Right"), ("Right", "Left")):
        own, seen = drawn.joints.index(side + "Hand"), mirror.joints.index(other + "Hand")
        np.testing.assert_allclose(places[:, own] * [-1, 1, 1], theirs[:, seen], atol=1e-9)


@pytest.mark.parametrize("intensity", [0.0, 0.5, 1.5, 2.0])
def test_intensity_scales_the_hands_and_keeps_them_in_range_and_out_of_the_body(
        intensity: float, system: Gesticulator, speech: Speech, drawn: Performance) -> None:
    made = system(speech, seed=SEED, intensity=intensity)
    np.testing.assert_array_equal(made.lexemes, drawn.lexemes)
    rests = drawn.blocks.silent.nonzero()[0][:1]
    assert len(rests) and drawn.blocks.edges[1] > 0.2
    path = [float(hand_speeds(one)[120:].mean()) for one in (made, drawn)]
    assert path[0] < 0.95 * path[1] if intensity < 1 else path[0] > 1.05 * path[1]
    speaker = system.resolver.speaker(None)
    low, high = (system.bundle.statistics.denormalise(bound, speaker) for bound in system.bundle.statistics.bounds)
    arms = [j for j, name in enumerate(made.joints) if name.endswith(("Shoulder", "Arm", "ForeArm"))]
    angles = rotation.unroll(rotation.to_exponential_map(made.rotations[:, arms])).reshape(len(made.rotations), -1)
    columns = (3 * np.array(arms)[:, None] + np.arange(3)).ravel()
    before = rotation.unroll(rotation.to_exponential_map(drawn.rotations[:, arms])).reshape(angles.shape)
    beyond = np.maximum(angles - high[columns], low[columns] - angles).max()
    # Idle life and smoothing bring the drawing itself to the edge; pushing a hand out of the trunk may take a little.
    assert beyond <= max(np.maximum(before - high[columns], low[columns] - before).max(), 0.0) + 0.16
    for gap in TRUNK.distances(pose_of(made.motion)).values():
        assert gap.min() > -0.01, "no hand in the trunk, at no frame"


def poses_of(made: Performance, step: int = 3) -> tuple[Array, Array]:
    """[M, 3 J] every so-manieth pose as exponential maps, and [M] its seconds."""
    poses = rotation.unroll(rotation.to_exponential_map(made.rotations[::step])).reshape(-1, 3 * len(made.joints))
    return poses, np.arange(len(poses)) * step / made.fps


def sized(count: int, intensity: float, mirrored: float = 0.0) -> shaping.ShapeLevels:
    sizes = np.full(count, intensity)
    return shaping.ShapeLevels(sizes, shaping.rest_share(sizes), np.full(count, mirrored))


@pytest.fixture(scope="module")
def new_shaper(system: Gesticulator) -> Callable[[], shaping.Shaper]:
    return lambda: shaping.Shaper(system.bundle.statistics, representation_of(system.bundle.config), 0)


def test_shaping_needs_no_later_frames_and_can_go_back(new_shaper: Callable[[], shaping.Shaper], drawn: Performance
                                                       ) -> None:
    poses, times = poses_of(drawn)
    asked = sized(len(poses), 0.7)
    whole = new_shaper().shaped(poses, times, asked)
    assert np.abs(whole - poses).max() > 0.05
    shaper = new_shaper()
    for first, last in ((0, 7), (7, 60), (60, 61), (61, 90), (40, 70), (70, len(poses))):  # one of them goes back
        part = slice(first, last)
        got = shaper.shaped(poses[part], times[part], sized(len(poses[part]), 0.7))
        np.testing.assert_allclose(got, whole[part], rtol=0, atol=1e-12)


def test_nothing_asked_is_nothing_done(new_shaper: Callable[[], shaping.Shaper], drawn: Performance) -> None:
    poses, times = poses_of(drawn)
    shaper = new_shaper()
    np.testing.assert_array_equal(shaper.shaped(poses, times, sized(len(poses), 1.0)), poses)
    mirror = sized(len(poses), 1.0, 1.0)
    twice = new_shaper().shaped(new_shaper().shaped(poses, times, mirror), times, mirror)
    np.testing.assert_array_equal(twice, poses)


def test_strokes_grow_and_what_is_slow_keeps_its_speed() -> None:
    """A dimension that goes 1 rad in 0.2 s and then creeps: known answers of the sum."""
    times = np.arange(1, 101) * 0.05
    poses = np.concatenate([np.linspace(0.0, 1.0, 5), 1.0 + 0.01 * np.arange(1, 96)])[:, None]
    large, fine = (StrokeMemory(np.array([0]), scale) for scale in (LARGE, FINE))
    large.push(times, poses)
    fine.push(times, poses)
    brought = large.at(times)[:, 0]
    steps, ways = np.full(4, 0.25), np.array([0.75, 0.5, 0.25, 0.0])  # how much way was gone since each step
    ages = ways / LARGE.path + (times[4] - times[1:5]) / REMEMBERED
    np.testing.assert_allclose(brought[4], np.sum(steps * (1.0 + np.cos(np.pi * ages)) / 2.0), atol=1e-12)
    fades = np.abs(np.diff(brought[4:])).max() / 0.05
    assert fades < 0.5 * np.pi / REMEMBERED, "rad/s with which one radian is forgotten, at most"
    assert 0.9 < brought[4] < 1.0 and 0.3 < brought[-1] < brought[4]
    # Small movements are over once the arm has gone on by their way.
    assert fine.at(times)[:, 0].max() < brought.max()


def test_hands_hold_still_where_they_are_told_and_wake(system: Gesticulator, speech: Speech, drawn: Performance
                                                       ) -> None:
    # Where they would move most.
    moved = hand_speeds(drawn).mean(axis=1)
    start = max(np.arange(1.0, 4.1, 0.25), key=lambda at: moved[round(at * 60):round((at + 1.5) * 60)].mean())
    held = system(speech, seed=SEED, hold_still=((start, start + 1.5),))
    # From the block on in which they begin to settle.
    settles = drawn.blocks.edges[np.searchsorted(drawn.blocks.edges, start - 0.42) - 1]
    assert changed(held, drawn)[0] >= settles - REACH
    speeds = hand_speeds(held)
    still = slice(round((start + 0.05) * 60), round((start + 1.45) * 60))
    # The trunk goes on, and its neck moves as fast: it carries them.
    assert speeds[still].max() < 0.2 < 0.5 * hand_speeds(drawn)[still].mean()
    assert speeds[round((start + 1.8) * 60):].max() > 0.5, "they wake"
    turned, free = (np.abs(np.diff(hand_speeds(one), axis=0)).max(axis=1) * 60 for one in (held, drawn))
    for edge in (start - 0.2, start + 1.5):  # into rest and out of it; elsewhere strokes are as sudden as they are
        assert turned[round((edge - 0.4) * 60):round((edge + 0.4) * 60)].max() < 1.2 * free.max(), "no jump"


def test_a_stream_gets_the_frames_of_a_file_whatever_knobs_are_turned(system: Gesticulator, speech: Speech) -> None:
    asked = {"seed": SEED, "intensity": 1.5, "mirror": True, "hold_still": ((2.0, 3.0),),
             "cues": (GestureCue("wave", time=1.5),)}
    short = replace(speech, samples=speech.samples[:round(4.0 * speech.sample_rate)])
    stream = system.stream(speech.sample_rate, **asked)
    parts = [stream.feed(short.samples[at:at + 1600]) for at in range(0, len(short.samples), 1600)] + [stream.finish()]
    got = np.concatenate([part.rotations for part in parts])
    np.testing.assert_array_equal(got, system(short, **asked).rotations)
    with pytest.raises(InputError, match="whole recording"):
        system.stream(plan=system(short, **asked).plan())


# --------------------------------------------------------------------------------------------------------- cues

def test_a_wave_is_a_wave(system: Gesticulator, speech: Speech, drawn: Performance) -> None:
    made = system(speech, seed=SEED, cues=(GestureCue("wave", time=3.0),))
    before, after = span_of_gesture("wave")
    first, last = changed(made, drawn)
    assert 3.0 - before - REACH <= first and last <= 3.0 + after + REACH
    places = made.positions()[round(3.0 * 60):round(4.3 * 60)]
    hand, shoulder = (places[:, made.joints.index(name)] for name in ("RightHand", "RightArm"))
    assert (hand[:, 1] > shoulder[:, 1]).all(), "beside the head"
    tip = places[:, made.joints.index("RightHandMiddle3"), 0] - places[:, made.joints.index("RightForeArm"), 0]
    swings = np.flatnonzero(np.diff(np.sign(np.diff(tip))))
    assert len(swings) >= 4 and np.ptp(tip) > 0.12, "to and fro"
    assert hand_speeds(made).max() < 1.1 * max(hand_speeds(drawn).max(), 3.2), "no jump"


def test_cues_find_their_words_and_say_what_is_said() -> None:
    words = (Word("Hello,", 0.2, 0.5), Word("you", 0.5, 0.8), Word("hello", 2.0, 2.3))
    cues = [GestureCue("wave", "HELLO"), GestureCue("nod", "hello", 2), GestureCue("stop", time=1.0)]
    due = cues_at(cues, words, 3.0, tuple)
    assert [round(one.time, 3) for one in due] == [0.18, 1.98, 1.0]
    for cue, told in ((GestureCue("wave", "hello", 3), "hello, you"), (GestureCue("wave", "red"), "0 times"),
                      (GestureCue("wavy", "you"), "did you mean wave"),
                      (GestureCue("wave", time=4.0), "not within the 3")):
        with pytest.raises(InputError, match=told):
            cues_at([cue], words, 3.0, tuple)
    with pytest.raises(InputError, match="--text"):
        cues_at([GestureCue("wave", "hello")], (), 3.0, tuple)


def test_a_lexeme_is_asked_for_by_its_name(system: Gesticulator, speech: Speech, plan: GesturePlan) -> None:
    wanted = next(one for one in plan.lexicon if one.name.startswith("both hands"))
    assert len({one.name for one in plan.lexicon}) == len(plan.lexicon) == len(system.bundle.vectors)
    made = system(speech, seed=SEED, cues=(GestureCue(wanted.name, time=5.0),))
    assert made.lexemes[np.searchsorted(made.blocks.edges[1:], 5.0)] == wanted.lexeme
    again = system(speech, plan=plan, cues=(GestureCue(wanted.name, time=5.0),))
    assert again.lexemes[np.searchsorted(again.blocks.edges[1:], 5.0)] == wanted.lexeme


# ----------------------------------------------------------------------------------------------------- mistakes

def test_a_plan_of_something_else_is_refused(system: Gesticulator, speech: Speech, plan: GesturePlan) -> None:
    with pytest.raises(InputError, match="not the one that was given"):
        system(replace(speech, samples=speech.samples * np.float32(0.5)), plan=plan)
    other = replace(plan, made_by={**plan.made_by, "bundle": {"preset": "x", "lexicon": "0"}})
    with pytest.raises(InputError, match="another bundle"):
        system(speech, plan=other)
    with pytest.raises(InputError, match="is determined by the plan"):
        system(speech, plan=plan, speaker="brad")


def test_a_plan_is_written_edited_and_rendered_on_the_command_line(
        tmp_path: Path, refused: Callable[..., str]) -> None:
    sound, out, told = tmp_path / "a.wav", tmp_path / "a.bvh", tmp_path / "plan.json"
    write_example(sound, 3.0, "FLOAT")
    assert infer.main([str(sound), "-o", str(out), "--plan-out", str(told), "--quiet"]) == 0
    first, text = out.read_bytes(), told.read_text()
    assert json.loads(text)["sound"]["name"] == "a.wav"
    assert infer.main([str(sound), "-o", str(out), "--plan", str(told), "--seed", "8", "--quiet"]) == 0
    assert out.read_bytes() == first
    told.write_text(text.replace('"silent": true', '"silent": 3', 1))
    out.unlink()
    line = refused("infer", sound, "-o", out, "--plan", told)
    assert "plan.json: blocks[0].silent: Expected `bool`, got `int`" in line and not out.exists()


class Steady:
    """The interpreter of a user: it likes one lexeme after the other."""

    name = "steady"

    def __init__(self, lexemes: int, first: int = 40) -> None:
        self.lexemes, self.first = lexemes, first

    def start(self, speaker: int, lexeme: int) -> int:
        return self.first

    def step(self, state: int, features: BlockFeatures, lexeme: int) -> tuple[Array, int]:
        return np.eye(self.lexemes)[state % self.lexemes] * 50.0, state + 1


def test_an_interpreter_object_that_is_missing_is_asked_for(system: Gesticulator, speech: Speech) -> None:
    size = len(system.bundle.vectors)
    plan = system(speech, interpreter=Steady(size)).plan()
    assert plan.interpreter == "steady"
    with pytest.raises(InputError, match=r"steady: is not in the bundle"):
        system(speech, plan=plan)
    with pytest.raises(InputError, match="is determined by the plan"):
        system(speech, plan=plan, interpreter="lstm")
