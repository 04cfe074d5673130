"""Arms that were turned outward are found and turned back; right ones are left as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer import joints, takes
from gesticulator_performer.joints import FPS, facing_positions, torso_depth
from gesticulator_performer.takes import MotionRange
from test_takes import hanging

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER, FINGERED
from data_module.types import Motion
from eval.metrics.eye import posture
from eval.metrics.eye.body import common_body


def test_a_hand_in_the_trunk_comes_out_of_it_and_other_hands_stay() -> None:
    rotations = np.tile(hanging(), (round(4.0 * FPS), 1, 1))
    bends = np.radians(75.0 + np.sin(np.arange(len(rotations)) / 40.0))
    left = CHARACTER.index("LeftArm")
    # The left elbow points inward.
    inward = rotation.from_exponential_map(np.array([np.radians(75.0), 0.0, 0.0]))
    rotations[:, left] = rotation.multiply(rotations[:, left], inward)
    rotations[:, left + 1] = rotation.from_exponential_map(bends[:, None] * np.array([0.0, -1.0, 0.0]))
    before, after = (facing_positions(q) for q in (rotations, joints.freed(rotations)))
    assert torso_depth(before).max() > 0.02 and torso_depth(after).max() < 1e-9
    wrist = CHARACTER.index("RightHand")
    assert np.allclose(before[:, wrist], after[:, wrist])


def _pooled(library: takes.Library, subject: str) -> list[Motion]:
    own = [take for take in library.talks() if joints.subject_of(take.name) == subject]
    pieces = [logs for take in own for logs in takes.stretches(library, take, MotionRange(0.5, 1.0))]
    return [Motion(FINGERED, library.rotations(logs), np.zeros((len(logs), 3)), FPS)
            for logs in pieces]


@pytest.fixture(scope="module")
def library(free_motion: Path) -> takes.Library:
    return takes.load_takes(free_motion)


@pytest.mark.parametrize("subject", sorted(joints.SUBJECTS))
def test_every_subject_holds_arms_and_hands_as_speakers_do(library: takes.Library, subject: str) -> None:
    motions = _pooled(library, subject)
    seconds = np.array([len(motion) for motion in motions])
    rows = [posture.figures(common_body(motion)) for motion in motions]

    def mean(name: str) -> float:
        values = np.array([row[name] for row in rows])
        known = np.isfinite(values)
        return float(np.average(values[known], weights=seconds[known]))

    assert seconds.sum() > 12 * FPS, "cmu_18 listens with hanging hands for most of the time"
    assert mean("eye_splay") <= 15.0 and -35.0 <= mean("eye_azimuth") <= 5.0 and 45.0 <= mean("eye_elbow") <= 100.0
    assert 0.45 <= mean("eye_shoulder") <= 1.1, "stretches of some seconds; whole talks have more"
    assert 25.0 <= mean("eye_wrist_95") <= 65.0
    assert 17.0 <= mean("eye_finger_bend") <= 35.0 and mean("eye_finger_between") >= 7.0
    assert mean("eye_thumb_index") <= 0.85
    assert all(torso_depth(facing_positions(motion.rotations)).max() < 0.01 for motion in motions)
