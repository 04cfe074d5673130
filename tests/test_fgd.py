"""The Frechet gesture distance: scipy's root, Gaussians with a known distance, the papers' own network."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import save_file
from scipy.linalg import sqrtm

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.representation import bone_directions, ted_positions
from data_module.motion.skeletons import CHARACTER
from data_module.types import Array, Motion
from eval.metrics import fgd
from eval.metrics import gesture_features as networks
from eval.metrics.fgd import Gaussian, distance, frechet_distance
from eval.metrics.gesture_features import RawFeatures


def some_features(seed: int, count: int = 80, width: int = 5) -> Array:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, width)) @ rng.normal(size=(width, width)) + rng.normal(size=width)


def gesturing(seconds: float, seed: int, fps: float = 20.0) -> Motion:
    """The character with smooth random swings of every joint."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * fps)) / fps
    size = (len(CHARACTER), 3)
    angles = 0.4 * rng.uniform(size=size) * np.sin(2 * np.pi * (rng.uniform(0.2, 1.2, size) * time[:, None, None]
                                                                + rng.uniform(size=size)))
    return Motion(CHARACTER, rotation.from_exponential_map(angles), np.zeros((len(time), 3)), fps)


# --- the distance

@given(first=st.integers(0, 40), second=st.integers(41, 80))
def test_the_distance_is_scipys_matrix_root_of_the_product(first: int, second: int) -> None:
    a, b = some_features(first), some_features(second)
    ca, cb = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    root = np.real(sqrtm(ca @ cb))
    wanted = ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(ca + cb - 2 * root)
    assert distance(a, b) == pytest.approx(float(wanted), rel=1e-7)
    assert distance(a, b) == pytest.approx(distance(b, a), rel=1e-10)


def test_singular_covariances_give_a_finite_distance() -> None:
    point, line = np.zeros((2, 2)), np.diag([4.0, 0.0])
    assert frechet_distance(Gaussian(np.zeros(2), point), Gaussian(np.ones(2), point)) == pytest.approx(2.0)
    assert frechet_distance(Gaussian(np.zeros(2), point), Gaussian(np.zeros(2), line)) == pytest.approx(4.0)
    across = np.diag([0.0, 1.0])
    assert frechet_distance(Gaussian(np.zeros(2), line), Gaussian(np.zeros(2), across)) == pytest.approx(5.0)
    few = distance(some_features(1, 6, 20), some_features(2, 6, 20))
    assert math.isfinite(few) and few > 0
    for same in (np.ones((10, 4)), some_features(0, 4, 12), some_features(0, 80, 12)):
        assert 0.0 <= distance(same, same) == pytest.approx(0.0, abs=1e-10 * max(1.0, float(same.var())))


def test_features_of_other_widths_are_refused() -> None:
    with pytest.raises(ValueError):
        distance(some_features(0), some_features(0, width=4))


# --- figures with their intervals

def clips_of(rng: np.random.Generator, count: int, middle: float = 0.0) -> list[Array]:
    """Features of clips that are each a little apart from the others."""
    return [middle + rng.normal(size=3) + rng.normal(size=(20, 3)) for _ in range(count)]


def test_a_figure_tells_all_that_it_depends_on() -> None:
    rng = np.random.default_rng(0)
    real, far = clips_of(rng, 12), clips_of(rng, 12, 5.0)
    got = fgd.measure(far, real)
    assert got.interval.mean == pytest.approx(distance(np.concatenate(far), np.concatenate(real)))
    assert got.interval.low < got.interval.mean < got.interval.high and got.interval.n == 12
    assert got.windows == (240, 240) and got.needed == 15
    assert fgd.measure(far, real) == got


def test_the_interval_holds_the_true_distance_about_as_often_as_it_says() -> None:
    # Clips' middles have variance 1, windows about them another 1: sets of variance 2, at 3 * 1.5^2 from each other.
    rng = np.random.default_rng(1)
    held = 0
    for trial in range(60):
        got = fgd.measure(clips_of(rng, 40, 1.5), clips_of(rng, 40), seed=trial)
        held += got.interval.low <= 3 * 1.5 ** 2 <= got.interval.high
    assert held >= 50


def test_pairs_are_drawn_together() -> None:
    rng = np.random.default_rng(2)
    real = clips_of(rng, 15)
    near = [clip + 0.5 for clip in real]
    together, apart = fgd.measure(near, real, paired=True), fgd.measure(near, real)
    assert together.interval.mean == pytest.approx(3 * 0.25)
    assert together.interval.high - together.interval.low == pytest.approx(0.0, abs=1e-6)
    assert apart.interval.high - apart.interval.low > 0.5
    with pytest.raises(ValueError):
        fgd.measure(near[1:], real, paired=True)


def test_too_few_windows_are_told_and_two_are_needed() -> None:
    rng = np.random.default_rng(3)
    few = fgd.measure([rng.normal(size=(4, 9))], [rng.normal(size=(50, 9))])
    assert math.isfinite(few.interval.mean) and "45 are needed" in few.doubt
    assert math.isnan(few.interval.low)  # one clip says nothing of other clips
    none = fgd.measure([np.zeros((0, 9))], [rng.normal(size=(50, 9))])
    assert math.isnan(none.interval.mean) and none.doubt == "0 windows, and 45 are needed"
    # clips too short for a window are left out, and are no error
    mixed = fgd.measure([np.zeros((0, 9)), rng.normal(size=(60, 9))], [rng.normal(size=(50, 9))] * 2)
    assert mixed.windows == (60, 100) and math.isfinite(mixed.interval.mean)


