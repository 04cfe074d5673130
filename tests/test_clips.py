"""Clips for animation tools: reduced keys, loops, masks, layers, names."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_reader import GlbFile as GlbData
from hypothesis import given, settings
from hypothesis import strategies as st
from performances import perform, write
from scipy.spatial.transform import Rotation, Slerp
from small_characters import write_character

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import FINGERED, LEG_JOINTS, WHOLE_BODY
from data_module.motion.standing_legs import with_standing_legs
from data_module.types import Array, Motion
from gesticulator.body.clips import added_to_rest, looped, upper_alone
from gesticulator.export.clip import ClipLayout, parse_keys
from gesticulator.export.key_reduction import METRES_PER_DEGREE, SPAN, STEADY_SHARE, kept_frames, rotation_errors
from gesticulator.jobs import Job, infer_arguments, jobs_of

FPS = 60.0


def lively(frames: int, joints: int, seed: int = 0, tremor: float = 0.002) -> Array:
    """[frames, joints, 4] turns of some seconds' period with a little tremor; signs are continuous."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / FPS
    phase = rng.uniform(0, 6, (joints, 3))
    waves = sum(rng.normal(size=(joints, 3)) * 0.5 / k * np.sin(2 * np.pi * 0.2 * k * time + k * phase)
                for k in (1, 2, 3, 5))
    return rotation.continuous(rotation.from_exponential_map(waves + tremor * rng.normal(size=(frames, joints, 3))))


def standing_motion(seconds: float, seed: int = 1) -> Motion:
    frames = round(seconds * FPS)
    turns = lively(frames, len(WHOLE_BODY), seed, 0.0)
    turns[:, 0] = rotation.from_exponential_map(0.1 * rotation.to_exponential_map(turns[:, 0]))
    return with_standing_legs(Motion(WHOLE_BODY, turns, np.zeros((frames, 3)), FPS))


def played(times: Array, keys: Array, turns: Array) -> Array:
    """[T, 4] (w last) what a player shows at times: slerp between keys, by scipy."""
    return Slerp(keys, Rotation.from_quat(turns))(times).as_quat()


# ---------------------------------------------------------------------------------------------------- keys

@settings(max_examples=40)
@given(st.integers(1, 700), st.integers(0, 1000), st.sampled_from([0.02, 0.1, 1.0, 5.0]),
       st.sampled_from([0, 0.003, 0.3]))
def test_no_frame_is_farther_off_than_the_bound(frames: int, seed: int, degrees: float, tremor: float) -> None:
    turns = lively(frames, 2, seed, tremor)
    kept = kept_frames(turns, np.radians([degrees, 2 * degrees]), rotation_errors)
    assert kept[[0, -1]].all()
    if frames < 2:
        return
    for track, bound in ((0, degrees), (1, 2 * degrees)):
        keys = np.flatnonzero(kept[:, track])
        shown = played(np.arange(frames), keys, turns[keys, track][:, [1, 2, 3, 0]])
        off = Rotation.from_quat(shown) * Rotation.from_quat(turns[:, track], scalar_first=True).inv()
        assert np.degrees(off.magnitude()).max() <= bound + 1e-5


def test_what_stands_still_or_turns_evenly_takes_the_keys_of_its_ends() -> None:
    frames = 2 * SPAN + 100
    still = np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1))
    even = rotation.from_exponential_map(np.linspace(0, 2.5, frames)[:, None] * [0.6, 0.0, 0.8])
    kept = kept_frames(np.stack([still, even], axis=1), np.radians([0.1, 0.1]), rotation_errors)
    assert np.flatnonzero(kept[:, 0]).tolist() == np.flatnonzero(kept[:, 1]).tolist() == [0, SPAN, 2 * SPAN, frames - 1]


def test_a_knee_in_the_path_gets_its_key() -> None:
    angles = np.interp(np.arange(101), [0, 37, 100], [0.0, 1.0, 0.2])
    kept = kept_frames(rotation.from_exponential_map(angles[:, None] * [0.0, 1.0, 0.0])[:, None], np.radians([0.1]),
                       rotation_errors)
    assert np.flatnonzero(kept[:, 0]).tolist() == [0, 37, 100]


