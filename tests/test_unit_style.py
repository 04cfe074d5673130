"""The style of gesture units: what is measured on motion, what is heard, and that a unit has one code."""

import numpy as np
import pytest
import torch
from learning import learn
from runners import played_unit_style

from gesticulator.training.stages.heads import RATE, spans, style_of
from interpreters.base import BlockFeatures
from interpreters.planner import UnitStyleInterpreter
from interpreters.planner_run import CODE
from interpreters.settings import StyleConfig

FRAMES, WIDTH, SPEAKERS = 4, 6, 2


def interpreter() -> UnitStyleInterpreter:
    torch.manual_seed(0)
    config = StyleConfig(audio_features=4, audio_bottleneck=4, width=24, dropout=0.0)
    return UnitStyleInterpreter(config, FRAMES, WIDTH, SPEAKERS, len(CODE))


def test_units_are_runs_of_blocks_and_long_ones_are_cut_evenly() -> None:
    acting = np.array([0, 1, 1, 0, 1, 1, 1, 1, 1, 1, 1], bool)
    assert spans(acting, 4) == [(1, 3), (4, 8), (8, 11)]
    assert spans(np.zeros(3, bool)) == []


def circling(hertz: float, metres: float, height: float) -> np.ndarray:
    """[T, 2, 3] hands on circles in front of the chest."""
    angles = 2 * np.pi * hertz * np.arange(120) / RATE
    hands = np.zeros((120, 2, 3))
    hands[..., 0], hands[..., 1], hands[..., 2] = [-0.2, 0.2], height, 0.3
    hands[:, :, 0] += metres * np.cos(angles)[:, None]
    hands[:, :, 1] += metres * np.sin(angles)[:, None]
    return hands


def test_a_code_tells_speed_range_height_and_reach() -> None:
    plain = style_of(circling(0.5, 0.1, 0.2))
    # A circle of radius r has the speed 2 pi f r, and deviates from its middle by r.
    assert np.exp(plain[0]) - 0.02 == pytest.approx(2 * np.pi * 0.5 * 0.1, rel=0.01)
    assert np.exp(plain[1]) - 0.02 == pytest.approx(0.1, rel=0.02)
    assert plain[2] == pytest.approx(0.2, abs=0.01) and plain[3] == pytest.approx(np.hypot(0.2, 0.3), abs=0.02)
    faster, higher = style_of(circling(1.0, 0.1, 0.2)), style_of(circling(0.5, 0.1, 0.4))
    assert faster[0] > plain[0] + 0.5 and faster[1] == pytest.approx(plain[1], abs=0.02)
    assert higher[2] == pytest.approx(plain[2] + 0.2) and higher[0] == pytest.approx(plain[0])


def effortful(count: int, blocks: int, seed: int) -> dict[str, torch.Tensor]:
    """Recordings in which the first number of the sound is the first of the code, and the others are noise."""
    rng = torch.Generator().manual_seed(seed)
    effort = torch.randn(count, 1, 1, generator=rng).expand(-1, blocks, -1)
    audio = torch.randn(count, blocks, 3 * FRAMES, WIDTH, generator=rng)
    audio[..., :1] += 2 * effort[:, :, None]
    code = torch.randn(count, blocks, len(CODE), generator=rng)
    code[..., :1] = effort
    return {"audio_low": audio, "code": code, "acting": torch.ones(count, blocks), "valid": torch.ones(count, blocks),
            "speaker": torch.eye(SPEAKERS)[torch.zeros(count, dtype=torch.long)]}


def test_what_can_be_heard_is_predicted_at_full_size_and_what_cannot_is_left_at_zero() -> None:
    model = interpreter().train()
    learn(model, lambda step: model.losses(effortful(32, 6, step))["code"], 200)
    unseen = effortful(64, 6, 999)
    with torch.no_grad():
        predicted, _ = model.predict(unseen["audio_low"], unseen["speaker"])
    model.calibrate(predicted.flatten(0, 1), unseen["code"].flatten(0, 1))
    codes = model.gain * predicted.flatten(0, 1)
    assert np.corrcoef(codes[:, 0], unseen["code"].flatten(0, 1)[:, 0])[0, 1] > 0.8
    assert codes.std(0)[0] == pytest.approx(1.0, abs=0.15)
    assert (codes.std(0)[1:] < 0.2).all()


def test_a_unit_has_the_mean_of_what_was_heard_since_it_began() -> None:
    model = interpreter().eval()
    rows = torch.randn(5, 3 * FRAMES, WIDTH, generator=torch.Generator().manual_seed(4))
    with torch.no_grad():
        heard, _ = model.predict(rows[None], torch.eye(SPEAKERS)[:1])
    runner, codes = played_unit_style(model), []
    state = runner.start(0)
    for k, row in enumerate(rows.numpy()):
        code, state = runner.step(state, BlockFeatures(row, row), resting=k == 2)
        codes.append(code)
    expected = [heard[0, 0], heard[0, :2].mean(0), torch.zeros(len(CODE)), heard[0, 3], heard[0, 3:].mean(0)]
    for code, mean in zip(codes, expected, strict=True):
        np.testing.assert_allclose(code, mean.clamp(-2.5, 2.5).numpy(), atol=1e-5)
