"""The clauses of the acceptance on motion, sound and lexicons whose verdict is known."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from bursts import RATE, recording
from hypothesis import given
from hypothesis import strategies as st
from performances import example
from torch import Tensor
from untrained import PLAIN, untrained

from data_module.blocks import cut
from data_module.motion import rotation
from data_module.motion.movement import Pasts, joined
from data_module.motion.skeletons import CHARACTER
from data_module.speech.audio import SAMPLE_RATE
from data_module.store import StoreWriter
from data_module.types import Array, Motion, Speech, Word
from eval.acceptance import command, response, rest, stimuli, voices
from eval.acceptance import lexicon as movements
from eval.acceptance.bounds import Measured, Results, Verdict, judge, table
from eval.acceptance.lexicon import HeldOut
from eval.acceptance.rest import Rested
from eval.acceptance.stimuli import LIVELY, SUBDUED, loudness, said_with, tilted
from eval.baselines import controls as baselines
from eval.metrics.eye import ReferenceSpace, common_body, hear
from eval.metrics.eye.pitch import pitch_track
from eval.metrics.eye.sample import EyeSample
from eval.metrics.fgd import Gaussian
from eval.renderings import Rendering
from eval.stats import mean_interval
from eval.table import load
from gesticulator.bundle import bundle as bundles
from gesticulator.cli import main
from lexicon.movement import MovementLexicon
from lexicon.settings import LexiconConfig
from tests.test_eye import elbow, posed

HZ = 60.0


def verdicts_of(group: str, results: Results) -> dict[tuple[str, str], Verdict]:
    """(Figure, set) -> the verdict of the table of bounds."""
    return {(row.figure, on): verdict for row in table()[group]
            for on, verdict in zip(row.sets(results), row.judge(results), strict=True)}


def holds(group: str, results: Results, figure: str) -> list[bool | None]:
    """The verdicts on a figure, in the order of its sets."""
    return [verdict.holds for (name, _), verdict in verdicts_of(group, results).items() if name == figure]


@pytest.fixture(scope="module")
def space() -> ReferenceSpace:
    """A space of noise, so that no outside data is needed."""
    rng = np.random.default_rng(0)
    axes = np.linalg.svd(rng.normal(size=(40, 40)))[2][:10]
    return ReferenceSpace(rng.normal(size=40), rng.uniform(0.5, 2, 40), axes, Gaussian(np.zeros(10), np.eye(10)))


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


# ------------------------------------------------------------------------------------------------------------- voices

def sampled(motions: list[Motion]) -> EyeSample:
    out = EyeSample()
    for seed, motion in enumerate(motions):
        speech = recording("one", seed).speech
        out.add(motion, hear(speech), cut(speech).edges, group=str(seed))
    return out


def free(count: int = 3) -> list[Motion]:
    """Arms that move each on its own, one of them twice as much."""
    return [moved(20.0, np.ones(1200), seed) for seed in range(count)]


def judged(motions: list[Motion], space: ReferenceSpace, corpus: list[Motion] | None = None) -> dict[str, Verdict]:
    """Figure -> its verdict on the voice of the real take, beside a corpus."""
    beside = sampled(corpus or free())
    results = {(name, voices.ON_TAKE): Measured(value)
               for name, value in sampled(motions).figures(space).items()}
    results |= {(name, "corpus"): Measured(value) for name, value in beside.figures(space).items()}
    return {figure: verdict for (figure, on), verdict in verdicts_of("motion", results).items()
            if on == voices.ON_TAKE}


def test_mirrored_arms_break_the_clauses_of_two_hands_and_free_arms_keep_them(space: ReferenceSpace) -> None:
    still_trunk = [replace(motion, rotations=np.where(
        np.array([name in ("Head", "Spine1") for name in CHARACTER.names])[:, None], [1.0, 0, 0, 0], motion.rotations))
        for motion in free()]
    mirrored, real = judged(baselines.mirrored(still_trunk), space), judged(still_trunk, space)
    for figure in ("eye_hand_height_correlation", "eye_hand_speed_correlation"):
        assert mirrored[figure].holds is False and mirrored[figure].value.mean == pytest.approx(1.0)
    assert real["eye_hand_speed_correlation"].holds is True
    assert real["eye_hand_height_correlation"].value.mean < 0.6
    assert mirrored["eye_one_handed"].holds is False and mirrored["eye_one_handed"].value.mean == 0.0


def test_the_corpus_itself_is_as_the_corpus(space: ReferenceSpace) -> None:
    real = judged(free(), space)
    assert real["eye_repetition"].holds is True and real["eye_repetition"].value.mean == pytest.approx(1.0)
    assert real["eye_frechet_pooled"].holds is False, "far from the noise of that space"
    assert real["eye_fingers"].holds is None


def test_slow_and_frozen_motion_is_refused(space: ReferenceSpace) -> None:
    whole, slow = (judged([moved(20.0, size * np.ones(1200), seed) for seed in range(3)], space)
                   for size in (1.0, 0.2))
    for percent in (25, 50, 75, 95):
        fast, half = (each[f"eye_speed_{percent}"].value.mean for each in (whole, slow))
        assert half == pytest.approx(0.2 * fast, rel=0.1)
    assert sum(slow[f"eye_speed_{percent}"].holds is False for percent in (50, 75, 95)) == 3
    frozen = judged(baselines.mean_pose(free()), space)
    for figure in ("eye_head", "eye_chest", "eye_stroke_amplitude", "eye_one_handed", "eye_hand_height_correlation",
                   "eye_speed_50", "eye_head_travel", "eye_chest_travel", "eye_head_with_hands", "eye_shoulder"):
        assert frozen[figure].holds is False, figure


def test_without_a_store_what_is_relative_to_it_is_not_judged(space: ReferenceSpace) -> None:
    results = {(name, voices.ON_TAKE): Measured(value)
               for name, value in sampled(free()).figures(space).items()}
    for figure in ("eye_repetition", "eye_drift"):
        assert holds("motion", results, figure) == [None]
    assert holds("motion", results, "eye_hand_height_correlation") != [None]


# -------------------------------------------------------------------------------------------------------------- rest

def spoken(seconds: float = 40.0) -> Speech:
    """Syllables without a pause of a second."""
    rng = np.random.default_rng(4)
    time = np.arange(round(seconds * RATE)) / RATE
    loud = 0.1 * np.clip(np.sin(2 * np.pi * 3.0 * time), 0, 1) ** 2
    return Speech((loud * rng.normal(size=len(time)) + 1e-4 * rng.normal(size=len(time))).astype(np.float32), RATE)


def test_pauses_are_set_in_with_the_lengths_that_were_told() -> None:
    speech = spoken()
    assert len(stimuli.pauses_in(speech)) == 0
    lengths = (1.2, 2.0, 5.0)
    paused = stimuli.with_pauses(speech, lengths)
    assert paused.duration == pytest.approx(speech.duration + sum(lengths), abs=1e-3)
    found = stimuli.pauses_in(paused)
    assert len(found) == 3
    # A gap between two syllables belongs to the pause that is set into it.
    np.testing.assert_allclose(found[:, 1] - found[:, 0], lengths, atol=0.3)
    np.testing.assert_array_equal(paused.samples, stimuli.with_pauses(speech, lengths).samples)


def test_faint_is_46_db_lower_and_noise_has_its_level() -> None:
    level = 20 * np.log10(np.sqrt((stimuli.noise(5.0, -40.0, RATE) ** 2).mean()))
    assert level == pytest.approx(-40.0, abs=0.1)
    speech = spoken(5.0)
    low = stimuli.faint(speech)
    hiss = stimuli.noise(5.0, stimuli.FAINT_NOISE, RATE)
    np.testing.assert_allclose(low.samples, speech.samples * 10 ** (-46 / 20) + hiss, atol=1e-7)


def resting(settle: float, life: float) -> tuple[Motion, Speech]:
    """Arms that swing in speech and come to rest `settle` seconds into each pause, where `life` of it is left."""
    speech = stimuli.with_pauses(spoken(), (2.0, 5.0, 4.0))
    frames = round(speech.duration * HZ)
    size = np.ones(frames)
    for start, stop in stimuli.pauses_in(speech):
        last = round(stop * HZ)
        size[round((start + settle) * HZ):last] = life
        size[last:last + 72] = np.linspace(life, 1.0, 72)
    # Fast enough to be at rest when it is asked for.
    smooth = np.convolve(np.pad(size, 6, mode="edge"), np.ones(13) / 13, mode="valid")
    return moved(frames / HZ, smooth), speech


def test_coming_to_rest_is_accepted_and_going_on_is_not() -> None:
    calm = Rested.of(*resting(0.2, 0.03))
    assert holds("rest", rest.pause_figures([calm, calm], ["a", "b"]), "at_rest") == [True]
    assert calm.in_speech() > 0.3
    restless = Rested.of(*resting(0.0, 1.0))
    assert holds("rest", rest.pause_figures([restless] * 2, ["a", "b"]), "at_rest") == [False]


def test_a_frozen_head_and_hands_that_stop_are_refused() -> None:
    dead = Rested.of(*resting(0.2, 0.0))
    figures = rest.pause_figures([dead, dead], ["a", "b"])
    assert holds("rest", figures, "longest_freeze") == holds("rest", figures, "exact_rest") == [False]
    assert figures["longest_freeze", rest.PAUSES].value.mean == pytest.approx(4.6, abs=0.5)
    lively = rest.life_figures([common_body(moved(20.0, np.ones(1200)))], ["a"], rest.PAUSES)
    assert holds("rest", lively, "longest_freeze") == holds("rest", lively, "exact_rest") == [True]
    still = rest.life_figures([common_body(moved(5.0, np.zeros(300)))], ["a"], rest.PAUSES)
    assert still["exact_rest", rest.PAUSES].value.mean == 100.0


def waking(wakes: Array, usual: Array | None) -> list[bool | None]:
    figures = rest.waking_figures(wakes, usual)
    return holds("rest", figures, "wake_acceleration") + holds("rest", figures, "wake_speed")


def test_a_jump_at_waking_is_refused() -> None:
    motion, speech = resting(0.2, 0.03)
    usual = rest.seconds_of(moved(60.0, np.ones(3600)))
    assert waking(Rested.of(motion, speech).wakes(), usual) == [True, True]
    turns = motion.rotations.copy()
    for _, stop in stimuli.pauses_in(speech):
        at = round(stop * HZ)
        turn = rotation.from_exponential_map(np.array([0.0, 0.0, 0.6]))
        turns[at:, CHARACTER.index("RightArm")] = rotation.multiply(turns[at:, CHARACTER.index("RightArm")], turn)
    assert waking(Rested.of(replace(motion, rotations=turns), speech).wakes(), usual) == [False, False]
    assert waking(np.zeros((0, 2)), usual) == [None, None]
    assert waking(Rested.of(motion, speech).wakes(), None) == [None, None]


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
    assert holds("rest", rest.quiet_figures([still, still], "in noise"), "quiet_moving") == [True]
    shaken = Rested.of(baselines.jittered([quiet], 0)[0], speech)
    assert holds("rest", rest.quiet_figures([shaken, shaken], "in noise"), "quiet_moving") == [False]
    assert holds("rest", rest.twitch_figures([shaken], [still]), "twitches") == [False]
    assert holds("rest", rest.twitch_figures([still], [still]), "twitches") == [True]


def activity(shares: Array) -> list[bool | None]:
    figures = rest.activity_figures(shares, shares)
    return holds("rest", figures, "activity_rank") + holds("rest", figures, "activity_rise")


def test_activity_must_be_followed_all_the_way() -> None:
    assert activity(np.linspace(0.0, 1.0, 5)[:, None] * np.array([0.9, 0.8])) == [True, True, True, None]
    at_once = np.array([0.0, 0.97, 0.97, 0.97, 0.97])[:, None] * np.ones(2)
    assert activity(at_once) == [False, False, True, None]
    assert rest.activity_figures(at_once, at_once)["activity_rank", "a hand that moves"].value.mean == pytest.approx(
        0.707, abs=0.001)
    assert activity(0.5 * np.ones((5, 2))) == [False, False, False, None]


def test_time_in_speech_is_of_spoken_blocks_alone() -> None:
    edges = np.array([0.0, 1.0, 2.0, 4.0])
    size = np.repeat([1.0, 1.0, 0.0], [60, 60, 120])
    made = Rendering(moved(4.0, size), edges, np.array([False, True, False]), np.array([7, 7, 0]))
    share, moving = rest.shares_of(made, np.array([0]), ~made.silent)
    assert share == pytest.approx(1.0 / 3.0)
    fastest = common_body(made.motion).hand_speed.max(axis=1)
    assert moving == pytest.approx(np.concatenate([fastest[:60], fastest[120:]]).__gt__(0.3).mean(), abs=0.02)


# ------------------------------------------------------------------------------------------------------------ lexicon

K, JOINTS = 6, len(CHARACTER)


def held(seed: int, blocks: int = 40) -> HeldOut:
    """Random walks of all joints: a feature is a coordinate, in metres."""
    rng = np.random.default_rng(seed)
    path = torch.as_tensor(np.cumsum(0.05 * rng.normal(size=(blocks * K + 1, 3 * JOINTS)), axis=0)).float()
    return HeldOut(path[1:].reshape(blocks, K, -1), torch.full((blocks,), 0.3), path[0],
                   lambda own: own.double().numpy().reshape(*own.shape[:2], JOINTS, 3))


def figures_of(recordings: list[HeldOut], decode: Callable[[Tensor, Pasts], Tensor]) -> dict[str, Verdict]:
    """Figure -> its verdict of a way to decode."""
    results = movements.lexicon_figures(recordings, [decode(own.motion, own.pasts()) for own in recordings])
    return {figure: verdict for (figure, _), verdict in verdicts_of("lexicon", results).items()}


def test_decoding_that_is_right_that_holds_still_and_that_names_postures() -> None:
    recordings = [held(seed) for seed in range(4)]
    kinds = ("within_r2", "displacement_r2")
    right = figures_of(recordings, lambda blocks, past: blocks)
    assert all(right[kind].value.mean == pytest.approx(1.0) for kind in kinds)
    assert all(verdict.holds for verdict in right.values())
    stays = figures_of(recordings, lambda blocks, past: past.frames[:, -1:].expand_as(blocks))
    for kind in kinds:
        assert stays[kind].value.mean == pytest.approx(0.0, abs=1e-6) and stays[kind].holds is False
    posture = figures_of(recordings, lambda blocks, past: blocks.mean(1, keepdim=True).expand_as(blocks))
    assert posture["within_r2"].value.mean == pytest.approx(0.0, abs=1e-6)
    assert posture["displacement_r2"].value.mean > 0.5
    right_hand, left_hand = (3 * CHARACTER.index(side + "Hand") + 1 for side in ("Right", "Left"))

    def as_one(blocks: Tensor, past: Pasts) -> Tensor:
        tied = blocks.clone()
        tied[..., left_hand] = tied[..., right_hand]
        return tied

    assert figures_of(recordings, as_one)["heights_apart"].holds is False, "two hands that are decoded as one"


def test_only_blocks_with_a_fast_wrist_are_strokes() -> None:
    places = np.zeros((3, K, JOINTS, 3))
    places[1, :, CHARACTER.index("LeftHand"), 0] = np.arange(K) * 0.02
    places[2, :, CHARACTER.index("Head"), 0] = np.arange(K) * 0.1
    # 2 cm a frame: 0.4 m/s in a block of 0.3 s, 0.2 in one of 0.6 s.
    assert movements.stroke_blocks(places, np.full(3, 0.3)).tolist() == [False, True, False]
    assert movements.stroke_blocks(places, np.full(3, 0.6)).tolist() == [False, False, False]


def test_absent_joints_must_not_move_at_all() -> None:
    decoded, present = torch.randn(5, K, 6), torch.tensor([1.0, 1, 1, 0, 0, 1])
    assert holds("lexicon", {("absent", ""): movements.absent_figure([decoded], present)}, "absent") == [False]
    decoded[..., 3:5] = 0.0
    assert holds("lexicon", {("absent", ""): movements.absent_figure([decoded], present)}, "absent") == [True]
    decoded[2, 1, 3] = 1e-7
    assert holds("lexicon", {("absent", ""): movements.absent_figure([decoded], present)}, "absent") == [False]
    assert holds("lexicon", {("absent", ""): movements.absent_figure([decoded], torch.ones(6))}, "absent") == [None]


@given(st.integers(1, 30), st.integers(2, 12), st.integers(0, 1000))
def test_ranks_are_places_in_the_order_of_distance(blocks: int, size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    distances, asked = torch.as_tensor(rng.normal(size=(blocks, size)) ** 2), torch.as_tensor(rng.integers(size,
                                                                                                           size=blocks))
    order = distances.argsort(dim=1)
    ranks = movements.ranks_of(distances, asked)
    assert all(int(order[k, rank]) == int(asked[k]) for k, rank in enumerate(ranks))


def obedience(*arguments: object) -> list[Verdict]:
    results = movements.obedience_figures(*arguments)  # type: ignore[arg-type]
    return list(verdicts_of("lexicon", results).values())


def test_obedience_is_a_share_of_all_blocks() -> None:
    obeyed = obedience([np.array([0, 0, 0, 1]), np.array([0, 4])], [np.zeros(4, int), np.ones(2, int)], ["a", "b"])
    assert obeyed[0].value.mean == pytest.approx(4 / 6) and obeyed[0].holds is True
    assert obeyed[1].value.mean == 1.0 and obeyed[1].holds is True
    blind = obedience([np.arange(10)], [np.arange(10)], ["a"])
    assert [verdict.holds for verdict in blind] == [False, False]
    assert [verdict.value.mean for verdict in blind] == pytest.approx([0.1, 0.5])


def test_silent_lexemes_are_looked_at_after_another_silent_one() -> None:
    edges = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    quiet = np.array([False, True, True, False])
    calm = moved(4.0, np.repeat([1.0, 0.0, 1.0], [100, 100, 40]))
    assert movements.silent_speed(calm, edges, quiet) < 0.1
    assert movements.silent_speed(moved(4.0, np.ones(240)), edges, quiet) > 0.3
    assert math.isnan(movements.silent_speed(calm, edges, np.array([True, False, True, False])))
    made = Rendering(moved(4.0, np.ones(240)), edges, quiet, np.array([3, 1, 1, 3]))
    for silent, expected in ((1, False), (2, None)):
        results = {("silent_speed", ""): movements.silent_figure([made], np.array([silent]), ["a"])}
        assert holds("lexicon", results, "silent_speed") == [expected]


def movement_lexicon(recordings: list[HeldOut]) -> MovementLexicon:
    """Fitted on these, one part of all numbers."""
    width = recordings[0].motion.shape[-1]
    lexicon = MovementLexicon(LexiconConfig(size=12, levels=(8,)), K, {"body": tuple(range(width))})
    motion = torch.cat([own.motion for own in recordings])
    lexicon.fit(motion, joined(own.pasts() for own in recordings), torch.ones(len(motion), width), seed=0)
    return lexicon


def test_a_lexicon_of_movements_decodes_from_the_past() -> None:
    recordings = [held(seed) for seed in range(3)]
    lexicon = movement_lexicon(recordings)
    one = recordings[0]
    labels = lexicon.label(one.motion, one.pasts())

    def alone(blocks: Tensor, past: Pasts) -> Tensor:
        return lexicon.basis.compose(lexicon.added(lexicon.label(blocks, past)), past)

    torch.testing.assert_close(alone(one.motion, one.pasts()),
                               lexicon.basis.compose(lexicon.quantised(
                                   lexicon.basis.coefficients(one.motion, one.pasts()), 0), one.pasts()))
    assert len(labels) == len(one.motion)
    every, first = (figures_of(recordings, decode)["displacement_r2"].value.mean
                    for decode in (partial(movements.decoded_by, lexicon), alone))
    assert every > first > 0.0, "more codes tell more, and a lexeme tells something"
    # What was drawn by the codewords themselves, block after block on its own past, is what was asked for.
    asked = np.random.default_rng(0).integers(lexicon.size, size=20)
    past, blocks = Pasts(torch.zeros(1, 3, one.motion.shape[-1]), torch.ones(1)), []
    for lexeme in asked:
        blocks.append(lexicon.basis.compose(lexicon.added(torch.tensor([lexeme])), past)[0])
        past = Pasts(blocks[-1][None, -3:], torch.ones(1))

    class Played:
        block_lexicon = lexicon

        def rest_feature(self, speaker: int) -> Array:
            return np.zeros(one.motion.shape[-1], np.float32)

    made = Rendering(moved(1.0, np.ones(60)), np.arange(21) * 0.3, lexemes=asked, drawn=torch.stack(blocks).numpy())
    assert movements.encode(Played(), made, 0).tolist() == [0] * 20  # type: ignore[arg-type]
    other = replace(made, lexemes=(asked + 1) % lexicon.size)
    assert (movements.encode(Played(), other, 0) > 0).all()  # type: ignore[arg-type]


# ----------------------------------------------------------------------------------------------------------- response

@pytest.fixture(scope="module")
def speech() -> Speech:
    return example(8.0)


def tilt_of(samples: Array) -> float:
    """dB by which 2 to 4 kHz lie over 300 to 700 Hz."""
    power = np.abs(np.fft.rfft(samples)) ** 2
    hertz = np.fft.rfftfreq(len(samples), 1 / SAMPLE_RATE)
    high, low = (power[(hertz > a) & (hertz < b)].mean() for a, b in ((2000, 4000), (300, 700)))
    return float(10 * np.log10(high / low))


def test_another_effort_has_another_pitch_range_tilt_and_rate_and_the_same_level(speech: Speech) -> None:
    pytest.importorskip("parselmouth", reason="praat-parselmouth is not installed")
    lively, subdued = said_with(speech, LIVELY), said_with(speech, SUBDUED)
    for own, asked in ((lively, LIVELY), (subdued, SUBDUED)):
        assert own.duration == pytest.approx(speech.duration / asked.rate, rel=0.01)
        assert loudness(own.samples.astype(float), SAMPLE_RATE) == pytest.approx(
            loudness(speech.samples.astype(float), SAMPLE_RATE), rel=1e-3)
    wide, own, narrow = (float(np.subtract(*np.nanpercentile(pitch_track(sound), [90, 10])))
                         for sound in (lively, speech, subdued))
    assert wide > 1.3 * own and narrow < 0.7 * own
    assert tilt_of(lively.samples) > tilt_of(speech.samples) + 3.0 > tilt_of(subdued.samples) + 6.0


@given(st.floats(-6.0, 6.0))
def test_a_tilt_is_as_steep_as_it_is_called(decibels: float) -> None:
    white = np.random.default_rng(0).normal(size=SAMPLE_RATE)
    before, after = (np.abs(np.fft.rfft(own)) for own in (white, tilted(white, SAMPLE_RATE, decibels)))
    hertz = np.fft.rfftfreq(len(white), 1 / SAMPLE_RATE)
    for at, octaves in ((300, 0.0), (1000, 1.0), (4000, 3.0), (7000, 3.0)):
        place = int(np.argmin(np.abs(hertz - at)))
        assert 20 * np.log10(after[place] / before[place]) == pytest.approx(decibels * octaves, abs=1e-6)


def values(size: float, speed: float, wrong: int = 0) -> Array:
    """[2, 2, 10] of ten readings with these ratios; in so many of them the order of both is the other way round."""
    out = np.ones((2, 2, 10)) * np.linspace(0.5, 1.5, 10)
    out[:, 0] *= np.array([size, speed])[:, None]
    out[:, :, :wrong] = out[:, ::-1, :wrong]
    return out


@pytest.mark.parametrize(("size", "speed", "wrong", "expected"), [
    (1.3, 1.0, 0, [True, True]), (1.0, 1.25, 0, [True, True]), (1.1, 1.15, 0, [False, True]),
    (1.6, 1.0, 2, [True, True]), (2.0, 1.0, 3, [True, False]), (1.0, 1.0, 0, [False, False]),
    (0.5, 0.9, 0, [False, False])])
def test_size_or_speed_must_differ_by_a_fifth_in_the_right_order(size: float, speed: float, wrong: int,
                                                                 expected: list[bool]) -> None:
    results = response.effort_figures(values(size, speed, wrong), [0.1] * 10)
    assert holds("effort", results, "effort_ratio") + holds("effort", results, "effort_ordered") == expected


def test_level_alone_must_change_nothing() -> None:
    for apart, expected in ((0.3, True), (26.0, False)):
        results = response.effort_figures(values(1.3, 1.3), [apart] * 10)
        assert holds("effort", results, "hands_apart") == [expected]


@pytest.mark.parametrize("name", list(stimuli.EXPORTS))
def test_an_export_is_the_same_sound_in_time_at_its_level(name: str, speech: Speech) -> None:
    changed = stimuli.EXPORTS[name](speech).samples
    assert len(changed) == len(speech.samples) and changed.dtype == np.float32
    if name.endswith("dB quieter"):
        loud = np.abs(speech.samples) > 0.01
        np.testing.assert_allclose(20 * np.log10(np.abs(speech.samples[loud]) / np.abs(changed[loud])),
                                   float(name.split()[0]), atol=1e-3)
        return
    level = np.sqrt(((changed - speech.samples) ** 2).mean())
    assert 0 < level < 0.0015
    if name.startswith("noise"):
        assert 20 * np.log10(level) == pytest.approx(-60.0, abs=0.2)


def test_controls_must_rise_by_two_centimetres_from_level_to_level() -> None:
    levels = {"low": 0.10, "mid": 0.13, "high": 0.14}
    results = response.order_figures({(feature, level): np.full(4, value) for feature in ("height", "speed", "radius")
                                      for level, value in levels.items()})
    assert [verdict.holds for verdict in judge(table()["controls"], results)] == [True, False] * 3


def test_other_words_keep_their_times_and_more_than_a_tenth_must_change() -> None:
    said = Word("one", 0.1, 0.2), Word("", 0.2, 0.4), Word("two", 0.4, 1)
    speech = Speech(np.zeros(16000, np.float32), 16000, said)
    told = stimuli.other_words(speech, (Word("red", 0, 1), Word(" ", 1, 2)))
    assert told.words == (Word("red", 0.1, 0.2), Word("", 0.2, 0.4), Word("red", 0.4, 1))
    with pytest.raises(ValueError):
        stimuli.other_words(speech, ())
    for on, shares, expected in (("other words", [0.1, 0.1], False), ("other words", [0.1, 0.12], True),
                                 ("0.1 dB fainter", [0.0, 0.02], True), ("0.1 dB fainter", [0.0, 0.7], False)):
        results = {("other_lexemes", on): Measured(mean_interval(shares))}
        assert holds("controls", results, "other_lexemes") == [expected], on


def said(*texts: str) -> Speech:
    words = tuple(Word(text, float(at), at + 0.8) for at, text in enumerate(texts))
    return Speech(np.zeros(len(texts) * SAMPLE_RATE, np.float32), SAMPLE_RATE, words)


def test_one_word_in_the_middle_is_changed_and_no_other() -> None:
    speech = said("a", "wonderful", "cat", "sat", "there", "was", "no", "b")
    changed, time = stimuli.word_changed(speech)
    assert [word.text for word in changed.words or ()] == [
        "a", "wonderful", "cat", "sat", "wonderful", "was", "no", "b"]
    assert time == 4.0 and [word.start for word in changed.words or ()] == [word.start for word in speech.words or ()]
    for few in (said("one"), said("same", "Same")):
        with pytest.raises(ValueError, match="two words"):
            stimuli.word_changed(few)


def swinging(*strokes: float) -> Motion:
    """30 s in which the right hand goes out and back at these seconds."""
    def move(time: Array) -> dict[str, Array]:
        swings = [np.where(np.abs(time - at - 0.5) < 0.5, 0.6 * (1 - np.cos(2 * np.pi * (time - at))), 0.0)
                  for at in strokes]
        return {"RightForeArm": elbow("Right", np.sum(swings, axis=0))}

    return posed(30.0, move)


def test_what_a_word_changes_is_told_before_its_unit_and_from_the_second_after_it() -> None:
    edges, lexemes = np.arange(31.0), np.zeros(30, np.int64)

    def made(motion: Motion, played: np.ndarray) -> Rendering:
        return Rendering(motion, edges, lexemes=played)

    first = made(swinging(4.0, 10.0, 16.0, 22.0), lexemes)
    units = response.units_of(common_body(first.motion))
    assert [round(begin) for begin, _ in units] == [4, 10, 16, 22]
    other = lexemes.copy()
    other[10:16] = 1  # its own unit, and until the second after it
    before, after = response.moved_by_word(first, made(swinging(4.0, 10.4, 16.0, 22.0), other), 10.5)
    assert before < 0.01 and after == 0.0
    other[25:] = 1
    before, after = response.moved_by_word(first, made(swinging(4.6, 10.4, 16.0, 22.0), other), 10.5)
    assert before > 1.0 and after > 50.0
    assert np.isnan(response.moved_by_word(first, first, 17.0)[1]), "no second unit after it"
    # The new word's gesture is prepared before the word and before the old one's unit; what moves before that counts.
    prepared = made(swinging(4.0, 9.5, 16.0, 22.0), other)
    assert response.moved_by_word(first, prepared, 9.9)[0] < 0.01


# -------------------------------------------------------------------------------------------------------- the command

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


def by_the_command(standing: tuple[Path, Path], *more: str) -> list[str]:
    store, bundle = map(str, standing)
    return ["acceptance", "--data", store, "--bundle", bundle, *more]


def test_every_group_is_judged(standing: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    out = tmp_path / "motion.json"
    assert main(by_the_command(standing, "--renderings", "1", "--out", str(out))) == 0
    about, *groups = load(out)
    assert [group.title for group in groups] == list(command.TITLES.values()) and "clauses hold" in about.notes[0]
    entries = [entry for group in groups for entry in group.facts["clauses"]]
    names = [entry["name"] for entry in entries]
    assert len(set(names)) == len(names) > 60
    assert set(entries[0]) == {"name", "value", "low", "high", "n", "bound", "holds", "reason"}
    by_name = {entry["name"]: entry for entry in entries}
    assert by_name["interpreter statistical runs"]["holds"] is True
    assert by_name["interpreter cql runs"]["holds"] is False and "not in the bundle" in by_name[
        "interpreter cql runs"]["reason"]
    assert by_name["hand controls are accepted"]["holds"] is False
    assert list(groups[0].columns) == ["value", "bound", "holds", "reason", "statistical", "sound rolled", "speakers"]
    speeds = groups[0].rows["log hand speed with loudness, correlation, test split"]
    assert len({speeds[column] for column in ("value", "statistical", "sound rolled", "speakers")}) == 4


@pytest.mark.parametrize(("more", "told"), [
    (["--renderings", "0"], "give 1 or more"), (["--limit", "0"], "give 1 or more"),
    (["--speaker", "unknown"], "unknown"), (["--only", "everything"], "invalid choice")])
def test_wrong_input_is_refused(standing: tuple[Path, Path], more: list[str], told: str,
                                refused: Callable[..., str]) -> None:
    assert told in refused(*by_the_command(standing, *more))


def test_without_a_voice_there_is_nothing_to_judge(standing: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch,
                                                   refused: Callable[..., str]) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    assert "no voice to gesture for" in refused("acceptance", "--bundle", standing[1])