@pytest.mark.parametrize("suffix", [".glb", ".vrma"])
def test_a_file_read_back_is_within_the_stated_error(suffix: str, tmp_path: Path) -> None:
    motion = standing_motion(6.0)
    made = replace(perform(6.0, FPS, skeleton=WHOLE_BODY), motion=motion)
    files = [GlbData.parse(write(tmp_path / f"{keys}{suffix}", replace(made, clip=ClipLayout(keys=keys))).read_bytes())
             for keys in (0.0, 0.1)]
    every, few = (tracks(file) for file in files)
    assert set(every) == set(few)
    assert sum(len(times) for times, _ in few.values()) < 0.5 * sum(len(times) for times, _ in every.values())
    hips = {"Hips", "hips"}
    for (name, path), (times, values) in every.items():
        keys, turns = few[name, path]
        steady = name in (*LEG_JOINTS, *hips) or "Leg" in name or name.endswith(("Foot", "Toes"))
        if path == "translation":
            shown = np.stack([np.interp(times, keys, column) for column in turns.T], axis=1)
            assert np.linalg.norm(shown - values, axis=1).max() <= METRES_PER_DEGREE * 0.1 + 1e-6
        else:
            off = Rotation.from_quat(played(times, keys, turns)) * Rotation.from_quat(values).inv()
            assert np.degrees(off.magnitude()).max() <= 0.1 * (STEADY_SHARE if steady else 1.0) + 1e-4


