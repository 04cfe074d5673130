"""What is measured on the training split: known answers, and what an absent joint does."""

from typing import Any

import numpy as np
import pytest

from data_module.motion.skeletons import CHARACTERS
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.features import LEAST_MOVEMENT, Normaliser, Statistics, control_rows
from gesticulator.bundle.files import NAMED
from gesticulator.training.presets import preset
from gesticulator.training.stages.measured import LOWEST, hanging, measured

FRAMES = 10


def recording(poses: np.ndarray, silent: np.ndarray | None = None, mask: np.ndarray | None = None) -> dict[str, Any]:
    """A recording's cached arrays, of poses [N, K, D]."""
    blocks, _, width = poses.shape
    return {"motion": poses.astype(np.float32), "silent": np.zeros(blocks, bool) if silent is None else silent,
            "mask": np.ones(width, bool) if mask is None else mask,
            "control": np.tile(np.linspace(0, 1, blocks)[:, None, None], (1, FRAMES, 3)).astype(np.float32)}


def heard(blocks: int) -> dict[str, Any]:
    return {"low": np.random.default_rng(0).normal(size=(blocks, 3 * FRAMES, 4)).astype(np.float16)}


def known(poses: list[np.ndarray], speaker_of: list[int], **more: Any) -> Statistics:
    names = tuple(f"speaker {k}" for k in range(max(speaker_of) + 1))
    return measured(preset("tiny"), names, np.array(speaker_of), [recording(own, **more) for own in poses],
                    [heard(len(own)) for own in poses])


def test_bounds_leave_out_one_frame_in_a_thousand_at_either_end() -> None:
    # 10,001 frames from -2 to 2 in even steps: the mean is 0, and a thousandth of the way is 0.004.
    ramp = np.linspace(-2, 2, 10_001)[:10_000].reshape(1000, FRAMES, 1)
    ramp = ramp - ramp.mean()
    found = known([ramp], [0])
    deviation = ramp.std()
    np.testing.assert_allclose(found.deviation, [deviation], rtol=1e-5)
    np.testing.assert_allclose(found.bounds[:, 0] * deviation, [-2 + 0.004, 2 - 0.004], atol=1e-3)


def test_bounds_are_of_each_speakers_own_mean() -> None:
    rng = np.random.default_rng(0)
    calm = rng.uniform(-1, 1, size=(200, FRAMES, 2))
    found = known([calm + 50, calm - 50], [0, 1])
    np.testing.assert_allclose(found.mean_pose, [[50, 50], [-50, -50]], atol=0.1)
    widest = np.abs(found.bounds * found.deviation)
    assert (widest > 0.9).all() and (widest < 1.1).all(), "not the distance between speakers"
    assert (found.bounds[0] < 0).all() and (found.bounds[1] > 0).all()


def test_rest_is_the_end_of_silences_that_are_settled() -> None:
    poses = np.zeros((12, FRAMES, 1))
    poses[:, :, 0] = np.arange(12)[:, None]
    silent = np.zeros(12, bool)
    silent[4:10] = True  # 4, 5, 6 are the arms coming down; 7, 8 and 9 are rest
    assert known([poses], [0], silent=silent).rest_pose[0, 0] == pytest.approx(8.0)


@pytest.mark.parametrize(("apart", "moves"), [(0.0, 0), (1e-27, 0), (5.6e-16, 0), (1e-3, 1), (2.0, 1)])
def test_a_rounding_error_is_no_movement(apart: float, moves: int) -> None:
    one = np.ones(1)
    found = Statistics(("a",), one[None], one[None], one, np.array([[-apart / 2], [apart / 2]]), Normaliser(one, one),
                       Normaliser(one, one))
    assert found.present.tolist() == [moves]
    assert 1e-15 < LEAST_MOVEMENT < 1e-3


def test_a_joint_that_no_source_has_is_absent_though_its_numbers_are_not_quite_equal() -> None:
    poses = np.random.default_rng(0).normal(size=(60, FRAMES, 4))
    poses[..., 2:] = 1e-20 * np.random.default_rng(1).normal(size=(60, FRAMES, 2))
    found = known([poses], [0], mask=np.array([True, True, False, True]))
    assert found.present.tolist() == [1, 1, 0, 0], "neither the absent dimension nor one that only trembles"
    assert found.deviation[2] == 1 and found.deviation[3] == preset("tiny").motion.least_deviation


def test_control_rows_are_standardised_and_say_what_is_asked() -> None:
    levels = bundles.load(NAMED["default"]).levels
    assert levels is not None
    given = np.array([True, False, True])
    rows = control_rows(levels, levels.mean + 2 * levels.spread, given)
    np.testing.assert_allclose(rows, [2, 0, 2, 1, 0, 1], atol=1e-6)


def test_a_body_that_lives_rests_with_its_hands_down() -> None:
    """Of a body whose hands are up nearly all the time, in silence too, rest is where they hang."""
    config = preset("default")
    joints = CHARACTERS[46].names
    down, up = np.zeros((2, 3 * len(joints)))
    for side, sign in (("Left", -1.0), ("Right", 1.0)):
        at = 3 * joints.index(side + "Arm")
        down[at + 2], up[at + 2] = sign * 1.3, sign * -0.3
    rng = np.random.default_rng(1)
    low = round(1.2 * LOWEST * 1000)
    poses = np.concatenate([np.tile(down, (low, 1)), np.tile(up, (1000 - low, 1))])
    poses += 0.01 * rng.normal(size=poses.shape)
    assert np.abs(hanging(poses, config) - down).max() < 0.05
    aside = 3 * joints.index("Head") + 1
    poses[:low, aside] = rng.normal(0.0, 0.4, low)
    assert abs(hanging(poses, config)[aside] - poses[:low, aside].mean()) < 0.15, "it looks where it looks on average"


def test_what_never_moves_is_exactly_zero() -> None:
    """Rounding of a constant number must not reach the models as movement."""
    bounds = np.array([[-2.0, -1e-9], [2.0, 1e-9]])
    none = Normaliser(np.zeros(1), np.ones(1))
    mean = np.array([[0.1, 0.3]])
    statistics = Statistics(("a",), mean, mean, np.array([0.5, 1.0]), bounds, none, none)
    poses = np.array([[0.6, 0.3 + 1e-12], [-0.4, 0.3 - 3e-12]])
    found = statistics.normalise(poses, 0)
    assert found[:, 0].tolist() == pytest.approx([1.0, -1.0]) and (found[:, 1] == 0.0).all()