# --- windows

def test_windows_are_unit_directions_at_the_rate_asked_for() -> None:
    motion = gesturing(4.0, 0, fps=30.0)
    own = networks.directions(motion, 15.0)
    assert own.shape == (60, 27)
    np.testing.assert_allclose(np.linalg.norm(own.reshape(-1, 9, 3), axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(own, bone_directions(ted_positions(motion)).reshape(-1, 27)[::2], atol=1e-9)
    cut = networks.windows(motion, 20, 15.0)
    assert cut.shape == (5, 20, 27)
    np.testing.assert_array_equal(cut[3], own[30:50])
    assert networks.windows(motion, 61, 15.0).shape == (0, 61, 27)


def test_raw_features_are_the_directions_themselves() -> None:
    own = networks.windows(gesturing(8.0, 2), 30)
    got = RawFeatures(30).features(own)
    assert got.shape == (len(own), 54) and RawFeatures(30).features(own[:0]).shape == (0, 54)
    np.testing.assert_array_equal(got[:, 27:], own[:, 29])


# --- the network of the papers

def test_the_published_network_gives_the_reference_features_and_distance(outside_data: Path) -> None:
    network = networks.published(outside_data / "fgd")
    with np.load(outside_data / "fgd" / "h36m_reference.npz", allow_pickle=False) as stored:
        wanted = {key: stored[key] for key in stored.files}
    axes = np.tile(networks.PUBLISHED_AXES, 9)
    first, second = (wanted[f"windows_{name}"] * axes for name in "ab")
    a, b = network.features(first), network.features(second)
    # Features reach 16 and come out of sums of hundreds of terms of that size in single precision, in an order that
    # depends on the processor and on how many windows there are: 2.2e-5 is the most of four kinds of processors.
    rounding = {"rtol": 0.0, "atol": 1e-4}
    np.testing.assert_allclose(a, wanted["features_a"], **rounding)
    np.testing.assert_allclose(b, wanted["features_b"], **rounding)
    assert distance(a, b) == pytest.approx(float(wanted["fgd"]), rel=1e-5)
    assert (network.frames, network.fps, a.shape) == (34, 15.0, (64, 32))
    # the windows' own order is no matter, and neither is how many are asked for at a time
    np.testing.assert_allclose(network.features(first[::-1])[::-1], a, **rounding)
    np.testing.assert_allclose(network.features(first[:1])[0], a[0], **rounding)
    assert network.features(first[:0]).size == 0


def test_our_character_lies_in_the_published_network_as_its_own_people_did(outside_data: Path) -> None:
    """Every bone within 40 degrees of its mean in the network's training data, left on the left and up where up was."""
    told = json.loads((outside_data / "fgd" / "h36m_gesture_encoder.json").read_text())
    mean = np.array(told["mean_dir_vec"]).reshape(9, 3)
    arms_down = np.zeros((1, len(CHARACTER), 3))
    for side, sign in (("Left", -1.0), ("Right", 1.0)):  # from the T-pose: arms lowered, forearms forward
        arms_down[0, CHARACTER.index(side + "Arm"), 2] = sign * 1.1
        arms_down[0, CHARACTER.index(side + "ForeArm"), 1] = sign * 1.2
    pose = Motion(CHARACTER, rotation.from_exponential_map(arms_down), np.zeros((1, 3)), 15.0)
    ours = networks.directions(pose, 15.0).reshape(9, 3) * networks.PUBLISHED_AXES
    cosines = (ours * mean).sum(1) / np.linalg.norm(mean, axis=1)
    assert (cosines > math.cos(math.radians(40))).all()


def test_what_is_not_the_published_network_is_refused(tmp_path: Path) -> None:
    for wrong in (None, b"no"):
        if wrong:
            (tmp_path / networks.PUBLISHED).write_bytes(wrong)
        with pytest.raises(InputError, match="gesture encoder"):
            networks.published(tmp_path)
    save_file({"a": torch.zeros(3)}, tmp_path / networks.PUBLISHED)
    with pytest.raises(InputError, match="gesture encoder"):
        networks.published(tmp_path)


def test_two_lengths_of_windows_stand_beside_each_other(outside_data: Path) -> None:
    assert list(networks.spaces(None)) == [f"raw directions of 2 frames, {frames} frames" for frames in (34, 60)]
    first, second = networks.spaces(outside_data / "fgd").values()
    assert (first.frames, second.frames) == (34, 60) and first.name.startswith("Human3.6M")


# --- the report

def test_a_distance_of_chosen_clips() -> None:
    rng = np.random.default_rng(0)
    real = [rng.normal(size=(30, 3)) for _ in range(5)]
    off = [clip + np.array([3.0, 0.0, 0.0]) for clip in real]
    # Two Gaussians of one covariance: the squared distance of the means, whichever clips are drawn, and however often.
    for chosen in (np.arange(5), np.array([0, 0, 3])):
        assert fgd.of_chosen(off, real)(chosen) == pytest.approx(9.0)
    empty = [np.zeros((0, 0)), *off[1:]]
    assert fgd.of_chosen(empty, [empty[0], *real[1:]])(np.arange(5)) == pytest.approx(9.0), "too short for a window"
    assert math.isnan(fgd.of_chosen(empty, real)(np.array([0, 0])))
