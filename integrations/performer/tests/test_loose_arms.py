"""What sources lack is made: the rhythm of the shoulder, wrists that lag, hands with shapes."""

from __future__ import annotations

import numpy as np
import pytest
from gesticulator_performer import shoulders, takes, wrists
from gesticulator_performer.torso import FPS, facing_positions
from test_mended_arms import SIDES, hanging

from data_module.motion import kinematics, rotation
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array

# ---------------------------------------------------------------------------------------------------------- shoulders


def raised(elevation: float, ahead: bool = False) -> Array:
    """[10, 16, 4] straight arms, lifted by degrees to the side or ahead."""
    out = np.tile([1.0, 0.0, 0.0, 0.0], (10, 16, 1))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        down = rotation.from_exponential_map(np.array([0.0, 0.0, -sign * np.radians(90.0)]))
        axis = np.array([-1.0, 0.0, 0.0]) if ahead else np.array([0.0, 0.0, sign])
        up = rotation.from_exponential_map(np.radians(elevation) * axis)
        out[:, CHARACTER.index(side + "Arm")] = rotation.multiply(up, down)
    return out


@pytest.mark.parametrize("side", SIDES)
def test_a_level_arm_has_a_third_of_its_elevation_from_the_shoulder(side: str) -> None:
    lift, forward = shoulders.rhythm(CHARACTER, raised(90.0), side)
    # A third of 60 degrees, and 18 degrees a metre for half a metre over a hanging hand; limited softly at 22.
    assert lift == pytest.approx(22.0 * np.tanh(29.0 / 22.0), abs=0.1)
    assert np.abs(forward) == pytest.approx(1.5, abs=0.1)
    low, _ = shoulders.rhythm(CHARACTER, raised(0.0), side)
    assert np.abs(low).max() < 1.0, "hanging arms leave the shoulder where it is"
    assert shoulders.rhythm(CHARACTER, raised(90.0, ahead=True), side)[1].min() > 5.0


def test_the_shoulder_goes_up_and_forward_and_the_upper_arm_keeps_its_direction() -> None:
    before = raised(80.0, ahead=True)
    after = shoulders.with_rhythm(CHARACTER, before, FPS)
    one, two = (kinematics.joint_positions(CHARACTER, q) for q in (before, after))
    for side in SIDES:
        arm, elbow, hand = (CHARACTER.index(side + name) for name in ("Arm", "ForeArm", "Hand"))
        assert (two[:, arm] - one[:, arm])[:, 1].min() > 0.02 and (two[:, arm] - one[:, arm])[:, 2].min() > 0.005
        assert np.allclose(two[:, elbow] - two[:, arm], one[:, elbow] - one[:, arm])
        assert np.linalg.norm(two[:, hand] - one[:, hand], axis=1).max() < 0.07
    logs = rotation.to_exponential_map(after)
    assert np.allclose(takes.mirrored(logs), logs, atol=1e-9)
    assert np.allclose(shoulders.with_rhythm(CHARACTER, before, FPS, 0.0), before)


# ------------------------------------------------------------------------------------------------------------- wrists


def test_a_hand_hangs_a_little_bent_and_a_raised_one_is_extended() -> None:
    still = hanging(0.0, seconds=1.0, bend=5.0)
    hand = CHARACTER.index("LeftHand")
    level = np.tile([1.0, 0.0, 0.0, 0.0], (60, 1))
    low = wrists.bends(facing_positions(still)[:, hand], level)[0]
    high = wrists.bends(np.tile([0.3, 0.4, 0.3], (60, 1)), level)[0]
    assert 5.0 < low.mean() < 8.5 and -10.5 < high.mean() < -8.0
