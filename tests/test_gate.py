"""The activity gate learns when to gesture, streams as it trains, and opens as `activity` asks."""

import itertools
import math

import numpy as np
import pytest
import torch
from learning import learn
from runners import played_gate
from torch import Tensor

from interpreters.base import BlockFeatures
from interpreters.gate import ActivityGate, GateConfig

FRAMES, AUDIO, SPEAKERS, BLOCKS = 4, 3, 2, 9



def gate(**changes: object) -> ActivityGate:
    torch.manual_seed(0)
    config = GateConfig(**{"audio_features": 8, "width": 16, **changes})  # type: ignore[arg-type]
    return ActivityGate(config, FRAMES, AUDIO, SPEAKERS)


def spoken(count: int, seed: int, habit: bool = False) -> dict[str, Tensor]:
    """Windows whose blocks are loud or soft at random; a gesture goes with the loud ones, or, where `habit` is set,
    the second performer gestures on the soft ones instead."""
    rng = np.random.default_rng(seed)
    loud = rng.random((count, BLOCKS + 2)) < 0.4
    speaker = rng.integers(SPEAKERS, size=count)
    level = np.repeat(loud.astype(np.float32), FRAMES, axis=1)
    level = level.reshape(count, BLOCKS + 2, FRAMES)
    windows = np.concatenate([level[:, :-2], level[:, 1:-1], level[:, 2:]], axis=2)[..., None]
    audio = windows + 0.3 * rng.standard_normal((*windows.shape[:-1], AUDIO))
    active = loud[:, 1:-1] ^ (habit & (speaker == 1))[:, None]
    return {"audio_low": torch.as_tensor(audio, dtype=torch.float32), "active": torch.as_tensor(active).float(),
            "speaker": torch.nn.functional.one_hot(torch.as_tensor(speaker), SPEAKERS).float(),
            "valid": torch.ones(count, BLOCKS)}


def taught(model: ActivityGate, habit: bool, steps: int = 120) -> float:
    """Train on the toy; the share of right decisions on other windows."""
    def loss(step: int) -> torch.Tensor:
        losses = model.losses(spoken(32, 100 + step, habit), step / steps)
        return torch.stack([model.weights[key] * term for key, term in losses.items()]).sum()

    learn(model, loss, steps)
    fresh = spoken(200, 1, habit)
    with torch.no_grad():
        says = model.logits(fresh["audio_low"], fresh["speaker"])[0] > 0
    return float((says == (fresh["active"] > 0.5)).float().mean())


@pytest.mark.parametrize("habit", [False, True], ids=["of all", "of each speaker"])
def test_learns_which_block_of_the_window_is_its_own(habit: bool) -> None:
    assert taught(gate(), habit) > 0.97


def test_streams_as_it_trains() -> None:
    model = gate().eval()
    batch = spoken(1, 5)
    whole = torch.sigmoid(model.logits(batch["audio_low"], batch["speaker"])[0][0]).tolist()
    runner, streamed = played_gate(model), []
    state = runner.start(int(batch["speaker"][0].argmax()))
    for window in batch["audio_low"][0].numpy():
        probability, state = runner.step(state, BlockFeatures(window, window * math.nan))  # the high level is not heard
        streamed.append(probability)
    np.testing.assert_allclose(streamed, whole, atol=1e-6)


def test_loss_is_the_cross_entropy_by_hand_and_ignores_padding() -> None:
    model = gate().eval()
    batch = spoken(3, 6)
    batch["valid"][0, 4:] = 0
    batch["valid"][2, 0] = 0
    odds = model.logits(batch["audio_low"], batch["speaker"])[0].detach().double().numpy()
    truth, valid = batch["active"].numpy(), batch["valid"].numpy()
    probability = 1 / (1 + np.exp(-odds))
    each = -np.log(np.where(truth > 0.5, probability, 1 - probability))
    expected = sum(each[b, i] for b, i in itertools.product(range(3), range(BLOCKS)) if valid[b, i]) / valid.sum()
    assert float(model.losses(batch)["activity"].detach()) == pytest.approx(expected, rel=1e-5)
    spoilt = {**batch, "active": torch.where(batch["valid"] > 0, batch["active"], 1 - batch["active"])}
    spoilt["audio_low"] = batch["audio_low"].clone()
    spoilt["audio_low"][0, 4:] = 50.0  # the padding at the end of a window comes after all that counts
    assert float(model.losses(spoilt)["activity"].detach()) == pytest.approx(expected, rel=1e-5)
