"""The shipped system at toy size: movements, a head that samples, 46 joints, and what stands around them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from untrained import PLAIN, untrained

from data_module.blocks import cut
from data_module.motion.skeletons import CHARACTERS
from data_module.speech.audio import write_flac
from data_module.store import Recording, Store
from eval.commands import QUALITY
from eval.context import EvalContext
from eval.metrics.encode import encode_motion, latents_of, normalised_blocks
from eval.table import load
from generator.flow import FlowGenerator
from gesticulator.bundle import bundle as bundles
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance
from gesticulator.training.stages.lexicon import token_labels
from interpreters.planner import UnitStyleInterpreter
from interpreters.planner_run import CODE
from lexicon.movement import MovementLexicon


@pytest.fixture(scope="module")
def system(tiny_movement_bundle: Path) -> Gesticulator:
    return Gesticulator.from_pretrained(tiny_movement_bundle)


@pytest.fixture(scope="module")
def recording(tiny_store: Path) -> Recording:
    store = Store.open(tiny_store)
    return store.load(store.of_split("test")[0].name)


@pytest.fixture(scope="module")
def played(system: Gesticulator, recording: Recording) -> Performance:
    return system(recording.speech, seed=3)


def test_it_draws_the_whole_character_at_every_frame(system: Gesticulator, played: Performance,
                                                     recording: Recording) -> None:
    bundle = system.bundle
    assert isinstance(bundle.lexicon, MovementLexicon) and isinstance(bundle.generator, FlowGenerator)
    assert isinstance(bundle.style, UnitStyleInterpreter) and "planner" in bundle.parts and bundle.encoder is None
    assert played.motion.skeleton.names == CHARACTERS[46].names
    assert played.motion.duration == pytest.approx(recording.speech.duration, abs=0.05)
    assert np.isfinite(played.motion.rotations).all()
    assert played.codes.shape == (len(played.blocks), len(CODE))
    assert len(np.unique(played.lexemes)) > 1 and played.lexemes.max() < len(bundle.vectors)


def test_a_bundle_that_draws_in_one_way_has_no_variations(recording: Recording, tmp_path: Path,
                                                          refused: Callable[..., str]) -> None:
    bundles.save(untrained(*PLAIN), tmp_path / "regression", "# Never trained\n")
    sound = tmp_path / "speech.flac"
    write_flac(sound, recording.speech)
    assert "variation 1: needs a generator that samples" in refused(
        "infer", sound, "-o", tmp_path / "out.bvh", "--bundle", tmp_path / "regression", "--variation", "1")
    assert not (tmp_path / "out.bvh").exists()


# ------------------------------------------------------------------------------------------------------ evaluation

@pytest.fixture(scope="module")
def context(tiny_store: Path, tiny_movement_bundle: Path) -> EvalContext:
    work = tiny_movement_bundle.with_name(tiny_movement_bundle.name + ".work")  # what the training cut and heard
    return EvalContext.over(Store.open(tiny_store), bundles.load(tiny_movement_bundle), work, progress=False)


def test_motion_is_read_as_the_training_read_it(context: EvalContext) -> None:
    bundle, corpus = context.bundle, context.corpus
    number = context.numbers("train")[0]
    recording = context.store.load(corpus.names[number], bundle.config.motion.joints)
    blocks = cut(recording.speech, bundle.config.rhythm)
    own = encode_motion(bundle, recording.motion, blocks, recording.info.speaker)
    rows = corpus.blocks_of(number)
    known = token_labels(bundle.block_lexicon, corpus)[rows]
    # The corpus is kept in half precision, which decides a block between two lexemes now and then.
    assert (own.labels == known).mean() > 0.95
    lexicon = bundle.block_lexicon
    assert isinstance(lexicon, MovementLexicon)
    poses, past = normalised_blocks(bundle.config, bundle.statistics, recording.motion, blocks, recording.info.speaker)
    distances = torch.cdist(latents_of(lexicon, poses, past).double(), torch.as_tensor(bundle.vectors).double())
    assert (distances.argmin(1).numpy() == own.labels).mean() > 0.99


def test_levels_and_lexemes_tell_more_than_the_past_alone(context: EvalContext, tiny_movement_bundle: Path,
                                                          tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    out = tmp_path / "quality.json"
    assert QUALITY.main("gesticulator quality", [
        "--data", str(context.store.path), "--bundle", str(tiny_movement_bundle), "--work",
        str(context.work), "--out", str(out), "--quiet"]) == 0
    error = {name: row["error"] for name, row in load(out)[0].rows.items()}
    assert error["unquantised"] < error["quantised"] < error["lexeme"] < error["predicted"]  # type: ignore[operator]
    assert {"lstm", "statistical", "majority"} <= set(load(out)[1].rows)
