"""Roles of the arms: one at a time or both together, always smooth, and nothing at rest."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.motion.kinematics import joint_positions
from data_module.motion.rotation import from_exponential_map
from data_module.motion.skeletons import CHARACTER, CHARACTERS
from data_module.types import Array
from gesticulator.body.roles import (
    AS_GENERATED,
    CHANGES,
    FOLLOWS,
    HANGING,
    JITTER,
    ONE_HANDED,
    PERIOD,
    SWAY,
    WAITS,
    Role,
    Roles,
    role_at,
    shown,
)
from gesticulator.bundle.features import Statistics
from gesticulator.gesticulator import Gesticulator

NAMES = CHARACTER.names
FINE = np.arange(0.0, 240.0, 1 / 60)


def columns(side: str) -> Array:
    """The numbers of an arm."""
    return np.flatnonzero(np.repeat([name.startswith(side) for name in NAMES], 3))


RIGHT, LEFT = columns("Right"), columns("Left")
REST = np.zeros(3 * len(NAMES))
REST[3 * NAMES.index("RightArm") + 2], REST[3 * NAMES.index("LeftArm") + 2] = 1.0, -1.0


@pytest.fixture(scope="module")
def statistics(system: Gesticulator) -> Statistics:
    """Of a body whose mean pose is 0, in radians."""
    zero = np.zeros((1, 3 * len(NAMES)))
    return replace(system.bundle.statistics, speakers=("one",), mean_pose=zero, rest_pose=REST[None],
                   deviation=np.ones(3 * len(NAMES)), bounds=np.outer([-9.0, 9.0], np.ones(3 * len(NAMES))))


class Fixed(Roles):
    """The same role all the time."""

    def at(self, time: float) -> Role:
        """Whatever the time is."""
        assert self.fixed is not None
        return self.fixed


def seen(statistics: Statistics, role: Role, block: Array) -> Array:
    """The block in a role."""
    return shown(Fixed(0, 0, fixed=role), statistics, 0, NAMES, np.zeros(len(block)), block)


def role(**parts: tuple[float, float]) -> Role:
    """Both arms gesture by themselves, but for these numbers."""
    plain = {"gestures": (1.0, 1.0), "follows": (0.0, 0.0), "hangs": (0.0, 0.0), "raised": (0.0, 0.0)}
    return Role(*(np.array(values) for values in (plain | parts).values()))


def places(block: Array) -> dict[str, Array]:
    """Where the joints of a body in a pose are, metres."""
    found = joint_positions(CHARACTER, from_exponential_map(block[-1].reshape(-1, 3)))
    return dict(zip(NAMES, found, strict=True))


def wandering(seed: int = 0, count: int = 120) -> Array:
    """Smooth motion of all joints."""
    rng, times = np.random.default_rng(seed), np.linspace(0, 2, count)[:, None]
    return np.asarray(0.4 * np.sin(2 * np.pi * (rng.uniform(0.1, 0.6, 3 * len(NAMES)) * times
                                                + rng.uniform(0, 1, 3 * len(NAMES)))))


# ------------------------------------------------------------------------------------------------------------- in time

def test_roles_last_for_seconds_and_pass_smoothly_into_each_other() -> None:
    rows = np.array([np.concatenate(role_at(3, 0, float(time))) for time in FINE])
    steps = np.abs(np.diff(rows, axis=0)).max(axis=1)
    # A minimum-jerk step of height 1.4 in 0.8 s has a speed of 1.875 times the mean.
    assert 0 < steps.max() < 1.4 * 1.875 / CHANGES / 60 * 1.01
    assert np.abs(np.diff(rows, n=2, axis=0)).max() < 0.01, "the speed has no jump, either"
    begins = FINE[1:][(steps > 0) & (np.append(0, steps[:-1]) == 0)]
    apart = np.diff(begins)
    assert (apart > PERIOD * (1 - 2 * JITTER) - 0.1).all() and (apart < PERIOD * (1 + 2 * JITTER) + 0.1).all()
    assert apart.std() > 0.5, "not like a clock"


def test_one_hand_gestures_alone_as_often_as_it_says_and_mostly_the_same() -> None:
    drawn = [role_at(seed, 0, PERIOD * (k + 0.57)) for seed in range(60) for k in range(2, 22)]
    alone = [each for each in drawn if np.isclose(each.gestures.min(), WAITS)]
    assert len(alone) / len(drawn) == pytest.approx(ONE_HANDED, abs=0.06)
    assert np.mean([each.hangs.max() for each in alone]) == pytest.approx(HANGING, abs=0.06)
    together = [each for each in drawn if np.allclose(each.gestures, 1)]
    assert np.mean([each.follows.max() for each in together]) == pytest.approx(FOLLOWS, abs=0.05)
    assert all(each.hangs.max() == 0 for each in together)
    leads = [np.mean([each.gestures[0] > each.gestures[1] for each in alone[k:k + 9]]) for k in range(0, 300, 9)]
    assert np.std(leads) > 0.2, "a performance has a hand that it prefers"


def test_another_seed_variation_or_sound_has_other_roles() -> None:
    times = np.arange(0, 120, 0.5)

    def course(roles: Roles) -> Array:
        return np.array([np.concatenate(roles.at(float(time))) for time in times])

    first = course(Roles(0, 0))
    assert np.array_equal(first, course(Roles(0, 0)))
    for other in (Roles(1, 0), Roles(0, 1), Roles(0, 0, voice=3)):
        assert np.abs(first - course(other)).mean() > 0.05


@given(start=st.floats(0, 60), seed=st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_a_hold_keeps_its_role_and_is_forgotten_soon_after(start: float, seed: int) -> None:
    free = Roles(seed, 0)
    held = free.for_block(start, requested=False, held=True)
    assert held.for_block(start + 1, requested=False, held=True) is held
    for time in np.linspace(start, start + 9, 20):
        for mine, its in zip(held.at(float(time)), free.at(start), strict=True):
            np.testing.assert_allclose(mine, its, atol=1e-12)
    after = held.for_block(start + 9, requested=False, held=False)
    for early, late in zip(after.at(start + 9), free.at(start), strict=True):
        np.testing.assert_allclose(early, late, atol=1e-12)
    for time in (start + 9 + CHANGES, start + 30):
        for mine, its in zip(after.at(time), free.at(time), strict=True):
            np.testing.assert_array_equal(mine, its)


def test_what_was_requested_is_shown_by_both_arms() -> None:
    start = next(float(time) for time in FINE if role_at(0, 0, float(time)).hangs.max() == 1.0)
    roles = Roles(0, 0).for_block(start, requested=True, held=False)
    assert roles.at(start).hangs.max() == 1.0, "no jump"
    for mine, its in zip(roles.at(start + CHANGES), AS_GENERATED, strict=True):
        np.testing.assert_array_equal(mine, its)
    assert roles.for_block(start + 0.4, requested=True, held=False) is roles


# ------------------------------------------------------------------------------------------------------------ in a pose

@given(seed=st.integers(0, 99), time=st.floats(0, 300))
@settings(max_examples=40, deadline=None)
def test_a_body_at_rest_stays_at_rest_in_every_role(system: Gesticulator, seed: int, time: float) -> None:
    """Of every speaker of the shipped bundle, whose resting poses are not symmetric."""
    statistics = system.bundle.statistics
    names = CHARACTERS[system.bundle.config.motion.joints].names
    for speaker in range(len(statistics.speakers)):
        rest = statistics.normalise(statistics.rest_pose[speaker], speaker)
        block = np.repeat(rest[None], 3, axis=0)
        np.testing.assert_allclose(shown(Roles(seed, 0), statistics, speaker, names, np.full(3, time), block),
                                   block, atol=1e-9)


def test_what_follows_is_the_mirror_image(statistics: Statistics) -> None:
    out = places(seen(statistics, role(follows=(0.0, 1.0)), wandering()))
    for joint in ("Arm", "ForeArm", "Hand"):
        right, left = out[f"Right{joint}"] - out["RightArm"], out[f"Left{joint}"] - out["LeftArm"]
        # The trunk leans, so the mirror is its own plane: lengths and the angle to the trunk's axis agree.
        assert np.linalg.norm(right) == pytest.approx(np.linalg.norm(left), abs=1e-9)
    upright = wandering()
    upright[:, [k for k in range(upright.shape[1]) if k not in {*RIGHT, *LEFT}]] = 0
    out = places(seen(statistics, role(follows=(0.0, 1.0)), upright))
    for joint in ("ForeArm", "Hand"):
        np.testing.assert_allclose(out[f"Left{joint}"], out[f"Right{joint}"] * [-1, 1, 1], atol=1e-9)


def test_a_hanging_arm_hangs_and_the_other_one_does_not_care(statistics: Statistics) -> None:
    block = wandering()
    plain, out = seen(statistics, role(), block), seen(statistics, role(hangs=(0.0, 1.0)), block)
    np.testing.assert_array_equal(out[:, RIGHT], plain[:, RIGHT])
    assert np.abs(out[:, LEFT] - REST[LEFT]).max() < SWAY * 2.0
    others = [k for k in range(block.shape[1]) if k not in {*RIGHT, *LEFT}]
    np.testing.assert_array_equal(out[:, others], block[:, others])


def test_a_requested_height_lifts_the_posture_and_no_resting_hand(statistics: Statistics) -> None:
    still = np.zeros((1, 3 * len(NAMES)))
    heights = [places(shown(Fixed(0, 0, fixed=role()), statistics, 0, NAMES, np.zeros(1), still, deviations))
               ["RightHand"][1] for deviations in (-1.0, 0.0, 1.0)]
    assert heights[1] - heights[0] > 0.05 and heights[2] - heights[1] > 0.05
    resting = shown(Fixed(0, 0, fixed=role()), statistics, 0, NAMES, np.zeros(1), REST[None], 1.0)
    np.testing.assert_allclose(resting, REST[None], atol=1e-12)


def test_small_movements_stay_near_a_posture_and_large_ones_grow(statistics: Statistics) -> None:
    def size(scale: float) -> float:
        block = np.zeros((1, 3 * len(NAMES)))
        block[:, 3 * NAMES.index("RightForeArm") + 1] = scale
        return float(np.abs(seen(statistics, role(), block)[0, RIGHT]).max() / scale)

    assert size(0.1) < 0.5 and size(6.0) > 1.1
    assert all(size(low) < size(high) for low, high in ((0.1, 1.0), (1.0, 2.0), (2.0, 4.0)))


@given(seed=st.integers(0, 99), time=st.floats(0, 100))
@settings(max_examples=30, deadline=None)
def test_smooth_motion_stays_smooth(statistics: Statistics, seed: int, time: float) -> None:
    block, times = wandering(seed), time + np.linspace(0, 2, 120)
    out = shown(Roles(seed, 0), statistics, 0, NAMES, times, block)
    assert np.abs(np.diff(out, n=2, axis=0)).max() < 0.03, "radians in a frame squared, at 60 Hz"
