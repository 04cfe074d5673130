"""The planner of gesture units: what blocks show, what it learns, and that its decisions are drawn."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from learning import learn
from runners import played_planner
from scipy.stats import chisquare

from gesticulator.bundle.features import SpeechBlock
from gesticulator.systems.movement import GOES_ON_PAUSING, HOLD, VOICE_RETURNS, phrasing
from gesticulator.training.stages.heads import units_of
from interpreters.base import BlockFeatures
from interpreters.planner import UnitPlanner
from interpreters.planner_run import APEXES, CLASSES, HANDS, PHASES, SIZES, UnitDecision
from interpreters.settings import PlannerConfig

FRAMES, WIDTH, SPEAKERS, LEXEMES = 4, 6, 2, 5


def planner(**settings: float) -> UnitPlanner:
    torch.manual_seed(0)
    config = replace(PlannerConfig(audio_features=4, audio_bottleneck=4, embedding=4, width=24), **settings)  # type: ignore[arg-type]
    return UnitPlanner(config, FRAMES, WIDTH, SPEAKERS, LEXEMES).eval()


def features(rows: torch.Tensor) -> BlockFeatures:
    return BlockFeatures(rows.numpy(), rows.numpy(), False)


# ---------------------------------------------------------------------------------------------------- what blocks show

def moved(*legs: tuple[float, float]) -> np.ndarray:
    """Heights [T] at 30 Hz of a hand that starts at -0.1 m and reaches each height by a minimum-jerk movement."""
    now, parts = -0.1, []
    for height, seconds in legs:
        s = np.arange(round(seconds * 30)) / (seconds * 30)
        parts.append(now + (10 * s**3 - 15 * s**4 + 6 * s**5) * (height - now))
        now = height
    return np.concatenate(parts)


def test_blocks_show_the_phases_of_the_hand_that_moves() -> None:
    heights = moved((-0.1, 2.0), (0.45, 1.0), (0.2, 0.3), (0.2, 0.4), (-0.1, 0.9), (-0.1, 2.0))
    hands = np.zeros((len(heights), 2, 3))
    hands[:, :, 1], hands[:, 1, 1] = -0.1, heights
    edges = np.array([0.0, 0.9, 2.1, 2.6, 3.0, 3.35, 3.7, 4.5, 5.5, 6.5])
    shown = units_of(hands, edges)
    assert [PHASES[row[0]] for row in shown] == ["rest", "rest", "preparation", "preparation", "stroke", "hold",
                                                 "retraction", "rest", "rest"]
    assert {HANDS[row[1]] for row in shown[2:7]} == {"right"} and not shown[:2].any()
    assert [APEXES[row[3]] for row in shown[2:5]] == ["later", "next", "now"]
    assert {SIZES[row[2]] for row in shown[2:5]} == {"medium"}
    mirrored = units_of(hands[:, ::-1], edges)
    assert {HANDS[row[1]] for row in mirrored[2:7]} == {"left"}
    np.testing.assert_array_equal(mirrored[:, [0, 2, 3]], shown[:, [0, 2, 3]])


# ---------------------------------------------------------------------------------------------------- the model

def loud_strokes(count: int, blocks: int, rng: np.random.Generator) -> dict[str, torch.Tensor]:
    """Recordings in which a loud block is a large stroke of the left hand, and any other a rest."""
    loud = torch.as_tensor(rng.random((count, blocks)) < 0.4)
    audio = torch.zeros(count, blocks, 3 * FRAMES, WIDTH)
    audio[:, :, FRAMES:2 * FRAMES] = loud[..., None, None].float() + 0.1 * torch.randn(count, blocks, FRAMES, WIDTH)
    units = loud[..., None] * torch.tensor([2, 1, 3, 1])
    return {"audio_low": audio, "units": units, "valid": torch.ones(count, blocks),
            "speaker": torch.eye(SPEAKERS)[torch.zeros(count, dtype=torch.long)]}


def numbers(seed: int) -> np.ndarray:
    """Standard Gumbel numbers for a decision."""
    return np.random.default_rng(seed).gumbel(size=sum(CLASSES))


def test_it_learns_what_can_be_heard_and_steps_as_it_was_trained() -> None:
    rng, model = np.random.default_rng(0), planner().train()
    learn(model, lambda _: torch.stack(list(model.losses(loud_strokes(16, 9, rng)).values())).sum(), 150, 0.02)
    heard = loud_strokes(4, 12, rng)
    assert sum(loss.item() for loss in model.losses(heard).values()) < 0.1, "the sound alone decides"
    runner, right = played_planner(model.eval()), []
    state = runner.start(0)
    for k in range(12):
        decision, state = runner.step(state, features(heard["audio_low"][0, k]), numbers(k), 0.0)
        shown = (decision.phase, decision.hand, decision.size, decision.apex)
        right.append(shown == tuple(heard["units"][0, k].tolist()))
    assert sum(right[1:]) >= 10


def test_losses_are_the_nats_of_its_own_distribution() -> None:
    model = planner()
    batch = loud_strokes(2, 5, np.random.default_rng(1))
    state, _ = model.encode_speech(batch["audio_low"][:, 1:], batch["speaker"], batch["units"][:, :-1])
    losses = model.losses(batch)
    for level, name in enumerate(("phase", "hand", "size", "apex")):
        logits = model.logits(state, level, batch["units"][:, 1:])
        assert logits.shape[-1] == CLASSES[level]
        own = torch.log_softmax(logits, -1).gather(-1, batch["units"][:, 1:, level:level + 1])
        assert losses[name].item() == pytest.approx(-own.mean().item(), rel=1e-5)


def test_a_bias_moves_the_odds_of_a_phase_and_a_hold_needs_raised_hands() -> None:
    model, rows = planner(), torch.zeros(3 * FRAMES, WIDTH)
    runner = played_planner(model)
    for last, raised in ((PHASES.index("stroke"), True), (PHASES.index("rest"), False)):
        begun = replace(runner.start(1), last=(last, 1, 0, 0))
        heard, _ = model.encode_speech(rows[None, None], torch.as_tensor(begun.speaker)[None],
                                       torch.tensor(begun.last)[None, None])
        logits = model.logits(heard, 0, torch.zeros(1, 1, 0, dtype=torch.long))[0, 0].double().detach().numpy()
        for name in ("preparation", "hold"):
            bias = 1.5 * (np.array(PHASES) == name)
            shares = np.exp(logits + (bias if raised or name != "hold" else 0.0))
            drawn = [runner.step(begun, features(rows), numbers(k), 1.0, bias)[0].phase for k in range(2000)]
            counts = np.bincount(drawn, minlength=len(PHASES))
            assert chisquare(counts, shares / shares.sum() * 2000).pvalue > 1e-3


def test_a_pause_that_goes_on_holds_and_one_that_ends_prepares() -> None:
    quiet, voiced = np.ones(FRAMES, bool), np.zeros(FRAMES, bool)
    nothing = np.zeros((3 * FRAMES, 2), np.float32)

    def of(now: np.ndarray, ahead: np.ndarray | None) -> dict[str, float]:
        speech = SpeechBlock(4, 2.0, 2.4, (0.4, 0.4, 0.4), (False, bool(now.all()), False), nothing, nothing, None, now,
                             ahead)
        return {name: value for name, value in zip(PHASES, phrasing(speech), strict=True) if value}

    assert of(quiet, quiet) == {"hold": HOLD + GOES_ON_PAUSING}
    assert of(quiet, voiced) == of(quiet, np.array([True, True, True, False])) == {
        "hold": HOLD, "preparation": VOICE_RETURNS}
    assert of(voiced, voiced) == of(voiced, quiet) == of(quiet, None) == {"hold": HOLD}


def test_a_new_unit_forgets_the_sound_before_its_last_decision() -> None:
    """From there on the decisions are those of a planner that heard nothing earlier."""
    model, rng = played_planner(planner()), np.random.default_rng(3)
    rows = [torch.as_tensor(rng.normal(size=(3 * FRAMES, WIDTH)), dtype=torch.float32) for _ in range(9)]
    state = other = model.start(0)
    for k in range(4):
        _, state = model.step(state, features(rows[k]), numbers(k))
        _, other = model.step(other, features(rows[k] + 1.0), numbers(k))
    begun = replace(other, hidden=None, last=state.last, held=state.held)
    state = replace(state, hidden=None)
    for k in range(4, 9):
        one, state = model.step(state, features(rows[k]), numbers(k))
        two, begun = model.step(begun, features(rows[k]), numbers(k))
        assert one == two


def test_what_is_heard_later_changes_nothing_earlier() -> None:
    model = planner()
    audio = torch.randn(1, 6, 3 * FRAMES, WIDTH)
    before = torch.zeros(1, 6, 4, dtype=torch.long)
    speaker = torch.eye(SPEAKERS)[:1]
    one = model.encode_speech(audio, speaker, before)[0]
    other = model.encode_speech(torch.cat([audio[:, :4], torch.randn(1, 2, 3 * FRAMES, WIDTH)], 1), speaker, before)[0]
    torch.testing.assert_close(one[:, :4], other[:, :4])
    assert (one[:, 4:] - other[:, 4:]).abs().max() > 1e-4


def test_lexemes_are_worth_what_their_phase_says() -> None:
    model = planner()
    lexemes = np.array([0] * 90 + [1] * 90 + [2])
    hold, stroke = (3, 1, 0, 0), (2, 1, 2, 1)
    units = np.array([hold] * 80 + [stroke] * 10 + [stroke] * 90 + [hold])
    model.count(lexemes, units)
    bias = played_planner(model).bias(UnitDecision(*hold))
    p, p0 = 80 / 90, 81 / 181
    assert bias[0] == pytest.approx(np.log(p / p0), abs=0.1)
    assert bias[1] < -1.0 and 0.0 < bias[2] < bias[0], "one block says little"
    assert bias[3] == bias[4] == pytest.approx(0.0), "a lexeme that never occurs is worth nothing in any phase"


# ---------------------------------------------------------------------------------------------------- the plan