def tracks(file: GlbData) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Name and property -> times and values of the last animation."""
    own = file.document["animations"][-1]
    return {(file.names()[channel["target"]["node"]], channel["target"]["path"]): (
        file.numbers(own["samplers"][channel["sampler"]]["input"])[:, 0].astype(float),
        file.numbers(own["samplers"][channel["sampler"]]["output"]).astype(float)) for channel in own["channels"]}


def test_keys_on_the_command_line() -> None:
    assert parse_keys("all") == 0.0 and parse_keys("0.5") == 0.5
    for bad in ("0", "-1", "6", "nan", "few"):
        with pytest.raises(InputError, match="--keys"):
            parse_keys(bad)
    with pytest.raises(InputError, match="--clip-name"):
        ClipLayout("a\nb")


# ---------------------------------------------------------------------------------------------------- motion

@given(st.integers(0, 100), st.floats(1.0, 8.0))
@settings(max_examples=25)
def test_a_loop_has_no_seam_in_place_and_speed(seed: int, seconds: float) -> None:
    motion = standing_motion(seconds, seed)
    loop = looped(motion)
    assert len(loop) == len(motion) + 1 and loop.fps == motion.fps
    places = positions_of(loop)
    np.testing.assert_allclose(places[-1], places[0], atol=1e-9)
    around = np.concatenate([places[-4:-1], places[:4]])
    bends = np.linalg.norm(np.diff(around, n=2, axis=0), axis=-1) * FPS ** 2
    usual = np.linalg.norm(np.diff(positions_of(motion), n=2, axis=0), axis=-1) * FPS ** 2
    assert bends.max() <= 1.5 * usual.max() + 8.0, "metres per second squared; a jump of a centimetre would be 36"
    near = round(1.5 * FPS)
    np.testing.assert_allclose(rotation.angle_between(loop.rotations, np.concatenate(
        [motion.rotations, motion.rotations[:1]]))[near:len(motion) - near], 0.0, atol=1e-6)
    feet = [WHOLE_BODY.index(side + "Foot") for side in ("Left", "Right")]
    assert np.ptp(places[:, feet], axis=0).max() < 5e-3, "planted"


def test_too_little_for_a_loop_is_refused() -> None:
    with pytest.raises(InputError, match="--loop: needs 8 frames"):
        looped(standing_motion(0.1))


def test_the_upper_body_alone_keeps_its_pose() -> None:
    motion = standing_motion(2.0)
    upper = upper_alone(motion)
    spine, hand = WHOLE_BODY.index("Spine"), WHOLE_BODY.index("LeftHand")
    before, after = positions_of(motion), positions_of(upper)
    np.testing.assert_allclose(after[:, hand] - after[:, spine], before[:, hand] - before[:, spine], atol=1e-9)
    for name in ("Hips", *LEG_JOINTS):
        np.testing.assert_array_equal(upper.rotations[:, WHOLE_BODY.index(name)], [[1.0, 0.0, 0.0, 0.0]] * len(upper))


def test_an_additive_layer_over_the_resting_pose_is_the_gesture(tmp_path: Path) -> None:
    """A character whose own clip holds it in its resting pose: with the layer added, it gestures as without."""
    rest = perform(0.2, seed=9, skeleton=FINGERED).motion.crop(0, 1)
    made = replace(perform(1.0, skeleton=FINGERED), rest=lambda: rest)
    source = write_character(tmp_path / "her.glb", seed=5)
    plain = made.as_clip(ClipLayout(upper=True, keys=0.0)).on(source)
    layer = made.as_clip(ClipLayout(additive=True, keys=0.0)).on(source)
    idle = replace(made, motion=rest).as_clip(ClipLayout(upper=True, keys=0.0)).on(source)
    assert plain.character is not None and layer.character is not None and idle.character is not None
    own = plain.character.character.rotations
    delta = rotation.multiply(rotation.conjugate(own), layer.character.rotations)
    shown = rotation.multiply(idle.character.rotations, delta)
    assert rotation.angle_between(shown, plain.character.rotations).max() < 1e-6
    assert layer.character.translations is None
    moved = {name for name, _ in tracks(GlbData.parse(write(tmp_path / "a.glb", layer).read_bytes()))}
    assert any("Arm" in name for name in moved) and not [name for name in moved if "Leg" in name or "Hips" in name]
    ours = added_to_rest(upper_alone(made.motion), upper_alone(rest))
    back = rotation.multiply(upper_alone(rest).rotations, ours.rotations)
    assert rotation.angle_between(back, upper_alone(made.motion).rotations).max() < 1e-6


def test_a_clip_is_made_before_it_is_moved_to_a_character(tmp_path: Path) -> None:
    made = perform(1.0, skeleton=FINGERED).on(write_character(tmp_path / "her.glb"))
    assert made.as_clip(ClipLayout("talk", 0.5)).clip == ClipLayout("talk", 0.5)
    with pytest.raises(ValueError, match="make the clip first"):
        made.as_clip(ClipLayout(loop=True))


# ---------------------------------------------------------------------------------------------------- files

def test_the_name_is_in_every_file_that_has_one(tmp_path: Path) -> None:
    made = perform(0.5).as_clip(ClipLayout("wave 2"))
    for suffix in (".glb", ".vrma"):
        document = GlbData.parse(write(tmp_path / f"a{suffix}", made).read_bytes()).document
        assert [animation["name"] for animation in document["animations"]] == ["wave 2"]
    pytest.importorskip("pxr")
    from pxr import Usd, UsdSkel

    stage = Usd.Stage.Open(str(made.save(tmp_path / "a.usda")))
    (animation,) = [prim.GetName() for prim in stage.Traverse() if prim.IsA(UsdSkel.Animation)]
    assert animation == "wave_2"


def jobs(words: str) -> list[Job]:
    """The jobs of a command line."""
    parser = argparse.ArgumentParser()
    infer_arguments(parser)
    return jobs_of(parser.parse_args(["a.wav", *words.split()]))


def test_options_make_the_layout_or_are_refused() -> None:
    with pytest.raises(InputError, match=r"--layer additive: makes no sense in \.npz"):
        jobs("-o a.smplx.npz --layer additive")
    (job,) = jobs("-o a.glb -o a.html --loop --mask upper")
    assert job.clip == ClipLayout(loop=True, upper=True)
    (plain,) = jobs("-o a.glb")
    assert plain.clip is None
