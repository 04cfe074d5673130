"""Coordinates of movement and the lexicon over them: known dynamics, round trips, planted movements."""

import numpy as np
import pytest
import torch

from data_module.motion.movement import MovementBasis, Pasts, joined, pasts_of
from data_module.motion.movement_run import body_parts
from data_module.motion.skeletons import CHARACTERS
from lexicon.movement import MovementLexicon
from lexicon.settings import LexiconConfig

FRAMES = 6
PARTS = {"torso": (0, 1), "left arm": (2, 3, 4), "left fingers": (5, 6)}
WIDTH = 7


def blocks(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth random walk [N, K, D] and durations [N]."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(count * FRAMES, WIDTH))
    for _ in range(2):
        steps = 0.8 * np.concatenate([steps[:1], steps[:-1]]) + 0.3 * steps
    walk = np.tanh(0.05 * np.cumsum(steps, axis=0))
    return torch.as_tensor(walk.reshape(count, FRAMES, WIDTH)).float(), torch.as_tensor(rng.uniform(0.2, 0.5, count))


def basis(components: int = 100) -> MovementBasis:
    return MovementBasis(FRAMES, PARTS, dict.fromkeys(PARTS, components))


@pytest.mark.parametrize("joints", [16, 46])
def test_every_number_of_the_body_belongs_to_one_part(joints: int) -> None:
    parts = body_parts(CHARACTERS[joints].names)
    assert sorted(column for columns in parts.values() for column in columns) == list(range(3 * joints))
    assert set(parts) == {"torso", "head", "left arm", "right arm"} | (
        {"left fingers", "right fingers"} if joints == 46 else set())
    names = CHARACTERS[joints].names
    assert [names[c // 3] for c in parts["left arm"][::3]] == ["LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"]


def test_a_block_that_goes_on_as_it_was_adds_nothing() -> None:
    """Motion at a constant velocity, whatever the durations: W is exact, and what it leaves is nothing."""
    rng = np.random.default_rng(3)
    groups = []
    for _ in range(200):
        durations = torch.as_tensor(rng.uniform(0.2, 0.5, 4))
        times = torch.cat([torch.linspace(0, 1, FRAMES + 1)[1:] * d for d in durations.float()]).reshape(4, FRAMES)
        starts = torch.cat([torch.zeros(1), durations.cumsum(0)[:-1].float()])
        velocity = torch.as_tensor(100.0 * rng.normal(size=WIDTH)).float()  # beside it the ridge is nothing
        groups.append(((times + starts[:, None])[..., None] * velocity, durations, torch.zeros(WIDTH)))
    motion = torch.cat([group[0][1:] for group in groups])
    past = joined(pasts_of(*group)[1:] for group in groups)
    told = basis()
    told.fit(motion, past, torch.ones(len(motion), WIDTH))
    assert (told.base(past) - motion).abs().max() < 0.01 * motion.std()


def test_coefficients_lead_back_to_the_block() -> None:
    motion, durations = blocks(300)
    past = pasts_of(motion, durations, motion[0, 0])
    told = basis()
    y = told.fit(motion, past, torch.ones(len(motion), WIDTH))
    torch.testing.assert_close(told.coefficients(motion, past), y, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(told.compose(y, past), motion, atol=1e-4, rtol=1e-4)
    few = basis(4)
    few.fit(motion, past, torch.ones(len(motion), WIDTH))
    left = (few.compose(few.coefficients(motion, past), past) - motion).pow(2).mean()
    assert 0 < left < 0.5 * (few.base(past) - motion).pow(2).mean()


def test_pasts_bring_velocities_to_the_clock_of_the_block() -> None:
    motion, durations = blocks(5)
    past = pasts_of(motion, durations, motion[0, 0])
    pose, velocity, acceleration = past.state()
    ratio = (durations[3] / durations[2]).float()
    torch.testing.assert_close(pose[3], motion[2, -1])
    torch.testing.assert_close(velocity[3], (motion[2, -1] - motion[2, -2]) * ratio)
    torch.testing.assert_close(acceleration[3], (motion[2, -1] - 2 * motion[2, -2] + motion[2, -3]) * ratio)
    assert (velocity[0] == 0).all()


def test_a_part_is_fitted_on_those_who_have_it() -> None:
    motion, durations = blocks(300)
    past = pasts_of(motion, durations, motion[0, 0])
    mask = torch.ones(len(motion), WIDTH)
    mask[:150, 5:] = 0
    spoilt = motion.clone()
    spoilt[:150, :, 5:] = torch.randn(150, FRAMES, 2)
    one, other = basis(3), basis(3)
    known = one.fit(motion, past, mask)
    other.fit(spoilt, past, mask)
    torch.testing.assert_close(one.get_buffer("components_2"), other.get_buffer("components_2"))
    assert (known[:150, one.slices()[2]] == 0).all() and (known[:150, one.slices()[1]] != 0).any()
    assert one.known(mask)[0].tolist() == [1] * 6 + [0] * 3


def planted(count: int, seed: int) -> tuple[torch.Tensor, Pasts, np.ndarray]:
    """Blocks that each make one of four movements, from poses anywhere."""
    rng = np.random.default_rng(seed)
    shape = np.sin(np.pi * np.arange(1, FRAMES + 1) / FRAMES)[:, None]
    ways = np.eye(WIDTH)[[0, 2, 3, 4]] * 2.0
    which = rng.integers(0, 4, count)
    pose = rng.normal(size=(count, 1, WIDTH)) * 0.1
    motion = pose + shape * ways[which][:, None] + 0.02 * rng.normal(size=(count, FRAMES, WIDTH))
    frames = torch.as_tensor(np.repeat(pose, 3, axis=1)).float()
    return torch.as_tensor(motion).float(), Pasts(frames, torch.ones(count)), which


def lexicon(size: int = 4) -> MovementLexicon:
    model = MovementLexicon(LexiconConfig(size=size, levels=(8, 8), trunk_components=6,
                                          arm_components=6, finger_components=6), FRAMES, PARTS)
    motion, past, _ = planted(400, 1)
    model.fit(motion, past, torch.ones(400, WIDTH), 5)
    return model


def test_lexemes_are_the_movements_whatever_the_pose() -> None:
    model = lexicon()
    motion, past, which = planted(200, 2)
    labels = model.label(motion, past).numpy()
    pairs = {(int(a), int(b)) for a, b in zip(which, labels, strict=True)}
    assert len(pairs) == 4 and len({b for _, b in pairs}) == 4
    assert (model.ranks(motion, past, torch.as_tensor(labels)) == 0).all()
    assert (model.ranks(motion, past, torch.as_tensor((labels + 1) % 4)) > 0).all()


def test_levels_below_the_lexeme_tell_more() -> None:
    model = lexicon()
    motion, past, _ = planted(200, 2)
    y = model.basis.coefficients(motion, past)
    errors = [float((model.quantised(y, levels) - y).pow(2).mean()) for levels in (0, 1, 2)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[0] < 0.1 * float(y.pow(2).mean())


def test_what_a_lexeme_shows_is_labelled_as_that_lexeme() -> None:
    model = lexicon()
    labels = model.label(model.shown(), Pasts(model.examples, torch.ones(4)))
    assert labels.tolist() == [0, 1, 2, 3]
