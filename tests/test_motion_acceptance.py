"""The clauses of the acceptance on motion, sound and lexicons whose verdict is known."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bursts import RATE, recording
from hypothesis import given
from hypothesis import strategies as st
from performances import perform
from torch import Tensor
from untrained import PLAIN, untrained

from data_module.blocks import cut
from data_module.motion import rotation
from data_module.motion.bvh import write_bvh
from data_module.motion.movement import Pasts, joined
from data_module.motion.skeletons import CHARACTER
from data_module.store import StoreWriter
from data_module.types import Array, Motion, Speech, Word
from eval.acceptance.motion import command as probe
from eval.acceptance.motion import movements, rest, seen, sounds, steering
from eval.acceptance.motion.movements import ALL, ALONE, HeldOut
from eval.acceptance.motion.rest import Rested
from eval.baselines import controls as baselines
from eval.claim import Verdict
from eval.commands import PROBE
from eval.metrics.eye import ReferenceSpace, common_body, frechet, hear
from eval.metrics.eye.sample import EyeSample
from eval.renderings import TAKE, TEST, AcceptanceVoice, FiledSystem, KeptRenderings, Rendering
from eval.table import load
from gesticulator.bundle import bundle as bundles
from lexicon.movement import MovementLexicon
from lexicon.settings import LexiconConfig

HZ = 60.0


@pytest.fixture(scope="module")
def space() -> ReferenceSpace:
    """A space of noise, so that no outside data is needed."""
    rng = np.random.default_rng(0)
    axes = np.linalg.svd(rng.normal(size=(40, 40)))[2][:10]
    return ReferenceSpace(rng.normal(size=40), rng.uniform(0.5, 2, 40), axes, frechet.Moments(np.zeros(10), np.eye(10)))


def named(clauses: list[Verdict], begin: str) -> Verdict:
    """The one clause whose name begins so."""
    found = [clause for clause in clauses if clause.figure.startswith(begin)]
    assert len(found) == 1, [clause.figure for clause in clauses]
    return found[0]


def moved(seconds: float, size: Array, seed: int = 0) -> Motion:
    """Both arms and the head swing, each on its own; size: [T] how much at each moment."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * HZ)) / HZ
    maps = np.zeros((len(time), len(CHARACTER), 3))
    for joint in ("LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "Head", "Spine1"):
        waves = np.sin(rng.uniform(1.5, 4.0, 3) * time[:, None] + rng.uniform(0, 6, 3))
        maps[:, CHARACTER.index(joint)] = rng.uniform(0.3, 0.5, 3) * waves * size[:, None]
    turns = rotation.continuous(rotation.from_exponential_map(maps))
    return Motion(CHARACTER, turns, np.zeros((len(time), 3)), HZ)


# -------------------------------------------------------------------------------------------------------------- seen

def sampled(motions: list[Motion], space: ReferenceSpace) -> EyeSample:
    out = EyeSample()
    for seed, motion in enumerate(motions):
        speech = recording("one", seed).speech
        out.add(motion, hear(speech), cut(speech).edges, space, group=str(seed), rolled=motion)
    return out


def free(count: int = 3) -> list[Motion]:
    """Arms that move each on its own, one of them twice as much."""
    return [moved(20.0, np.ones(1200), seed) for seed in range(count)]


def verdicts(motions: list[Motion], space: ReferenceSpace, corpus: list[Motion] | None = None) -> list[Verdict]:
    beside = sampled(corpus or free(), space)
    return seen.clauses("x", sampled(motions, space).figures(space, beside), beside.figures(space), True)


def test_mirrored_arms_break_the_clauses_of_two_hands_and_free_ones_keep_them(space: ReferenceSpace) -> None:
    still_trunk = [replace(motion, rotations=np.where(
        np.array([name in ("Head", "Spine1") for name in CHARACTER.names])[:, None], [1.0, 0, 0, 0], motion.rotations))
        for motion in free()]
    mirrored, own = verdicts(baselines.mirrored(still_trunk), space), verdicts(still_trunk, space)
    for begin in ("L/R hand height", "L/R hand speed"):
        assert named(mirrored, begin).holds is False and named(mirrored, begin).value.mean == pytest.approx(1.0)
    assert named(own, "L/R hand speed").holds is True
    assert named(own, "L/R hand height").value.mean < 0.6
    assert named(mirrored, "one-handed").holds is False and named(mirrored, "one-handed").value.mean == 0.0


def test_what_is_the_corpus_itself_is_as_the_corpus(space: ReferenceSpace) -> None:
    own = verdicts(free(), space)
    repeats = named(own, "nearest other 2 s window over spread over")
    assert repeats.holds is True and repeats.value.mean == pytest.approx(1.0)
    distance = named(own, "window Frechet to the corpus")
    assert distance.holds is None and distance.value.mean == pytest.approx(0.0, abs=1e-6)
    assert named(own, "window Frechet to the reference").holds is False, "far from the noise of that space"
    assert named(own, "fingers moving").holds is None


def test_halves_of_one_kind_are_near_and_of_two_kinds_far(space: ReferenceSpace) -> None:
    rng = np.random.default_rng(3)

    def recordings(*centres: float) -> EyeSample:
        sample = EyeSample()
        sample.windows += [rng.normal(centre, 1.0, (80, 40)) for centre in centres]
        return sample

    alike = seen.halves(recordings(*[0.0] * 6), space)
    two = seen.halves(recordings(0.0, 3.0, 0.0, 3.0, 0.0, 3.0), space)
    assert alike.n == two.n == 6 and two.low < two.mean < two.high
    assert two.low > alike.high, "three of six cannot be half of each kind"
    assert math.isnan(seen.halves(recordings(0.0), space).mean)
    clause = seen.halves_clause(recordings(0.0, 3.0), space)
    assert clause.holds is None and clause.value.mean > two.mean, "one against the other"


def test_slow_and_frozen_motion_is_refused(space: ReferenceSpace) -> None:
    whole, slow = (verdicts([moved(20.0, size * np.ones(1200), seed) for seed in range(3)], space)
                   for size in (1.0, 0.2))
    for percent in (25, 50, 75, 95):
        fast, half = (named(each, f"hand speed, {percent} %").value.mean for each in (whole, slow))
        assert half == pytest.approx(0.2 * fast, rel=0.1)
    assert sum(named(slow, f"hand speed, {percent} %").holds is False for percent in (50, 75, 95)) == 3
    frozen = verdicts(baselines.mean_pose(free()), space)
    for begin in ("head on chest", "chest, spread", "stroke amplitude, median", "one-handed", "L/R hand height",
                  "hand speed, 50 %", "head travel", "chest travel", "head with hands", "shoulder lift"):
        assert named(frozen, begin).holds is False, begin


def test_without_a_store_what_is_asked_against_it_is_not_measured(space: ReferenceSpace) -> None:
    alone = seen.clauses("x", sampled(free(), space).figures(space, None), None, True)
    for begin in ("nearest other 2 s", "window Frechet to the corpus", "mean wrist"):
        assert named(alone, begin).holds is None
    assert named(alone, "L/R hand height").holds is not None


def test_mismatch_prefers_who_beats_to_its_own_sound() -> None:
    heard = [hear(recording("one", seed, 21.0).speech) for seed in range(9)]
    still = moved(21.0, np.zeros(1260))
    right = [baselines.bobbing([still], [own.onsets[0]])[0] for own in heard]
    clause = seen.mismatch_clause(list(zip(right, heard, strict=True)))
    assert clause.holds is None and clause.value.mean < 0.001
    wrong = list(zip(right, [*heard[1:], heard[0]], strict=True))
    assert seen.mismatch_clause(wrong).value.mean > 0.05
    first, second = seen.mismatches(list(zip(right, heard, strict=True)))
    assert first.difference.n == second.difference.n == 9 and first.right > first.wrong


# -------------------------------------------------------------------------------------------------------------- rest

def spoken(seconds: float = 40.0) -> Speech:
    """Syllables without a pause of a second."""
    rng = np.random.default_rng(4)
    time = np.arange(round(seconds * RATE)) / RATE
    loud = 0.1 * np.clip(np.sin(2 * np.pi * 3.0 * time), 0, 1) ** 2
    return Speech((loud * rng.normal(size=len(time)) + 1e-4 * rng.normal(size=len(time))).astype(np.float32), RATE)


def test_pauses_are_set_in_with_the_lengths_that_were_told() -> None:
    speech = spoken()
    assert len(sounds.pauses_in(speech)) == 0
    lengths = (1.2, 2.0, 5.0)
    paused = sounds.with_pauses(speech, lengths)
    assert paused.duration == pytest.approx(speech.duration + sum(lengths), abs=1e-3)
    found = sounds.pauses_in(paused)
    assert len(found) == 3
    # A gap between two syllables belongs to the pause that is set into it.
    np.testing.assert_allclose(found[:, 1] - found[:, 0], lengths, atol=0.3)
    np.testing.assert_array_equal(paused.samples, sounds.with_pauses(speech, lengths).samples)


def test_faint_is_46_db_lower_and_noise_has_its_level() -> None:
    level = 20 * np.log10(np.sqrt((sounds.noise(5.0, -40.0, RATE) ** 2).mean()))
    assert level == pytest.approx(-40.0, abs=0.1)
    speech = spoken(5.0)
    low = sounds.faint(speech)
    hiss = sounds.noise(5.0, sounds.HISS, RATE)
    np.testing.assert_allclose(low.samples, speech.samples * 10 ** (-46 / 20) + hiss, atol=1e-7)


def resting(settle: float, life: float) -> tuple[Motion, Speech]:
    """Arms that swing in speech and come to rest `settle` seconds into each pause, where `life` of it is left."""
    speech = sounds.with_pauses(spoken(), (2.0, 5.0, 4.0))
    frames = round(speech.duration * HZ)
    size = np.ones(frames)
    for start, stop in sounds.pauses_in(speech):
        last = round(stop * HZ)
        size[round((start + settle) * HZ):last] = life
        size[last:last + 72] = np.linspace(life, 1.0, 72)
    # Fast enough to be at rest when it is asked for.
    smooth = np.convolve(np.pad(size, 6, mode="edge"), np.ones(13) / 13, mode="valid")
    return moved(frames / HZ, smooth), speech


def test_who_comes_to_rest_at_once_is_accepted_and_who_goes_on_or_comes_late_is_not() -> None:
    calm = Rested.of(*resting(0.2, 0.03))
    good = rest.pause_clauses([calm, calm], ["a", "b"])
    settled = named(good, "hands from .5 to 2.5 s")
    assert settled.holds is None, "short pauses belong to the next preparation"
    assert named(good, "hands from 2.5 s").holds is True
    assert len(calm.settled()) == 3 and calm.in_speech() > 0.3
    for settle, life in ((0.0, 1.0), (1.8, 0.03)):
        bad = rest.pause_clauses([Rested.of(*resting(settle, life))] * 2, ["a", "b"])
        assert named(bad, "hands from .5 to 2.5 s").value.mean > settled.value.mean + 0.1
        assert named(bad, "hands from 2.5 s").holds is (life < 1.0)


def test_a_frozen_head_and_hands_that_stop_are_refused() -> None:
    dead = Rested.of(*resting(0.2, 0.0))
    found = rest.pause_clauses([dead, dead], ["a", "b"])
    freeze = named(found, "longest freeze of the head")
    assert freeze.holds is False and freeze.value.mean == pytest.approx(4.6, abs=0.5)
    assert named(found, "frames in which a hand").holds is False
    lively = rest.life_clauses([common_body(moved(20.0, np.ones(1200)))], ["a"], "x")
    assert [clause.holds for clause in lively] == [True, True]
    assert rest.exact_rest(common_body(moved(5.0, np.zeros(300)))) == 100.0


def test_a_jump_at_waking_is_refused() -> None:
    motion, speech = resting(0.2, 0.03)
    usual = rest.seconds_of(moved(60.0, np.ones(3600)))
    calm = rest.waking_clauses(Rested.of(motion, speech).wakes(), usual)
    assert [clause.holds for clause in calm] == [True, True]
    turns = motion.rotations.copy()
    for _, stop in sounds.pauses_in(speech):
        at = round(stop * HZ)
        turn = rotation.from_exponential_map(np.array([0.0, 0.0, 0.6]))
        turns[at:, CHARACTER.index("RightArm")] = rotation.multiply(turns[at:, CHARACTER.index("RightArm")], turn)
    jumped = rest.waking_clauses(Rested.of(replace(motion, rotations=turns), speech).wakes(), usual)
    assert [clause.holds for clause in jumped] == [False, False]
    assert all(clause.holds is None for clause in rest.waking_clauses(np.zeros((0, 2)), usual))
    assert all(clause.holds is None for clause in rest.waking_clauses(Rested.of(motion, speech).wakes(), None))


def test_twitches_are_moves_too_short_to_be_any() -> None:
    time = np.arange(1200) / HZ
    size = np.zeros(1200)
    for at in (4.0, 8.0, 16.0):
        # There and back within a fifth of a second, 8 cm far: two moves of each hand.
        size += np.where(np.abs(time - at) < 0.1, np.cos(5 * np.pi * (time - at)) ** 2, 0.0)
    quick = Motion(CHARACTER, rotation.from_exponential_map(np.stack([
        size[:, None] * np.array([0, 0, 0.15 * (name in ("LeftArm", "RightArm"))]) for name in CHARACTER.names], 1)),
        np.zeros((1200, 3)), HZ)
    assert rest.twitches(common_body(quick)) == pytest.approx(3 * 2 * 2 * 3.0)
    assert rest.twitches(common_body(moved(20.0, np.ones(1200)))) < 6.0
    quiet, speech = moved(20.0, 0.03 * np.ones(1200)), Speech(np.zeros(20 * RATE, np.float32), RATE)
    still = Rested.of(quiet, speech)
    assert named(rest.quiet_clauses("noise", [still, still]), "time in which").holds is True
    shaken = Rested.of(baselines.jittered([quiet], 0)[0], speech)
    assert named(rest.quiet_clauses("noise", [shaken, shaken]), "time in which").holds is False
    assert rest.faint_clause([shaken], [still]).holds is False
    assert rest.faint_clause([still], [still]).holds is True


def test_activity_must_be_followed_all_the_way() -> None:
    rising = np.linspace(0.0, 1.0, 5)[:, None] * np.array([0.9, 0.8])
    assert [clause.holds for clause in rest.activity_clauses(rising, rising)][:3] == [True, True, True]
    at_once = np.array([0.0, 0.97, 0.97, 0.97, 0.97])[:, None] * np.ones(2)
    found = rest.activity_clauses(at_once, at_once)
    assert found[0].holds is False and found[0].value.mean == pytest.approx(0.707, abs=0.001)
    assert found[1].holds is True
    deaf = rest.activity_clauses(0.5 * np.ones((5, 2)), 0.5 * np.ones((5, 2)))
    assert [clause.holds for clause in deaf][:2] == [False, False]


def test_time_in_speech_is_told_of_spoken_blocks_alone() -> None:
    edges = np.array([0.0, 1.0, 2.0, 4.0])
    size = np.repeat([1.0, 1.0, 0.0], [60, 60, 120])
    made = Rendering(moved(4.0, size), edges, np.array([False, True, False]), np.array([7, 7, 0]))
    share, moving = rest.shares_of(made, np.array([0]), ~made.silent)
    assert share == pytest.approx(1.0 / 3.0)
    fastest = common_body(made.motion).hand_speed.max(axis=1)
    assert moving == pytest.approx(np.concatenate([fastest[:60], fastest[120:]]).__gt__(0.3).mean(), abs=0.02)


# --------------------------------------------------------------------------------------------------------- movements

K, JOINTS = 6, len(CHARACTER)


def held(seed: int, blocks: int = 40) -> HeldOut:
    """Random walks of all joints: a feature is a coordinate, in metres."""
    rng = np.random.default_rng(seed)
    path = torch.as_tensor(np.cumsum(0.05 * rng.normal(size=(blocks * K + 1, 3 * JOINTS)), axis=0)).float()
    return HeldOut(str(seed), path[1:].reshape(blocks, K, -1), torch.full((blocks,), 0.3), path[0],
                   lambda own: own.double().numpy().reshape(*own.shape[:2], JOINTS, 3))


def test_decoding_that_is_right_that_holds_still_and_that_names_postures() -> None:
    recordings = [held(seed) for seed in range(4)]
    right = movements.lexicon_clauses(recordings, {ALL: lambda blocks, past: blocks})
    assert all(named(right, f"{kind} of strokes, all levels, open").value.mean == pytest.approx(1.0)
               for kind in ("within-block R2", "displacement R2"))
    assert all(clause.holds is True for clause in right if "open" in clause.figure)
    assert all(clause.holds is None for clause in right if "closed" in clause.figure)
    stays = movements.lexicon_clauses(recordings, {ALL: lambda blocks, past: past.frames[:, -1:].expand_as(blocks)})
    for kind in ("within-block R2", "displacement R2"):
        clause = named(stays, f"{kind} of strokes, all levels, open")
        assert clause.value.mean == pytest.approx(0.0, abs=1e-6) and clause.holds is False
    posture = movements.lexicon_clauses(
        recordings, {ALL: lambda blocks, past: blocks.mean(1, keepdim=True).expand_as(blocks)})
    assert named(posture, "within-block R2 of strokes, all levels, open").value.mean == pytest.approx(0.0, abs=1e-6)
    assert named(posture, "displacement R2 of strokes, all levels, open").value.mean > 0.5


def test_closed_loop_feeds_back_what_was_decoded() -> None:
    one = held(0)

    def lagging(blocks: Tensor, past: Pasts) -> Tensor:
        """Half of every step from the last frame that is told."""
        return past.frames[:, -1:] + 0.5 * (blocks - past.frames[:, -1:])

    told = movements.closed_loop(lagging, [one])[0]
    last = one.first
    for at, block in enumerate(one.motion):
        expected = last + 0.5 * (block - last)
        torch.testing.assert_close(told[at], expected)
        last = expected[-1]
    opened = movements.open_loop(lagging, one)
    torch.testing.assert_close(opened[5], one.motion[4, -1] + 0.5 * (one.motion[5] - one.motion[4, -1]))
    torch.testing.assert_close(opened[0], told[0])
    # Recordings of different lengths do not touch each other.
    both = movements.closed_loop(lagging, [one, held(1, 7)])
    torch.testing.assert_close(both[0], told)
    assert len(both[1]) == 7


def test_hands_that_are_decoded_as_one_break_the_tie_between_them() -> None:
    right, left = (3 * CHARACTER.index(side + "Hand") + 1 for side in ("Right", "Left"))

    def as_one(blocks: Tensor, past: Pasts) -> Tensor:
        told = blocks.clone()
        told[..., left] = told[..., right]
        return told

    recordings = [held(seed) for seed in range(3)]
    assert named(movements.lexicon_clauses(recordings, {ALL: as_one}), "L/R height correlation, decoded from the truth'"
                 "s, all levels, open").holds is False


def test_only_blocks_with_a_fast_wrist_are_strokes() -> None:
    places = np.zeros((3, K, JOINTS, 3))
    places[1, :, CHARACTER.index("LeftHand"), 0] = np.arange(K) * 0.02
    places[2, :, CHARACTER.index("Head"), 0] = np.arange(K) * 0.1
    # 2 cm a frame: 0.4 m/s in a block of 0.3 s, 0.2 in one of 0.6 s.
    assert movements.stroke_blocks(places, np.full(3, 0.3)).tolist() == [False, True, False]
    assert movements.stroke_blocks(places, np.full(3, 0.6)).tolist() == [False, False, False]


def test_absent_joints_must_not_move_at_all() -> None:
    decoded, present = torch.randn(5, K, 6), torch.tensor([1.0, 1, 1, 0, 0, 1])
    assert movements.absent_clause([decoded], present).holds is False
    decoded[..., 3:5] = 0.0
    assert movements.absent_clause([decoded], present).holds is True
    decoded[2, 1, 3] = 1e-7
    assert movements.absent_clause([decoded], present).holds is False
    assert movements.absent_clause([decoded], torch.ones(6)).holds is None


@given(st.integers(1, 30), st.integers(2, 12), st.integers(0, 1000))
def test_ranks_are_places_in_the_order_of_distance(blocks: int, size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    distances, asked = torch.as_tensor(rng.normal(size=(blocks, size)) ** 2), torch.as_tensor(rng.integers(size,
                                                                                                           size=blocks))
    order = distances.argsort(dim=1)
    ranks = movements.ranks_of(distances, asked)
    assert all(int(order[k, rank]) == int(asked[k]) for k, rank in enumerate(ranks))


def test_obedience_is_a_share_of_all_blocks() -> None:
    obeyed = movements.obedience_clauses([np.array([0, 0, 0, 1]), np.array([0, 4])],
                                         [np.zeros(4, int), np.ones(2, int)], ["a", "b"], np.array([], int))
    assert obeyed[0].value.mean == pytest.approx(4 / 6) and obeyed[0].holds is True
    assert obeyed[1].value.mean == 1.0 and obeyed[1].holds is True
    blind = movements.obedience_clauses([np.arange(10)], [np.arange(10)], ["a"], np.arange(5, 9))
    assert [clause.holds for clause in blind] == [False, False, None]
    assert [clause.value.mean for clause in blind] == pytest.approx([0.1, 0.5, 5 / 6])


def test_silent_lexemes_are_looked_at_after_another_silent_one() -> None:
    edges = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    quiet = np.array([False, True, True, False])
    calm = moved(4.0, np.repeat([1.0, 0.0, 1.0], [100, 100, 40]))
    assert movements.silent_speed(calm, edges, quiet) < 0.1
    assert movements.silent_speed(moved(4.0, np.ones(240)), edges, quiet) > 0.3
    assert math.isnan(movements.silent_speed(calm, edges, np.array([True, False, True, False])))
    made = Rendering(moved(4.0, np.ones(240)), edges, quiet, np.array([3, 1, 1, 3]))
    assert movements.silent_clause([made], np.array([1]), ["a"]).holds is False
    assert movements.silent_clause([made], np.array([2]), ["a"]).holds is None


def movement_lexicon(recordings: list[HeldOut]) -> MovementLexicon:
    """Fitted on these, one part of all numbers."""
    width = recordings[0].motion.shape[-1]
    lexicon = MovementLexicon(LexiconConfig(size=12, levels=(8,)), K, {"body": tuple(range(width))})
    motion = torch.cat([own.motion for own in recordings])
    lexicon.fit(motion, joined(own.pasts() for own in recordings), torch.ones(len(motion), width), seed=0)
    return lexicon


def test_a_lexicon_of_movements_is_told_the_past() -> None:
    recordings = [held(seed) for seed in range(3)]
    lexicon = movement_lexicon(recordings)
    codes = movements.codes_of(lexicon)
    one = recordings[0]
    labels = lexicon.label(one.motion, one.pasts())
    torch.testing.assert_close(movements.open_loop(codes[ALONE], one),
                               lexicon.basis.compose(lexicon.added(labels), one.pasts()))
    found = movements.lexicon_clauses(recordings, codes)
    every, alone = (named(found, f"displacement R2 of strokes, {name}, open").value.mean for name in (ALL, ALONE))
    assert every > alone > 0.0, "more codes tell more, and a lexeme tells something"
    # What was drawn by the codewords themselves, block after block on its own past, is what was asked for.
    asked = np.random.default_rng(0).integers(lexicon.size, size=20)
    past, blocks = Pasts(torch.zeros(1, 3, one.motion.shape[-1]), torch.ones(1)), []
    for lexeme in asked:
        blocks.append(lexicon.basis.compose(lexicon.added(torch.tensor([lexeme])), past)[0])
        past = Pasts(blocks[-1][None, -3:], torch.ones(1))

    class Played:
        block_models = SimpleNamespace(lexicon=lexicon)

        def rest_feature(self, speaker: int) -> Tensor:
            return torch.zeros(one.motion.shape[-1])

    made = Rendering(moved(1.0, np.ones(60)), np.arange(21) * 0.3, lexemes=asked, drawn=torch.stack(blocks).numpy())
    assert movements.encode(Played(), made, 0).tolist() == [0] * 20  # type: ignore[arg-type]
    other = replace(made, lexemes=(asked + 1) % lexicon.size)
    assert (movements.encode(Played(), other, 0) > 0).all()  # type: ignore[arg-type]


# ---------------------------------------------------------------------------------------------------------- steering

def test_controls_must_rise_by_two_centimetres_from_level_to_level() -> None:
    levels = {"low": 0.10, "mid": 0.13, "high": 0.14}
    told = {(feature, level): np.full(4, value) for feature in ("height", "speed", "radius")
            for level, value in levels.items()}
    assert [clause.holds for clause in steering.order_clauses(told)] == [True, False] * 3


def test_the_plan_of_a_performance_has_no_fault_and_broken_ones_are_told() -> None:
    made = perform()
    plan = made.explain()
    assert steering.plan_faults(plan, made.duration) == []
    assert "end at" in steering.plan_faults(plan, made.duration + 1.0)[0]
    assert steering.plan_faults({}, 1.0) == ["no blocks"]
    for block, told in ((plan["blocks"][1] | {"start": 0.01}, "begin"),
                        (plan["blocks"][1] | {"alternatives": plan["blocks"][1]["alternatives"][:4]}, "no 5 lexemes"),
                        (plan["blocks"][1] | {"alternatives": plan["blocks"][1]["alternatives"][::-1]}, "do not fall"),
                        ({"start": 0.0}, "lacks")):
        broken = plan | {"blocks": [plan["blocks"][0], block, *plan["blocks"][2:]]}
        assert told in steering.plan_faults(broken, made.duration)[0]


def test_other_words_keep_their_times_and_more_than_a_tenth_must_change() -> None:
    said = Word("one", 0.1, 0.2), Word("", 0.2, 0.4), Word("two", 0.4, 1)
    speech = Speech(np.zeros(16000, np.float32), 16000, said)
    told = steering.other_words(speech, (Word("red", 0, 1), Word(" ", 1, 2)))
    assert told.words == (Word("red", 0.1, 0.2), Word("", 0.2, 0.4), Word("red", 0.4, 1))
    with pytest.raises(ValueError):
        steering.other_words(speech, ())
    assert steering.words_clause([0.1, 0.1]).holds is False
    assert steering.words_clause([0.1, 0.12]).holds is True
    assert steering.fainter_clause([0.0, 0.02]).holds is True
    assert steering.fainter_clause([0.0, 0.7]).holds is False, "any trifle changes them"


# -------------------------------------------------------------------------------------------------------- renderings

def test_what_is_kept_comes_back_and_what_is_damaged_is_made_again(tmp_path: Path) -> None:
    made = Rendering(moved(2.0, np.ones(120)), np.array([0.0, 0.5, 2.0]), np.array([True, False]), np.array([4, 2]),
                     np.ones((2, K, 48), np.float32), 1.5)
    kept = KeptRenderings(tmp_path / "kept")
    found, file = kept.get(["bundle", 1])
    assert found is None and file is not None
    first = kept.put(made, file)
    again, _ = kept.get(["bundle", 1])
    assert again is not None and again.spent == 1.5 and again.lexemes.tolist() == [4, 2]
    np.testing.assert_array_equal(again.motion.rotations, first.motion.rotations)
    np.testing.assert_allclose(np.abs((again.motion.rotations * made.motion.rotations).sum(-1)), 1.0, atol=1e-6)
    assert again.motion.skeleton.names == CHARACTER.names
    np.testing.assert_array_equal(again.edges, made.edges)
    assert kept.get(["bundle", 2])[0] is None, "another key"
    file.write_bytes(file.read_bytes()[:200])
    assert kept.get(["bundle", 1])[0] is None
    unkept = KeptRenderings(None)
    assert unkept.get(["bundle", 1]) == (None, None)
    np.testing.assert_array_equal(unkept.put(made, None).motion.rotations, first.motion.rotations)


def test_motion_files_are_a_system_with_the_blocks_of_their_plan(tmp_path: Path) -> None:
    one = moved(3.0, np.ones(180))
    for name in ("take.0", "take.1", "talk"):
        write_bvh(tmp_path / f"{name}.bvh", one)
    (tmp_path / "take.1.json").write_text('{"edges": [0.0, 1.0, 3.0]}')
    system = FiledSystem("theirs", tmp_path)
    speech = recording("one", 0, 3.0).speech
    found = system.pairs(AcceptanceVoice("take", speech, TAKE), range(8))
    assert [late for _, late in found] == [None, None]
    assert found[0][0].edges is None and found[1][0].edges is not None and found[1][0].edges.tolist() == [0, 1, 3]
    assert len(system.pairs(AcceptanceVoice("talk", speech, TEST), [0])) == 1
    assert system.pairs(AcceptanceVoice("other", speech, TEST), [0]) == []
    assert all(a.motion.fps == HZ for (a, _), _ in itertools.product(found, [0]))


# --------------------------------------------------------------------------------------------------------- the probe

@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A store of bursts of noise and free arms, and a bundle that nobody trained."""
    folder = tmp_path_factory.mktemp("acceptance")
    writer = StoreWriter(folder / "store", "folder", {}, 1, "free")
    for seed, name in enumerate(("train", "first", "second")):
        writer.add(recording(name, seed, 21.0, "train" if name == "train" else "test"))
    writer.finish(["train", "first", "second"])
    bundles.save(untrained(*PLAIN), folder / "bundle", "a card")
    return folder / "store", folder / "bundle"


def probed(standing: tuple[Path, Path], *more: str) -> int:
    store, bundle = standing
    return PROBE.main("gesticulator probe", ["motion", "--store", str(store), "--bundle", str(bundle), *more])


def test_every_group_is_judged_and_a_second_run_says_the_same(standing: tuple[Path, Path], tmp_path: Path,
                                                              monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    work, out = tmp_path / "work", tmp_path / "motion.json"
    told = ["--work", str(work), "--renderings", "1", "--out", str(out)]
    assert probed(standing, *told, "--only", "motion", "lexicon") == 0
    some = load(out)
    assert list(some[0].rows) == [probe.TITLES["motion"], probe.TITLES["lexicon"]]
    assert probed(standing, *told, "--only", "rest", "effort", "controls", "--write", str(tmp_path / "made")) == 0
    every = load(out)
    assert list(every[0].rows) == list(probe.TITLES.values()), "what was run before is shown beside"
    entries = every[0].facts["clauses"]
    names = [entry["name"] for entry in entries]
    assert len(set(names)) == len(names) > 60
    assert set(entries[0]) == {"name", "value", "low", "high", "n", "bound", "holds", "reason"}
    assert all(entry["holds"] in (True, False) for entry in entries if entry["bound"])
    by_name = {entry["name"]: entry for entry in entries}
    assert by_name["interpreter statistical runs"]["holds"] is True
    assert by_name["interpreter cql runs"]["holds"] is False and "not in the bundle" in by_name[
        "interpreter cql runs"]["reason"]
    assert by_name["faults of the plan (--explain)"]["holds"] is True
    assert by_name["hand controls are heard"]["holds"] is False
    assert list(every[2].columns) == ["bound", "ours", "statistical", "unit selection", "corpus"]
    assert list(every[3].columns) == ["ours", "statistical", "unit selection"]
    before = {file.name: file.stat().st_mtime_ns for file in (work / "renderings").iterdir()}
    first = out.read_bytes()
    assert probed(standing, *told, "--only", "motion", "lexicon", "rest") == 0
    assert {file.name: file.stat().st_mtime_ns for file in (work / "renderings").iterdir()} == before
    assert out.read_bytes() == first
    # What was written is another system, and as good as ours but for rounding.
    assert probed(standing, *told[:4], "--only", "motion", "--system", f"again={tmp_path / 'made'}", "--out", str(
        tmp_path / "again.json")) == 0
    figures = load(tmp_path / "again.json")[2].facts["figures"]
    for row, value in figures["ours"].items():
        if "rolled" not in row:
            assert figures["again"][row]["mean"] == pytest.approx(value["mean"], rel=2e-3, abs=2e-3, nan_ok=True), row


def test_a_bundle_can_stand_beside_another(standing: tuple[Path, Path], tmp_path: Path,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    bundles.save(untrained(*PLAIN, seed=1), tmp_path / "other", "a card")
    assert probed(standing, "--work", str(tmp_path / "work"), "--only", "motion", "--renderings", "1", "--limit", "1",
                  "--system", f"regressing={tmp_path / 'other'}", "--out", str(tmp_path / "motion.json")) == 0
    table = load(tmp_path / "motion.json")[2]
    assert list(table.columns) == ["bound", "ours", "statistical", "regressing", "unit selection", "corpus"]
    assert table.facts["figures"]["ours"]["eye_speed_50"] != table.facts["figures"]["regressing"]["eye_speed_50"]


@pytest.mark.parametrize(("more", "told"), [
    (["--renderings", "0"], "give 1 or more"), (["--limit", "0"], "give 1 or more"),
    (["--system", "ours=x"], "column of its own"), (["--speaker", "nobody"], "nobody"),
    (["--system", "nothing"], "NAME=VALUE"), (["--system", "x=/nowhere"], "is not a folder"),
    (["--only", "everything"], "invalid choice")])
def test_wrong_input_is_refused(standing: tuple[Path, Path], more: list[str], told: str,
                                capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        probed(standing, *more)
    assert caught.value.code == 2 and told in capsys.readouterr().err


def test_without_a_voice_there_is_nothing_to_judge(standing: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    with pytest.raises(SystemExit):
        PROBE.main("gesticulator probe", ["motion", "--bundle", str(standing[1])])
    assert "no voice to gesture for" in capsys.readouterr().err
