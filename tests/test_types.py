"""The glossary refuses what would break a stage further on."""

import subprocess
import sys

import numpy as np
import pytest

from data_module.errors import EXIT_PIPE, InputError
from data_module.types import Array, BeatFlag, Beats, Blocks, Motion, Skeleton, Speech

TWO = Skeleton(("root", "tip"), (-1, 0), np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))


def still(frames: int) -> Array:
    rotations = np.zeros((frames, 2, 4))
    rotations[..., 0] = 1.0
    return rotations


@pytest.mark.parametrize(("names", "parents", "offsets"), [
    (("a", "b"), (-1,), np.zeros((2, 3))),
    (("a", "a"), (-1, 0), np.zeros((2, 3))),
    (("a", "b"), (1, -1), np.zeros((2, 3))),
    (("a", "b"), (-1, -1), np.zeros((2, 3))),
    (("a", "b"), (-1, 1), np.zeros((2, 3))),
    (("a", "b"), (-1, 0), np.full((2, 3), np.nan)),
    (("a", "b"), (-1, 0), np.zeros((2, 2))),
    ((), (), np.zeros((0, 3))),
])
def test_a_skeleton_that_is_no_tree_is_refused(names: tuple[str, ...], parents: tuple[int, ...],
                                               offsets: Array) -> None:
    with pytest.raises(ValueError):
        Skeleton(names, parents, offsets)


def test_a_motion_refuses_wrong_shapes_no_frames_no_rate_and_nan() -> None:
    for rotations, root, fps in [
        (still(3)[:, :1], np.zeros((3, 3)), 30.0),
        (still(3), np.zeros((2, 3)), 30.0),
        (still(0), np.zeros((0, 3)), 30.0),
        (still(3), np.zeros((3, 3)), 0.0),
        (still(3), np.zeros((3, 3)), float("nan")),
        (still(3) * np.nan, np.zeros((3, 3)), 30.0),
        (still(3), np.full((3, 3), np.inf), 30.0),
    ]:
        with pytest.raises(ValueError):
            Motion(TWO, rotations, root, fps)


def test_speech_without_samples_or_with_nan_is_the_users_error() -> None:
    with pytest.raises(InputError, match="no samples"):
        Speech(np.zeros(0, dtype=np.float32), 16000)
    with pytest.raises(InputError, match="not numbers"):
        Speech(np.array([0.0, np.nan], dtype=np.float32), 16000)
    with pytest.raises(ValueError):
        Speech(np.zeros((2, 2), dtype=np.float32), 16000)
    assert Speech(np.zeros(8000, dtype=np.float32), 16000).duration == 0.5


def test_beats_rise_strictly_from_zero() -> None:
    flags = np.full(3, BeatFlag.ONSET, dtype=np.int8)
    Beats(np.array([0.0, 0.3, 0.5]), flags)
    for times in ([0.1, 0.3, 0.5], [0.0, 0.3, 0.3], [0.0, 0.5, 0.3]):
        with pytest.raises(ValueError):
            Beats(np.array(times), flags)


def test_the_last_frame_of_a_block_lies_on_its_beat() -> None:
    edges = np.array([0.0, 0.3, 0.7])
    blocks = Blocks(edges, np.ones(2, dtype=np.int8), np.zeros(2, dtype=bool), 3, 20.0)
    # By hand: thirds of 0.3 s after 0, then thirds of 0.4 s after 0.3.
    assert blocks.knot_times == pytest.approx([0.1, 0.2, 0.3, 0.3 + 0.4 / 3, 0.3 + 0.8 / 3, 0.7])
    assert blocks.knot_times[5] == edges[2]
    with pytest.raises(ValueError):
        Blocks(edges[::-1].copy(), np.ones(2, dtype=np.int8), np.zeros(2, dtype=bool), 3, 20.0)


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    code = ("from data_module.errors import one_line_errors\n"
            "with one_line_errors('prog'):\n"
            "    for line in range(100_000):\n        print(line)\n")
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdout is not None and running.stderr is not None
        assert running.stdout.readline() == b"0\n"
        running.stdout.close()
        told = running.stderr.read()
    assert told == b"" and running.returncode == EXIT_PIPE
