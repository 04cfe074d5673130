"""Idle life is smooth, small, never still and never periodic, and the same however it is asked for."""

import math

import numpy as np
import pytest

from data_module.motion.kinematics import joint_positions
from data_module.motion.rotation import from_exponential_map
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array
from eval.metrics.eye.trunk import longest, smoothed_speed
from gesticulator.body.life import Idle, Shifts, ShiftStyle, noise, normal, uniform

HANGING = np.zeros((len(CHARACTER), 3))
HANGING[CHARACTER.index("RightArm"), 2] = math.radians(75)
HANGING[CHARACTER.index("LeftArm"), 2] = -math.radians(75)
MINUTE = np.arange(1, 3600) / 60.0


def places(seed: int, times: Array = MINUTE) -> Array:
    """[T, J, 3] metres of a body that hangs its arms and lives."""
    life = Idle(seed, CHARACTER.names, HANGING)(times)
    return joint_positions(CHARACTER, from_exponential_map(HANGING + life))


def test_the_numbers_behind_it_are_the_same_everywhere() -> None:
    # splitmix64 in Python's own integers.
    def scrambled(z: int) -> int:
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % 2**64
        return z ^ (z >> 31)

    step = 0x9E3779B97F4A7C15
    for seed, channel, number in ((0, 0, 0), (2**64 - 1, 7, 12345), (9, 3, -2)):
        expected = scrambled((scrambled((seed + step * (channel + 1)) % 2**64) + step * number) % 2**64)
        assert uniform(seed, channel, np.array([number]))[0] == ((expected >> 11) + 0.5) / 2**53
    drawn = normal(1, 0, np.arange(20_000))
    assert drawn.mean() == pytest.approx(0, abs=0.03) and drawn.std() == pytest.approx(1, abs=0.02)
    assert abs(np.corrcoef(drawn, normal(2, 0, np.arange(20_000)))[0, 1]) < 0.03
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 0.03


def test_noise_has_the_spread_that_it_says_and_nothing_fast() -> None:
    times = np.arange(0, 2000, 0.05)
    made, slow = noise(3, np.array([5, 6]), times, np.array([1.0, 4.0])).T
    assert made.std() == pytest.approx(1, abs=0.05) and abs(made.mean()) < 0.1
    power = np.abs(np.fft.rfft(made)) ** 2
    above = np.fft.rfftfreq(len(made), 0.05) > 1.0
    assert power[above].sum() < 1e-3 * power.sum()
    assert abs(np.corrcoef(made, slow)[0, 1]) < 0.1 and np.abs(np.diff(slow)).max() < 0.5 * np.abs(np.diff(made)).max()
    again = np.correlate(made - made.mean(), made - made.mean(), "full")[len(made):] / (made.var() * len(made))
    assert np.abs(again[100:20_000]).max() < 0.2, "it never comes back"


def test_noise_at_a_time_is_the_same_whatever_it_is_asked_for_with() -> None:
    times, channels, steps = np.array([90.0, 0.01, 3.99, 4.0, 4.01, 700.3]), np.array([9, 2, 5]), np.array([0.1, 1, 4])
    together = noise(3, channels, times, steps)
    for time, row in zip(times, together, strict=True):
        np.testing.assert_array_equal(noise(3, channels, np.array([time]), steps)[0], row)


def test_shifts_settle_on_their_postures_and_jump_nowhere() -> None:
    style = ShiftStyle(every=2.0, jitter=0.2, tau=0.1, spread=(2.0, 1.0), least=1.0, most=2.0)
    shifts = Shifts(4, 0, style)
    settled = shifts.at(np.arange(100) * 2.0 + 1.55)  # every shift began 1.15 s ago at least
    steps = np.linalg.norm(np.diff(settled, axis=0) / style.spread, axis=1)
    assert steps.min() > 0.99 and steps.max() < 2.01
    fine = shifts.at(np.arange(0, 40, 0.001))
    # The steepest of 1 - (1 + a + a^2 / 2) exp(-a) is a^2 / 2 exp(-a) at a = 2: 0.271 of a shift in each tau.
    rate = np.linalg.norm(np.diff(fine, axis=0) / 0.001 / style.spread, axis=1)
    assert rate.max() < 2.0 * 0.271 / style.tau * 1.001
    assert np.abs(np.diff(rate)).max() < 0.2, "no jump of velocity"
    np.testing.assert_allclose(Shifts(4, 0, style).at(np.array([35.0])), shifts.at(np.array([35.0])))


@pytest.mark.parametrize("seed", range(6))
def test_a_body_that_does_nothing_lives(seed: int) -> None:
    at = places(seed)
    speed = smoothed_speed(at[:, [CHARACTER.index(name) for name in ("RightHand", "LeftHand", "Head")]])
    assert longest(speed[:, 2] < 0.02) < 0.7, "the head stands nowhere"
    assert speed[:, :2].min() > 1e-5 and speed[:, :2].max() < 0.09
    assert 0.01 < np.median(speed[:, :2]) < 0.03
    assert np.ptp(at[:, CHARACTER.index("RightHand")], axis=0).max() < 0.12, "and wanders nowhere"


def test_it_is_keyed_by_seed_and_time_alone() -> None:
    whole = Idle(7, CHARACTER.names, HANGING)(MINUTE)
    life = Idle(7, CHARACTER.names, HANGING)
    parts = [life(part) for part in np.split(MINUTE, [31, 32, 100, 2000])]
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-9)
    np.testing.assert_array_equal(Idle(7, CHARACTER.names, HANGING)(MINUTE[2000:]), parts[-1])
    assert np.abs(Idle(8, CHARACTER.names, HANGING)(MINUTE) - whole).max() > math.radians(1)


def test_a_chest_breathes_fifteen_times_a_minute() -> None:
    times = np.arange(0, 240, 0.05)
    raised = Idle(0, CHARACTER.names, HANGING)(times)[:, CHARACTER.index("LeftShoulder"), 2]
    power = np.abs(np.fft.rfft(raised - raised.mean())) ** 2
    frequency = np.fft.rfftfreq(len(raised), 0.05)
    assert 0.2 < frequency[power.argmax()] < 0.3
    assert np.ptp(raised) < math.radians(8)


def test_fingers_bend_along_their_own_bend_and_other_joints_are_found_by_name() -> None:
    names = (*CHARACTER.names, "LeftHandIndex1", "RightHandIndex1", "LeftHandIndex2")
    bent = np.concatenate([HANGING, [[0.0, 0.0, -0.5], [0.0, 0.3, 0.4], [0.0, 0.0, 0.0]]])
    life = Idle(1, names, bent)(MINUTE)
    np.testing.assert_allclose(life[:, :16], Idle(1, CHARACTER.names, HANGING)(MINUTE), atol=1e-12)
    assert np.abs(life[:, 16, 2]).max() > math.radians(1) and not life[:, 16, :2].any()
    np.testing.assert_allclose(life[:, 17, 1] * 4, life[:, 17, 2] * 3)
    assert not life[:, 18].any(), "nothing tells which way a straight finger bends"
    order = (*names[16:], *names[:16])
    np.testing.assert_allclose(Idle(1, order, np.roll(bent, 3, axis=0))(MINUTE), np.roll(life, 3, axis=1), atol=1e-12)
