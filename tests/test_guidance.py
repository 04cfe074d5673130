"""Style guidance: what is asked is followed further than the models do, away from what they do unasked (RG 7.2.1)."""

import dataclasses

import numpy as np
import pytest
from untrained import SILENT, sampled_blocks, untrained

from data_module.types import Speech
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.config import with_settings
from gesticulator.gesticulator import Gesticulator
from gesticulator.sampling.loop import GeneratedMotion, Request, Setup


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    """A bundle that was never trained, hears control, and has wide bounds: nothing is clamped."""
    made = dataclasses.replace(untrained(f"lexicon.size={max(SILENT) + 1}"), silent=np.array([2]))
    bounds = np.array([[-1e6], [1e6]]) * np.ones_like(made.statistics.bounds)
    return dataclasses.replace(made, statistics=dataclasses.replace(made.statistics, bounds=bounds))


def played(bundle: Bundle, guidance: float, asked: bool = True, noise: float = 0.1) -> GeneratedMotion:
    """The first blocks with guidance; the same sound each time, all of it silent where noise is 0."""
    config = with_settings(bundle.config, [f"selection.guidance={guidance}", "silence.rest_decay=0"])
    own = dataclasses.replace(bundle, config=config)
    system = Gesticulator(own)
    samples = noise * np.random.default_rng(0).normal(size=20_000).astype(np.float32)
    encoded = dataclasses.replace(system.encode_speech(Speech(samples.astype(np.float32), 16000)), text=None)
    blocks = len(encoded.blocks)
    rows = np.ones((blocks, own.frames, 6), np.float32) if asked else None
    setup = Setup(system.bundle.interpreter_named("lstm"), 0, temperature=0.0, seed=0)
    made = sampled_blocks(own, setup, [Request(encoded.block(i), None if rows is None else rows[i])
                                       for i in range(blocks)])
    return GeneratedMotion(encoded.blocks, made, own.system.motion_of(own, setup, made))


def scores(made: GeneratedMotion) -> np.ndarray:
    """[S] scores of the first block, by lexeme."""
    first = made.blocks[0].block.alternatives
    out = np.full(max(SILENT) + 1, np.nan)
    out[[one.lexeme for one in first]] = [one.score for one in first]
    return out


def test_scores_go_on_from_unasked_to_asked(bundle: Bundle) -> None:
    none, plain, five = (scores(played(bundle, g)) for g in (0, 1, 5))
    assert not np.allclose(none, plain, equal_nan=True), "what is asked is heard"
    kept = ~np.isnan(none + plain + five)
    assert kept.sum() >= 4
    np.testing.assert_allclose(five[kept], (none + 5 * (plain - none))[kept], rtol=1e-9)
    np.testing.assert_allclose(none, scores(played(bundle, 5, asked=False)), err_msg="0 is what is done unasked")


def test_motion_goes_on_from_unasked_to_asked(bundle: Bundle) -> None:
    # In silence every performance takes the one silent lexeme, so the first blocks differ by guidance alone.
    none, plain, five = (played(bundle, g, noise=0.0) for g in (0, 1, 5))
    assert [made.blocks[0].lexeme for made in (none, plain, five)] == [2, 2, 2]
    first = [made.motion[0].astype(np.float64) for made in (none, plain, five)]
    assert np.abs(first[1] - first[0]).max() > 1e-4, "what is asked is heard"
    np.testing.assert_allclose(first[2], first[0] + 5 * (first[1] - first[0]), atol=1e-5)
    unasked = played(bundle, 5, asked=False, noise=0.0)
    np.testing.assert_array_equal(first[0], unasked.motion[0])
