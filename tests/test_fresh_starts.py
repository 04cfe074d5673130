"""Fresh starts of preparations: their poses, and the offset that joins them to what was shown."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from gesticulator.sampling.loop import Keys
from gesticulator.systems.movement import FADES, Offset, first_pose

NAMES = ["Spine", "LeftArm", "RightArm"]
REST = np.concatenate([np.full(3, 9.0), np.full(3, 2.0), np.full(3, -4.0)])


@given(st.floats(0.0, 100.0), st.floats(-2.0, 2.0), st.floats(-5.0, 5.0))
def test_an_offset_begins_with_the_pose_and_velocity_shown_and_ends_at_rest(begin: float, pose: float, speed: float
                                                                            ) -> None:
    offset = Offset(begin, np.array([pose]), np.array([speed]))
    step = 1e-3
    start = offset.at(begin + step * np.arange(4.0))[:, 0]
    end = offset.at(begin + FADES - step * np.arange(4.0))[:, 0]
    assert start[0] == pytest.approx(pose, abs=1e-9) and end[0] == pytest.approx(0.0, abs=1e-9)
    assert (start[1] - start[0]) / step == pytest.approx(speed, abs=0.02)
    assert (end[1] - end[0]) / step == pytest.approx(0.0, abs=0.01)
    for path in (start, end):
        assert np.diff(path, 2)[0] / step ** 2 == pytest.approx(0.0, abs=0.6 * (abs(pose) + abs(speed)) + 1e-3)
    assert (offset.at(begin + FADES + np.array([1e-6, 1.0, 50.0])) == 0).all()


def test_first_poses_lie_between_the_speakers_pose_and_rest_each_arm_for_itself() -> None:
    poses = np.stack([first_pose(Keys(1), NAMES, REST, 0.2 * n) for n in range(2000)])
    assert (poses[:, :3] == 0).all(), "the trunk begins in the mean pose"
    shares = poses[:, [3, 6]] / REST[[3, 6]]
    assert shares.min() > -0.45 and shares.max() < 0.55
    assert stats.kstest(shares.ravel(), stats.uniform(-0.45, 1.0).cdf).pvalue > 0.01
    assert abs(stats.spearmanr(*shares.T).statistic) < 0.1
