"""Blocks with knobs, each shaped from the blocks that it remembers, against one pass over all poses."""

from __future__ import annotations

from functools import cache
from typing import cast

import numpy as np
import pytest

from data_module.types import Array, Blocks
from gesticulator import Gesticulator
from gesticulator.directing import shaped_blocks
from gesticulator.directing.directions import Shaping
from gesticulator.directing.editing import PlayedBlock, Rows
from gesticulator.directing.shaped_blocks import ShapedBlock, ShapedBlocks
from gesticulator.directing.strokes import FINE, LARGE, StrokeMemory, StrokeScale
from gesticulator.options import InferenceOptions
from gesticulator.sampling.loop import BlockMotion

COUNT, FRAMES, SECONDS = 120, 8, 0.33
"""40 seconds: twice as long as a stroke is remembered by an arm that hardly moves."""
CUT = Blocks(np.arange(COUNT + 1) * SECONDS, np.zeros(COUNT, np.int8), np.zeros(COUNT, bool), FRAMES, FRAMES / SECONDS)


@cache
def system() -> Gesticulator:
    return Gesticulator.from_pretrained()


def moving(liveliness: float) -> Rows:
    """[N, K, D_m] normalised motion of a body that swings its limbs, and now and then is still."""
    rng, width = np.random.default_rng(7), len(system().bundle.statistics.deviation)
    times = np.arange(COUNT * FRAMES)[:, None] * SECONDS / FRAMES
    waves = np.sum([np.sin(2.0 * np.pi * (rng.uniform(0.2, 1.2, width) * times + rng.uniform(size=width)))
                    for _ in range(4)], axis=0)
    awake = np.clip(3.0 * np.sin(times / 3.0) + 1.5, 0.0, 1.0)
    return (liveliness * awake * waves).astype(np.float32).reshape(COUNT, FRAMES, width)


def played(motion: Rows, numbers: list[int]) -> list[PlayedBlock]:
    nothing = cast("BlockMotion", None)
    return [PlayedBlock(nothing, rows, number) for rows, number in zip(motion, numbers, strict=True)]


def shaping(options: InferenceOptions) -> Shaping:
    return Shaping(system().bundle, options, 0, (), CUT.edges)


def at_once(motion: Rows, options: InferenceOptions) -> Array:
    """[N, K, D_m] by one shaper, block by block as a recording is rendered."""
    statistics, whole = system().bundle.statistics, shaping(options)
    times = CUT.knot_times.reshape(COUNT, -1)
    return np.stack([whole(statistics.denormalise(rows.astype(np.float64), 0), knots)
                     for rows, knots in zip(motion, times, strict=True)])


KNOBS = {"larger": InferenceOptions(intensity=1.5), "smaller": InferenceOptions(intensity=0.6),
         "both hands": InferenceOptions(intensity=1.2, handedness="both")}


@pytest.mark.parametrize("liveliness", [0.1, 0.5], ids=["calm", "lively"])
@pytest.mark.parametrize("knobs", KNOBS)
def test_blocks_that_are_asked_for_in_any_order_are_those_of_one_pass(knobs: str, liveliness: float) -> None:
    options, motion = KNOBS[knobs], moving(liveliness)
    made = list(ShapedBlocks(system().bundle.statistics, 0, COUNT).blocks(
        played(motion, list(range(COUNT))), CUT, shaping(options)))
    wanted = at_once(motion, options)
    for at in np.random.default_rng(1).permutation(COUNT):
        np.testing.assert_array_equal(made[at].poses, wanted[at])


def test_after_an_edit_what_does_not_remember_it_is_not_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that moves forgets within seconds, one that does not within twenty."""
    shaped, computed = shaped_blocks._Run.shaped, list[int]()

    def counted(self: shaped_blocks._Run, at: int) -> Array:
        before = set(self.lacking)
        poses = shaped(self, at)
        computed.extend(before - set(self.lacking))
        return poses

    monkeypatch.setattr(shaped_blocks._Run, "shaped", counted)
    counts, options = list[int](), KNOBS["larger"]
    for liveliness in (0.02, 0.5):
        motion, blocks = moving(liveliness), ShapedBlocks(system().bundle.statistics, 0, COUNT)

        def posed(rows: Rows, numbers: list[int], blocks: ShapedBlocks = blocks) -> list[ShapedBlock]:
            made = list(blocks.blocks(played(rows, numbers), CUT, shaping(options)))
            assert all(len(one.poses) for one in made)
            return made

        posed(motion, list(range(COUNT)))
        computed.clear()
        edited, numbers = motion.copy(), list(range(COUNT))
        edited[40], numbers[40] = edited[40] + 0.3, COUNT
        after = posed(edited, numbers)
        counts.append(len(set(computed)))
        assert min(computed) == 40, "what was before is as it was"
        np.testing.assert_array_equal(np.stack([one.poses for one in after]), at_once(edited, options))
        computed.clear()
        assert posed(motion, list(range(COUNT)))[40].poses is not after[40].poses
        assert not computed, "undo computes nothing"
    assert counts[0] > 40 and counts[1] < 25, counts


@pytest.mark.parametrize("scale", [LARGE, FINE], ids=["large", "fine"])
def test_the_strokes_are_the_sum_that_the_module_defines(scale: StrokeScale) -> None:
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.02, 0.06, 900))
    poses = np.cumsum(rng.normal(0.0, 0.05, (900, 6)), axis=0)
    memory = StrokeMemory(np.arange(6), scale)
    memory.push(times, poses)
    steps = np.diff(poses, axis=0, prepend=poses[:1])
    speeds = np.linalg.norm(steps, axis=1) / np.diff(times, prepend=times[0] - 1.0)
    u = np.clip((speeds - scale.slow) / (scale.fast - scale.slow), 0.0, 1.0)
    moved = steps * (3.0 * u ** 2 - 2.0 * u ** 3)[:, None]
    path = np.cumsum(np.linalg.norm(moved, axis=1))
    for knot in (0, 1, 60, 500, 899):
        age = (path[knot] - path[:knot + 1]) / scale.path + (times[knot] - times[:knot + 1]) / 20.0
        wanted = np.sum((np.where(age < 1.0, 1.0 + np.cos(np.pi * age), 0.0) / 2.0)[:, None] * moved[:knot + 1], axis=0)
        np.testing.assert_allclose(memory.at(times[knot:knot + 1])[0], wanted, atol=1e-8)
