"""People who stand and wait: their way onto the character, their splits, and what must not change because of them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer import idle, takes
from gesticulator_performer.joints import FPS, facing_positions
from gesticulator_performer.takes import RealTake
from test_takes import hanging, moving

from data_module.errors import InputError
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import write_bvh
from data_module.motion.skeletons import CHARACTER, FINGERED
from data_module.types import Array, Motion, Skeleton

UP, AHEAD = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
ROWS = [("pelvis", -1, 0.0, 0.0), ("pelvis.L", 0, 0.0, 0.0), ("spine", 0, 0.0, 0.0), ("spine.001", 2, 0.0, 0.2),
        ("neck", 3, 0.0, 0.2), ("face", 4, 0.0, 0.16), ("shoulder.L", 3, 0.0, 0.2), ("upper_arm.L", 6, 0.14, 0.0),
        ("forearm.L", 7, 0.22, 0.0), ("shoulder.R", 3, 0.0, 0.2), ("upper_arm.R", 9, -0.14, 0.0),
        ("forearm.R", 10, -0.22, 0.0)]


def turn(axis: Array, degrees: float) -> Array:
    return rotation.from_exponential_map(np.radians(degrees) * axis)


def write_take(file: Path) -> None:
    """Two seconds of a body as of ReActIdle that turns by 12 degrees a second; the hips roll by 8 degrees and the chest
    by 3, both upper arms hang and the left forearm points ahead."""
    names, parents, left, up = zip(*ROWS, strict=True)
    offsets = np.stack([left, up, np.zeros(len(ROWS))], axis=1)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (48, len(names), 1))
    q[:, 0] = rotation.from_exponential_map(np.radians(np.arange(48)[:, None] / 2.0) * UP)
    for name, axis, degrees in (("pelvis.L", AHEAD, 8), ("spine", AHEAD, 3), ("upper_arm.L", AHEAD, -90),
                                ("forearm.L", UP, -90), ("upper_arm.R", AHEAD, 90)):
        q[:, names.index(name)] = turn(axis, degrees)
    body = Skeleton(names, parents, offsets, {8: np.array([0.21, 0, 0]), 11: np.array([-0.21, 0, 0])})
    write_bvh(file.with_name("plain.bvh"), Motion(body, q, np.zeros((48, 3)), 24.0), 1.0)
    file.write_bytes(gzip.compress(file.with_name("plain.bvh").read_bytes()))


def test_a_body_comes_onto_the_character_as_it_stands(tmp_path: Path) -> None:
    write_take(tmp_path / "take.bvh.gz")
    rotations = idle.stretch(tmp_path / "take.bvh.gz", (0.5, 1.5)).rotations[24]
    yaw = turn(UP, 12.0 * (0.5 + 24 / FPS))
    chest = rotation.multiply(yaw, turn(AHEAD, 3))
    places = dict(zip(FINGERED.names, kinematics.joint_positions(FINGERED, rotations[None])[0], strict=True))
    assert rotations[0] == pytest.approx(rotation.multiply(yaw, turn(AHEAD, 8)), abs=1e-4)
    for above, below, bone in (("LeftArm", "LeftForeArm", -0.28 * UP), ("RightArm", "RightForeArm", -0.28 * UP),
                               ("LeftForeArm", "LeftHand", 0.25 * AHEAD), ("RightForeArm", "RightHand", -0.25 * UP),
                               ("Neck1", "Head", FINGERED.offsets[FINGERED.index("Head")])):
        assert places[below] - places[above] == pytest.approx(rotation.rotate(chest, bone), abs=1e-4), below


def test_people_are_in_one_split_and_move_no_other_take(tmp_path: Path) -> None:
    assert idle.stretches_of(tmp_path / "none") == []
    with pytest.raises(InputError, match=r"001_acted\.bvh\.gz: does not exist"):
        idle.stretches_of(tmp_path)
    for stem in idle._TABLE["stretches"]:
        (tmp_path / f"{stem}.bvh.gz").write_bytes(b"no gzip")
    with pytest.raises(InputError, match=r"001_acted\.bvh\.gz: is not a gzipped BVH file"):
        idle.stretch(tmp_path / "001_acted.bvh.gz", (0.5, 1.5))

    def read(name: str, person: str, group: str, seed: int) -> tuple[RealTake, Array]:
        take = RealTake(name, person, group, "none", np.zeros((0, 16, 3)))
        return take, rotation.multiply(hanging()[None], rotation.from_exponential_map(moving(1.0, seed)))

    waiting = [read(name, person, "idling", 0) for name, person, _, _ in idle.stretches_of(tmp_path)]
    others = [read(f"m_idle_neutral_{k}", "him", "idling", k) for k in range(20)] + [read("cmu_18", "a", "traffic", 1)]
    alone, joined = takes.library_of(others), takes.library_of([*others, *waiting])
    assert np.array_equal(alone.rest, joined.rest) and np.array_equal(alone.centre, joined.centre)
    assert all(np.array_equal(a.logs, b.logs) for a, b in zip(alone.takes, joined.takes, strict=False))
    splits, held = takes.split_of_takes(joined.takes), ("012", "013", "014", "015", "016")
    assert takes.split_of_takes(alone.takes) == {take.name: splits[take.name] for take in alone.takes}
    assert all((splits[take.name] == "train") == (take.name.split("_")[1] not in held) for take, _ in waiting)
    assert {splits[take.name] for take, _ in waiting} == {"train", "val", "test"}


def test_people_who_wait_stand_upright_with_hanging_arms(outside_data: Path) -> None:
    if not (outside_data / "idle").is_dir():
        pytest.skip("the outside data has no idle")
    for name, _, file, seconds in idle.stretches_of(outside_data / "idle")[::3]:
        places = facing_positions(idle.stretch(file, seconds).rotations[:, :len(CHARACTER)])
        left, right = (places[:, wrist] for wrist in takes.WRISTS)
        assert max(left[:, 1].max(), right[:, 1].max()) < 0.12 and min(left[:, 0].mean(), -right[:, 0].mean()) > 0.05
        head = places[:, CHARACTER.index("Head")]
        assert head[:, 1].min() > 0.5 and np.abs(head[:, 0]).max() < 0.2, name
