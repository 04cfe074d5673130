"""The lexeme interpreter that sees the body, remembers a few blocks and mistrusts its past."""

import numpy as np
import pytest
import torch
from learning import learn
from runners import played_lstm
from torch import Tensor

from interpreters.base import BlockFeatures, pose_of
from interpreters.lstm import InterpreterWidths, LstmConfig, LstmInterpreter

FRAMES, AUDIO, SIZE, MOTION = 5, 4, 6, 3


def model(**changes: object) -> LstmInterpreter:
    torch.manual_seed(0)
    config = LstmConfig(**{"audio_features": 8, "width": 16, "dropout": 0.0, "own_past_most": 0.0,
                           **changes})  # type: ignore[arg-type]
    return LstmInterpreter(config, torch.randn(SIZE, 7), InterpreterWidths(FRAMES, AUDIO, 2, motion=MOTION))


def heard(blocks: int, count: int = 1, seed: int = 1) -> dict[str, Tensor]:
    """A batch of noise: `count` windows of a seed block and `blocks` more."""
    chance = torch.Generator().manual_seed(seed)
    return {"lexeme": torch.randint(SIZE, (count, blocks + 1), generator=chance),
            "audio_high": torch.randn(count, blocks + 1, 3 * FRAMES, AUDIO, generator=chance),
            "motion": torch.randn(count, blocks + 1, FRAMES, MOTION, generator=chance),
            "duration": 0.2 + 0.3 * torch.rand(count, blocks + 1, generator=chance),
            "speaker": torch.eye(2)[torch.zeros(count, dtype=torch.long)], "valid": torch.ones(count, blocks + 1)}


def whole(interpreter: LstmInterpreter, batch: dict[str, Tensor]) -> Tensor:
    """Log-probabilities [B, N, S] of every block but the seed."""
    with torch.no_grad():
        logits, _ = interpreter.scores(batch["lexeme"][:, :-1], batch["audio_high"][:, 1:], batch["speaker"],
                                       pose=interpreter.poses(batch))
    return torch.log_softmax(logits, -1)


def block(batch: dict[str, Tensor], i: int) -> BlockFeatures:
    """What the interpreter is given of block i of the first window."""
    seconds = batch["duration"][0]
    audio = batch["audio_high"][0, i].numpy()
    return BlockFeatures(audio * 0, audio, past=batch["motion"][0, i - 1].numpy(),
                         durations=(float(seconds[i - 1]), float(seconds[i])))


# ------------------------------------------------------------------------------------------------------------ the pose

def test_a_steady_motion_has_its_speed_and_no_acceleration() -> None:
    past = torch.arange(5.0)[:, None] * torch.tensor([[1.0, -2.0, 0.0]])  # so much a frame
    last, velocity, acceleration = pose_of(past)
    assert last.tolist() == [4, -8, 0]
    assert velocity.tolist() == [5, -10, 0]  # a whole block of five frames on
    assert acceleration.abs().max() == 0


def test_what_is_a_function_of_time_has_the_same_derivatives_however_the_block_before_was_cut() -> None:
    def seen(before: float, own: float) -> tuple[Tensor, Tensor, Tensor]:
        at = -before / 1000 * torch.arange(999, -1, -1, dtype=torch.float64)  # a thousand frames, the last at time 0
        return pose_of((3 * at + 2 * at ** 2)[:, None], (before, own))

    for before in (0.2, 0.5):
        _, velocity, acceleration = map(float, seen(before, 0.4))
        assert velocity == pytest.approx(3 * 0.4, rel=1e-3)  # d/dt at 0, times the seconds of this block
        assert acceleration == pytest.approx(4 * 0.4 ** 2 / 1000, rel=1e-6)  # d^2/dt^2, for one frame of a thousand


def test_the_paper_is_blind_to_the_body() -> None:
    blind, batch = model().eval(), heard(3)
    assert torch.equal(whole(blind, batch), whole(blind, {**batch, "motion": batch["motion"] + 1}))
    seer = model(pose_features=4).eval()
    assert not torch.equal(whole(seer, batch), whole(seer, {**batch, "motion": batch["motion"] + 1}))
    assert not torch.equal(whole(seer, batch), whole(seer, {**batch, "duration": batch["duration"].flip(1)}))


@pytest.mark.parametrize("by", ["frame", "block"])
@pytest.mark.parametrize("pose", [4, 0])
def test_a_rule_of_the_hands_is_learned_by_who_sees_them(pose: int, by: str) -> None:
    """Which of two lexemes comes next hangs on the direction of the hand alone: 1 bit, 0.693 nats."""
    student = model(pose_features=pose, reads_by=by)
    torch.manual_seed(7)

    def batch(seed: int) -> dict[str, Tensor]:
        made = heard(4, 16, seed)
        up = made["motion"][:, :, -1, 0] > made["motion"][:, :, -2, 0]
        made["lexeme"] = torch.cat([torch.zeros(16, 1, dtype=torch.long), up[:, :-1].long()], dim=1)
        return made

    learn(student, lambda step: student.losses(batch(step), step / 120)["nll"], 120)
    with torch.no_grad():
        nll = float(np.mean([float(student.eval().losses(batch(seed))["nll"]) for seed in range(1000, 1005)]))
    assert nll < 0.2 if pose else nll > 0.65


# ---------------------------------------------------------------------------------------------------------- the memory

@pytest.mark.parametrize("by", ["frame", "block"])
@pytest.mark.parametrize("memory", [0, 1, 3, 8])
def test_it_streams_as_it_is_trained(memory: int, by: str) -> None:
    interpreter, batch = model(pose_features=4, memory=memory, reads_by=by, lexeme_features=5).eval(), heard(7)
    scores, runner = whole(interpreter, batch)[0], played_lstm(interpreter)
    state = runner.start(0, int(batch["lexeme"][0, 0]))
    for i in range(1, 8):
        own, state = runner.step(state, block(batch, i), int(batch["lexeme"][0, i - 1]))
        np.testing.assert_allclose(own, scores[i - 1].numpy(), atol=1e-5)


def test_what_lies_before_the_memory_is_forgotten_and_the_paper_forgets_nothing() -> None:
    batch = heard(7)
    other = {**batch, "audio_high": batch["audio_high"].clone()}
    other["audio_high"][:, 2] += 3.0
    for memory, remembers in ((3, 3), (0, 6)):
        interpreter = model(memory=memory).eval()
        apart = (whole(interpreter, batch) - whole(interpreter, other)).abs().amax((0, 2)) > 0
        assert apart.tolist() == [False, *[True] * remembers, *[False] * (6 - remembers)]


# --------------------------------------------------------------------------------------------------------- its own past

def test_noise_and_dropout_are_of_training_alone() -> None:
    student, batch = model(pose_features=4, pose_noise=1.0, history_dropout=0.5), heard(4, 8)
    assert student.losses(batch)["nll"] != student.losses(batch)["nll"]
    student.eval()
    assert student.losses(batch)["nll"] == student.losses(batch)["nll"]


def test_the_block_after_can_be_left_out_of_training() -> None:
    batch = heard(4, 8)
    other = {**batch, "audio_high": batch["audio_high"].clone()}
    other["audio_high"][:, :, batch["audio_high"].shape[2] * 2 // 3:] += 1.0
    for share, same in ((1.0, True), (0.0, False)):
        student = model(pose_features=0, after_dropout=share, dropout=0.0)
        losses = []
        for one in (batch, other):
            torch.manual_seed(5)
            losses.append(float(student.losses(one)["nll"]))
        assert (losses[0] == losses[1]) == same
